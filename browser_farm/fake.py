"""A fake browser: four tasks generated in Python behind the `Browser` protocol. For tests, never for results."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from giirl_core.types import Command, EpisodeSpec, Goal, Observation, Page, StepResult, Verb

LABELS = ("submit", "okay", "ok", "yes", "no", "cancel", "next", "previous")
FILLER_WORDS = ("lorem", "ipsum", "dolor", "amet", "elit", "magna", "purus", "tellus", "sapien", "nibh")
NAMES = ("Ada", "Bertram", "Clotilde", "Dorinda", "Emil", "Fausta", "Gregor", "Hedda", "Ignatz", "Jolanda")


@dataclass(frozen=True, slots=True)
class Row:
    """One element of a fake page. Clicking it ends the episode with `reward`, or does nothing when that is None."""

    tag: str
    text: str = ""
    value: str = ""
    reward: float | None = None
    tampered: bool = False
    focused: bool = False


@dataclass(slots=True)
class FakeTab:
    """The state of one tab."""

    episode: EpisodeSpec
    goal: Goal
    rows: list[Row]
    wanted: str = ""  # the text that the field must hold when Submit is clicked
    boxes: np.ndarray[tuple[int, int], np.dtype[np.float32]] | None = None


def _click_test(rng: np.random.Generator) -> tuple[str, list[Row], str]:
    return "Click the button.", [Row("button", "Click Me!", reward=1.0)], ""


def _click_test_2(rng: np.random.Generator) -> tuple[str, list[Row], str]:
    return "Click button ONE.", [Row("button", "ONE", reward=1.0), Row("button", "TWO", reward=-1.0)], ""


def _click_button(rng: np.random.Generator) -> tuple[str, list[Row], str]:
    rows = [_filler(rng) for _ in range(6)]
    if all(row.tag != "button" for row in rows):
        rows[-1] = Row("button", _label(rng))
    texts = [row.text for row in rows if row.tag == "button"]
    wanted = texts[rng.integers(len(texts))]
    rows = [replace(row, reward=1.0 if row.text == wanted else -1.0) if row.tag == "button" else row for row in rows]
    return f'Click on the "{wanted}" button.', rows, ""


def _enter_text(rng: np.random.Generator) -> tuple[str, list[Row], str]:
    name = NAMES[rng.integers(len(NAMES))]
    rows = [Row("input_text"), Row("button", "Submit", reward=-1.0)]
    return f'Enter "{name}" into the text field and press Submit.', rows, name


def _filler(rng: np.random.Generator) -> Row:
    """A random element: text, an input or a button."""
    kind = rng.random()
    if kind < 1 / 3:
        return Row("div", " ".join(rng.choice(FILLER_WORDS, 3)))
    return Row("input_text") if kind < 2 / 3 else Row("button", _label(rng))


def _label(rng: np.random.Generator) -> str:
    label = LABELS[rng.integers(len(LABELS))]
    return label.capitalize() if rng.random() < 0.5 else label


TASKS: dict[str, Callable[[np.random.Generator], tuple[str, list[Row], str]]] = {
    "click-test": _click_test,
    "click-test-2": _click_test_2,
    "click-button": _click_button,
    "enter-text": _enter_text,
}


class FakeFarm:
    """Implements `giirl_core.types.Browser` without a browser. The same task and seed give the same page."""

    def __init__(self, *, tabs: int = 8) -> None:
        self.tabs = tabs
        self._open: dict[int, FakeTab] = {}

    def reset(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]:
        for tab, episode in episodes.items():
            self._open[tab] = _generate(episode)
        return {tab: _observe(self._open[tab]) for tab in episodes}

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
        return {tab: self._step(tab, command) for tab, command in commands.items()}

    def _step(self, tab: int, command: Command) -> StepResult:
        reward = _act(self._open[tab], command)
        done = reward is not None
        if done or command.last:
            if command.following is None:
                return StepResult(raw_reward=reward or 0.0, done=done, observation=None)
            self._open[tab] = _generate(command.following)
        return StepResult(raw_reward=reward or 0.0, done=done, observation=_observe(self._open[tab]))

    def screenshot(self, tab: int, box: tuple[float, float, float, float], *, scale: float = 1.0) -> bytes:
        """The fake browser has no screenshots."""
        return b""

    def close(self) -> None:
        self._open.clear()


def check_task(task: str) -> None:
    """Raise ValueError when the fake browser has no such task."""
    if task not in TASKS:
        raise ValueError(f"the fake browser has no task {task!r}: it has {', '.join(TASKS)}")


def _generate(episode: EpisodeSpec) -> FakeTab:
    """The page of an episode; ValueError when there is no such task."""
    check_task(episode.task)
    rng = np.random.default_rng(episode.seed)
    utterance, rows, wanted = TASKS[episode.task](rng)
    boxes = np.stack(
        [
            rng.uniform(2, 60, len(rows)),
            50 + np.arange(len(rows)) * 20 + rng.uniform(0, 8, len(rows)),
            rng.uniform(40, 100, len(rows)),
            np.full(len(rows), 18.0),
        ],
        axis=1,
    ).astype(np.float32)
    return FakeTab(episode, Goal(utterance), rows, wanted, boxes)


def _act(tab: FakeTab, command: Command) -> float | None:
    """Execute the command; returns the page's reward if that ends the episode, else None."""
    if not 0 <= command.ref < len(tab.rows):
        return None
    row = tab.rows[command.ref]
    if command.verb is Verb.CLICK and row.reward is not None:
        values = {other.value for other in tab.rows if other.tag == "input_text"}
        return 1.0 if tab.wanted and tab.wanted in values else row.reward
    typed = command.verb is Verb.TYPE and row.tag == "input_text"
    tab.rows = [replace(other, focused=False) for other in tab.rows]
    tab.rows[command.ref] = replace(row, value=command.text if typed else row.value, tampered=True, focused=True)
    return None


def _observe(tab: FakeTab) -> Observation:
    rows, boxes = tab.rows, tab.boxes
    assert boxes is not None
    page = Page(
        tag=tuple(row.tag for row in rows),
        text=tuple(row.text for row in rows),
        value=tuple(row.value for row in rows),
        classes=("",) * len(rows),
        ref=np.arange(len(rows), dtype=np.int32),
        parent=np.full(len(rows), -1, dtype=np.int16),
        box=boxes,
        focused=np.array([row.focused for row in rows]),
        tampered=np.array([row.tampered for row in rows]),
    )
    return Observation(episode=tab.episode, page=page, goal=tab.goal)
