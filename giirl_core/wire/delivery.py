"""The delivery protocol between actors and the learner: each finished episode is processed once, or counted as lost.

Terms:

- incarnation: one lifetime of an actor. Every restart of the actor gets a higher number.
- sequence: the number of an episode within its incarnation, from 0.
- acked: the learner has received the episode and decided about it: queued for training, or dropped and counted.
- committed: a checkpoint covers the episode. Until then the actor keeps a copy, because a learner that restarts from
  an older checkpoint needs the episode again.
- settled: a checkpoint has recorded the end of the incarnation and the number of episodes that were lost with it.

One connection (DEALER to ROUTER, see `transport`), from start to end:

    actor                                     learner
      | hello                                   |
      | --------------------------------------> |  registers the actor, fences its older incarnations,
      |                                         |  counts the episodes that were lost with them
      | <--------------------------- grant ---- |  what is acked and committed, and the send limit
      | episode 0, 1, ... (below the limit)     |
      | --------------------------------------> |  acks each episode: queued, or dropped and counted
      | <--------------------------- grant ---- |  after episodes were acked, taken for training or committed
      | heartbeat (about once a second)         |
      | --------------------------------------> |
      | <--------------------------- grant ---- |
      | bye                                     |
      | --------------------------------------> |  counts finished but undelivered episodes as lost

Messages of the actor carry a `Stamp`. Hello, heartbeat and bye are notices (`Notice`).

Flow control: a grant has a `limit`. The actor starts only episodes whose sequence will be below it, and sends only
those. The learner raises the limit as it takes episodes from its queue, so that none is played that would be stale when
its turn comes. An actor whose copies take too much memory starts none either; before that, the flag `full` in its
notices asks for a checkpoint. An actor sends notices more and more rarely while the learner does not answer them.

Lost messages: notices and grants carry the complete state, not changes, so a lost or repeated one does no harm. A
connection keeps the order of its messages. Therefore, when a grant answers a notice that was sent after an episode but
does not ack that episode, the episode did not arrive (or was above the limit), and the actor sends it again. The
learner drops and counts an episode that it has acked already.

Restarts: a learner that does not know an actor, or knows it by an earlier incarnation or another connection, answers
`unknown_actor`. The actor then sends hello, and again every episode that is not committed. A learner answers `refused`
to an actor of another run, and to an incarnation that has been replaced by a newer one ("fenced"); that actor exits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from giirl_core.wire import messages as wire
from giirl_core.wire.columns import Columns, read_field
from giirl_core.wire.messages import MAX_COUNT, Header, Stamp, WireError

HELLO, HEARTBEAT, BYE, EPISODE = "hello", "heartbeat", "bye", "episode"  # kinds of messages from actors
NOTICES = frozenset({HELLO, HEARTBEAT, BYE})
GRANT, UNKNOWN_ACTOR, REFUSED = "grant", "unknown_actor", "refused"  # from the learner
FENCED, OTHER_RUN = "fenced", "other_run"  # reasons of a refusal
MAX_EARLIER = 4096  # earlier incarnations in one notice
IncarnationCounts = tuple[tuple[int, int], ...]  # (incarnation, number of episodes that it finished)


@dataclass(frozen=True, slots=True, kw_only=True)
class Notice:
    """The state of an actor, as it reports it. Raises ValueError when its numbers contradict each other."""

    kind: str  # HELLO, HEARTBEAT or BYE
    stamp: Stamp  # its `sequence` is the first episode of which the actor keeps a copy
    number: int  # of this notice; grows with every notice of an incarnation
    finished: int  # number of episodes finished in this incarnation: sequences 0 to finished - 1
    full: bool = False  # the actor's buffer of copies is nearly full: it needs a checkpoint
    before: IncarnationCounts = ()  # earlier incarnations that are not settled
    idle_share: float = 0.0  # fraction of the actor's tabs that may start no episode

    def __post_init__(self) -> None:
        if not 0 <= self.idle_share <= 1:
            raise ValueError(f"Notice.idle_share is {self.idle_share}, wanted a share from 0 to 1")
        if min(self.number, self.finished - self.stamp.sequence) < 0:
            raise ValueError(
                f"Notice has number {self.number}, finished {self.finished} and sequence {self.stamp.sequence}, "
                "wanted a number from 0 and a sequence of at most `finished`"
            )
        if max(self.number, self.finished) >= MAX_COUNT:
            raise ValueError(
                f"Notice has number {self.number} and finished {self.finished}, wanted less than {MAX_COUNT}"
            )
        if not all(0 <= i < self.stamp.incarnation and 0 <= count < MAX_COUNT for i, count in self.before):
            raise ValueError(
                f"Notice.before is {self.before!r:.80}, wanted incarnations below {self.stamp.incarnation} with counts"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeMessage:
    """A received episode: header and columns are decoded, but the episode itself is not built or validated yet."""

    stamp: Stamp
    header: Header
    arrays: Columns
    size: int  # bytes of the encoded message


@dataclass(frozen=True, slots=True, kw_only=True)
class Grant:
    """The learner's state of one incarnation of one actor, as it reports it to that actor."""

    incarnation: int
    notice: int  # number of the last notice received
    low_watermark: int  # every sequence below it is acked
    acked: tuple[int, ...] = ()  # sequences above the low watermark that are acked, too
    committed: int  # every sequence below it is committed: the actor may delete its copy
    settled: int  # every incarnation below it is settled: the actor may delete its count
    limit: int  # the actor may start and send the sequences below it

    def is_acked(self, sequence: int) -> bool:
        return sequence < self.low_watermark or sequence in self.acked


GRANT_FIELDS = ("incarnation", "notice", "low_watermark", "committed", "settled", "limit")


def encode_notice(notice: Notice) -> bytes:
    """The message of a notice."""
    return wire.encode(
        {
            "kind": notice.kind,
            "run": notice.stamp.run,
            "actor": notice.stamp.actor,
            "incarnation": notice.stamp.incarnation,
            "sequence": notice.stamp.sequence,
            "number": notice.number,
            "finished": notice.finished,
            "full": notice.full,
            "idle_share": notice.idle_share,
            "before": [list(pair) for pair in notice.before],
        }
    )


def encode_grant(grant: Grant) -> bytes:
    """The message of a grant."""
    fields = {name: getattr(grant, name) for name in GRANT_FIELDS}
    return wire.encode({"kind": GRANT, **fields, "acked": list(grant.acked)})


def encode_unknown_actor() -> bytes:
    """The answer to an actor that the learner does not know: the actor should send hello."""
    return wire.encode({"kind": UNKNOWN_ACTOR})


def encode_refused(reason: str, stamp: Stamp) -> bytes:
    """The answer to an actor from which the learner accepts nothing; `reason` is FENCED or OTHER_RUN."""
    recipient = {"run": stamp.run, "actor": stamp.actor, "incarnation": stamp.incarnation}
    return wire.encode({"kind": REFUSED, "reason": reason, **recipient})


def is_refused(header: Header, stamp: Stamp) -> bool:
    """True when a message refuses this very actor, not another one that used the same connection identity."""
    recipient = (header.get("run"), header.get("actor"), header.get("incarnation"))
    return header["kind"] == REFUSED and recipient == (stamp.run, stamp.actor, stamp.incarnation)


def read_notice(header: Header, stamp: Stamp) -> Notice:
    """The notice of a decoded message. Raises WireError."""
    before: Any = header.get("before")
    if not isinstance(before, list) or len(before) > MAX_EARLIER or not all(_is_pair(entry) for entry in before):
        raise WireError(f"header field 'before' is {before!r:.80}, wanted pairs of incarnation and count")
    with wire.as_wire_error():
        return Notice(
            kind=read_field(header, "kind", str),
            stamp=stamp,
            number=read_field(header, "number", int),
            finished=read_field(header, "finished", int),
            full=read_field(header, "full", bool),
            idle_share=read_field(header, "idle_share", float),
            before=tuple((entry[0], entry[1]) for entry in before),
        )


def read_grant(header: Header) -> Grant:
    """The grant of a decoded message. Raises WireError."""
    wire.check_kind(header, GRANT)
    acked: Any = header.get("acked")
    if not isinstance(acked, list) or not all(type(sequence) is int for sequence in acked):
        raise WireError(f"header field 'acked' is {acked!r:.80}, wanted a list of integers")
    with wire.as_wire_error():
        return Grant(acked=tuple(acked), **{name: read_field(header, name, int) for name in GRANT_FIELDS})


def _is_pair(entry: object) -> bool:
    return isinstance(entry, list) and len(entry) == 2 and all(type(number) is int for number in entry)


def parse(message: bytes) -> Notice | EpisodeMessage:
    """Decode a message from an actor; WireError unless it is a valid notice or the envelope of an episode."""
    header, arrays = wire.decode(message)
    stamp = wire.read_stamp(header)
    if header["kind"] in NOTICES:
        return read_notice(header, stamp)
    wire.check_kind(header, EPISODE)
    return EpisodeMessage(stamp=stamp, header=header, arrays=arrays, size=len(message))
