"""The reward of every element, and instructions that name another element (goal swap)."""

from __future__ import annotations

import pytest

from giirl.analysis.swaps import swap_goal
from giirl.report.element_rewards import describe_action, scale_of, score_elements
from giirl_core.config_file import load_config
from giirl_core.nets.reward import RewardModel
from giirl_core.types import Action, EpisodeSpec, Goal, Observation, Page, Verb
from tests.learner import samples
from tests.learner.samples import legal_actions, page


def observation(on: Page, goal: str, seed: int = 0) -> Observation:
    return Observation(episode=EpisodeSpec(task="t", seed=seed), page=on, goal=Goal(goal))


@pytest.mark.parametrize(("on", "goal"), samples.CASES)
def test_the_reward_of_an_element_is_that_of_its_best_action(on: Page, goal: Goal) -> None:
    model = RewardModel(samples.reward_net(), samples.vectors(), "logit", 5.0)
    found = {one.action.element: one.reward for one in score_elements(model, on, goal)[0]}
    naive: dict[int, float] = {}
    actions = legal_actions(on, goal)
    rewards = model.score_pairs([on] * len(actions), actions, [goal] * len(actions)).tolist()
    for action, reward in zip(actions, rewards, strict=True):
        naive[action.element] = max(naive.get(action.element, reward), reward)
    assert found == pytest.approx(naive, abs=1e-5)
    for action, reward in zip(actions[:3], rewards[:3], strict=True):
        best, taken = score_elements(model, on, goal, action)
        assert taken == pytest.approx(reward, abs=1e-5)
        assert {one.action.element for one in best} == set(found)


def test_a_page_without_elements_has_no_rewards() -> None:
    model = RewardModel(samples.reward_net(), samples.vectors(), "logit", 5.0)
    empty = Page(**{name: getattr(samples.FLAT, name)[:0] for name in Page.__dataclass_fields__})
    assert score_elements(model, empty, Goal("Go.")) == ((), None)


def test_the_other_instruction_names_another_element_of_the_same_kind() -> None:
    swap = swap_goal(observation(page("t:Ok", "button:Ok", "button:ok", "link:No"), 'Click on the "Ok" button.'))
    assert swap is not None
    assert (swap.tag, swap.wanted, swap.other) == ("button", "Ok", "ok")
    assert swap.goal.utterance == 'Click on the "ok" button.'


def test_quoted_text_is_swapped_before_other_text() -> None:
    on = page("button:Submit", "button:Back", "t:Ada", "t:Emil")
    swap = swap_goal(observation(on, 'Find "Ada" and press Submit.'))
    assert swap is not None
    assert swap.goal.utterance == 'Find "Emil" and press Submit.'


def test_the_seed_determines_the_other_element() -> None:
    on = page("button:Ok", *(f"button:b{i}" for i in range(20)))
    others = {seed: [swap_goal(observation(on, 'Click "Ok".', seed)) for _ in range(2)] for seed in range(9)}
    assert all(one == again and one is not None for one, again in others.values())
    assert len({pair[0].other for pair in others.values() if pair[0] is not None}) > 1


@pytest.mark.parametrize("goal", ["Click the button.", 'Enter "Ada" and press Submit.', 'Click "ok".'])
def test_an_instruction_without_a_swappable_element_has_no_swap(goal: str) -> None:
    assert swap_goal(observation(page("button:Submit", "input_text", "t:Ada", "link:ok"), goal)) is None
    assert swap_goal(observation(page("link:ok", "link:no"), 'Click "ok".'), "button") is None


@pytest.mark.parametrize(
    ("form", "low", "middle", "high"),
    [("logit", -5, 0, 5), ("d", 0.0067, 0.5, 0.9933), ("log_d", -5.0067, -0.6931, -0.0067), ("goal", 0, 0, 1)],
)
def test_the_scale_matches_the_range_of_the_reward_form(form: str, low: float, middle: float, high: float) -> None:
    scale = scale_of(load_config(None, [f"discriminator.reward={form}"]))
    assert (scale.low, scale.middle, scale.high) == pytest.approx((low, middle, high), abs=1e-4)
    assert scale.normalise(high + 1) == 1
    assert scale.normalise(scale.middle) == 0
    assert scale.normalise(low - 1) == (-1 if middle > low else 0)


def test_actions_are_described_in_words() -> None:
    on, goal = page("input_text", "button:Submit"), Goal('Enter "Ada".')
    typing = Action(verb=Verb.TYPE, element=0, start=2, end=2)
    assert describe_action(on, goal, typing) == "type “Ada” into text field"
    assert describe_action(on, goal, Action(verb=Verb.CLICK, element=1)) == "click button “Submit”"
    long = page(f"button:{'x' * 99}")
    assert len(describe_action(long, goal, Action(verb=Verb.CLICK, element=0))) < 60
