"""The JSON of the HTTP API: a page as elements, a goal and candidate actions; their rewards."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from giirl_core.choices import Choice, action_of, choice_of, readings
from giirl_core.gestures import BASIC, CLICK, Gesture, Takes
from giirl_core.types import NO_SPAN, Action, Goal, Page, Verb

MAX_ELEMENTS, MAX_ACTIONS = 500, 1000
MAX_NAME, MAX_TEXT = 500, 5000  # characters
MAX_PX = 100_000.0
MAX_GOT, MAX_LINE = 60, 400  # characters of a wrong value in an error message, and of the message
COLUMNS = ("tag", "text", "value", "classes", "attributes", "colour", "shape")  # strings of `Page`

Name = Annotated[str, Field(max_length=MAX_NAME)]
Text = Annotated[str, Field(max_length=MAX_TEXT)]
Px = Annotated[float, Field(ge=-MAX_PX, le=MAX_PX)]
Row = Annotated[int, Field(ge=0, lt=MAX_ELEMENTS, description="index in `elements`")]


class _Strict(BaseModel):
    """Unknown keys and values of another type are errors."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Element(_Strict):
    """A visible element of the page."""

    tag: Annotated[Name, Field(min_length=1, description="lower case; an input as input_text; t is a run of bare text")]
    left: Annotated[Px, Field(description="CSS px")]
    top: Annotated[Px, Field(description="CSS px")]
    width: Annotated[Px, Field(ge=0, description="CSS px")]
    height: Annotated[Px, Field(ge=0, description="CSS px")]
    parent: Annotated[int, Field(ge=-1, description="index of the parent, which comes before; -1 for a root")] = -1
    text: Annotated[Text, Field(description="text of an element without children")] = ""
    value: Annotated[Text, Field(description="of a field; `checked` of a checked box")] = ""
    classes: Annotated[Name, Field(description="separated by spaces")] = ""
    attributes: Annotated[Name, Field(description="id, placeholder, alt, aria-label, separated by spaces")] = ""
    focused: bool = False
    tampered: Annotated[bool, Field(description="acted on earlier in this episode")] = False
    colour: Annotated[Name, Field(description="CSS colour in its own style, or fill of an SVG shape")] = ""
    shape: Annotated[Name, Field(description="kind of an SVG shape and its corners, `triangle 10,40 20,20 30,40`")] = ""


class Click(_Strict):
    """Click an element."""

    verb: Literal["click"]
    element: Row


class Type(_Strict):
    """Replace the text of a field."""

    verb: Literal["type"]
    element: Row
    text: Annotated[Text, Field(min_length=1, description="words of the goal, exactly as they are there")]


class Other(_Strict):
    """Any other gesture that the demonstrations of the reward showed."""

    verb: Literal["gesture"]
    gesture: Annotated[Name, Field(examples=["hover", "press Enter", "drag to", "type text-of"])]
    element: Row
    second: Annotated[Row | None, Field(description="the other element of `drag to` and `type text-of`")] = None


class ScoreRequest(_Strict):
    """Candidate actions on one page under one goal."""

    goal: Annotated[Text, Field(min_length=1, examples=['Click on the "Ok" button.'])]
    elements: Annotated[tuple[Element, ...], Field(min_length=1, max_length=MAX_ELEMENTS, strict=False)]
    actions: Annotated[
        tuple[Annotated[Click | Type | Other, Field(discriminator="verb")], ...],
        Field(min_length=1, max_length=MAX_ACTIONS, strict=False),
    ]

    @classmethod
    def of(cls, page: Page, goal: Goal, actions: Sequence[Action]) -> ScoreRequest:
        """The request for the rewards of `actions`; ValueError for an action on no element."""
        boxes = [dict(zip(("left", "top", "width", "height"), box, strict=True)) for box in page.box.tolist()]
        columns = {name: getattr(page, name) for name in COLUMNS}
        columns |= {name: getattr(page, name).tolist() for name in ("parent", "focused", "tampered")}
        rows = [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]
        elements = tuple(Element(**box, **row) for box, row in zip(boxes, rows, strict=True))
        return cls(
            goal=goal.utterance, elements=elements, actions=tuple(_candidate(action, page, goal) for action in actions)
        )

    def read(self, gestures: Sequence[Gesture] = BASIC) -> tuple[Page, Goal, list[Action]]:
        """The values that nets with these gestures score; ValueError, one line, where one part does not fit another."""
        goal = _goal(self.goal)
        page = _page(self.elements)
        known = {str(gesture): gesture for gesture in gestures if gesture.takes is not Takes.WORDS}
        actions = [_action(index, action, page, goal, known) for index, action in enumerate(self.actions)]
        return page, goal, actions


class Scores(_Strict):
    """The rewards of the candidates."""

    rewards: Annotated[Sequence[float], Field(description="one for each action, in the order of the request")]
    best_first: Annotated[Sequence[int], Field(description="indices of the actions by their rewards, the best first")]
    version: Annotated[int, Field(description="learner step of the weights")]
    form: Annotated[str, Field(description="how the logit became the reward; `logit` is in nats")]


class Problem(_Strict):
    """Why a request got no rewards."""

    error: Annotated[str, Field(description="one line: where, what was wanted, what was got")]


def shown(value: Any) -> str:
    """A wrong value in an error message."""
    text = repr(value)
    return text if len(text) <= MAX_GOT else f"{text[:MAX_GOT]}..."


def one_line(text: str) -> str:
    """A message that any client can print, whatever of a request is in it."""
    line = " ".join(text.encode("ascii", "backslashreplace").decode().split())
    return line if len(line) <= MAX_LINE else f"{line[:MAX_LINE]}..."


def _goal(utterance: str) -> Goal:
    try:
        return Goal(utterance)
    except ValueError:
        raise ValueError(f"goal: wanted at least one word, got {shown(utterance)}") from None


def _page(elements: Sequence[Element]) -> Page:
    for row, element in enumerate(elements):
        if element.parent >= row:
            raise ValueError(
                f"elements.{row}.parent: wanted the index of an earlier element, or -1, got {element.parent}"
            )
    return Page(
        **{name: tuple(getattr(element, name) for element in elements) for name in COLUMNS},
        ref=np.arange(len(elements), dtype=np.int32),
        parent=np.array([element.parent for element in elements], dtype=np.int16),
        box=np.array([(e.left, e.top, e.width, e.height) for e in elements], dtype=np.float32),
        focused=np.array([element.focused for element in elements], dtype=np.bool_),
        tampered=np.array([element.tampered for element in elements], dtype=np.bool_),
    )


def _action(index: int, action: Click | Type | Other, page: Page, goal: Goal, known: Mapping[str, Gesture]) -> Action:
    _check_row(f"actions.{index}.element", action.element, page)
    if isinstance(action, Click):
        return Action(verb=Verb.CLICK, element=action.element)
    if isinstance(action, Type):
        start, end = goal.find(action.text)
        if start == NO_SPAN:
            raise ValueError(f"actions.{index}.text: wanted words of the goal, got {shown(action.text)}")
        return Action(verb=Verb.TYPE, element=action.element, start=start, end=end)
    if action.gesture not in known:
        raise ValueError(f"actions.{index}.gesture: wanted one of {', '.join(known)}, got {shown(action.gesture)}")
    gesture = known[action.gesture]
    if gesture.has_second is not (action.second is not None):
        wanted = "another element" if gesture.has_second else "none"
        raise ValueError(f"actions.{index}.second: wanted {wanted} for {action.gesture}, got {action.second}")
    if action.second is not None:
        _check_row(f"actions.{index}.second", action.second, page)
    choice = Choice(0, action.element, NO_SPAN if action.second is None else action.second)
    return action_of(choice, page, [gesture])


def _check_row(where: str, row: int, page: Page) -> None:
    if row >= len(page):
        raise ValueError(f"{where}: wanted one of the {len(page)} elements, from 0, got {row}")


def _candidate(action: Action, page: Page, goal: Goal) -> Click | Type | Other:
    found = readings(action, page)
    if not found or (found[0].takes is Takes.WORDS and found[0].verb is not Verb.TYPE):
        raise ValueError(f"{action} is not in this API: wanted an action on an element")
    if found[0] == CLICK:
        return Click(verb="click", element=action.element)
    if found[0].takes is Takes.WORDS:
        return Type(verb="type", element=action.element, text=action.text(goal))
    choice = choice_of(action, page, found[:1])
    assert choice is not None
    second = choice.start if found[0].has_second else None
    return Other(verb="gesture", gesture=str(found[0]), element=choice.element, second=second)
