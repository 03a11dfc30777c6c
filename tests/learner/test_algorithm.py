"""Algorithm 1 calls its parts in order, a restored learner continues like the saved one; schedules."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from giirl_core.algorithms import ALGORITHMS
from giirl_core.config import CloningConfig, Config, DiscriminatorConfig, GridConfig, NetConfig, PolicyConfig
from giirl_core.config_file import load_config
from giirl_core.metrics import Metrics
from giirl_core.nets.parameters import hash_nets, load_net, serialise_net
from giirl_core.types import Trajectory
from giirl_core.weights import Weights
from gridcraft.instructions import ColourPair
from gridcraft.layouts import named_layout
from gridcraft.world import build_world
from learner.algorithms import LOOPS
from learner.data import Example
from learner.giirl import giirl
from learner.grid.learner import GridLearner
from learner.learner import Learner
from learner.protocols import BaselineParts, LearnerParts
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
    """Makes parts of a learner that record each call and return their own name."""

    def __init__(self) -> None:
        self.calls: list[tuple[Any, ...]] = []

    def part(self, name: str) -> Any:
        def call(*args: Any, **kwargs: Any) -> Any:
            self.calls.append((name, *args, *kwargs.values()))
            return {name: 1.0} if "update" in name else name

        return call

    def learner(self, **more: Any) -> Any:
        """The parts that the loops on a reward have in common, and `more`."""
        return SimpleNamespace(
            featurise=self.part("featurise"),
            demos=SimpleNamespace(sample=self.part("expert")),
            discriminator=SimpleNamespace(update=self.part("d_update"), rewards=self.part("rewards")),
            policy=SimpleNamespace(update=self.part("p_update"), net="net"),
            **more,
        )


def test_algorithm_1_trains_the_reward_and_then_the_policy_on_that_reward_only() -> None:
    recorder = Recorder()
    source: Any = SimpleNamespace(take=recorder.part("take"))
    giirl(SMALL, recorder.learner(), source, range(3, 4), recorder.part("observe"))
    assert recorder.calls == [
        ("take", SMALL.rollout_batch),
        ("featurise", "take"),
        ("expert", SMALL.discriminator.batch),
        ("d_update", "expert", "featurise", "net"),
        ("rewards", "featurise", 4),
        ("p_update", "featurise", "rewards"),
        ("observe", 3, {"d_update": 1.0, "p_update": 1.0}),
    ]


@pytest.mark.parametrize("algorithm", ["giirl", "frozen", "true_reward", "wge"])
def test_every_policy_that_follows_a_reward_can_go_on_cloning(algorithm: str) -> None:
    recorder = Recorder()
    learner = recorder.learner(
        cloner=SimpleNamespace(update=recorder.part("clone_update")),
        carried_rewards=recorder.part("rewards"),
        successes=recorder.part("successes"),
        replay=SimpleNamespace(add=recorder.part("add"), sample=lambda episodes: []),
    )
    source: Any = SimpleNamespace(take=recorder.part("take"))
    config = replace(SMALL, policy=replace(SMALL.policy, cloning_updates=2))
    LOOPS[algorithm](config, learner, source, range(1), recorder.part("observe"))
    names = [name for name, *_ in recorder.calls]
    start = names.index("p_update") + 1
    assert names[start : start + 4] == ["expert", "clone_update"] * 2
    assert names.count("clone_update") == 2


def train(learner: Learner, demonstrations: list[Trajectory], steps: int) -> None:
    """Some iterations of Algorithm 1 with demonstrations in place of rollouts."""

    def observe(step: int, stats: dict[str, float]) -> None:
        learner.version = step + 1

    source: Any = SimpleNamespace(take=lambda episodes: demonstrations[:4])
    LOOPS["giirl"](SMALL, learner, source, range(learner.version, learner.version + steps), observe)


def test_a_restored_learner_continues_exactly_like_the_saved_one(
    demonstrations: list[Trajectory], tmp_path: Path
) -> None:
    one = Learner(SMALL, demonstrations, Metrics())
    train(one, demonstrations, 3)
    one.save(tmp_path)
    torch.manual_seed(12345)  # the global generator must not matter
    two = Learner(SMALL, demonstrations, Metrics())
    two.load(tmp_path)
    assert two.hash() == one.hash()
    assert two.version == 3
    assert len(two.discriminator.replay.examples) == 6
    assert two.discriminator.replay.seen == 12
    train(one, demonstrations, 2)
    train(two, demonstrations, 2)
    assert two.hash() == one.hash()


@pytest.mark.parametrize(
    "lost", ["rng", "generator", "replay_seen", "policy_optimiser.safetensors", "reward_optimiser.safetensors"]
)
def test_each_part_of_the_saved_state_is_needed_to_continue_exactly(
    lost: str, demonstrations: list[Trajectory], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = Learner(SMALL, demonstrations, Metrics())
    fresh = Learner(SMALL, demonstrations, Metrics())
    train(one, demonstrations, 3)
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
    train(one, demonstrations, 3)
    train(fresh, demonstrations, 3)
    assert fresh.hash() != one.hash()


def test_every_algorithm_has_a_spec_and_a_training_loop() -> None:
    assert set(LOOPS) == set(ALGORITHMS)


def test_the_error_for_an_unknown_algorithm_names_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"algorithm = 'reinforce': .*wanted 'giirl' or 'cloning' or "):
        load_config(None, ["algorithm=reinforce"])


@pytest.mark.parametrize("algorithm", [name for name, spec in ALGORITHMS.items() if "gridcraft" not in spec.worlds])
def test_the_error_for_an_algorithm_without_grid_support_names_those_with_it(algorithm: str) -> None:
    with pytest.raises(ValueError, match="does not play gridcraft: wanted 'giirl' or 'cloning'"):
        load_config(None, ["world=gridcraft", f"algorithm={algorithm}"])


def test_both_learners_implement_the_protocols_of_the_training_loops(demonstrations: list[Trajectory]) -> None:
    grid = Config(world="gridcraft", grid=GridConfig(random_episodes=1, demonstrations=1))
    in_grid: LearnerParts = GridLearner(
        grid, build_world([named_layout("regions")]), [ColourPair("red", "blue")]
    )  # checked by mypy
    on_pages: BaselineParts = Learner(SMALL, demonstrations, Metrics())
    for learner in (in_grid, on_pages):
        assert learner.policy.net is not None
        assert callable(learner.discriminator.rewards)


def test_loading_sealed_weights_reproduces_the_net() -> None:
    one, two = policy(1), policy(2)
    assert hash_nets(one) != hash_nets(two)
    load_net(two, serialise_net(one, 7))
    assert hash_nets(one) == hash_nets(two)


@pytest.mark.parametrize("wrong", ["another net", "no safetensors", "corrupt"])
def test_invalid_weights_are_an_error_and_do_not_change_the_net(wrong: str) -> None:
    net = policy(1)
    before, sealed = hash_nets(net), serialise_net(policy(2), 7)
    bad = {
        "another net": serialise_net(reward_net(), 7),
        "no safetensors": Weights.with_digest(7, b"nonsense"),
        "corrupt": Weights(version=7, blob=sealed.blob[:-1] + b"\x00", digest=sealed.digest),
    }[wrong]
    with pytest.raises(ValueError, match="weights version 7"):
        load_net(net, bad)
    assert hash_nets(net) == before


def test_the_weights_do_not_contain_the_word_vectors() -> None:
    assert len(serialise_net(policy(), 0).blob) < policy().encoder.table.nbytes


# --- schedules


def test_the_learning_rate_falls_while_the_policy_is_cloned_before_the_first_iteration() -> None:
    demonstrations = [episode.trajectory for episode in expert_episodes(1)]
    config = Config(
        net=NetConfig(width=16, vectors="hashed"),
        policy=PolicyConfig(bc_warmup_updates=4),
        cloning=CloningConfig(learning_rate=1e-3, final_lr_fraction=0.2, batch=1),
    )
    learner = Learner(config, demonstrations, Metrics())
    rates: list[float] = []
    update = learner.cloner.update

    def record(expert: Sequence[Example]) -> dict[str, float]:
        rates.append(learner.cloner.optimiser.param_groups[0]["lr"])
        return update(expert)

    learner.cloner.update = record  # type: ignore[method-assign]
    assert len([*learner.bc_warmup()]) == 4
    assert rates == pytest.approx([1e-3, 0.8e-3, 0.6e-3, 0.4e-3])


def test_with_a_cloned_prior_the_discriminator_begins_with_the_encoder_of_the_clone() -> None:
    config = Config(net=NetConfig(width=16, vectors="hashed"), policy=PolicyConfig(bc_warmup_updates=2, prior="clone"))
    learner = Learner(config, [episode.trajectory for episode in expert_episodes(1)], Metrics())
    mine, clones = (net.encoder.state_dict() for net in (learner.discriminator.model.net, learner.policy.net))
    assert not all(torch.equal(mine[name], value) for name, value in clones.items())
    list(learner.bc_warmup())
    assert all(torch.equal(mine[name], value) for name, value in clones.items())


def test_the_accuracy_schedule_lowers_the_rate_from_accuracy_1_to_one_half() -> None:
    demonstrations = [episode.trajectory for episode in expert_episodes(1)]
    config = Config(
        net=NetConfig(width=16, vectors="hashed"),
        discriminator=DiscriminatorConfig(lr_schedule="accuracy", learning_rate=1.0, final_lr_fraction=0.1),
    )
    learner = Learner(config, demonstrations, Metrics())
    for accuracy, rate in ((1.0, 1.0), (0.75, 0.55), (0.5, 0.1), (0.0, 0.1)):
        learner.discriminator.accuracy = accuracy
        learner.anneal(config.iterations // 2)
        assert learner.discriminator.optimiser.param_groups[0]["lr"] == pytest.approx(rate)


@pytest.mark.parametrize(("algorithm", "rate"), [("giirl", 0.2), ("true_reward", 0.2), ("cloning", 0.6)])
def test_who_goes_on_cloning_does_so_at_the_last_rate_and_cloning_itself_keeps_its_schedule(
    algorithm: str, rate: float
) -> None:
    config = Config(
        algorithm=algorithm,
        iterations=101,
        net=NetConfig(width=16, vectors="hashed"),
        policy=PolicyConfig(cloning_updates=1),
        cloning=CloningConfig(learning_rate=1.0, final_lr_fraction=0.2),
    )
    learner = Learner(config, [episode.trajectory for episode in expert_episodes(1)], Metrics())
    learner.anneal(50)
    assert learner.cloner.optimiser.param_groups[0]["lr"] == pytest.approx(rate)


def test_learning_rates_and_entropy_decay_linearly() -> None:
    demonstrations = [episode.trajectory for episode in expert_episodes(1)]
    config = Config(
        iterations=101,
        net=NetConfig(width=16, vectors="hashed"),
        policy=PolicyConfig(learning_rate=1.0, final_lr_fraction=0.2, entropy=0.5, final_entropy_fraction=0.4),
        cloning=CloningConfig(learning_rate=2.0, final_lr_fraction=0.2),
    )
    learner = Learner(config, demonstrations, Metrics())
    for step, rate, entropy in ((0, 1.0, 0.5), (50, 0.6, 0.35), (100, 0.2, 0.2)):
        learner.anneal(step)
        assert learner.policy.optimiser.param_groups[0]["lr"] == pytest.approx(rate)
        assert learner.cloner.optimiser.param_groups[0]["lr"] == pytest.approx(2 * rate)
        assert learner.policy.entropy == pytest.approx(entropy)
