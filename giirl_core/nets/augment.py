"""Augmentation: the same pages and goals in other words."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from giirl_core.nets.action_batch import ActionBatch
from giirl_core.nets.batch import Batch
from giirl_core.nets.language import FIRST_WORD, UNKNOWN
from giirl_core.types import NO_SPAN

COMMON_WORDS = 4000  # renamed words come from this many of the commonest, whatever the table


def rename(batch: Batch, actions: ActionBatch, prob: float, jitter: float, generator: torch.Generator) -> Batch:
    """The same pages in other words: open words become random ones, alike in goal and page.

    A page is renamed with probability `prob`. Open are the words that the page gives their meaning and those that its
    first action types. Overlap features stay as they are, since renaming is consistent. The boxes of such a page
    shift together by up to `jitter` of the page. A net that sees this must read which words agree, and cannot
    remember which pages were demonstrated. `generator` is of the CPU.
    """
    size, device, token_page = len(batch), batch.token_words.device, batch.token_page
    chosen = (torch.rand(size, generator=generator) < prob).to(device)
    salt = (torch.randint(1, 1 << 30, (size,), generator=generator) | 1).to(device)
    shift = (torch.rand(size, 2, generator=generator) * 2 - 1).to(device) * jitter * chosen[:, None]
    position = torch.arange(len(token_page), device=device) - batch.token_row[token_page, 0]
    start, end = actions.start[token_page, 0], actions.end[token_page, 0]
    typed = (position >= start) & (position <= end) & (start != NO_SPAN)
    opened = (batch.token_open | typed) & (batch.token_words >= FIRST_WORD) & chosen[token_page]
    page = batch.element_page
    flags = batch.element_flags.clone()
    flags[:, :2] += shift[page]
    return replace(
        batch,
        token_words=torch.where(opened, _other(batch.token_words, salt[token_page]), batch.token_words),
        element_words=torch.where(
            (batch.element_words >= FIRST_WORD) & chosen[page, None],
            _other(batch.element_words, salt[page, None]),
            batch.element_words,
        ),
        element_flags=flags,
    )


def _other(words: Tensor, salt: Tensor) -> Tensor:
    """A word that depends on the old word and the salt alone; one in eight is a word the table lacks."""
    mixed = ((words * 2654435761 + salt * 40503) ^ (salt >> 3)) & 0x7FFFFFFF
    return torch.where(mixed % 8 == 0, UNKNOWN, FIRST_WORD + (mixed >> 3) % COMMON_WORDS)
