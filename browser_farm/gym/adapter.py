"""The miniwob package's words for what our farm does: its actions become commands, our pages its observations."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from miniwob.action import (
    COORDS_ACTIONS,
    FIELD_ACTIONS,
    SCROLL_ACTIONS,
    TEXT_ACTIONS,
    ActionSpaceConfig,
    ActionTypes,
)
from miniwob.constants import (
    ATTRIBUTE_MAX_LENGTH,
    FLIGHT_TASK_HEIGHT,
    FLIGHT_TASK_WIDTH,
    TASK_HEIGHT,
    TASK_WIDTH,
    TEXT_MAX_LENGTH,
    UTTERANCE_MAX_LENGTH,
)
from miniwob.dom import DOMElement
from miniwob.fields import FIELD_EXTRACTORS
from miniwob.observation import create_empty_observation, get_observation_space
from miniwob.reward import get_original_reward
from numpy.typing import NDArray

from browser_farm.gym.elements import Elements, rgba
from browser_farm.tasks import page_url
from giirl_core import keys
from giirl_core.types import Command, Verb

Fields = Sequence[tuple[str, str]]
Observed = dict[str, Any]  # "utterance", "fields", "dom_elements", "screenshot"
Wanted = Mapping[str, Any]  # "action_type" and what it needs of "coords", "ref", "key", "text", "field"
POINTING = {
    ActionTypes.MOVE_COORDS: Verb.HOVER,
    ActionTypes.CLICK_COORDS: Verb.CLICK,
    ActionTypes.DBLCLICK_COORDS: Verb.DOUBLE_CLICK,
    ActionTypes.MOUSEDOWN_COORDS: Verb.MOUSE_DOWN,
    ActionTypes.MOUSEUP_COORDS: Verb.MOUSE_UP,
}
MODIFIERS = {"A-": "Alt", "C-": "Control", "M-": "Meta", "S-": "Shift"}
# Keys that the package names and pages know by what they write.
WRITING = {
    "Space": " ",
    "Semicolon": ";",
    "Equal": "=",
    "NumpadMultiply": "*",
    "NumpadAdd": "+",
    "NumpadComma": ",",
    "NumpadSubtract": "-",
    "NumpadDecimal": ".",
    "NumpadDivide": "/",
    **{f"Numpad{digit}": str(digit) for digit in range(10)},
}


@dataclass(frozen=True, kw_only=True)
class MiniWoBAdapter:
    """How the miniwob package would speak of one task."""

    task: str
    action_space_config: ActionSpaceConfig
    field_extractor: Callable[[str], Fields]
    reward_processor: Callable[[Mapping[str, Any]], float]

    @classmethod
    def of(
        cls,
        task: str,
        action_space_config: str | ActionSpaceConfig = "all_supported",
        field_extractor: Callable[[str], Fields] | None = None,
        reward_processor: Callable[[Mapping[str, Any]], float] | None = None,
    ) -> MiniWoBAdapter:
        """With the package's own defaults; ValueError for an unknown preset or a key that no page would hear."""
        config = action_space_config
        if isinstance(config, str):
            config = ActionSpaceConfig.get_preset(config)
        page_url(task)  # a task that does not exist is an error before any browser starts
        made = cls(
            task=task,
            action_space_config=config,
            field_extractor=field_extractor or FIELD_EXTRACTORS.get(task, _nothing),
            reward_processor=reward_processor or get_original_reward,
        )
        config.screen_width, config.screen_height = made.size
        if ActionTypes.PRESS_KEY in config.action_types:
            for name in config.allowed_keys:
                chord_of(name)
        return made

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the part of the page that belongs to the task, CSS px."""
        flight = self.task.startswith("flight.")
        return (FLIGHT_TASK_WIDTH, FLIGHT_TASK_HEIGHT) if flight else (TASK_WIDTH, TASK_HEIGHT)

    @property
    def action_space(self) -> Any:
        return self.action_space_config.get_action_space()

    @property
    def observation_space(self) -> Any:
        return get_observation_space(*self.size)

    def fields(self, page: Elements) -> Fields:
        """What the instruction names, by the page's own account or by the package's pattern for the task."""
        return list(page.fields) if page.fields is not None else self.field_extractor(page.utterance)

    def command(self, action: Wanted | None, page: Elements, fields: Fields) -> Command:
        """What an action means on a page; ValueError for an action that is none."""
        if action is None:
            return Command(verb=Verb.WAIT)
        config = self.action_space_config
        try:
            kind = config.action_types[int(action["action_type"])]
            if kind in COORDS_ACTIONS:
                return _pointed(kind, config.compute_raw_coords(action), config.scroll_amount)
            if kind is ActionTypes.PRESS_KEY:
                return Command(verb=Verb.PRESS, text=chord_of(config.allowed_keys[int(action["key"])]))
            text = ""
            if kind in TEXT_ACTIONS:
                text = str(action["text"])
            elif kind in FIELD_ACTIONS:
                text = dict(enumerate(value for _, value in fields)).get(int(action["field"]), "")
            if kind in (ActionTypes.TYPE_TEXT, ActionTypes.TYPE_FIELD):
                return Command(verb=Verb.APPEND, text=text)
            if kind is ActionTypes.NONE:
                return Command(verb=Verb.WAIT)
            ref = int(action["ref"])
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise ValueError(
                f"{action!r} is no action of {self.task} ({error!r}), wanted one of the action space"
            ) from error
        if ref > 0 and np.any(page.ref == ref):
            return Command(verb=Verb.ACTIVATE, ref=ref, text=text)
        return Command(verb=Verb.APPEND, text=text)  # there is no such element: nothing gets the focus

    def create_action(self, space: Any, action_type: Any, values: Mapping[str, Any]) -> dict[str, Any]:
        """An action of this type (a name, or an index), drawn at random but for the values given."""
        action: dict[str, Any] = space.sample()
        named = isinstance(action_type, (str, ActionTypes))
        kinds = self.action_space_config.action_types
        action["action_type"] = kinds.index(ActionTypes(action_type)) if named else int(action_type)
        for key, value in values.items():
            if key not in action:
                raise KeyError(f"an action has no {key!r}, wanted one of: {', '.join(action)}")
            action[key] = value
        return action

    def observe(self, page: Elements, fields: Fields, screenshot: NDArray[np.uint8] | None) -> Observed:
        """The package's observation of a page."""
        observed = self.blank()
        observed["utterance"] = page.utterance[:UTTERANCE_MAX_LENGTH]
        observed["dom_elements"] = tuple(serialized(page))
        observed["fields"] = tuple(fields)
        if screenshot is not None:
            observed["screenshot"] = screenshot
        return observed

    def blank(self) -> Observed:
        """The package's observation of an episode that is over."""
        observed: Observed = create_empty_observation(*self.size)
        return observed


def _nothing(utterance: str) -> Fields:
    """The fields of a task for which the package has no pattern."""
    del utterance
    return []


def _pointed(kind: ActionTypes, at: tuple[float, float], amount: int) -> Command:
    if kind in SCROLL_ACTIONS:
        down = amount if kind is ActionTypes.SCROLL_DOWN_COORDS else -amount
        return Command(verb=Verb.SCROLL, at=at, by=(0.0, float(down)))
    return Command(verb=POINTING[kind], at=at)


@functools.cache
def chord_of(name: str) -> str:
    """A key of the package ("<Enter>", "C-a", "A") as pages name it."""
    held, key = [], name
    while key[:2] in MODIFIERS and len(key) > 2:
        held.append(MODIFIERS[key[:2]])
        key = key[2:]
    if key.startswith("<") and key.endswith(">"):
        key = WRITING.get(key[1:-1], key[1:-1]).removeprefix("Numpad").removeprefix("Right")
    wanted = "+".join([*held, key])
    try:
        keys.parse_chord(wanted)
    except ValueError as error:
        raise ValueError(f"the key {name!r} has no meaning for a page: {error}") from error
    return wanted


def serialized(page: Elements) -> list[dict[str, Any]]:
    """One dictionary for each element, as the package lays them out."""
    box, flags, refs = page.box.copy(), page.flags.copy(), page.ref.tolist()
    colours = np.array([(*rgba(b), *rgba(f)) for b, f in zip(page.background, page.foreground, strict=True)])
    colours = colours.astype(np.float32).reshape(-1, 8)
    return [
        {
            "ref": refs[row],
            "parent": refs[parent] if parent >= 0 else 0,
            "left": box[row, 0:1],
            "top": box[row, 1:2],
            "width": box[row, 2:3],
            "height": box[row, 3:4],
            "tag": page.tag[row][:ATTRIBUTE_MAX_LENGTH],
            "text": page.text[row][:TEXT_MAX_LENGTH],
            "value": page.value[row][:TEXT_MAX_LENGTH],
            "id": page.id[row][:ATTRIBUTE_MAX_LENGTH],
            "classes": page.classes[row][:ATTRIBUTE_MAX_LENGTH],
            "bg_color": colours[row, :4],
            "fg_color": colours[row, 4:],
            "flags": flags[row],
        }
        for row, parent in enumerate(page.parent.tolist())
    ]


def _readable(colour: str) -> str | None:
    """A colour that DOMElement can read; it breaks on others."""
    return colour if colour.startswith("rgb") else None


def root_dom(page: Elements) -> Any:
    """The page as a tree of the package's DOMElement."""
    nodes: list[dict[str, Any]] = []
    for row, parent in enumerate(page.parent.tolist()):
        left, top, width, height = page.box[row].tolist()
        node = {
            "tag": page.tag[row],
            "ref": int(page.ref[row]),
            "left": left,
            "top": top,
            "width": width,
            "height": height,
            "value": page.held[row],
            "id": page.id[row],
            "classes": page.classes[row],
            "bgColor": _readable(page.background[row]),
            "fgColor": _readable(page.foreground[row]),
            "focused": bool(page.flags[row, 0]),
            "tampered": bool(page.flags[row, 1]),
            "children": [],
        }
        if page.flags[row, 3]:
            node["text"] = page.text[row]
        nodes.append(node)
        if parent >= 0:
            nodes[parent]["children"].append(node)
    return DOMElement(nodes[0])
