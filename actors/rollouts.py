"""Plays episodes in all tabs of a browser in parallel. A round is one batch of actions and one browser call."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from actors.agents import Agent, Decision
from actors.schedule import Schedule
from giirl_core.choices import SampledActions
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
)


@dataclass(slots=True)
class Slot:
    """The unfinished episode in one tab."""

    observation: Observation  # the current one
    following: EpisodeSpec | None  # the tab's next episode
    rng: np.random.Generator
    pages: list[Page] = field(default_factory=list)
    actions: list[Action] = field(default_factory=list)
    logp: list[float] = field(default_factory=list)
    sampled: list[NDArray[np.int16]] = field(default_factory=list)
    sampled_logp: list[NDArray[np.float32]] = field(default_factory=list)
    version: int | None = None  # of the policy at the first step


Gate = Callable[[int], int]  # from the number of unfinished episodes to the number of episodes that may start


def always_open(playing: int) -> int:
    """The gate without a limit."""
    return 1 << 30


def play(
    browser: Browser,
    agent: Agent,
    schedule: Schedule,
    *,
    step_limit: int,
    metrics: Metrics,
    gate: Gate = always_open,
) -> Iterator[list[Episode]]:
    """Play until the schedule ends. After each round, yields the episodes that ended in it, often none.

    A tab stays idle while `gate` does not let its next episode start. The random numbers of an episode depend only on
    its seed, not on its tab, the other tabs or the actor.
    """
    slots: dict[int, Slot] = {}
    waiting_tabs = {tab: spec for tab in range(browser.tabs) if (spec := schedule.next(tab)) is not None}
    while True:
        starting = dict(list(waiting_tabs.items())[: max(0, gate(len(slots)))])
        for tab in starting:
            del waiting_tabs[tab]
        opened = browser.reset(starting) if starting else {}
        for tab, spec in starting.items():
            if tab in opened:
                slots[tab] = _open(opened[tab], schedule, tab)
            else:
                _give_back(spec, schedule, tab, browser, waiting_tabs, metrics)
        if slots:
            yield _play_round(browser, agent, schedule, slots, waiting_tabs, step_limit, metrics, gate)
        elif waiting_tabs:
            yield []
        if not slots and not waiting_tabs:  # episodes lost in the last round are played again
            waiting_tabs = {tab: spec for tab in range(browser.tabs) if (spec := schedule.next(tab)) is not None}
            if not waiting_tabs:
                return


def _play_round(
    browser: Browser,
    agent: Agent,
    schedule: Schedule,
    slots: dict[int, Slot],
    waiting_tabs: dict[int, EpisodeSpec],
    step_limit: int,
    metrics: Metrics,
    gate: Gate,
) -> list[Episode]:
    """One step of every tab. Returns the episodes that ended, and moves tabs between `slots` and `waiting_tabs`."""
    may_follow = gate(len(slots)) - len(waiting_tabs)  # idle tabs come first
    commands = _commands(slots, agent, step_limit, may_follow)
    with waiting(metrics, "browser"):
        results = browser.step(commands)
    ended: list[Episode] = []
    purpose = schedule.purpose.name.lower()
    metrics.env_steps.labels(purpose).inc(len(results))
    for tab, result in results.items():
        slot = slots[tab]
        if result.lost:
            metrics.episodes.labels(slot.observation.episode.task, "lost", purpose).inc()
            schedule.requeue(slot.observation.episode)
        elif not slot.pages:
            metrics.episodes.labels(slot.observation.episode.task, "empty_page", purpose).inc()
        elif result.done or commands[tab].last:
            episode = _close(slot, Outcome(raw_reward=result.raw_reward, ended=result.done))
            metrics.episodes.labels(episode.trajectory.task, _outcome_name(episode.outcome), purpose).inc()
            ended.append(episode)
        else:
            assert result.observation is not None
            slot.observation = result.observation
            continue
        del slots[tab]
        if result.observation is not None:
            slots[tab] = _open(result.observation, schedule, tab)
        elif slot.following is not None and commands[tab].following is None:
            waiting_tabs[tab] = slot.following
        elif slot.following is not None:
            _give_back(slot.following, schedule, tab, browser, waiting_tabs, metrics)
    return ended


def _give_back(
    spec: EpisodeSpec,
    schedule: Schedule,
    tab: int,
    browser: Browser,
    waiting_tabs: dict[int, EpisodeSpec],
    metrics: Metrics,
) -> None:
    """An episode whose page did not open is void: it is played again. The tab goes on with its next one."""
    metrics.episodes.labels(spec.task, "lost", schedule.purpose.name.lower()).inc()
    schedule.requeue_unopened(spec, browser.unopened.get(tab, ""))
    following = schedule.next(tab)
    if following is not None:
        waiting_tabs[tab] = following


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
    """Play the pages `first` to `first + pages - 1` of each task, with the seeds of `purpose`; returns the episodes.

    Empty `tasks` means all tasks of the config. `job` shows the number of episodes, with `note` next to it.
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
    schedule.opened(observation.episode)
    rng = np.random.default_rng([observation.episode.seed, 1])
    return Slot(observation=observation, following=schedule.next(tab), rng=rng)


def _commands(slots: Mapping[int, Slot], agent: Agent, step_limit: int, may_follow: int) -> dict[int, Command]:
    """One command for each tab, from one batch of decisions. On a page without elements the episode ends.

    If an episode ends, only the first `may_follow` tabs open their next one in the same call.
    """
    following = {tab: slot.following if n < may_follow else None for n, (tab, slot) in enumerate(slots.items())}
    commands = {tab: Command(verb=Verb.WAIT, last=True, following=following[tab]) for tab in slots}
    playable = {tab: slot for tab, slot in slots.items() if slot.observation.page.leaf.any()}
    if playable:
        uniform = np.stack([slot.rng.random((agent.draws, 3), dtype=np.float32) for slot in playable.values()])
        observations = [replace(slot.observation, step=len(slot.pages)) for slot in playable.values()]
        decisions = agent.select_actions(observations, uniform)
        for (tab, slot), decision in zip(playable.items(), decisions, strict=True):
            commands[tab] = _command(slot, decision, step_limit, following[tab])
    return commands


def _command(slot: Slot, decision: Decision, step_limit: int, following: EpisodeSpec | None) -> Command:
    """Record the decision in the slot and translate it into a browser command."""
    page, action = slot.observation.page, decision.action
    slot.pages.append(page)
    slot.actions.append(action)
    slot.logp.append(decision.logp)
    if decision.sampled is not None and decision.sampled_logp is not None:
        slot.sampled.append(decision.sampled)
        slot.sampled_logp.append(decision.sampled_logp)
    if slot.version is None:
        slot.version = decision.version
    return Command.of(action, slot.observation, last=len(slot.pages) >= step_limit, following=following)


def _close(slot: Slot, outcome: Outcome) -> Episode:
    assert slot.version is not None
    sampled = None
    if slot.sampled:
        logp = np.stack(slot.sampled_logp)
        sampled = SampledActions(choices=np.stack(slot.sampled), logp=logp, rewards=np.zeros_like(logp))
    trajectory = Trajectory(
        task=slot.observation.episode.task,
        goal=slot.observation.goal,
        seed=slot.observation.episode.seed,
        pages=tuple(slot.pages),
        actions=tuple(slot.actions),
        behaviour_logp=np.array(slot.logp, dtype=np.float32),
        rewards=np.zeros(len(slot.pages), dtype=np.float32),
        policy_version=slot.version,
        sampled=sampled,
    )
    return Episode(trajectory=trajectory, outcome=outcome)


def _outcome_name(outcome: Outcome) -> str:
    if outcome.success:
        return "success"
    return "failure" if outcome.ended else "step_limit"
