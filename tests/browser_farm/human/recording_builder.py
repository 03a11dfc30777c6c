"""Simulates a person on a small page and writes the recording: the pages and events of one episode."""

from __future__ import annotations

import copy
import gzip
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from browser_farm.human.recordings import read_recording
from giirl_core.types import Trajectory

Dom = dict[str, Any]
CAPTURE, BUBBLE = 1, 3
ENTER, TAB, CONTROL = 13, 9, 17


def element(tag: str, ref: int, *children: Dom, box: tuple[float, ...] = (0, 50, 160, 20), **more: Any) -> Dom:
    """A recorded DOM node. `more` are its other properties: text, value, id, classes."""
    left, top, width, height = box
    node: Dom = {"tag": tag, "ref": ref, "left": left, "top": top, "width": width, "height": height}
    return {**node, "id": "", "classes": "", "children": list(children), **more}


def bare_text(text: str, box: tuple[float, ...] = (30, 50, 60, 20)) -> Dom:
    """A line of bare text. Real recordings give it another ref in every state."""
    return {
        "tag": "t",
        "ref": -1,
        **dict(zip(("left", "top", "width", "height"), box, strict=True)),
        "text": text,
    }


def body(*children: Dom) -> Dom:
    """A page with MiniWoB's structure: all content is in div#wrap > div#area."""
    area = element("DIV", 3, *children, id="area", box=(0, 50, 160, 160))
    return element("BODY", 1, element("DIV", 2, area, id="wrap", box=(0, 0, 160, 210)), box=(0, 0, 800, 210))


def enter_text_page() -> Dom:
    """The page of the task enter-text."""
    field = element("INPUT_text", 5, value="", text="", box=(20, 60, 120, 20))
    return body(element("DIV", 4, field, element("BUTTON", 6, text="Submit", box=(20, 100, 90, 30))))


class RecordingBuilder:
    """Builds a recording step by step."""

    def __init__(self, page: Dom, utterance: str) -> None:
        self.page = page
        self.utterance = utterance
        self.states: list[Dom] = [{"time": 1, "action": None, "dom": copy.deepcopy(page)}]

    def node(self, ref: int) -> Dom:
        """The node with this ref, to change it."""
        return next(node for node in _all(self.page) if node["ref"] == ref)

    def event(self, kind: str, ref: int, phase: int, **more: float) -> None:
        """Record one event phase with the current page."""
        page = copy.deepcopy(self.page)
        for node in _all(page):
            if node["ref"] == ref:
                node["recordingTarget"] = True
        action = {"type": kind, "timing": phase, **more}
        self.states.append({"time": len(self.states), "action": action, "dom": page})

    def mouse(self, kind: str, ref: int, at: tuple[float, float], effect: Callable[[], object] = bool) -> None:
        """Record a mouse event in both phases, and call `effect` between them to change the page."""
        self.event(kind, ref, CAPTURE, x=at[0], y=at[1])
        effect()
        self.event(kind, ref, BUBBLE, x=at[0], y=at[1])

    def focus(self, ref: int) -> None:
        """Move the focus without an event."""
        for node in _all(self.page):
            node.pop("focused", None)
        self.node(ref)["focused"] = True

    def click(self, ref: int, at: tuple[float, float] = (0, 0), effect: Callable[[], object] = bool) -> None:
        """Record mousedown, mouseup and click."""
        self.mouse("mousedown", ref, at)
        self.focus(ref)
        self.mouse("mouseup", ref, at)
        self.mouse("click", ref, at, effect)

    def key(self, ref: int, code: int) -> None:
        """Record a keydown that does not change the page."""
        self.event("keydown", ref, CAPTURE, keyCode=code, charCode=0)
        self.event("keydown", ref, BUBBLE, keyCode=code, charCode=0)

    def type(self, ref: int, text: str) -> None:
        """Record typing at the end of a field."""
        for letter in text:
            self.key(ref, ord(letter.upper()))
            self.event("keypress", ref, CAPTURE, keyCode=ord(letter), charCode=ord(letter))
            self.node(ref)["value"] += letter
            self.event("keyup", ref, CAPTURE, keyCode=ord(letter.upper()), charCode=0)

    def flip(self, ref: int) -> None:
        """Change a checkbox without an event."""
        self.node(ref)["value"] = not self.node(ref)["value"]

    def content(self, raw_reward: float = 1) -> Dom:
        """The recording as JSON."""
        return {"utterance": self.utterance, "states": self.states, "rawReward": raw_reward, "reward": 0.5}

    def write(self, path: Path, raw_reward: float = 1) -> Path:
        """Write the recording, compressed if the name ends in .gz."""
        path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps(self.content(raw_reward)).encode()
        path.write_bytes(gzip.compress(text) if path.suffix == ".gz" else text)
        return path


def enter_text_recording(name: str = "Ada") -> RecordingBuilder:
    """A successful recording of enter-text."""
    recording = RecordingBuilder(enter_text_page(), f'Enter "{name}" into the text field and press Submit.')
    recording.click(5, (30, 65))
    recording.type(5, name)
    recording.click(6, (30, 110))
    return recording


def trajectory_of(recording: RecordingBuilder, folder: Path, raw_reward: float = 1) -> Trajectory:
    """The episode that is imported from a recording. It must not be skipped."""
    imported = read_recording(recording.write(folder / "some-task" / "some-task_A_d1.json.gz", raw_reward))
    assert imported.reason == ("" if raw_reward == 1 else "failed")
    assert imported.episode is not None
    return imported.episode.trajectory


def skip_reason(recording: RecordingBuilder, folder: Path) -> str:
    """Why a recording is skipped."""
    imported = read_recording(recording.write(folder / "some-task" / "some-task_A_d1.json.gz"))
    assert imported.episode is None
    assert not imported.clean
    return imported.reason


def actions_of(trajectory: Trajectory) -> list[tuple[str, int, str]]:
    """(verb, ref, text) of every action."""
    return [
        (action.verb.name, int(page.ref[action.element]), action.text(trajectory.goal))
        for page, action in zip(trajectory.pages, trajectory.actions, strict=True)
    ]


def _all(node: Dom) -> list[Dom]:
    return [node, *(below for child in node.get("children", []) for below in _all(child))]
