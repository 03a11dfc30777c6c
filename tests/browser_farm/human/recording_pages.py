"""Plays a person on a small page and writes down what a recorder would: pages and events of one episode."""

from __future__ import annotations

import copy
import gzip
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

Dom = dict[str, Any]
CAPTURE, BUBBLE = 1, 3
ENTER, TAB, CONTROL = 13, 9, 17


def element(tag: str, ref: int, *children: Dom, box: tuple[float, ...] = (0, 50, 160, 20), **more: Any) -> Dom:
    """A recorded node. `more` is what else stands on it: text, value, id, classes."""
    left, top, width, height = box
    node: Dom = {"tag": tag, "ref": ref, "left": left, "top": top, "width": width, "height": height}
    return {**node, "id": "", "classes": "", "children": list(children), **more}


def words(text: str, box: tuple[float, ...] = (30, 50, 60, 20)) -> Dom:
    """A line of bare text; recorders give it another ref in every state."""
    return {
        "tag": "t",
        "ref": -1,
        **dict(zip(("left", "top", "width", "height"), box, strict=True)),
        "text": text,
    }


def body(*children: Dom) -> Dom:
    """A page as MiniWoB has it: everything in div#wrap > div#area."""
    area = element("DIV", 3, *children, id="area", box=(0, 50, 160, 160))
    return element("BODY", 1, element("DIV", 2, area, id="wrap", box=(0, 0, 160, 210)), box=(0, 0, 800, 210))


def form() -> Dom:
    """enter-text's page."""
    field = element("INPUT_text", 5, value="", text="", box=(20, 60, 120, 20))
    return body(element("DIV", 4, field, element("BUTTON", 6, text="Submit", box=(20, 100, 90, 30))))


class Tape:
    """A recording in the making."""

    def __init__(self, page: Dom, utterance: str) -> None:
        self.page = page
        self.utterance = utterance
        self.states: list[Dom] = [{"time": 1, "action": None, "dom": copy.deepcopy(page)}]

    def node(self, ref: int) -> Dom:
        return next(node for node in _all(self.page) if node["ref"] == ref)

    def event(self, kind: str, ref: int, timing: int, **more: float) -> None:
        page = copy.deepcopy(self.page)
        for node in _all(page):
            if node["ref"] == ref:
                node["recordingTarget"] = True
        action = {"type": kind, "timing": timing, **more}
        self.states.append({"time": len(self.states), "action": action, "dom": page})

    def mouse(self, kind: str, ref: int, at: tuple[float, float], effect: Callable[[], object] = bool) -> None:
        """An event in both phases, its effect on the page between them."""
        self.event(kind, ref, CAPTURE, x=at[0], y=at[1])
        effect()
        self.event(kind, ref, BUBBLE, x=at[0], y=at[1])

    def focus(self, ref: int) -> None:
        for node in _all(self.page):
            node.pop("focused", None)
        self.node(ref)["focused"] = True

    def click(self, ref: int, at: tuple[float, float] = (0, 0), effect: Callable[[], object] = bool) -> None:
        self.mouse("mousedown", ref, at)
        self.focus(ref)
        self.mouse("mouseup", ref, at)
        self.mouse("click", ref, at, effect)

    def key(self, ref: int, code: int) -> None:
        self.event("keydown", ref, CAPTURE, keyCode=code, charCode=0)
        self.event("keydown", ref, BUBBLE, keyCode=code, charCode=0)

    def type(self, ref: int, text: str) -> None:
        for letter in text:
            self.key(ref, ord(letter.upper()))
            self.event("keypress", ref, CAPTURE, keyCode=ord(letter), charCode=ord(letter))
            self.node(ref)["value"] += letter
            self.event("keyup", ref, CAPTURE, keyCode=ord(letter.upper()), charCode=0)

    def flip(self, ref: int) -> None:
        self.node(ref)["value"] = not self.node(ref)["value"]

    def content(self, raw_reward: float = 1) -> Dom:
        return {"utterance": self.utterance, "states": self.states, "rawReward": raw_reward, "reward": 0.5}

    def write(self, path: Path, raw_reward: float = 1) -> Path:
        path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps(self.content(raw_reward)).encode()
        path.write_bytes(gzip.compress(text) if path.suffix == ".gz" else text)
        return path


def entered(name: str = "Ada") -> Tape:
    """Somebody doing enter-text well."""
    tape = Tape(form(), f'Enter "{name}" into the text field and press Submit.')
    tape.click(5, (30, 65))
    tape.type(5, name)
    tape.click(6, (30, 110))
    return tape


def _all(node: Dom) -> list[Dom]:
    return [node, *(below for child in node.get("children", []) for below in _all(child))]
