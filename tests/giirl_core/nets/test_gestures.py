"""The nets with more gestures than to click and to type words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
import pytest
import torch
from torch import Tensor

from giirl_core.choices import Choice, action_of, choice_of
from giirl_core.config import CloningConfig, NetConfig
from giirl_core.gestures import Gesture, read_gestures
from giirl_core.metrics import Metrics
from giirl_core.nets.action_batch import (
    ActionBatch,
    collate_candidates,
    legal_pairs,
    random_actions,
    random_logp,
)
from giirl_core.nets.batch import Batch
from giirl_core.nets.models import PolicyNet, RewardNet
from giirl_core.nets.reward import RewardModel
from giirl_core.types import Action, Page, Trajectory, Verb
from learner.cloning import Cloner
from learner.data import featurise_trajectory
from tests.learner.samples import CASES, FLAT, WIDTH, batch_of, page, trajectory, vectors

TEXTS = ("hover", "drag to", "type text-of", "press Enter", "wait", "scroll by 0 100")
GESTURES = read_gestures(TEXTS)
CONFIG = NetConfig(width=WIDTH, gestures=TEXTS)


@pytest.fixture(scope="module")
def net() -> PolicyNet:
    torch.manual_seed(3)
    scaled = PolicyNet(vectors(), CONFIG)
    with torch.no_grad():
        for parameter in scaled.parameters():
            parameter.mul_(1.6)
    return scaled


def choices(case: int, gestures: Sequence[Gesture] = GESTURES) -> list[Choice]:
    """All legal choices on a page under a goal."""
    case_page, goal = CASES[case]
    words, found = len(goal.tokens), []
    for element, gesture in legal_pairs(batch_of(CASES[case]), gestures)[0].nonzero().tolist():
        if str(gestures[gesture]) == "type words":
            found += [Choice(gesture, element, start, end) for start in range(words) for end in range(start, words)]
        elif gestures[gesture].has_second:
            found += [Choice(gesture, element, second) for second in range(len(case_page))]
        else:
            found.append(Choice(gesture, element))
    return found


@pytest.mark.parametrize("case", range(len(CASES)))
def test_the_probabilities_of_all_choices_sum_to_one(case: int, net: PolicyNet) -> None:
    batch, every = batch_of(CASES[case], *CASES), collate_candidates(choices(case))
    rows = ActionBatch(**{f.name: getattr(every, f.name).expand(len(batch), -1) for f in fields(every)})
    assert net.evaluate(net.encoder(batch), rows)[0][0].exp().sum().item() == pytest.approx(1.0, abs=1e-5)
    assert random_logp(batch, rows, GESTURES)[0].exp().sum().item() == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("random", [False, True])
def test_sampled_choices_are_legal_and_as_frequent_as_their_probabilities(random: bool, net: PolicyNet) -> None:
    batch, every, count = batch_of(CASES[1]), choices(1), 8000
    numbers = torch.rand(1, count, 3, generator=torch.Generator().manual_seed(0))
    drawn, logp = _sample(net, batch_of(CASES[1]), numbers, random)
    found = [Choice(*row) for row in drawn.table()[0].tolist()]
    assert set(found) <= set(every)
    expected = random_logp(batch, drawn, GESTURES) if random else net.evaluate(net.encoder(batch), drawn)[0]
    assert torch.allclose(logp, expected, atol=1e-5)
    for choice, p in dict(zip(found, logp[0].exp().tolist(), strict=True)).items():
        assert found.count(choice) / count == pytest.approx(p, abs=4 * (p * (1 - p) / count) ** 0.5 + 1e-3)


def _sample(net: PolicyNet, batch: Batch, numbers: Tensor, random: bool) -> tuple[ActionBatch, Tensor]:
    if not random:
        return net.sample(net.encoder(batch), numbers)
    drawn = random_actions(batch, numbers, GESTURES)
    return drawn, random_logp(batch, drawn, GESTURES)


@pytest.mark.parametrize("case", range(len(CASES)))
def test_every_choice_is_read_back_from_its_action(case: int) -> None:
    case_page, gestures = CASES[case][0], read_gestures([*TEXTS, "drag across", "drag by 33 0", "drag by 30 0"])
    for choice in choices(case, gestures):
        action = action_of(choice, case_page, gestures)
        again = choice_of(action, case_page, gestures)
        assert again is not None
        assert again.gesture == choice.gesture
        assert action_of(again, case_page, gestures) == action  # copies may be of another element with the same text


def test_half_of_the_random_actions_are_basic(net: PolicyNet) -> None:
    drawn = random_actions(batch_of(*CASES), torch.rand(3, 4000, 3), GESTURES)
    assert torch.allclose((drawn.gesture < 2).float().mean(1), torch.full((3,), 0.5), atol=0.04)


def test_the_reward_reads_the_gesture_and_the_second_element() -> None:
    torch.manual_seed(0)
    reward = RewardModel(RewardNet(vectors(), CONFIG), vectors(), "logit", 100.0)
    actions = [
        Action(verb=Verb.CLICK, element=0),
        Action(verb=Verb.HOVER, element=0),
        Action(verb=Verb.DRAG, element=0, to=1),
        Action(verb=Verb.DRAG, element=0, to=2),
    ]
    scores = reward.score_actions(FLAT, CASES[2][1], actions)
    assert len(set(np.round(scores, 6))) == len(actions)
    with pytest.raises(ValueError, match=r"DOUBLE_CLICK.* is none of the 8 gestures of the nets"):
        reward.score_actions(FLAT, CASES[2][1], [Action(verb=Verb.DOUBLE_CLICK, element=0)])
    with pytest.raises(ValueError, match="no gesture that the nets learn"):
        reward.score([trajectory("Ok.", [FLAT], [Action(verb=Verb.DOUBLE_CLICK, element=0)])])


NAMES = ("ada", "bea", "cyd", "dot", "eve", "fay")


def dragging(name: str, other: str, *, first: bool) -> tuple[Page, Trajectory]:
    """Drag the tile that the goal names onto the bin."""
    tiles = [f"li:{name}", f"li:{other}"] if first else [f"li:{other}", f"li:{name}"]
    shown = page(*tiles, "button:bin")
    action = Action(verb=Verb.DRAG, element=0 if first else 1, to=2)
    return shown, trajectory(f"Drag {name} to the bin.", [shown], [action])


def test_cloning_learns_what_to_drag_and_where() -> None:
    torch.manual_seed(0)
    net = PolicyNet(vectors(), NetConfig(width=WIDTH, gestures=("drag to",)))
    cloner = Cloner(CloningConfig(rename_prob=0), net, torch.Generator().manual_seed(0), metrics=Metrics())
    pairs = [(a, b) for a in NAMES[:5] for b in NAMES[:5] if a != b]
    shown = [dragging(a, b, first=first)[1] for a, b in pairs for first in (True, False)]
    examples = [featurise_trajectory(one, vectors(), net.gestures) for one in shown]
    for _ in range(150):
        cloner.update(examples)
    for first in (True, False):
        new_page, wanted = dragging(NAMES[5], NAMES[0], first=first)
        batch = batch_of((new_page, wanted.goal))
        greedy = net.sample(net.encoder(batch), None)[0].first()[0]
        assert greedy == choice_of(wanted.actions[0], new_page, net.gestures)
        assert action_of(greedy, new_page, net.gestures) == wanted.actions[0]
