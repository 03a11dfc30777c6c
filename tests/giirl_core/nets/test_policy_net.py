"""The policy net is a distribution over legal actions, and sampling and evaluation use the same probabilities."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from torch import Tensor

from giirl_core.choices import Choice
from giirl_core.config import NetConfig
from giirl_core.gestures import BASIC
from giirl_core.nets.action_batch import ActionBatch, collate_candidates, join, random_actions, random_logp
from giirl_core.nets.batch import Batch
from giirl_core.nets.encoder import adjacency
from giirl_core.nets.models import PolicyNet
from giirl_core.types import Action, Goal, Page, Verb
from tests.learner.samples import (
    CASES,
    LONG,
    SHORT,
    batch_of,
    choice,
    collate_actions,
    legal_actions,
    on_one_page,
    page,
    policy,
    vectors,
)

IDS = ["long", "short", "flat"]


@pytest.fixture(scope="module")
def net() -> PolicyNet:
    """An untrained net whose parameters are scaled up, so that its distributions are far from uniform."""
    scaled = policy(3)
    with torch.no_grad():
        for parameter in scaled.parameters():
            parameter.mul_(1.6)
    return scaled


def sample(net: PolicyNet, batch: Batch, uniform: Tensor, *, random: bool) -> ActionBatch:
    """Actions of the random policy if `random`, else of the net."""
    return random_actions(batch, uniform, BASIC) if random else net.sample(net.encoder(batch), uniform)[0]


def uniform(pages: int, count: int, seed: int = 0) -> Tensor:
    return torch.rand(pages, count, 3, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("case", CASES, ids=IDS)
def test_the_probabilities_of_all_legal_actions_sum_to_one(case: tuple[Page, Goal], net: PolicyNet) -> None:
    logp, _ = net.evaluate(net.encoder(batch_of(case)), on_one_page(legal_actions(*case)))
    assert logp.exp().sum().item() == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("case", CASES, ids=IDS)
def test_the_entropy_of_the_pair_equals_its_sum_over_all_pairs(case: tuple[Page, Goal], net: PolicyNet) -> None:
    actions = legal_actions(*case)
    logp, entropy = net.evaluate(net.encoder(batch_of(case)), on_one_page(actions))
    pairs: dict[tuple[Verb, int], float] = {}
    for action, p in zip(actions, logp[0].exp().tolist(), strict=True):
        pairs[action.verb, action.element] = pairs.get((action.verb, action.element), 0.0) + p
    assert actions[0].verb is Verb.CLICK  # so the entropy has no part for the typed words
    expected = -sum(p * torch.tensor(p).log().item() for p in pairs.values())
    assert entropy.item() == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(
    "action",
    [
        (Verb.CLICK, 0, -1, -1),  # not a leaf
        (Verb.TYPE, 2, 0, 0),  # not a field
        (Verb.TYPE, 3, 2, 1),  # the last word is before the first one
    ],
)
def test_an_illegal_action_has_probability_zero(action: tuple[int, ...], net: PolicyNet) -> None:
    chosen = collate_candidates([Choice(*action)])
    logp, _ = net.evaluate(net.encoder(batch_of((LONG, CASES[0][1]))), chosen)
    assert logp.exp().item() == 0.0


@pytest.mark.parametrize("random", [False, True])
def test_sampled_actions_are_legal(random: bool, net: PolicyNet) -> None:
    actions = sample(net, batch_of(*CASES), uniform(3, 200), random=random)
    for b, case in enumerate(CASES):
        legal = set(map(choice, legal_actions(*case)))
        for m in range(200):
            assert Choice(*actions.table()[b, m].tolist()) in legal


@pytest.mark.parametrize("uniform", [0.0, 1.0 - 2.0**-24])
def test_the_smallest_and_largest_random_numbers_give_legal_actions(uniform: float, net: PolicyNet) -> None:
    batch = batch_of((LONG, CASES[0][1]))
    actions, logp = net.sample(net.encoder(batch), torch.full((1, 1, 3), uniform))
    legal = set(map(choice, legal_actions(*CASES[0])))
    assert actions.first()[0] in legal
    assert logp.item() > -100
    assert random_actions(batch, torch.full((1, 1, 3), uniform), BASIC).first()[0] in legal


def test_sampling_and_evaluation_give_the_same_log_probabilities(net: PolicyNet) -> None:
    encoding = net.encoder(batch_of(*CASES))
    actions, logp = net.sample(encoding, uniform(3, 50))
    assert torch.allclose(logp, net.evaluate(encoding, actions)[0], atol=1e-5)
    assert {0, 1} <= set(actions.gesture.flatten().tolist())


@pytest.mark.parametrize("random", [False, True])
def test_sampling_frequencies_equal_the_probabilities(random: bool, net: PolicyNet) -> None:
    case = (SHORT, Goal("Type ok."))
    batch, actions, count = batch_of(case), legal_actions(SHORT, Goal("Type ok.")), 4000
    grid = (torch.arange(count) + 0.5) / count  # stratified, so that frequencies are nearly exact
    generator = torch.Generator().manual_seed(0)
    numbers = torch.stack([grid[torch.randperm(count, generator=generator)] for _ in range(3)], dim=1).unsqueeze(0)
    found, every = sample(net, batch, numbers, random=random), on_one_page(actions)
    logp = random_logp(batch, every, BASIC) if random else net.evaluate(net.encoder(batch), every)[0]
    for action, p in zip(actions, logp[0].exp().tolist(), strict=True):
        same = (found.gesture == action.verb) & (found.element == action.element)
        same &= (found.start == action.start) & (found.end == action.end)
        assert same.float().mean().item() == pytest.approx(p, abs=4 * (p * (1 - p) / count) ** 0.5 + 1e-3)


@pytest.mark.parametrize("case", CASES, ids=IDS)
def test_the_greedy_action_is_the_most_probable_pair_with_the_most_probable_words(
    case: tuple[Page, Goal], net: PolicyNet
) -> None:
    actions = legal_actions(*case)
    p = net.evaluate(net.encoder(batch_of(case)), on_one_page(actions))[0][0].exp().tolist()
    table: dict[Action, float] = dict(zip(actions, p, strict=True))

    def total(verb: Verb, element: int, start: int | None = None) -> float:
        return sum(
            prob
            for a, prob in table.items()
            if (a.verb, a.element) == (verb, element) and (start is None or a.start == start)
        )

    greedy = net.sample(net.encoder(batch_of(case)), None)[0].first()[0]
    best = max(actions, key=lambda a: total(a.verb, a.element))
    assert (greedy.gesture, greedy.element) == (best.verb, best.element)
    same = [a for a in actions if (a.verb, a.element) == (best.verb, best.element)]
    start = max(same, key=lambda a: total(a.verb, a.element, a.start)).start
    assert greedy == choice(max((a for a in same if a.start == start), key=table.__getitem__))


@pytest.mark.parametrize("case", CASES, ids=IDS)
def test_the_probabilities_of_the_random_policy_sum_to_one(case: tuple[Page, Goal]) -> None:
    batch = batch_of(case, *CASES)  # with padding, which must not count
    actions = on_one_page(legal_actions(*case))
    rows = {f.name: getattr(actions, f.name).expand(len(batch), -1) for f in fields(actions)}
    logp = random_logp(batch, ActionBatch(**rows), BASIC)[0]
    assert logp.exp().sum().item() == pytest.approx(1.0, abs=1e-5)


def test_join_keeps_the_order_of_its_arguments() -> None:
    taken = collate_actions([Action(verb=Verb.TYPE, element=3, start=1, end=2)])
    both = join(taken, on_one_page([Action(verb=Verb.CLICK, element=1), Action(verb=Verb.CLICK, element=2)]))
    assert both.element.tolist() == [[3, 1, 2]]
    assert both.gesture.tolist() == [[1, 0, 0]]
    assert both.start.tolist() == [[1, -1, -1]]
    assert both.first() == taken.first()


def labels(first: str, second: str) -> Page:
    """A list with two lines, each with an image and its label."""
    form = page("div", "img", f"t:{first}", "img", f"t:{second}", parent=(-1, 0, 0, 0, 0))
    box = np.array([[0, 0, 160, 50], [4, 4, 13, 13], [21, 3, 30, 16], [4, 24, 13, 13], [21, 23, 30, 16]])
    return replace(form, box=box.astype(np.float32))


def test_the_adjacent_element_is_the_nearest_leaf_in_the_same_line() -> None:
    (weights,) = adjacency(batch_of((labels("Ok", "No"), Goal("Select Ok")), (SHORT, Goal("Type ok."))))
    assert weights[0].argmax(1).tolist()[1:] == [2, 1, 4, 3]
    assert weights[0].max(1).values[1:].min() > 0.8
    assert weights.diagonal(dim1=1, dim2=2).abs().sum() == 0
    assert weights[0, :, 0].sum() == 0  # element 0 is not a leaf
    assert weights[1, :, 2:].sum() == 0  # padding


@pytest.mark.parametrize("adjacent", [True, False])
def test_with_adjacent_elements_an_image_is_encoded_with_its_label(adjacent: bool) -> None:
    goal = Goal("Select Ok")
    torch.manual_seed(0)
    encoder = PolicyNet(vectors(), NetConfig(width=16, adjacent_elements=adjacent, element_attention=False)).encoder
    one, other = (encoder(batch_of((labels(*text), goal))).elements[1] for text in (("Ok", "No"), ("No", "Ok")))
    assert torch.allclose(one, other, atol=1e-6) is not adjacent
