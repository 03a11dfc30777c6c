"""What an actor and the learner say to each other so that every episode arrives once, or is counted as lost.

    actor                                learner
      | hello                               |
      | ----------------------------------> |  fences older incarnations, counts what they took with them
      | <------------------------ grant --- |  acked so far, committed so far, how far it may send
      | episode 0, 1, .. below the limit    |
      | ----------------------------------> |  judges each once: queued, or dropped and counted
      | <------------------------ grant --- |  when something was acked, taken or committed
      | beat                                |
      | ----------------------------------> |  answered by a grant, or by `who` when the learner is a new one
      | bye                                 |
      | ----------------------------------> |  what it finished and never delivered is counted as lost

Notices and grants state all there is to know, not what has changed: one that is lost or comes twice does no harm.
Messages keep their order on one connection. So a grant that answers a notice sent after an episode, and does not
call that episode acked, says that the episode was lost on the way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from giirl_core.wire import messages as wire
from giirl_core.wire.columns import Columns, take
from giirl_core.wire.messages import MAX_COUNT, Header, Stamp, WireError

HELLO, HEARTBEAT, BYE, EPISODE = "hello", "heartbeat", "bye", "episode"  # from actors, all stamped
NOTICES = frozenset({HELLO, HEARTBEAT, BYE})
GRANT, UNKNOWN_ACTOR, REFUSED = "grant", "unknown_actor", "refused"  # from the learner
FENCED, OTHER_RUN = "fenced", "other_run"  # why an actor is refused
MAX_BEFORE = 4096  # earlier incarnations in one notice
Before = tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Notice:
    """What an actor says of itself; `stamp.sequence` is the first episode it still keeps."""

    kind: str
    stamp: Stamp
    number: int  # grows with every notice of one incarnation
    finished: int  # its sequences are those below
    full: bool = False  # it keeps so much that it needs a checkpoint to go on
    before: Before = ()  # earlier incarnations no checkpoint has settled, with how many episodes each finished

    def __post_init__(self) -> None:
        if min(self.number, self.finished - self.stamp.sequence) < 0:
            raise ValueError(f"notice {self.number} of {self.finished} episodes, {self.stamp.sequence} the first kept")
        if max(self.number, self.finished) >= MAX_COUNT:
            raise ValueError(f"notice {self.number} of {self.finished} episodes, wanted less than {MAX_COUNT}")
        if not all(0 <= i < self.stamp.incarnation and 0 <= count < MAX_COUNT for i, count in self.before):
            raise ValueError(f"{self.before!r:.80} finished before incarnation {self.stamp.incarnation}")


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeMessage:
    """A received episode: header and columns are decoded, but the episode itself is not built or validated yet."""

    stamp: Stamp
    header: Header
    arrays: Columns
    size: int  # bytes of the encoded message


@dataclass(frozen=True, slots=True, kw_only=True)
class Grant:
    """The learner's view of one incarnation of one actor; sequences are the actor's own."""

    incarnation: int
    notice: int  # the last notice that was heard
    low_watermark: int  # every sequence below has been judged
    acked: tuple[int, ...] = ()  # and these above it
    committed: int  # every sequence below is covered by a checkpoint: the actor may forget it
    settled: int  # incarnations below are closed in a checkpoint: what they lost has been counted for good
    limit: int  # the actor may send sequences below

    def is_acked(self, sequence: int) -> bool:
        return sequence < self.low_watermark or sequence in self.acked


NUMBERS = ("incarnation", "notice", "low_watermark", "committed", "settled", "limit")


def encode_notice(notice: Notice) -> bytes:
    """What an actor says besides its episodes."""
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
            "before": [list(pair) for pair in notice.before],
        }
    )


def encode_grant(grant: Grant) -> bytes:
    """The learner's answer to whatever an actor said."""
    return wire.encode({"kind": GRANT, **{name: getattr(grant, name) for name in NUMBERS}, "acked": list(grant.acked)})


def encode_who() -> bytes:
    """The learner does not know the actor: it should say hello."""
    return wire.encode({"kind": UNKNOWN_ACTOR})


def encode_refused(reason: str, stamp: Stamp) -> bytes:
    """The learner will never take anything from the actor that this stamp names."""
    who = {"run": stamp.run, "actor": stamp.actor, "incarnation": stamp.incarnation}
    return wire.encode({"kind": REFUSED, "reason": reason, **who})


def is_refused(header: Header, stamp: Stamp) -> bool:
    """Whether a refusal means this actor, and not somebody else who spoke in its place."""
    who = (header.get("run"), header.get("actor"), header.get("incarnation"))
    return header["kind"] == REFUSED and who == (stamp.run, stamp.actor, stamp.incarnation)


def parse(message: bytes) -> Notice | EpisodeMessage:
    """Decode a message from an actor; WireError unless it is a valid notice or the envelope of an episode."""
    header, arrays = wire.decode(message)
    stamp = wire.read_stamp(header)
    if header["kind"] in NOTICES:
        return read_notice(header, stamp)
    wire.expect(header, EPISODE)
    return EpisodeMessage(stamp=stamp, header=header, arrays=arrays, size=len(message))


def read_notice(header: Header, stamp: Stamp) -> Notice:
    """The notice of a decoded message."""
    before: Any = header.get("before")
    if not isinstance(before, list) or len(before) > MAX_BEFORE or not all(_is_pair(entry) for entry in before):
        raise WireError(f"header field 'before' is {before!r:.80}, wanted pairs of incarnation and count")
    with wire.untrusted():
        return Notice(
            kind=take(header, "kind", str),
            stamp=stamp,
            number=take(header, "number", int),
            finished=take(header, "finished", int),
            full=take(header, "full", bool),
            before=tuple((entry[0], entry[1]) for entry in before),
        )


def read_grant(header: Header) -> Grant:
    """The grant of a decoded message."""
    wire.expect(header, GRANT)
    acked: Any = header.get("acked")
    if not isinstance(acked, list) or not all(type(sequence) is int for sequence in acked):
        raise WireError(f"header field 'acked' is {acked!r:.80}, wanted a list of sequences")
    with wire.untrusted():
        return Grant(acked=tuple(acked), **{name: take(header, name, int) for name in NUMBERS})


def _is_pair(entry: object) -> bool:
    return isinstance(entry, list) and len(entry) == 2 and all(type(number) is int for number in entry)
