"""The two sides of the farm's benchmark: ours, and the miniwob package's environment, played by the same experts."""

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

FIRST_SEED = 1 << 40  # far from the pages of everybody else
CLICK_ELEMENT, FOCUS_AND_TYPE = 8, 12  # of the package's preset "all_supported"


@dataclass(kw_only=True)
class Played:
    """What some seconds of play came to. Time and CPU are those of the environment; an expert's are left out."""

    steps: int = 0
    episodes: int = 0
    successes: int = 0
    wall_s: float = 0.0
    cpu_s: float = 0.0

    def add(self, other: Played) -> None:
        for name in ("steps", "episodes", "successes", "wall_s", "cpu_s"):
            setattr(self, name, getattr(self, name) + getattr(other, name))


def cpu_s(pids: set[int]) -> dict[int, float]:
    """CPU seconds that each process has used."""
    used = {}
    for pid in pids:
        try:
            times = psutil.Process(pid).cpu_times()
        except psutil.NoSuchProcess:
            continue
        used[pid] = times.user + times.system
    return used


def pss_mb(pids: set[int]) -> float:
    """Memory of these processes in MB; what several share is counted once."""
    total_kb = 0
    for pid in pids:
        try:
            lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
        except OSError:
            continue
        total_kb += sum(int(line.split()[1]) for line in lines if line.startswith("Pss:"))
    return total_kb / 1024


class Meter:
    """Adds up what the environment takes, in this process and in its browser."""

    def __init__(self, pids: Callable[[], set[int]]) -> None:
        self._pids = pids
        self._before = cpu_s(pids())
        self.wall_s = 0.0
        self._own_s = 0.0

    def __call__(self, call: Callable[..., Any], *given: Any, **named: Any) -> Any:
        wall, own = time.perf_counter(), time.process_time()
        answer = call(*given, **named)
        self.wall_s += time.perf_counter() - wall
        self._own_s += time.process_time() - own
        return answer

    @property
    def cpu_s(self) -> float:
        after = cpu_s(self._pids())
        return self._own_s + sum(used - self._before.get(pid, 0.0) for pid, used in after.items())


class FarmSide:
    """Our farm, all of its tabs at once."""

    def __init__(self, tabs: int) -> None:
        self.tabs = tabs
        self.farm = ChromeFarm(tabs=tabs)

    def pids(self) -> set[int]:
        return reaper.processes(Path(self.farm.chrome_directory))

    def play(self, task: str, seconds: float, seeds: Iterator[int]) -> Played:
        choose, played, meter = expert(task), Played(), Meter(self.pids)
        first = {tab: EpisodeSpec(task=task, seed=next(seeds)) for tab in range(self.tabs)}
        shown: dict[int, Observation] = meter(self.farm.reset, first)
        while meter.wall_s < seconds:
            commands = {
                tab: Command.of(choose(seen), seen, following=EpisodeSpec(task=task, seed=next(seeds)))
                for tab, seen in shown.items()
            }
            for tab, result in meter(self.farm.step, commands).items():
                if result.lost:
                    raise RuntimeError(f"tab {tab} was lost while nothing was wrong: {result.lost}")
                played.steps += 1
                played.episodes += result.done
                played.successes += result.done and result.raw_reward == 1.0
                shown[tab] = result.observation
        played.wall_s, played.cpu_s = meter.wall_s, meter.cpu_s
        return played

    def close(self) -> None:
        self.farm.close()


class PackageSide:
    """One environment of the miniwob package, as it comes or without screenshots."""

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

    def play(self, task: str, seconds: float, seeds: Iterator[int]) -> Played:
        choose, played = expert(task), Played()
        if self._driver is None:
            self._env.reset(seed=0, options={"record_screenshots": self._screenshots})
            self._driver = self._env.unwrapped.instance.driver.service.process.pid  # type: ignore[attr-defined]
        meter = Meter(self.pids)
        while meter.wall_s < seconds:
            spec = EpisodeSpec(task=task, seed=next(seeds))
            observed, _ = meter(self._env.reset, seed=spec.seed)
            done = False
            while not done:
                seen = _as_ours(spec, observed)
                action = _in_the_packages_words(choose(seen), seen, self._env.action_space)
                observed, _, done, _, info = meter(self._env.step, action)
                played.steps += 1
            played.episodes += 1
            played.successes += info["raw_reward"] == 1.0
        played.wall_s, played.cpu_s = meter.wall_s, meter.cpu_s
        return played

    def close(self) -> None:
        self._env.close()


def _as_ours(spec: EpisodeSpec, observed: dict[str, Any]) -> Observation:
    """The package's observation in the form that experts read."""
    elements = [e for e in observed["dom_elements"] if e["tag"] not in ("body", "br") and e["id"] != "wrap"]
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
    return Observation(episode=spec, page=page, goal=Goal(observed["utterance"]))


def _value(element: dict[str, Any]) -> str:
    if element["tag"] in ("input_checkbox", "input_radio"):
        return "checked" if element["value"] == "True" else ""
    return str(element["value"])


def _in_the_packages_words(action: Action, seen: Observation, space: Any) -> dict[str, Any]:
    if action.verb not in (Verb.CLICK, Verb.TYPE):
        raise ValueError(f"the benchmark's tasks need clicks and typing alone, got {action.verb.name}")
    said: dict[str, Any] = space.sample()
    said["ref"] = int(seen.page.ref[action.element])
    said["action_type"] = CLICK_ELEMENT if action.verb is Verb.CLICK else FOCUS_AND_TYPE
    said["text"] = action.text(seen.goal)
    return said
