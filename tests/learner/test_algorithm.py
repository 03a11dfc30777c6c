"""Algorithm 1 in its order, and a learner that is saved and restored whole."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from giirl_core.algorithms import ALGORITHMS
from giirl_core.config import Config, DiscriminatorConfig, GridConfig, NetConfig, PolicyConfig
from giirl_core.config_file import load_config
from giirl_core.metrics import Metrics
from giirl_core.nets.parameters import hash_nets, load_net, seal_net
from giirl_core.types import Trajectory
from giirl_core.weights import Weights
from gridcraft.instructions import Pair
from gridcraft.layouts import named_layout
from gridcraft.world import build_world
from learner.algorithms import LOOPS
from learner.giirl import giirl
from learner.grid.learner import GridLearner
from learner.learner import Learner
from learner.protocols import BaselineLearning, Learning
from tests.learner.samples import expert_episodes, policy, reward_net

SMALL = Config(
    net=NetConfig(width=16, vectors="hashed"),
    discriminator=DiscriminatorConfig(batch=16, replay_size=6, updates=1),
    policy=PolicyConfig(sampled_actions=4),
)


@pytest.fixture(scope="module")
def demonstrations() -> list[Trajectory]:
    return [episode.trajectory for episode in expert_episodes(3)]


class Recorder:
    """Answers every call with its own name and remembers it."""

    def __init__(self) -> None:
        self.calls: list[tuple[Any, ...]] = []

    def part(self, name: str) -> Any:
        def call(*given: Any, **named: Any) -> Any:
            self.calls.append((name, *given, *named.values()))
            return {name: 1.0} if "update" in name else name

        return call


def test_algorithm_1_trains_the_reward_first_and_the_policy_on_that_reward_alone() -> None:
    log = Recorder()
    learner: Any = SimpleNamespace(
        featurise=log.part("featurise"),
        demos=SimpleNamespace(sample=log.part("expert")),
        discriminator=SimpleNamespace(update=log.part("d_update"), rewards=log.part("rewards")),
        policy=SimpleNamespace(update=log.part("p_update"), net="net"),
    )
    source: Any = SimpleNamespace(take=log.part("take"))
    giirl(SMALL, learner, source, range(3, 4), log.part("observe"))
    assert log.calls == [
        ("take", SMALL.rollout_batch),
        ("featurise", "take"),
        ("expert", SMALL.discriminator.batch),
        ("d_update", "expert", "featurise", "net"),
        ("rewards", "featurise", 4),
        ("p_update", "featurise", "rewards"),
        ("observe", 3, {"d_update": 1.0, "p_update": 1.0}),
    ]


def step(learner: Learner, shown: list[Trajectory], steps: int) -> None:
    """Go on with Algorithm 1, the demonstrations standing in for rollouts."""

    def observe(step: int, stats: dict[str, float]) -> None:
        learner.version = step + 1

    source: Any = SimpleNamespace(take=lambda episodes: shown[:4])
    LOOPS["giirl"](SMALL, learner, source, range(learner.version, learner.version + steps), observe)


def test_a_restored_learner_goes_on_as_the_saved_one_would(demonstrations: list[Trajectory], tmp_path: Path) -> None:
    one = Learner(SMALL, demonstrations, Metrics())
    step(one, demonstrations, 3)
    one.save(tmp_path)
    torch.manual_seed(12345)  # whatever else has drawn meanwhile
    two = Learner(SMALL, demonstrations, Metrics())
    two.load(tmp_path)
    assert two.hash() == one.hash()
    assert two.version == 3
    assert len(two.discriminator.replay.examples) == 6
    assert two.discriminator.replay.seen == 12
    step(one, demonstrations, 2)
    step(two, demonstrations, 2)
    assert two.hash() == one.hash()


@pytest.mark.parametrize(
    "lost", ["rng", "generator", "replay_seen", "policy_optimiser.safetensors", "reward_optimiser.safetensors"]
)
def test_nothing_that_is_saved_could_be_left_out(
    lost: str, demonstrations: list[Trajectory], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = Learner(SMALL, demonstrations, Metrics())
    fresh = Learner(SMALL, demonstrations, Metrics())
    step(one, demonstrations, 3)
    (tmp_path / "one").mkdir()
    (tmp_path / "fresh").mkdir()
    one.save(tmp_path / "one")
    fresh.save(tmp_path / "fresh")
    if lost.endswith(".safetensors"):
        (tmp_path / "fresh" / lost).replace(tmp_path / "one" / lost)
    else:
        state = json.loads((tmp_path / "one/learner.json").read_text())
        state[lost] = json.loads((tmp_path / "fresh/learner.json").read_text())[lost]
        (tmp_path / "one/learner.json").write_text(json.dumps(state))
    fresh.load(tmp_path / "one")
    step(one, demonstrations, 3)
    step(fresh, demonstrations, 3)
    assert fresh.hash() != one.hash()


def test_every_algorithm_has_one_row_of_facts_and_one_loop() -> None:
    assert set(LOOPS) == set(ALGORITHMS)


def test_an_unknown_algorithm_is_an_error_that_names_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"algorithm = 'reinforce': .*wanted 'giirl' or 'cloning' or "):
        load_config(None, ["algorithm=reinforce"])


@pytest.mark.parametrize("algorithm", [name for name, spec in ALGORITHMS.items() if "gridcraft" not in spec.worlds])
def test_an_algorithm_that_does_not_play_the_grid_is_an_error_that_names_those_that_do(algorithm: str) -> None:
    with pytest.raises(ValueError, match="does not play gridcraft: wanted 'giirl' or 'cloning'"):
        load_config(None, ["world=gridcraft", f"algorithm={algorithm}"])


def test_both_learners_have_the_parts_that_the_loops_use(demonstrations: list[Trajectory]) -> None:
    grid = Config(world="gridcraft", grid=GridConfig(random_episodes=1, demonstrations=1))
    in_grid: Learning = GridLearner(grid, build_world([named_layout("regions")]), [Pair("red", "blue")])  # mypy checks
    on_pages: BaselineLearning = Learner(SMALL, demonstrations, Metrics())
    for learner in (in_grid, on_pages):
        assert learner.policy.net is not None
        assert callable(learner.discriminator.rewards)


def test_a_net_sealed_and_loaded_is_the_same_net() -> None:
    one, two = policy(1), policy(2)
    assert hash_nets(one) != hash_nets(two)
    load_net(two, seal_net(one, 7))
    assert hash_nets(one) == hash_nets(two)


@pytest.mark.parametrize("wrong", ["another net", "no safetensors", "corrupt"])
def test_weights_that_do_not_fit_leave_the_net_as_it_was(wrong: str) -> None:
    net = policy(1)
    before, sealed = hash_nets(net), seal_net(policy(2), 7)
    bad = {
        "another net": seal_net(reward_net(), 7),
        "no safetensors": Weights.seal(7, b"nonsense"),
        "corrupt": Weights(version=7, blob=sealed.blob[:-1] + b"\x00", digest=sealed.digest),
    }[wrong]
    with pytest.raises(ValueError, match="weights version 7"):
        load_net(net, bad)
    assert hash_nets(net) == before


def test_the_word_table_is_not_part_of_the_weights() -> None:
    assert len(seal_net(policy(), 0).blob) < policy().encoder.table.nbytes
