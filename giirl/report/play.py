"""A run's policy does one task before the eyes of a person: each action with its probability and learned reward."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from rich.table import Table

from actors.agents import PolicyAgent
from giirl.report.element_rewards import describe_action, element_actions
from giirl_core.nets.reward import RewardModel
from giirl_core.types import Action, Browser, Command, EpisodeSpec, Goal, Observation, StepResult

TAB = 0
CANDIDATES = 5  # shown of a page
PAUSE_S = 1.0  # before each action, where a person watches
END_PAUSES = 3  # pauses after the last one


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """An action that is possible on a page. `reward` is None for a run without a learned reward."""

    action: Action
    description: str
    probability: float  # with which the policy chooses it
    reward: float | None

    def row(self) -> dict[str, Any]:
        """As JSON."""
        return {"action": self.description, "probability": self.probability, "reward": self.reward}


@dataclass(frozen=True, slots=True, kw_only=True)
class PlayedStep:
    """What the policy chose, and the best action on each of the best elements: the learned reward decides, if any."""

    chosen: Candidate
    best: tuple[Candidate, ...]

    def row(self) -> dict[str, Any]:
        """As JSON."""
        return {**self.chosen.row(), "candidates": [candidate.row() for candidate in self.best]}


class TooUncertain(RuntimeError):
    """The policy's choice is less probable than what the user wanted."""


@dataclass(slots=True)
class Play:
    """One episode of a policy in the first tab of `browser`. `steps` plays it; the other fields say how it went.

    `goal` is given to the agent in place of the page's own, and the page's verdict is then not about it.
    """

    browser: Browser
    agent: PolicyAgent
    reward: RewardModel | None
    spec: EpisodeSpec
    step_limit: int
    goal: Goal | None = None
    least: float = 0.0  # probability of an action
    pause_s: float = 0.0
    is_measured: bool = True  # the page says what success is
    instruction: str = ""
    played: list[PlayedStep] = field(default_factory=list)
    result: StepResult | None = None  # of the last step, once the episode has ended

    def steps(self) -> Iterator[PlayedStep]:
        """Play; yields each step before it is done.

        TooUncertain for a choice below `least`, which is then not done. RuntimeError, one line, for a page that does
        not open or breaks.
        """
        observation: Observation | None = self._open()
        while observation is not None:
            if not observation.page.leaf.any():
                raise RuntimeError(f"{self.spec.task}: the page has no element to act on")
            step = self._look(observation)
            self.played.append(step)
            yield step
            if step.chosen.probability < self.least:
                raise TooUncertain(
                    f"step {len(self.played)}, {step.chosen.description}, has the probability "
                    f"{step.chosen.probability:.3f}: wanted at least {self.least:g}; it was not done"
                )
            time.sleep(self.pause_s)
            observation = self._act(observation, step.chosen.action)
        time.sleep(END_PAUSES * self.pause_s)

    @property
    def success(self) -> bool | None:
        """Whether the page says that its instruction was followed; None if it does not say."""
        if self.result is None or self.goal is not None or not self.is_measured:
            return None
        return self.result.raw_reward == 1.0

    @property
    def verdict(self) -> str:
        """What happened, in one line."""
        if self.result is None:
            return "the episode did not end"
        how = "the page ended the episode" if self.result.done else f"the step limit of {self.step_limit} ended it"
        if self.success is not None:
            return f"{'succeeded' if self.success else 'failed'}: {how} with reward {self.result.raw_reward + 0.0:g}"
        why = "it knows its own instruction only" if self.goal is not None else "the task file has no [success]"
        return f"{how}; the page has no verdict, since {why}"

    def summary(self) -> dict[str, Any]:
        """The episode as JSON."""
        return {
            "task": self.spec.task,
            "seed": self.spec.seed,
            "goal": self.instruction,
            "given_goal": self.goal is not None,
            "policy_version": self.agent.version,
            "min_confidence": self.least,
            "steps": [step.row() for step in self.played],
            "ended": self.result is not None and self.result.done,
            "success": self.success,
        }

    def _open(self) -> Observation:
        opened = self.browser.reset({TAB: self.spec})
        if TAB not in opened:
            raise RuntimeError(self.browser.unopened.get(TAB) or f"{self.spec.task} does not open")
        return self._asked(opened[TAB])

    def _asked(self, observation: Observation) -> Observation:
        """The observation under the goal that is followed."""
        observation = observation if self.goal is None else replace(observation, goal=self.goal)
        self.instruction = observation.goal.utterance
        return observation

    def _act(self, observation: Observation, action: Action) -> Observation | None:
        """The next observation, None at the end of the episode."""
        last = len(self.played) >= self.step_limit
        result = self.browser.step({TAB: Command.of(action, observation, last=last)})[TAB]
        if result.lost:
            where = f"{self.spec.task}: step {len(self.played)}"
            raise RuntimeError(f"{where} broke the page or the browser: {result.lost}")
        if result.done or last or result.observation is None:
            self.result = result
            return None
        return self._asked(result.observation)

    def _look(self, observation: Observation) -> PlayedStep:
        """The policy's choice on a page, and the best of the others."""
        page, goal = observation.page, observation.goal
        chosen = self.agent.select_actions([observation], np.zeros((1, 1, 3), np.float32))[0].action
        actions = [chosen, *element_actions(page, goal, self.agent.net.gestures)]
        probabilities = [math.exp(min(0.0, p)) for p in self.agent.log_probabilities(observation, actions).tolist()]
        scores = self.reward.score_actions(page, goal, actions).tolist() if self.reward is not None else None
        candidates = [
            Candidate(
                action=action,
                description=describe_action(page, goal, action),
                probability=probability,
                reward=scores[number] if scores is not None else None,
            )
            for number, (action, probability) in enumerate(zip(actions, probabilities, strict=True))
        ]
        ranked = sorted(candidates[1:], key=lambda one: -(one.probability if one.reward is None else one.reward))
        best: dict[int, Candidate] = {}
        for candidate in ranked:
            best.setdefault(candidate.action.element, candidate)
        return PlayedStep(chosen=candidates[0], best=tuple(best.values())[:CANDIDATES])


def candidates_table(step: PlayedStep) -> Table:
    """The candidates of a step, best first; the chosen one is marked."""
    table = Table("", "candidate")
    for name in ("reward", "probability"):
        table.add_column(name, justify="right")
    shown = step.best if step.chosen.action in [one.action for one in step.best] else (*step.best, step.chosen)
    for one in shown:
        mark = ">" if one.action == step.chosen.action else ""
        reward = "-" if one.reward is None else f"{one.reward:+.2f}"
        table.add_row(mark, one.description, reward, f"{one.probability:.3f}")
    return table
