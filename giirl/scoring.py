"""Asking the reward service: the messages both ends speak, and the end that asks."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np
from numpy.typing import NDArray

from giirl import columns as cols
from giirl import wire
from giirl.columns import Columns, take
from giirl.spec import UNSCORED, Trajectory
from giirl.transport import Dealer, Keys
from giirl.wire import Header, WireError

MAX_BATCH = 4096  # trajectories in one request
OVERLOADED = "overloaded"
NO_WEIGHTS = "no weights yet"
NOT_NOW = frozenset({OVERLOADED, NO_WEIGHTS})  # answers that are worth asking again
BACKOFF_S = 0.02  # after the first "not now"; doubles
BACKOFF_MAX_S = 1.0
Rewards = NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreReply:
    """What the reward service answers: rewards of one version, or why there are none."""

    request: int
    rewards: tuple[Rewards, ...] = ()  # one [T] for each trajectory of the request
    version: int = UNSCORED
    error: str = ""


def encode_request(request: int, trajectories: Sequence[Trajectory]) -> list[bytes]:
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
            trajectory.check_learned()
        return trajectories


def encode_reply(reply: ScoreReply) -> list[bytes]:
    """The answer to one request."""
    header = {"kind": "scores", "request": reply.request, "version": reply.version, "error": reply.error}
    rewards = np.concatenate([np.empty(0, np.float32), *reply.rewards], dtype=np.float32)
    steps = np.array([len(part) for part in reply.rewards], dtype=np.uint32)
    return wire.encode(header, {"steps": steps, "rewards": rewards})


def decode_reply(frames: Sequence[bytes]) -> ScoreReply:
    """The inverse of `encode_reply`."""
    header, arrays = wire.decode(frames)
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
        )


@dataclass(slots=True, kw_only=True)
class _Question:
    key: object
    frames: list[bytes]
    steps: tuple[int, ...]
    tries: int = 0  # how often it was sent and not put off
    put_off: int = 0  # how often the answer was "not now"
    asked: bool = False  # on its way; False: waits until `due_s` to be sent
    due_s: float  # when to send it, or to stop waiting for its answer
    end_s: float  # when to give up altogether
    trouble: str = "no answer"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Answer:
    key: object
    rewards: tuple[Rewards, ...] | None
    version: int
    trouble: str = ""


class ScoreClient:
    """Asks a reward service without ever waiting for it: submit, go on, poll.

    A question that is not answered within `timeout_s` is asked again up to `retries` times, also of a service
    that was started anew on the same address. One answered "not now" is asked again for as long as all those
    tries would have taken. Belongs to one thread.
    """

    def __init__(
        self,
        address: str,
        *,
        identity: str,
        timeout_s: float = 2.0,
        retries: int = 2,
        keys: Keys | None = None,
    ) -> None:
        self.address = address
        self.strays = 0  # replies that came too late, twice, or damaged
        self._timeout_s = timeout_s
        self._retries = retries
        self._dealer = Dealer(address, identity=identity.encode(), keys=keys)
        self._numbers = count()
        self._open: dict[int, _Question] = {}

    @property
    def pending(self) -> int:
        """Questions neither answered nor given up."""
        return len(self._open)

    def submit(self, key: object, trajectory: Trajectory) -> None:
        """Ask for one trajectory's rewards; `poll` will name them by `key`."""
        self._ask(key, [trajectory])
        self._send()

    def poll(self) -> list[tuple[object, Rewards | None, int]]:
        """What has been settled since: key, rewards, their version. No rewards: asking was given up."""
        return [(a.key, a.rewards[0] if a.rewards else None, a.version) for a in self._settle(0.0)]

    def score(self, trajectories: Sequence[Trajectory]) -> tuple[list[Rewards], int]:
        """Ask and wait. For scripts: only while nothing submitted is pending."""
        if self._open:
            raise ValueError(f"{len(self._open)} submitted questions are pending: poll until there are none")
        self._ask(None, trajectories)
        settled: list[_Answer] = []
        while not settled:
            settled = self._settle(0.02)
        if settled[0].rewards is None:
            asked = f"the reward service at {self.address} gave no rewards for {len(trajectories)} trajectories"
            raise TimeoutError(f"{asked}: {settled[0].trouble}")
        return list(settled[0].rewards), settled[0].version

    def close(self) -> None:
        """Forget what is pending."""
        self._open.clear()
        self._dealer.close()

    def _ask(self, key: object, trajectories: Sequence[Trajectory]) -> None:
        number = next(self._numbers)
        now_s = time.monotonic()
        self._open[number] = _Question(
            key=key,
            frames=encode_request(number, trajectories),
            steps=tuple(len(trajectory) for trajectory in trajectories),
            due_s=now_s,
            end_s=now_s + self._timeout_s * (self._retries + 1),
        )

    def _send(self) -> None:
        now_s = time.monotonic()
        for question in self._open.values():
            if question.asked and now_s >= question.due_s:
                question.asked = False
                question.trouble = f"no answer within {self._timeout_s} s, asked {question.tries} times"
            if not question.asked and now_s >= question.due_s and question.tries <= self._retries:
                if not self._dealer.send(question.frames):
                    if not question.tries:
                        question.trouble = f"no connection ({self._dealer.refusals} refusals)"
                    break
                question.asked = True
                question.tries += 1
                question.due_s = now_s + self._timeout_s

    def _settle(self, wait_s: float) -> list[_Answer]:
        self._send()
        answers = []
        while (frames := self._dealer.recv(wait_s)) is not None:
            wait_s = 0.0
            if (answer := self._read(frames)) is not None:
                answers.append(answer)
        now_s = time.monotonic()
        for number, question in list(self._open.items()):
            spent = question.tries > self._retries and not question.asked
            if spent or now_s >= question.end_s:
                del self._open[number]
                answers.append(_Answer(key=question.key, rewards=None, version=UNSCORED, trouble=question.trouble))
        return answers

    def _read(self, frames: list[bytes]) -> _Answer | None:
        try:
            reply = decode_reply(frames)
        except WireError:
            self.strays += 1
            return None
        question = self._open.get(reply.request)
        if question is None:
            self.strays += 1
            return None
        if reply.error in NOT_NOW:
            if question.asked:
                question.asked = False
                question.tries -= 1
                question.trouble = reply.error
                question.due_s = time.monotonic() + min(BACKOFF_S * 2**question.put_off, BACKOFF_MAX_S)
                question.put_off += 1
            return None
        del self._open[reply.request]
        if reply.error or tuple(len(part) for part in reply.rewards) != question.steps:
            trouble = reply.error or "rewards for other steps than were asked about"
            return _Answer(key=question.key, rewards=None, version=UNSCORED, trouble=trouble)
        return _Answer(key=question.key, rewards=reply.rewards, version=reply.version)
