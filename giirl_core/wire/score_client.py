"""The client of the reward service: sends requests to the least loaded replica, and retries at another one."""

from __future__ import annotations

import random
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

from giirl_core.types import UNSCORED, Trajectory
from giirl_core.wire.addresses import split_key
from giirl_core.wire.messages import WireError
from giirl_core.wire.scoring import RETRYABLE, Rewards, ScoreReply, decode_reply, encode_request
from giirl_core.wire.transport import Dealer, Keys

BACKOFF_S = 0.02  # after the first retryable error of a replica; doubles with each further one
BACKOFF_MAX_S = 1.0
PROBE_S = 1.0  # between two probes of a silent replica
WAIT_S = 0.02  # to receive from a single replica
WAIT_EACH_S = 0.001  # to receive from each of several replicas


@dataclass(slots=True, kw_only=True)
class _Replica:
    address: str
    dealer: Dealer
    rewards_in_flight: int = 0  # in requests that it has not answered
    backlog: int = 0  # requests queued there, by its last reply
    retryable_errors: int = 0  # in a row
    backoff_until_s: float = 0.0  # no requests are sent to it before
    heard_s: float = 0.0  # time of its last reply
    unreachable_s: float | None = None  # since when there is no connection
    probe: bytes = b""  # it is silent, and this is the request that it did not answer; b"" when it answers
    probe_at_s: float = 0.0  # time of the next probe


@dataclass(slots=True, kw_only=True)
class _Request:
    key: object
    message: bytes
    rewards: tuple[int, ...]  # wanted for each trajectory
    attempts: int = 0  # how often it was sent, without those that were answered with a retryable error
    replica: _Replica | None = None  # where the current attempt was sent
    attempt_s: float = 0.0  # start of the current attempt
    end_s: float  # deadline of the request
    error: str = "no answer"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Result:
    key: object
    rewards: tuple[Rewards, ...] | None
    version: int
    error: str = ""


class ScoreClient:
    """Requests rewards without blocking. Belongs to one thread.

        client.submit(key, trajectory)
        ...
        for key, rewards, version in client.poll(): ...

    An attempt that is not answered within `timeout_s` is repeated up to `retries` times, at another replica if there is
    one. After a retryable error ("overloaded", "no weights yet") the request is sent again, after a backoff and without
    using up a retry. In any case the request fails after `timeout_s * (retries + 1)`.

    A replica that answers nothing for `timeout_s` is silent: all its requests go to the others, and until it answers
    again it gets only a copy of an old request every PROBE_S, for which nobody waits.
    """

    def __init__(
        self,
        addresses: Sequence[str],
        *,
        identity: str,
        timeout_s: float = 2.0,
        retries: int = 2,
        keys: Keys | None = None,
    ) -> None:
        self.ignored_replies = 0  # late, repeated or damaged ones
        self._identity, self._keys = identity, keys
        self._timeout_s, self._retries = timeout_s, retries
        self._numbers = count()
        self._pending: dict[int, _Request] = {}
        self._replicas: list[_Replica] = []
        self.set_replicas(addresses)

    @property
    def pending(self) -> int:
        """Number of requests that have neither succeeded nor failed."""
        return len(self._pending)

    @property
    def answering(self) -> bool:
        """Whether there is a replica that is not silent."""
        return any(not replica.probe for replica in self._replicas)

    def set_replicas(self, addresses: Sequence[str]) -> None:
        """Replace the list of replicas. Pending requests of removed replicas are sent to the new ones."""
        removed = {replica.address: replica for replica in self._replicas}
        self._replicas = [removed.pop(a) if a in removed else self._connect(a) for a in addresses]
        for replica in removed.values():
            replica.dealer.close()
        for request in self._pending.values():
            if request.replica and request.replica.address in removed:
                request.replica = None

    def submit(self, key: object, trajectory: Trajectory) -> None:
        """Request the rewards of one trajectory; `poll` returns them with `key`."""
        self._add(key, [trajectory])
        self._send()

    def poll(self) -> list[tuple[object, Rewards | None, int]]:
        """The requests that have finished since the last call: key, rewards [T], reward version.

        The rewards are None for a request that failed.
        """
        return [(r.key, r.rewards[0] if r.rewards else None, r.version) for r in self._receive(0.0)]

    def score(self, trajectories: Sequence[Trajectory]) -> tuple[list[Rewards], int]:
        """Request rewards and wait for them: an array [T] for each trajectory, and the reward version.

        Raises TimeoutError when the request fails, ValueError while submitted requests are pending.
        """
        if self._pending:
            raise ValueError(f"{len(self._pending)} submitted requests are pending, wanted none: call poll first")
        self._add(None, trajectories)
        results: list[_Result] = []
        while not results:
            results = self._receive(WAIT_S if len(self._replicas) == 1 else WAIT_EACH_S)
        result = results[0]
        if result.rewards is None:
            addresses = ", ".join(split_key(replica.address)[0] for replica in self._replicas) or "no address"
            raise TimeoutError(
                f"the reward service at {addresses} gave no rewards for {len(trajectories)} episodes: {result.error}"
            )
        return list(result.rewards), result.version

    def cancel_pending(self) -> list[object]:
        """Cancel all pending requests; returns their keys."""
        keys = [request.key for request in self._pending.values()]
        self._pending.clear()
        return keys

    def close(self) -> None:
        """Cancel all pending requests and close the connections."""
        self._pending.clear()
        self.set_replicas([])

    def _connect(self, address: str) -> _Replica:
        dealer = Dealer(address, identity=self._identity.encode(), keys=self._keys)
        return _Replica(address=address, dealer=dealer)

    def _add(self, key: object, trajectories: Sequence[Trajectory]) -> None:
        number = next(self._numbers)
        self._pending[number] = _Request(
            key=key,
            message=encode_request(number, trajectories),
            rewards=tuple(trajectory.reward_count for trajectory in trajectories),
            end_s=time.monotonic() + self._timeout_s * (self._retries + 1),
        )

    def _send(self) -> None:
        now_s = time.monotonic()
        for request in self._pending.values():
            replica = request.replica
            if replica and now_s >= request.attempt_s + self._timeout_s:
                if replica.heard_s < request.attempt_s:
                    self._mark_silent(replica, request.message, now_s)
                self._detach(request)
                request.error = f"no answer within {self._timeout_s} s, tried {request.attempts} times"
            elif replica and replica.probe and self.answering:
                self._detach(request)  # sent before the replica was known to be silent
        for request in self._pending.values():
            if request.replica is None and request.attempts <= self._retries:
                self._send_to_best(request, now_s)
        for replica in self._replicas:
            if replica.probe and now_s >= replica.probe_at_s:
                replica.probe_at_s = now_s + PROBE_S
                replica.dealer.send(replica.probe)

    def _mark_silent(self, replica: _Replica, message: bytes, now_s: float) -> None:
        if not replica.probe:
            replica.probe, replica.probe_at_s = message, now_s + PROBE_S

    def _send_to_best(self, request: _Request, now_s: float) -> None:
        """Send to the least loaded reachable replica that is not backing off; to silent ones only if all are."""
        answering = [replica for replica in self._replicas if not replica.probe] or self._replicas
        available = [replica for replica in answering if now_s >= replica.backoff_until_s]
        for replica in sorted(available, key=lambda r: r.rewards_in_flight + r.backlog):
            if replica.dealer.send(request.message):
                request.replica, request.attempt_s = replica, now_s
                request.attempts += 1
                replica.rewards_in_flight += sum(request.rewards)
                replica.unreachable_s = None
                return
            replica.unreachable_s = replica.unreachable_s or now_s
            if now_s >= replica.unreachable_s + self._timeout_s:
                self._mark_silent(replica, request.message, now_s)
        if available and not request.attempts:
            refusals = sum(replica.dealer.refusals for replica in self._replicas)
            request.error = f"no connection ({refusals} refusals)"

    def _detach(self, request: _Request) -> None:
        """End the current attempt of a request."""
        if request.replica:
            request.replica.rewards_in_flight -= sum(request.rewards)
        request.replica = None

    def _receive(self, wait_s: float) -> list[_Result]:
        self._send()
        results = []
        for replica in self._replicas or ():
            while (message := replica.dealer.recv(wait_s)) is not None:
                wait_s = 0.0
                if (result := self._read(replica, message)) is not None:
                    results.append(result)
        if not self._replicas:
            time.sleep(wait_s)
        now_s = time.monotonic()
        for number, request in list(self._pending.items()):
            exhausted = request.attempts > self._retries and request.replica is None
            if exhausted or now_s >= request.end_s:
                self._detach(self._pending.pop(number))
                results.append(_Result(key=request.key, rewards=None, version=UNSCORED, error=request.error))
        return results

    def _read(self, replica: _Replica, message: bytes) -> _Result | None:
        try:
            reply = decode_reply(message)
        except WireError:
            self.ignored_replies += 1
            return None
        replica.backlog, replica.heard_s, replica.probe = reply.backlog, time.monotonic(), b""
        request = self._pending.get(reply.request)
        if request is None:
            self.ignored_replies += 1
            return None
        if reply.error in RETRYABLE:
            self._back_off(replica, request, reply)
            return None
        replica.retryable_errors = 0
        self._detach(self._pending.pop(reply.request))
        if reply.error or tuple(len(part) for part in reply.rewards) != request.rewards:
            error = reply.error or "the reply has another number of rewards than were wanted"
            return _Result(key=request.key, rewards=None, version=UNSCORED, error=error)
        return _Result(key=request.key, rewards=reply.rewards, version=reply.version)

    def _back_off(self, replica: _Replica, request: _Request, reply: ScoreReply) -> None:
        now_s = time.monotonic()
        if now_s >= replica.backoff_until_s:
            backoff_s = min(BACKOFF_S * 2**replica.retryable_errors, BACKOFF_MAX_S)
            replica.backoff_until_s = now_s + backoff_s * random.uniform(0.5, 1.0)
            replica.retryable_errors += 1
        if request.replica is replica:
            self._detach(request)
            request.attempts -= 1
            request.error = reply.error
