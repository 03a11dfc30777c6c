"""Simulates a person's mouse and keyboard in tests, with events of Chrome's Input domain.

A page cannot distinguish them from a person's events: `isTrusted` is true for both.
"""

from __future__ import annotations

import json
from typing import Any

from browser_farm.chrome.devtools import BROWSER
from browser_farm.human.recorder import TAB, Recorder
from giirl_core.keys import MODIFIERS, key_code

FIND = """(() => {
  const found = [...document.querySelectorAll(%s)].filter((one) => %s === null || one.textContent.trim() === %s);
  const element = found[%d];
  const box = element.getBoundingClientRect();
  return JSON.stringify([box.left + box.width / 2, box.top + box.height / 2]);
})()"""


class Hand:
    """Waits for Chrome's reply to each event, so the page has handled it when the method returns."""

    def __init__(self, recorder: Recorder) -> None:
        self._tabs = recorder._tabs

    def find(self, selector: str, text: str | None = None, nth: int = 0) -> tuple[float, float]:
        """The middle of the nth element that matches the selector and has this text, CSS px."""
        expression = FIND % (json.dumps(selector), json.dumps(text), json.dumps(text), nth)
        x, y = json.loads(self.ask(expression))
        return x, y

    def ask(self, expression: str) -> str:
        """The string that a JavaScript expression returns."""
        answer = self._tabs.evaluate({TAB: expression})[TAB]
        assert isinstance(answer, str), answer
        return answer

    def click(self, selector: str, text: str | None = None, nth: int = 0) -> None:
        self.click_at(*self.find(selector, text, nth))

    def click_at(self, x: float, y: float) -> None:
        self._mouse("mouseMoved", x, y)
        self._mouse("mousePressed", x, y)
        self._mouse("mouseReleased", x, y)

    def drag(self, start: tuple[float, float], by: tuple[float, float]) -> None:
        x, y = start
        self._mouse("mouseMoved", x, y)
        self._mouse("mousePressed", x, y)
        for fraction in (0.25, 0.5, 0.75, 1.0):
            self._mouse("mouseMoved", x + fraction * by[0], y + fraction * by[1])
        self._mouse("mouseReleased", x + by[0], y + by[1])

    def wheel(self, at: tuple[float, float], down: float) -> None:
        self._send("Input.dispatchMouseEvent", type="mouseWheel", x=at[0], y=at[1], deltaX=0, deltaY=down)

    def type(self, text: str) -> None:
        for character in text:
            self.press(character)

    def press(self, key: str, held: str = "") -> None:
        """Press and release a key while the modifier `held`, if any, is down."""
        text = "\r" if key == "Enter" else key if len(key) == 1 and not held else ""
        params = {
            "key": key,
            "modifiers": MODIFIERS.get(held, 0),
            "windowsVirtualKeyCode": key_code(key),
            **({"commands": ["selectAll"]} if (held, key) == ("Control", "a") else {}),
        }
        self._send("Input.dispatchKeyEvent", type="keyDown" if text else "rawKeyDown", text=text, **params)
        self._send("Input.dispatchKeyEvent", type="keyUp", **params)

    def close(self) -> None:
        self._tabs._tools.call(BROWSER, "Target.closeTarget", {"targetId": self._tabs._tab(TAB).target}, timeout_s=5.0)

    def _mouse(self, kind: str, x: float, y: float) -> None:
        self._send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)

    def _send(self, method: str, **params: Any) -> None:
        self._tabs._tools.call(self._tabs._tab(TAB).session, method, params, timeout_s=5.0)
