"""Example episodes (a small fixed one, and hypothesis strategies), and malformed messages with a valid checksum."""

from __future__ import annotations

import msgpack
import numpy as np
from hypothesis import strategies as st

from giirl_core.types import VERB_FIELDS, Action, Episode, Goal, Outcome, Page, Trajectory, Verb
from giirl_core.wire import messages as wire
from giirl_core.wire.messages import Stamp

STAMP = Stamp(run="run-1", actor="actor-7", incarnation=2, sequence=41)
# JavaScript strings, and therefore pages, may contain lone surrogates.
TEXT = st.text(st.characters(codec=None), max_size=6)
NUMBER = st.floats(-1e4, 1e4, width=32)


def page(*labels: str) -> Page:
    """A page of buttons with these labels."""
    count = len(labels)
    return Page(
        tag=("button",) * count,
        text=labels,
        value=("",) * count,
        classes=("wide",) * count,
        ref=np.arange(count, dtype=np.int32) + 1,
        parent=np.full(count, -1, dtype=np.int16),
        box=np.arange(count * 4, dtype=np.float32).reshape(count, 4),
        focused=np.zeros(count, dtype=np.bool_),
        tampered=np.arange(count) == 0,
    )


def episode(steps: int = 2, *, seed: int = 5, policy_version: int = 3, reward_version: int = -1) -> Episode:
    """An episode that clicks the same button in every step."""
    return Episode(
        trajectory=Trajectory(
            task="click-button",
            goal=Goal('Click "Ok".'),
            seed=seed,
            pages=tuple(page("Ok", "Né", "") for _ in range(steps)),
            actions=tuple(Action(verb=Verb.CLICK, element=0) for _ in range(steps)),
            behaviour_logp=np.full(steps, -0.5, dtype=np.float32),
            rewards=np.zeros(steps, dtype=np.float32),
            policy_version=policy_version,
            reward_version=reward_version,
        ),
        outcome=Outcome(raw_reward=1.0, ended=True),
    )


@st.composite
def pages(draw: st.DrawFn) -> Page:
    """Any page with at least one element."""
    count = draw(st.integers(1, 5))
    texts = st.lists(TEXT, min_size=count, max_size=count).map(tuple)
    return Page(
        tag=draw(texts),
        text=draw(texts),
        value=draw(texts),
        classes=draw(texts),
        ref=np.array(draw(st.lists(st.integers(-(2**31), 2**31 - 1), min_size=count, max_size=count)), np.int32),
        parent=np.array([draw(st.integers(-1, row - 1)) for row in range(count)], np.int16),
        box=np.array(draw(st.lists(NUMBER, min_size=count * 4, max_size=count * 4)), np.float32).reshape(-1, 4),
        focused=np.array(draw(st.lists(st.booleans(), min_size=count, max_size=count)), np.bool_),
        tampered=np.array(draw(st.lists(st.booleans(), min_size=count, max_size=count)), np.bool_),
        colour=draw(texts),
        shape=draw(texts),
        attributes=draw(texts),
    )


@st.composite
def actions(draw: st.DrawFn, page: Page, goal: Goal) -> Action:
    """Any action on a page."""
    rows, offsets = st.integers(-1, len(page) - 1), st.tuples(NUMBER, NUMBER)
    verb = draw(st.sampled_from(Verb))
    start = draw(st.integers(-1, len(goal.tokens) - 1)) if "start" in VERB_FIELDS[verb] else -1
    literal = draw(TEXT) if "literal" in VERB_FIELDS[verb] and start < 0 else ""
    return Action(
        verb=verb,
        element=draw(rows),
        start=start,
        end=start if start < 0 else draw(st.integers(start, len(goal.tokens) - 1)),
        literal=draw(st.sampled_from(("Enter", "Control+c"))) if verb is Verb.PRESS else literal,
        at=draw(offsets) if "at" in VERB_FIELDS[verb] else (0.0, 0.0),
        by=draw(offsets) if "by" in VERB_FIELDS[verb] else (0.0, 0.0),
        to=draw(rows) if "to" in VERB_FIELDS[verb] else -1,
    )


@st.composite
def trajectories(draw: st.DrawFn) -> Trajectory:
    """Any trajectory of one to four steps."""
    path = tuple(draw(st.lists(pages(), min_size=1, max_size=4)))
    goal = Goal("w" + draw(TEXT))
    numbers = st.lists(NUMBER, min_size=len(path), max_size=len(path))
    return Trajectory(
        task=draw(TEXT),
        goal=goal,
        seed=draw(st.integers(0, 2**53)),
        pages=path,
        actions=tuple(draw(actions(page, goal)) for page in path),
        behaviour_logp=np.array(draw(numbers), np.float32),
        rewards=np.array(draw(numbers), np.float32),
        policy_version=draw(st.integers(-1, 10**9)),
        reward_version=draw(st.integers(-1, 10**9)),
    )


episodes = st.builds(
    Episode,
    trajectory=trajectories(),
    outcome=st.builds(Outcome, raw_reward=st.floats(-1, 1), ended=st.booleans()),
)


def raw_message(header: object, columns: bytes = b"") -> bytes:
    """A message with a valid checksum and any header."""
    return raw_message_bytes(msgpack.packb(header), columns)


def raw_message_bytes(header: bytes, columns: bytes = b"") -> bytes:
    """A message with a valid checksum and a header that need not be msgpack."""
    return with_prefix(wire.LENGTH.pack(len(header)) + header + wire.PADDING[len(header) % wire.ALIGN] + columns)


def with_prefix(body: bytes) -> bytes:
    """A message with a valid prefix and any body."""
    return wire.PREFIX.pack(wire.MAGIC, wire.SCHEMA_VERSION, wire.checksum(body)) + body


def assert_same_trajectory(found: Trajectory, wanted: Trajectory) -> None:
    """Check that all fields are equal, bit for bit and in type."""
    for name in ("task", "goal", "seed", "actions", "policy_version", "reward_version"):
        assert getattr(found, name) == getattr(wanted, name)
    for name in ("behaviour_logp", "rewards"):
        _assert_same_array(getattr(found, name), getattr(wanted, name))
    for found_page, wanted_page in zip(found.pages, wanted.pages, strict=True):
        for name in ("tag", "text", "value", "classes", "colour", "shape", "attributes"):
            assert getattr(found_page, name) == getattr(wanted_page, name)
        for name in ("ref", "parent", "box", "focused", "tampered"):
            _assert_same_array(getattr(found_page, name), getattr(wanted_page, name))


def assert_same_episode(found: Episode, wanted: Episode) -> None:
    """Check that the trajectories and the outcomes are equal."""
    assert_same_trajectory(found.trajectory, wanted.trajectory)
    assert found.outcome == wanted.outcome


def _assert_same_array(found: np.ndarray, wanted: np.ndarray) -> None:
    assert found.dtype == wanted.dtype
    assert found.shape == wanted.shape
    assert found.tobytes() == wanted.tobytes()
