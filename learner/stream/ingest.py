"""Where episodes reach the learner: a thread hears the actors while the learner computes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from giirl_core.metrics import Metrics, waiting
from giirl_core.types import Episode
from giirl_core.wire.delivery import IncarnationCounts
from giirl_core.wire.transport import Keys, Router
from learner.stream.admission import Admission, IngestLimits
from learner.stream.snapshot import IngestSnapshot

TICK_S = 0.1  # how soon the thread notices that it should stop
DEAF_S = 5.0  # between two turns of a process that runs there is far less
MAX_BURST = 256  # messages heard before grants are told


class Ingest:
    """Actors on one side, `take` on the other. A lock guards the books; the socket is the thread's alone."""

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
        held: IngestSnapshot | None = None,
        held_out: float = 0.0,
    ) -> None:
        self._metrics = metrics or Metrics()
        self._books = Admission(
            run,
            policy_version,
            reward_version=reward_version,
            limits=limits or IngestLimits(),
            metrics=self._metrics,
            held=held or IngestSnapshot(),
            held_out=held_out,
        )
        self._refusals = 0
        self._listened_s = time.monotonic()
        self._lock = threading.Condition()
        self._broken: BaseException | None = None
        self._stop = threading.Event()
        self._router = Router(host, port, keys=keys)
        self.address = self._router.address
        self._thread = threading.Thread(target=self._pump, name="ingest", daemon=True)
        self._thread.start()

    def take(self, episodes: int, timeout_s: float) -> list[Episode]:
        """The next `episodes` fresh ones, in order of arrival. On TimeoutError those that came stay here."""
        deadline_s = time.monotonic() + timeout_s
        with waiting(self._metrics, "rollouts"), self._lock:
            while True:
                batch = self._books.pull(episodes)
                self._router.wake()  # credits were freed
                if batch is not None:
                    return batch
                if self._broken:
                    raise RuntimeError(f"the ingest thread ended: {self._broken!r}") from self._broken
                left_s = deadline_s - time.monotonic()
                if left_s <= 0:
                    raise TimeoutError(
                        f"no {episodes} episodes within {timeout_s} s: {self._books.describe_shortage()}"
                    )
                self._lock.wait(left_s)

    def snapshot(self) -> IngestSnapshot:
        """Everything accepted and not yet taken, and what has been judged, at one moment."""
        with self._lock:
            return self._books.snapshot()

    def committed(self, held: IngestSnapshot) -> None:
        """A checkpoint with this snapshot is on the disk: actors may forget what it covers.

        Never a later snapshot: what arrived while the checkpoint was written is not in it.
        """
        with self._lock:
            self._books.commit(held)
        self._router.wake()

    @property
    def wants_commit(self) -> bool:
        """Whether an actor can go on only after a checkpoint: it keeps as many copies as it may."""
        with self._lock:
            return self._books.wants_commit

    def retire(self, actor: str, finished: IncarnationCounts) -> None:
        """An actor has gone for good. What it finished, by its own count, and did not deliver is lost."""
        with self._lock:
            self._books.retire(actor, finished)

    def silent_for_s(self, actor: str) -> float:
        """How long ago an actor was last heard; infinite when it never was."""
        with self._lock:
            return self._books.silent_for_s(actor)

    @property
    def queued(self) -> int:
        """Episodes accepted and not yet taken."""
        with self._lock:
            return self._books.queued

    def close(self) -> None:
        """Stop hearing, and let go of the port."""
        self._stop.set()
        self._router.wake()
        self._thread.join(timeout=10)
        if self._thread.is_alive():
            raise RuntimeError("the ingest thread did not stop within 10 s")
        self._router.close()

    def _pump(self) -> None:
        try:
            while not self._stop.is_set():
                self._turn()
        except BaseException as error:
            with self._lock:
                self._broken = error
                self._lock.notify_all()
            raise

    def _turn(self) -> None:
        deaf_s, self._listened_s = time.monotonic() - self._listened_s, time.monotonic()
        if deaf_s > DEAF_S:  # this whole process was stopped: nobody else has been silent
            with self._lock:
                self._books.extend_deadlines(deaf_s)
        timeout_s = TICK_S
        for _ in range(MAX_BURST):
            received = self._router.recv(timeout_s)
            if received is None:
                break
            timeout_s = 0.0
            peer, message = received
            with self._lock:
                answer = self._books.receive(peer, message)
                self._lock.notify_all()
            if answer is not None:
                self._router.send(peer, answer)  # a peer that is gone needs no answer
        if (refusals := self._router.refusals) > self._refusals:
            self._metrics.connections_refused.labels("trajectories").inc(refusals - self._refusals)
            self._refusals = refusals
        with self._lock:
            grants = self._books.grants()
        for peer, grant in grants:
            self._router.send(peer, grant)  # one that misses a grant gets it again with its next beat
