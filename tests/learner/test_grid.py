"""GIIRL in LanguageGridCraft: equations, sampling, and the loop of Algorithm 1 on a small grid."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import pytest
import torch

from giirl.run.grid import learn, pairs_of
from giirl_core.config import CloningConfig, Config, DiscriminatorConfig, GridConfig, NetConfig, PolicyConfig
from giirl_core.nets.parameters import hash_nets
from gridcraft.instructions import ColourPair
from gridcraft.layouts import Layout, named_layout
from gridcraft.planning import normalized_return, random_policy, solve
from gridcraft.world import ACTIONS, HORIZON, build_world, observations, true_reward
from learner.grid.learner import GridLearner, GridSoftQ, RewardFn, soft_target
from learner.grid.maxent import MaxEnt
from learner.grid.nets import GridFeatures, one_hot, policy_table, reward_table
from learner.grid.steps import GridDemos, Steps, expert_steps

SMALL = Config(
    world="gridcraft",
    iterations=3,
    rollout_batch=4,
    net=NetConfig(width=16),
    discriminator=DiscriminatorConfig(
        updates=2, batch=32, clip=8.0, gradient_penalty=0.2, policy_on_expert_states=0.0, rename_prob=0.0
    ),
    policy=PolicyConfig(updates=3, gamma=0.95, entropy=0.1),
    cloning=CloningConfig(learning_rate=1e-3, updates=1, batch=4),
    grid=GridConfig(random_episodes=10, demonstrations=2, batch=32, measure_every=1),
)
WORLD = build_world([named_layout("regions")])
PAIRS = pairs_of(SMALL.grid)


def with_grid(**changes: Any) -> Config:
    return dataclasses.replace(SMALL, grid=dataclasses.replace(SMALL.grid, **changes))


def with_discriminator(**changes: Any) -> Config:
    return dataclasses.replace(SMALL, discriminator=dataclasses.replace(SMALL.discriminator, **changes))


def test_the_soft_target_matches_the_naive_formula() -> None:
    reward, q = torch.tensor([0.5, -0.25]), torch.tensor([[0.1, 0.3, -0.2], [0.0, 0.0, 1.0]])
    got = soft_target(reward, q, 0.9, 0.2)
    for i in range(2):
        soft_max = 0.2 * math.log(sum(math.exp(value / 0.2) for value in q[i].tolist()))
        assert got[i].item() == pytest.approx(reward[i].item() + 0.9 * soft_max, rel=1e-5)


def test_the_loop_of_algorithm_1_runs_in_the_grid_and_reports_its_statistics() -> None:
    run = learn(SMALL)
    assert [point["step"] for point in run.curve] == [1, 2, 3]
    assert run.env_steps == (10 + 3 * 4) * HORIZON
    assert {"d_loss", "d_accuracy_expert", "d_accuracy_random_actions", "p_loss", "p_reward"} <= set(run.curve[-1])
    assert len(run.curve[-1]["returns"]) == len(PAIRS) == 6


def test_the_seed_determines_every_number() -> None:
    one, same, other = (learn(dataclasses.replace(SMALL, seed=seed)) for seed in (100, 100, 101))
    assert one.curve == same.curve
    hashes = [hash_nets(*run.learner.nets().values()) for run in (one, same, other)]
    assert hashes[0] == hashes[1] != hashes[2]


@pytest.fixture(scope="module")
def plain() -> str:
    return hash_nets(*learn(SMALL).learner.nets().values())


@pytest.mark.parametrize(
    "config",
    [
        with_discriminator(form="airl"),
        with_grid(absorbing=True),
        with_discriminator(lr_schedule="accuracy"),
        with_grid(full_map=True),
        with_grid(sentences="all", ngram_order=1, adjacent_cells=True),
        with_discriminator(reward="d"),
        with_discriminator(reward="log_d"),
        with_discriminator(gradient_penalty=0.0, policy_on_expert_states=0.5),
        with_discriminator(rename_prob=0.5),
        with_discriminator(rollouts=1.0, replay=0.0, random_actions=0.0, wrong_goal=0.0),
        dataclasses.replace(SMALL, algorithm="cloning"),
    ],
    ids=[
        "airl",
        "absorbing",
        "accuracy",
        "map",
        "sentences",
        "d",
        "log_d",
        "policy on expert states",
        "rename",
        "plain",
        "cloning",
    ],
)
def test_every_setting_of_the_ablations_changes_the_trained_networks(plain: str, config: Config) -> None:
    assert hash_nets(*learn(config).learner.nets().values()) != plain


def test_demonstrations_end_on_the_goal_and_never_enter_the_avoided_colour() -> None:
    rng = np.random.default_rng(0)
    steps = expert_steps(WORLD, [ColourPair("red", "blue")], [[4]], 20, 0.05, rng, None)
    states = steps.state.reshape(20, HORIZON)
    assert (WORLD.colour[states[:, -1]] == 1).all()
    assert not (WORLD.colour[states] == 3).any()
    assert (WORLD.next_state[steps.state, steps.action] == steps.following).all()
    assert set(steps.goal.tolist()) == {4}


def test_an_absorbing_episode_ends_in_the_end_state() -> None:
    end_state = len(WORLD)
    steps = expert_steps(WORLD, [ColourPair("red", "blue")], [[0]], 3, 0.1, np.random.default_rng(0), end_state)
    states, following = (x.reshape(3, HORIZON + 1) for x in (steps.state, steps.following))
    assert (following[:, -2:] == end_state).all()
    assert (states[:, -1] == end_state).all()
    assert (states[:, :-1] < end_state).all()


def test_wrong_goals_keep_the_step_and_avoid_states_that_their_expert_visits() -> None:
    learner = GridLearner(with_grid(sentences="all"), WORLD, PAIRS)
    expert = learner.demos.sample(50)
    wrong = learner.demos.wrong_goals(expert)
    assert 0 < len(wrong) < len(expert)
    demos = learner.demos.steps
    transitions = set(zip(demos.state, demos.action, demos.following, strict=True))
    assert transitions >= set(zip(wrong.state, wrong.action, wrong.following, strict=True))
    visited = set(zip(learner.pair_index[demos.goal], demos.state, strict=True))
    assert not visited & set(zip(learner.pair_index[wrong.goal], wrong.state, strict=True))


def test_a_single_pair_of_colours_has_no_wrong_goals() -> None:
    steps = expert_steps(WORLD, [ColourPair("red", "blue")], [[0]], 2, 0.1, np.random.default_rng(0), None)
    demos = GridDemos(steps, HORIZON, np.array([0]), np.array([0]), np.random.default_rng(0))
    assert len(demos.wrong_goals(steps)) == 0


def test_demonstrations_are_sampled_as_whole_episodes() -> None:
    learner = GridLearner(SMALL, WORLD, PAIRS)
    steps = learner.demos.sample(7)
    states, following = (x.reshape(7, HORIZON) for x in (steps.state, steps.following))
    assert (following[:, :-1] == states[:, 1:]).all()
    assert (steps.goal.reshape(7, HORIZON) == steps.goal[::HORIZON, None]).all()


def grid_policy(learner: GridLearner, reward_fn: RewardFn) -> GridSoftQ:
    """A fresh policy like the learner's, on another reward."""
    random = learner.discriminator._random
    return GridSoftQ(learner.config, learner.features, learner.goals, random, learner.rng, reward_fn)


def test_a_fresh_soft_q_learner_learns_from_a_frozen_reward() -> None:
    config = dataclasses.replace(
        SMALL, policy=dataclasses.replace(SMALL.policy, updates=400), grid=GridConfig(goals=("red-blue",))
    )
    world, pair = WORLD, ColourPair("red", "blue")
    learner = GridLearner(config, world, [pair])
    true = true_reward(world, pair)
    frozen = torch.tensor(solve(world, true, temperature=0.0).q * 0.1, dtype=torch.float32)  # already shaped

    def reward_fn(steps: Steps) -> torch.Tensor:
        return frozen[steps.state, steps.action]

    rollouts = learner.demos.sample(4)
    policy = grid_policy(learner, reward_fn)
    policy.update(rollouts, reward_fn(rollouts))
    got = policy_table(policy.net, learner.features, 0)
    assert normalized_return(world, got, true) > 0.9 > normalized_return(world, random_policy(world), true)


def test_the_discriminator_rewards_the_expert_more_than_the_random_policy() -> None:
    config = with_discriminator(updates=150, learning_rate=3e-3)
    learner = GridLearner(config, WORLD, PAIRS)
    expert = learner.demos.sample(30)
    random = learner.discriminator._random
    learner.discriminator.update(expert, random, learner.policy.net)
    reward_fn = learner.discriminator.reward_fn
    assert reward_fn(expert).mean() > 0.5 > -0.5 > reward_fn(random).mean()


def test_tables_match_the_network_outputs_of_each_state() -> None:
    learner = GridLearner(SMALL, WORLD, PAIRS)
    table = reward_table(learner.discriminator.net, learner.features, 2, "logit", 8.0)
    pi = policy_table(learner.policy.net, learner.features, 2)
    for state, action in ((0, 0), (17, 3), (len(WORLD) - 1, 4)):
        states, actions, goal = np.array([state]), np.array([action]), np.array([2])
        logit = learner.discriminator.net(learner.features.reward_inputs(states, goal), one_hot(actions))
        logp = learner.policy.net.log_policy(learner.features.policy_inputs(states, goal))
        assert table[state, action] == pytest.approx(logit.item(), abs=1e-5)
        assert np.log(pi[state]) == pytest.approx(logp[0].tolist(), abs=1e-4)
    assert pi.shape == (len(WORLD), len(ACTIONS))


def test_the_airl_reward_leaves_out_the_shaping_terms() -> None:
    learner = GridLearner(with_discriminator(form="airl"), WORLD, PAIRS)
    steps, d = learner.demos.sample(1), learner.discriminator
    inputs = learner.features.reward_inputs(steps.state, steps.goal)
    following = learner.features.reward_inputs(steps.following, steps.goal)
    got = d._shaping(steps, inputs, learner.policy.net)
    h, h_next = d.potential(inputs), d.potential(following)
    logp = learner.policy.net.log_policy(learner.features.policy_inputs(steps.state, steps.goal))
    for i in range(len(steps)):
        assert got[i].item() == pytest.approx((0.95 * h_next[i] - h[i] - logp[i, steps.action[i]]).item(), abs=1e-5)
    assert torch.equal(d.reward_fn(steps), d.net(inputs, one_hot(steps.action)).clamp(-8, 8))


def test_goal_features_depend_on_word_order_only_with_bigrams() -> None:
    texts = ["Go to Red. Avoid Blue.", "Go to Blue. Avoid Red."]
    for order, equal in ((1, True), (2, False)):
        learner = GridLearner(with_grid(ngram_order=order), WORLD, PAIRS)
        goals = GridFeatures(WORLD, texts, learner.bag, learner.config.grid).goals
        assert torch.equal(goals[0], goals[1]) == equal


def test_permuted_colours_give_the_layout_and_the_sentences_with_swapped_colours() -> None:
    config = with_grid(adjacent_cells=True)
    features = GridLearner(config, WORLD, PAIRS).features
    states, goals = features.colour_permutations
    assert torch.equal(states[0], features.states)
    assert torch.equal(goals[0], features.goals)
    order = list(itertools.permutations(("red", "green", "blue")))
    swap = order.index(("green", "red", "blue"))
    cells = WORLD.layouts[0].cells
    other = build_world([Layout(name="swapped", cells=np.array([0, 2, 1, 3], dtype=np.int8)[cells])])
    assert torch.equal(states[swap][:-1], torch.tensor(observations(other)))
    swapped = [
        PAIRS.index(ColourPair(*("red" if c == "green" else "green" if c == "red" else c for c in pair)))
        for pair in ((p.goal, p.avoid) for p in PAIRS)
    ]
    assert torch.equal(goals[swap], features.goals[swapped])


def test_renaming_gives_the_discriminator_the_same_steps_in_other_colours() -> None:
    learner = GridLearner(with_discriminator(rename_prob=1.0), WORLD, PAIRS)
    steps = learner.demos.sample(20)
    plain = learner.features.reward_inputs(steps.state, steps.goal)
    renamed = learner.discriminator._renamed_inputs(steps)
    assert renamed.shape == plain.shape
    assert not torch.equal(renamed, plain)
    assert torch.allclose(renamed.sum(dim=1), plain.sum(dim=1))


def test_q_learning_relabels_steps_with_every_sentence() -> None:
    learner = GridLearner(SMALL, WORLD, PAIRS)
    scored: list[Steps] = []

    def reward_fn(steps: Steps) -> torch.Tensor:
        scored.append(steps)
        return torch.zeros(len(steps))

    rollouts = learner.demos.sample(4).with_goals(np.zeros(4 * HORIZON, dtype=np.int64))
    grid_policy(learner, reward_fn).update(rollouts, torch.zeros(len(rollouts)))
    assert set(scored[0].goal.tolist()) == set(range(len(PAIRS)))


def test_maximum_entropy_learns_a_reward_whose_optimum_is_that_of_the_expert() -> None:
    config = with_grid(demonstrations=20)
    learner = GridLearner(config, WORLD, PAIRS)
    torch.manual_seed(0)
    baseline = MaxEnt(WORLD, learner.features, learner.demos.steps, width=32)
    distances = [baseline.update(0.01)["distance"] for _ in range(60)]
    assert distances[-1] < 0.4 * distances[0]
    for i, pair in enumerate(PAIRS):
        agent = solve(WORLD, reward_table(baseline.net, learner.features, i, "logit", 1e9)).pi
        assert normalized_return(WORLD, agent, true_reward(WORLD, pair)) > 0.9
