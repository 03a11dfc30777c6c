"""A fake browser in which pages do not open and episodes are lost."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from browser_farm.fake import FakeFarm
from giirl_core.types import Command, EpisodeSpec, Observation, StepResult

Fault = Callable[[EpisodeSpec], bool]


class FaultyFarm(FakeFarm):
    """The pages for which `closed` is true do not open, those for which `lost` is true are lost in every step."""

    def __init__(self, *, tabs: int, closed: Fault = lambda spec: False, lost: Fault = lambda spec: False) -> None:
        super().__init__(tabs=tabs)
        self._closed, self._lost = closed, lost

    def reset(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]:
        self.unopened.clear()
        return super().reset({tab: spec for tab, spec in episodes.items() if self._opens(tab, spec)})

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
        self.unopened.clear()
        lost = {tab for tab in commands if self._lost(self._open[tab].episode)}
        results = super().step(commands)
        for tab, result in results.items():
            following = commands[tab].following
            if tab in lost:
                results[tab] = result = replace(result, raw_reward=0.0, lost="page_hung")
            over = result.lost or result.done or commands[tab].last
            if over and following is not None and not self._opens(tab, following):
                results[tab] = replace(result, observation=None)
        return results

    def _opens(self, tab: int, spec: EpisodeSpec) -> bool:
        closed = self._closed(spec)
        if closed:
            self.unopened[tab] = f"{spec.task} does not open"
        return not closed
