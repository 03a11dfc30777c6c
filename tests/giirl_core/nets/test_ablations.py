"""What the nets do not read when a setting switches it off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from giirl_core.config import NetConfig
from giirl_core.nets.layout import ELEMENT_OVERLAP, TOKEN_OVERLAP
from giirl_core.nets.models import PolicyNet
from giirl_core.types import Goal
from tests.learner.samples import FLAT, batch_of, page, vectors


def test_without_goal_overlap_the_encoding_does_not_depend_on_common_words() -> None:
    batch = batch_of((FLAT, Goal('Click on the "Ok" button.')))
    for overlap, same in ((True, False), (False, True)):
        torch.manual_seed(0)
        net = PolicyNet(vectors(), NetConfig(width=16, goal_overlap=overlap))
        tokens, elements = batch.token_flags.clone(), batch.element_flags.clone()
        tokens[:, TOKEN_OVERLAP] = 0.0
        elements[:, ELEMENT_OVERLAP] = 0.0
        none = torch.zeros_like(batch.match_weight)
        without = replace(batch, match_weight=none, token_flags=tokens, element_flags=elements)
        assert torch.equal(net.encoder(batch).elements, net.encoder(without).elements) is same


def test_without_word_order_the_encoding_does_not_depend_on_it() -> None:
    one, two = Goal("Click Ok not Cancel"), Goal("Click Cancel not Ok")
    for order, same in ((True, False), (False, True)):
        torch.manual_seed(0)
        encoder = PolicyNet(vectors(), NetConfig(width=16, word_order=order, goal_overlap=False)).encoder
        first, second = (encoder(batch_of((FLAT, goal))).summary for goal in (one, two))
        assert torch.allclose(first, second, atol=1e-5) is same


def test_without_attention_an_element_is_encoded_independently_of_the_others() -> None:
    # The size of an element is relative to the largest one.
    pages = [replace(each, box=np.ones_like(each.box)) for each in (page("button:Ok"), page("button:Ok", "div:x"))]
    for attention, same in ((True, False), (False, True)):
        torch.manual_seed(0)
        encoder = PolicyNet(vectors(), NetConfig(width=16, element_attention=attention)).encoder
        first, second = (encoder(batch_of((each, Goal("Click Ok")))).elements[0] for each in pages)
        assert torch.allclose(first, second, atol=1e-6) is same
