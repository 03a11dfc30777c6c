"""Inspect a run's policy and reward on fresh pages, step by step, under the page's own instruction and another one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from actors.agents import PolicyAgent
from actors.browser import open_browser
from giirl.analysis.swaps import swap_goal
from giirl.report.element_rewards import EpisodeView, Frame, ScoredPage, score_elements
from giirl.report.overlay import Box, visible_area
from giirl_core.config import Config
from giirl_core.metrics import Metrics
from giirl_core.nets.language import load_vectors
from giirl_core.nets.parameters import load_net
from giirl_core.nets.reward import build_policy, build_reward
from giirl_core.types import Command, EpisodeSpec, Goal, Observation, Outcome, Purpose, page_seed
from giirl_core.weights import Weights

PIXEL_RATIO = 2.0  # image pixels per CSS px in screenshots
TAB = 0
MAX_SEED = 1 << 53  # largest integer that JavaScript represents exactly


class Inspector:
    """Plays the greedy policy, one page at a time. `reward` is None for algorithms that learn no reward."""

    def __init__(
        self,
        config: Config,
        policy: Weights,
        reward: Weights | None,
        metrics: Metrics,
        *,
        screenshots: bool = True,
    ) -> None:
        self._config, self._screenshots = config, screenshots
        self.load(policy, reward)
        self._browser = open_browser(replace(config, actors=replace(config.actors, tabs=1)), metrics)

    def __enter__(self) -> Inspector:
        return self

    def __exit__(self, *_: object) -> None:
        self._browser.close()

    def load(self, policy: Weights, reward: Weights | None) -> None:
        """Play and score with other weights from now on. ValueError if they are corrupt or of another net."""
        net = build_policy(self._config)
        load_net(net, policy)
        self._agent = PolicyAgent(net, load_vectors(self._config.net.vectors), version=policy.version, greedy=True)
        self._reward = build_reward(self._config, reward) if reward is not None else None

    def episode(self, spec: EpisodeSpec) -> EpisodeView:
        """Play one page to the end, under its own instruction alone. RuntimeError if it does not open."""
        return self._play(self._open(spec), None)

    def strips(self, task: str, count: int) -> Iterator[EpisodeView]:
        """Play the first `count` inspection pages of a task to the end.

        The other instruction names another element of the page. Where that is impossible, it is the instruction of
        the next page that has a different one.
        """
        specs = [
            EpisodeSpec(task=task, seed=page_seed(Purpose.INSPECT, self._config.seed, i)) for i in range(count + 1)
        ]
        goals = [self._open(spec).goal for spec in specs]
        for number, spec in enumerate(specs[:count]):
            observation = self._open(spec)
            swap = swap_goal(observation)
            others = [goal for goal in goals[number:] + goals[:number] if goal != goals[number]]
            yield self._play(observation, swap.goal if swap is not None else next(iter(others), None))

    def page(self, spec: EpisodeSpec, other: Goal | None) -> EpisodeView:
        """The first step of one page, under its own instruction and under `other`.

        By default the other instruction names another element of the page. ValueError for a seed out of range.
        """
        if not 0 <= spec.seed < MAX_SEED:
            raise ValueError(f"the page seed {spec.seed} is out of range: wanted 0 to 2**53 - 1")
        observation = self._open(spec)
        swap = swap_goal(observation)
        frame = self._frame(observation, other or (swap.goal if swap else None))
        return EpisodeView(task=spec.task, seed=spec.seed, frames=(frame,))

    def _open(self, spec: EpisodeSpec) -> Observation:
        opened = self._browser.reset({TAB: spec})
        for reason in self._browser.unopened.values():
            raise RuntimeError(reason)
        return opened[TAB]

    def _play(self, first: Observation, other: Goal | None) -> EpisodeView:
        """Play the page that is open to its end, with each step also under `other`."""
        spec = first.episode
        observation: Observation | None = first
        frames: list[Frame] = []
        while True:
            assert observation is not None
            frames.append(frame := self._frame(observation, other))
            action, last = frame.own.policy_action, len(frames) == self._config.step_limit
            error, outcome = "the page has no element to act on", None
            if action is not None:
                result = self._browser.step({TAB: Command.of(action, observation, last=last)})[TAB]
                error, observation = result.lost, result.observation
                if not error and (result.done or last):
                    outcome = Outcome(raw_reward=result.raw_reward, ended=result.done)
            if error or outcome is not None:
                return EpisodeView(task=spec.task, seed=spec.seed, frames=tuple(frames), outcome=outcome, error=error)

    def _frame(self, observation: Observation, other: Goal | None) -> Frame:
        return Frame(
            page=observation.page,
            screenshot=self._screenshot(visible_area(observation.page)),
            own=self._score(observation),
            other=self._score(replace(observation, goal=other)) if other is not None else None,
        )

    def _score(self, observation: Observation) -> ScoredPage:
        page, goal, action, logp = observation.page, observation.goal, None, 0.0
        if page.leaf.any():
            (decision,) = self._agent.select_actions([observation], np.zeros((1, 1, 3), np.float32))
            action, logp = decision.action, decision.logp
        best, reward = score_elements(self._reward, page, goal, action) if self._reward is not None else ((), None)
        return ScoredPage(goal=goal, policy_action=action, best=best, policy_logp=logp, policy_reward=reward)

    def _screenshot(self, area: Box) -> bytes | None:
        if not self._screenshots:
            return None
        return self._browser.screenshot(TAB, (area.x, area.y, area.width, area.height), scale=PIXEL_RATIO) or None
