"""Every setting of a run in one frozen tree; `giirl_core.config_file` reads and writes it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field
from pydantic.dataclasses import dataclass

from giirl_core.algorithms import ALGORITHMS, WorldName, algorithm_names
from giirl_core.config.learning import (
    CloningConfig,
    DiscriminatorConfig,
    GridConfig,
    LearnerConfig,
    NetConfig,
    PolicyConfig,
    SoftQConfig,
)
from giirl_core.config.sections import (
    MAX_ACTORS,
    STRICT,
    ActorConfig,
    DemosConfig,
    EvaluateConfig,
    MetricsConfig,
    Place,
    Positive,
    ScoringConfig,
    StreamConfig,
)

__all__ = [
    "DEFAULT_TASKS",
    "MAX_ACTORS",
    "STRICT",
    "ActorConfig",
    "CloningConfig",
    "Config",
    "DemosConfig",
    "DiscriminatorConfig",
    "EvaluateConfig",
    "GridConfig",
    "LearnerConfig",
    "MetricsConfig",
    "NetConfig",
    "PolicyConfig",
    "ScoringConfig",
    "SoftQConfig",
    "StreamConfig",
]

MAX_OPEN_PAGES = 64  # unless the settings say more: a page takes about 18 MB
DEFAULT_TASKS = ("click-test", "click-test-2", "click-button", "enter-text")


def _known_algorithm(name: str) -> str:
    if name not in ALGORITHMS:
        raise ValueError(f"wanted {algorithm_names()}")
    return name


Algorithm = Annotated[str, AfterValidator(_known_algorithm), Field(json_schema_extra={"enum": list(ALGORITHMS)})]


ON_PAGES_ALONE = (  # settings that the grid does not know
    "policy.prior",
    "policy.bc_warmup_updates",
    "policy.frozen_iterations",
    "policy.cloning_updates",
    "discriminator.wrong_step",
)


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class Config:
    """All settings of a run."""

    run: Place = ""
    """Folder of the run. Empty makes `runs/NAME-TIME`."""
    world: WorldName = "miniwob"
    """MiniWoB pages in a browser, or LanguageGridCraft."""
    seed: Annotated[int, Field(ge=0, lt=1 << 16)] = 0
    """Seed of the nets, of all sampling and of the pages."""
    runtime: Literal["serial", "local", "ray"] = "local"
    """Everything in one thread, Ray processes on this machine, or Ray processes on a cluster."""
    log: Literal["text", "json"] = "text"
    """Warnings as lines of text, or as one JSON object each."""
    browser: Literal["chrome", "fake"] = "chrome"
    """Real Chrome, or the fake browser of the tests, which plays a few tasks."""
    algorithm: Algorithm = "giirl"
    """What is trained; each is described in docs/algorithms.md. The grid has giirl and cloning."""
    reward_from: Place = ""
    """With `algorithm=frozen`, and only there: the run whose learned reward is used."""
    tasks: Annotated[tuple[str, ...], Field(min_length=1)] = DEFAULT_TASKS
    """Tasks to train and evaluate on, with one policy and one reward for all: names of MiniWoB tasks, task files of
    own pages (`tasks/invoices.toml`), or folders of them (`tasks/`)."""
    held_out_goals: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Fraction of all instructions that training and demonstrations never contain."""
    iterations: Positive = 300
    """Iterations of Algorithm 1. [iterations]"""
    rollout_batch: Positive = 32
    """Episodes that each iteration takes from the actors; `serial` takes equally many of each task, at least one.
    [episodes]"""
    step_limit: Positive = 10
    """Longest episode. One that has not ended by then counts as failed. [actions]"""
    checkpoint_every: Positive = 50
    """Iterations between two checkpoints. [iterations]"""
    keep_checkpoints: Positive = 3
    """Newest checkpoints that are kept. [checkpoints]"""
    net: NetConfig = NetConfig()
    demos: DemosConfig = DemosConfig()
    actors: ActorConfig = ActorConfig()
    scoring: ScoringConfig = ScoringConfig()
    stream: StreamConfig = StreamConfig()
    learner: LearnerConfig = LearnerConfig()
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
                "wanted reward_from=RUN with algorithm=frozen, and only with it"
            )
        for key in ON_PAGES_ALONE if self.world == "gridcraft" else ():
            section, name = key.split(".")
            own = getattr(self, section)
            value, wanted = (getattr(one, name) for one in (own, type(own)()))
            if value != wanted:
                raise ValueError(f"{key} is {value!r} and world 'gridcraft': wanted {name}={wanted}, or world=miniwob")
        if self.algorithm == "cloning" and self.policy.bc_warmup_updates:
            raise ValueError(
                "algorithm is 'cloning', which clones in every iteration, and policy.bc_warmup_updates "
                f"{self.policy.bc_warmup_updates}: wanted bc_warmup_updates=0 and policy.prior=uniform"
            )
        lock_step = self.stream.policy_lag == 0 and self.runtime != "serial"
        if lock_step and self.held_out_goals:
            raise ValueError(
                f"stream.policy_lag is 0 and held_out_goals is {self.held_out_goals}: lock-step trains on every "
                "episode and cannot drop those of held-out goals; wanted one of the two changed, or runtime=serial"
            )

    @property
    def sampled_actions(self) -> int:
        """Actions that an actor samples on each page for the reward to score; 0 where no learned reward is read."""
        return self.policy.sampled_actions if ALGORITHMS[self.algorithm].has_learned_reward else 0

    @property
    def open_pages(self) -> int:
        """Tabs that an actor opens for training."""
        return self.actors.open_pages or max(self.actors.tabs, min(len(self.tasks), MAX_OPEN_PAGES))

    @property
    def quota(self) -> int:
        """Episodes of each task in a batch that has equally many of every task."""
        return -(-self.rollout_batch // len(self.tasks))
