"""Episodes from actors to the learner over real sockets, through restarts on either side."""

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
from learner.stream.admission import IngestLimits
from learner.stream.ingest import Ingest
from learner.stream.snapshot import IngestSnapshot
from tests.giirl_core.wire_examples import STAMP, episode
from tests.reward_service.serving import WAIT_S, until

QUICK = UplinkLimits(beat_s=0.05, hello_s=0.05)
FOLDER: list[Path] = []


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path) -> Iterator[None]:
    FOLDER.append(tmp_path)
    yield
    FOLDER.clear()


@contextmanager
def ingesting(
    port: int = 0, *, held: IngestSnapshot | None = None, metrics: Metrics | None = None, credits_: int = 4
) -> Iterator[Ingest]:
    limits = IngestLimits(credits=credits_)
    with closing(Ingest("run", lambda: 3, port=port, limits=limits, held=held, metrics=metrics)) as ingest:
        yield ingest


def uplink(
    address: str, *, actor: str = "a", incarnation: int = 0, run: str = "run", limits: UplinkLimits = QUICK
) -> Uplink:
    tally = EpisodeCounter(FOLDER[-1] / actor, incarnation)
    return Uplink(address, run=run, actor=actor, incarnation=incarnation, tally=tally, limits=limits)


def dropped(metrics: Metrics, reason: str) -> float:
    return metrics.registry.get_sample_value("giirl_trajectories_dropped_total", {"reason": reason}) or 0.0


def port_of(ingest: Ingest) -> int:
    return int(ingest.address.rpartition(":")[2])


def test_every_episode_of_every_actor_arrives_once() -> None:
    with ingesting() as ingest:
        lines = [uplink(ingest.address, actor=f"a{n}") for n in range(3)]
        seeds = [1000 * n + k for n in range(3) for k in range(20)]
        found: list[int] = []
        for k in range(20):
            for n, line in enumerate(lines):
                line.offer(episode(1, seed=1000 * n + k))
            found += [e.trajectory.seed for e in _take_with(ingest, 3, *lines)]
        assert all(line.flush(WAIT_S) for line in lines)
        assert sorted(found) == seeds
        for line in lines:
            line.close()


def _take_with(ingest: Ingest, episodes: int, *lines: Uplink) -> list[Episode]:
    until(lambda: ingest.queued >= episodes, *lines)
    return ingest.take(episodes, WAIT_S)


def test_an_actor_pauses_while_the_learner_takes_nothing() -> None:
    with ingesting(credits_=2) as ingest, closing(uplink(ingest.address)) as line:
        for seed in range(12):
            line.offer(episode(1, seed=seed))
        until(lambda: ingest.queued == 2, line)
        assert not line.flush(0.3)
        assert (ingest.queued, line.unacked, line.ready) == (2, 10, False)
        ingest.take(2, WAIT_S)
        until(lambda: line.unacked == 8, line)
        taken = [e.trajectory.seed for _ in range(5) for e in _take_with(ingest, 2, line)]
        assert taken == list(range(2, 12))
        until(lambda: line.ready, line)


def test_a_freed_credit_is_told_at_once_and_not_at_the_next_beat(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("learner.stream.ingest.TICK_S", 600.0)
    slow = UplinkLimits(beat_s=600, hello_s=600)
    with ingesting(credits_=1) as ingest:
        line = uplink(ingest.address, limits=slow)
        with closing(line):
            line.offer(episode(1))
            line.offer(episode(1))
            until(lambda: ingest.queued == 1 and line.unacked == 1, line)
            ingest.take(1, WAIT_S)
            assert line.flush(WAIT_S)


def test_an_actor_that_keeps_as_much_as_it_may_pauses_and_asks_for_a_checkpoint() -> None:
    size = len(wire.encode_episode(episode(1), stamp=STAMP))
    limits = UplinkLimits(pause_at=64, max_kept_bytes=4 * size, beat_s=0.05, hello_s=0.05)
    with ingesting(credits_=64) as ingest, closing(uplink(ingest.address, limits=limits)) as line:
        line.offer(episode(1))
        assert line.flush(WAIT_S)
        assert not ingest.wants_commit
        while line.ready:
            line.offer(episode(1))
        until(lambda: ingest.wants_commit and not line.unacked, line)
        assert not line.ready
        kept = line.kept
        until(lambda: line.kept == kept, line)  # nothing is given up
        ingest.committed(ingest.snapshot())
        until(lambda: line.ready and not line.kept and not ingest.wants_commit, line)


def test_a_take_in_vain_says_who_was_heard_and_keeps_what_came() -> None:
    with ingesting() as ingest, closing(uplink(ingest.address)) as line:
        with pytest.raises(TimeoutError, match="of 0 actors heard: none"):
            ingest.take(1, 0.01)
        line.offer(episode(1, seed=8))
        until(lambda: ingest.queued == 1, line)
        with pytest.raises(TimeoutError, match="1 wait; of 1 actors heard: a "):
            ingest.take(2, 0.01)
        assert [e.trajectory.seed for e in ingest.take(1, WAIT_S)] == [8]


def test_a_copy_is_kept_until_a_checkpoint_covers_it() -> None:
    with ingesting() as ingest, closing(uplink(ingest.address)) as line:
        line.offer(episode(1))
        assert line.flush(WAIT_S)
        held = ingest.snapshot()
        line.offer(episode(1))
        assert line.flush(WAIT_S)
        assert line.kept == 2
        ingest.committed(held)
        until(lambda: line.kept == 1, line)


def test_a_learner_that_resumes_gets_what_it_had_not_saved_and_nothing_twice() -> None:
    with ingesting() as first:
        line = uplink(first.address)
        port = port_of(first)
        for seed in range(3):
            line.offer(episode(1, seed=seed))
        assert line.flush(WAIT_S)
        assert len(first.take(1, WAIT_S)) == 1
        saved = first.snapshot()  # 0 was trained on, 1 and 2 are in the checkpoint
        first.committed(saved)
        until(lambda: line.kept == 0, line)
        line.offer(episode(1, seed=3))
        assert line.flush(WAIT_S)  # accepted, and not in any checkpoint
    with closing(line), ingesting(port, held=saved) as second:
        line.offer(episode(1, seed=4))
        until(lambda: second.queued == 4, line)
        assert [e.trajectory.seed for e in second.take(4, WAIT_S)] == [1, 2, 3, 4]
        assert line.flush(WAIT_S)
        with pytest.raises(TimeoutError):
            second.take(1, 0.3)  # nothing comes again, though time enough to resend has gone by


def test_a_replaced_actor_can_finish_nothing_and_what_it_took_with_it_is_counted() -> None:
    metrics = Metrics()
    with ingesting(metrics=metrics) as ingest, closing(uplink(ingest.address, incarnation=0)) as old:
        old.offer(episode(1, seed=1))
        assert old.flush(WAIT_S)
        for _ in range(5):  # one of them waits with the actor when it stalls
            old.offer(episode(1))
        until(lambda: old.unacked == 2, old)
        with closing(uplink(ingest.address, incarnation=1)) as new:
            new.offer(episode(1, seed=2))
            with pytest.raises(Refused, match="incarnation 1 has taken over"):
                old.offer(episode(1))
            until(lambda: dropped(metrics, "lost") == 2, new)
            with pytest.raises(Refused, match=r"actor 'a', incarnation 0, .*fenced"):
                until(lambda: False, old)
            assert new.flush(WAIT_S)
        assert ingest.snapshot().counts == {"lost": 2}


def test_an_actor_that_leaves_waits_for_the_checkpoint_that_frees_it() -> None:
    with ingesting() as ingest:
        line = uplink(ingest.address)
        line.offer(episode(1))
        assert not line.settle(0.3)
        assert ingest.wants_commit
        held = ingest.snapshot()
        ingest.committed(held)
        assert line.settle(WAIT_S)
        line.close()
        until(lambda: ingest.silent_for_s("a") == float("inf"))
        assert ingest.snapshot().counts == {}


def test_an_actor_that_leaves_in_a_hurry_has_what_it_takes_along_counted() -> None:
    metrics = Metrics()
    with ingesting(metrics=metrics, credits_=1) as ingest:
        line = uplink(ingest.address)
        for _ in range(3):
            line.offer(episode(1))
        until(lambda: line.unacked == 2, line)
        line.close()
        until(lambda: dropped(metrics, "lost") == 2)
        assert ingest.queued == 1


def test_an_actor_follows_its_learner_to_another_address() -> None:
    with ingesting() as first, closing(uplink(first.address)) as line:
        line.offer(episode(1, seed=1))
        assert line.flush(WAIT_S)
        with ingesting() as second:
            line.redirect(second.address)
            assert [e.trajectory.seed for e in _take_with(second, 1, line)] == [1]


def test_an_actor_of_another_run_is_told() -> None:
    with ingesting() as ingest, closing(uplink(ingest.address, run="old")) as line:
        with pytest.raises(Refused, match="other_run"):
            until(lambda: False, line)
        assert ingest.queued == 0


def test_an_actor_is_not_refused_for_what_another_said_in_its_name() -> None:
    with closing(Router()) as router, closing(uplink(router.address)) as line:
        line.offer(episode(1))
        peer, _ = until(lambda: router.recv(0.0), line)
        for stamp in (replace(STAMP, actor="a", incarnation=0), replace(STAMP, run="run", actor="a", incarnation=1)):
            router.send(peer, delivery.encode_refused(delivery.FENCED, stamp))
        stamp = replace(STAMP, run="run", actor="a", incarnation=0)
        router.send(peer, delivery.encode_refused(delivery.OTHER_RUN, stamp))
        with pytest.raises(Refused, match="other_run"):
            until(lambda: False, line)


def test_junk_on_the_socket_stops_nobody() -> None:
    metrics = Metrics()
    with ingesting(metrics=metrics) as ingest, closing(Dealer(ingest.address, identity=b"vandal")) as vandal:
        for junk in (b"", b"junk", b"GIRL" * 9):
            assert vandal.send(junk, timeout_s=WAIT_S)
        with closing(uplink(ingest.address)) as line:
            line.offer(episode(1, seed=6))
            assert line.flush(WAIT_S)
            assert [e.trajectory.seed for e in ingest.take(1, WAIT_S)] == [6]
    assert dropped(metrics, "damaged") == 3


def test_an_episode_lost_on_the_way_is_sent_again_as_soon_as_that_is_certain() -> None:
    with closing(Router()) as router, closing(uplink(router.address)) as line:
        line.offer(episode(1))
        heard: list[str] = []
        floor = 0

        def hear() -> bool:
            nonlocal floor
            if (message := router.recv(0.005)) is not None:
                header, _ = wire.decode(message[1])
                heard.append(header["kind"])
                router.send(message[0], b"junk")  # ignored
                floor = int(heard.count(delivery.EPISODE) >= 3)
                if "number" in header:
                    grant = Grant(
                        incarnation=0, notice=header["number"], low_watermark=floor, committed=0, settled=0, limit=1
                    )
                    router.send(message[0], delivery.encode_grant(grant))
            return line.unacked == 0

        until(hear, line)
        assert heard[0] == delivery.HELLO
        episodes = [place for place, kind in enumerate(heard) if kind == delivery.EPISODE]
        assert len(episodes) == 3
        for first, second in pairwise(episodes):
            assert delivery.HEARTBEAT in heard[first:second]  # never on a mere suspicion


def test_how_long_an_actor_has_been_silent_is_known() -> None:
    with ingesting() as ingest, closing(uplink(ingest.address)) as line:
        assert ingest.silent_for_s("a") == float("inf")
        until(lambda: ingest.silent_for_s("a") < WAIT_S, line)
        silence_s = ingest.silent_for_s("a")
        until(lambda: ingest.silent_for_s("a") > silence_s + 0.2)  # nobody polls: it says nothing
        silence_s = ingest.silent_for_s("a")
        until(lambda: ingest.silent_for_s("a") < silence_s, line)
        assert line.silent_for_s < WAIT_S
