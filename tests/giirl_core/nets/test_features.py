"""What the nets see: exact words, no padding, and the same agreement in other words."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from giirl_core.nets.action_batch import ActionBatch, collate_actions
from giirl_core.nets.augment import rename
from giirl_core.nets.batch import Batch, collate
from giirl_core.nets.features import ELEMENT_WORDS, OPEN, POSITION, WORD, WORDS, Features, featurise
from giirl_core.nets.language import FIRST_WORD, PADDING, UNKNOWN, load_vectors
from giirl_core.nets.models import PolicyNet, RewardNet
from giirl_core.types import Action, Goal, Page, Verb
from tests.learner.samples import (
    CASES,
    FLAT,
    batch_of,
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
    """Log-probabilities, entropy and value."""
    seen = net.encoder(batch)
    return *net.evaluate(seen, actions), net.state_value(seen)


@pytest.fixture(scope="module")
def acting() -> PolicyNet:
    return policy()


@pytest.fixture(scope="module")
def judging() -> RewardNet:
    return reward_net()


@pytest.mark.parametrize("case", CASES, ids=["long", "short", "flat"])
def test_padding_changes_no_output_of_either_net(
    case: tuple[Page, Goal], acting: PolicyNet, judging: RewardNet
) -> None:
    wide = page("div", *["input_text"] * 9)
    padded = batch_of(case, (wide, Goal(" ".join(["word"] * 40))))
    for action in legal_actions(*case)[::5]:
        alone = batch_of(case), collate_actions([action])
        beside = padded, collate_actions([action, Action(verb=Verb.TYPE, element=9, start=0, end=39)])
        for one, two in zip(evaluated(acting, *alone), evaluated(acting, *beside), strict=True):
            assert close(one[0], two[0])
        assert close(judging(*alone)[0], judging(*beside)[0])


def test_what_stands_in_the_padding_is_never_read(acting: PolicyNet, judging: RewardNet) -> None:
    batch, actions = batch_of(*CASES), collate_actions([legal_actions(*case)[0] for case in CASES])
    spoiled = batch_of(*CASES)
    padding = torch.ones(len(spoiled.element_page), dtype=torch.bool)
    for b, (shown, _) in enumerate(CASES):
        padding[spoiled.row[b, : len(shown)]] = False
    assert padding.any()
    for name in ("token_words", "token_flags", "element_words", "element_tag", "element_classes", "element_flags"):
        getattr(spoiled, name)[~spoiled.token_real if name.startswith("token") else padding] = 3
    assert not torch.equal(batch.token_words, spoiled.token_words)
    for one, two in zip(evaluated(acting, batch, actions), evaluated(acting, spoiled, actions), strict=True):
        assert close(one, two)
    assert close(judging(batch, actions), judging(spoiled, actions))


def test_labels_that_differ_in_case_alone_look_different() -> None:
    seen = featurise(FLAT, Goal('Click on the "Ok" button.'), vectors())
    positions = np.arange(seen.element_flags.shape[1]) >= POSITION.stop
    exact, folded = seen.element_flags[0, positions], seen.element_flags[1, positions]
    assert np.array_equal(seen.element_ids[0, ELEMENT_WORDS], seen.element_ids[1, ELEMENT_WORDS])
    assert not np.array_equal(exact, folded)
    matches = dense_matches(seen)
    assert matches[0, 0].any()
    assert not matches[0, 1].any()
    swapped = featurise(FLAT, Goal('Click on the "ok" button.'), vectors())
    assert np.array_equal(swapped.element_flags[0, positions], folded)
    assert np.array_equal(swapped.element_flags[1, positions], exact)


def test_a_match_points_at_exactly_the_words_that_the_text_repeats() -> None:
    shown = page("button:Ada Lovelace", "input_text", "button:Lovelace Ada", value=("", "Lovelace", ""))
    seen = featurise(shown, Goal('Enter "Ada Lovelace" here.'), vectors())
    whole, any_word, held = dense_matches(seen)
    assert whole.tolist() == [[0, 0, 0.5, 0.5, 0, 0, 0], [0] * 7, [0] * 7]
    assert any_word[2].tolist() == [0, 0, 0.5, 0.5, 0, 0, 0]
    assert held[1].tolist() == [0, 0, 0, 1, 0, 0, 0]


def test_words_that_glove_lacks_still_match_by_their_letters() -> None:
    seen = featurise(page("button:Qwxzzqv", "button:Zzqvqwx"), Goal('Click "Qwxzzqv".'), load_vectors("glove"))
    assert seen.token_ids[2, WORD] == seen.element_ids[0, 0] == seen.element_ids[1, 0] == UNKNOWN
    matches = dense_matches(seen)
    assert matches[0, 0, 2] == 1.0
    assert not matches[0, 1].any()
    assert seen.token_ids[2, OPEN]


def test_what_may_be_done_is_what_the_page_says() -> None:
    batch = batch_of(*CASES)
    for b, (shown, _) in enumerate(CASES):
        assert batch.clickable[b, : len(shown)].tolist() == shown.leaf.tolist()
        assert batch.typable[b, : len(shown)].tolist() == shown.typable.tolist()
        assert not batch.clickable[b, len(shown) :].any()


def test_features_know_nothing_of_how_an_episode_ended() -> None:
    names = {field.name for kind in (Features, Batch, ActionBatch) for field in fields(kind)}
    assert not {name for name in names if "reward" in name or "outcome" in name or "success" in name}


# --- renaming


def renamed(seed: int, chance: float = 1.0, jitter: float = 0.0) -> tuple[Batch, Batch]:
    """The cases before and after, with the first legal action of each."""
    batch = batch_of(*CASES)
    actions = collate_actions([legal_actions(*case)[0] for case in CASES])
    return batch, rename(batch, actions, chance, jitter, torch.Generator().manual_seed(seed))


@given(st.integers(0, 200))
def test_renaming_gives_a_word_the_same_new_name_in_goal_and_page(seed: int) -> None:
    before, after = renamed(seed)
    for b in range(len(before)):
        names: dict[int, int] = {}
        rows, opened = before.element_page == b, (before.token_page == b) & before.token_open
        pairs = [(before.element_words[rows].flatten(), after.element_words[rows].flatten())]
        pairs.append((before.token_words[opened], after.token_words[opened]))
        for old, new in pairs:
            for was, now in zip(old.tolist(), new.tolist(), strict=True):
                assert names.setdefault(was, now) == now
        assert names.get(PADDING, PADDING) == PADDING


def test_renaming_leaves_everything_but_words_as_it_was() -> None:
    before, after = renamed(0)
    names = [f.name for f in fields(Batch) if f.name != "blocks"]
    changed = {name for name in names if not torch.equal(getattr(before, name), getattr(after, name))}
    assert changed == {"token_words", "element_words"}
    assert before.blocks == after.blocks
    closed = before.token_real & ~before.token_open
    assert torch.equal(before.token_words[closed], after.token_words[closed])


def test_words_to_be_typed_are_renamed_although_the_page_lacks_them() -> None:
    batch = batch_of(CASES[1])  # Type ok.
    actions = collate_actions([Action(verb=Verb.TYPE, element=1, start=0, end=0)])
    closed = collate_actions([Action(verb=Verb.CLICK, element=0)])
    typed = rename(batch, actions, 1.0, 0.0, torch.Generator().manual_seed(1))
    clicked = rename(batch, closed, 1.0, 0.0, torch.Generator().manual_seed(1))
    assert typed.token_words[0] != batch.token_words[0]
    assert clicked.token_words[0] == batch.token_words[0]


def test_new_names_are_many_and_some_are_words_that_the_table_lacks() -> None:
    found: list[Tensor] = [after.element_words[after.row[2, :3], 0] for after in (renamed(s)[1] for s in range(100))]
    words = torch.cat(found)
    assert len(words.unique()) > 100
    assert 0.03 < (words == UNKNOWN).float().mean() < 0.3
    assert words.max() < len(vectors().table)
    assert words[words != UNKNOWN].min() >= FIRST_WORD


def test_chance_decides_how_many_pages_are_renamed() -> None:
    before, after = renamed(0, chance=0.0, jitter=1.0)
    assert torch.equal(before.element_words, after.element_words)
    assert torch.equal(before.element_flags, after.element_flags)


def test_jitter_moves_a_page_as_a_whole() -> None:
    before, after = renamed(0, jitter=0.1)
    moved = (after.element_flags - before.element_flags)[before.row[2, :3]]
    assert close(moved[:, :2], moved[:1, :2].expand(3, 2))
    assert 0 < moved[:, :2].abs().max() <= 0.1
    assert not moved[:, 2:].any()


def test_a_text_longer_than_is_read_is_cut() -> None:
    seen = featurise(page("t:" + "word " * 30), Goal("Go."), vectors())
    assert seen.element_ids[:, ELEMENT_WORDS].shape == (1, WORDS)
    assert (seen.element_ids[:, ELEMENT_WORDS] == vectors().row("word")).all()
    assert len(collate([seen])) == 1
