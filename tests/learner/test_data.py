"""How steps are drawn: experts evenly by task, wrong goals that are truly wrong, and a fair memory."""

from __future__ import annotations

from collections import Counter
from dataclasses import fields

import numpy as np
import pytest

from giirl_core.nets.features import featurise
from giirl_core.types import Action, Trajectory, Verb
from learner.data import Example, ExpertSampler, Replay, Step, featurise_trajectory
from tests.learner.samples import FLAT, expert_episodes, page, trajectory, vectors

NAMES = ("Ada", "Bertram", "Clotilde")


def demonstrations(per_task: int = 12) -> list[Trajectory]:
    return [episode.trajectory for episode in expert_episodes(per_task)]


def sampler(shown: list[Trajectory], seed: int = 0) -> ExpertSampler:
    return ExpertSampler(shown, vectors(), np.random.default_rng(seed))


def enter(name: str) -> Trajectory:
    """Type the name, then press Submit."""
    goal = f'Enter "{name}" and press Submit.'
    empty, full = page("input_text", "button:Submit"), page("input_text", "button:Submit", value=(name, ""))
    typing = Action(verb=Verb.TYPE, element=0, start=2, end=2)
    return trajectory(goal, [empty, full], [typing, Action(verb=Verb.CLICK, element=1)], task="enter-text")


def test_submit_is_right_under_every_goal_and_so_is_no_negative() -> None:
    demos = sampler([enter(name) for name in NAMES])
    wrong = demos.wrong_goals(demos.sample(300))
    assert len(wrong) > 50
    assert {step.action.verb for step in wrong} == {Verb.TYPE}


def test_text_typed_under_a_goal_that_lacks_it_points_at_no_word() -> None:
    demos = sampler([enter(name) for name in NAMES])
    assert {(step.action.start, step.action.end) for step in demos.wrong_goals(demos.sample(50))} == {(-1, -1)}


def test_text_that_the_other_goal_holds_elsewhere_is_pointed_at_there() -> None:
    first = trajectory(
        'Copy "Ada" for Bertram.', [page("input_text")], [Action(verb=Verb.TYPE, element=0, start=2, end=2)]
    )
    second = trajectory(
        'And now for Ada copy "Bertram".', [page("input_text")], [Action(verb=Verb.TYPE, element=0, start=6, end=6)]
    )
    demos = sampler([first, second])
    assert {step.action.start for step in demos.wrong_goals(demos.sample(80))} == {3, 5}


def test_a_wrong_goal_never_holds_an_action_that_an_expert_does_under_it() -> None:
    shown = [episode for episode in demonstrations(30) if episode.task == "click-button"]
    demos = sampler(shown)
    drawn = demos.sample(400)
    by_features = {  # every click that is wrong, by what its page looks like under every other goal
        (featurise(own.pages[0], other.goal, vectors()).element_flags.tobytes(), own.actions[0].element)
        for own in shown
        for other in shown
        if other.goal.utterance.split('"')[1] != own.pages[0].text[own.actions[0].element]
    }
    wrong = demos.wrong_goals(drawn)
    assert wrong
    assert {(s.features.element_flags.tobytes(), s.action.element) for s in wrong} <= by_features


def test_tasks_with_one_goal_have_no_wrong_one() -> None:
    shown = [episode for episode in demonstrations() if episode.task in ("click-test", "click-test-2")]
    demos = sampler(shown)
    assert demos.wrong_goals(demos.sample(100)) == []


def test_every_task_is_drawn_equally_often_however_few_its_demonstrations() -> None:
    few = [enter("Ada")]
    many = [trajectory("Click Ok.", [FLAT], [Action(verb=Verb.CLICK, element=0)], seed=i) for i in range(20)]
    counts = Counter(example.trajectory.task for example in sampler([*few, *many]).sample(1000))
    assert counts["enter-text"] == pytest.approx(500, abs=70)


def test_the_seed_decides_every_draw() -> None:
    shown = demonstrations(4)

    def drawn(seed: int) -> list[int]:
        demos = sampler(shown, seed)
        examples = demos.sample(20)
        return [e.trajectory.seed for e in examples] + [s.action.element for s in demos.wrong_goals(examples)]

    assert drawn(1) == drawn(1)
    assert drawn(1) != drawn(2)


def test_no_demonstrations_are_an_error_in_words() -> None:
    with pytest.raises(ValueError, match="no demonstrations to learn from"):
        sampler([]).sample(1)


def test_the_replay_is_a_uniform_sample_of_everything_it_was_given() -> None:
    click = Action(verb=Verb.CLICK, element=0)
    examples = [featurise_trajectory(trajectory("Click Ok.", [FLAT], [click], seed=i), vectors()) for i in range(20)]
    rng, kept = np.random.default_rng(0), Counter[int]()
    for _ in range(1500):
        replay = Replay(5, rng)
        for start in (0, 3, 10):  # given in parts, as rollouts are
            replay.add(examples[start : {0: 3, 3: 10, 10: 20}[start]])
        assert replay.seen == 20
        assert len(replay.examples) == 5
        kept.update(example.trajectory.seed for example in replay.examples)
    expected = 1500 * 5 / 20
    chi_squared = sum((kept[i] - expected) ** 2 / expected for i in range(20))
    assert chi_squared < 43.8  # the 0.1 % point of 19 degrees of freedom; the draws have a fixed seed


def test_an_empty_replay_gives_no_steps() -> None:
    assert Replay(5, np.random.default_rng(0)).sample(10) == []


def test_what_is_learned_from_has_no_place_for_an_outcome() -> None:
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
    assert {field.name for field in fields(Example)} == {"trajectory", "features"}
    assert {field.name for field in fields(Step)} == {"features", "action"}
