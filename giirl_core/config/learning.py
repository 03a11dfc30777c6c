"""The settings of the nets and of how they learn.

The docstring below a field is its entry in docs/configuration.md; the unit stands in brackets at its end. After a
change: `python -m giirl_core.config_reference > docs/configuration.md`.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from giirl_core.config.sections import SHOWN, STRICT, Positive, PositiveFloat, RewardForm, Share, Weight


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class NetConfig:
    """Architecture of the policy net and the reward net (after DOMNet, Liu et al. 2018)."""

    width: Annotated[int, Field(ge=4, multiple_of=4)] = 64
    """Width of the hidden layers. In the grid the Q-function is twice as wide. [units]"""
    vectors: Literal["glove", "hashed"] = "glove"
    """Word vectors: "glove" reads 50-dimensional GloVe, and WordNet's synonyms; "hashed" gives each word a random
    vector, needs no file, and has no synonyms."""
    word_order: bool = True
    """Read each word of the instruction with its neighbours. Without it the instruction is a bag of words."""
    goal_overlap: bool = True
    """Give the nets features that mark which words the instruction and the page have in common."""
    element_attention: bool = True
    """Let every element attend to all other elements of the page (self-attention)."""
    adjacent_elements: bool = False
    """Also read each element together with the elements directly next to it, as a check box with its label."""
    gestures: tuple[str, ...] = (SHOWN,)
    """What the policy can do besides `click` and `type words`, such as `["hover", "press Enter", "drag to"]`. `shown`
    stands for what at least three demonstrations show."""


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

    `rollouts`, `replay`, `policy_on_expert_states`, `random_actions`, `wrong_goal`, `wrong_step` and `feedback` weigh
    the sources of negative samples. Only their proportions matter. Plain Algorithm 1 has `rollouts` alone.
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
    rollouts: Weight = 0.1
    """Weight of steps from the newest rollouts. If this and `replay` are 0 the discriminator sees experts' pages alone,
    and cannot recognise the policy by its pages. [relative]"""
    replay: Weight = 0.1
    """Weight of steps from older rollouts. [relative]"""
    replay_size: Positive = 4096
    """Older trajectories that are kept, a uniform sample of all so far; in the grid the newest. [trajectories]"""
    policy_on_expert_states: Weight = 0.5
    """Weight of the policy's own actions in the states of the demonstrations. [relative]"""
    random_actions: Weight = 0.5
    """Weight of uniformly random actions, half in expert states and half in the policy's if `rollouts` is not 0.
    [relative]"""
    wrong_goal: Weight = 0.25
    """Weight of expert steps under another instruction of the same task. [relative]"""
    wrong_step: Weight = 0.0
    """Weight of expert steps that another step of the same demonstration makes wrong: with its words, before its turn,
    or after it under an instruction that asks for something else. [relative]"""
    feedback: Weight = 0.5
    """Weight of steps that people marked as wrong in `giirl feedback`. Without answers it has no effect. [relative]"""
    rename_prob: Share = 0.5
    """Probability that a sample's words are replaced by random ones, consistently in instruction and page."""
    position_jitter: Weight = 0.1
    """Largest shift of all positions of a renamed sample. [fractions of the page]"""
    gradient_penalty: Weight = 0.0
    """Weight of the zero-centred gradient penalty on the encoded page; in the grid on the input."""

    def __post_init__(self) -> None:
        weights = (self.rollouts, self.replay, self.policy_on_expert_states, self.random_actions)
        if not any((*weights, self.wrong_goal, self.wrong_step)):
            raise ValueError(
                "all sources of negatives have weight 0: wanted one above 0, rollouts=1 for plain Algorithm 1"
            )
        if self.lr_schedule == "accuracy" and not self.rollouts:
            raise ValueError(
                "discriminator.lr_schedule is 'accuracy' and discriminator.rollouts is 0: wanted rollouts above 0, "
                "whose accuracy is meant, or lr_schedule=linear"
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
    """Updates of behavioural cloning before the first rollout. Their learning rate falls linearly. [updates]"""
    frozen_iterations: Annotated[int, Field(ge=0)] = 0
    """Iterations at the start in which the policy follows no reward: its value and the discriminator are trained, and
    the policy goes on cloning if `cloning_updates` says so."""
    prior: Literal["uniform", "clone"] = "uniform"
    """Policy that the trained one stays close to, with weight `entropy`: the uniform policy (entropy), or the policy
    after `bc_warmup_updates` (KL divergence). With "clone" the discriminator begins with the encoder of that policy."""
    cloning_updates: Annotated[int, Field(ge=0)] = 0
    """Updates of behavioural cloning after each policy update, at the last learning rate of cloning. Algorithms without
    a reward ignore it. [updates]"""

    def __post_init__(self) -> None:
        if self.prior == "clone" and not self.bc_warmup_updates:
            raise ValueError("policy.prior is 'clone' and policy.bc_warmup_updates is 0: wanted at least 1 update")


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class CloningConfig:
    """Behavioural cloning on the same policy net."""

    learning_rate: PositiveFloat = 3e-3
    """Learning rate of the first iteration (Adam)."""
    final_lr_fraction: Share = 0.1
    """Learning rate of the last iteration, as a fraction of the first. In the grid it does not fall."""
    updates: Positive = 2
    """Gradient updates per iteration. [updates]"""
    batch: Positive = 64
    """Demonstrations in one update, all their steps. [episodes]"""
    rename_prob: Share = 0.5
    """As `discriminator.rename_prob`."""
    position_jitter: Weight = 0.1
    """As `discriminator.position_jitter`. [fractions of the page]"""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class SoftQConfig:
    """SQIL, IQ-Learn and Q-learning, on the same policy net."""

    learning_rate: PositiveFloat = 1e-3
    """Learning rate of the first iteration (Adam)."""
    final_lr_fraction: Share = 0.1
    """Learning rate of the last iteration, as a fraction of the first. It falls linearly in between."""
    updates: Positive = 4
    """Gradient updates per iteration. [updates]"""
    batch: Positive = 64
    """Expert steps in one update (none in Q-learning), and as many of the policy's. [steps]"""
    gamma: Share = 0.9
    """Discount factor per step."""
    temperature: PositiveFloat = 0.1
    """Temperature alpha of soft Q-learning, Q(s, a) = V(s) + alpha log pi(a | s). [reward per nat]"""
    rename_prob: Share = 0.5
    """As `discriminator.rename_prob`."""
    position_jitter: Weight = 0.1
    """As `discriminator.position_jitter`. [fractions of the page]"""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class GridConfig:
    """LanguageGridCraft. Read only with `world=gridcraft`.

    The settings of `discriminator`, `policy` and `cloning` hold there too.
    """

    layouts: tuple[str, ...] = ("regions",)
    """Names of layouts to play in."""
    random_layouts: Annotated[int, Field(ge=0)] = 0
    """Number of random layouts in addition. [layouts]"""
    layout_seed: Annotated[int, Field(ge=0)] = 1000
    """Seed of the first random layout; the others have the seeds after it."""
    colours: Annotated[tuple[str, ...], Field(min_length=2)] = ("red", "green", "blue")
    """Colours of the regions in random layouts and of the goals."""
    goals: tuple[str, ...] = ()
    """Goals to train on, "red-blue" for "Go to Red. Avoid Blue.". Empty takes all ordered pairs of the colours."""
    held_out: tuple[str, ...] = ()
    """Goals among them that training never sees."""
    sentences: Literal["plain", "all"] = "plain"
    """One sentence for each goal, or all synonyms and word orders."""
    ngram_order: Literal[1, 2] = 2
    """Longest n-grams counted in the instruction: single words (1), or also pairs of neighbouring words (2). [words]"""
    adjacent_cells: bool = False
    """Nets also see the four cells around the agent."""
    full_map: bool = False
    """The policy also sees the whole map. The reward never does."""
    demonstrations: Positive = 10
    """Demonstrations for each layout and goal. [episodes]"""
    random_episodes: Positive = 100
    """Episodes of the random policy, played before learning and kept for good. [episodes]"""
    batch: Positive = 256
    """Steps in one update of the soft Q-function. [steps]"""
    absorbing: bool = False
    """Add an absorbing state at the end of each episode, which the reward also scores."""
    measure_every: Positive = 5
    """Iterations between two exact measurements of the policy. [iterations]"""
