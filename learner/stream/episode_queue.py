"""The learner's queue of accepted episodes, which stay encoded until they are taken or saved."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from giirl_core.gestures import Gesture
from giirl_core.types import Episode, is_held_out
from giirl_core.wire import messages as wire
from giirl_core.wire.delivery import EpisodeMessage
from learner.stream.actor_state import ActorState

LOG = logging.getLogger(__name__)


@dataclass(slots=True, kw_only=True, eq=False)
class Queued:
    """An episode in the queue. The thread that takes or saves it builds it, not the thread that receives it."""

    message: EpisodeMessage
    episode: Episode | None = None
    policy_version: int
    owner: ActorState


class EpisodeQueue:
    """Episodes in order of arrival. Not thread-safe, but `check` needs no lock: it changes nothing that others read."""

    def __init__(self, max_lag: int, held_out: float, gestures: Sequence[Gesture]) -> None:
        self._max_lag, self._held_out, self._gestures = max_lag, held_out, gestures
        self._entries: deque[Queued] = deque()
        self.bytes = 0  # encoded

    def __len__(self) -> int:
        return len(self._entries)

    @property
    def entries(self) -> tuple[Queued, ...]:
        """What is in the queue now."""
        return tuple(self._entries)

    def append(self, message: EpisodeMessage, policy_version: int, owner: ActorState) -> None:
        """Add an episode; it takes a credit of its owner until it leaves the queue."""
        self._entries.append(Queued(message=message, policy_version=policy_version, owner=owner))
        self.bytes += message.size
        owner.queued += 1

    def popleft(self) -> Queued:
        """Remove the oldest episode and give its credit back."""
        entry = self._entries.popleft()
        self._release(entry)
        return entry

    def remove(self, entries: Collection[Queued]) -> None:
        """Remove these entries and give their credits back."""
        if entries:
            gone = set(entries)
            self._entries = deque(entry for entry in self._entries if entry not in gone)
            for entry in entries:
                self._release(entry)

    def check(self, entry: Queued, version: int) -> str:
        """Build the episode of an entry. Returns why it cannot be trained on at this policy version, "" if it can."""
        if self.is_stale(entry.policy_version, version):
            return "stale_queued"
        if entry.episode is None:
            try:
                episode = wire.build_episode(entry.message.header, entry.message.arrays)
                episode.trajectory.choices(self._gestures)  # of any other gesture it is invalid
                entry.episode = episode
            except ValueError as error:
                LOG.warning("dropped an invalid episode from %s: %s", entry.owner.actor, error)
                return "invalid"
        return "held_out" if is_held_out(entry.episode.trajectory.goal, self._held_out) else ""

    def is_stale(self, behaviour_version: int, version: int) -> bool:
        """Whether an episode of a policy of `behaviour_version` is too far from `version`.

        After the learner has gone back to a checkpoint, actors may still play with a later policy: also off-policy.
        """
        return abs(version - behaviour_version) > self._max_lag

    def _release(self, entry: Queued) -> None:
        self.bytes -= entry.message.size
        entry.owner.queued -= 1
