"""The page of giirl feedback in real Chrome: by keyboard, on a phone, with hostile text, and recording a person."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from browser_farm.chrome.devtools import BROWSER, DevTools, Json, browser_url
from browser_farm.chrome.launcher import Chrome
from browser_farm.human.recorder import Recorder
from giirl.feedback.stage import Stage
from giirl_core.types import Episode, EpisodeSpec
from giirl_core.wire.answers import RIGHT, read_answer
from tests.browser_farm.hand import Hand
from tests.giirl.feedback.examples import DEADLINE_S, Served, clicking, serving, typing

pytestmark = [pytest.mark.chrome, pytest.mark.timeout(300)]

WIDTHS = (360, 1200)
HOSTILE = "</text></svg><script>document.title='owned'</script><img src=x onerror=alert(1)> \"'&lt; " + "long" * 60
LAYOUT = """JSON.stringify({
  wider: document.documentElement.scrollWidth - document.documentElement.clientWidth,
  title: document.title,
  scripts: document.scripts.length,
  images: document.images.length,
  nameless: [...document.querySelectorAll('button, input:not([type=hidden]), a')].filter(
    (one) => !(one.innerText || one.labels && [...one.labels].map((label) => label.innerText).join('')).trim()).length,
  small: [...document.querySelectorAll('button')].filter((one) => one.getBoundingClientRect().height < 32).length,
})"""


class Window:
    """One tab of the Chrome of a person who has only a keyboard."""

    def __init__(self, tools: DevTools, console: list[str]) -> None:
        self._tools, self.console = tools, console
        target = tools.call(BROWSER, "Target.createTarget", {"url": "about:blank"}, timeout_s=DEADLINE_S)["targetId"]
        attach = {"targetId": target, "flatten": True}
        self.session = tools.call(BROWSER, "Target.attachToTarget", attach, timeout_s=DEADLINE_S)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")
        self.call("Emulation.setFocusEmulationEnabled", enabled=True)

    def call(self, method: str, **params: Any) -> Json:
        return self._tools.call(self.session, method, params, timeout_s=DEADLINE_S)

    def open(self, url: str, *, width: int = 1200) -> None:
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=False)
        self.call("Page.navigate", url=url)
        self.until("document.readyState === 'complete'")

    def read(self, expression: str) -> Any:
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def until(self, expression: str) -> None:
        deadline_s = time.monotonic() + DEADLINE_S
        while not self.read(expression):
            assert time.monotonic() < deadline_s, (expression, self.read("document.body.innerText"))
            time.sleep(0.02)

    def until_text(self, words: str) -> None:
        self.until(f"document.readyState === 'complete' && document.body.innerText.includes({json.dumps(words)})")

    def until_asked(self, key: str) -> None:
        self.until(
            f"document.readyState === 'complete' && document.querySelector('[name=key]')?.value === {json.dumps(key)}"
        )

    def press(self, key: str) -> None:
        code = {"Tab": 9, "Enter": 13, "Escape": 27}.get(key, ord(key[0].upper()))
        text = {"Enter": "\r"}.get(key, key if len(key) == 1 else "")
        named = {"key": key, "windowsVirtualKeyCode": code, **({"text": text} if text else {})}
        self.call("Input.dispatchKeyEvent", type="keyDown", **named)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key, windowsVirtualKeyCode=code)

    def write(self, text: str) -> None:
        self.call("Input.insertText", text=text)


@pytest.fixture(scope="module")
def open_window() -> Iterator[Callable[[], Window]]:
    flags = ["--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"]  # anything but the server is not found
    chrome = Chrome(headless=True, sandbox="auto", timeout_s=60.0, extra_flags=flags)
    console: list[str] = []

    def on_event(session: str, method: str, params: Json) -> None:
        if method in ("Log.entryAdded", "Runtime.consoleAPICalled", "Runtime.exceptionThrown"):
            console.append(json.dumps(params))

    try:
        tools = DevTools(browser_url(chrome.debugger_address, timeout_s=60.0), timeout_s=DEADLINE_S, on_event=on_event)
        yield lambda: Window(tools, console)
        tools.close()
    finally:
        chrome.end()


@pytest.fixture
def window(open_window: Callable[[], Window]) -> Window:
    return open_window()


def first(served: Served, window: Window, *, width: int = 1200) -> None:
    window.open(served.url, width=width)
    window.until_text("Did the policy do this")


def test_episodes_are_answered_with_the_keyboard_alone(window: Window, tmp_path: Path) -> None:
    right, wrong, other, skipped = clicking(1), clicking(2, steps=3), typing(3), clicking(4)
    with serving(tmp_path / "feedback", right, wrong, other, skipped) as served:
        first(served, window)
        window.press("r")
        window.until_text("Answers so far: 1")
        window.press("2")
        window.press("w")
        window.until_text("Answers so far: 2")
        window.press("g")
        window.write("write Ada")  # W and R are letters here
        window.press("Enter")
        window.until_text("Answers so far: 3")
        window.press("s")
        window.until_text("The policy plays the next episodes")
        assert served.desk.answers == 3
    found = {key: read_answer(tmp_path / "feedback" / key) for key in (right.key, wrong.key, other.key)}
    assert [answer.wrong_from for answer in found.values()] == [RIGHT, 1, 1]
    assert [one.goal.utterance for one in found[other.key].demonstrations] == ["write Ada"]
    assert window.console == []


def test_the_answer_before_is_changed_with_the_keyboard(window: Window, tmp_path: Path) -> None:
    one, two = clicking(1), clicking(2)
    with serving(tmp_path / "feedback", one, two) as served:
        first(served, window)
        window.press("r")
        window.until_text("Answers so far: 1")
        window.press("c")
        window.until_asked(one.key)
        window.press("w")
        window.until_asked(two.key)
        assert served.desk.answers == 1
    assert read_answer(tmp_path / "feedback" / one.key).wrong_from == 1


def test_every_control_is_reached_with_tab(window: Window, tmp_path: Path) -> None:
    with serving(tmp_path / "feedback", clicking(1)) as served:
        first(served, window)
        reached = []
        for _ in range(8):
            window.press("Tab")
            reached.append(window.read("(document.activeElement.dataset.key || document.activeElement.className)"))
    assert reached[:7] == ["film ask", "1", "R", "W", "T", "S", "G"]


@pytest.mark.parametrize("width", WIDTHS)
def test_hostile_text_is_text_and_nothing_is_wider_than_the_window(width: int, window: Window, tmp_path: Path) -> None:
    hostile = clicking(1, steps=4, text=HOSTILE)
    with serving(tmp_path / "feedback", hostile) as served:
        first(served, window, width=width)
        window.press("9")  # no such step: nothing happens
        for page in ("asked", "refused"):
            found = json.loads(window.read(LAYOUT))
            assert found == {
                "wider": 0,
                "title": "test: feedback",
                "scripts": 1,
                "images": 0,
                "nameless": 0,
                "small": 0,
            }, page
            window.read(f"document.querySelector('[name=right_for]').value = {json.dumps(HOSTILE[:900])}")
            window.read("[...document.querySelectorAll('[name=step]')].forEach((one) => { one.value = 9; })")
            window.press("1")
            window.press("w")
            window.until_text("is marked as wrong")
    # The last page may still load when its server ends.
    assert all("422" in line or "ERR_CONNECTION_REFUSED" in line for line in window.console), window.console
    window.console.clear()


def test_two_windows_at_once_answer_different_episodes(open_window: Callable[[], Window], tmp_path: Path) -> None:
    one, two = clicking(1), clicking(2)
    with serving(tmp_path / "feedback", one, two) as served:
        left, right = open_window(), open_window()
        keys = []
        for each in (left, right):
            first(served, each)
            keys.append(each.read("document.querySelector('[name=key]').value"))
        assert keys == [one.key, two.key]
        for each in (left, right):
            each.press("r")
        for each in (left, right):
            each.until_text("The policy plays the next episodes")
    assert sorted(path.name for path in (tmp_path / "feedback").iterdir()) == [one.key, two.key]


def test_a_restart_loses_no_answer_and_an_old_window_says_that_it_is_gone(window: Window, tmp_path: Path) -> None:
    one, two = clicking(1), clicking(2)
    with serving(tmp_path / "feedback", one, two) as served:
        first(served, window)
        window.press("r")
        window.until_text("Answers so far: 1")
    with serving(tmp_path / "feedback", two) as served:
        first(served, window)
        window.until_text("Answers so far: 1")
        window.press("w")
        window.until_text("Answers so far: 2")
    assert read_answer(tmp_path / "feedback" / one.key).wrong_from == RIGHT
    assert read_answer(tmp_path / "feedback" / two.key).wrong_from == 1


def any_task(task: str) -> None:
    """Every task can be shown."""


class Shower:
    """A Recorder in whose window a hand does what a person would do."""

    def __init__(self) -> None:
        self._recorder = Recorder(headless=True)

    def record(self, spec: EpisodeSpec, show_instruction: Callable[[str], None]) -> Episode | None:
        hand = Hand(self._recorder)
        return self._recorder.record(spec, lambda goal: hand.click("button", goal.split('"')[1]))

    def close(self) -> None:
        self._recorder.close()


@pytest.mark.slow
def test_a_person_takes_over_and_shows_the_right_way_in_a_window(window: Window, tmp_path: Path) -> None:
    with serving(tmp_path / "feedback", one := clicking(1), stage=Stage(lambda task: Shower(), any_task)) as served:
        first(served, window)
        window.press("t")
        window.until_text("You showed this way")
        window.press("k")
        window.until_text("Answers so far: 1")
    answer = read_answer(tmp_path / "feedback" / one.key)
    assert answer.shown is not None
    assert answer.shown.seed == 1
    assert len(answer.demonstrations) == 1


@pytest.mark.slow
def test_the_window_closes_when_the_person_cancels(window: Window, tmp_path: Path) -> None:
    stage = Stage(lambda task: Recorder(headless=True), any_task)
    with serving(tmp_path / "feedback", clicking(1), stage=stage) as served:
        first(served, window)
        window.press("t")
        window.until_text("A Chrome window shows the page")
        window.press("x")
        window.until_text("Did the policy do this")
        stage.close()
    assert not (tmp_path / "feedback").exists()
