"""A farm with a real Chrome, and helpers for its tests."""

from __future__ import annotations

from pathlib import Path

from browser_farm.chrome import reaper
from browser_farm.farm import ChromeFarm
from giirl_core.types import Command, EpisodeSpec, Observation, Verb


class Farm:
    """A farm of three tabs, and the causes that it has passed to `on_restart`."""

    def __init__(self, *, trusted: bool = False) -> None:
        self.causes: list[str] = []
        self.chrome = ChromeFarm(tabs=3, call_timeout_s=4.0, trusted=trusted, on_restart=self.causes.append)

    def open(self, task: str, *seeds: int) -> dict[int, Observation]:
        return self.chrome.reset({tab: EpisodeSpec(task=task, seed=seed) for tab, seed in enumerate(seeds)})

    def run(self, tab: int, script: str) -> None:
        """Run a script in a tab."""
        self.ask(tab, f"{script};'ok'")

    def ask(self, tab: int, expression: str) -> str:
        """The string that a JavaScript expression returns in a tab."""
        answer = self.chrome._tabs.evaluate({tab: expression})[tab]
        assert isinstance(answer, str), answer
        return answer

    def on_click(self, tab: int, script: str) -> None:
        """Let the next click in a tab run a script."""
        self.run(tab, f"document.body.addEventListener('mousedown', () => {{ {script} }}, {{once: true}})")

    def pids(self) -> set[int]:
        return reaper.processes(Path(self.chrome.chrome_directory))


def click(observation: Observation, row: int, *, seed: int | None = 900, last: bool = False) -> Command:
    """Click a row; an episode of the same task with this seed follows."""
    task = observation.episode.task
    following = None if seed is None else EpisodeSpec(task=task, seed=seed)
    ref = int(observation.page.ref[row])
    return Command(verb=Verb.CLICK, ref=ref, last=last, following=following)


def content(observation: Observation | None) -> tuple[object, ...]:
    """Everything in an observation except its episode, comparable with ==."""
    assert observation is not None
    page = observation.page
    strings = (page.tag, page.text, page.value, page.classes, page.colour, page.shape, page.attributes)
    arrays = (page.ref, page.parent, page.box, page.focused, page.tampered)
    return (observation.goal.utterance, *strings, *(array.tobytes() for array in arrays))
