"""Delivery of episodes from actors to the learner over real sockets, through restarts of both."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from actors.episode_counter import EpisodeCounter
from actors.uplink import Refused, Uplink, UplinkLimits
from giirl_core.metrics import Metrics
from giirl_core.types import Episode
from giirl_core.wire import delivery
from giirl_core.wire import messages as wire
from giirl_core.wire.delivery import Grant
from giirl_core.wire.transport import Dealer, Router
from learner.stream.flow import IngestLimits
from learner.stream.ingest import Ingest
from learner.stream.snapshot import IngestSnapshot
from tests.giirl_core.wire_examples import STAMP, episode
from tests.reward_service.serving import WAIT_S, until

QUICK = UplinkLimits(heartbeat_s=0.05, hello_s=0.05)
COUNTERS: list[Path] = []  # the folder of the running test's episode counters


@pytest.fixture(autouse=True)
def _counters(tmp_path: Path) -> Iterator[None]:
    COUNTERS.append(tmp_path)
    yield
    COUNTERS.clear()


@contextmanager
def open_ingest(
    port: int = 0, *, snapshot: IngestSnapshot | None = None, metrics: Metrics | None = None, credits_: int = 4
) -> Iterator[Ingest]:
    limits = IngestLimits(credits=credits_)
    with closing(Ingest("run", lambda: 3, port=port, limits=limits, snapshot=snapshot, metrics=metrics)) as ingest:
        yield ingest


def open_uplink(
    address: str, *, actor: str = "a", incarnation: int = 0, run: str = "run", limits: UplinkLimits = QUICK
) -> Uplink:
    counter = EpisodeCounter(COUNTERS[-1] / actor, incarnation)
    return Uplink(address, run=run, actor=actor, incarnation=incarnation, counter=counter, limits=limits)


def lost(metrics: Metrics) -> float:
    return metrics.registry.get_sample_value("giirl_trajectories_lost_total") or 0.0


def port_of(ingest: Ingest) -> int:
    return int(ingest.address.rpartition(":")[2])


def test_every_episode_of_every_actor_arrives_once() -> None:
    with open_ingest() as ingest:
        uplinks = [open_uplink(ingest.address, actor=f"a{n}") for n in range(3)]
        seeds = [1000 * n + k for n in range(3) for k in range(20)]
        found: list[int] = []
        for k in range(20):
            for n, uplink in enumerate(uplinks):
                uplink.submit(episode(1, seed=1000 * n + k))
            found += [e.trajectory.seed for e in _take_with(ingest, 3, *uplinks)]
        assert all(uplink.flush(WAIT_S) for uplink in uplinks)
        assert sorted(found) == seeds
        for uplink in uplinks:
            uplink.close()


def _take_with(ingest: Ingest, episodes: int, *uplinks: Uplink) -> list[Episode]:
    until(lambda: ingest.queued >= episodes, *uplinks)
    return ingest.take(episodes, WAIT_S)


def test_an_actor_may_start_no_episode_while_the_learner_takes_none() -> None:
    with open_ingest(credits_=2) as ingest, closing(open_uplink(ingest.address)) as uplink:
        for seed in range(12):
            uplink.submit(episode(1, seed=seed))
        until(lambda: ingest.queued == 2, uplink)
        assert not uplink.flush(0.3)
        assert (ingest.queued, uplink.unacked, uplink.startable(0)) == (2, 10, 0)
        ingest.take(2, WAIT_S)
        until(lambda: uplink.unacked == 8, uplink)
        taken = [e.trajectory.seed for _ in range(5) for e in _take_with(ingest, 2, uplink)]
        assert taken == list(range(2, 12))
        until(lambda: uplink.startable(0) == 2, uplink)
        assert uplink.startable(1) == 1  # while one is played


def test_a_freed_credit_is_granted_at_once_and_not_at_the_next_heartbeat(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("learner.stream.ingest.TICK_S", 600.0)
    slow = UplinkLimits(heartbeat_s=600, hello_s=600)
    with open_ingest(credits_=1) as ingest:
        uplink = open_uplink(ingest.address, limits=slow)
        with closing(uplink):
            uplink.submit(episode(1))
            uplink.submit(episode(1))
            until(lambda: ingest.queued == 1 and uplink.unacked == 1, uplink)
            ingest.take(1, WAIT_S)
            assert uplink.flush(WAIT_S)


def test_an_actor_with_a_full_buffer_pauses_and_asks_for_a_checkpoint() -> None:
    size = len(wire.encode_episode(episode(1), stamp=STAMP))
    limits = UplinkLimits(max_kept_bytes=4 * size, heartbeat_s=0.05, hello_s=0.05)
    with open_ingest(credits_=64) as ingest, closing(open_uplink(ingest.address, limits=limits)) as uplink:
        uplink.submit(episode(1))
        assert uplink.flush(WAIT_S)
        assert not ingest.wants_commit
        while uplink.startable(0):
            uplink.submit(episode(1))
        until(lambda: ingest.wants_commit and not uplink.unacked, uplink)
        assert not uplink.startable(0)
        kept = uplink.kept
        until(lambda: uplink.kept == kept, uplink)  # no episode is discarded
        ingest.commit(ingest.snapshot())
        until(lambda: uplink.startable(0) > 0 and not uplink.kept and not ingest.wants_commit, uplink)


def test_a_take_that_times_out_names_the_actors_and_loses_no_episode() -> None:
    with open_ingest() as ingest, closing(open_uplink(ingest.address)) as uplink:
        with pytest.raises(TimeoutError, match="0 queued; last messages from 0 actors: none"):
            ingest.take(1, 0.01)
        uplink.submit(episode(1, seed=8))
        until(lambda: ingest.queued == 1, uplink)
        with pytest.raises(TimeoutError, match="1 queued; last messages from 1 actors: a "):
            ingest.take(2, 0.01)
        assert [e.trajectory.seed for e in ingest.take(1, WAIT_S)] == [8]


def test_an_episode_is_kept_until_a_checkpoint_covers_it() -> None:
    with open_ingest() as ingest, closing(open_uplink(ingest.address)) as uplink:
        uplink.submit(episode(1))
        assert uplink.flush(WAIT_S)
        snapshot = ingest.snapshot()
        uplink.submit(episode(1))
        assert uplink.flush(WAIT_S)
        assert uplink.kept == 2
        ingest.commit(snapshot)
        until(lambda: uplink.kept == 1, uplink)


def test_a_resumed_learner_gets_the_episodes_it_had_not_saved_and_none_twice() -> None:
    with open_ingest() as first:
        uplink = open_uplink(first.address)
        port = port_of(first)
        for seed in range(3):
            uplink.submit(episode(1, seed=seed))
        assert uplink.flush(WAIT_S)
        assert len(first.take(1, WAIT_S)) == 1
        saved = first.snapshot()  # episode 0 is trained on, 1 and 2 are in the checkpoint
        first.commit(saved)
        until(lambda: uplink.kept == 0, uplink)
        uplink.submit(episode(1, seed=3))
        assert uplink.flush(WAIT_S)  # accepted, but in no checkpoint
    with closing(uplink), open_ingest(port, snapshot=saved) as second:
        uplink.submit(episode(1, seed=4))
        until(lambda: second.queued == 4, uplink)
        assert [e.trajectory.seed for e in second.take(4, WAIT_S)] == [1, 2, 3, 4]
        assert uplink.flush(WAIT_S)
        with pytest.raises(TimeoutError):
            second.take(1, 0.3)  # nothing arrives again, although there was time to resend


def test_a_replaced_actor_cannot_finish_episodes_and_those_it_did_not_deliver_are_counted() -> None:
    metrics = Metrics()
    with open_ingest(metrics=metrics) as ingest, closing(open_uplink(ingest.address, incarnation=0)) as old:
        old.submit(episode(1, seed=1))
        assert old.flush(WAIT_S)
        for _ in range(5):  # there are 4 credits, so 2 of the 6 episodes stay with the actor
            old.submit(episode(1))
        until(lambda: old.unacked == 2, old)
        with closing(open_uplink(ingest.address, incarnation=1)) as new:
            new.submit(episode(1, seed=2))
            with pytest.raises(Refused, match="incarnation 1 has taken over"):
                old.submit(episode(1))
            until(lambda: lost(metrics) == 2, new)
            with pytest.raises(Refused, match=r"actor 'a', incarnation 0, .*fenced"):
                until(lambda: False, old)
            assert new.flush(WAIT_S)
        assert ingest.snapshot().counts == {"lost": 2}


def test_an_actor_that_leaves_waits_for_the_checkpoint_that_covers_its_episodes() -> None:
    with open_ingest() as ingest:
        uplink = open_uplink(ingest.address)
        uplink.submit(episode(1))
        assert not uplink.wait_committed(0.3)
        assert ingest.wants_commit
        snapshot = ingest.snapshot()
        ingest.commit(snapshot)
        assert uplink.wait_committed(WAIT_S)
        uplink.close()
        until(lambda: ingest.silent_for_s("a") == float("inf"))
        assert ingest.snapshot().counts == {}


def test_the_undelivered_episodes_of_an_actor_that_leaves_at_once_are_counted_as_lost() -> None:
    metrics = Metrics()
    with open_ingest(metrics=metrics, credits_=1) as ingest:
        uplink = open_uplink(ingest.address)
        for _ in range(3):
            uplink.submit(episode(1))
        until(lambda: uplink.unacked == 2, uplink)
        uplink.close()
        until(lambda: lost(metrics) == 2)
        assert ingest.queued == 1


def test_an_actor_sends_its_episodes_again_to_a_learner_at_another_address() -> None:
    with open_ingest() as first, closing(open_uplink(first.address)) as uplink:
        uplink.submit(episode(1, seed=1))
        assert uplink.flush(WAIT_S)
        with open_ingest() as second:
            uplink.redirect(second.address)
            assert [e.trajectory.seed for e in _take_with(second, 1, uplink)] == [1]


def test_an_actor_of_another_run_is_refused() -> None:
    with open_ingest() as ingest, closing(open_uplink(ingest.address, run="old")) as uplink:
        with pytest.raises(Refused, match="other_run"):
            until(lambda: False, uplink)
        assert ingest.queued == 0


def test_an_actor_ignores_refusals_of_another_run_or_incarnation() -> None:
    with closing(Router()) as router, closing(open_uplink(router.address)) as uplink:
        uplink.submit(episode(1))
        peer, _ = until(lambda: router.recv(0.0), uplink)
        for stamp in (replace(STAMP, actor="a", incarnation=0), replace(STAMP, run="run", actor="a", incarnation=1)):
            router.send(peer, delivery.encode_refused(delivery.FENCED, stamp))
        stamp = replace(STAMP, run="run", actor="a", incarnation=0)
        router.send(peer, delivery.encode_refused(delivery.OTHER_RUN, stamp))
        with pytest.raises(Refused, match="other_run"):
            until(lambda: False, uplink)


def test_junk_on_the_socket_is_dropped_and_stops_nothing() -> None:
    metrics = Metrics()
    with open_ingest(metrics=metrics) as ingest, closing(Dealer(ingest.address, identity=b"vandal")) as vandal:
        for junk in (b"", b"junk", b"GIRL" * 9):
            assert vandal.send(junk, timeout_s=WAIT_S)
        with closing(open_uplink(ingest.address)) as uplink:
            uplink.submit(episode(1, seed=6))
            assert uplink.flush(WAIT_S)
            assert [e.trajectory.seed for e in ingest.take(1, WAIT_S)] == [6]
    damaged = metrics.registry.get_sample_value("giirl_trajectories_rejected_total", {"reason": "damaged"})
    assert damaged == 3


def test_an_episode_is_sent_again_only_once_it_is_certain_that_it_was_lost() -> None:
    with closing(Router()) as router, closing(open_uplink(router.address)) as uplink:
        uplink.submit(episode(1))
        received: list[str] = []  # kinds
        watermark = 0

        def receive() -> bool:
            nonlocal watermark
            if (message := router.recv(0.005)) is not None:
                header, _ = wire.decode(message[1])
                received.append(header["kind"])
                router.send(message[0], b"junk")  # the actor ignores it
                watermark = int(received.count(delivery.EPISODE) >= 3)
                if "number" in header:
                    grant = Grant(
                        incarnation=0, notice=header["number"], low_watermark=watermark, committed=0, settled=0, limit=1
                    )
                    router.send(message[0], delivery.encode_grant(grant))
            return uplink.unacked == 0

        until(receive, uplink)
        assert received[0] == delivery.HELLO
        episodes = [index for index, kind in enumerate(received) if kind == delivery.EPISODE]
        assert len(episodes) == 3
        for first, second in pairwise(episodes):
            assert delivery.HEARTBEAT in received[first:second]


def test_the_learner_knows_how_long_an_actor_has_been_silent() -> None:
    with open_ingest() as ingest, closing(open_uplink(ingest.address)) as uplink:
        assert ingest.silent_for_s("a") == float("inf")
        until(lambda: ingest.silent_for_s("a") < WAIT_S, uplink)
        silence_s = ingest.silent_for_s("a")
        until(lambda: ingest.silent_for_s("a") > silence_s + 0.2)  # without poll() it sends nothing
        silence_s = ingest.silent_for_s("a")
        until(lambda: ingest.silent_for_s("a") < silence_s, uplink)
        assert uplink.silent_for_s < WAIT_S
