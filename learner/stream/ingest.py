"""The learner's end of the episode stream: a thread receives episodes from the actors while the learner computes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Sequence

from giirl_core.gestures import BASIC, Gesture
from giirl_core.metrics import Metrics, waiting
from giirl_core.types import Episode
from giirl_core.wire.delivery import IncarnationCounts
from giirl_core.wire.transport import Keys, Router
from learner.stream.admission import Admission
from learner.stream.flow import IngestLimits
from learner.stream.snapshot import IngestSnapshot

TICK_S = 0.1  # longest wait for a message; bounds how long `close` takes
STALL_S = 5.0  # a longer gap between two rounds means that this process was suspended
MAX_BURST = 256  # messages processed before grants are sent


class Ingest:
    """Receives episodes from actors; `take` returns them. Thread-safe, except for `close`.

    A lock guards the admission state. The socket belongs to the ingest thread.
    """

    def __init__(
        self,
        run: str,
        policy_version: Callable[[], int],
        *,
        reward_version: Callable[[], int] | None = None,
        host: str = "127.0.0.1",
        port: int = 0,
        limits: IngestLimits | None = None,
        keys: Keys | None = None,
        metrics: Metrics | None = None,
        snapshot: IngestSnapshot | None = None,
        held_out: float = 0.0,
        gestures: Sequence[Gesture] = BASIC,
    ) -> None:
        self._metrics = metrics or Metrics()
        self._admission = Admission(
            run,
            policy_version,
            reward_version=reward_version,
            limits=limits or IngestLimits(),
            metrics=self._metrics,
            snapshot=snapshot or IngestSnapshot(),
            held_out=held_out,
            gestures=gestures,
        )
        self._refusals = 0
        self._listened_s = time.monotonic()
        self._lock = threading.Condition()
        self._error: BaseException | None = None
        self._stop = threading.Event()
        self._router = Router(host, port, keys=keys)
        self.address = self._router.address
        self._thread = threading.Thread(target=self._run, name="ingest", daemon=True)
        self._thread.start()

    def allow(self, public_keys: Iterable[bytes]) -> None:
        """Accept connections of actors with these public keys only. The ingest needs keys of its own."""
        self._router.allow(public_keys)

    def take(self, episodes: int, timeout_s: float) -> list[Episode]:
        """Wait for the next `episodes` fresh episodes, in order of arrival.

        Raises TimeoutError when there are fewer after `timeout_s`; those stay in the queue.
        Raises RuntimeError when the ingest thread has failed.
        """
        deadline_s = time.monotonic() + timeout_s
        with waiting(self._metrics, "rollouts"), self._lock:
            while True:
                batch = self._admission.pull(episodes)
                self._router.wake()  # credits were freed, so grants are due
                if batch is not None:
                    return batch
                if self._error:
                    raise RuntimeError(f"the ingest thread failed: {self._error!r}") from self._error
                left_s = deadline_s - time.monotonic()
                if left_s <= 0:
                    raise TimeoutError(
                        f"fewer than {episodes} episodes arrived within {timeout_s} s: "
                        f"{self._admission.describe_shortage()}"
                    )
                self._lock.wait(left_s)

    def snapshot(self) -> IngestSnapshot:
        """The state at this moment, for a checkpoint: queued episodes, actor offsets and episode counts.

        Call it from the thread that calls `take`.
        """
        with self._lock:
            frozen = self._admission.freeze()
        problems = self._admission.build(frozen)  # without the lock, so that actors are answered meanwhile
        with self._lock:
            return self._admission.snapshot(frozen, problems)

    def commit(self, snapshot: IngestSnapshot) -> None:
        """Tell actors that a checkpoint with `snapshot` is on disk: they may discard the episodes that it covers.

        Pass the snapshot that was saved, not a later one: episodes that arrived since are not in the checkpoint.
        """
        with self._lock:
            self._admission.commit(snapshot)
        self._router.wake()

    @property
    def wants_commit(self) -> bool:
        """Whether an actor has filled its buffer and has to wait for a checkpoint before it can go on."""
        with self._lock:
            return self._admission.wants_commit

    def retire(self, actor: str, finished: IncarnationCounts) -> None:
        """Remove an actor for good. Of `finished`, its own count per incarnation, what never arrived is lost."""
        with self._lock:
            self._admission.retire(actor, finished)

    def silent_for_s(self, actor: str) -> float:
        """Seconds since the actor's last message; infinite if there was none, or if it has said goodbye."""
        with self._lock:
            return self._admission.silent_for_s(actor)

    @property
    def queued(self) -> int:
        """The number of episodes that are accepted and not yet taken."""
        with self._lock:
            return self._admission.queued

    @property
    def stale(self) -> int:
        """Episodes dropped as stale in this history."""
        with self._lock:
            return self._admission.stale

    @property
    def idle_share(self) -> float:
        """The share of their tabs that the connected actors leave idle, because the learner takes no more."""
        with self._lock:
            return self._admission.idle_share

    def close(self) -> None:
        """Stop the thread and release the port."""
        self._stop.set()
        self._router.wake()
        self._thread.join(timeout=10)
        if self._thread.is_alive():
            raise RuntimeError("the ingest thread did not stop within 10 s")
        self._router.close()

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                self._run_once()
        except BaseException as error:
            with self._lock:
                self._error = error
                self._lock.notify_all()
            raise

    def _run_once(self) -> None:
        """Receive a burst of messages, then send the grants that have changed."""
        gap_s, self._listened_s = time.monotonic() - self._listened_s, time.monotonic()
        if gap_s > STALL_S:  # this process was suspended, so the actors were not silent
            with self._lock:
                self._admission.extend_deadlines(gap_s)
        timeout_s = TICK_S
        for _ in range(MAX_BURST):
            received = self._router.recv(timeout_s)
            if received is None:
                break
            timeout_s = 0.0
            peer, message = received
            with self._lock:
                reply = self._admission.receive(peer, message)
                self._lock.notify_all()
            if reply is not None:
                self._router.send(peer, reply)  # fails if the peer has disconnected; then the reply is not needed
        if (refusals := self._router.refusals) > self._refusals:
            self._metrics.connections_refused.labels("trajectories").inc(refusals - self._refusals)
            self._refusals = refusals
        with self._lock:
            grants = self._admission.grants()
            self._metrics.trajectories_queued.set(self._admission.queued)
        for peer, grant in grants:
            self._router.send(peer, grant)  # an actor that misses a grant gets another after its next heartbeat
