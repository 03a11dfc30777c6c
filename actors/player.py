"""Plays a fixed number of pages of each task: for demonstrations, for evaluation and for the random baseline."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass
from typing import Literal, Protocol

from actors.agents import Agent, ExpertAgent, FurtherAttempt, PolicyAgent, RandomAgent, ReplayAgent
from actors.browser import open_browser
from actors.rollouts import play_pages
from actors.workflows import WorkflowAgent, read_workflows
from browser_farm.mixed import expert_of
from giirl_core.config import Config
from giirl_core.metrics import Metrics
from giirl_core.nets.language import load_vectors
from giirl_core.nets.parameters import load_net
from giirl_core.nets.reward import build_policy
from giirl_core.progress import Job
from giirl_core.types import Browser, Episode, Purpose, Trajectory
from giirl_core.weights import Weights


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentSpec:
    """Which agent plays. It can be sent to another process."""

    kind: Literal["expert", "random", "greedy", "sampling", "replay"]
    policy: Weights | None = None  # of a greedy or sampling policy
    demonstrations: tuple[Trajectory, ...] = ()  # that a replay repeats
    attempt: int = 0  # of a sampling policy at the same pages: each attempt uses other random numbers


class Player(Protocol):
    """Plays pages with an agent."""

    def play(
        self,
        spec: AgentSpec,
        purpose: Purpose,
        pages: int,
        *,
        tasks: Sequence[str] = (),
        first: int = 0,
        job: Job | None = None,
    ) -> list[Episode]:
        """Play the pages `first` to `first + pages - 1` of each task, with the seeds of `purpose`, in any order.

        Empty `tasks` means all tasks of the config.
        """
        ...


OpenPlayer = Callable[[Config, Metrics], AbstractContextManager[Player]]


def build_agent(spec: AgentSpec, config: Config) -> Agent:
    """The agent that a spec describes."""
    if spec.kind == "expert":
        return ExpertAgent(expert_of)
    if spec.kind == "random":
        return RandomAgent()
    if spec.kind == "replay":
        return ReplayAgent(spec.demonstrations)
    assert spec.policy is not None
    net = build_policy(config)
    load_net(net, spec.policy)
    vectors, greedy = load_vectors(config.net.vectors), spec.kind == "greedy"
    agent = PolicyAgent(net, vectors, version=spec.policy.version, greedy=greedy)
    return agent if greedy else FurtherAttempt(agent, spec.attempt)


def training_agent(config: Config) -> PolicyAgent:
    """The agent that plays for the learner, with an untrained policy."""
    net, vectors = build_policy(config), load_vectors(config.net.vectors)
    if config.algorithm == "wge":
        return WorkflowAgent(net, vectors, read_workflows(config.demos.workflows))
    return PolicyAgent(net, vectors, sampled_actions=config.sampled_actions)


class BrowserPlayer:
    """Plays in one browser of this process."""

    def __init__(self, config: Config, browser: Browser, metrics: Metrics) -> None:
        self._config, self._browser, self._metrics = config, browser, metrics

    def play(
        self,
        spec: AgentSpec,
        purpose: Purpose,
        pages: int,
        *,
        tasks: Sequence[str] = (),
        first: int = 0,
        job: Job | None = None,
    ) -> list[Episode]:
        """See `Player.play`."""
        config, agent = self._config, build_agent(spec, self._config)
        return play_pages(
            config, self._browser, agent, purpose, pages, self._metrics, tasks=tasks, first=first, job=job
        )


@contextmanager
def open_browser_player(config: Config, metrics: Metrics) -> Iterator[Player]:
    """A player with a browser of its own in this process."""
    with closing(open_browser(config, metrics)) as browser:
        yield BrowserPlayer(config, browser, metrics)
