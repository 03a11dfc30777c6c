"""Translates between the miniwob package and our farm: its actions to commands, our pages to its observations."""

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
from browser_farm.gym.own_pages import size_of
from browser_farm.sites.task_file import SiteTask, is_site, load_task
from browser_farm.tasks import page_url
from giirl_core import keys
from giirl_core.types import Command, Verb

Fields = Sequence[tuple[str, str]]
ObservationDict = dict[str, Any]  # "utterance", "fields", "dom_elements", "screenshot"
ActionDict = Mapping[str, Any]  # "action_type" and, depending on it, "coords", "ref", "key", "text", "field"
POINTER_VERBS = {
    ActionTypes.MOVE_COORDS: Verb.HOVER,
    ActionTypes.CLICK_COORDS: Verb.CLICK,
    ActionTypes.DBLCLICK_COORDS: Verb.DOUBLE_CLICK,
    ActionTypes.MOUSEDOWN_COORDS: Verb.MOUSE_DOWN,
    ActionTypes.MOUSEUP_COORDS: Verb.MOUSE_UP,
}
MODIFIERS = {"A-": "Alt", "C-": "Control", "M-": "Meta", "S-": "Shift"}
# Keys of the package that KeyboardEvent.key names by the character they type.
KEY_CHARACTERS = {
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
    """The miniwob package's spaces, actions, observations and rewards for one task."""

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
        base_url: str = "",
    ) -> MiniWoBAdapter:
        """An adapter with the package's defaults; ValueError for an unknown task, preset or key, or a bad task file."""
        config = action_space_config
        if isinstance(config, str):
            config = ActionSpaceConfig.get_preset(config)
        if is_site(task):
            load_task(task)  # raises for a bad file, before a browser starts
        else:
            page_url(task, base_url)  # raises for an unknown task
        adapter = cls(
            task=task,
            action_space_config=config,
            field_extractor=field_extractor or FIELD_EXTRACTORS.get(task, _no_fields),
            reward_processor=reward_processor or get_original_reward,
        )
        config.screen_width, config.screen_height = adapter.size
        if ActionTypes.PRESS_KEY in config.action_types:
            for name in config.allowed_keys:
                chord_of(name)  # raises for an unknown key
        return adapter

    @property
    def site(self) -> SiteTask | None:
        """The task file; None for a task of MiniWoB."""
        return load_task(self.task) if is_site(self.task) else None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the task's area of the page: CSS px, or the units of the pages of a task file."""
        if self.site is not None:
            return size_of(self.site)
        flight = self.task.startswith("flight.")
        return (FLIGHT_TASK_WIDTH, FLIGHT_TASK_HEIGHT) if flight else (TASK_WIDTH, TASK_HEIGHT)

    @property
    def action_space(self) -> Any:
        return self.action_space_config.get_action_space()

    @property
    def observation_space(self) -> Any:
        return get_observation_space(*self.size)

    def fields(self, page: Elements) -> Fields:
        """The (key, value) fields of the instruction: the page's own, else from the package's pattern for the task."""
        return list(page.fields) if page.fields is not None else self.field_extractor(page.utterance)

    def command(self, action: ActionDict | None, page: Elements, fields: Fields) -> Command:
        """The command of an action on a page; ValueError for a malformed action."""
        if action is None:
            return Command(verb=Verb.WAIT)
        config = self.action_space_config
        try:
            kind = config.action_types[int(action["action_type"])]
            if kind in COORDS_ACTIONS:
                return _pointer_command(kind, config.compute_raw_coords(action), config.scroll_amount)
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
                f"{action!r} is not an action of {self.task} ({error!r}): wanted one from the action space"
            ) from error
        if ref > 0 and np.any(page.ref == ref):
            return Command(verb=Verb.ACTIVATE, ref=ref, text=text)
        return Command(verb=Verb.APPEND, text=text)  # no such element: the keys go to the element with the focus

    def create_action(self, space: Any, action_type: Any, values: Mapping[str, Any]) -> dict[str, Any]:
        """An action of this type (a name or an index); fields without a given value are sampled from `space`."""
        action: dict[str, Any] = space.sample()
        by_name = isinstance(action_type, (str, ActionTypes))
        kinds = self.action_space_config.action_types
        action["action_type"] = kinds.index(ActionTypes(action_type)) if by_name else int(action_type)
        for key, value in values.items():
            if key not in action:
                raise KeyError(f"an action has no {key!r}, wanted one of: {', '.join(action)}")
            action[key] = value
        return action

    def observe(self, page: Elements, fields: Fields, screenshot: NDArray[np.uint8] | None) -> ObservationDict:
        """The package's observation of a page; black without a screenshot."""
        observation = self.empty_observation()
        observation["utterance"] = page.utterance[:UTTERANCE_MAX_LENGTH]
        observation["dom_elements"] = tuple(dom_elements(page))
        observation["fields"] = tuple(fields)
        if screenshot is not None:
            observation["screenshot"] = screenshot
        return observation

    def empty_observation(self) -> ObservationDict:
        """The package's observation after the end of an episode."""
        observation: ObservationDict = create_empty_observation(*self.size)
        return observation


def _no_fields(utterance: str) -> Fields:
    """The field extractor of a task for which the package has no pattern."""
    del utterance
    return []


def _pointer_command(kind: ActionTypes, at: tuple[float, float], amount: int) -> Command:
    if kind in SCROLL_ACTIONS:
        down = amount if kind is ActionTypes.SCROLL_DOWN_COORDS else -amount
        return Command(verb=Verb.SCROLL, at=at, by=(0.0, float(down)))
    return Command(verb=POINTER_VERBS[kind], at=at)


@functools.cache
def chord_of(name: str) -> str:
    """A key of the package ("<Enter>", "C-a", "A") in the notation of `giirl_core.keys`; ValueError if unknown."""
    modifiers, key = [], name
    while key[:2] in MODIFIERS and len(key) > 2:
        modifiers.append(MODIFIERS[key[:2]])
        key = key[2:]
    if key.startswith("<") and key.endswith(">"):
        key = KEY_CHARACTERS.get(key[1:-1], key[1:-1]).removeprefix("Numpad").removeprefix("Right")
    wanted = "+".join([*modifiers, key])
    try:
        keys.parse_chord(wanted)
    except ValueError as error:
        raise ValueError(f"the key {name!r} is not supported: {error}") from error
    return wanted


def dom_elements(page: Elements) -> list[dict[str, Any]]:
    """One dictionary per element, with the package's keys, types and length limits."""
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


def _rgb_or_none(colour: str) -> str | None:
    """The colour if DOMElement can parse it; it raises on other notations."""
    return colour if colour.startswith("rgb") else None


def root_dom(page: Elements) -> Any:
    """The page as a tree of the package's DOMElement; a page without a single root gets one."""
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
            "value": page.raw_value[row],
            "id": page.id[row],
            "classes": page.classes[row],
            "bgColor": _rgb_or_none(page.background[row]),
            "fgColor": _rgb_or_none(page.foreground[row]),
            "focused": bool(page.flags[row, 0]),
            "tampered": bool(page.flags[row, 1]),
            "children": [],
        }
        if page.flags[row, 3]:
            node["text"] = page.text[row]
        nodes.append(node)
        if parent >= 0:
            nodes[parent]["children"].append(node)
    roots = [node for node, parent in zip(nodes, page.parent.tolist(), strict=True) if parent < 0]
    place = dict.fromkeys(("ref", "left", "top", "width", "height"), 0)
    return DOMElement(roots[0] if len(roots) == 1 else {"tag": "body", **place, "children": roots})
