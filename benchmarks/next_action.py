"""Offline accuracy of cloning: does the policy net, cloned from recordings, predict a person's next action on others?

    python -m benchmarks.next_action --demos FOLDER --updates 400 --seed 0 --json FILE

One net learns from 24 of every 32 recordings of each task; the other 8 are predicted, step by step, on the pages that the
person saw. Two accuracies are reported. Strict: the same verb, row and typed text. Lenient: an action that the task
accepts as well (`accepted`). An episode is right when all its steps are, leniently.
"""

from __future__ import annotations

import argparse
import copy
import json
import pickle
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
from actors.rollouts import Schedule, play
from browser_farm.human.recordings import find_recordings, import_recordings
from giirl_core.config import CloningConfig, Config
from giirl_core.metrics import Metrics
from giirl_core.nets.batch import collate
from giirl_core.nets.language import load_vectors
from giirl_core.nets.models import PolicyNet
from giirl_core.nets.parameters import seal_net
from giirl_core.types import Action, Page, Purpose, Trajectory, Verb
from learner.cloning import Cloner
from learner.data import Example, featurise_trajectory

COLLECTION = "2017-10-16_second-turk"
EMA = 0.98  # of the weights, for each update
HELD_OUT = 4  # every fourth recording of a task is predicted, the others are learned from
# Where the instruction fixes the order of equal elements: what is done later is not right now.
ORDERED = frozenset({"click-button-sequence", "tic-tac-toe", "choose-date-nodelay", "use-spinner"})
# Where the person tries sections until the link turns up: any that was not tried yet is as good.
SEARCHES = frozenset({"click-collapsible-2-nodelay", "click-tab-2", "click-tab-2-hard", "navigate-tree"})
CONTROLS = frozenset({"a", "button", "label", "li", "td", "h3", "option"})  # clicked as a whole, whatever is inside


def load(folder: Path, cache: Path | None = None) -> list[Trajectory]:
    """All clean recordings that the nets can imitate, by task and file name. `cache` is a file outside the repository."""
    if cache is not None and cache.exists():
        with cache.open("rb") as file:
            return pickle.load(file)  # type: ignore[no-any-return]
    tasks = list(find_recordings(folder, collections=[COLLECTION]))
    episodes, _ = import_recordings(folder, tasks=tasks, collections=[COLLECTION])
    found = [e.trajectory for e in episodes if e.outcome.success and all(a.learnable for a in e.trajectory.actions)]
    if cache is not None:
        cache.write_bytes(pickle.dumps(found))
    return found


def split(trajectories: Sequence[Trajectory]) -> tuple[list[Trajectory], list[Trajectory]]:
    """To learn from, and held out. Two tasks that share their recordings hold out the same ones."""
    by_task: dict[str, list[Trajectory]] = defaultdict(list)
    for trajectory in trajectories:
        by_task[trajectory.task].append(trajectory)
    learned, held_out = [], []
    for some in by_task.values():
        for rank, trajectory in enumerate(sorted(some, key=lambda t: t.seed)):
            (held_out if rank % HELD_OUT == HELD_OUT - 1 else learned).append(trajectory)
    return learned, held_out


def control(page: Page, row: int) -> int:
    """The ref of the control that an action on a row operates: its nearest ancestor in CONTROLS, or bare text's parent."""
    at = row
    while at >= 0:
        if page.tag[at] in CONTROLS:
            return int(page.ref[at])
        at = int(page.parent[at])
    parent = int(page.parent[row])
    return int(page.ref[parent if page.tag[row] == "t" and parent >= 0 else row])


def accepted(trajectory: Trajectory, t: int, guess: Action) -> bool:
    """Whether the task accepts a guess at step t as well as what the person did.

    It is on the same control; or on one with the same tag, classes and (not empty) text; or does what the person did at a
    later step, to another element of the same tag, where order does not matter; or, in a search, tries another section.
    """
    page, done, goal = trajectory.pages[t], trajectory.actions[t], trajectory.goal
    if guess.verb is not done.verb:
        return False
    a, b = guess.element, done.element
    if control(page, a) == control(page, b) or (_look(page, a) == _look(page, b) and page.text[a]):
        typed, wanted = guess.text(goal), done.text(goal)
        longer = (
            trajectory.task == "book-flight-nodelay"
            and typed
            and (typed.startswith(wanted) or wanted.startswith(typed))
        )
        return typed == wanted or bool(longer)  # a list offers the same towns for a part of a name
    if trajectory.task == "click-shape":
        return _fits_alike(page, a, b, set(goal.tokens))
    if trajectory.task == "tic-tac-toe":
        return _as_good(page, a, b)
    if trajectory.task == "click-widget":
        return page.tag[a] == page.tag[b]
    if trajectory.task == "use-autocomplete-nodelay" and "ends" not in goal.tokens:
        return _look(page, a)[0] == _look(page, b)[0] and page.text[a][:2].lower() == page.text[b][:2].lower()
    if page.classes[a] == page.classes[b] == "page-link" and page.text[a] == ">":
        active = [
            int(t)
            for t, r in zip(page.text, page.parent, strict=True)
            if r >= 0 and "active" in page.classes[r] and t.isdigit()
        ]
        return page.text[b].isdigit() and bool(active) and int(page.text[b]) > active[0]
    if page.classes[a].startswith("email-") and page.parent[a] == page.parent[b]:
        return True  # any part of a message opens it
    if trajectory.task == "click-pie-nodelay":
        return _on_sector(page, a, b)
    if trajectory.task in SEARCHES and t + 1 < len(trajectory):
        last = trajectory.actions[-1].element
        found = control(trajectory.pages[-1], last) == control(page, a)  # sooner than the person did
        closed = page.classes[_parent(page, a)].startswith("expandable")
        like = page.tag[a] == page.tag[b] and page.tag[_parent(page, a)] == page.tag[_parent(page, b)]
        return found or (closed if trajectory.task == "navigate-tree" else like)
    if trajectory.task in ORDERED or page.tag[a] != page.tag[b]:
        return False
    return any(
        later.verb is guess.verb
        and control(trajectory.pages[s], later.element) == control(page, a)
        and later.text(goal) == guess.text(goal)
        for s, later in enumerate(trajectory.actions)
        if s > t
    )


def _fits_alike(page: Page, a: int, b: int, words: set[str]) -> bool:
    """Whether two drawings fit the same words of an instruction that names no colour (recordings lack it)."""
    if words & {"red", "green", "blue", "aqua", "black", "magenta", "yellow"} or not words & {
        "item",
        "shape",
        "letter",
        "digit",
    }:
        return False
    kinds = [_drawn(page, row) for row in (a, b)]
    if not words & {"item"} and kinds[0] != kinds[1]:
        return False
    sizes = page.box[[a, b], 3]
    return not words & {"small", "large"} or bool(sizes.min() > 0.7 * sizes.max())


def _drawn(page: Page, row: int) -> str:
    if page.tag[row] != "text":
        return "shape"
    return "digit" if page.text[row].isdigit() else "letter"


def _as_good(page: Page, a: int, b: int) -> bool:
    """Whether a move is as good as the person's: it wins if that wins, else blocks if that blocks, else is to a free cell."""
    cells = [row for row in range(len(page)) if page.tag[row] == "span"]
    if len(cells) != 9 or a not in cells or b not in cells:
        return False
    board = ["x" if "mark-x" in page.classes[c] else "o" if "mark-o" in page.classes[c] else "" for c in cells]
    lines = [(0, 1, 2), (3, 4, 5), (6, 7, 8), (0, 3, 6), (1, 4, 7), (2, 5, 8), (0, 4, 8), (2, 4, 6)]

    def value(cell: int) -> int:
        if board[cell]:
            return -1
        others = [sorted(board[c] for c in line if c != cell) for line in lines if cell in line]
        return 2 if ["x", "x"] in others else 1 if ["o", "o"] in others else 0

    return value(cells.index(a)) >= max(0, value(cells.index(b)))


def _on_sector(page: Page, a: int, b: int) -> bool:
    """Whether a label lies on the sector that the person clicked, or the other way round."""
    if {page.tag[a], page.tag[b]} != {"path", "tspan"}:
        return False
    sector, label = (a, b) if page.tag[a] == "path" else (b, a)
    left, top, width, height = page.box[sector]
    x, y = page.box[label, :2] + page.box[label, 2:] / 2
    return bool(left <= x <= left + width and top <= y <= top + height)


def _parent(page: Page, row: int) -> int:
    return max(0, int(page.parent[row]))


def _look(page: Page, row: int) -> tuple[str, ...]:
    return page.tag[row], page.text[row], page.value[row], page.classes[row]


@torch.no_grad()
def predict(net: PolicyNet, examples: Sequence[Example], pages: int = 64) -> list[list[Action]]:
    """The likeliest action at every step of every example."""
    net.eval()
    rows = [row for example in examples for row in example.features]
    guesses: list[Action] = []
    for first in range(0, len(rows), pages):
        guesses += net.sample(net.encoder(collate(rows[first : first + pages])), None)[0].first()
    net.train()
    found, at = [], 0
    for example in examples:
        found.append(guesses[at : at + len(example.features)])
        at += len(example.features)
    return found


def score(examples: Sequence[Example], guesses: Sequence[Sequence[Action]]) -> dict[str, dict[str, float]]:
    """For each task: strict and lenient accuracy per step, and the share of episodes that are right."""
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
    """Over tasks."""
    return {
        name: round(float(np.mean([s[name] for s in scores.values()])), 4) for name in ("strict", "lenient", "episode")
    }


def train(
    config: Config, learned: Sequence[Example], updates: int, batch: int, seed: int, report: Any = None
) -> tuple[PolicyNet, PolicyNet, float]:
    """A cloned net, the running mean of its weights, and the CPU-milliseconds a step of training."""
    torch.manual_seed(seed)
    generator, rng = torch.Generator().manual_seed(seed), np.random.default_rng(seed)
    net = PolicyNet(load_vectors(config.net.vectors), config.net)
    net.train()
    cloner = Cloner(config.cloning, net, generator, metrics=Metrics())
    smooth = copy.deepcopy(net)
    by_task: dict[str, list[Example]] = defaultdict(list)
    for example in learned:
        by_task[example.trajectory.task].append(example)
    tasks = sorted(by_task)
    steps, began = 0, time.process_time()
    for update in range(updates):
        done = update / updates
        warm = min(1.0, (update + 1) / 30)
        for group in cloner.optimiser.param_groups:
            group["lr"] = config.cloning.learning_rate * warm * (1 - done * (1 - config.cloning.final_lr_fraction))
        some = [by_task[tasks[i]] for i in rng.choice(len(tasks), batch, replace=batch > len(tasks))]
        drawn = [examples[rng.integers(len(examples))] for examples in some]
        steps += sum(len(example.features) for example in drawn)
        stats = cloner.update(drawn)
        decay = min(EMA, (update + 1) / (update + 10))
        with torch.no_grad():
            for average, current in zip(smooth.parameters(), net.parameters(), strict=True):
                average.lerp_(current, 1 - decay)
        if report and (update + 1) % 50 == 0:
            report(update + 1, stats, 1e3 * (time.process_time() - began) / steps)
    return net, smooth, 1e3 * (time.process_time() - began) / steps


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--demos", type=Path, required=True, help="folder of all collections of recordings")
    parser.add_argument("--updates", type=int, default=400)
    parser.add_argument("--batch", type=int, default=48, help="recordings in one update")
    parser.add_argument("--rate", type=float, default=CloningConfig().learning_rate)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tasks", nargs="*", help="only these")
    parser.add_argument("--cache", type=Path, help="keep the imported recordings in this file")
    parser.add_argument("--play", type=int, default=0, help="also play this many pages of each task in Chrome")
    parser.add_argument("--weights", type=Path, help="keep the net in this file")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--mistakes", type=int, default=0, help="print this many mistakes of each of the worst tasks")
    options = parser.parse_args()
    torch.set_num_threads(1)
    config = replace(Config(), cloning=CloningConfig(learning_rate=options.rate))
    began = time.process_time()
    learned, held_out = split(
        [t for t in load(options.demos, options.cache) if not options.tasks or t.task in options.tasks]
    )
    vectors = load_vectors(config.net.vectors)
    examples = [featurise_trajectory(t, vectors) for t in learned]
    tested = [featurise_trajectory(t, vectors) for t in held_out]
    print(f"{len(learned)} + {len(held_out)} recordings, {time.process_time() - began:.0f} s", flush=True)

    def report(update: int, stats: dict[str, float], cost: float) -> None:
        print(f"{update} loss {stats['p_loss']:.3f} {cost:.2f} ms/step", flush=True)

    raw, net, cost = train(config, examples, options.updates, options.batch, options.seed, report)
    guesses = predict(net, tested)
    scores = score(tested, guesses)
    fitted = mean(score(examples, predict(net, examples)))
    result = {
        "held_out": mean(scores),
        "last_weights": mean(score(tested, predict(raw, tested))),
        "learned": fitted,
        "ms_per_step": round(cost, 3),
        "parameters": sum(p.numel() for p in net.parameters()),
        "tasks": scores,
    }
    worst = sorted(scores, key=lambda task: scores[task]["lenient"])
    for task in worst:
        print(f"{task:32}" + "".join(f"{100 * value:7.1f}" for value in scores[task].values()))
    print({name: part for name, part in result.items() if name != "tasks"})
    if options.json:
        options.json.write_text(json.dumps(result, indent=1))
    if options.weights:
        options.weights.write_bytes(seal_net(net, 1).blob)
    if options.play:
        played = play_tasks(config, net, sorted(scores), options.play)
        result["played"] = played
        for task in sorted(played, key=lambda task: played[task]):
            print(f"played {task:32}{100 * played[task]:7.1f}{100 * scores[task]['episode']:7.1f}")
        print(f"played: {np.mean(list(played.values())):.4f}")
        if options.json:
            options.json.write_text(json.dumps(result, indent=1))
    if options.mistakes:
        print_mistakes(tested, guesses, worst[:16], options.mistakes)


def play_tasks(config: Config, net: PolicyNet, tasks: Sequence[str], episodes: int) -> dict[str, float]:
    """For each task the share of fresh pages on which the likeliest actions succeed, in Chrome."""
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
    """Some wrong guesses of some tasks, as lines."""
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
                print(f"   {name}: {Verb(action.verb).name} {row} {_look(page, row)} {action.text(trajectory.goal)!r}")


if __name__ == "__main__":
    main()
