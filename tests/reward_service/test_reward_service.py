"""The reward service over real sockets: which weights it accepts, which requests it rejects, and its errors."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from contextlib import closing

import numpy as np
import pytest

from giirl_core.metrics import Metrics
from giirl_core.types import Trajectory
from giirl_core.weights import Weights
from giirl_core.wire import messages as wire
from giirl_core.wire import scoring
from giirl_core.wire.score_client import ScoreClient
from giirl_core.wire.transport import Dealer
from reward_service.service import RewardService, Scorer, ServiceLimits
from tests.reward_service.serving import WAIT_S, Rewards, counted, load, poll_results, serving, trajectory, until


def test_before_the_first_weights_a_request_is_repeated_until_there_are_some() -> None:
    metrics = Metrics()
    with serving(RewardService(load, metrics=metrics)) as service:
        impatient = ScoreClient([service.address], identity="a", timeout_s=1.0, retries=0)
        with closing(impatient), pytest.raises(TimeoutError, match="no weights yet"):
            impatient.score([trajectory()])
        with closing(ScoreClient([service.address], identity="b", timeout_s=WAIT_S)) as client:
            client.submit("k", trajectory())
            before = counted(metrics, "no_weights")
            until(lambda: not client.poll() and counted(metrics, "no_weights") > before)
            service.set_weights(Weights.with_digest(1, b"3"))
            ((_, rewards, version),) = poll_results(client)
            assert rewards is not None
            assert (rewards.tolist(), version) == ([3.0, 3.0], 1)


def test_older_corrupt_and_unfit_weights_are_rejected_and_change_nothing() -> None:
    metrics = Metrics()
    service = RewardService(load, metrics=metrics)
    with serving(service):
        service.set_weights(Weights.with_digest(5, b"5"))
        corrupt = Weights(version=7, blob=b"8", digest=Weights.with_digest(7, b"7").digest)
        for weights, message in (
            (Weights.with_digest(4, b"4"), "version 4, wanted one after 5"),
            (Weights.with_digest(5, b"6"), "version 5, wanted one after 5"),
            (corrupt, "corrupt"),
            (Weights.with_digest(8, b"eight"), "no number"),
        ):
            with pytest.raises(ValueError, match=message):
                service.set_weights(weights)
        service.set_weights(Weights.with_digest(5, b"5"))  # the current weights are accepted again
        assert service.version == 5
        assert metrics.registry.get_sample_value("giirl_weights_refused_total", {"network": "reward"}) == 4
        with closing(ScoreClient([service.address], identity="a")) as client:
            assert client.score([trajectory(1)])[0][0].tolist() == [5.0]


@pytest.mark.parametrize("earlier", [2, 6])
def test_first_weights_are_ignored_if_other_weights_came_earlier(earlier: int) -> None:
    metrics = Metrics()
    with serving(RewardService(load, metrics=metrics)) as service:
        service.set_weights(Weights.with_digest(earlier, b"7"))
        service.set_first_weights(Weights.with_digest(5, b"5"))
        assert service.version == earlier
        assert not metrics.registry.get_sample_value("giirl_weights_refused_total", {"network": "reward"})
    with serving(RewardService(load)) as service:
        service.set_first_weights(Weights.with_digest(5, b"5"))
        assert service.version == 5


def test_new_weights_never_mix_two_versions_in_one_reply() -> None:
    with serving(RewardService(load)) as service:
        service.set_weights(Weights.with_digest(0, b"0"))
        stop = threading.Event()

        def publish() -> None:
            version = 1
            while not stop.is_set():
                service.set_weights(Weights.with_digest(version, b"%d" % version))
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


def test_requests_beyond_the_queue_limit_get_the_reply_overloaded() -> None:
    metrics = Metrics()
    service = RewardService(load, metrics=metrics, limits=ServiceLimits(max_queue=2, max_batch_steps=1))
    service.set_weights(Weights.with_digest(0, b"1"))
    stop = threading.Event()
    with closing(Dealer(service.address, identity=b"flood")) as dealer:
        for number in range(8):
            assert dealer.send(scoring.encode_request(number, [trajectory(1)]), timeout_s=WAIT_S)
        time.sleep(0.2)  # wait until all of them have arrived
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


def test_malformed_requests_are_counted_and_the_service_keeps_running() -> None:
    metrics = Metrics()
    good = scoring.encode_request(1, [trajectory()])
    header, arrays = wire.decode(good)
    with serving(RewardService(load, metrics=metrics)) as service:
        service.set_weights(Weights.with_digest(0, b"2"))
        with closing(Dealer(service.address, identity=b"vandal")) as vandal:
            for message in (b"", b"junk", good[:-1], good + b"x", wire.encode({"kind": "x"})):
                assert vandal.send(message, timeout_s=WAIT_S)
            invalid = {**arrays, "verb": np.full(2, 99, np.int8)}
            assert vandal.send(wire.encode(header, invalid), timeout_s=WAIT_S)
            assert vandal.send(wire.encode({**header, "heads": [1]}, arrays), timeout_s=WAIT_S)
            for _ in range(2):
                reply = scoring.decode_reply(vandal.recv(WAIT_S) or b"")
                assert reply.request == 1
                assert reply.error.startswith("invalid request: ")
        with closing(ScoreClient([service.address], identity="a")) as client:
            assert client.score([trajectory()])[0][0].tolist() == [2.0, 2.0]
    assert counted(metrics, "malformed") == 7
    assert counted(metrics, "ok") == 1


def test_a_trajectory_that_cannot_be_scored_does_not_fail_the_other_requests_of_its_batch(
    caplog: pytest.LogCaptureFixture,
) -> None:
    def load_picky(_: Weights) -> Scorer:
        def score(trajectories: Sequence[Trajectory]) -> list[Rewards]:
            if any(len(t) == 3 for t in trajectories):
                raise IndexError("three steps")
            return [np.zeros(len(t), np.float32) for t in trajectories]

        return score

    service = RewardService(load_picky, limits=ServiceLimits(linger_s=0.2))
    service.set_weights(Weights.with_digest(0, b""))
    with serving(service), closing(ScoreClient([service.address], identity="a")) as client:
        for steps in (1, 3, 2):
            client.submit(steps, trajectory(steps))
        results = {key: rewards for key, rewards, _ in poll_results(client, 3)}
    assert results[3] is None
    assert [len(results[key]) for key in (1, 2) if results[key] is not None] == [1, 2]  # type: ignore[arg-type]
    assert "three steps" in caplog.text


@pytest.mark.parametrize("wrong", [[], [np.zeros(1, np.float32)], [np.array([1, np.nan], np.float32)]], ids=repr)
def test_rewards_of_wrong_length_or_value_are_an_error_for_the_client(wrong: list[Rewards]) -> None:
    with serving(RewardService(lambda _: lambda _: wrong)) as service:
        service.set_weights(Weights.with_digest(0, b""))
        client = ScoreClient([service.address], identity="a")
        with closing(client), pytest.raises(TimeoutError, match="scoring failed: the scorer returned"):
            client.score([trajectory(2)])
