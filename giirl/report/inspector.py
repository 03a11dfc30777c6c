"""A run's policy and reward looked at on fresh pages, step by step, under the page's instruction and under another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from actors.agents import PolicyAgent
from actors.browser import open_browser
from browser_farm.farm import ChromeFarm
from giirl.analysis.swaps import renamed
from giirl.report.element_rewards import EpisodeView, Frame, ScoredPage, value_elements
from giirl.report.overlay import Box, window_of
from giirl_core.config import Config
from giirl_core.metrics import Metrics
from giirl_core.nets.language import load_vectors
from giirl_core.nets.parameters import load_net
from giirl_core.nets.reward import build_policy, build_reward
from giirl_core.types import Browser, Command, EpisodeSpec, Goal, Observation, Outcome, Purpose, Weights, page_seed

DOTS = 2.0  # of a picture per CSS px
TAB = 0
LARGEST_SEED = 1 << 53  # JavaScript keeps no larger number exact


class Inspector:
    """Plays greedily, one page at a time. `reward` is None where nothing of the kind was learned."""

    def __init__(self, config: Config, policy: Weights, reward: Weights | None, metrics: Metrics) -> None:
        net = build_policy(config)
        load_net(net, policy)
        self._choose = PolicyAgent(net, load_vectors(config.net.vectors), version=policy.version, greedy=True)
        self._reward = build_reward(config, reward) if reward is not None else None
        self._config = config
        self._browser = open_browser(replace(config, actors=replace(config.actors, tabs=1)), metrics)

    def __enter__(self) -> Inspector:
        return self

    def __exit__(self, *_: object) -> None:
        self._browser.close()

    def strips(self, task: str, count: int) -> Iterator[EpisodeView]:
        """The first `count` pages of a task that inspection has for this run, played to their ends.

        The other instruction names another element of the page; where that cannot be, it is the next page's.
        """
        specs = [
            EpisodeSpec(task=task, seed=page_seed(Purpose.INSPECT, self._config.seed, i)) for i in range(count + 1)
        ]
        goals = [self._open(spec).goal for spec in specs]
        for number, spec in enumerate(specs[:count]):
            yield self._play(spec, [goal for goal in goals[number:] + goals[:number] if goal != goals[number]])

    def page(self, spec: EpisodeSpec, other: Goal | None) -> EpisodeView:
        """One page as it opens, under its own instruction and under `other`, or one that names another element."""
        if not 0 <= spec.seed < LARGEST_SEED:
            raise ValueError(f"the page seed {spec.seed} is out of range: wanted 0 to 2**53 - 1")
        seen = self._open(spec)
        swap = renamed(seen)
        frame = self._look(seen, other or (swap.goal if swap else None))
        return EpisodeView(task=spec.task, seed=spec.seed, frames=(frame,))

    def _open(self, spec: EpisodeSpec) -> Observation:
        return self._browser.reset({TAB: spec})[TAB]

    def _play(self, spec: EpisodeSpec, others: Sequence[Goal]) -> EpisodeView:
        seen: Observation | None = self._open(spec)
        assert seen is not None
        swap = renamed(seen)
        other = swap.goal if swap is not None else next(iter(others), None)
        frames: list[Frame] = []
        while True:
            assert seen is not None
            frames.append(frame := self._look(seen, other))
            action, last = frame.own.choice, len(frames) == self._config.step_limit
            trouble, outcome = "there is nothing on the page to act on", None
            if action is not None:
                result = self._browser.step({TAB: Command.of(action, seen, last=last)})[TAB]
                trouble, seen = result.lost, result.observation
                if result.done or last:
                    outcome = Outcome(raw_reward=result.raw_reward, ended=result.done)
            if trouble or outcome is not None:
                return EpisodeView(
                    task=spec.task, seed=spec.seed, frames=tuple(frames), outcome=outcome, trouble=trouble
                )

    def _look(self, seen: Observation, other: Goal | None) -> Frame:
        return Frame(
            page=seen.page,
            picture=_picture(self._browser, window_of(seen.page)),
            own=self._judge(seen),
            other=self._judge(replace(seen, goal=other)) if other is not None else None,
        )

    def _judge(self, seen: Observation) -> ScoredPage:
        choice = None
        if seen.page.leaf.any():
            choice = self._choose([seen], np.zeros((1, 3), np.float32))[0].action
        best = value_elements(self._reward, seen.page, seen.goal) if self._reward is not None else ()
        return ScoredPage(goal=seen.goal, choice=choice, best=best)


def _picture(browser: Browser, window: Box) -> bytes | None:
    if not isinstance(browser, ChromeFarm):
        return None
    return browser.picture(TAB, (window.x, window.y, window.width, window.height), scale=DOTS) or None
