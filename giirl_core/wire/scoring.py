"""The messages between actors and the reward service: scoring requests and their replies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from giirl_core.types import UNSCORED, Trajectory
from giirl_core.wire import columns as cols
from giirl_core.wire import messages as wire
from giirl_core.wire.columns import Columns, read_field
from giirl_core.wire.messages import Header, WireError

MAX_BATCH = 4096  # trajectories in one request
OVERLOADED = "overloaded"
NO_WEIGHTS = "no weights yet"
RETRYABLE = frozenset({OVERLOADED, NO_WEIGHTS})  # errors after which the same request can succeed later
Rewards = NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreReply:
    """The reply of the reward service to one request: rewards, or an error."""

    request: int  # number of the request
    rewards: tuple[Rewards, ...] = ()  # one array [T] for each trajectory of the request
    version: int = UNSCORED  # learner step of the reward net that computed the rewards
    error: str = ""  # "" when there are rewards
    backlog: int = 0  # number of requests queued behind this one

    def __post_init__(self) -> None:
        if self.backlog < 0:
            raise ValueError(f"ScoreReply.backlog is {self.backlog}, wanted 0 or more")


def encode_request(request: int, trajectories: Sequence[Trajectory]) -> bytes:
    """The request for the rewards of some trajectories; `request` is its number, which the reply repeats.

    Raises ValueError when there are no trajectories or more than MAX_BATCH.
    """
    if not 0 < len(trajectories) <= MAX_BATCH:
        raise ValueError(f"scoring request has {len(trajectories)} trajectories, wanted 1 to {MAX_BATCH}")
    heads = [cols.header_fields(trajectory) for trajectory in trajectories]
    return wire.encode({"kind": "score", "request": request, "heads": heads}, cols.pack(trajectories))


def read_request(header: Header) -> int:
    """The number of a request, from its header. Raises WireError."""
    wire.check_kind(header, "score")
    with wire.as_wire_error():
        return read_field(header, "request", int)


def build_request(header: Header, arrays: Columns) -> list[Trajectory]:
    """The trajectories of a decoded request. Raises WireError."""
    heads = header.get("heads")
    if not isinstance(heads, list) or not 0 < len(heads) <= MAX_BATCH:
        raise WireError(f"header field 'heads' is {heads!r:.80}, wanted a list of 1 to {MAX_BATCH}")
    if not all(isinstance(head, dict) for head in heads):
        raise WireError(f"header field 'heads' is {heads!r:.80}, wanted maps of fields")
    with wire.as_wire_error():
        return cols.unpack(arrays, heads)


def encode_reply(reply: ScoreReply) -> bytes:
    """The message of a reply."""
    header: dict[str, object] = {"kind": "scores"}
    header |= {name: getattr(reply, name) for name in ("request", "version", "error", "backlog")}
    rewards = np.concatenate([np.empty(0, np.float32), *reply.rewards], dtype=np.float32)
    steps = np.array([len(part) for part in reply.rewards], dtype=np.uint32)
    return wire.encode(header, {"steps": steps, "rewards": rewards})


def decode_reply(message: bytes) -> ScoreReply:
    """The inverse of `encode_reply`. Raises WireError."""
    header, arrays = wire.decode(message)
    wire.check_kind(header, "scores")
    with wire.as_wire_error():
        steps, rewards = cols.read_vectors(arrays, {"steps": "<u4", "rewards": "<f4"})
        ends = np.cumsum(steps, dtype=np.int64)
        if len(steps) > MAX_BATCH or (int(ends[-1]) if len(ends) else 0) != len(rewards):
            raise WireError(
                f"column 'steps' splits {len(rewards)} rewards into {steps.tolist()[:8]}, "
                f"wanted at most {MAX_BATCH} parts that add up to {len(rewards)}"
            )
        if not bool(np.isfinite(rewards).all()):
            raise WireError("column 'rewards' holds a number that is not finite")
        return ScoreReply(
            request=read_field(header, "request", int),
            rewards=tuple(np.split(rewards, ends[:-1])) if len(ends) else (),
            version=read_field(header, "version", int),
            error=read_field(header, "error", str),
            backlog=read_field(header, "backlog", int),
        )
