"""The nets on flat tables in blocks give the same losses and gradients as the padded reference implementation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from giirl_core.config import NetConfig
from giirl_core.nets.batch import Batch, collate
from giirl_core.nets.features import featurise
from giirl_core.nets.layout import ELEMENT_WORDS, TEXT_RUN, TEXT_WORD, VALUE_RUN
from giirl_core.nets.models import PolicyNet, RewardNet
from giirl_core.types import Action, Goal, Page, Verb
from tests.giirl_core.nets import padded_features, padded_nets
from tests.learner.samples import collate_actions, dense_matches, legal_actions, page, vectors

WORDS = ("Ok", "ok", "Cancel", "Ada", "Lovelace", "next", "word", "Qwxzz", "12", "!")
TAGS = ("button", "div", "span", "input_text", "input_checkbox", "textarea", "a", "t")
DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]

Step = tuple[Page, Goal, Action]


def random_page(rng: np.random.Generator, count: int, *, fields: bool = True) -> Page:
    """A random page with `count` elements, some of them nested."""
    tags = rng.choice([tag for tag in TAGS if fields or tag not in ("input_text", "textarea")], count)
    texts = [" ".join(rng.choice(WORDS, rng.integers(0, 12))) for _ in range(count)]
    values = [" ".join(rng.choice(WORDS, rng.integers(0, 3))) for _ in range(count)]
    parents = [-1 if row == 0 or rng.random() < 0.8 else int(rng.integers(row)) for row in range(count)]
    return page(*(f"{tag}:{text}" for tag, text in zip(tags, texts, strict=True)), value=values, parent=parents)


def random_steps(seed: int, sizes: Sequence[int], *, fields: bool = True) -> list[Step]:
    rng = np.random.default_rng(seed)
    steps = []
    for size in sizes:
        case_page, goal = random_page(rng, size, fields=fields), Goal(" ".join(rng.choice(WORDS, rng.integers(1, 30))))
        actions = legal_actions(case_page, goal) or [Action(verb=Verb.CLICK, element=0)]
        steps.append((case_page, goal, actions[int(rng.integers(len(actions)))]))
    return steps


def gradients(net: nn.Module, loss: Tensor) -> dict[str, Tensor]:
    net.zero_grad()
    loss.backward()
    return {name: p.grad.cpu() if p.grad is not None else torch.zeros(p.shape) for name, p in net.named_parameters()}


def loss_of(parts: Sequence[Tensor]) -> Tensor:
    return torch.stack([part.cpu().pow(2).mean() for part in parts]).sum()


def same(one: dict[str, Tensor], two: dict[str, Tensor]) -> bool:
    return one.keys() == two.keys() and all(torch.allclose(one[n], two[n], rtol=1e-4, atol=1e-5) for n in one)


CASES = {
    "many sizes": random_steps(0, [1, 2, 3, 5, 8, 8, 8, 13, 21, 34, 55, 89]),
    "one element": random_steps(1, [1, 1, 1]),
    "three hundred elements": random_steps(2, [300, 4]),
    "no field": random_steps(3, [6, 9, 30], fields=False),
}


@pytest.mark.parametrize("steps", CASES.values(), ids=CASES)
def test_words_and_matches_of_texts_equal_those_of_the_reference_implementation(steps: list[Step]) -> None:
    for case_page, goal, _ in steps:
        features = featurise(case_page, goal, vectors())
        rows, wanted = features.element_ids[:, ELEMENT_WORDS], padded_features.word_rows(case_page, vectors())
        # A checkbox, or a field without words, has the words of its label.
        read = wanted.any(axis=1) & (np.array(case_page.tag) != "input_checkbox")
        assert np.array_equal(rows[read], wanted[read])
        found = dense_matches(features)[[TEXT_RUN, TEXT_WORD, VALUE_RUN]]
        assert np.allclose(found, padded_features.text_matches(case_page, goal))


@pytest.mark.filterwarnings("ignore:Attempting to run cuBLAS")  # torch makes the CUDA context of the backward thread
@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("adjacent", [False, True])
@pytest.mark.parametrize("steps", CASES.values(), ids=CASES)
def test_losses_and_gradients_equal_those_of_the_padded_reference(
    steps: list[Step], adjacent: bool, device: str
) -> None:
    config = NetConfig(width=16, adjacent_elements=adjacent)
    table = padded_features.collate([padded_features.dense(featurise(p, g, vectors()), p) for p, g, _ in steps])
    batch = collate([featurise(p, g, vectors()) for p, g, _ in steps]).to(torch.device(device))
    actions = [action for *_, action in steps]
    padded, flat = collate_actions(actions), collate_actions(actions).to(torch.device(device))
    torch.manual_seed(0)
    slow_policy, slow_reward = padded_nets.PolicyNet(vectors(), config), padded_nets.RewardNet(vectors(), config)
    policy, reward = PolicyNet(vectors(), config).to(device), RewardNet(vectors(), config).to(device)
    for net in (slow_policy, slow_reward):  # untrained biases are 0
        nn.init.normal_(net.encoder.attention.bias)
    policy.load_state_dict(slow_policy.state_dict())
    reward.load_state_dict(slow_reward.state_dict())
    encoding = policy.encoder(batch)
    parts = (*policy.evaluate(encoding, flat), policy.state_value(encoding))
    for fast, wanted in zip(parts, slow_policy.evaluate(table, padded), strict=True):
        assert torch.allclose(fast.cpu(), wanted, rtol=1e-4, atol=1e-5)
    slow = slow_policy.evaluate(table, padded)
    assert same(gradients(policy, loss_of(parts)), gradients(slow_policy, loss_of(slow)))
    fast_logits, slow_logits = reward(batch, flat).cpu(), slow_reward(table, padded)
    assert torch.allclose(fast_logits, slow_logits, rtol=1e-4, atol=1e-5)
    assert same(gradients(reward, fast_logits.pow(2).mean()), gradients(slow_reward, slow_logits.pow(2).mean()))


def test_an_empty_page_in_a_batch_raises_no_error_and_does_not_change_the_other_pages() -> None:
    steps = random_steps(4, [5, 7])
    features = [featurise(p, g, vectors()) for p, g, _ in steps]
    empty = featurise(page(), Goal("Go."), vectors())
    net = PolicyNet(vectors(), NetConfig(width=16))
    alone, together = net.encoder(collate(features)), net.encoder(collate([features[0], empty, features[1]]))
    assert torch.allclose(alone.summary, together.summary[[0, 2]], atol=1e-6)
    assert torch.isfinite(net.encoder(collate([empty])).elements).all()


def test_padding_is_at_most_a_tenth_of_the_rows_plus_a_few_rows_per_block() -> None:
    rng = np.random.default_rng(0)
    sizes = rng.integers(1, 120, 200)
    batch = collate([featurise(random_page(rng, int(size)), Goal("Go."), vectors()) for size in sizes])
    rows = len(batch.element_page)
    assert rows - sizes.sum() <= 0.1 * rows + 32 * len(batch.blocks)
    assert sorted(torch.cat([block.pages for block in batch.blocks]).tolist()) == list(range(200))


def test_each_flat_row_has_the_index_of_the_page_that_refers_to_it() -> None:
    steps = random_steps(5, [3, 50, 4, 50, 1, 20])
    batch: Batch = collate([featurise(p, g, vectors()) for p, g, _ in steps])
    for b, (case_page, goal, _) in enumerate(steps):
        assert (batch.element_page[batch.row[b, : len(case_page)]] == b).all()
        assert (batch.token_page[batch.token_row[b, : len(goal.tokens)]] == b).all()
        assert batch.token_real[batch.token_row[b, : len(goal.tokens)]].all()
    rows = torch.cat([batch.row[b, : len(case_page)] for b, (case_page, *_) in enumerate(steps)])
    assert len(rows.unique()) == len(rows)
