"""Soak test of the farm: many episodes on many tasks, with injected faults.

    python benchmarks/soak_farm.py [--episodes 24000] [--every 500] [--tabs 8] [--json FILE]

After every 500 (--every) episodes one fault is injected, in turn: an infinite loop in a page, a crashed tab, an alert,
a page that navigates away, a killed browser, a killed chromedriver, a stopped browser. The farm has recovered when
every tab has made a step again. In one episode of eight the reward is compared with the page's own, read without the
farm. Exit status 1 if a reward is wrong, a recovery is slow, or memory grows.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import signal
import statistics
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from benchmarks.sides import FIRST_SEED
from browser_farm.chrome import reaper
from browser_farm.experts import expert
from browser_farm.farm import ChromeFarm
from giirl_core.files import writable, write_json
from giirl_core.progress import Display
from giirl_core.types import Command, EpisodeSpec, Observation

TASKS = (
    "click-test",
    "click-test-2",
    "click-button",
    "click-button-sequence",
    "click-checkboxes",
    "click-checkboxes-large",
    "click-collapsible",
    "click-color",
    "click-dialog",
    "click-link",
    "click-option",
    "click-tab",
    "click-widget",
    "email-inbox",
    "enter-password",
    "enter-text",
    "focus-text",
    "login-user",
    "search-engine",
    "social-media",
)
EPISODES_PER_TASK = 25  # consecutive episodes of one task in one tab
CHECK_ONE_IN = 8
STEP_LIMIT = 30
CALL_TIMEOUT_S = 1.5
MAX_RECOVERY_S = 5.0
MAX_MEMORY_GROWTH = 1.10  # ratio


@dataclass(kw_only=True)
class TabState:
    """The episode of one tab, and the number of episodes it has ended."""

    episode: EpisodeSpec
    observation: Observation | None = None
    steps: int = 0
    ended: int = 0


@dataclass(kw_only=True)
class Soak:
    """One run: the state of every tab, and the results so far."""

    farm: ChromeFarm
    causes: Counter[str]
    states: dict[int, TabState] = field(default_factory=dict)
    outcomes: Counter[str] = field(default_factory=Counter)
    checked: int = 0
    wrong: list[str] = field(default_factory=list)
    faults: list[dict[str, Any]] = field(default_factory=list)
    rss_mb: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._seeds = itertools.count(FIRST_SEED << 1)
        self._tasks = itertools.cycle(TASKS)
        for tab in range(self.farm.tabs):
            self.states[tab] = TabState(episode=EpisodeSpec(task=next(self._tasks), seed=next(self._seeds)))

    def pids(self) -> set[int]:
        """The processes of the browser and its driver."""
        return reaper.processes(Path(self.farm.chrome_directory))

    def record_memory(self) -> None:
        """Record the resident memory of this process and of all its children."""
        total = 0
        for pid in {os.getpid(), *self.pids()}:
            try:
                total += psutil.Process(pid).memory_info().rss
            except psutil.NoSuchProcess:
                continue
        self.rss_mb.append(total / 1e6)

    def step(self) -> int:
        """Make one step in every tab. Returns the number of episodes that ended."""
        unopened = {tab: state.episode for tab, state in self.states.items() if state.observation is None}
        if unopened:
            for tab, observation in self.farm.reset(unopened).items():
                self.states[tab].observation, self.states[tab].steps = observation, 0
        commands = {tab: self._command(state) for tab, state in self.states.items()}
        ended = 0
        for tab, result in self.farm.step(commands).items():
            state, command = self.states[tab], commands[tab]
            over = result.done or command.last or bool(result.lost)
            if over:
                ended += 1
                self._check(tab, state, result.raw_reward, result.done, result.lost, checked=command.following is None)
                state.ended += 1
                state.episode = command.following or self._next_episode(state)
                state.steps = 0
            state.observation = result.observation
        return ended

    def _command(self, state: TabState) -> Command:
        assert state.observation is not None
        state.steps += 1
        checks = state.ended % CHECK_ONE_IN == 0
        following = None if checks else self._next_episode(state)
        action = expert(state.episode.task)(state.observation)
        return Command.of(action, state.observation, last=state.steps >= STEP_LIMIT, following=following)

    def _next_episode(self, state: TabState) -> EpisodeSpec:
        task = next(self._tasks) if state.ended % EPISODES_PER_TASK == EPISODES_PER_TASK - 1 else state.episode.task
        return EpisodeSpec(task=task, seed=next(self._seeds))

    def _check(self, tab: int, state: TabState, reward: float, done: bool, lost: str, *, checked: bool) -> None:
        self.outcomes[lost or ("step limit" if not done else "success" if reward == 1.0 else "failure")] += 1
        if checked and done:  # no episode follows in this tab, so the page still has the reward
            own = self.farm._tabs.evaluate({tab: "String(Number(WOB_RAW_REWARD_GLOBAL))"})[tab]
            self.checked += 1
            if own != str(reward) and (not isinstance(own, str) or float(own) != reward):
                self.wrong.append(f"{state.episode}: the reward is {reward}, wanted the page's own {own}")

    def inject_fault(self, kind: str, episodes: int) -> None:
        """Inject one fault, and step until every tab steps again. Appends the fault to `faults`."""
        before = Counter(self.causes)
        tab = episodes % self.farm.tabs
        tabs = self.farm._tabs
        start = time.monotonic()
        if kind == "loop":
            tabs.evaluate({tab: "document.body.addEventListener('mousedown', () => { for (;;); }, {once: true}); ''"})
        elif kind == "crash":
            tabs._tools.post(tabs._tab(tab).session, "Page.crash")
        elif kind == "alert":
            tabs.evaluate({tab: "document.body.addEventListener('mousedown', () => alert(1), {once: true}); ''"})
        elif kind == "leave":
            tabs.evaluate({tab: "location.href = 'about:blank'; ''"})
        else:
            self._signal(kind)
        self.step()
        self.step()
        seconds = time.monotonic() - start
        causes = dict(Counter(self.causes) - before)
        self.faults.append({"kind": kind, "at_episode": episodes, "healed_s": round(seconds, 2), "causes": causes})

    def _signal(self, kind: str) -> None:
        """Kill or stop the browser or its driver."""
        for pid in self.pids():
            try:
                driver = psutil.Process(pid).name().startswith("chromedriver")
            except psutil.NoSuchProcess:
                continue
            if kind == "stop" or driver == (kind == "kill chromedriver"):
                os.kill(pid, signal.SIGSTOP if kind == "stop" else signal.SIGKILL)


FAULTS = ("loop", "crash", "alert", "leave", "kill browser", "kill chromedriver", "stop")


def run(episodes: int, every: int, tabs: int) -> dict[str, Any]:
    """Play `episodes` episodes with a fault after every `every` of them. Returns the JSON result."""
    causes: Counter[str] = Counter()
    start = time.monotonic()
    with ChromeFarm(tabs=tabs, call_timeout_s=CALL_TIMEOUT_S, on_restart=lambda cause: causes.update([cause])) as farm:
        soak, ended, faults = Soak(farm=farm, causes=causes), 0, itertools.cycle(FAULTS)
        with Display().job("episodes", episodes) as job:
            while ended < episodes:
                now = soak.step()
                if (ended + now) // every > ended // every:
                    soak.inject_fault(next(faults), ended + now)
                if (ended + now) // 250 > ended // 250:
                    soak.record_memory()
                ended += now
                job.advance(now, f"{len(soak.faults)} faults")
    half = soak.rss_mb[len(soak.rss_mb) // 2 :]
    third, fourth = half[: len(half) // 2], half[len(half) // 2 :]
    growth = statistics.mean(fourth) / statistics.mean(third) if third and fourth else 1.0
    slowest_s = max((fault["healed_s"] for fault in soak.faults), default=0.0)
    return {
        "episodes": ended,
        "tasks": len(TASKS),
        "tabs": tabs,
        "seconds": round(time.monotonic() - start, 1),
        "load": os.getloadavg(),
        "outcomes": dict(soak.outcomes),
        "restarts_by_cause": dict(causes),
        "rewards": {"checked": soak.checked, "wrong": soak.wrong[:20]},
        "memory": {
            "rss_mb": [round(value, 1) for value in soak.rss_mb],
            "fourth_over_third_quarter": round(growth, 4),
            "flat": growth <= MAX_MEMORY_GROWTH,
        },
        "faults": {"slowest_healed_s": slowest_s, "all_within_5_s": slowest_s <= MAX_RECOVERY_S, "each": soak.faults},
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--episodes", type=int, default=24000)
    parser.add_argument("--every", type=int, default=500)
    parser.add_argument("--tabs", type=int, default=8)
    parser.add_argument("--json", type=writable)
    arguments = parser.parse_args()
    result = run(arguments.episodes, arguments.every, arguments.tabs)
    if arguments.json is not None:
        write_json(arguments.json, result)
    summary = {name: result[name] for name in ("episodes", "seconds", "outcomes", "restarts_by_cause")}
    print(json.dumps({**summary, "slowest_healed_s": result["faults"]["slowest_healed_s"]}))  # noqa: T201
    good = not result["rewards"]["wrong"] and result["memory"]["flat"] and result["faults"]["all_within_5_s"]
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
