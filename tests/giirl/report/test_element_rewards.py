"""What a reward says of every element, and the instruction that names another one."""

from __future__ import annotations

import pytest

from giirl.analysis.swaps import swap_goal
from giirl.report.element_rewards import action_words, scale_of, value_elements
from giirl_core.config_file import load_config
from giirl_core.nets.reward import RewardModel
from giirl_core.types import Action, EpisodeSpec, Goal, Observation, Page, Verb
from tests.learner import samples
from tests.learner.samples import legal_actions, page


def observed(shown: Page, goal: str, seed: int = 0) -> Observation:
    return Observation(episode=EpisodeSpec(task="t", seed=seed), page=shown, goal=Goal(goal))


@pytest.mark.parametrize(("shown", "goal"), samples.CASES)
def test_an_element_is_worth_the_best_of_all_that_can_be_done_to_it(shown: Page, goal: Goal) -> None:
    model = RewardModel(samples.reward_net(), samples.vectors(), "logit", 5.0)
    found = {one.action.element: one.reward for one in value_elements(model, shown, goal)}
    naive: dict[int, float] = {}
    options = legal_actions(shown, goal)
    earned = model.score_pairs([shown] * len(options), options, [goal] * len(options)).tolist()
    for option, reward in zip(options, earned, strict=True):
        naive[option.element] = max(naive.get(option.element, reward), reward)
    assert found == pytest.approx(naive, abs=1e-5)


def test_a_page_with_nothing_to_act_on_has_no_values() -> None:
    model = RewardModel(samples.reward_net(), samples.vectors(), "logit", 5.0)
    empty = Page(**{name: getattr(samples.FLAT, name)[:0] for name in Page.__dataclass_fields__})
    assert value_elements(model, empty, Goal("Go.")) == ()


def test_the_other_instruction_names_another_element_of_the_same_kind() -> None:
    swap = swap_goal(observed(page("t:Ok", "button:Ok", "button:ok", "link:No"), 'Click on the "Ok" button.'))
    assert swap is not None
    assert (swap.tag, swap.wanted, swap.other) == ("button", "Ok", "ok")
    assert swap.goal.utterance == 'Click on the "ok" button.'


def test_what_is_quoted_is_renamed_before_what_is_only_said() -> None:
    shown = page("button:Submit", "button:Back", "t:Ada", "t:Emil")
    swap = swap_goal(observed(shown, 'Find "Ada" and press Submit.'))
    assert swap is not None
    assert swap.goal.utterance == 'Find "Emil" and press Submit.'


def test_which_other_element_it_is_depends_on_the_seed_alone() -> None:
    shown = page("button:Ok", *(f"button:b{i}" for i in range(20)))
    others = {seed: [swap_goal(observed(shown, 'Click "Ok".', seed)) for _ in range(2)] for seed in range(9)}
    assert all(one == again and one is not None for one, again in others.values())
    assert len({pair[0].other for pair in others.values() if pair[0] is not None}) > 1


@pytest.mark.parametrize("goal", ["Click the button.", 'Enter "Ada" and press Submit.', 'Click "ok".'])
def test_an_instruction_that_names_nothing_another_could_stand_in_for_has_no_other(goal: str) -> None:
    assert swap_goal(observed(page("button:Submit", "input_text", "t:Ada", "link:ok"), goal)) is None
    assert swap_goal(observed(page("link:ok", "link:no"), 'Click "ok".'), "button") is None


@pytest.mark.parametrize(
    ("form", "low", "middle", "high"),
    [("logit", -5, 0, 5), ("d", 0.0067, 0.5, 0.9933), ("log_d", -5.0067, -0.6931, -0.0067), ("goal", 0, 0, 1)],
)
def test_the_scale_has_the_ends_and_the_middle_of_the_form(form: str, low: float, middle: float, high: float) -> None:
    scale = scale_of(load_config(None, [f"discriminator.reward={form}"]))
    assert (scale.low, scale.middle, scale.high) == pytest.approx((low, middle, high), abs=1e-4)
    assert scale.share(high + 1) == 1
    assert scale.share(scale.middle) == 0
    assert scale.share(low - 1) == (-1 if middle > low else 0)


def test_actions_are_said_in_words() -> None:
    shown, goal = page("input_text", "button:Submit"), Goal('Enter "Ada".')
    typing = Action(verb=Verb.TYPE, element=0, start=2, end=2)
    assert action_words(shown, goal, typing) == "type “Ada” into text field"
    assert action_words(shown, goal, Action(verb=Verb.CLICK, element=1)) == "click button “Submit”"
    long = page(f"button:{'x' * 99}")
    assert len(action_words(long, goal, Action(verb=Verb.CLICK, element=0))) < 60
