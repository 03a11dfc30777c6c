"""What becomes of each episode that reaches the learner, without sockets: once, fresh, or counted."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from giirl_core.wire import delivery
from giirl_core.wire import messages as wire
from giirl_core.wire.delivery import Grant, Notice
from giirl_core.wire.messages import Stamp, WireError
from learner.stream.admission import IngestLimits
from tests.giirl_core.wire_examples import episode
from tests.learner.admitting import Learner


def test_episodes_are_pulled_in_order_of_arrival() -> None:
    learner = Learner()
    learner.hello()
    for sequence in (1, 0, 2):
        assert learner.episode(sequence) == ""
    assert learner.seeds(2) == [1, 0]
    assert learner.books.pull(2) is None
    assert learner.books.queued == 1


@given(st.permutations([0, 1, 2, 3, 0, 1, 2, 3, 3]))
def test_whatever_the_order_and_however_often_each_episode_is_taken_once(arrivals: list[int]) -> None:
    learner = Learner()
    learner.hello()
    for sequence in arrivals:
        learner.episode(sequence)
    assert sorted(learner.seeds(4)) == [0, 1, 2, 3]
    assert learner.grant().low_watermark == 4
    assert learner.dropped("duplicate") == 5
    assert learner.count("received") == 9


def test_credits_come_back_only_as_the_learner_takes() -> None:
    learner = Learner(credits=2)
    learner.hello()
    assert learner.grant().limit == 2
    learner.episode(0)
    learner.episode(1)
    assert learner.grant().limit == 2
    assert learner.episode(2) == ""
    assert learner.dropped("over_credit") == 1
    learner.seeds(1)
    assert learner.grant().limit == 3
    learner.episode(2)  # what came too early is taken when its time has come
    assert learner.seeds(2) == [1, 2]


def test_a_gap_holds_the_floor_but_not_the_credits() -> None:
    learner = Learner(credits=2)
    learner.hello()
    learner.episode(1)
    learner.seeds(1)
    grant = learner.grant()
    assert (grant.low_watermark, grant.acked, grant.limit) == (0, (1,), 3)
    learner.episode(0)
    assert (learner.grant().low_watermark, learner.seeds(1)) == (2, [0])


def test_an_actor_that_did_not_say_hello_is_asked_who_it_is_and_loses_nothing() -> None:
    learner = Learner()
    assert learner.episode(0) == "unknown_actor"
    assert learner.count("received") == 0
    learner.hello()
    assert learner.episode(0) == ""
    assert learner.episode(0, incarnation=1) == "unknown_actor"
    assert learner.seeds(1) == [0]


def test_an_older_incarnation_and_another_run_are_fenced_and_counted() -> None:
    learner = Learner()
    learner.hello(incarnation=2)
    assert learner.episode(0, incarnation=1) == "fenced"
    assert learner.hello(incarnation=1) == "fenced"
    assert learner.episode(0, incarnation=2, run="old") == "other_run"
    assert learner.hello(run="old") == "other_run"
    assert (learner.dropped("fenced"), learner.dropped("other_run")) == (1, 1)
    assert learner.books.queued == 0


def test_a_newer_incarnation_begins_again_at_its_own_first_episode() -> None:
    learner = Learner()
    learner.hello()
    learner.episode(0)
    learner.hello(incarnation=1)
    learner.episode(0, incarnation=1)
    assert learner.seeds(2) == [0, 0]
    assert learner.dropped("duplicate") == 0


@pytest.mark.parametrize(("version", "taken"), [(3, 1), (5, 1), (6, 0), (1, 1), (0, 0)])
def test_an_episode_too_many_versions_away_is_dropped_on_arrival(version: int, taken: int) -> None:
    learner = Learner(max_lag=2)
    learner.version = version
    learner.hello()
    learner.episode(0, policy_version=3)
    assert len(learner.seeds(1)) == taken
    assert learner.dropped("stale") == 1 - taken
    assert learner.grant().low_watermark == 1  # judged: the actor need not keep it


def test_an_episode_that_grows_stale_in_the_queue_is_dropped_there_and_frees_its_credit() -> None:
    learner = Learner(max_lag=2, credits=2)
    learner.hello()
    learner.episode(0)
    assert learner.books.pull(2) is None  # taken out of the queue, and still waited with
    learner.episode(1)
    learner.version = 6
    assert learner.books.pull(1) is None
    assert learner.dropped("stale_queued") == 2
    assert learner.books.queued == 0
    assert learner.grant().limit == 4


def test_lock_step_takes_the_present_version_alone_each_page_once_and_in_an_order_of_its_own() -> None:
    learner = Learner(max_lag=0, credits=8)
    learner.hello()
    for sequence in (0, 3, 2):
        learner.episode(sequence, policy_version=2 if sequence == 0 else 3)
    learner.hello(actor="a", incarnation=1)  # plays its share again
    for sequence in (2, 1):
        learner.episode(sequence, incarnation=1)
    assert learner.seeds(3) == [1, 2, 3]
    assert (learner.dropped("stale"), learner.dropped("repeated")) == (1, 1)


def test_a_queue_that_is_full_takes_nothing_more_until_it_has_room() -> None:
    learner = Learner(credits=8, max_bytes=1)
    learner.hello()
    learner.hello(actor="b")
    learner.episode(0)
    assert learner.grant().limit == 1
    learner.episode(0, actor="b")
    assert learner.dropped("over_credit") == 1
    assert learner.seeds(1) == [0]
    assert learner.grant("b").limit == 8  # told to everyone, asked or not
    learner.episode(0, actor="b")
    assert learner.seeds(1) == [0]


def test_saving_what_waits_makes_no_room_for_more() -> None:
    learner = Learner(credits=2)
    learner.hello()
    for sequence in (0, 1):
        learner.episode(sequence)
    held = learner.books.snapshot()
    assert [e.trajectory.seed for e in held.episodes] == [0, 1]
    assert learner.grant().limit == 2
    learner.episode(2)
    assert learner.dropped("over_credit") == 1
    assert learner.seeds(2) == [0, 1]


def test_episodes_under_goals_held_out_are_counted_and_not_taken() -> None:
    learner = Learner(held_out=0.999)
    learner.hello()
    learner.episode(0)
    assert learner.seeds(1) == []
    assert learner.dropped("held_out") == 1


def test_malformed_messages_are_counted_and_forgotten() -> None:
    learner = Learner()
    learner.hello()
    for message in (b"", b"junk", wire.encode({"kind": "episode"}), b"GIRL" * 9):
        assert learner.books.receive(b"a", message) is None
    assert learner.dropped("damaged") == 4
    assert learner.episode(0) == ""
    assert learner.seeds(1) == [0]


def test_a_whole_message_with_an_impossible_episode_is_judged_invalid_and_not_asked_for_again() -> None:
    learner = Learner()
    learner.hello()
    stamp = Stamp(run="run", actor="a", incarnation=0, sequence=0)
    header, arrays = wire.decode(wire.encode_episode(episode(1), stamp=stamp))
    learner.books.receive(b"a", wire.encode(header, {**arrays, "element": np.array([77], np.int32)}))
    learner.episode(1, policy_version=-1)  # a demonstration is no rollout
    assert learner.books.pull(1) is None
    assert learner.dropped("invalid") == 2
    assert learner.grant().low_watermark == 2
    assert learner.books.queued == 0


def test_received_is_dropped_plus_taken_plus_queued() -> None:
    learner = Learner(credits=3, max_lag=1)
    learner.hello()
    learner.hello(actor="b", incarnation=1)
    for sequence, version in enumerate((3, 1, 3, 2, 3)):
        learner.episode(sequence, policy_version=version)
        learner.episode(sequence, actor="b", incarnation=1, policy_version=version)
    learner.episode(0, actor="b")
    taken = len(learner.seeds(2))
    reasons = ("stale", "duplicate", "fenced", "over_credit", "stale_queued")
    dropped = sum(learner.dropped(reason) for reason in reasons)
    assert learner.count("received") == 11 == taken + dropped + learner.books.queued


def test_the_lag_of_what_is_taken_is_observed() -> None:
    learner = Learner()
    learner.hello()
    learner.episode(0, policy_version=1)
    learner.seeds(1)
    registry = learner.metrics.registry
    assert registry.get_sample_value("giirl_policy_lag_versions_sum") == 2
    assert registry.get_sample_value("giirl_reward_lag_versions_sum") == 1


def test_limits_that_let_nothing_in_are_refused() -> None:
    with pytest.raises(ValueError, match="lets nothing in"):
        IngestLimits(credits=0)
    with pytest.raises(ValueError, match="lets nothing in"):
        IngestLimits(max_lag=-1)


def test_a_grant_that_lacks_a_number_is_a_wire_error() -> None:
    whole, _ = wire.decode(
        delivery.encode_grant(Grant(incarnation=1, notice=7, low_watermark=2, committed=0, settled=1, limit=5))
    )
    assert delivery.read_grant(whole) == Grant(
        incarnation=1, notice=7, low_watermark=2, committed=0, settled=1, limit=5
    )
    for name in set(whole) - {"kind"}:
        with pytest.raises(WireError, match=name):
            delivery.read_grant({**whole, name: "1"})


def test_a_notice_that_lacks_something_or_says_the_impossible_is_a_wire_error() -> None:
    stamp = Stamp(run="run", actor="a", incarnation=2, sequence=1)
    notice = Notice(kind=delivery.HEARTBEAT, stamp=stamp, number=3, finished=4, full=True, before=((0, 5), (1, 0)))
    whole, _ = wire.decode(delivery.encode_notice(notice))
    assert delivery.read_notice(whole, stamp) == notice
    wrong: list[dict[str, Any]] = [{name: None} for name in ("number", "finished", "full", "before")]
    wrong += [{"finished": 0}, {"number": -1}, {"before": [[2, 1]]}, {"before": [[0, -1]]}, {"before": [[0, 1, 2]]}]
    for change in wrong:
        with pytest.raises(WireError):
            delivery.read_notice({**whole, **change}, stamp)
