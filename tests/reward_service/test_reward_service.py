"""The reward service over real sockets: which weights it takes, what it refuses, and that it goes on."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from contextlib import closing

import numpy as np
import pytest

from giirl_core.metrics import Metrics
from giirl_core.types import Trajectory, Weights
from giirl_core.wire import messages as wire
from giirl_core.wire import scoring
from giirl_core.wire.score_client import ScoreClient
from giirl_core.wire.transport import Dealer
from reward_service.service import RewardService, Scorer, ServiceLimits
from tests.reward_service.serving import WAIT_S, Rewards, counted, load, serving, settled, trajectory, until


def test_before_any_weights_the_client_is_told_so_and_asks_again_until_there_are_some() -> None:
    metrics = Metrics()
    with serving(RewardService(load, metrics=metrics)) as service:
        hasty = ScoreClient([service.address], identity="a", timeout_s=1.0, retries=0)
        with closing(hasty), pytest.raises(TimeoutError, match="no weights yet"):
            hasty.score([trajectory()])
        with closing(ScoreClient([service.address], identity="b", timeout_s=WAIT_S)) as client:
            client.submit("k", trajectory())
            before = counted(metrics, "no_weights")
            until(lambda: not client.poll() and counted(metrics, "no_weights") > before)
            service.set_weights(Weights.seal(1, b"3"))
            ((_, rewards, version),) = settled(client)
            assert rewards is not None
            assert (rewards.tolist(), version) == ([3.0, 3.0], 1)


def test_older_corrupt_and_unfit_weights_are_refused_and_change_nothing() -> None:
    metrics = Metrics()
    service = RewardService(load, metrics=metrics)
    with serving(service):
        service.set_weights(Weights.seal(5, b"5"))
        corrupt = Weights(version=7, blob=b"8", digest=Weights.seal(7, b"7").digest)
        for weights, told in (
            (Weights.seal(4, b"4"), "version 4 came after 5"),
            (Weights.seal(5, b"6"), "version 5 came after 5"),
            (corrupt, "corrupt"),
            (Weights.seal(8, b"eight"), "no number"),
        ):
            with pytest.raises(ValueError, match=told):
                service.set_weights(weights)
        service.set_weights(Weights.seal(5, b"5"))  # the very same may come again
        assert service.version == 5
        assert metrics.registry.get_sample_value("giirl_weights_refused_total", {"network": "reward"}) == 4
        with closing(ScoreClient([service.address], identity="a")) as client:
            assert client.score([trajectory(1)])[0][0].tolist() == [5.0]


@pytest.mark.parametrize("sooner", [2, 6])
def test_weights_to_begin_with_give_way_to_those_that_came_before_them(sooner: int) -> None:
    metrics = Metrics()
    with serving(RewardService(load, metrics=metrics)) as service:
        service.set_weights(Weights.seal(sooner, b"7"))
        service.set_first_weights(Weights.seal(5, b"5"))
        assert service.version == sooner
        assert not metrics.registry.get_sample_value("giirl_weights_refused_total", {"network": "reward"})
    with serving(RewardService(load)) as service:
        service.set_first_weights(Weights.seal(5, b"5"))
        assert service.version == 5


def test_a_swap_never_mixes_two_versions_in_one_answer() -> None:
    with serving(RewardService(load)) as service:
        service.set_weights(Weights.seal(0, b"0"))
        stop = threading.Event()

        def publish() -> None:
            version = 1
            while not stop.is_set():
                service.set_weights(Weights.seal(version, b"%d" % version))
                version += 1

        publisher = threading.Thread(target=publish)
        publisher.start()
        try:
            versions = []
            with closing(ScoreClient([service.address], identity="a", timeout_s=WAIT_S)) as client:
                for _ in range(50):
                    rewards, version = client.score([trajectory(1), trajectory(3)])
                    assert {float(r) for part in rewards for r in part} == {float(version)}
                    versions.append(version)
        finally:
            stop.set()
            publisher.join(WAIT_S)
    assert versions == sorted(versions)
    assert versions[-1] > versions[0]


def test_a_flood_is_answered_overloaded_and_the_queue_stays_within_its_bound() -> None:
    metrics = Metrics()
    service = RewardService(load, metrics=metrics, limits=ServiceLimits(max_queue=2, max_batch_steps=1))
    service.set_weights(Weights.seal(0, b"1"))
    stop = threading.Event()
    with closing(Dealer(service.address, identity=b"flood")) as dealer:
        for number in range(8):
            assert dealer.send(scoring.encode_request(number, [trajectory(1)]), timeout_s=WAIT_S)
        time.sleep(0.2)  # until all of them have arrived
        thread = threading.Thread(target=service.serve, args=(stop.is_set,))
        thread.start()
        try:
            replies = [scoring.decode_reply(dealer.recv(WAIT_S) or b"") for _ in range(8)]
        finally:
            stop.set()
            thread.join(WAIT_S)
    refused = [reply for reply in replies if reply.error]
    assert {reply.error for reply in refused} == {"overloaded"}
    assert len(refused) == counted(metrics, "overloaded") > 0
    assert {reply.request for reply in replies} == set(range(8))
    assert [len(reply.rewards) for reply in replies if not reply.error] == [1] * (8 - len(refused))


def test_malformed_messages_are_counted_and_the_service_goes_on() -> None:
    metrics = Metrics()
    good = scoring.encode_request(1, [trajectory()])
    header, arrays = wire.decode(good)
    with serving(RewardService(load, metrics=metrics)) as service:
        service.set_weights(Weights.seal(0, b"2"))
        with closing(Dealer(service.address, identity=b"vandal")) as vandal:
            for message in (b"", b"junk", good[:-1], good + b"x", wire.encode({"kind": "x"})):
                assert vandal.send(message, timeout_s=WAIT_S)
            spoiled = {**arrays, "verb": np.full(2, 9, np.int8)}
            assert vandal.send(wire.encode(header, spoiled), timeout_s=WAIT_S)
            assert vandal.send(wire.encode({**header, "heads": [1]}, arrays), timeout_s=WAIT_S)
            for _ in range(2):
                reply = scoring.decode_reply(vandal.recv(WAIT_S) or b"")
                assert reply.request == 1
                assert reply.error.startswith("invalid request: ")
        with closing(ScoreClient([service.address], identity="a")) as client:
            assert client.score([trajectory()])[0][0].tolist() == [2.0, 2.0]
    assert counted(metrics, "malformed") == 7
    assert counted(metrics, "ok") == 1


def test_one_strange_trajectory_does_not_spoil_the_batch_of_others(caplog: pytest.LogCaptureFixture) -> None:
    def load_picky(_: Weights) -> Scorer:
        def score(trajectories: Sequence[Trajectory]) -> list[Rewards]:
            if any(len(t) == 3 for t in trajectories):
                raise IndexError("three steps")
            return [np.zeros(len(t), np.float32) for t in trajectories]

        return score

    service = RewardService(load_picky, limits=ServiceLimits(linger_s=0.2))
    service.set_weights(Weights.seal(0, b""))
    with serving(service), closing(ScoreClient([service.address], identity="a")) as client:
        for steps in (1, 3, 2):
            client.submit(steps, trajectory(steps))
        answers = {key: rewards for key, rewards, _ in settled(client, 3)}
    assert answers[3] is None
    assert [len(answers[key]) for key in (1, 2) if answers[key] is not None] == [1, 2]  # type: ignore[arg-type]
    assert "three steps" in caplog.text


@pytest.mark.parametrize("wrong", [[], [np.zeros(1, np.float32)], [np.array([1, np.nan], np.float32)]], ids=repr)
def test_a_scorer_that_gives_the_wrong_thing_is_an_error_for_the_client(wrong: list[Rewards]) -> None:
    with serving(RewardService(lambda _: lambda _: wrong)) as service:
        service.set_weights(Weights.seal(0, b""))
        client = ScoreClient([service.address], identity="a")
        with closing(client), pytest.raises(TimeoutError, match="scoring failed: the scorer gave"):
            client.score([trajectory(2)])
