"""Episodes out of tabs: K at once, one batched choice and one browser call a round."""

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
    """Which episode each tab plays next: tabs keep to their tasks, tasks get equal shares of the tabs.

    Episode `i` of a task has seed `page_seed(purpose, run_seed, first + i * stride)`. With a `quota` each task
    is played so many times and then never again; without one, for ever.
    """

    STAY = 10  # episodes a tab plays of one task before it opens another page, when tasks outnumber tabs

    LOSSES = 3  # of one episode, after which it counts as played

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
        self._of_tab = [tasks[tab::tabs] if len(tasks) > tabs else [tasks[tab % len(tasks)]] for tab in range(tabs)]
        self._purpose, self._run_seed, self._first, self._stride = purpose, run_seed, first, stride
        self._quota = quota
        self._dealt = dict.fromkeys(tasks, 0)
        self._turn = [0] * tabs
        self._returned: list[EpisodeSpec] = []
        self._losses: Counter[EpisodeSpec] = Counter()

    def next(self, tab: int) -> EpisodeSpec | None:
        """The tab's next episode, or None when its tasks are used up."""
        mine = self._of_tab[tab]
        for spec in self._returned:
            if spec.task in mine:
                self._returned.remove(spec)
                return spec
        open_tasks = [task for task in mine if self._quota is None or self._dealt[task] < self._quota]
        if not open_tasks:
            return None
        task = open_tasks[self._turn[tab] // self.STAY % len(open_tasks)]
        self._turn[tab] += 1
        index = self._first + self._dealt[task] * self._stride
        self._dealt[task] += 1
        return EpisodeSpec(task=task, seed=page_seed(self._purpose, self._run_seed, index))

    def give_back(self, spec: EpisodeSpec) -> None:
        """An episode that was lost is played again, unless it always is: a page may break whatever opens it."""
        self._losses[spec] += 1
        if self._losses[spec] < self.LOSSES:
            self._returned.append(spec)


@dataclass(slots=True)
class Slot:
    """The episode under way in one tab."""

    seen: Observation
    following: EpisodeSpec | None
    rng: np.random.Generator
    pages: list[Page] = field(default_factory=list)
    actions: list[Action] = field(default_factory=list)
    logp: list[float] = field(default_factory=list)
    version: int | None = None


def play(
    browser: Browser, chooser: Agent, schedule: Schedule, *, step_limit: int, metrics: Metrics
) -> Iterator[list[Episode]]:
    """Play until the schedule ends; yields after every round the episodes that ended in it, often none.

    The chance in an episode depends on its seed alone, not on its tab, its neighbours or its actor.
    """
    first = {tab: spec for tab in range(browser.tabs) if (spec := schedule.next(tab)) is not None}
    slots = {tab: _open(seen, schedule, tab) for tab, seen in browser.reset(first).items()}
    while slots:
        commands = _commands(slots, chooser, step_limit)
        with waiting(metrics, "browser"):
            results = browser.step(commands)
        ended: list[Episode] = []
        for tab, result in results.items():
            slot = slots[tab]
            metrics.env_steps.inc()
            if result.lost:
                metrics.episodes.labels(slot.seen.episode.task, "lost").inc()
                schedule.give_back(slot.seen.episode)
            elif not slot.pages:
                metrics.episodes.labels(slot.seen.episode.task, "empty_page").inc()
            elif result.done or commands[tab].last:
                episode = _close(slot, Outcome(raw_reward=result.raw_reward, ended=result.done))
                metrics.episodes.labels(episode.trajectory.task, _outcome_name(episode.outcome)).inc()
                ended.append(episode)
            else:
                assert result.observation is not None
                slot.seen = result.observation
                continue
            del slots[tab]
            if result.observation is not None:
                slots[tab] = _open(result.observation, schedule, tab)
        yield ended
        if not slots:  # what was lost last is played again
            again = {tab: spec for tab in range(browser.tabs) if (spec := schedule.next(tab)) is not None}
            slots = {tab: _open(seen, schedule, tab) for tab, seen in browser.reset(again).items()}


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
    """Play pages `first` to `first + pages - 1` of this purpose, of each task, and return the episodes that ended.

    `tasks` are those of the config when empty. `job` counts the episodes, with `note` beside the number.
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


def _open(seen: Observation, schedule: Schedule, tab: int) -> Slot:
    return Slot(seen=seen, following=schedule.next(tab), rng=np.random.default_rng([seen.episode.seed, 1]))


def _commands(slots: Mapping[int, Slot], chooser: Agent, step_limit: int) -> dict[int, Command]:
    """A batched choice for all tabs. A page with nothing to act on ends its episode."""
    commands = {tab: Command(verb=Verb.WAIT, last=True, following=slot.following) for tab, slot in slots.items()}
    playable = {tab: slot for tab, slot in slots.items() if slot.seen.page.leaf.any()}
    if playable:
        uniform = np.stack([slot.rng.random(3, dtype=np.float32) for slot in playable.values()])
        choices = chooser([slot.seen for slot in playable.values()], uniform)
        for (tab, slot), choice in zip(playable.items(), choices, strict=True):
            commands[tab] = _command(slot, choice, step_limit)
    return commands


def _command(slot: Slot, choice: Decision, step_limit: int) -> Command:
    """Note the choice in the slot and say it in the browser's words."""
    page, action = slot.seen.page, choice.action
    slot.pages.append(page)
    slot.actions.append(action)
    slot.logp.append(choice.logp)
    if slot.version is None:
        slot.version = choice.version
    return Command.of(action, slot.seen, last=len(slot.pages) >= step_limit, following=slot.following)


def _close(slot: Slot, outcome: Outcome) -> Episode:
    assert slot.version is not None
    trajectory = Trajectory(
        task=slot.seen.episode.task,
        goal=slot.seen.goal,
        seed=slot.seen.episode.seed,
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
