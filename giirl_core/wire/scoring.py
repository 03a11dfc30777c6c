"""What actors and the reward service say to each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from giirl_core.types import UNSCORED, Trajectory
from giirl_core.wire import columns as cols
from giirl_core.wire import messages as wire
from giirl_core.wire.columns import Columns, take
from giirl_core.wire.messages import Header, WireError

MAX_BATCH = 4096  # trajectories in one request
OVERLOADED = "overloaded"
NO_WEIGHTS = "no weights yet"
NOT_NOW = frozenset({OVERLOADED, NO_WEIGHTS})  # answers that are worth asking again
Rewards = NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreReply:
    """What the reward service answers: rewards of one version, or why there are none."""

    request: int
    rewards: tuple[Rewards, ...] = ()  # one [T] for each trajectory of the request
    version: int = UNSCORED
    error: str = ""
    backlog: int = 0  # requests that wait behind this one

    def __post_init__(self) -> None:
        if self.backlog < 0:
            raise ValueError(f"a score reply tells a backlog of {self.backlog}, wanted 0 or more")


def encode_request(request: int, trajectories: Sequence[Trajectory]) -> bytes:
    """Ask for the rewards of some trajectories."""
    if not 0 < len(trajectories) <= MAX_BATCH:
        raise ValueError(f"a score request holds {len(trajectories)} trajectories, wanted 1 to {MAX_BATCH}")
    heads = [cols.head(trajectory) for trajectory in trajectories]
    return wire.encode({"kind": "score", "request": request, "heads": heads}, cols.pack(trajectories))


def read_request(header: Header) -> int:
    """The number that ties a reply to its request."""
    wire.expect(header, "score")
    with wire.untrusted():
        return take(header, "request", int)


def build_request(header: Header, arrays: Columns) -> list[Trajectory]:
    """The trajectories of a decoded request."""
    heads = header.get("heads")
    if not isinstance(heads, list) or not 0 < len(heads) <= MAX_BATCH:
        raise WireError(f"a score request has heads {heads!r:.80}, wanted 1 to {MAX_BATCH}")
    if not all(isinstance(head, dict) for head in heads):
        raise WireError("a score request has a head that is no set of fields")
    with wire.untrusted():
        trajectories = cols.unpack(arrays, heads)
        for trajectory in trajectories:
            trajectory.check_learnable()
        return trajectories


def encode_reply(reply: ScoreReply) -> bytes:
    """The answer to one request."""
    header: dict[str, object] = {"kind": "scores"}
    header |= {name: getattr(reply, name) for name in ("request", "version", "error", "backlog")}
    rewards = np.concatenate([np.empty(0, np.float32), *reply.rewards], dtype=np.float32)
    steps = np.array([len(part) for part in reply.rewards], dtype=np.uint32)
    return wire.encode(header, {"steps": steps, "rewards": rewards})


def decode_reply(message: bytes) -> ScoreReply:
    """The inverse of `encode_reply`."""
    header, arrays = wire.decode(message)
    wire.expect(header, "scores")
    with wire.untrusted():
        steps, rewards = cols.flat(arrays, {"steps": "<u4", "rewards": "<f4"})
        ends = np.cumsum(steps, dtype=np.int64)
        if len(steps) > MAX_BATCH or (int(ends[-1]) if len(ends) else 0) != len(rewards):
            raise WireError(f"a score reply cuts {len(rewards)} rewards into {len(steps)} parts of other sizes")
        if not bool(np.isfinite(rewards).all()):
            raise WireError("a score reply holds a reward that is not finite")
        return ScoreReply(
            request=take(header, "request", int),
            rewards=tuple(np.split(rewards, ends[:-1])) if len(ends) else (),
            version=take(header, "version", int),
            error=take(header, "error", str),
            backlog=take(header, "backlog", int),
        )
