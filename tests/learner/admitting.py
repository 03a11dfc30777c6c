"""An admission without sockets, and the words to talk to it."""

from __future__ import annotations

from typing import Any

from giirl_core.metrics import Metrics
from giirl_core.wire import delivery
from giirl_core.wire import messages as wire
from giirl_core.wire.delivery import Grant, IncarnationCounts, Notice
from giirl_core.wire.messages import Stamp
from learner.stream.admission import Admission, IngestLimits
from learner.stream.snapshot import IngestSnapshot
from tests.giirl_core.wire_examples import episode


class Learner:
    """An admission with a clock of versions, and the words to talk to it."""

    def __init__(self, *, held: IngestSnapshot | None = None, held_out: float = 0.0, **limits: int) -> None:
        self.version = 3
        self.metrics = Metrics()
        self._notices = 0
        self.books = Admission(
            "run",
            lambda: self.version,
            reward_version=lambda: self.version,
            limits=IngestLimits(**{"max_lag": 8, **limits}),
            metrics=self.metrics,
            held=held or IngestSnapshot(),
            held_out=held_out,
        )

    def hello(self, base: int = 0, **stated: Any) -> str:
        return self.notice(delivery.HELLO, base, **stated)

    def notice(
        self,
        kind: str,
        base: int = 0,
        *,
        actor: str = "a",
        incarnation: int = 0,
        run: str = "run",
        finished: int = 0,
        full: bool = False,
        before: IncarnationCounts = (),
    ) -> str:
        self._notices += 1
        stamp = Stamp(run=run, actor=actor, incarnation=incarnation, sequence=base)
        said = Notice(
            kind=kind,
            stamp=stamp,
            number=self._notices,
            finished=max(base, finished),
            full=full,
            before=before,
        )
        return self._said(actor, delivery.encode_notice(said))

    def episode(
        self,
        sequence: int,
        *,
        actor: str = "a",
        incarnation: int = 0,
        run: str = "run",
        policy_version: int = 3,
    ) -> str:
        stamp = Stamp(run=run, actor=actor, incarnation=incarnation, sequence=sequence)
        sent = episode(1, seed=sequence, policy_version=policy_version, reward_version=2)
        return self._said(actor, wire.encode_episode(sent, stamp=stamp))

    def _said(self, actor: str, message: bytes) -> str:
        answer = self.books.receive(actor.encode(), message)
        if answer is None:
            return ""
        header, _ = wire.decode(answer)
        return str(header.get("reason", header["kind"]))

    def grant(self, actor: str = "a") -> Grant:
        told = dict(self.books.grants())
        return delivery.read_grant(wire.decode(told[actor.encode()])[0])

    def count(self, name: str, **labels: str) -> float:
        return self.metrics.registry.get_sample_value(f"giirl_trajectories_{name}_total", labels) or 0.0

    def dropped(self, reason: str) -> float:
        return self.count("dropped", reason=reason)

    def seeds(self, episodes: int) -> list[int]:
        return [e.trajectory.seed for e in self.books.pull(episodes) or []]
