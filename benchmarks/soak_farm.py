"""Plays many episodes on many tasks while things break, and says what came of it.

    python benchmarks/soak_farm.py [--episodes 24000] [--every 500] [--tabs 8] [--json FILE]

Every so many episodes the next fault is made, in turn: a page that loops for ever, a crash, an alert, a page that
leaves, a killed browser, a killed chromedriver, a browser that is stopped. It is healed when every tab has taken a step
again. Rewards are compared with what the page itself holds, asked apart from the farm, on one episode in eight. Exit
status 1 where an episode hangs, a reward is wrong, a fault heals late, or memory grows.
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
from giirl_core.files import write_json
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
IN_A_ROW = 25  # episodes of one task in one tab
CHECK_ONE_IN = 8
STEP_LIMIT = 30
CALL_TIMEOUT_S = 1.5
HEALED_S, FLAT = 5.0, 1.10  # what is demanded


@dataclass(kw_only=True)
class Place:
    """What one tab is at."""

    episode: EpisodeSpec
    seen: Observation | None = None
    steps: int = 0
    ended: int = 0


@dataclass(kw_only=True)
class Soak:
    """One run and its books."""

    farm: ChromeFarm
    causes: Counter[str]
    places: dict[int, Place] = field(default_factory=dict)
    outcomes: Counter[str] = field(default_factory=Counter)
    checked: int = 0
    wrong: list[str] = field(default_factory=list)
    faults: list[dict[str, Any]] = field(default_factory=list)
    rss_mb: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._seeds = itertools.count(FIRST_SEED << 1)
        self._tasks = itertools.cycle(TASKS)
        for tab in range(self.farm.tabs):
            self.places[tab] = Place(episode=EpisodeSpec(task=next(self._tasks), seed=next(self._seeds)))

    def pids(self) -> set[int]:
        return reaper.processes(Path(self.farm.chrome_directory))

    def weigh(self) -> None:
        """Note the resident memory of this process and everything it started."""
        total = 0
        for pid in {os.getpid(), *self.pids()}:
            try:
                total += psutil.Process(pid).memory_info().rss
            except psutil.NoSuchProcess:
                continue
        self.rss_mb.append(total / 1e6)

    def step(self) -> int:
        """One step of every tab; how many episodes ended."""
        unopened = {tab: place.episode for tab, place in self.places.items() if place.seen is None}
        if unopened:
            for tab, seen in self.farm.reset(unopened).items():
                self.places[tab].seen, self.places[tab].steps = seen, 0
        commands = {tab: self._command(place) for tab, place in self.places.items()}
        ended = 0
        for tab, result in self.farm.step(commands).items():
            place, command = self.places[tab], commands[tab]
            over = result.done or command.last or bool(result.lost)
            if over:
                ended += 1
                self._judge(tab, place, result.raw_reward, result.done, result.lost, checked=command.following is None)
                place.ended += 1
                place.episode = command.following or self._next(place)
                place.steps = 0
            place.seen = result.observation
        return ended

    def _command(self, place: Place) -> Command:
        assert place.seen is not None
        place.steps += 1
        checks = place.ended % CHECK_ONE_IN == 0
        following = None if checks else self._next(place)
        action = expert(place.episode.task)(place.seen)
        return Command.of(action, place.seen, last=place.steps >= STEP_LIMIT, following=following)

    def _next(self, place: Place) -> EpisodeSpec:
        task = next(self._tasks) if place.ended % IN_A_ROW == IN_A_ROW - 1 else place.episode.task
        return EpisodeSpec(task=task, seed=next(self._seeds))

    def _judge(self, tab: int, place: Place, reward: float, done: bool, lost: str, *, checked: bool) -> None:
        self.outcomes[lost or ("step limit" if not done else "success" if reward == 1.0 else "failure")] += 1
        if checked and done:  # nothing followed, so the page still shows how it ended
            own = self.farm._tabs.evaluate({tab: "String(Number(WOB_RAW_REWARD_GLOBAL))"})[tab]
            self.checked += 1
            if own != str(reward) and (not isinstance(own, str) or float(own) != reward):
                self.wrong.append(f"{place.episode}: {reward}, the page says {own}")

    def break_something(self, kind: str, episodes: int) -> None:
        """Make one fault, and go on until every tab steps again."""
        before = Counter(self.causes)
        tab = episodes % self.farm.tabs
        tabs = self.farm._tabs
        since = time.monotonic()
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
        seconds = time.monotonic() - since
        told = dict(Counter(self.causes) - before)
        self.faults.append({"kind": kind, "at_episode": episodes, "healed_s": round(seconds, 2), "told": told})

    def _signal(self, kind: str) -> None:
        for pid in self.pids():
            try:
                driver = psutil.Process(pid).name().startswith("chromedriver")
            except psutil.NoSuchProcess:
                continue
            if kind == "stop" or driver == (kind == "kill chromedriver"):
                os.kill(pid, signal.SIGSTOP if kind == "stop" else signal.SIGKILL)


FAULTS = ("loop", "crash", "alert", "leave", "kill browser", "kill chromedriver", "stop")


def run(episodes: int, every: int, tabs: int) -> dict[str, Any]:
    causes: Counter[str] = Counter()
    since = time.monotonic()
    with ChromeFarm(tabs=tabs, call_timeout_s=CALL_TIMEOUT_S, on_restart=lambda cause: causes.update([cause])) as farm:
        soak, ended, faults = Soak(farm=farm, causes=causes), 0, itertools.cycle(FAULTS)
        with Display().job("episodes", episodes) as job:
            while ended < episodes:
                now = soak.step()
                if (ended + now) // every > ended // every:
                    soak.break_something(next(faults), ended + now)
                if (ended + now) // 250 > ended // 250:
                    soak.weigh()
                ended += now
                job.advance(now, f"{len(soak.faults)} faults")
    half = soak.rss_mb[len(soak.rss_mb) // 2 :]
    third, fourth = half[: len(half) // 2], half[len(half) // 2 :]
    growth = statistics.mean(fourth) / statistics.mean(third) if third and fourth else 1.0
    healed = max((fault["healed_s"] for fault in soak.faults), default=0.0)
    return {
        "episodes": ended,
        "tasks": len(TASKS),
        "tabs": tabs,
        "seconds": round(time.monotonic() - since, 1),
        "load": os.getloadavg(),
        "outcomes": dict(soak.outcomes),
        "restarts_by_cause": dict(causes),
        "rewards": {"checked": soak.checked, "wrong": soak.wrong[:20]},
        "memory": {
            "rss_mb": [round(value, 1) for value in soak.rss_mb],
            "fourth_over_third_quarter": round(growth, 4),
            "flat": growth <= FLAT,
        },
        "faults": {"slowest_healed_s": healed, "all_within_5_s": healed <= HEALED_S, "each": soak.faults},
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--episodes", type=int, default=24000)
    parser.add_argument("--every", type=int, default=500)
    parser.add_argument("--tabs", type=int, default=8)
    parser.add_argument("--json", type=Path)
    wanted = parser.parse_args()
    found = run(wanted.episodes, wanted.every, wanted.tabs)
    if wanted.json is not None:
        write_json(wanted.json, found)
    summary = {name: found[name] for name in ("episodes", "seconds", "outcomes", "restarts_by_cause")}
    print(json.dumps({**summary, "slowest_healed_s": found["faults"]["slowest_healed_s"]}))  # noqa: T201
    good = not found["rewards"]["wrong"] and found["memory"]["flat"] and found["faults"]["all_within_5_s"]
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
