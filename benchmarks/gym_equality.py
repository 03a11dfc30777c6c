"""Plays the miniwob package's environment and ours side by side, and compares every field of every observation.

    python -m benchmarks.gym_equality [--task NAME ...] [--episodes 5] [--steps 5] [--json FILE]

Same seeds, same actions, drawn from the page that both show. The package's page is loaded anew for each episode, as
ours is where it matters. An episode ends at its first difference, since what follows would differ anyway.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import gymnasium
import numpy as np
from miniwob.environment import MiniWoBEnvironment
from miniwob.fields import get_field_extractor

from browser_farm import tasks as miniwob
from browser_farm.gym.adapter import MiniWoBAdapter
from browser_farm.gym.env import MiniWoB
from browser_farm.gym.slot import EnvSlot

ELEMENT_ACTIONS = ("NONE", "CLICK_ELEMENT", "FOCUS_ELEMENT_AND_TYPE_TEXT", "FOCUS_ELEMENT_AND_TYPE_FIELD", "TYPE_TEXT")
HAND_ACTIONS = ("CLICK_COORDS", "DBLCLICK_COORDS", "MOVE_COORDS", "SCROLL_DOWN_COORDS", "PRESS_KEY")
KEYS = ("<Tab>", "<Backspace>", "<ArrowLeft>", "<Enter>", "a", "Q", "7")
TOLD = ("done", "raw_reward", "reason")


@dataclass(slots=True)
class Tally:
    """What the comparison of one task came to."""

    episodes: int = 0
    observations: int = 0  # compared, field by field
    elements: int = 0
    ends: int = 0  # episodes that the page ended, with equal rewards
    screenshots: int = 0
    restarted: int = 0  # a double click ended the episode, and the package's second click began another
    actions: Counter[str] = field(default_factory=Counter)
    differences: list[str] = field(default_factory=list)


def registered() -> list[str]:
    """The tasks that the package registers, without the flights."""
    names = [
        spec.removeprefix("miniwob/").removesuffix("-v1") for spec in gymnasium.registry if spec.startswith("miniwob/")
    ]
    return sorted(name for name in names if name in miniwob.tasks() and not name.startswith("flight"))


class Reference:
    """The package's environment, moved from task to task in one Chrome."""

    def __init__(self) -> None:
        os.environ.setdefault("MINIWOB_CHROME_BINARY", shutil.which("chromium") or "")
        os.environ.setdefault("MINIWOB_CHROMEDRIVER", shutil.which("chromedriver") or "")
        self.env = MiniWoBEnvironment("click-test", refresh_freq=1)

    def show(self, task: str) -> MiniWoBEnvironment:
        instance = self.env.instance
        instance.url = miniwob.page_url(task)
        instance.field_extractor = get_field_extractor(task)
        return self.env


def move(env: MiniWoB, task: str) -> MiniWoB:
    """Our environment likewise: all tasks in one tab."""
    env.adapter = MiniWoBAdapter.of(task)
    env._slot = EnvSlot(env.adapter)
    return env


def differences(ours: Any, theirs: Any, where: str = "") -> Iterator[str]:
    """Every place where two observations differ in value, length, type or dtype."""
    if isinstance(theirs, dict):
        if ours.keys() != theirs.keys():
            yield f"{where} has {sorted(ours)}, wanted {sorted(theirs)}"
            return
        for key in theirs:
            yield from differences(ours[key], theirs[key], f"{where}.{key}")
    elif isinstance(theirs, (tuple, list)):
        if len(ours) != len(theirs):
            yield f"{where} has {len(ours)} entries, wanted {len(theirs)}"
        for index, (one, other) in enumerate(zip(ours, theirs, strict=False)):
            yield from differences(one, other, f"{where}[{index}]")
    elif isinstance(theirs, np.ndarray):
        if ours.dtype != theirs.dtype or ours.shape != theirs.shape or not np.array_equal(ours, theirs):
            yield f"{where} is {_short(ours)}, wanted {_short(theirs)}"
    elif {type(ours), type(theirs)} <= {int, float}:  # the package passes a page's 1 on as it is
        if ours != theirs:
            yield f"{where} is {ours}, wanted {theirs}"
    elif type(ours) is not type(theirs) or ours != theirs:
        yield f"{where} is {_short(ours)}, wanted {_short(theirs)}"


def _short(value: Any) -> str:
    return repr(value)[:80]


def draw_action(env: MiniWoB, observed: dict[str, Any], kinds: tuple[str, ...], rng: np.random.Generator) -> Any:
    """An action on something that the page shows."""
    kind = str(rng.choice(kinds))
    elements = [each for each in observed["dom_elements"] if each["ref"] > 0]
    leaves = [each for each in elements if each["flags"][3]] or elements
    fields = [each for each in elements if each["tag"].startswith(("input_text", "input_password", "textarea"))]
    chosen = (fields if "TYPE" in kind and fields and rng.random() < 0.8 else leaves)[0:]
    element = chosen[int(rng.integers(len(chosen)))]
    words = [word for word in observed["utterance"].replace('"', "").split() if word.isascii()]
    values = {
        "ref": element["ref"],
        "coords": np.array(
            [
                np.clip(element["left"][0] + element["width"][0] / 2, 0, 159),
                np.clip(element["top"][0] + element["height"][0] / 2, 0, 209),
            ],
            dtype=np.float32,
        ),
        "text": str(rng.choice(words or ["word"])),
        "field": 0,
        "key": env.action_space_config.allowed_keys.index(str(rng.choice(KEYS))),
    }
    return kind, env.create_action(kind, **values)


def compare_task(
    task: str,
    reference: Reference,
    ours: MiniWoB,
    tally: Tally,
    *,
    kinds: tuple[str, ...],
    seeds: range,
    steps: int,
    screenshots: bool = False,
) -> None:
    """Play one task in both; add to the tally."""
    theirs = reference.show(task)
    for seed in seeds:
        rng = np.random.default_rng(seed)
        options = {"record_screenshots": screenshots}
        one, _ = ours.reset(seed=seed, options=options)
        other, _ = theirs.reset(seed=seed, options=options)
        tally.episodes += 1
        place, told, over = f"{task} seed {seed} reset", list[str](), False
        for step in range(steps + 1):
            found = [*told, *differences(one, other)]
            tally.observations += 1
            tally.elements += len(other["dom_elements"])
            tally.screenshots += screenshots
            if found:
                tally.differences.append(f"{place}: {len(found)} differences, first {found[0]}")
                break
            if over or step == steps:
                tally.ends += over
                break
            kind, action = draw_action(ours, other, kinds, rng)
            tally.actions[kind] += 1
            place = f"{task} seed {seed} step {step} {kind}"
            one, _, done, _, info = ours.step(action)
            other, _, over, _, wanted = theirs.step(action)
            told = list(differences({key: info[key] for key in TOLD}, {key: wanted[key] for key in TOLD}, "info"))
            if kind == "DBLCLICK_COORDS" and done and not over:
                tally.restarted += 1
                break
            if "root_dom" in wanted and "root_dom" in info and info["root_dom"].diff(wanted["root_dom"]):
                told.append("info.root_dom differs")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--task", action="append", help="again for more; every task but the flights if not given")
    parser.add_argument("--episodes", type=int, default=5, help="a task and kind of action")
    parser.add_argument("--steps", type=int, default=5, help="at most, an episode")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--hand", action="store_true", help="also what goes by coordinates and keys")
    parser.add_argument("--trusted", action="store_true", help="ours acts through Chrome's own input too")
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    tasks = asked.task or registered()
    reference = Reference()
    seeds = range(asked.first_seed, asked.first_seed + asked.episodes)
    results: dict[str, dict[str, Tally]] = {}
    ours = MiniWoB("click-test", trusted=asked.trusted)
    for task in tasks:
        results[task] = {}
        move(ours, task)
        for name, kinds in {"element": ELEMENT_ACTIONS, **({"hand": HAND_ACTIONS} if asked.hand else {})}.items():
            tally = results[task][name] = Tally()
            try:
                compare_task(task, reference, ours, tally, kinds=kinds, seeds=seeds, steps=asked.steps)
            except Exception as error:  # noqa: BLE001 (whatever one task does, the others are compared)
                tally.differences.append(f"{task}: {type(error).__name__}: {str(error).splitlines()[0]}")
            click.echo(f"{task:30} {name:8} {tally.observations:4} {' '.join(tally.differences[:2]) or 'equal'}")
    ours.close()
    reference.env.close()
    if asked.json:
        asked.json.write_text(json.dumps(summary(results), indent=1) + "\n")


def summary(results: dict[str, dict[str, Tally]]) -> dict[str, Any]:
    """Counts for each task, and which tasks were equal throughout."""
    return {
        "command": " ".join(["python -m benchmarks.gym_equality", *sys.argv[1:]]),
        "python": platform.python_version(),
        "equal": {
            name: sum(name in each and not each[name].differences for each in results.values())
            for name in ("element", "hand")
        },
        "tasks": {
            task: {
                name: {
                    "episodes": tally.episodes,
                    "observations": tally.observations,
                    "elements": tally.elements,
                    "ended": tally.ends,
                    "restarted": tally.restarted,
                    "actions": dict(tally.actions),
                    "differences": tally.differences,
                }
                for name, tally in each.items()
            }
            for task, each in results.items()
        },
    }


if __name__ == "__main__":
    main()
