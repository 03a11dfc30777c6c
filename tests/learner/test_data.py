"""Sampling: demonstrations by task, wrong goals that are wrong, a uniform replay buffer; the page's own reward."""

from __future__ import annotations

from collections import Counter
from dataclasses import fields

import numpy as np
import pytest

from giirl_core.gestures import BASIC, TYPE_WORDS
from giirl_core.nets.features import featurise
from giirl_core.types import NO_SPAN, Action, Episode, Outcome, Trajectory, Verb
from learner.data import Example, ExpertSampler, Replay, Step, featurise_trajectory, with_env_reward
from tests.learner.samples import FLAT, expert_episodes, page, trajectory, vectors

NAMES = ("Ada", "Bertram", "Clotilde")
NAME, PASSWORD = 3, 9  # words of the goal of `log_in`


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


def log_in(name: str, password: str) -> Trajectory:
    """A demonstration that types two texts into two fields, then presses Login."""
    filled = [("", ""), (name, ""), (name, password)]
    pages = [page("input_text", "input_password", "button:Login", value=(*texts, "")) for texts in filled]
    goal = f'The name "{name}" and the password "{password}".'
    typing = [Action(verb=Verb.TYPE, element=row, start=at, end=at) for row, at in ((0, NAME), (1, PASSWORD))]
    return trajectory(goal, pages, [*typing, Action(verb=Verb.CLICK, element=2)], task="log-in")


def test_a_step_is_wrong_with_the_words_of_another_too_early_or_before_the_page_is_done() -> None:
    shown = [log_in("Ada", "abc"), log_in("Bea", "bcd")]
    assert [action.text(shown[0].goal) for action in shown[0].actions[:2]] == ["Ada", "abc"]
    demos = sampler(shown)
    examples = demos.sample(60)
    on_own_page = {id(row): t for example in examples for t, row in enumerate(example.features)}
    found = Counter(
        (on_own_page.get(id(step.features)), step.choice.element, step.choice.start)
        for step in demos.wrong_steps(examples)
    )
    other_words, too_early = {(0, 0, PASSWORD), (1, 1, NAME)}, {(0, 2, NO_SPAN), (1, 2, NO_SPAN)}
    not_done = {(None, 2, NO_SPAN)}  # the page of the other demonstration, with other texts in its fields
    assert set(found) == other_words | too_early | not_done
    assert sum(found[key] for key in other_words) == sum(found[key] for key in too_early) == 60
    assert 15 < sum(found[key] for key in not_done) < 45


def test_a_step_that_the_demonstration_takes_anyway_is_not_wrong() -> None:
    twice = [Action(verb=Verb.CLICK, element=0)] * 2  # the last action is right before its turn too
    same = log_in("Ada", "Ada")  # both fields have the same text
    clicks = trajectory("Press the button twice.", [FLAT, FLAT], twice)
    single = [episode for episode in demonstrations() if len(episode) == 1]
    demos = sampler([same, clicks, *single])
    wrong = demos.wrong_steps(demos.sample(200))
    assert {(step.choice.element, len(step.features.element_flags)) for step in wrong} == {(2, 3)}  # Login, too early


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
