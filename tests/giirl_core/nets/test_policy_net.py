"""The policy is a distribution over legal actions: it draws, scores and points by one and the same numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from giirl_core.config import NetConfig
from giirl_core.nets.action_batch import ActionBatch, collate_actions, join, random_actions, random_logp
from giirl_core.nets.batch import Batch
from giirl_core.nets.encoder import nearness
from giirl_core.nets.models import PolicyNet
from giirl_core.types import Action, Goal, Page, Verb
from tests.learner.samples import CASES, LONG, SHORT, batch_of, legal_actions, on_one_page, page, policy, vectors

IDS = ["long", "short", "flat"]


@pytest.fixture(scope="module")
def net() -> PolicyNet:
    """Untrained, but with opinions: its weights are scaled up."""
    opinionated = policy(3)
    with torch.no_grad():
        for parameter in opinionated.parameters():
            parameter.mul_(1.6)
    return opinionated


def drawn(net: PolicyNet, batch: Batch, uniform: Tensor, *, random: bool) -> ActionBatch:
    """By the net, or uniformly over what is legal."""
    return random_actions(batch, uniform) if random else net.sample(net.encoder(batch), uniform)[0]


def uniform(pages: int, count: int, seed: int = 0) -> Tensor:
    return torch.rand(pages, count, 3, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("case", CASES, ids=IDS)
def test_the_probabilities_of_all_legal_actions_sum_to_one(case: tuple[Page, Goal], net: PolicyNet) -> None:
    logp, _ = net.evaluate(net.encoder(batch_of(case)), on_one_page(legal_actions(*case)))
    assert logp.exp().sum().item() == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("case", CASES, ids=IDS)
def test_the_entropy_of_verb_and_element_is_that_of_the_enumeration(case: tuple[Page, Goal], net: PolicyNet) -> None:
    shown, goal = case
    actions = legal_actions(shown, goal)
    logp, entropy = net.evaluate(net.encoder(batch_of(case)), on_one_page(actions))
    pairs: dict[tuple[Verb, int], float] = {}
    for action, p in zip(actions, logp[0].exp().tolist(), strict=True):
        pairs[action.verb, action.element] = pairs.get((action.verb, action.element), 0.0) + p
    assert actions[0].verb is Verb.CLICK  # so the entropy is that of the pair alone
    by_hand = -sum(p * torch.tensor(p).log().item() for p in pairs.values())
    assert entropy.item() == pytest.approx(by_hand, abs=1e-4)


@pytest.mark.parametrize(
    "action",
    [
        (Verb.CLICK, 0, -1, -1),  # no leaf
        (Verb.TYPE, 2, 0, 0),  # no field
        (Verb.TYPE, 3, 2, 1),  # ends before it starts
    ],
)
def test_an_illegal_action_has_probability_zero(action: tuple[int, ...], net: PolicyNet) -> None:
    verb, element, start, end = torch.tensor(action).view(4, 1, 1)
    chosen = ActionBatch(verb=verb, element=element, start=start, end=end)
    logp, _ = net.evaluate(net.encoder(batch_of((LONG, CASES[0][1]))), chosen)
    assert logp.exp().item() == 0.0


@pytest.mark.parametrize("random", [False, True])
def test_what_is_drawn_is_legal_and_words_never_end_before_they_start(random: bool, net: PolicyNet) -> None:
    actions = drawn(net, batch_of(*CASES), uniform(3, 200), random=random)
    for b, (shown, goal) in enumerate(CASES):
        legal = set(legal_actions(shown, goal))
        for m in range(200):
            parts = (int(part[b, m]) for part in (actions.verb, actions.element, actions.start, actions.end))
            verb, element, start, end = parts
            assert Action(verb=Verb(verb), element=element, start=start, end=end) in legal


@pytest.mark.parametrize("uniform", [0.0, 1.0 - 2.0**-24])
def test_the_first_and_the_last_of_all_draws_are_legal_too(uniform: float, net: PolicyNet) -> None:
    batch = batch_of((LONG, CASES[0][1]))
    actions, logp = net.sample(net.encoder(batch), torch.full((1, 1, 3), uniform))
    assert actions.first()[0] in legal_actions(*CASES[0])
    assert logp.item() > -100
    assert random_actions(batch, torch.full((1, 1, 3), uniform)).first()[0] in legal_actions(*CASES[0])


def test_the_logp_of_a_draw_is_the_one_that_evaluation_gives(net: PolicyNet) -> None:
    seen = net.encoder(batch_of(*CASES))
    actions, logp = net.sample(seen, uniform(3, 50))
    assert torch.allclose(logp, net.evaluate(seen, actions)[0], atol=1e-5)
    assert {0, 1} <= set(actions.verb.flatten().tolist())


@pytest.mark.parametrize("random", [False, True])
def test_actions_are_drawn_as_often_as_they_are_likely(random: bool, net: PolicyNet) -> None:
    case = (SHORT, Goal("Type ok."))
    batch, actions, count = batch_of(case), legal_actions(SHORT, Goal("Type ok.")), 4000
    grid = (torch.arange(count) + 0.5) / count  # stratified, so that counts are nearly exact
    order = torch.Generator().manual_seed(0)
    draws = torch.stack([grid[torch.randperm(count, generator=order)] for _ in range(3)], dim=1).unsqueeze(0)
    found, every = drawn(net, batch, draws, random=random), on_one_page(actions)
    logp = random_logp(batch, every) if random else net.evaluate(net.encoder(batch), every)[0]
    for action, p in zip(actions, logp[0].exp().tolist(), strict=True):
        same = (found.verb == action.verb) & (found.element == action.element)
        same &= (found.start == action.start) & (found.end == action.end)
        assert same.float().mean().item() == pytest.approx(p, abs=4 * (p * (1 - p) / count) ** 0.5 + 1e-3)


@pytest.mark.parametrize("case", CASES, ids=IDS)
def test_the_greedy_action_is_the_likeliest_pair_and_then_the_likeliest_words(
    case: tuple[Page, Goal], net: PolicyNet
) -> None:
    actions = legal_actions(*case)
    p = net.evaluate(net.encoder(batch_of(case)), on_one_page(actions))[0][0].exp().tolist()
    table: dict[Action, float] = dict(zip(actions, p, strict=True))

    def total(verb: Verb, element: int, start: int | None = None) -> float:
        return sum(
            chance
            for a, chance in table.items()
            if (a.verb, a.element) == (verb, element) and (start is None or a.start == start)
        )

    greedy = net.sample(net.encoder(batch_of(case)), None)[0].first()[0]
    best = max(actions, key=lambda a: total(a.verb, a.element))
    assert (greedy.verb, greedy.element) == (best.verb, best.element)
    same = [a for a in actions if (a.verb, a.element) == (best.verb, best.element)]
    start = max(same, key=lambda a: total(a.verb, a.element, a.start)).start
    assert greedy == max((a for a in same if a.start == start), key=table.__getitem__)


@pytest.mark.parametrize("case", CASES, ids=IDS)
def test_the_probabilities_of_chance_sum_to_one_by_enumeration(case: tuple[Page, Goal]) -> None:
    beside = batch_of(case, *CASES)  # padding must not count
    actions = on_one_page(legal_actions(*case))
    rows = [getattr(actions, name).expand(len(beside), -1) for name in ("verb", "element", "start", "end")]
    verb, element, start, end = rows
    logp = random_logp(beside, ActionBatch(verb=verb, element=element, start=start, end=end))[0]
    assert logp.exp().sum().item() == pytest.approx(1.0, abs=1e-5)


def test_joining_puts_the_action_taken_first() -> None:
    taken = collate_actions([Action(verb=Verb.TYPE, element=3, start=1, end=2)])
    both = join(taken, on_one_page([Action(verb=Verb.CLICK, element=1), Action(verb=Verb.CLICK, element=2)]))
    assert both.element.tolist() == [[3, 1, 2]]
    assert both.verb.tolist() == [[1, 0, 0]]
    assert both.start.tolist() == [[1, -1, -1]]
    assert both.first() == taken.first()


def labels(first: str, second: str) -> Page:
    """Two boxes with a label each, in two lines of a form."""
    shown = page("div", "input_checkbox", f"t:{first}", "input_checkbox", f"t:{second}", parent=(-1, 0, 0, 0, 0))
    box = np.array([[0, 0, 160, 50], [4, 4, 13, 13], [21, 3, 30, 16], [4, 24, 13, 13], [21, 23, 30, 16]])
    return replace(shown, box=box.astype(np.float32))


def test_what_is_beside_an_element_is_its_nearest_leaf_in_the_same_line() -> None:
    (near,) = nearness(batch_of((labels("Ok", "No"), Goal("Select Ok")), (SHORT, Goal("Type ok."))))
    assert near[0].argmax(1).tolist()[1:] == [2, 1, 4, 3]
    assert near[0].max(1).values[1:].min() > 0.8
    assert near.diagonal(dim1=1, dim2=2).abs().sum() == 0
    assert near[0, :, 0].sum() == 0  # a group is not a leaf
    assert near[1, :, 2:].sum() == 0  # nor is what pads a smaller page


@pytest.mark.parametrize("beside", [True, False])
def test_a_net_may_read_a_box_with_its_label_alone(beside: bool) -> None:
    goal = Goal("Select Ok")
    torch.manual_seed(0)
    encoder = PolicyNet(vectors(), NetConfig(width=16, adjacent_elements=beside, element_attention=False)).encoder
    one, other = (encoder(batch_of((labels(*text), goal))).elements[1] for text in (("Ok", "No"), ("No", "Ok")))
    assert torch.allclose(one, other, atol=1e-6) is not beside
