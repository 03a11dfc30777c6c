"""One frozen tree of settings, defaults beside their types; `giirl_core.config_file` reads and writes it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, ConfigDict, Field
from pydantic.dataclasses import dataclass

from giirl_core.algorithms import ALGORITHMS, WorldName, algorithm_names

STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)

MAX_ACTORS = 1024  # of a run: each has pages of its own

Positive = Annotated[int, Field(ge=1)]
Seconds = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Weight = Annotated[float, Field(ge=0)]


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class NetConfig:
    """The shape that policy and reward share."""

    width: Annotated[int, Field(ge=4, multiple_of=4)] = 64
    vectors: Literal["glove", "hashed"] = "glove"
    word_order: bool = True  # whether words are read with their neighbours; False makes the goal a bag of words
    goal_overlap: bool = True  # whether a net is told which words goal and page share
    element_attention: bool = True  # whether an element is read with the others around it
    adjacent_elements: bool = (
        False  # whether it is also read with whatever stands right beside it, as a box with its label
    )


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class DemosConfig:
    """Where demonstrations come from."""

    source: Literal["scripted", "file", "recordings"] = "scripted"
    path: str = ""  # a demonstration file, or the folder of public human recordings
    per_task: Positive = 100  # at most so many
    collections: tuple[str, ...] = ()  # folders of recordings to read, all when empty
    noise_fraction: Share = 0.0  # of each task's, replaced by episodes of somebody who does anything


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class ActorConfig:
    """Who plays."""

    count: Annotated[int, Field(ge=1, le=MAX_ACTORS)] = 1
    min_healthy: Positive = 1  # healthy actors below which the run gives up
    tabs: Positive = 8  # episodes an actor plays at once, all in one Chrome
    call_timeout_s: Seconds = 10.0  # deadline of one browser call
    launch_timeout_s: Seconds = 60.0
    score_timeout_s: Seconds = 5.0  # deadline of one scoring request
    heartbeat_timeout_s: Seconds = 60.0  # an actor not heard for so long is replaced


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class ScoringConfig:
    """Who tells actors what their episodes are worth."""

    replicas: Annotated[int, Field(ge=1, le=64)] = 1  # of the reward service


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class StreamConfig:
    """How far ahead actors may run, and how old a trajectory may be."""

    credits: Annotated[int, Field(ge=1, le=256)] = 32  # trajectories an actor may have under way
    policy_lag: Annotated[int, Field(ge=0, le=8)] = 4  # versions; older ones are dropped and counted; 0 is lock-step
    reward_lag: Annotated[int, Field(ge=0, le=1)] = 1  # versions behind the one in the making; older are computed again
    take_timeout_s: Seconds = 120.0  # the run gives up when the actors send nothing for so long


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class DiscriminatorConfig:
    """Binary logistic regression of expert from policy (eq. 3.2), and what keeps it honest.

    The weights say how much each source of negatives counts; only their proportions matter. All but `rollouts`
    at zero is Algorithm 1 as the thesis has it.
    """

    reward: Literal["logit", "d", "log_d", "gail", "goal"] = "logit"
    form: Literal["plain", "airl"] = "plain"  # "airl": D = e^f / (e^f + pi), f is the reward (Fu et al. 2018)
    train_on: Literal["all_steps", "final_steps"] = "all_steps"  # "final_steps": the last step of each episode (AGILE)
    discard_top_fraction: Share = 0.0  # top-scored share of the policy's own steps that is no negative (AGILE)
    clip: Annotated[float, Field(gt=0)] = 5.0  # bound on the logit, nats
    learning_rate: Annotated[float, Field(gt=0)] = 1e-3  # of the first iteration
    final_lr_fraction: Share = 0.1  # of it in the last one; in between it falls in a straight line
    lr_schedule: Literal["linear", "accuracy"] = "linear"  # "accuracy": falls as the policy catches up with the expert
    updates: Positive = 2  # per iteration
    batch: Positive = 64  # expert steps per update, and as many of every kind of negative
    rollouts: Weight = 0.25  # steps of the newest rollouts
    replay: Weight = 0.25  # steps of older rollouts
    replay_size: Positive = 4096  # trajectories kept, a uniform sample of all so far
    policy_on_expert_states: Weight = 0.5  # the policy's own actions on demonstration states
    random_actions: Weight = 0.5  # actions drawn at random, on the experts' and the policy's pages alike
    wrong_goal: Weight = 0.25  # expert steps under another goal of the same task
    rename_prob: Share = 0.5  # chance that a sample's words are consistently replaced
    position_jitter: Weight = 0.1  # shift of such a sample's positions, in pages
    gradient_penalty: Weight = 0.0  # zero-centred, on the encoded page

    def __post_init__(self) -> None:
        if not self.rollouts + self.replay + self.policy_on_expert_states + self.random_actions + self.wrong_goal:
            raise ValueError("all sources of negatives weigh 0; wanted at least one, rollouts=1 for plain Algorithm 1")


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class PolicyConfig:
    """Entropy-regularised, off-policy corrected actor-critic (eq. 3.1; V-trace, Espeholt et al. 2018)."""

    learning_rate: Annotated[float, Field(gt=0)] = 1e-3  # of the first iteration
    final_lr_fraction: Share = 0.1  # of it in the last one
    updates: Positive = 1  # per iteration
    gamma: Share = 0.9
    entropy: Annotated[float, Field(gt=0)] = 0.15  # alpha of eq. 3.1, nats of reward per nat of entropy
    final_entropy: Annotated[float, Field(gt=0, le=1)] = 0.3  # of it in the last iteration; the grid's stays as it is
    vtrace_weight: Weight = 1.0  # weight of the V-trace gradient on the actions taken
    sampled_actions: Annotated[int, Field(ge=0, multiple_of=2)] = (
        32  # actions on each page that the reward is asked about
    )
    value_loss_weight: Weight = 0.5
    bc_warmup_updates: Annotated[int, Field(ge=0)] = 0  # updates of behavioural cloning before the first rollout


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class CloningConfig:
    """Behavioural cloning on the same nets."""

    learning_rate: Annotated[float, Field(gt=0)] = 1e-3  # of the first iteration
    final_lr_fraction: Share = 0.1  # of it in the last one; the grid's stays as it is
    batch: Positive = 64
    rename_prob: Share = 0.5
    position_jitter: Weight = 0.1


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class SoftQConfig:
    """Imitation without a discriminator, on the policy's net: SQIL and IQ-Learn."""

    learning_rate: Annotated[float, Field(gt=0)] = 1e-3  # of the first iteration
    final_lr_fraction: Share = 0.1  # of it in the last one
    updates: Positive = 4  # per iteration
    batch: Positive = 64  # expert steps per update, and as many of the policy's
    gamma: Share = 0.9
    temperature: Annotated[float, Field(gt=0)] = 0.1  # alpha: Q(s, a) = V(s) + alpha log pi(a | s)
    rename_prob: Share = 0.5
    position_jitter: Weight = 0.1


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class EvaluateConfig:
    """How the result is measured."""

    episodes: Positive = 200  # fresh pages a task
    random_episodes: Positive = 200  # pages a task for the random policy


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class MetricsConfig:
    """Prometheus endpoints; port 0 takes any free one and writes it to the run folder."""

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 0


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class GridConfig:
    """LanguageGridCraft; read where world = "gridcraft", with what policy and discriminator say."""

    layouts: tuple[str, ...] = ("regions",)  # by name
    random_layouts: Annotated[int, Field(ge=0)] = 0  # as many more, of the seeds from layout_seed on
    layout_seed: Annotated[int, Field(ge=0)] = 1000
    colours: Annotated[tuple[str, ...], Field(min_length=2)] = ("red", "green", "blue")
    goals: tuple[str, ...] = ()  # "red-blue" goes to red and avoids blue; all ordered pairs of the colours when empty
    held_out: tuple[str, ...] = ()  # pairs among them that training never sees
    sentences: Literal["plain", "all"] = "plain"
    order: Literal[1, 2] = 2  # of the bag of words; 2 also counts neighbouring words
    neighbours: bool = False  # whether the four cells around are seen
    full_map: bool = False  # whether policies see the layout from above; a reward judges what is near
    demonstrations: Positive = 10  # per layout and goal
    random_episodes: Positive = 100  # played by chance before learning, kept for good
    batch: Positive = 256  # steps per soft Q update
    absorbing: bool = False  # whether an episode's end is a state that is judged too
    measure_every: Positive = 5  # iterations between exact measurements of the policy


def _known_algorithm(name: str) -> str:
    if name not in ALGORITHMS:
        raise ValueError(f"wanted {algorithm_names()}")
    return name


DEFAULT_TASKS = ("click-test", "click-test-2", "click-button", "enter-text")


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class Config:
    """Everything a run needs to know."""

    run: str = ""  # folder of the run; runs/NAME-TIME when empty
    world: WorldName = "miniwob"
    seed: Annotated[int, Field(ge=0, lt=1 << 16)] = 0
    runtime: Literal["serial", "local", "ray"] = "local"
    browser: Literal["chrome", "fake"] = "chrome"
    algorithm: Annotated[str, AfterValidator(_known_algorithm)] = "giirl"
    reward_from: str = ""  # with "frozen": the run whose reward a fresh policy is trained on
    tasks: Annotated[tuple[str, ...], Field(min_length=1)] = DEFAULT_TASKS
    held_out_goals: Annotated[float, Field(ge=0, lt=1)] = 0.0  # share of goals that training never sees
    iterations: Positive = 300  # N of Algorithm 1
    rollout_batch: Positive = 32  # episodes per iteration
    step_limit: Positive = 10  # actions per episode
    checkpoint_every: Positive = 50  # iterations
    keep_checkpoints: Positive = 3
    net: NetConfig = NetConfig()
    demos: DemosConfig = DemosConfig()
    actors: ActorConfig = ActorConfig()
    scoring: ScoringConfig = ScoringConfig()
    stream: StreamConfig = StreamConfig()
    discriminator: DiscriminatorConfig = DiscriminatorConfig()
    policy: PolicyConfig = PolicyConfig()
    cloning: CloningConfig = CloningConfig()
    soft_q: SoftQConfig = SoftQConfig()
    evaluate: EvaluateConfig = EvaluateConfig()
    metrics: MetricsConfig = MetricsConfig()
    grid: GridConfig = GridConfig()

    def __post_init__(self) -> None:
        spec = ALGORITHMS[self.algorithm]
        if self.world not in spec.worlds:
            wanted = algorithm_names(world=self.world)
            raise ValueError(f"algorithm {self.algorithm!r} does not play {self.world}: wanted {wanted}")
        if (spec.reward == "frozen") != bool(self.reward_from):
            raise ValueError(
                f"algorithm is {self.algorithm!r} and reward_from {self.reward_from!r}: "
                "'frozen' goes with reward_from=RUN, and nothing else does"
            )

        lock_step = self.stream.policy_lag == 0 and self.runtime != "serial"
        if lock_step and self.held_out_goals:
            raise ValueError(
                f"stream.policy_lag is 0 and held_out_goals is {self.held_out_goals}: in lock-step every page that is "
                "played is trained on; wanted one of them changed, or runtime=serial"
            )

    @property
    def quota(self) -> int:
        """Episodes of each task in a batch, where every task has equally many."""
        return -(-self.rollout_batch // len(self.tasks))
