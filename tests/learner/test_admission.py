"""Admission control without sockets: each episode is taken once while fresh, or dropped and counted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from giirl_core.choices import SampledActions
from giirl_core.telemetry.series import DROPPED, REJECTED
from giirl_core.types import Action, Verb
from giirl_core.wire import delivery
from giirl_core.wire import messages as wire
from giirl_core.wire.delivery import Grant, Notice
from giirl_core.wire.messages import Stamp, WireError
from learner.stream.flow import IngestLimits
from tests.giirl_core.wire_examples import episode
from tests.learner.admitting import AdmissionHarness


def test_episodes_are_pulled_in_order_of_arrival() -> None:
    harness = AdmissionHarness()
    harness.hello()
    for sequence in (1, 0, 2):
        assert harness.send_episode(sequence) == ""
    assert harness.pull_seeds(2) == [1, 0]
    assert harness.admission.pull(2) is None
    assert harness.admission.queued == 1


@given(st.permutations([0, 1, 2, 3, 0, 1, 2, 3, 3]))
def test_each_episode_is_taken_once_for_any_order_and_number_of_arrivals(arrivals: list[int]) -> None:
    harness = AdmissionHarness()
    harness.hello()
    for sequence in arrivals:
        harness.send_episode(sequence)
    assert sorted(harness.pull_seeds(4)) == [0, 1, 2, 3]
    assert harness.grant().low_watermark == 4
    assert harness.rejected("duplicate") == 5
    assert harness.count("received") == 9


def test_credits_come_back_only_when_the_learner_takes_episodes() -> None:
    harness = AdmissionHarness(credits=2)
    harness.hello()
    assert harness.grant().limit == 2
    harness.send_episode(0)
    harness.send_episode(1)
    assert harness.grant().limit == 2
    assert harness.send_episode(2) == ""
    assert harness.rejected("over_credit") == 1
    harness.pull_seeds(1)
    assert harness.grant().limit == 3
    harness.send_episode(2)  # rejected above, accepted now that there is a credit
    assert harness.pull_seeds(2) == [1, 2]


def test_a_gap_holds_back_the_watermark_but_not_the_credits() -> None:
    harness = AdmissionHarness(credits=2)
    harness.hello()
    harness.send_episode(1)
    harness.pull_seeds(1)
    grant = harness.grant()
    assert (grant.low_watermark, grant.acked, grant.limit) == (0, (1,), 3)
    harness.send_episode(0)
    assert (harness.grant().low_watermark, harness.pull_seeds(1)) == (2, [0])


def test_an_actor_without_a_hello_gets_an_unknown_actor_reply_and_loses_nothing() -> None:
    harness = AdmissionHarness()
    assert harness.send_episode(0) == "unknown_actor"
    assert harness.count("received") == 0
    harness.hello()
    assert harness.send_episode(0) == ""
    assert harness.send_episode(0, incarnation=1) == "unknown_actor"
    assert harness.pull_seeds(1) == [0]


def test_older_incarnations_and_other_runs_are_refused_and_counted() -> None:
    harness = AdmissionHarness()
    harness.hello(incarnation=2)
    assert harness.send_episode(0, incarnation=1) == "fenced"
    assert harness.hello(incarnation=1) == "fenced"
    assert harness.send_episode(0, incarnation=2, run="old") == "other_run"
    assert harness.hello(run="old") == "other_run"
    assert (harness.rejected("fenced"), harness.rejected("other_run")) == (1, 1)
    assert harness.admission.queued == 0


def test_a_newer_incarnation_starts_with_its_own_episode_0() -> None:
    harness = AdmissionHarness()
    harness.hello()
    harness.send_episode(0)
    harness.hello(incarnation=1)
    harness.send_episode(0, incarnation=1)
    assert harness.pull_seeds(2) == [0, 0]
    assert harness.rejected("duplicate") == 0


@pytest.mark.parametrize(("version", "taken"), [(3, 1), (5, 1), (6, 0), (1, 1), (0, 0)])
def test_an_episode_too_many_versions_away_is_dropped_on_arrival(version: int, taken: int) -> None:
    harness = AdmissionHarness(max_lag=2)
    harness.version = version
    harness.hello()
    harness.send_episode(0, policy_version=3)
    assert len(harness.pull_seeds(1)) == taken
    assert harness.dropped("stale") == 1 - taken
    assert harness.grant().low_watermark == 1  # acknowledged, so the actor need not send it again


def test_an_episode_that_becomes_stale_in_the_queue_is_dropped_and_frees_its_credit() -> None:
    harness = AdmissionHarness(max_lag=2, credits=2)
    harness.hello()
    harness.send_episode(0)
    assert harness.admission.pull(2) is None  # out of the queue, but too few for a batch
    harness.send_episode(1)
    harness.version = 6
    assert harness.admission.pull(1) is None
    assert harness.dropped("stale_queued") == 2
    assert harness.admission.queued == 0
    assert harness.grant().limit == 4


def test_lock_step_takes_only_the_current_version_each_page_once_and_sorted_by_page() -> None:
    harness = AdmissionHarness(max_lag=0, credits=8)
    harness.hello()
    for sequence in (0, 3, 2):
        harness.send_episode(sequence, policy_version=2 if sequence == 0 else 3)
    harness.hello(actor="a", incarnation=1)  # a restarted actor plays its pages again
    for sequence in (2, 1):
        harness.send_episode(sequence, incarnation=1)
    assert harness.pull_seeds(3) == [1, 2, 3]
    assert (harness.dropped("stale"), harness.dropped("repeated")) == (1, 1)


def test_a_full_queue_accepts_no_episode_until_it_has_room() -> None:
    harness = AdmissionHarness(credits=8, max_bytes=1)
    harness.hello()
    harness.hello(actor="b")
    harness.send_episode(0)
    assert harness.grant().limit == 1
    harness.send_episode(0, actor="b")
    assert harness.rejected("over_credit") == 1
    assert harness.pull_seeds(1) == [0]
    assert harness.grant("b").limit == 8  # every actor gets a new grant
    harness.send_episode(0, actor="b")
    assert harness.pull_seeds(1) == [0]


def test_a_snapshot_of_the_queue_frees_no_credits() -> None:
    harness = AdmissionHarness(credits=2)
    harness.hello()
    for sequence in (0, 1):
        harness.send_episode(sequence)
    snapshot = harness.snapshot()
    assert [e.trajectory.seed for e in snapshot.episodes] == [0, 1]
    assert harness.grant().limit == 2
    harness.send_episode(2)
    assert harness.rejected("over_credit") == 1
    assert harness.pull_seeds(2) == [0, 1]


def test_episodes_with_held_out_goals_are_dropped_and_counted() -> None:
    harness = AdmissionHarness(held_out=0.999)
    harness.hello()
    harness.send_episode(0)
    assert harness.pull_seeds(1) == []
    assert harness.dropped("held_out") == 1


def test_malformed_messages_are_dropped_and_counted() -> None:
    harness = AdmissionHarness()
    harness.hello()
    stamp = {"run": "run", "actor": "a", "incarnation": 0, "sequence": 0}
    other_kind = wire.encode({"kind": delivery.GRANT, **stamp})
    for message in (b"", b"junk", wire.encode({"kind": "episode"}), other_kind, b"GIRL" * 9):
        assert harness.admission.receive(b"a", message) is None
    assert harness.rejected("damaged") == 5
    assert harness.send_episode(0) == ""
    assert harness.pull_seeds(1) == [0]


def test_an_invalid_episode_in_a_valid_message_is_dropped_and_acknowledged() -> None:
    harness = AdmissionHarness()
    harness.hello()
    stamp = Stamp(run="run", actor="a", incarnation=0, sequence=0)
    header, arrays = wire.decode(wire.encode_episode(episode(1), stamp=stamp))
    harness.admission.receive(b"a", wire.encode(header, {**arrays, "element": np.array([77], np.int32)}))
    harness.send_episode(1, policy_version=-1)  # the version of demonstrations
    played = episode(1, seed=2)
    hover = replace(played, trajectory=replace(played.trajectory, actions=(Action(verb=Verb.HOVER, element=0),)))
    harness.send(hover, 2)  # a gesture that the run does not learn
    unknown = SampledActions(
        choices=np.array([[[2, 0, -1, -1]]], np.int16),
        logp=np.zeros((1, 1), np.float32),
        rewards=np.zeros((1, 1), np.float32),
    )
    harness.send(replace(played, trajectory=replace(played.trajectory, sampled=unknown)), 3)
    assert harness.admission.pull(1) is None
    assert harness.dropped("invalid") == 4
    assert harness.grant().low_watermark == 4
    assert harness.admission.queued == 0


def test_received_is_dropped_plus_taken_plus_queued() -> None:
    harness = AdmissionHarness(credits=3, max_lag=1)
    harness.hello()
    harness.hello(actor="b", incarnation=1)
    for sequence, version in enumerate((3, 1, 3, 2, 3)):
        harness.send_episode(sequence, policy_version=version)
        harness.send_episode(sequence, actor="b", incarnation=1, policy_version=version)
    harness.send_episode(0, actor="b")
    taken = len(harness.pull_seeds(2))
    dropped = sum(harness.dropped(reason) for reason in DROPPED)
    rejected = sum(harness.rejected(reason) for reason in REJECTED)
    assert harness.count("received") == 11 == taken + dropped + rejected + harness.admission.queued
    assert harness.count("taken") == taken


def test_policy_and_reward_lag_of_taken_episodes_are_observed() -> None:
    harness = AdmissionHarness()
    harness.hello()
    harness.send_episode(0, policy_version=1)
    harness.pull_seeds(1)
    registry = harness.metrics.registry
    assert registry.get_sample_value("giirl_policy_lag_versions_sum") == 2
    assert registry.get_sample_value("giirl_reward_lag_versions_sum") == 1


def test_limits_that_admit_no_episode_are_rejected() -> None:
    with pytest.raises(ValueError, match="admits no episode"):
        IngestLimits(credits=0)
    with pytest.raises(ValueError, match="admits no episode"):
        IngestLimits(max_lag=-1)


def test_a_grant_with_a_missing_or_mistyped_field_is_a_wire_error() -> None:
    whole, _ = wire.decode(
        delivery.encode_grant(Grant(incarnation=1, notice=7, low_watermark=2, committed=0, settled=1, limit=5))
    )
    assert delivery.read_grant(whole) == Grant(
        incarnation=1, notice=7, low_watermark=2, committed=0, settled=1, limit=5
    )
    for name in set(whole) - {"kind"}:
        with pytest.raises(WireError, match=name):
            delivery.read_grant({**whole, name: "1"})


def test_a_notice_with_missing_or_impossible_fields_is_a_wire_error() -> None:
    stamp = Stamp(run="run", actor="a", incarnation=2, sequence=1)
    notice = Notice(kind=delivery.HEARTBEAT, stamp=stamp, number=3, finished=4, full=True, before=((0, 5), (1, 0)))
    whole, _ = wire.decode(delivery.encode_notice(notice))
    assert delivery.read_notice(whole, stamp) == notice
    wrong: list[dict[str, Any]] = [{name: None} for name in ("number", "finished", "full", "before")]
    wrong += [{"finished": 0}, {"number": -1}, {"before": [[2, 1]]}, {"before": [[0, -1]]}, {"before": [[0, 1, 2]]}]
    for change in wrong:
        with pytest.raises(WireError):
            delivery.read_notice({**whole, **change}, stamp)
