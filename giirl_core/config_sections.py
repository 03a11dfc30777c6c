"""The sections of the settings tree, with defaults and allowed ranges next to the types.

The docstring below a field is its entry in docs/configuration.md; the unit stands in brackets at its end. After a
change: `python -m giirl_core.config_reference > docs/configuration.md`.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

STRICT = ConfigDict(extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)

MAX_ACTORS = 1024  # the index of an actor is part of its page seeds

Positive = Annotated[int, Field(ge=1)]
Port = Annotated[int, Field(ge=0, le=65535)]
Seconds = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Weight = Annotated[float, Field(ge=0)]
PositiveFloat = Annotated[float, Field(gt=0)]
RewardForm = Literal["logit", "d", "log_d", "gail", "goal"]  # giirl_core/nets/reward.py has the formulas


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class NetConfig:
    """Architecture of the policy net and the reward net (after DOMNet, Liu et al. 2018)."""

    width: Annotated[int, Field(ge=4, multiple_of=4)] = 64
    """Width of the hidden layers. In the grid the Q-function is twice as wide. [units]"""
    vectors: Literal["glove", "hashed"] = "glove"
    """Word vectors: "glove" reads 50-dimensional GloVe, "hashed" gives each word a random vector and needs no file."""
    word_order: bool = True
    """Read each word of the instruction with its neighbours. Without it the instruction is a bag of words."""
    goal_overlap: bool = True
    """Give the nets features that mark which words the instruction and the page have in common."""
    element_attention: bool = True
    """Let every element attend to all other elements of the page (self-attention)."""
    adjacent_elements: bool = False
    """Also read each element together with the elements directly next to it, as a check box with its label."""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class DemosConfig:
    """Where demonstrations come from. Only successful ones are used."""

    source: Literal["scripted", "file", "recordings"] = "scripted"
    """Scripted experts, a file written by `giirl demos`, or a folder of public human recordings."""
    path: str = ""
    """The demonstration file, or the folder of recordings. Unused with scripted experts."""
    per_task: Positive = 100
    """Largest number of demonstrations of each task. [episodes]"""
    collections: tuple[str, ...] = ()
    """Sub-folders of the recordings to read. Empty reads all of them."""
    noise_fraction: Share = 0.0
    """Fraction of each task's demonstrations that is replaced by episodes of the random policy."""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class ActorConfig:
    """The processes that play episodes."""

    count: Annotated[int, Field(ge=1, le=MAX_ACTORS)] = 1
    """Number of actors. `giirl actors` changes it during a run. [processes]"""
    min_healthy: Positive = 1
    """The run ends with an error when fewer actors than this are left. [processes]"""
    tabs: Positive = 8
    """Episodes that one actor plays at the same time, each in a tab of one Chrome. [tabs]"""
    open_pages: Annotated[int, Field(ge=0, le=256)] = 0
    """Pages that one actor keeps open in training, while `tabs` of them are played. 0: one for each task, from `tabs`
    to 64. [tabs]"""
    step_delay_s: Annotated[float, Field(ge=0, le=60)] = 0.0
    """Simulated time of every step, for experiments on pages that respond slowly. [s]"""
    call_timeout_s: Seconds = 10.0
    """Deadline of one call to the browser. [s]"""
    launch_timeout_s: Seconds = 60.0
    """Deadline of starting Chrome. [s]"""
    score_timeout_s: Seconds = 1.0
    """Deadline of one request to a reward service. After a second try the learner computes the rewards. [s]"""
    heartbeat_timeout_s: Seconds = 60.0
    """An actor that sends nothing for this long is replaced. [s]"""
    cpus: Weight = 1.0
    """Cores that an actor asks for on a cluster; `local` asks for nothing. [cores]"""
    memory_mb: Weight = 1000.0
    """Memory that an actor asks for on a cluster. 0 asks for none. [MB]"""
    chrome: Weight = 0.0
    """Units of the resource `chrome` that an actor asks for. A node of a cluster offers some with
    `ray start --resources='{"chrome": 8}'`; where no node does, leave it at 0. [units]"""
    place_timeout_s: Seconds = 24 * 3600.0
    """An actor or reward service for which no node of a cluster has room for this long is given up. [s]"""
    orphan_timeout_s: Annotated[float, Field(ge=10)] = 300.0
    """An actor or reward service that hears nothing of a learner for this long ends itself. A run that is resumed
    before goes on with it. [s]"""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class ScoringConfig:
    """The reward service, which computes rewards for the actors."""

    replicas: Annotated[int, Field(ge=1, le=64)] = 1
    """Number of reward services. An actor asks the least loaded one. On a cluster they are on different nodes where
    there are enough. [processes]"""
    cpus: Weight = 0.0
    """Cores that a reward service asks for on a cluster. [cores]"""
    memory_mb: Weight = 0.0
    """Memory that a reward service asks for on a cluster. 0 asks for none. [MB]"""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class StreamConfig:
    """How far actors may run ahead of the learner, and how old a trajectory may be."""

    credits: Annotated[int, Field(ge=1, le=1024)] = 256
    """Most trajectories of one actor that may be played, scored, sent or queued at a time. Flow control allows fewer,
    so that none grows stale. [trajectories]"""
    policy_lag: Annotated[int, Field(ge=0, le=8)] = 4
    """Trajectories of a policy further behind than this are dropped and counted. 0 is lock-step. [versions]"""
    reward_lag: Annotated[int, Field(ge=0, le=8)] = 4
    """Rewards further behind than this are computed again by the learner. [versions]"""
    take_timeout_s: Seconds = 120.0
    """The run ends with an error when the actors send too few trajectories for this long. [s]"""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class LearnerConfig:
    """Where the learner computes."""

    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Device of the nets in training. `auto` is a CUDA device if there is one; in `serial` it is the CPU."""
    threads: Annotated[int, Field(ge=0)] = 0
    """CPU threads of the learner. 0 is automatic: one in `serial`, in `local` the cores that the actors leave free (at
    least one), in `ray` all cores of the learner's node. [threads]"""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class DiscriminatorConfig:
    """Discriminator: logistic regression of expert against policy (Luo 2019, eq. 3.2).

    `rollouts`, `replay`, `policy_on_expert_states`, `random_actions` and `wrong_goal` weigh the sources of negative
    samples. Only their proportions matter. Plain Algorithm 1 has `rollouts` alone.
    """

    reward: RewardForm = "logit"
    """How the logit becomes a reward; the forms are in docs/algorithms.md."""
    form: Literal["plain", "airl"] = "plain"
    """What the discriminator is: sigmoid of a net, or AIRL's e^f / (e^f + pi) with the reward f (Fu et al. 2018)."""
    train_on: Literal["all_steps", "final_steps"] = "all_steps"
    """Train on any step of an episode, or on the last one only, as AGILE does."""
    discard_top_fraction: Share = 0.0
    """Fraction of the policy's own steps, the highest scored ones, that is not used as negatives (AGILE)."""
    clip: PositiveFloat = 5.0
    """The reward is computed from the logit clipped to this absolute value. [nats]"""
    learning_rate: PositiveFloat = 1e-3
    """Learning rate of the first iteration (Adam)."""
    final_lr_fraction: Share = 0.1
    """Learning rate of the last iteration, as a fraction of the first. It falls linearly in between."""
    lr_schedule: Literal["linear", "accuracy"] = "linear"
    """What lowers the learning rate: the iteration, or the discriminator's accuracy as it approaches 1/2."""
    updates: Positive = 2
    """Gradient updates per iteration. [updates]"""
    batch: Positive = 64
    """Expert steps in one update, and as many of every source of negatives. [steps]"""
    rollouts: Weight = 0.25
    """Weight of steps from the newest rollouts. [relative]"""
    replay: Weight = 0.25
    """Weight of steps from older rollouts. [relative]"""
    replay_size: Positive = 4096
    """Older trajectories that are kept, a uniform sample of all so far; in the grid the newest. [trajectories]"""
    policy_on_expert_states: Weight = 0.5
    """Weight of the policy's own actions in the states of the demonstrations. [relative]"""
    random_actions: Weight = 0.5
    """Weight of uniformly random actions, half in expert states and half in the policy's. [relative]"""
    wrong_goal: Weight = 0.25
    """Weight of expert steps under another instruction of the same task. [relative]"""
    rename_prob: Share = 0.5
    """Probability that a sample's words are replaced by random ones, consistently in instruction and page."""
    position_jitter: Weight = 0.1
    """Largest shift of all positions of a renamed sample. [fractions of the page]"""
    gradient_penalty: Weight = 0.0
    """Weight of the zero-centred gradient penalty on the encoded page; in the grid on the input."""

    def __post_init__(self) -> None:
        if not self.rollouts + self.replay + self.policy_on_expert_states + self.random_actions + self.wrong_goal:
            raise ValueError(
                "all sources of negatives have weight 0: wanted one above 0, rollouts=1 for plain Algorithm 1"
            )


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class PolicyConfig:
    """Policy: entropy-regularised actor-critic (Luo 2019, eq. 3.1).

    V-trace (Espeholt et al. 2018) corrects for rollouts of an older policy.
    """

    learning_rate: PositiveFloat = 1e-3
    """Learning rate of the first iteration (Adam)."""
    final_lr_fraction: Share = 0.1
    """Learning rate of the last iteration, as a fraction of the first. It falls linearly in between."""
    updates: Positive = 1
    """Gradient updates per iteration. [updates]"""
    gamma: Share = 0.9
    """Discount factor per step."""
    entropy: PositiveFloat = 0.15
    """Entropy weight alpha of the first iteration. [nats of reward per nat of entropy]"""
    final_entropy_fraction: Annotated[float, Field(gt=0, le=1)] = 0.3
    """Entropy weight of the last iteration, as a fraction of the first. In the grid it does not fall."""
    vtrace_weight: Weight = 1.0
    """Weight of the V-trace policy gradient on the actions taken. [relative]"""
    sampled_actions: Annotated[int, Field(ge=0, multiple_of=2)] = 32
    """Actions sampled on each page and scored by the reward, half policy, half random. 0 is off. [actions]"""
    value_loss_weight: Weight = 0.5
    """Weight of the squared error of the value. [relative]"""
    bc_warmup_updates: Annotated[int, Field(ge=0)] = 0
    """Updates of behavioural cloning before the first rollout. [updates]"""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class CloningConfig:
    """Behavioural cloning on the same policy net."""

    learning_rate: PositiveFloat = 1e-3
    """Learning rate of the first iteration (Adam)."""
    final_lr_fraction: Share = 0.1
    """Learning rate of the last iteration, as a fraction of the first. In the grid it does not fall."""
    batch: Positive = 64
    """Demonstrations in one update, all their steps. There is one update per iteration. [episodes]"""
    rename_prob: Share = 0.5
    """As `discriminator.rename_prob`."""
    position_jitter: Weight = 0.1
    """As `discriminator.position_jitter`. [fractions of the page]"""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class SoftQConfig:
    """SQIL and IQ-Learn: imitation without a discriminator, on the same policy net."""

    learning_rate: PositiveFloat = 1e-3
    """Learning rate of the first iteration (Adam)."""
    final_lr_fraction: Share = 0.1
    """Learning rate of the last iteration, as a fraction of the first. It falls linearly in between."""
    updates: Positive = 4
    """Gradient updates per iteration. [updates]"""
    batch: Positive = 64
    """Expert steps in one update, and as many of the policy's. [steps]"""
    gamma: Share = 0.9
    """Discount factor per step."""
    temperature: PositiveFloat = 0.1
    """Temperature alpha of soft Q-learning, Q(s, a) = V(s) + alpha log pi(a | s). [reward per nat]"""
    rename_prob: Share = 0.5
    """As `discriminator.rename_prob`."""
    position_jitter: Weight = 0.1
    """As `discriminator.position_jitter`. [fractions of the page]"""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class EvaluateConfig:
    """How the result is measured."""

    episodes: Positive = 200
    """Fresh pages of each task for the greedy policy. [episodes]"""
    random_episodes: Positive = 200
    """Fresh pages of each task for the random baseline. [episodes]"""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class MetricsConfig:
    """The Prometheus endpoint of each process."""

    host: str = "127.0.0.1"
    """Address that every process listens on. 0.0.0.0 and :: are all addresses of its machine."""
    port: Port = 0
    """Port of the learner; 0 takes any free one."""
    worker_port: Port = 0
    """Actors and reward services take the first free port from here on; 0 takes any free one."""
