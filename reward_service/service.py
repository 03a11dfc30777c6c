"""Serves the learned reward: gathers waiting requests into batches, and swaps weights between batches."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from giirl_core.metrics import Metrics, waiting
from giirl_core.types import UNSCORED, Trajectory, Weights
from giirl_core.wire import messages as wire
from giirl_core.wire.columns import Columns
from giirl_core.wire.messages import Header, WireError
from giirl_core.wire.scoring import NO_WEIGHTS, OVERLOADED, ScoreReply, build_request, encode_reply, read_request
from giirl_core.wire.transport import Keys, Router

Scorer: TypeAlias = Callable[[Sequence[Trajectory]], list[NDArray[np.float32]]]
LOG = logging.getLogger(__name__)
TICK_S = 0.1  # how soon a stop is noticed


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceLimits:
    """How much the service takes on at once."""

    max_batch_steps: int = 4096  # a batch is closed once it holds so many; one request may exceed it alone
    max_queue: int = 256  # requests; more are answered "overloaded"
    linger_s: float = 0.0  # how long a batch waits for company; whole milliseconds

    def __post_init__(self) -> None:
        if self.max_batch_steps < 1 or self.max_queue < 1 or not 0 <= self.linger_s <= 1:
            raise ValueError(f"{self} cannot serve: wanted 1 or more steps and requests, linger_s from 0 to 1")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Request:
    peer: bytes
    number: int
    header: Header
    arrays: Columns
    since_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _Loaded:
    version: int
    digest: str
    score: Scorer


class RewardService:
    """One router, one thread that serves; `set_weights` may be called from any other."""

    def __init__(
        self,
        load: Callable[[Weights], Scorer],
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        keys: Keys | None = None,
        limits: ServiceLimits | None = None,
        metrics: Metrics | None = None,
    ) -> None:
        self._load = load
        self._limits = limits or ServiceLimits()
        self._metrics = metrics or Metrics()
        self._loaded: _Loaded | None = None  # replaced by one assignment; a batch reads it once
        self._loading = threading.Lock()
        self._queue: deque[_Request] = deque()
        self._refusals = 0
        self._router = Router(host, port, keys=keys)
        self.address = self._router.address

    @property
    def version(self) -> int:
        """Of the weights in use, -1 before any."""
        loaded = self._loaded
        return loaded.version if loaded else UNSCORED

    def set_weights(self, weights: Weights, *, anew: bool = False) -> None:
        """Build a scorer from `weights`, then put it in place of the one in use.

        ValueError, and nothing changed, when they are corrupt, older than those in use, or others of the same
        version. The very ones in use may come again; and, where a learner came back to a checkpoint, older ones `anew`.
        """
        with self._loading:
            self._replace(weights, anew=anew)

    def set_first_weights(self, weights: Weights) -> None:
        """The same for those to begin with: not wanted any more when others have come before them."""
        with self._loading:
            if self._loaded is None:
                self._replace(weights)

    def _replace(self, weights: Weights, *, anew: bool = False) -> None:
        used = self._loaded
        if used and (used.version, used.digest) == (weights.version, weights.digest):
            return
        try:
            if weights.version <= self.version and not anew:
                raise ValueError(f"reward weights of version {weights.version} came after {self.version}")
            weights.check()
            score = self._load(weights)
        except ValueError:
            self._metrics.weights_refused.labels("reward").inc()
            raise
        self._loaded = _Loaded(version=weights.version, digest=weights.digest, score=score)
        self._metrics.reward_version.set(weights.version)

    def serve(self, stop: Callable[[], bool]) -> None:
        """Answer until `stop`, then let go of the port."""
        try:
            while not stop():
                self.serve_once(TICK_S)
        finally:
            self._router.close()

    def serve_once(self, timeout_s: float) -> None:
        """Wait for requests, then answer one batch."""
        if (refusals := self._router.refusals) > self._refusals:
            self._metrics.connections_refused.labels("scoring").inc(refusals - self._refusals)
            self._refusals = refusals
        if not self._queue:
            with waiting(self._metrics, "score_requests"):
                self._admit(timeout_s)
        if self._queue:
            self._admit(self._limits.linger_s)
            self._answer(self._next_batch())

    def _admit(self, timeout_s: float) -> None:
        """Queue what has arrived. Bounded, so that a flood cannot keep the queue itself from being served."""
        for _ in range(2 * self._limits.max_queue):
            received = self._router.recv(timeout_s)
            if received is None:
                return
            timeout_s = 0.0
            self._queue_up(*received)

    def _queue_up(self, peer: bytes, message: bytes) -> None:
        since_s = time.monotonic()
        try:
            header, arrays = wire.decode(message)
            number = read_request(header)
        except WireError as error:
            self._metrics.scoring_requests.labels("malformed").inc()
            LOG.warning("dropped a message of %r: %s", peer, error)
            return
        request = _Request(peer=peer, number=number, header=header, arrays=arrays, since_s=since_s)
        if len(self._queue) >= self._limits.max_queue:
            self._refuse(request, OVERLOADED, result="overloaded")
        else:
            self._queue.append(request)

    def _next_batch(self) -> list[tuple[_Request, list[Trajectory]]]:
        batch: list[tuple[_Request, list[Trajectory]]] = []
        steps = 0
        while self._queue and steps < self._limits.max_batch_steps:
            request = self._queue.popleft()
            try:
                trajectories = build_request(request.header, request.arrays)
            except WireError as error:
                LOG.warning("refused a request of %r: %s", request.peer, error)
                self._refuse(request, f"invalid request: {error}", result="malformed")
                continue
            batch.append((request, trajectories))
            steps += sum(map(len, trajectories))
        return batch

    def _answer(self, batch: list[tuple[_Request, list[Trajectory]]]) -> None:
        if not batch:
            return
        loaded = self._loaded
        if loaded is None:
            for request, _ in batch:
                self._refuse(request, NO_WEIGHTS, result="no_weights")
            return
        trajectories = [trajectory for _, part in batch for trajectory in part]
        try:
            rewards = loaded.score(trajectories)
            _check(rewards, trajectories)
        except Exception as error:  # whatever a net makes of a strange page, the next request is another's
            LOG.exception("scoring %d trajectories with version %d failed", len(trajectories), loaded.version)
            self._answer_apart(batch, f"scoring failed: {error}")
            return
        first = 0
        for request, part in batch:
            share = tuple(rewards[first : first + len(part)])
            first += len(part)
            self._reply(
                request,
                ScoreReply(request=request.number, rewards=share, version=loaded.version, backlog=len(self._queue)),
                result="ok",
            )

    def _answer_apart(self, batch: list[tuple[_Request, list[Trajectory]]], error: str) -> None:
        """One request spoiled the batch: the others still get their rewards."""
        if len(batch) == 1:
            self._refuse(batch[0][0], error, result="failed")
        else:
            for entry in batch:
                self._answer([entry])

    def _refuse(self, request: _Request, error: str, *, result: str) -> None:
        self._reply(request, ScoreReply(request=request.number, error=error, backlog=len(self._queue)), result=result)

    def _reply(self, request: _Request, reply: ScoreReply, *, result: str) -> None:
        sent = self._router.send(request.peer, encode_reply(reply))
        self._metrics.scoring_requests.labels(result if sent else "unreachable").inc()
        self._metrics.scoring_duration.observe(time.monotonic() - request.since_s)


def _check(rewards: Sequence[NDArray[np.float32]], trajectories: Sequence[Trajectory]) -> None:
    found, wanted = [len(part) for part in rewards], [len(trajectory) for trajectory in trajectories]
    if found != wanted:
        raise ValueError(f"the scorer gave rewards of lengths {found[:8]}, wanted {wanted[:8]}")
    if not all(bool(np.isfinite(part).all()) for part in rewards):
        raise ValueError("the scorer gave a reward that is not finite")
