"""Input features: exact words, outputs independent of padding, and augmentation that keeps the overlap."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from giirl_core.nets.action_batch import ActionBatch
from giirl_core.nets.augment import rename
from giirl_core.nets.batch import Batch, collate
from giirl_core.nets.features import Features, featurise
from giirl_core.nets.language import FIRST_WORD, PADDING, UNKNOWN, load_vectors
from giirl_core.nets.layout import ELEMENT_OVERLAP, ELEMENT_WORDS, OPEN, TEXT_RUN, TEXT_WORD, VALUE_RUN, WORD, WORDS
from giirl_core.nets.models import PolicyNet, RewardNet
from giirl_core.types import Action, Goal, Page, Verb
from tests.learner.samples import (
    CASES,
    FLAT,
    batch_of,
    collate_actions,
    dense_matches,
    legal_actions,
    page,
    policy,
    reward_net,
    vectors,
)


def close(one: Tensor, two: Tensor) -> bool:
    """Equal but for rounding."""
    return torch.allclose(one, two, rtol=1e-4, atol=1e-5)


def evaluated(net: PolicyNet, batch: Batch, actions: ActionBatch) -> tuple[Tensor, Tensor, Tensor]:
    """Log-probabilities, entropies and values."""
    encoding = net.encoder(batch)
    return *net.evaluate(encoding, actions), net.state_value(encoding)


@pytest.fixture(scope="module")
def policy_net() -> PolicyNet:
    return policy()


@pytest.fixture(scope="module")
def reward() -> RewardNet:
    return reward_net()


@pytest.mark.parametrize("case", CASES, ids=["long", "short", "flat"])
def test_padding_does_not_change_the_outputs_of_the_nets(
    case: tuple[Page, Goal], policy_net: PolicyNet, reward: RewardNet
) -> None:
    wide = page("div", *["input_text"] * 9)
    padded = batch_of(case, (wide, Goal(" ".join(["word"] * 40))))
    for action in legal_actions(*case)[::5]:
        alone = batch_of(case), collate_actions([action])
        together = padded, collate_actions([action, Action(verb=Verb.TYPE, element=9, start=0, end=39)])
        for one, two in zip(evaluated(policy_net, *alone), evaluated(policy_net, *together), strict=True):
            assert close(one[0], two[0])
        assert close(reward(*alone)[0], reward(*together)[0])


def test_the_content_of_padding_rows_has_no_effect(policy_net: PolicyNet, reward: RewardNet) -> None:
    batch, actions = batch_of(*CASES), collate_actions([legal_actions(*case)[0] for case in CASES])
    overwritten = batch_of(*CASES)
    padding = torch.ones(len(overwritten.element_page), dtype=torch.bool)
    for b, (case_page, _) in enumerate(CASES):
        padding[overwritten.row[b, : len(case_page)]] = False
    assert padding.any()
    for name in ("token_words", "token_flags", "element_tag", "element_classes", "element_flags"):
        getattr(overwritten, name)[~overwritten.token_real if name.startswith("token") else padding] = 3
    assert not torch.equal(batch.token_words, overwritten.token_words)
    before, after = evaluated(policy_net, batch, actions), evaluated(policy_net, overwritten, actions)
    for one, two in zip(before, after, strict=True):
        assert close(one, two)
    assert close(reward(batch, actions), reward(overwritten, actions))


def test_labels_that_differ_only_in_case_have_different_features() -> None:
    features = featurise(FLAT, Goal('Click on the "Ok" button.'), vectors())
    exact, folded = features.element_flags[:2, ELEMENT_OVERLAP]
    assert np.array_equal(features.element_ids[0, ELEMENT_WORDS], features.element_ids[1, ELEMENT_WORDS])
    assert not np.array_equal(exact, folded)
    matches = dense_matches(features)
    assert matches[0, 0].any()
    assert not matches[0, 1].any()
    swapped = featurise(FLAT, Goal('Click on the "ok" button.'), vectors())
    assert np.array_equal(swapped.element_flags[:2, ELEMENT_OVERLAP], [folded, exact])


def test_matches_refer_to_exactly_the_goal_words_that_an_element_contains() -> None:
    names = page("button:Ada Lovelace", "input_text", "button:Lovelace Ada", value=("", "Lovelace", ""))
    features = featurise(names, Goal('Enter "Ada Lovelace" here.'), vectors())
    whole, any_word, value = dense_matches(features)[[TEXT_RUN, TEXT_WORD, VALUE_RUN]]
    assert whole.tolist() == [[0, 0, 0.5, 0.5, 0, 0, 0], [0] * 7, [0] * 7]
    assert any_word[2].tolist() == [0, 0, 0.5, 0.5, 0, 0, 0]
    assert value[1].tolist() == [0, 0, 0, 1, 0, 0, 0]


def test_words_outside_the_glove_vocabulary_match_by_their_spelling() -> None:
    features = featurise(page("button:Qwxzzqv", "button:Zzqvqwx"), Goal('Click "Qwxzzqv".'), load_vectors("glove"))
    assert features.token_ids[2, WORD] == features.element_ids[0, 0] == features.element_ids[1, 0] == UNKNOWN
    matches = dense_matches(features)
    assert matches[0, 0, 2] == 1.0
    assert not matches[0, 1].any()
    assert features.token_ids[2, OPEN]


def test_legal_actions_are_those_of_the_page() -> None:
    batch = batch_of(*CASES)
    for b, (case_page, _) in enumerate(CASES):
        assert batch.clickable[b, : len(case_page)].tolist() == case_page.leaf.tolist()
        assert batch.typable[b, : len(case_page)].tolist() == case_page.typable.tolist()
        assert not batch.clickable[b, len(case_page) :].any()


def test_features_do_not_contain_rewards_or_outcomes() -> None:
    names = {field.name for kind in (Features, Batch, ActionBatch) for field in fields(kind)}
    assert not {name for name in names if "reward" in name or "outcome" in name or "success" in name}


# --- augmentation


def renamed(seed: int, prob: float = 1.0, jitter: float = 0.0) -> tuple[Batch, Batch]:
    """The batch of CASES before and after renaming, each with its first legal action."""
    batch = batch_of(*CASES)
    actions = collate_actions([legal_actions(*case)[0] for case in CASES])
    return batch, rename(batch, actions, prob, jitter, torch.Generator().manual_seed(seed))


@given(st.integers(0, 200))
def test_renaming_replaces_a_word_by_the_same_new_word_in_goal_and_page(seed: int) -> None:
    before, after = renamed(seed)
    for b in range(len(before)):
        names: dict[int, int] = {}
        rows, open_rows = before.text_page == b, (before.token_page == b) & before.token_open
        goal = zip(before.token_words[open_rows].tolist(), after.token_words[open_rows].tolist(), strict=True)
        for old_word, new_word in goal:
            assert names.setdefault(old_word, new_word) == new_word
        shown = zip(before.text_words[rows].tolist(), after.text_words[rows].tolist(), strict=True)
        for old_word, new_word in shown:
            assert new_word in (names.get(old_word, old_word), UNKNOWN)  # some words are dropped
        assert names.get(PADDING, PADDING) == PADDING


def test_renaming_changes_only_words() -> None:
    before, after = renamed(0)
    names = [f.name for f in fields(Batch) if f.name != "blocks"]
    changed = {name for name in names if not torch.equal(getattr(before, name), getattr(after, name))}
    assert changed == {"token_words", "text_words"}
    assert before.blocks == after.blocks
    closed = before.token_real & ~before.token_open
    same = before.token_words[closed] == after.token_words[closed]
    assert (same | (after.token_words[closed] == UNKNOWN)).all()


def test_words_that_the_goal_does_not_share_keep_their_meaning_or_are_dropped() -> None:
    before, after = renamed(0)
    own = (before.text_page == 2) & (before.text_words == vectors().row("Cancel"))
    found = torch.cat([renamed(seed)[1].text_words[own] for seed in range(100)])
    assert own.sum() == 1
    assert set(found.tolist()) == {vectors().row("Cancel"), UNKNOWN}
    assert 0.1 < (found == UNKNOWN).float().mean() < 0.35
    assert len(after.text_words) == len(before.text_words)


def test_typed_words_are_renamed_even_if_they_are_not_on_the_page() -> None:
    batch = batch_of(CASES[1])  # Type ok.
    actions = collate_actions([Action(verb=Verb.TYPE, element=1, start=0, end=0)])
    closed = collate_actions([Action(verb=Verb.CLICK, element=0)])
    typed = rename(batch, actions, 1.0, 0.0, torch.Generator().manual_seed(1))
    clicked = rename(batch, closed, 1.0, 0.0, torch.Generator().manual_seed(1))
    assert typed.token_words[0] != batch.token_words[0]
    assert clicked.token_words[0] in (batch.token_words[0], UNKNOWN)


def test_new_words_are_diverse_and_some_of_them_are_unknown() -> None:
    found: list[Tensor] = [after.text_words[after.text_page == 2] for after in (renamed(s)[1] for s in range(100))]
    words = torch.cat(found)
    assert len(words.unique()) > 60
    assert 0.1 < (words == UNKNOWN).float().mean() < 0.45
    assert words.max() < len(vectors().table)
    assert words[words != UNKNOWN].min() >= FIRST_WORD


def test_with_probability_0_no_page_is_renamed_or_shifted() -> None:
    before, after = renamed(0, prob=0.0, jitter=1.0)
    assert torch.equal(before.text_words, after.text_words)
    assert torch.equal(before.element_flags, after.element_flags)


def test_jitter_shifts_all_elements_of_a_page_together() -> None:
    before, after = renamed(0, jitter=0.1)
    moved = (after.element_flags - before.element_flags)[before.row[2, :3]]
    assert close(moved[:, :2], moved[:1, :2].expand(3, 2))
    assert 0 < moved[:, :2].abs().max() <= 0.1
    assert not moved[:, 2:].any()


def test_only_the_first_words_of_a_long_text_are_read() -> None:
    features = featurise(page("t:" + "word " * 30), Goal("Go."), vectors())
    assert features.element_ids[:, ELEMENT_WORDS].shape == (1, WORDS)
    assert (features.element_ids[:, ELEMENT_WORDS] == vectors().row("word")).all()
    assert len(collate([features])) == 1
