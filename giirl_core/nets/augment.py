"""Data augmentation: replaces words of a page and its goal consistently, and shifts the page."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from giirl_core.nets.action_batch import ActionBatch
from giirl_core.nets.batch import Batch
from giirl_core.nets.language import FIRST_WORD, UNKNOWN
from giirl_core.types import NO_SPAN

DROP_PROB = 0.2  # of a word of a renamed page or its goal to become an unknown word
COMMON_WORDS = 4000  # replacements are among this many most frequent words of the table


def rename(batch: Batch, actions: ActionBatch, prob: float, jitter: float, generator: torch.Generator) -> Batch:
    """Replace the open words of some pages by random ones, the same in the goal and on the page.

    Each page is renamed with probability `prob`. The open words of its goal are replaced: those that are quoted or on
    the page, and those that its first action types. So are the words of its elements that are equal to one of these;
    the others keep their meaning. Overlap features do not change, because the replacement is consistent. Words that are
    not open become unknown with probability DROP_PROB, as do those of elements. The boxes of a renamed page are shifted
    together by up to `jitter`, as a fraction of the page. A net trained on such pages must read which words agree,
    because it cannot remember which pages were demonstrated. `generator` must be on the CPU.
    """
    size, device, token_page = len(batch), batch.token_words.device, batch.token_page
    chosen = (torch.rand(size, generator=generator) < prob).to(device)
    salt = (torch.randint(1, 1 << 30, (size,), generator=generator) | 1).to(device)
    shift = (torch.rand(size, 2, generator=generator) * 2 - 1).to(device) * jitter * chosen[:, None]
    position = torch.arange(len(token_page), device=device) - batch.token_row[token_page, 0]
    start, end = actions.start[token_page, 0], actions.end[token_page, 0]
    typed = (position >= start) & (position <= end) & (start != NO_SPAN)
    renamed = (batch.token_open | typed) & (batch.token_words >= FIRST_WORD) & chosen[token_page]
    dropped = (torch.rand(len(token_page), generator=generator) < DROP_PROB).to(device)
    dropped &= ~renamed & chosen[token_page] & (batch.token_words >= FIRST_WORD)
    lost = (torch.rand(len(batch.text_words), generator=generator) < DROP_PROB).to(device)
    lost &= chosen[batch.text_page] & (batch.text_words >= FIRST_WORD)
    token_words = torch.where(dropped, UNKNOWN, batch.token_words)
    text_words = torch.where(lost, UNKNOWN, batch.text_words)
    # A word and its page as one number. Words of elements that are not below `rows` occur in no goal.
    rows = int(token_words.max()) + 1
    shared = torch.isin(text_words + batch.text_page * rows, (token_words + token_page * rows)[renamed])
    shared &= text_words < rows
    page = batch.element_page
    flags = batch.element_flags.clone()
    flags[:, :2] += shift[page]
    return replace(
        batch,
        token_words=torch.where(renamed, _replacement(token_words, salt[token_page]), token_words),
        text_words=torch.where(shared, _replacement(text_words, salt[batch.text_page]), text_words),
        element_flags=flags,
    )


def _replacement(words: Tensor, salt: Tensor) -> Tensor:
    """A word that depends only on the old word and the salt; one in eight is an unknown word."""
    mixed = ((words * 2654435761 + salt * 40503) ^ (salt >> 3)) & 0x7FFFFFFF
    return torch.where(mixed % 8 == 0, UNKNOWN, FIRST_WORD + (mixed >> 3) % COMMON_WORDS)
