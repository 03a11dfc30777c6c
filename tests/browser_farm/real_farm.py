"""A farm with a real Chrome, and what tests say to it."""

from __future__ import annotations

from pathlib import Path

from browser_farm.chrome import reaper
from browser_farm.farm import ChromeFarm
from giirl_core.types import Command, EpisodeSpec, Observation, Verb


class Farm:
    """A farm and the causes that it has told so far."""

    def __init__(self, *, trusted: bool = False) -> None:
        self.causes: list[str] = []
        self.chrome = ChromeFarm(tabs=3, call_timeout_s=4.0, trusted=trusted, on_restart=self.causes.append)

    def open(self, task: str, *seeds: int) -> dict[int, Observation]:
        return self.chrome.reset({tab: EpisodeSpec(task=task, seed=seed) for tab, seed in enumerate(seeds)})

    def run(self, tab: int, script: str) -> None:
        self.ask(tab, f"{script};'ok'")

    def ask(self, tab: int, expression: str) -> str:
        answer = self.chrome._tabs.evaluate({tab: expression})[tab]
        assert isinstance(answer, str), answer
        return answer

    def on_click(self, tab: int, script: str) -> None:
        self.run(tab, f"document.body.addEventListener('mousedown', () => {{ {script} }}, {{once: true}})")

    def pids(self) -> set[int]:
        return reaper.processes(Path(self.chrome.chrome_directory))


def click(observation: Observation, row: int, *, seed: int | None = 900, last: bool = False) -> Command:
    task = observation.episode.task
    following = None if seed is None else EpisodeSpec(task=task, seed=seed)
    ref = int(observation.page.ref[row])
    return Command(verb=Verb.CLICK, ref=ref, last=last, following=following)


def seen(observation: Observation | None) -> tuple[object, ...]:
    assert observation is not None
    page = observation.page
    strings = (observation.goal.utterance, page.tag, page.text, page.value, page.classes, page.colour, page.shape)
    arrays = (page.ref, page.parent, page.box, page.focused, page.tampered)
    return (*strings, *(array.tobytes() for array in arrays))
