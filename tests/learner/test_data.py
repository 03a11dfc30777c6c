"""Sampling: demonstrations by task, wrong goals that are wrong, a uniform replay buffer; the page's own reward."""

from __future__ import annotations

from collections import Counter
from dataclasses import fields

import numpy as np
import pytest

from giirl_core.gestures import BASIC, TYPE_WORDS
from giirl_core.nets.features import featurise
from giirl_core.types import Action, Episode, Outcome, Trajectory, Verb
from learner.data import Example, ExpertSampler, Replay, Step, featurise_trajectory, with_env_reward
from tests.learner.samples import FLAT, expert_episodes, page, trajectory, vectors

NAMES = ("Ada", "Bertram", "Clotilde")


def demonstrations(per_task: int = 12) -> list[Trajectory]:
    return [episode.trajectory for episode in expert_episodes(per_task)]


def sampler(demonstrations: list[Trajectory], seed: int = 0) -> ExpertSampler:
    return ExpertSampler(demonstrations, vectors(), np.random.default_rng(seed))


def enter(name: str) -> Trajectory:
    """A demonstration that types the name and presses Submit."""
    goal = f'Enter "{name}" and press Submit.'
    empty, full = page("input_text", "button:Submit"), page("input_text", "button:Submit", value=(name, ""))
    typing = Action(verb=Verb.TYPE, element=0, start=2, end=2)
    return trajectory(goal, [empty, full], [typing, Action(verb=Verb.CLICK, element=1)], task="enter-text")


def test_an_action_that_is_correct_under_every_goal_is_no_negative() -> None:
    demos = sampler([enter(name) for name in NAMES])
    wrong = demos.wrong_goals(demos.sample(300))
    assert len(wrong) > 50
    assert {BASIC[step.choice.gesture] for step in wrong} == {TYPE_WORDS}


def test_typed_text_that_the_wrong_goal_lacks_has_no_span() -> None:
    demos = sampler([enter(name) for name in NAMES])
    assert {(step.choice.start, step.choice.end) for step in demos.wrong_goals(demos.sample(50))} == {(-1, -1)}


def test_typed_text_gets_its_span_in_the_wrong_goal() -> None:
    first = trajectory(
        'Copy "Ada" for Bertram.', [page("input_text")], [Action(verb=Verb.TYPE, element=0, start=2, end=2)]
    )
    second = trajectory(
        'And now for Ada copy "Bertram".', [page("input_text")], [Action(verb=Verb.TYPE, element=0, start=6, end=6)]
    )
    demos = sampler([first, second])
    assert {step.choice.start for step in demos.wrong_goals(demos.sample(80))} == {3, 5}


def test_an_action_that_experts_take_under_a_goal_is_no_negative_under_it() -> None:
    clicks = [episode for episode in demonstrations(30) if episode.task == "click-button"]
    demos = sampler(clicks)
    examples = demos.sample(400)
    incorrect = {  # every click on the wrong button, as the features of its page under the other goal and its element
        (featurise(own.pages[0], other.goal, vectors()).element_flags.tobytes(), own.actions[0].element)
        for own in clicks
        for other in clicks
        if other.goal.utterance.split('"')[1] != own.pages[0].text[own.actions[0].element]
    }
    wrong = demos.wrong_goals(examples)
    assert wrong
    assert {(s.features.element_flags.tobytes(), s.choice.element) for s in wrong} <= incorrect


def test_tasks_with_a_single_goal_give_no_wrong_goals() -> None:
    demos = sampler([episode for episode in demonstrations() if episode.task in ("click-test", "click-test-2")])
    assert demos.wrong_goals(demos.sample(100)) == []


def test_tasks_are_sampled_equally_often_whatever_their_number_of_demonstrations() -> None:
    few = [enter("Ada")]
    many = [trajectory("Click Ok.", [FLAT], [Action(verb=Verb.CLICK, element=0)], seed=i) for i in range(20)]
    counts = Counter(example.trajectory.task for example in sampler([*few, *many]).sample(1000))
    assert counts["enter-text"] == pytest.approx(500, abs=70)


def test_sampling_depends_only_on_the_seed() -> None:
    episodes = demonstrations(4)

    def sampled(seed: int) -> list[int]:
        demos = sampler(episodes, seed)
        examples = demos.sample(20)
        return [e.trajectory.seed for e in examples] + [s.choice.element for s in demos.wrong_goals(examples)]

    assert sampled(1) == sampled(1)
    assert sampled(1) != sampled(2)


def test_sampling_without_demonstrations_is_an_error() -> None:
    with pytest.raises(ValueError, match="no demonstrations to learn from"):
        sampler([]).sample(1)


def test_the_replay_buffer_is_a_uniform_sample_of_all_trajectories_added() -> None:
    click = Action(verb=Verb.CLICK, element=0)
    examples = [featurise_trajectory(trajectory("Click Ok.", [FLAT], [click], seed=i), vectors()) for i in range(20)]
    rng, kept = np.random.default_rng(0), Counter[int]()
    for _ in range(1500):
        replay = Replay(5, rng)
        for start in (0, 3, 10):  # in batches, as rollouts are
            replay.add(examples[start : {0: 3, 3: 10, 10: 20}[start]])
        assert replay.seen == 20
        assert len(replay.examples) == 5
        kept.update(example.trajectory.seed for example in replay.examples)
    expected = 1500 * 5 / 20
    chi_squared = sum((kept[i] - expected) ** 2 / expected for i in range(20))
    assert chi_squared < 43.8  # the 0.1 % point of 19 degrees of freedom; the seed is fixed


def test_an_empty_replay_buffer_gives_no_trajectories() -> None:
    assert Replay(5, np.random.default_rng(0)).sample(10) == []


def test_training_data_has_no_field_for_an_outcome() -> None:
    assert {field.name for field in fields(Trajectory)} == {
        "task",
        "goal",
        "seed",
        "pages",
        "actions",
        "behaviour_logp",
        "rewards",
        "policy_version",
        "reward_version",
        "sampled",
    }
    assert {field.name for field in fields(Example)} == {"trajectory", "features", "choices"}
    assert {field.name for field in fields(Step)} == {"features", "choice"}


@pytest.mark.parametrize(("raw", "last"), [(1.0, 1.0), (0.4, 0.4), (0.0, 0.0), (-1.0, 0.0)])
def test_the_pages_own_reward_is_paid_at_the_end_and_a_failure_has_none(raw: float, last: float) -> None:
    episode = Episode(trajectory=enter("Ada"), outcome=Outcome(raw_reward=raw, ended=True))
    assert with_env_reward(episode).rewards.tolist() == [0.0, pytest.approx(last)]
