"""Asking the reward service: of several replicas the least loaded, and another one when that does not answer."""

from __future__ import annotations

import random
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

from giirl_core.types import UNSCORED, Trajectory
from giirl_core.wire.messages import WireError
from giirl_core.wire.scoring import NOT_NOW, Rewards, ScoreReply, decode_reply, encode_request
from giirl_core.wire.transport import Dealer, Keys

BACKOFF_S = 0.02  # after the first "not now" of a replica; doubles
BACKOFF_MAX_S = 1.0
WAIT_S = 0.02  # for an answer, where one replica is all there is to listen to
GLANCE_S = 0.001  # where there are several


@dataclass(slots=True, kw_only=True)
class _Replica:
    address: str
    dealer: Dealer
    under_way: int = 0  # steps of ours that it has not answered
    backlog: int = 0  # requests that waited there when it answered last
    put_off: int = 0  # "not now" in a row
    rests_until_s: float = 0.0  # it said "not now"
    suspect_until_s: float = 0.0  # it did not answer: only asked when there is no other


@dataclass(slots=True, kw_only=True)
class _Question:
    key: object
    message: bytes
    steps: tuple[int, ...]
    tries: int = 0  # how often it was sent and not put off
    asked: _Replica | None = None  # who has it
    due_s: float = 0.0  # when to stop waiting for that answer
    end_s: float  # when to give up altogether
    trouble: str = "no answer"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Answer:
    key: object
    rewards: tuple[Rewards, ...] | None
    version: int
    trouble: str = ""


class ScoreClient:
    """Asks reward services without ever waiting for them: submit, go on, poll.

    A question that is not answered within `timeout_s` is asked again up to `retries` times, of another replica if
    there is one. One answered "not now" is asked again for as long as all those tries would have taken. Belongs to
    one thread.
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
        self.strays = 0  # replies that came too late, twice, or damaged
        self._identity, self._keys = identity, keys
        self._timeout_s, self._retries = timeout_s, retries
        self._numbers = count()
        self._open: dict[int, _Question] = {}
        self._replicas: list[_Replica] = []
        self.follow(addresses)

    @property
    def pending(self) -> int:
        """Questions neither answered nor given up."""
        return len(self._open)

    def follow(self, addresses: Sequence[str]) -> None:
        """These are the replicas from now on; what others have not answered is asked of these."""
        known = {replica.address: replica for replica in self._replicas}
        self._replicas = [known.pop(a) if a in known else self._connect(a) for a in addresses]
        for replica in known.values():
            replica.dealer.close()
        for question in self._open.values():
            if question.asked and question.asked.address in known:
                question.asked = None

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
            settled = self._settle(WAIT_S if len(self._replicas) == 1 else GLANCE_S)
        if settled[0].rewards is None:
            where = ", ".join(replica.address for replica in self._replicas) or "no address"
            asked = f"the reward service at {where} gave no rewards for {len(trajectories)} trajectories"
            raise TimeoutError(f"{asked}: {settled[0].trouble}")
        return list(settled[0].rewards), settled[0].version

    def give_up(self) -> list[object]:
        """The keys of all that is pending: whoever asked goes on without."""
        keys = [question.key for question in self._open.values()]
        self._open.clear()
        return keys

    def close(self) -> None:
        """Forget what is pending."""
        self._open.clear()
        self.follow([])

    def _connect(self, address: str) -> _Replica:
        dealer = Dealer(address, identity=self._identity.encode(), keys=self._keys)
        return _Replica(address=address, dealer=dealer)

    def _ask(self, key: object, trajectories: Sequence[Trajectory]) -> None:
        number = next(self._numbers)
        self._open[number] = _Question(
            key=key,
            message=encode_request(number, trajectories),
            steps=tuple(len(trajectory) for trajectory in trajectories),
            end_s=time.monotonic() + self._timeout_s * (self._retries + 1),
        )

    def _send(self) -> None:
        now_s = time.monotonic()
        for question in self._open.values():
            if question.asked and now_s >= question.due_s:
                question.asked.suspect_until_s = now_s + self._timeout_s
                self._take_back(question)
                question.trouble = f"no answer within {self._timeout_s} s, asked {question.tries} times"
            if question.asked is None and question.tries <= self._retries:
                self._send_to_someone(question, now_s)

    def _send_to_someone(self, question: _Question, now_s: float) -> None:
        """The least loaded that may be asked and can be reached, those who answer first."""
        awake = [replica for replica in self._replicas if now_s >= replica.rests_until_s]
        for replica in sorted(awake, key=lambda r: (r.suspect_until_s > now_s, r.under_way + r.backlog)):
            if replica.dealer.send(question.message):
                question.asked, question.due_s = replica, now_s + self._timeout_s
                question.tries += 1
                replica.under_way += sum(question.steps)
                return
        if awake and not question.tries:
            refusals = sum(replica.dealer.refusals for replica in self._replicas)
            question.trouble = f"no connection ({refusals} refusals)"

    def _take_back(self, question: _Question) -> None:
        if question.asked:
            question.asked.under_way -= sum(question.steps)
        question.asked = None

    def _settle(self, wait_s: float) -> list[_Answer]:
        self._send()
        answers = []
        for replica in self._replicas or ():
            while (message := replica.dealer.recv(wait_s)) is not None:
                wait_s = 0.0
                if (answer := self._read(replica, message)) is not None:
                    answers.append(answer)
        if not self._replicas:
            time.sleep(wait_s)
        now_s = time.monotonic()
        for number, question in list(self._open.items()):
            spent = question.tries > self._retries and question.asked is None
            if spent or now_s >= question.end_s:
                self._take_back(self._open.pop(number))
                answers.append(_Answer(key=question.key, rewards=None, version=UNSCORED, trouble=question.trouble))
        return answers

    def _read(self, replica: _Replica, message: bytes) -> _Answer | None:
        try:
            reply = decode_reply(message)
        except WireError:
            self.strays += 1
            return None
        replica.backlog, replica.suspect_until_s = reply.backlog, 0.0
        question = self._open.get(reply.request)
        if question is None:
            self.strays += 1
            return None
        if reply.error in NOT_NOW:
            self._put_off(replica, question, reply)
            return None
        replica.put_off = 0
        self._take_back(self._open.pop(reply.request))
        if reply.error or tuple(len(part) for part in reply.rewards) != question.steps:
            trouble = reply.error or "rewards for other steps than were asked about"
            return _Answer(key=question.key, rewards=None, version=UNSCORED, trouble=trouble)
        return _Answer(key=question.key, rewards=reply.rewards, version=reply.version)

    def _put_off(self, replica: _Replica, question: _Question, reply: ScoreReply) -> None:
        now_s = time.monotonic()
        if now_s >= replica.rests_until_s:
            pause_s = min(BACKOFF_S * 2**replica.put_off, BACKOFF_MAX_S)
            replica.rests_until_s = now_s + pause_s * random.uniform(0.5, 1.0)
            replica.put_off += 1
        if question.asked is replica:
            self._take_back(question)
            question.tries -= 1
            question.trouble = reply.error
