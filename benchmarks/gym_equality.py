"""Plays the miniwob package's environment and ours in parallel, and compares every field of every observation.

    python -m benchmarks.gym_equality [--task NAME ...] [--episodes 5] [--steps 5] [--json FILE]

Both get the same seeds, and the same actions, sampled from the page that both show. The package reloads its page before
each episode; ours does so for tasks that need it. An episode ends at its first difference, because later observations
would differ anyway.
"""

from __future__ import annotations

import argparse
import os
import platform
import shutil
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
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
from giirl_core.files import writable, write_json

ELEMENT_ACTIONS = ("NONE", "CLICK_ELEMENT", "FOCUS_ELEMENT_AND_TYPE_TEXT", "FOCUS_ELEMENT_AND_TYPE_FIELD", "TYPE_TEXT")
INPUT_ACTIONS = ("CLICK_COORDS", "DBLCLICK_COORDS", "MOVE_COORDS", "SCROLL_DOWN_COORDS", "PRESS_KEY")
KEYS = ("<Tab>", "<Backspace>", "<ArrowLeft>", "<Enter>", "a", "Q", "7")
COMPARED_INFO = ("done", "raw_reward", "reason")


@dataclass(slots=True)
class Comparison:
    """The results of one task and kind of action."""

    episodes: int = 0
    observations: int = 0  # compared field by field
    elements: int = 0
    ended: int = 0  # episodes that the page ended, with equal rewards
    screenshots: int = 0
    restarted: int = 0  # episodes ended by a double click whose second click began a new episode in the package
    actions: Counter[str] = field(default_factory=Counter)
    differences: list[str] = field(default_factory=list)


def registered() -> list[str]:
    """The tasks that the package registers, without the flight tasks."""
    names = [
        spec.removeprefix("miniwob/").removesuffix("-v1") for spec in gymnasium.registry if spec.startswith("miniwob/")
    ]
    return sorted(name for name in names if name in miniwob.tasks() and not name.startswith("flight"))


class PackageEnv:
    """The package's environment, switched between tasks in one Chrome."""

    def __init__(self) -> None:
        os.environ.setdefault("MINIWOB_CHROME_BINARY", shutil.which("chromium") or "")
        os.environ.setdefault("MINIWOB_CHROMEDRIVER", shutil.which("chromedriver") or "")
        self.env = MiniWoBEnvironment("click-test", refresh_freq=1)

    def switch_task(self, task: str) -> MiniWoBEnvironment:
        """The environment, set to a task from its next reset on."""
        instance = self.env.instance
        instance.url = miniwob.page_url(task)
        instance.field_extractor = get_field_extractor(task)
        return self.env


def switch_task(env: MiniWoB, task: str) -> MiniWoB:
    """Our environment, set to a task from its next reset on: all tasks share one tab."""
    env.adapter = MiniWoBAdapter.of(task)
    env._slot = EnvSlot(env.adapter)
    return env


def differences(ours: Any, theirs: Any, where: str = "") -> Iterator[str]:
    """A line for each field in which two observations differ in value, length, type or dtype."""
    if isinstance(theirs, dict):
        if ours.keys() != theirs.keys():
            yield f"{where} has {sorted(ours)}, wanted {sorted(theirs)}"
            return
        for key in theirs:
            yield from differences(ours[key], theirs[key], f"{where}.{key}")
    elif isinstance(theirs, (tuple, list)):
        if len(ours) != len(theirs):
            yield f"{where} has {len(ours)} entries, wanted {len(theirs)}"
        for index, (our_item, their_item) in enumerate(zip(ours, theirs, strict=False)):
            yield from differences(our_item, their_item, f"{where}[{index}]")
    elif isinstance(theirs, np.ndarray):
        if ours.dtype != theirs.dtype or ours.shape != theirs.shape or not np.array_equal(ours, theirs):
            yield f"{where} is {_short(ours)}, wanted {_short(theirs)}"
    elif {type(ours), type(theirs)} <= {int, float}:  # the package returns an integer reward of the page as int
        if ours != theirs:
            yield f"{where} is {ours}, wanted {theirs}"
    elif type(ours) is not type(theirs) or ours != theirs:
        yield f"{where} is {_short(ours)}, wanted {_short(theirs)}"


def _short(value: Any) -> str:
    return repr(value)[:80]


def sample_action(env: MiniWoB, observation: dict[str, Any], kinds: tuple[str, ...], rng: np.random.Generator) -> Any:
    """A random action type of `kinds`, and an action of it on a random element of the page."""
    kind = str(rng.choice(kinds))
    elements = [element for element in observation["dom_elements"] if element["ref"] > 0]
    leaves = [element for element in elements if element["flags"][3]] or elements
    fields = [e for e in elements if e["tag"].startswith(("input_text", "input_password", "textarea"))]
    candidates = fields if "TYPE" in kind and fields and rng.random() < 0.8 else leaves
    element = candidates[int(rng.integers(len(candidates)))]
    words = [word for word in observation["utterance"].replace('"', "").split() if word.isascii()]
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
    package: PackageEnv,
    ours: MiniWoB,
    comparison: Comparison,
    *,
    kinds: tuple[str, ...],
    seeds: range,
    steps: int,
    screenshots: bool = False,
) -> None:
    """Play one task in both environments, and add the results to `comparison`."""
    theirs = package.switch_task(task)
    for seed in seeds:
        rng = np.random.default_rng(seed)
        options = {"record_screenshots": screenshots}
        our_obs, _ = ours.reset(seed=seed, options=options)
        their_obs, _ = theirs.reset(seed=seed, options=options)
        comparison.episodes += 1
        where, info_differences, their_done = f"{task} seed {seed} reset", list[str](), False
        for step in range(steps + 1):
            found = [*info_differences, *differences(our_obs, their_obs)]
            comparison.observations += 1
            comparison.elements += len(their_obs["dom_elements"])
            comparison.screenshots += screenshots
            if found:
                comparison.differences.append(f"{where}: {len(found)} differences, first {found[0]}")
                break
            if their_done or step == steps:
                comparison.ended += their_done
                break
            kind, action = sample_action(ours, their_obs, kinds, rng)
            comparison.actions[kind] += 1
            where = f"{task} seed {seed} step {step} {kind}"
            our_obs, _, our_done, _, our_info = ours.step(action)
            their_obs, _, their_done, _, their_info = theirs.step(action)
            ours_compared, theirs_compared = (
                {key: info[key] for key in COMPARED_INFO} for info in (our_info, their_info)
            )
            info_differences = list(differences(ours_compared, theirs_compared, "info"))
            if kind == "DBLCLICK_COORDS" and our_done and not their_done:
                comparison.restarted += 1
                break
            doms = [info["root_dom"] for info in (our_info, their_info) if "root_dom" in info]
            if len(doms) == 2 and doms[0].diff(doms[1]):
                info_differences.append("info.root_dom differs")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--task", action="append", help="may be repeated; default: all tasks except the flight tasks")
    parser.add_argument("--episodes", type=int, default=5, help="episodes per task and kind of action")
    parser.add_argument("--steps", type=int, default=5, help="maximum number of steps per episode")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--hand", action="store_true", help="also compare actions by coordinates and keys")
    parser.add_argument("--trusted", action="store_true", help="our environment uses Chrome's native input too")
    parser.add_argument("--json", type=writable)
    arguments = parser.parse_args()
    tasks = arguments.task or registered()
    package = PackageEnv()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.episodes)
    results: dict[str, dict[str, Comparison]] = {}
    ours = MiniWoB("click-test", trusted=arguments.trusted)
    for task in tasks:
        results[task] = {}
        switch_task(ours, task)
        for name, kinds in {"element": ELEMENT_ACTIONS, **({"hand": INPUT_ACTIONS} if arguments.hand else {})}.items():
            comparison = results[task][name] = Comparison()
            try:
                compare_task(task, package, ours, comparison, kinds=kinds, seeds=seeds, steps=arguments.steps)
            except Exception as error:  # noqa: BLE001 (an error in one task must not stop the comparison of the others)
                comparison.differences.append(f"{task}: {type(error).__name__}: {str(error).splitlines()[0]}")
            shown = " ".join(comparison.differences[:2]) or "equal"
            click.echo(f"{task:30} {name:8} {comparison.observations:4} {shown}")
    ours.close()
    package.env.close()
    if arguments.json:
        write_json(arguments.json, summary(results))


def summary(results: dict[str, dict[str, Comparison]]) -> dict[str, Any]:
    """The JSON result: counts for each task, and the number of tasks without differences."""
    return {
        "command": " ".join(["python -m benchmarks.gym_equality", *sys.argv[1:]]),
        "python": platform.python_version(),
        "equal": {
            name: sum(name in kinds and not kinds[name].differences for kinds in results.values())
            for name in ("element", "hand")
        },
        "tasks": {
            task: {
                name: {
                    "episodes": comparison.episodes,
                    "observations": comparison.observations,
                    "elements": comparison.elements,
                    "ended": comparison.ended,
                    "restarted": comparison.restarted,
                    "actions": dict(comparison.actions),
                    "differences": comparison.differences,
                }
                for name, comparison in kinds.items()
            }
            for task, kinds in results.items()
        },
    }


if __name__ == "__main__":
    main()
