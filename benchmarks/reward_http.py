"""Latency of the learned reward over HTTP on loopback: python -m benchmarks.reward_http [--json FILE]

A client in a process of its own asks for the rewards of 32 candidates, a click or a word typed, on pages of 52 tasks,
one request after the other over one connection. In the first round the service reads each page for the first time, in
the second it finds what it has read in its caches. The reward is untrained, which changes no time.
"""

from __future__ import annotations

import argparse
import http.client
import json
import multiprocessing
import os
import time
from multiprocessing.connection import Connection
from threading import Event
from typing import Any

import click
import numpy as np
import torch

from benchmarks.pages import load_fixture
from giirl_core.config_file import load_config
from giirl_core.files import writable, write_json
from giirl_core.metrics import Metrics
from giirl_core.nets.reward import build_reward
from giirl_core.telemetry.series import SERVICE
from giirl_core.types import Action, Goal, Page, Verb
from reward_service.http_api import open_server
from reward_service.http_schema import ScoreRequest

CANDIDATES = 32
START_S = 120.0  # longest start of the service
TIMEOUT_S = 10.0  # of one request


def candidates(page: Page, goal: Goal, rng: np.random.Generator) -> list[Action]:
    """Random clicks, and random words of the goal typed into the fields of the page, about half each."""
    fields = np.flatnonzero(page.typable)
    actions = []
    for _ in range(CANDIDATES):
        if len(fields) and rng.random() < 0.5:
            word = int(rng.integers(len(goal.tokens)))
            actions.append(Action(verb=Verb.TYPE, element=int(rng.choice(fields)), start=word, end=word))
        else:
            actions.append(Action(verb=Verb.CLICK, element=int(rng.integers(len(page)))))
    return actions


def requests() -> list[bytes]:
    """One request for each page of the fixture."""
    rng = np.random.default_rng(0)
    steps = [(page, t.goal) for trajectories in load_fixture() for t in trajectories for page in t.pages]
    return [
        ScoreRequest.of(page, goal, candidates(page, goal, rng)).model_dump_json(exclude_defaults=True).encode()
        for page, goal in steps
    ]


def serve(address: Connection) -> None:
    """Serve an untrained reward until the process is terminated; its address goes into the pipe."""
    torch.set_num_threads(1)
    open_server(build_reward(load_config(None, [])), Metrics(SERVICE)).serve(Event(), address.send)


def latencies_ms(address: str, bodies: list[bytes]) -> list[float]:
    """The time from sending each request to the end of its answer; RuntimeError for an answer other than 200."""
    connection = http.client.HTTPConnection(address.removeprefix("http://"), timeout=TIMEOUT_S)
    times = []
    for body in bodies:
        start_s = time.perf_counter()
        connection.request("POST", "/score", body, {"Content-Type": "application/json"})
        answer = connection.getresponse()
        text = answer.read()
        times.append(1000 * (time.perf_counter() - start_s))
        if answer.status != 200:
            raise RuntimeError(f"{address}/score answered {answer.status}: {text.decode()}")
    connection.close()
    return times


def measure() -> dict[str, Any]:
    """Percentiles of both rounds, in milliseconds."""
    bodies, load = requests(), os.getloadavg()
    near, far = multiprocessing.Pipe()
    context = multiprocessing.get_context("spawn")
    service = context.Process(target=serve, args=(far,), daemon=True)
    service.start()
    try:
        if not near.poll(START_S):
            raise RuntimeError(f"the service did not start within {START_S:.0f} s")
        address = near.recv()
        rounds = {name: latencies_ms(address, bodies) for name in ("new_pages", "known_pages")}
    finally:
        service.terminate()
        service.join(TIMEOUT_S)
    return {
        "candidates": CANDIDATES,
        "requests": len(bodies),
        "request_bytes_p50": float(np.median([len(body) for body in bodies])),
        "load_before": load,
        "load_after": os.getloadavg(),
        **{
            name: {f"p{q}_ms": round(float(np.percentile(times, q)), 2) for q in (50, 95, 99)}
            for name, times in rounds.items()
        },
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--json", type=writable)
    file = parser.parse_args().json
    result = measure()
    if file:
        write_json(file, result)
    click.echo(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
