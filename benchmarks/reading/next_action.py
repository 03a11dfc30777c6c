# ruff: noqa: T201
"""Offline accuracy of cloning: how often a policy cloned from human recordings predicts the next action in others.

    python -m benchmarks.reading.next_action --demos FOLDER --updates 600 --seed 0 --json FILE

One net learns from three of every four recordings of each task. The actions of the others are predicted, step by step,
on the recorded pages. Two accuracies are reported. Strict: the same verb, row and typed text. Lenient: an action that
the task accepts as well (`accepted`). An episode is correct if all its steps are correct, leniently.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from actors.agents import PolicyAgent
from actors.browser import open_browser
from actors.rollouts import play
from actors.schedule import Schedule
from benchmarks.reading.accepted_actions import accepted, look
from browser_farm.human.recording_files import find_recordings
from browser_farm.human.recordings import import_recordings
from giirl_core.choices import Choice, action_of
from giirl_core.config import CloningConfig, Config
from giirl_core.gestures import BASIC
from giirl_core.metrics import Metrics
from giirl_core.nets.batch import collate
from giirl_core.nets.language import load_vectors
from giirl_core.nets.models import PolicyNet
from giirl_core.nets.parameters import load_net, serialise_net
from giirl_core.nets.reward import build_policy
from giirl_core.types import Action, Purpose, Trajectory, Verb
from giirl_core.weights import Weights
from learner.cloning import Cloner
from learner.data import Example, ExpertSampler, featurise_trajectory
from learner.schedules import anneal

COLLECTION = "2017-10-16_second-turk"
HELD_OUT = 4  # every fourth recording of a task is held out


def load(folder: Path) -> list[Trajectory]:
    """All successful recordings whose actions the nets can learn."""
    tasks = list(find_recordings(folder, collections=[COLLECTION]))
    episodes, _ = import_recordings(folder, tasks=tasks, collections=[COLLECTION])
    return [e.trajectory for e in episodes if e.outcome.success and not e.trajectory.unlearnable(BASIC)]


def split(trajectories: Sequence[Trajectory]) -> tuple[list[Trajectory], list[Trajectory]]:
    """The recordings to learn from, and those held out. Tasks that share recordings hold out the same ones."""
    by_task: dict[str, list[Trajectory]] = defaultdict(list)
    for trajectory in trajectories:
        by_task[trajectory.task].append(trajectory)
    learned: list[Trajectory] = []
    held_out: list[Trajectory] = []
    for some in by_task.values():
        for rank, trajectory in enumerate(sorted(some, key=lambda t: t.seed)):
            (held_out if rank % HELD_OUT == HELD_OUT - 1 else learned).append(trajectory)
    return learned, held_out


@torch.no_grad()
def predict(net: PolicyNet, examples: Sequence[Example], pages: int = 64) -> list[list[Action]]:
    """The greedy action at every step of every example."""
    net.eval()
    rows = [row for example in examples for row in example.features]
    guesses: list[Choice] = []
    for first in range(0, len(rows), pages):
        guesses += net.sample(net.encoder(collate(rows[first : first + pages])), None)[0].first()
    net.train()
    found, at = [], 0
    for example in examples:
        some = guesses[at : at + len(example.features)]
        pages_of = example.trajectory.pages
        found.append([action_of(choice, page, net.gestures) for choice, page in zip(some, pages_of, strict=True)])
        at += len(example.features)
    return found


def score(examples: Sequence[Example], guesses: Sequence[Sequence[Action]]) -> dict[str, dict[str, float]]:
    """For each task: strict and lenient accuracy per step, and the fraction of correct episodes."""
    counts: dict[str, list[tuple[float, float, float]]] = defaultdict(list)
    for example, some in zip(examples, guesses, strict=True):
        trajectory = example.trajectory
        strict, lenient = [], []
        for t, (guess, done) in enumerate(zip(some, trajectory.actions, strict=True)):
            same = (guess.verb, guess.element) == (done.verb, done.element)
            strict.append(same and guess.text(trajectory.goal) == done.text(trajectory.goal))
            lenient.append(strict[-1] or accepted(trajectory, t, guess))
        counts[trajectory.task].append((float(np.mean(strict)), float(np.mean(lenient)), float(all(lenient))))
    names = ("strict", "lenient", "episode")
    return {
        task: dict(zip(names, np.mean(rows, axis=0).round(4).tolist(), strict=True)) for task, rows in counts.items()
    }


def mean(scores: dict[str, dict[str, float]]) -> dict[str, float]:
    """The mean over tasks."""
    return {
        name: round(float(np.mean([s[name] for s in scores.values()])), 4) for name in ("strict", "lenient", "episode")
    }


def train(config: Config, learned: Sequence[Trajectory], updates: int, seed: int) -> tuple[PolicyNet, float]:
    """A cloned net, and the CPU time of training per step in ms."""
    torch.manual_seed(seed)
    vectors = load_vectors(config.net.vectors)
    demos = ExpertSampler(learned, vectors, np.random.default_rng(seed))
    net = PolicyNet(vectors, config.net).train()
    cloner = Cloner(config.cloning, net, torch.Generator().manual_seed(seed), metrics=Metrics())
    steps, began = 0, time.process_time()
    for update in range(updates):
        anneal(cloner, update / updates)
        drawn = demos.sample(config.cloning.batch)
        steps += sum(len(example.features) for example in drawn)
        stats = cloner.update(drawn)
        if (update + 1) % 50 == 0:
            cost = 1e3 * (time.process_time() - began) / steps
            print(f"{update + 1} loss {stats['p_loss']:.3f} {cost:.2f} ms/step", flush=True)
    return net, 1e3 * (time.process_time() - began) / steps


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--demos", type=Path, required=True, help="folder of all collections of recordings")
    parser.add_argument("--updates", type=int, default=600)
    parser.add_argument("--batch", type=int, default=CloningConfig().batch, help="recordings in one update")
    parser.add_argument("--rate", type=float, default=CloningConfig().learning_rate)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tasks", nargs="*", help="only these")
    parser.add_argument("--play", type=int, default=0, help="also play this many pages of each task in Chrome")
    parser.add_argument("--weights", type=Path, help="keep the net in this file; play that net if the file exists")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--mistakes", type=int, default=0, help="print this many mistakes of each of the worst tasks")
    options = parser.parse_args()
    torch.set_num_threads(1)
    config = replace(Config(), cloning=CloningConfig(learning_rate=options.rate, batch=options.batch))
    if options.weights and options.weights.exists():
        net = build_policy(config)
        load_net(net, Weights.with_digest(1, options.weights.read_bytes()))
        result: dict[str, Any] = {}
        tasks = options.tasks or sorted(find_recordings(options.demos, collections=[COLLECTION]))
    else:
        net, result = train_and_score(config, options)
        tasks = sorted(result["tasks"])
    if options.play:
        result["played"] = played = play_tasks(config, net, tasks, options.play)
        for task in sorted(played, key=lambda task: played[task]):
            print(f"played {task:32}{100 * played[task]:7.1f}")
        print(f"played: {np.mean(list(played.values())):.4f}")
    if options.json:
        options.json.write_text(json.dumps(result, indent=1), encoding="utf-8")


def train_and_score(config: Config, options: argparse.Namespace) -> tuple[PolicyNet, dict[str, Any]]:
    """A cloned net and its accuracies."""
    learned, held_out = split([t for t in load(options.demos) if not options.tasks or t.task in options.tasks])
    print(f"{len(learned)} + {len(held_out)} recordings", flush=True)
    net, cost = train(config, learned, options.updates, options.seed)
    vectors = load_vectors(config.net.vectors)
    examples, tested = ([featurise_trajectory(t, vectors) for t in part] for part in (learned, held_out))
    guesses = predict(net, tested)
    scores = score(tested, guesses)
    result = {
        "held_out": mean(scores),
        "learned": mean(score(examples, predict(net, examples))),
        "ms_per_step": round(cost, 3),
        "parameters": sum(p.numel() for p in net.parameters()),
        "tasks": scores,
    }
    worst = sorted(scores, key=lambda task: scores[task]["lenient"])
    for task in worst:
        print(f"{task:32}" + "".join(f"{100 * value:7.1f}" for value in scores[task].values()))
    print({name: part for name, part in result.items() if name != "tasks"})
    if options.mistakes:
        print_mistakes(tested, guesses, worst[:16], options.mistakes)
    if options.weights:
        options.weights.write_bytes(serialise_net(net, 1).blob)
    return net, result


def play_tasks(config: Config, net: PolicyNet, tasks: Sequence[str], episodes: int) -> dict[str, float]:
    """For each task the success rate of greedy actions in Chrome on new pages."""
    config = replace(config, tasks=tuple(tasks), step_limit=25)
    net.eval()
    agent = PolicyAgent(net, load_vectors(config.net.vectors), greedy=True)
    metrics = Metrics()
    browser = open_browser(config, metrics)
    successes: dict[str, int] = dict.fromkeys(tasks, 0)
    try:
        schedule = Schedule(config.tasks, browser.tabs, purpose=Purpose.INSPECT, run_seed=config.seed, quota=episodes)
        for finished in play(browser, agent, schedule, step_limit=config.step_limit, metrics=metrics):
            for episode in finished:
                successes[episode.trajectory.task] += episode.outcome.success
    finally:
        browser.close()
    return {task: count / episodes for task, count in successes.items()}


def print_mistakes(
    examples: Sequence[Example], guesses: Sequence[Sequence[Action]], tasks: Sequence[str], most: int
) -> None:
    """Print wrong predictions of some tasks."""
    shown: dict[str, int] = defaultdict(int)
    for example, some in zip(examples, guesses, strict=True):
        trajectory = example.trajectory
        if trajectory.task not in tasks:
            continue
        for t, (guess, done) in enumerate(zip(some, trajectory.actions, strict=True)):
            if shown[trajectory.task] >= most or guess == done or accepted(trajectory, t, guess):
                continue
            shown[trajectory.task] += 1
            page = trajectory.pages[t]
            print(f"{trajectory.task} step {t}: {trajectory.goal.utterance[:150]}")
            for name, action in (("wanted", done), ("got", guess)):
                row = action.element
                print(f"   {name}: {Verb(action.verb).name} {row} {look(page, row)} {action.text(trajectory.goal)!r}")


if __name__ == "__main__":
    main()
