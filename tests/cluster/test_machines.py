"""A run on several simulated machines that come, go and lose their power; see `tests.cluster.machines`.

`make test` runs a short form; `pytest tests/cluster` runs all of it. What was measured is printed (`-s` shows it).
"""

from __future__ import annotations

import random
import signal
import sys
import time

import pytest

from tests.cluster.machines import missing
from tests.cluster.site import START_S, Site, send, site
from tests.end_to_end.commands import Command, curve, step

pytestmark = [
    pytest.mark.ray,
    pytest.mark.slow,
    pytest.mark.timeout(3000),
    pytest.mark.skipif(bool(missing()), reason=missing()),
]


def test_a_run_goes_on_through_a_full_cluster_new_nodes_and_power_cuts(full: bool) -> None:
    with site() as place:
        place.power_on("head")
        place.power_on("learner")
        with place.train() as command:
            nobody_has_a_place(place, command, wait_s=300.0 if full else 30.0)
            a_node_comes(place, command)
            a_worker_node_is_cut(place, command)
            the_node_comes_back(place, command)
            the_learner_node_is_cut(place, command)
        the_learner_comes_back(place)


def test_a_job_that_is_killed_at_random_moments_goes_on_with_the_same_command(full: bool) -> None:
    rng, kills = random.Random(7), 20 if full else 3
    with site() as place:
        for name in ("head", "learner", "a"):
            place.power_on(name)
        reached = []
        for _ in range(kills):
            with place.train("checkpoint_every=5") as command:
                time.sleep(rng.uniform(1.0, 30.0))
                assert command.process.poll() is None, command.err
                send(command, signal.SIGKILL)
                reached.append(step(place.run))
        with place.train("checkpoint_every=5") as command:
            place.until_step(command, max(reached) + 20)
            note(kills=kills, steps_at_each_kill=reached)
            assert place.stop(command) == 0
        assert [point["step"] for point in curve(place.run)] == list(range(1, step(place.run) + 1))


def nobody_has_a_place(place: Site, command: Command, *, wait_s: float) -> None:
    command.until(lambda: "for a place" in command.err, "a line that says what is missing", timeout_s=START_S)
    since_s = time.monotonic()
    time.sleep(wait_s)
    assert command.process.poll() is None, command.err
    assert step(place.run) == 0
    place.power_on("a")
    on_s = time.monotonic()
    place.until_step(command, 20)
    note(waited_s=on_s - since_s, first_20_steps_after_the_node_came_s=time.monotonic() - on_s)


def a_node_comes(place: Site, command: Command) -> None:
    assert place.actors() <= {"actor-0", "actor-1", "actor-2"}
    place.power_on("b")
    since_s = time.monotonic()
    # A line says so only after a longer wait, so the address of its metrics is what shows that it has started.
    command.until(lambda: "metrics of actor-2" in command.err, "a place for the last actor", timeout_s=60)
    note(place_on_a_new_node_s=time.monotonic() - since_s)
    place.goes_on(command, 60)
    assert place.actors() == {"actor-0", "actor-1", "actor-2"}


def a_worker_node_is_cut(place: Site, command: Command) -> None:
    """The node has actors and a reward service."""
    usual_s = place.goes_on(command)
    place.power_cut("b")
    note(longest_step_before_s=usual_s, longest_step_after_a_power_cut_s=place.goes_on(command, 60))


def the_node_comes_back(place: Site, command: Command) -> None:
    place.power_on("b")
    place.goes_on(command, 40)


def the_learner_node_is_cut(place: Site, command: Command) -> None:
    place.power_cut("learner")
    command.process.wait(30)


def the_learner_comes_back(place: Site) -> None:
    place.power_on("learner")
    before = step(place.run)
    with place.train() as command:
        since_s = time.monotonic()
        place.until_step(command, before + 20)
        note(back_after_the_learner_node_was_cut_s=time.monotonic() - since_s)
        assert place.stop(command) == 0


def note(**measured: object) -> None:
    sys.stderr.write(f"{measured}\n")
