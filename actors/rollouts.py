"""Plays episodes in all tabs of a browser at once, with one batch of actions and one browser call per round."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from actors.agents import Agent, Decision
from giirl_core.config import Config
from giirl_core.metrics import Metrics, waiting
from giirl_core.progress import Job
from giirl_core.types import (
    Action,
    Browser,
    Command,
    Episode,
    EpisodeSpec,
    Observation,
    Outcome,
    Page,
    Purpose,
    Trajectory,
    Verb,
    page_seed,
)


class Schedule:
    """Decides which episode each tab plays next. Each tab has a fixed set of tasks; tasks share the tabs equally.

    Episode `i` of a task has seed `page_seed(purpose, run_seed, first + i * stride)`. With a `quota`, each task is
    played that many times; without one the schedule never ends.
    """

    EPISODES_PER_TURN = 10  # that a tab plays of one task before it opens the next, when there are more tasks than tabs
    MAX_LOSSES = 3  # of one episode, after which it is not played again

    def __init__(
        self,
        tasks: Sequence[str],
        tabs: int,
        *,
        purpose: Purpose,
        run_seed: int,
        first: int = 0,
        stride: int = 1,
        quota: int | None = None,
    ) -> None:
        self._tasks_of_tab = [
            tasks[tab::tabs] if len(tasks) > tabs else [tasks[tab % len(tasks)]] for tab in range(tabs)
        ]
        self._purpose, self._run_seed, self._first, self._stride = purpose, run_seed, first, stride
        self._quota = quota
        self._started = dict.fromkeys(tasks, 0)  # episodes of each task
        self._started_by_tab = [0] * tabs
        self._requeued: list[EpisodeSpec] = []
        self._losses: Counter[EpisodeSpec] = Counter()

    def next(self, tab: int) -> EpisodeSpec | None:
        """The tab's next episode; None when the quota of its tasks is reached."""
        tasks = self._tasks_of_tab[tab]
        for spec in self._requeued:
            if spec.task in tasks:
                self._requeued.remove(spec)
                return spec
        open_tasks = [task for task in tasks if self._quota is None or self._started[task] < self._quota]
        if not open_tasks:
            return None
        task = open_tasks[self._started_by_tab[tab] // self.EPISODES_PER_TURN % len(open_tasks)]
        self._started_by_tab[tab] += 1
        index = self._first + self._started[task] * self._stride
        self._started[task] += 1
        return EpisodeSpec(task=task, seed=page_seed(self._purpose, self._run_seed, index))

    def requeue(self, spec: EpisodeSpec) -> None:
        """Play a lost episode again, unless it was lost MAX_LOSSES times: some pages break every browser."""
        self._losses[spec] += 1
        if self._losses[spec] < self.MAX_LOSSES:
            self._requeued.append(spec)


@dataclass(slots=True)
class Slot:
    """The unfinished episode in one tab."""

    observation: Observation  # the current one
    following: EpisodeSpec | None  # the tab's next episode
    rng: np.random.Generator
    pages: list[Page] = field(default_factory=list)
    actions: list[Action] = field(default_factory=list)
    logp: list[float] = field(default_factory=list)
    version: int | None = None  # of the policy at the first step


def play(
    browser: Browser, agent: Agent, schedule: Schedule, *, step_limit: int, metrics: Metrics
) -> Iterator[list[Episode]]:
    """Play until the schedule ends. After every round, yields the episodes that ended in it, often none.

    The random numbers of an episode depend only on its seed, not on its tab, the other tabs or the actor.
    """
    first = {tab: spec for tab in range(browser.tabs) if (spec := schedule.next(tab)) is not None}
    slots = {tab: _open(observation, schedule, tab) for tab, observation in browser.reset(first).items()}
    while slots:
        commands = _commands(slots, agent, step_limit)
        with waiting(metrics, "browser"):
            results = browser.step(commands)
        ended: list[Episode] = []
        for tab, result in results.items():
            slot = slots[tab]
            metrics.env_steps.inc()
            if result.lost:
                metrics.episodes.labels(slot.observation.episode.task, "lost").inc()
                schedule.requeue(slot.observation.episode)
            elif not slot.pages:
                metrics.episodes.labels(slot.observation.episode.task, "empty_page").inc()
            elif result.done or commands[tab].last:
                episode = _close(slot, Outcome(raw_reward=result.raw_reward, ended=result.done))
                metrics.episodes.labels(episode.trajectory.task, _outcome_name(episode.outcome)).inc()
                ended.append(episode)
            else:
                assert result.observation is not None
                slot.observation = result.observation
                continue
            del slots[tab]
            if result.observation is not None:
                slots[tab] = _open(result.observation, schedule, tab)
        yield ended
        if not slots:  # episodes lost in the last round are played again
            again = {tab: spec for tab in range(browser.tabs) if (spec := schedule.next(tab)) is not None}
            slots = {tab: _open(observation, schedule, tab) for tab, observation in browser.reset(again).items()}


def play_pages(
    config: Config,
    browser: Browser,
    agent: Agent,
    purpose: Purpose,
    pages: int,
    metrics: Metrics,
    *,
    tasks: Sequence[str] = (),
    first: int = 0,
    job: Job | None = None,
    note: str = "",
) -> list[Episode]:
    """Play pages `first` to `first + pages - 1` of each task and return the episodes that ended.

    The seeds of the pages are those of `purpose`. Empty `tasks` means all tasks of the config. `job` counts the
    episodes and shows `note` next to the count.
    """
    schedule = Schedule(
        tasks or config.tasks, browser.tabs, purpose=purpose, run_seed=config.seed, first=first, quota=pages
    )
    episodes: list[Episode] = []
    for ended in play(browser, agent, schedule, step_limit=config.step_limit, metrics=metrics):
        episodes += ended
        if job is not None:
            job.advance(len(ended), note)
    return episodes


def _open(observation: Observation, schedule: Schedule, tab: int) -> Slot:
    rng = np.random.default_rng([observation.episode.seed, 1])
    return Slot(observation=observation, following=schedule.next(tab), rng=rng)


def _commands(slots: Mapping[int, Slot], agent: Agent, step_limit: int) -> dict[int, Command]:
    """One command for each tab, chosen in one batch. An episode ends on a page without elements."""
    commands = {tab: Command(verb=Verb.WAIT, last=True, following=slot.following) for tab, slot in slots.items()}
    playable = {tab: slot for tab, slot in slots.items() if slot.observation.page.leaf.any()}
    if playable:
        uniform = np.stack([slot.rng.random(3, dtype=np.float32) for slot in playable.values()])
        decisions = agent.select_actions([slot.observation for slot in playable.values()], uniform)
        for (tab, slot), decision in zip(playable.items(), decisions, strict=True):
            commands[tab] = _command(slot, decision, step_limit)
    return commands


def _command(slot: Slot, decision: Decision, step_limit: int) -> Command:
    """Record the decision in the slot and translate it into a browser command."""
    page, action = slot.observation.page, decision.action
    slot.pages.append(page)
    slot.actions.append(action)
    slot.logp.append(decision.logp)
    if slot.version is None:
        slot.version = decision.version
    return Command.of(action, slot.observation, last=len(slot.pages) >= step_limit, following=slot.following)


def _close(slot: Slot, outcome: Outcome) -> Episode:
    assert slot.version is not None
    trajectory = Trajectory(
        task=slot.observation.episode.task,
        goal=slot.observation.goal,
        seed=slot.observation.episode.seed,
        pages=tuple(slot.pages),
        actions=tuple(slot.actions),
        behaviour_logp=np.array(slot.logp, dtype=np.float32),
        rewards=np.zeros(len(slot.pages), dtype=np.float32),
        policy_version=slot.version,
    )
    return Episode(trajectory=trajectory, outcome=outcome)


def _outcome_name(outcome: Outcome) -> str:
    if outcome.success:
        return "success"
    return "failure" if outcome.ended else "step_limit"
