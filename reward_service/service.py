"""Serves the learned reward: collects score requests into batches, and replaces the weights between batches."""

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
from giirl_core.types import UNSCORED, Trajectory
from giirl_core.weights import Weights
from giirl_core.wire import messages as wire
from giirl_core.wire.columns import Columns
from giirl_core.wire.messages import Header, WireError
from giirl_core.wire.scoring import NO_WEIGHTS, OVERLOADED, ScoreReply, build_request, encode_reply, read_request
from giirl_core.wire.transport import Keys, Router

Scorer: TypeAlias = Callable[[Sequence[Trajectory]], list[NDArray[np.float32]]]  # rewards [T] for each trajectory
LOG = logging.getLogger(__name__)
TICK_S = 0.1  # longest wait for a request before `stop` is checked


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceLimits:
    """Bounds of the queue and of a batch."""

    max_batch_steps: int = 4096  # a batch is complete once it has this many; a single request may have more
    max_queue: int = 256  # requests; further ones get the reply "overloaded"
    linger_s: float = 0.0  # how long a batch waits for further requests; rounded to milliseconds

    def __post_init__(self) -> None:
        if self.max_batch_steps < 1 or self.max_queue < 1 or not 0 <= self.linger_s <= 1:
            raise ValueError(f"{self} is out of range: wanted steps and requests >= 1 and linger_s in [0, 1]")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Request:
    peer: bytes
    number: int
    header: Header
    arrays: Columns
    received_s: float  # monotonic time


@dataclass(frozen=True, slots=True, kw_only=True)
class _Loaded:
    version: int
    digest: str
    score: Scorer


class RewardService:
    """Runs in the thread that calls `serve`; the other methods may be called from other threads."""

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
        """`load` builds a scorer from weights; it raises ValueError if they do not fit."""
        self._load = load
        self._limits = limits or ServiceLimits()
        self._metrics = metrics or Metrics()
        self._loaded: _Loaded | None = None  # replaced in one assignment; a batch reads it once
        self._loading = threading.Lock()
        self._queue: deque[_Request] = deque()
        self._refusals = 0
        self._router = Router(host, port, keys=keys)
        self.address = self._router.address

    def allow(self, public_keys: Sequence[bytes]) -> None:
        """Accept connections of clients with these public keys only. The service needs keys of its own."""
        self._router.allow(public_keys)

    @property
    def version(self) -> int:
        """The version of the current weights, -1 before the first."""
        loaded = self._loaded
        return loaded.version if loaded else UNSCORED

    def set_weights(self, weights: Weights, *, allow_older: bool = False) -> None:
        """Build a scorer from `weights`, then replace the current one. The current weights are accepted again.

        Raises ValueError, and changes nothing, if the weights are corrupt, do not fit, are older than the current
        ones, or have the same version but other content. `allow_older` accepts the latter two: a learner that was
        resumed from a checkpoint counts versions from there.
        """
        with self._loading:
            self._replace(weights, allow_older=allow_older)

    def set_first_weights(self, weights: Weights) -> None:
        """Like `set_weights`, but does nothing if there are weights already: newer ones may have overtaken these."""
        with self._loading:
            if self._loaded is None:
                self._replace(weights)

    def _replace(self, weights: Weights, *, allow_older: bool = False) -> None:
        current = self._loaded
        if current and (current.version, current.digest) == (weights.version, weights.digest):
            return
        try:
            if weights.version <= self.version and not allow_older:
                raise ValueError(f"reward weights have version {weights.version}, wanted one after {self.version}")
            weights.check()
            score = self._load(weights)
        except ValueError:
            self._metrics.weights_refused.labels("reward").inc()
            raise
        self._loaded = _Loaded(version=weights.version, digest=weights.digest, score=score)
        self._metrics.reward_version.set(weights.version)
        self._metrics.health.ready()

    def serve(self, stop: Callable[[], bool]) -> None:
        """Reply to requests until `stop` returns True, then release the port."""
        try:
            while not stop():
                self.serve_once(TICK_S)
        finally:
            self._metrics.health.not_ready("it has stopped serving")
            self._router.close()

    def serve_once(self, timeout_s: float) -> None:
        """Wait for requests, then reply to one batch."""
        self._metrics.health.beat()
        if (refusals := self._router.refusals) > self._refusals:
            self._metrics.connections_refused.labels("scoring").inc(refusals - self._refusals)
            self._refusals = refusals
        if not self._queue:
            with waiting(self._metrics, "score_requests"):
                self._receive(timeout_s)
        if self._queue:
            self._receive(self._limits.linger_s)
            self._score(self._next_batch())

    def _receive(self, timeout_s: float) -> None:
        """Queue the requests that have arrived. The loop is bounded, so that a flood cannot delay replies forever."""
        for _ in range(2 * self._limits.max_queue):
            received = self._router.recv(timeout_s)
            if received is None:
                return
            timeout_s = 0.0
            self._enqueue(*received)

    def _enqueue(self, peer: bytes, message: bytes) -> None:
        received_s = time.monotonic()
        try:
            header, arrays = wire.decode(message)
            number = read_request(header)
        except WireError as error:
            self._metrics.scoring_requests.labels("malformed").inc()
            LOG.warning("dropped a message from %r: %s", peer, error)
            return
        request = _Request(peer=peer, number=number, header=header, arrays=arrays, received_s=received_s)
        if len(self._queue) >= self._limits.max_queue:
            self._reply_error(request, OVERLOADED, result="overloaded")
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
                LOG.warning("rejected a request from %r: %s", request.peer, error)
                self._reply_error(request, f"invalid request: {error}", result="malformed")
                continue
            batch.append((request, trajectories))
            steps += sum(map(len, trajectories))
        return batch

    def _score(self, batch: list[tuple[_Request, list[Trajectory]]]) -> None:
        if not batch:
            return
        loaded = self._loaded
        if loaded is None:
            for request, _ in batch:
                self._reply_error(request, NO_WEIGHTS, result="no_weights")
            return
        trajectories = [trajectory for _, part in batch for trajectory in part]
        try:
            rewards = loaded.score(trajectories)
            _check(rewards, trajectories)
        except Exception as error:  # the net may fail on an unusual page; other clients still need the service
            LOG.exception("scoring %d trajectories with version %d failed", len(trajectories), loaded.version)
            self._score_separately(batch, f"scoring failed: {error}")
            return
        first = 0
        for request, part in batch:
            own = tuple(rewards[first : first + len(part)])
            first += len(part)
            self._reply(
                request,
                ScoreReply(request=request.number, rewards=own, version=loaded.version, backlog=len(self._queue)),
                result="ok",
            )

    def _score_separately(self, batch: list[tuple[_Request, list[Trajectory]]], error: str) -> None:
        """After a batch has failed: score its requests one by one, so that only the failing ones get an error."""
        if len(batch) == 1:
            self._reply_error(batch[0][0], error, result="failed")
        else:
            for entry in batch:
                self._score([entry])

    def _reply_error(self, request: _Request, error: str, *, result: str) -> None:
        self._reply(request, ScoreReply(request=request.number, error=error, backlog=len(self._queue)), result=result)

    def _reply(self, request: _Request, reply: ScoreReply, *, result: str) -> None:
        sent = self._router.send(request.peer, encode_reply(reply))
        self._metrics.scoring_requests.labels(result if sent else "unreachable").inc()
        self._metrics.scoring_duration.observe(time.monotonic() - request.received_s)


def _check(rewards: Sequence[NDArray[np.float32]], trajectories: Sequence[Trajectory]) -> None:
    found, wanted = [len(part) for part in rewards], [trajectory.reward_count for trajectory in trajectories]
    if found != wanted:
        raise ValueError(f"the scorer returned rewards of lengths {found[:8]}, wanted {wanted[:8]}")
    if not all(bool(np.isfinite(part).all()) for part in rewards):
        raise ValueError("the scorer returned a reward that is not finite")
