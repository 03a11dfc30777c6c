"""Actor state over checkpoints, restarts and departures: every finished episode is trained on, queued or counted."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from typing import Any

import pytest

from giirl_core.types import Episode
from giirl_core.wire import delivery
from giirl_core.wire import messages as wire
from giirl_core.wire.delivery import Notice
from giirl_core.wire.messages import Stamp
from giirl_core.wire.transport import Dealer
from learner.stream.ingest import Ingest
from tests.giirl_core.wire_examples import assert_same_episode, episode
from tests.learner.admitting import AdmissionHarness
from tests.reward_service.serving import WAIT_S, until


def test_a_snapshot_restores_queued_episodes_and_rejects_acknowledged_ones() -> None:
    harness = AdmissionHarness()
    harness.hello()
    for sequence in (0, 1, 3):
        harness.send_episode(sequence)
    harness.pull_seeds(1)
    snapshot = harness.snapshot()
    resumed = AdmissionHarness(snapshot=snapshot)
    assert resumed.send_episode(1) == "unknown_actor"
    resumed.hello()
    grant = resumed.grant()
    assert (grant.low_watermark, grant.acked, grant.committed) == (2, (3,), 2)
    for sequence in (0, 1, 2, 3):
        resumed.send_episode(sequence)
    assert resumed.pull_seeds(3) == [1, 3, 2]
    assert resumed.rejected("duplicate") == 3
    assert_same_episode(snapshot.episodes[0], episode(1, seed=1, reward_version=2))


def test_only_episodes_in_the_snapshot_are_committed() -> None:
    harness = AdmissionHarness()
    harness.hello()
    harness.send_episode(0)
    snapshot = harness.snapshot()
    harness.send_episode(1)
    assert harness.grant().committed == 0
    harness.admission.commit(snapshot)
    assert harness.grant().committed == 1
    harness.hello(incarnation=1)
    harness.admission.commit(snapshot)  # the snapshot is from an earlier incarnation
    assert harness.grant().committed == 0


def test_episodes_the_actor_no_longer_keeps_and_the_learner_never_got_are_counted_as_lost() -> None:
    harness = AdmissionHarness()
    harness.hello()
    harness.send_episode(1)
    harness.hello(4)
    assert harness.lost() == 3  # 0, 2 and 3
    assert harness.grant().low_watermark == 4
    harness.hello(2**40)  # must not take time proportional to the gap
    assert harness.lost() == 3 + 2**40 - 4


def test_episodes_of_an_earlier_incarnation_that_never_arrived_are_counted_as_lost() -> None:
    harness = AdmissionHarness()
    harness.hello()
    harness.send_episode(0)
    harness.send_episode(2)
    harness.hello(incarnation=3, before=((0, 5), (2, 4)))
    assert harness.lost() == 3 + 4
    harness.hello(incarnation=3, before=((0, 5), (2, 4)))  # repeated, but counted once
    assert harness.lost() == 7


def test_without_a_count_from_its_successor_the_last_notice_of_an_incarnation_is_used() -> None:
    harness = AdmissionHarness()
    harness.hello(finished=6)
    harness.send_episode(0)
    harness.hello(incarnation=1)
    assert harness.lost() == 5


def test_after_a_bye_every_missing_episode_is_counted_as_lost() -> None:
    harness = AdmissionHarness()
    harness.hello()
    harness.send_episode(1)
    harness.notice(delivery.BYE, finished=4)
    assert harness.lost() == 3
    assert harness.admission.silent_for_s("a") == float("inf")
    harness.hello(incarnation=1, before=((0, 4),))
    assert harness.lost() == 3


def test_losses_counted_after_a_checkpoint_are_counted_again_by_a_learner_that_resumes_from_it() -> None:
    harness = AdmissionHarness()
    harness.hello()
    harness.send_episode(0)
    snapshot = harness.snapshot()
    harness.hello(incarnation=1, before=((0, 3),))
    assert harness.snapshot().counts == {"lost": 2}
    resumed = AdmissionHarness(snapshot=snapshot)
    resumed.hello(incarnation=2, before=((0, 3), (1, 1)))
    assert resumed.snapshot().counts == {"lost": 3}
    assert resumed.grant().settled == 0  # actors must keep both counts
    resumed.admission.commit(resumed.snapshot())
    assert resumed.grant().settled == 2


def test_an_actor_with_a_full_buffer_asks_for_a_checkpoint_that_frees_it() -> None:
    harness = AdmissionHarness()
    harness.hello(full=True)
    assert not harness.admission.wants_commit  # a checkpoint would free nothing
    harness.send_episode(0)
    harness.notice(delivery.HEARTBEAT, full=True, finished=1)
    assert harness.admission.wants_commit
    harness.admission.commit(harness.snapshot())
    assert not harness.admission.wants_commit


def test_episodes_of_a_retired_actor_are_counted_as_lost_and_it_may_be_replaced() -> None:
    harness = AdmissionHarness()
    harness.hello(finished=4)
    harness.send_episode(0)
    harness.admission.retire("a", ((0, 5),))  # the actor counted 5, the learner knew of 4
    assert harness.lost() == 4
    harness.admission.retire("a", ((0, 5),))
    assert harness.lost() == 4  # not counted twice
    assert harness.pull_seeds(1) == [0]  # episodes that arrived are still used
    harness.hello(incarnation=1, before=((0, 5),))
    assert harness.lost() == 4
    harness.send_episode(0, incarnation=1)
    assert harness.pull_seeds(1) == [0]


def test_all_episodes_of_a_retired_actor_that_never_connected_are_counted_as_lost() -> None:
    harness = AdmissionHarness()
    harness.admission.retire("a", ())
    assert harness.snapshot().offsets == ()
    harness.admission.retire("a", ((3, 2), (4, 1)))
    assert harness.lost() == 3
    (offsets,) = harness.snapshot().offsets
    assert (offsets.incarnation, offsets.low_watermark, offsets.finished) == (4, 1, 1)


def test_a_retired_actor_that_reconnects_has_no_episode_trained_on_twice() -> None:
    harness = AdmissionHarness()
    harness.hello(finished=2)
    harness.admission.retire("a", ((0, 2),))
    assert harness.send_episode(1) == "unknown_actor"
    harness.hello(finished=2)
    assert harness.grant().low_watermark == 2
    harness.send_episode(1)
    assert harness.rejected("duplicate") == 1
    assert harness.lost() == 2


def test_the_learner_shows_when_it_last_heard_of_each_actor_until_that_leaves() -> None:
    def heard(actor: str) -> float | None:
        values = harness.metrics.registry
        return values.get_sample_value("giirl_actor_last_heard_timestamp_seconds", {"actor": actor})

    harness = AdmissionHarness()
    for actor in ("a", "b"):
        harness.hello(actor=actor)
    assert time.time() - 60 < (heard("a") or 0) <= time.time()
    harness.notice(delivery.BYE, actor="a")
    harness.admission.retire("b", ())
    assert (heard("a"), heard("b")) == (None, None)


def test_an_episode_that_a_checkpoint_finds_to_be_held_out_is_counted_once_and_in_it() -> None:
    harness = AdmissionHarness(held_out=1 - 1e-9)  # every instruction is held out
    harness.hello()
    harness.send_episode(0)
    snapshot = harness.snapshot()
    assert (snapshot.episodes, snapshot.counts) == ((), {"held_out": 1})
    assert harness.admission.queued == 0
    assert harness.pull_seeds(1) == []
    assert harness.dropped("held_out") == 1
    assert harness.grant().limit == 5  # 4 credits beyond the one episode


def test_a_checkpoint_does_not_hold_the_ingest_while_it_builds_the_queued_episodes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    build = wire.build_episode

    def build_and_ask(*parts: Any) -> Episode:
        with ThreadPoolExecutor(1) as other_thread:
            asked.append(other_thread.submit(lambda: ingest.queued).result(WAIT_S))
        return build(*parts)

    asked: list[int] = []
    stamp = Stamp(run="run", actor="a", incarnation=0, sequence=0)
    hello = Notice(kind=delivery.HELLO, stamp=stamp, number=1, finished=0)
    with closing(Ingest("run", lambda: 3)) as ingest, closing(Dealer(ingest.address, identity=b"a")) as actor:
        assert actor.send(delivery.encode_notice(hello), WAIT_S)
        assert actor.send(wire.encode_episode(episode(1, seed=7, policy_version=3), stamp=stamp), WAIT_S)
        until(lambda: ingest.queued == 1)
        monkeypatch.setattr(wire, "build_episode", build_and_ask)
        assert [saved.trajectory.seed for saved in ingest.snapshot().episodes] == [7]
    assert asked == [1]
