"""The two sides of the farm benchmark: our farm and the miniwob package's environment, played by the same experts."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import psutil

from browser_farm.chrome import launcher, reaper
from browser_farm.experts import expert
from browser_farm.farm import ChromeFarm
from giirl_core.types import Action, Command, EpisodeSpec, Goal, Observation, Page, Verb

FIRST_SEED = 1 << 40  # far from the seeds used elsewhere
CLICK_ELEMENT, FOCUS_AND_TYPE = 8, 12  # action types in the package's preset "all_supported"


@dataclass(kw_only=True)
class PlayStats:
    """Statistics of some seconds of play. Wall and CPU time are those of the environment, without the expert."""

    steps: int = 0
    episodes: int = 0
    successes: int = 0
    wall_s: float = 0.0
    cpu_s: float = 0.0

    def add(self, other: PlayStats) -> None:
        """Add the numbers of another turn."""
        for name in ("steps", "episodes", "successes", "wall_s", "cpu_s"):
            setattr(self, name, getattr(self, name) + getattr(other, name))


def cpu_s(pids: set[int]) -> dict[int, float]:
    """CPU seconds used so far by each process that still exists."""
    used = {}
    for pid in pids:
        try:
            times = psutil.Process(pid).cpu_times()
        except psutil.NoSuchProcess:
            continue
        used[pid] = times.user + times.system
    return used


def pss_mb(pids: set[int]) -> float:
    """Proportional set size of these processes in MB: shared memory is counted once."""
    total_kb = 0
    for pid in pids:
        try:
            lines = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="utf-8").splitlines()
        except OSError:
            continue
        total_kb += sum(int(line.split()[1]) for line in lines if line.startswith("Pss:"))
    return total_kb / 1024


class Meter:
    """Measures wall and CPU time of calls to an environment, in this process and in its browser."""

    def __init__(self, pids: Callable[[], set[int]]) -> None:
        self._pids = pids
        self._before = cpu_s(pids())
        self.wall_s = 0.0
        self._own_s = 0.0

    def __call__(self, call: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Make a call and add its time."""
        wall, own = time.perf_counter(), time.process_time()
        result = call(*args, **kwargs)
        self.wall_s += time.perf_counter() - wall
        self._own_s += time.process_time() - own
        return result

    @property
    def cpu_s(self) -> float:
        """CPU seconds of the calls so far."""
        after = cpu_s(self._pids())
        return self._own_s + sum(used - self._before.get(pid, 0.0) for pid, used in after.items())


class FarmSide:
    """Our farm with all of its tabs."""

    def __init__(self, tabs: int) -> None:
        self.tabs = tabs
        self.farm = ChromeFarm(tabs=tabs)

    def pids(self) -> set[int]:
        return reaper.processes(Path(self.farm.chrome_directory))

    def play(self, task: str, seconds: float, seeds: Iterator[int]) -> PlayStats:
        act, stats, meter = expert(task), PlayStats(), Meter(self.pids)
        first = {tab: EpisodeSpec(task=task, seed=next(seeds)) for tab in range(self.tabs)}
        observations: dict[int, Observation] = meter(self.farm.reset, first)
        while meter.wall_s < seconds:
            commands = {
                tab: Command.of(act(observation), observation, following=EpisodeSpec(task=task, seed=next(seeds)))
                for tab, observation in observations.items()
            }
            for tab, result in meter(self.farm.step, commands).items():
                if result.lost:
                    raise RuntimeError(f"the farm lost tab {tab}: {result.lost}, wanted a run without faults")
                stats.steps += 1
                stats.episodes += result.done
                stats.successes += result.done and result.raw_reward == 1.0
                observations[tab] = result.observation
        stats.wall_s, stats.cpu_s = meter.wall_s, meter.cpu_s
        return stats

    def close(self) -> None:
        self.farm.close()


class PackageSide:
    """One environment of the miniwob package, with or without screenshots."""

    def __init__(self, task: str, *, screenshots: bool) -> None:
        import miniwob

        os.environ["MINIWOB_CHROME_BINARY"] = str(launcher.find("GIIRL_CHROME", launcher.CHROMES, "Chrome"))
        os.environ["MINIWOB_CHROMEDRIVER"] = str(launcher.find("GIIRL_CHROMEDRIVER", launcher.DRIVERS, "chromedriver"))
        gymnasium.register_envs(miniwob)
        self._env = gymnasium.make(f"miniwob/{task}-v1", disable_env_checker=True)
        self._screenshots = screenshots
        self._driver: int | None = None

    def pids(self) -> set[int]:
        if self._driver is None:
            return set()
        process = psutil.Process(self._driver)
        return {self._driver, *(child.pid for child in process.children(recursive=True))}

    def play(self, task: str, seconds: float, seeds: Iterator[int]) -> PlayStats:
        act, stats = expert(task), PlayStats()
        if self._driver is None:
            self._env.reset(seed=0, options={"record_screenshots": self._screenshots})
            self._driver = self._env.unwrapped.instance.driver.service.process.pid  # type: ignore[attr-defined]
        meter = Meter(self.pids)
        while meter.wall_s < seconds:
            spec = EpisodeSpec(task=task, seed=next(seeds))
            raw, _ = meter(self._env.reset, seed=spec.seed)
            done = False
            while not done:
                observation = _observation(spec, raw)
                action = _package_action(act(observation), observation, self._env.action_space)
                raw, _, done, _, info = meter(self._env.step, action)
                stats.steps += 1
            stats.episodes += 1
            stats.successes += info["raw_reward"] == 1.0
        stats.wall_s, stats.cpu_s = meter.wall_s, meter.cpu_s
        return stats

    def close(self) -> None:
        self._env.close()


def _observation(spec: EpisodeSpec, raw: dict[str, Any]) -> Observation:
    """Convert the package's observation to the one that experts get."""
    elements = [e for e in raw["dom_elements"] if e["tag"] not in ("body", "br") and e["id"] != "wrap"]
    row_of = {e["ref"]: row for row, e in enumerate(elements)}
    count = len(elements)
    page = Page(
        tag=tuple(e["tag"] for e in elements),
        text=tuple(" ".join(e["text"].split()) for e in elements),
        value=tuple(_value(e) for e in elements),
        classes=tuple(e["classes"] for e in elements),
        ref=np.array([e["ref"] for e in elements], dtype=np.int32),
        parent=np.array([row_of.get(e["parent"], -1) for e in elements], dtype=np.int16),
        box=np.array([[e[n][0] for n in ("left", "top", "width", "height")] for e in elements], np.float32).reshape(
            count, 4
        ),
        focused=np.array([e["flags"][0] for e in elements], dtype=np.bool_),
        tampered=np.array([e["flags"][1] for e in elements], dtype=np.bool_),
    )
    return Observation(episode=spec, page=page, goal=Goal(raw["utterance"]))


def _value(element: dict[str, Any]) -> str:
    if element["tag"] in ("input_checkbox", "input_radio"):
        return "checked" if element["value"] == "True" else ""
    return str(element["value"])


def _package_action(action: Action, observation: Observation, space: Any) -> dict[str, Any]:
    """Convert an action to the package's format. ValueError for verbs other than CLICK and TYPE."""
    if action.verb not in (Verb.CLICK, Verb.TYPE):
        raise ValueError(f"the expert's action is {action.verb.name}, wanted CLICK or TYPE")
    converted: dict[str, Any] = space.sample()
    converted["ref"] = int(observation.page.ref[action.element])
    converted["action_type"] = CLICK_ELEMENT if action.verb is Verb.CLICK else FOCUS_AND_TYPE
    converted["text"] = action.text(observation.goal)
    return converted
