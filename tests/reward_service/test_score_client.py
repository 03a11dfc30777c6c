"""The score client over real sockets: replies, retries, and when it gives up."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from functools import partial

import numpy as np
import pytest

from giirl_core.types import Trajectory
from giirl_core.weights import Weights
from giirl_core.wire import messages as wire
from giirl_core.wire import scoring
from giirl_core.wire.score_client import ScoreClient
from giirl_core.wire.scoring import ScoreReply
from giirl_core.wire.transport import Router
from reward_service.service import RewardService, Scorer, ServiceLimits
from tests.giirl_core.wire_examples import assert_same_trajectory
from tests.reward_service.serving import (
    WAIT_S,
    Rewards,
    load,
    poll_results,
    receive_request,
    serving,
    trajectory,
    until,
)


def test_rewards_come_with_the_version_of_the_reward() -> None:
    with serving(RewardService(load)) as service:
        service.set_weights(Weights.with_digest(4, b"7"))
        with closing(ScoreClient([service.address], identity="a")) as client:
            rewards, version = client.score([trajectory(2), trajectory(5)])
            assert [part.tolist() for part in rewards] == [[7.0] * 2, [7.0] * 5]
            assert version == 4


def test_each_submitted_request_gets_its_result_under_its_own_key() -> None:
    with serving(RewardService(load)) as service:
        service.set_weights(Weights.with_digest(0, b"1"))
        with closing(ScoreClient([service.address], identity="a")) as client:
            for steps in range(1, 20):
                client.submit(("episode", steps), trajectory(steps))
            results = poll_results(client, 19)
            assert {key: len(r) for key, r, _ in results if r is not None} == {("episode", n): n for n in range(1, 20)}
            assert client.pending == 0


def test_the_scorer_gets_the_submitted_trajectory() -> None:
    scored: list[Trajectory] = []

    def load_spy(_: Weights) -> Scorer:
        def score(trajectories: Sequence[Trajectory]) -> list[Rewards]:
            scored.extend(trajectories)
            return [np.zeros(len(t), np.float32) for t in trajectories]

        return score

    with serving(RewardService(load_spy)) as service:
        service.set_weights(Weights.with_digest(0, b""))
        with closing(ScoreClient([service.address], identity="a")) as client:
            client.score([trajectory(3)])
    assert_same_trajectory(scored[0], trajectory(3))


def test_a_request_to_an_overloaded_service_is_sent_again() -> None:
    limits = ServiceLimits(max_queue=1, max_batch_steps=1)
    with serving(RewardService(load, limits=limits)) as service:
        service.set_weights(Weights.with_digest(0, b"1"))
        with closing(ScoreClient([service.address], identity="a", timeout_s=WAIT_S)) as client:
            for key in range(20):
                client.submit(key, trajectory(1))
            results = poll_results(client, 20)
    assert {key for key, rewards, _ in results if rewards is not None} == set(range(20))


def test_a_service_restarted_on_the_same_port_replies_to_pending_requests() -> None:
    first = RewardService(load)
    port = int(first.address.rpartition(":")[2])
    with closing(ScoreClient([first.address], identity="a", timeout_s=0.3, retries=60)) as client:
        with serving(first):
            first.set_weights(Weights.with_digest(0, b"1"))
            assert client.score([trajectory(1)])[1] == 0
        client.submit("k", trajectory(1))
        assert client.poll() == []
        second = RewardService(load, port=port)
        second.set_weights(Weights.with_digest(1, b"2"))
        with serving(second):
            ((key, rewards, version),) = poll_results(client)
    assert (key, version) == ("k", 1)
    assert rewards is not None
    assert rewards.tolist() == [2.0]


def test_a_request_fails_if_there_is_no_service() -> None:
    with closing(ScoreClient(["127.0.0.1:1"], identity="a", timeout_s=0.02, retries=1)) as client:
        client.submit("k", trajectory())
        assert client.pending == 1
        assert poll_results(client) == [("k", None, -1)]
        assert client.pending == 0
        with pytest.raises(TimeoutError, match=r"127\.0\.0\.1:1 gave no rewards .*no connection"):
            client.score([trajectory()])


def test_a_request_without_a_reply_is_sent_again_with_the_same_number() -> None:
    connect = partial(ScoreClient, identity="a", timeout_s=0.5, retries=2)
    with closing(Router()) as router, closing(connect([router.address])) as client:
        client.submit("k", trajectory(1))
        numbers: list[int] = []  # of the requests that arrived
        results: list[tuple[object, Rewards | None, int]] = []

        def receive() -> bool:
            if (message := router.recv(0.005)) is not None:
                numbers.append(scoring.read_request(wire.decode(message[1])[0]))
            results.extend(client.poll())
            return bool(results)

        until(receive)
        assert numbers == [numbers[0]] * 3
        assert results == [("k", None, -1)]


def test_a_late_or_repeated_reply_is_counted_as_a_stray() -> None:
    with closing(Router()) as router, closing(ScoreClient([router.address], identity="a")) as client:
        client.submit("k", trajectory(1))
        peer, number = receive_request(client, router)
        reply = ScoreReply(request=number, rewards=(np.ones(1, np.float32),), version=2)
        for message in (scoring.encode_reply(reply), scoring.encode_reply(reply), b"junk"):
            assert router.send(peer, message)
        results = poll_results(client)
        until(lambda: not client.poll() and client.ignored_replies == 2)
    assert [(key, version) for key, _, version in results] == [("k", 2)]


def test_the_less_loaded_of_two_replicas_gets_more_requests() -> None:
    with closing(Router()) as silent, closing(Router()) as quick:
        received = {silent: 0, quick: 0}
        client = ScoreClient([silent.address, quick.address], identity="a", timeout_s=WAIT_S)

        def received_so_far() -> int:
            client.poll()
            for router in received:
                while (message := router.recv(0.0)) is not None:
                    received[router] += 1
                    number = scoring.read_request(wire.decode(message[1])[0])
                    reply = ScoreReply(request=number, rewards=(np.ones(1, np.float32),), version=2, backlog=1)
                    if router is quick:
                        assert router.send(message[0], scoring.encode_reply(reply))
            return sum(received.values())

        def settled(requests: int) -> bool:
            return received_so_far() == requests and client.pending == received[silent]

        with closing(client):
            for key in range(20):
                client.submit(key, trajectory(1))
                until(lambda requests=key + 1: settled(requests))  # type: ignore[misc]
    assert 1 <= received[silent] <= 3


def test_requests_of_a_dead_replica_go_to_another() -> None:
    with closing(Router()) as dead, serving(RewardService(load)) as alive:
        alive.set_weights(Weights.with_digest(3, b"4"))
        client = ScoreClient([dead.address, alive.address], identity="a", timeout_s=0.3, retries=20)
        with closing(client):
            for key in range(10):
                client.submit(key, trajectory(1))
            results = poll_results(client, 10)
    assert {key: version for key, _, version in results} == dict.fromkeys(range(10), 3)


def test_a_silent_replica_is_left_at_once_and_used_again_when_it_answers() -> None:
    with closing(Router()) as silent, serving(RewardService(load)) as alive:
        alive.set_weights(Weights.with_digest(3, b"4"))
        client = ScoreClient([silent.address], identity="a", timeout_s=0.3, retries=50)
        with closing(client):
            for key in range(5):
                client.submit(key, trajectory(1))
            receive_request(client, silent)
            client.set_replicas([silent.address, alive.address])
            # When the first of the five has waited too long, all of them go to the other one.
            results = poll_results(client, 5)
            assert {key: version for key, _, version in results} == dict.fromkeys(range(5), 3)
            while silent.recv(0.0):
                continue
            for key in range(50):
                client.submit(key, trajectory(1))
            assert len(poll_results(client, 50)) == 50
            numbers = {scoring.read_request(wire.decode(m[1])[0]) for _ in range(50) if (m := silent.recv(0.0))}
            assert len(numbers) <= 1  # a probe, for which nobody waits
            assert client.answering
            peer, number = receive_request(client, silent)
            client.set_replicas([silent.address])
            assert not client.answering
            silent.send(peer, scoring.encode_reply(ScoreReply(request=number, version=2)))
            until(lambda: not client.poll() and client.answering)


def test_without_any_replica_that_answers_the_client_says_so() -> None:
    with closing(ScoreClient([], identity="a")) as client:
        assert not client.answering
    with closing(ScoreClient(["127.0.0.1:1"], identity="a", timeout_s=0.1, retries=3)) as client:
        client.submit("k", trajectory(1))
        until(lambda: not client.poll() and not client.answering)


def test_pending_requests_go_to_the_new_replicas_after_a_change_of_addresses() -> None:
    with closing(Router()) as gone, serving(RewardService(load)) as new:
        new.set_weights(Weights.with_digest(3, b"4"))
        with closing(ScoreClient([], identity="a", timeout_s=WAIT_S)) as client:
            client.submit("early", trajectory(1))  # pending, because there are no replicas yet
            assert client.poll() == []
            client.set_replicas([gone.address])
            receive_request(client, gone)
            client.set_replicas([new.address])
            ((key, _, version),) = poll_results(client)
    assert (key, version) == ("early", 3)


def test_an_overloaded_replica_gets_no_requests_while_another_one_replies() -> None:
    with closing(Router()) as busy, serving(RewardService(load)) as free:
        free.set_weights(Weights.with_digest(3, b"4"))
        with closing(ScoreClient([busy.address], identity="a", timeout_s=WAIT_S)) as client:
            client.submit("k", trajectory(1))
            peer, number = receive_request(client, busy)
            client.set_replicas([busy.address, free.address])
            assert busy.send(peer, scoring.encode_reply(ScoreReply(request=number, error=scoring.OVERLOADED)))
            ((key, _, version),) = poll_results(client)
    assert (key, version) == ("k", 3)
