"""What an actor and the learner say to each other so that every episode arrives once.

    actor                                learner
      | hello (first sequence it keeps)     |
      | ----------------------------------> |  fences older incarnations
      | <------------------------ grant --- |  judged so far, committed so far, how far it may send
      | episode 0, 1, .. below the limit    |
      | ----------------------------------> |  judges each once: queued, or dropped and counted
      | <------------------------ grant --- |  when something was judged, taken or committed
      | beat                                |
      | ----------------------------------> |  answered by a grant, or by `who` when the learner is a new one

A grant states all there is to know, not what has changed: one that is lost or comes twice does no harm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from giirl import wire
from giirl.columns import take
from giirl.wire import Header, Stamp, WireError

HELLO, BEAT, EPISODE = "hello", "beat", "episode"  # from actors, all stamped
GRANT, WHO, REFUSED = "grant", "who", "refused"  # from the learner
FENCED, OTHER_RUN = "fenced", "other_run"  # why an actor is refused


@dataclass(frozen=True, slots=True, kw_only=True)
class Grant:
    """The learner's view of one incarnation of one actor; sequences are the actor's own."""

    incarnation: int
    floor: int  # every sequence below has been judged
    judged: tuple[int, ...] = ()  # and these above it
    committed: int  # every sequence below is covered by a checkpoint: the actor may forget it
    limit: int  # the actor may send sequences below

    def has_judged(self, sequence: int) -> bool:
        return sequence < self.floor or sequence in self.judged


def encode_notice(kind: str, stamp: Stamp) -> list[bytes]:
    """A hello, whose sequence is the first the actor still keeps, or a beat."""
    fields = {"run": stamp.run, "actor": stamp.actor, "incarnation": stamp.incarnation}
    return wire.encode({"kind": kind, **fields, "sequence": stamp.sequence})


def encode_grant(grant: Grant) -> list[bytes]:
    """The learner's answer to whatever an actor said."""
    numbers = {name: getattr(grant, name) for name in ("incarnation", "floor", "committed", "limit")}
    return wire.encode({"kind": GRANT, **numbers, "judged": list(grant.judged)})


def encode_who() -> list[bytes]:
    """The learner does not know the actor: it should say hello."""
    return wire.encode({"kind": WHO})


def encode_refused(reason: str) -> list[bytes]:
    """The learner will never take anything from this actor."""
    return wire.encode({"kind": REFUSED, "reason": reason})


def read_grant(header: Header) -> Grant:
    """The grant of a decoded message."""
    wire.expect(header, GRANT)
    judged: Any = header.get("judged")
    if not isinstance(judged, list) or not all(type(sequence) is int for sequence in judged):
        raise WireError(f"header field 'judged' is {judged!r:.80}, wanted a list of sequences")
    with wire.untrusted():
        return Grant(
            incarnation=take(header, "incarnation", int),
            floor=take(header, "floor", int),
            judged=tuple(judged),
            committed=take(header, "committed", int),
            limit=take(header, "limit", int),
        )
