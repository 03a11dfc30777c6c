"""A test harness around `Admission`, without sockets."""

from __future__ import annotations

from typing import Any

from giirl_core.metrics import Metrics
from giirl_core.types import Episode
from giirl_core.wire import delivery
from giirl_core.wire import messages as wire
from giirl_core.wire.delivery import Grant, IncarnationCounts, Notice
from giirl_core.wire.messages import Stamp
from learner.stream.admission import Admission
from learner.stream.flow import IngestLimits
from learner.stream.snapshot import IngestSnapshot
from tests.giirl_core.wire_examples import episode


class AdmissionHarness:
    """An `Admission` whose policy version the test sets, and the messages that actors send to it.

    Each method that sends a message returns the kind of the reply, or the reason of a refusal; "" for no reply.
    """

    def __init__(self, *, snapshot: IngestSnapshot | None = None, held_out: float = 0.0, **limits: int) -> None:
        self.version = 3
        self.metrics = Metrics()
        self._notices = 0
        self.admission = Admission(
            "run",
            lambda: self.version,
            reward_version=lambda: self.version,
            limits=IngestLimits(**{"max_lag": 8, **limits}),
            metrics=self.metrics,
            snapshot=snapshot or IngestSnapshot(),
            held_out=held_out,
        )

    def hello(self, first_kept: int = 0, **fields: Any) -> str:
        return self.notice(delivery.HELLO, first_kept, **fields)

    def notice(
        self,
        kind: str,
        first_kept: int = 0,
        *,
        actor: str = "a",
        incarnation: int = 0,
        run: str = "run",
        finished: int = 0,
        full: bool = False,
        before: IncarnationCounts = (),
    ) -> str:
        self._notices += 1
        notice = Notice(
            kind=kind,
            stamp=Stamp(run=run, actor=actor, incarnation=incarnation, sequence=first_kept),
            number=self._notices,
            finished=max(first_kept, finished),
            full=full,
            before=before,
        )
        return self._send(actor, delivery.encode_notice(notice))

    def send_episode(
        self,
        sequence: int,
        *,
        actor: str = "a",
        incarnation: int = 0,
        run: str = "run",
        policy_version: int = 3,
    ) -> str:
        """The seed of the episode is its sequence number."""
        sent = episode(1, seed=sequence, policy_version=policy_version, reward_version=2)
        return self.send(sent, sequence, actor=actor, incarnation=incarnation, run=run)

    def send(self, sent: Episode, sequence: int, *, actor: str = "a", incarnation: int = 0, run: str = "run") -> str:
        stamp = Stamp(run=run, actor=actor, incarnation=incarnation, sequence=sequence)
        return self._send(actor, wire.encode_episode(sent, stamp=stamp))

    def _send(self, actor: str, message: bytes) -> str:
        reply = self.admission.receive(actor.encode(), message)
        if reply is None:
            return ""
        header, _ = wire.decode(reply)
        return str(header.get("reason", header["kind"]))

    def grant(self, actor: str = "a") -> Grant:
        grants = dict(self.admission.grants())
        return delivery.read_grant(wire.decode(grants[actor.encode()])[0])

    def snapshot(self) -> IngestSnapshot:
        frozen = self.admission.freeze()
        return self.admission.snapshot(frozen, self.admission.build(frozen))

    def count(self, name: str, **labels: str) -> float:
        return self.metrics.registry.get_sample_value(f"giirl_trajectories_{name}_total", labels) or 0.0

    def lost(self) -> float:
        return self.count("lost")

    def rejected(self, reason: str) -> float:
        return self.count("rejected", reason=reason)

    def dropped(self, reason: str) -> float:
        return self.count("dropped", reason=reason)

    def pull_seeds(self, episodes: int) -> list[int]:
        return [e.trajectory.seed for e in self.admission.pull(episodes) or []]
