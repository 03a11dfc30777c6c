"""Runs one config over several seeds and variants, and writes what came out as one JSON and one table.

    python experiments/study.py experiments/miniwob_four.toml --seeds 0 1 2 3 4 --out experiments/results/NAME.json
    python experiments/study.py CONFIG --seeds 100 101 --out F --variant plain discriminator.demo_states=0 ...

Each run is a `giirl train` of its own. Runs that are already in the JSON are not repeated.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from giirl.files import whole_file
from giirl.statistics import Score


def main() -> None:
    arguments = _arguments()
    variants: list[list[str]] = arguments.variant or [["default"]]
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    study: dict[str, Any] = {"commands": [], "runs": []}
    if arguments.out.exists():
        study = json.loads(arguments.out.read_text())
    command = " ".join(["python", *sys.argv])
    study["commands"] += [command] if command not in study["commands"] else []
    for name, *changes in variants:
        for seed in arguments.seeds:
            settings = [*arguments.set, *changes]
            if not any(
                (run["variant"], run["seed"], run["changes"]) == (name, seed, settings) for run in study["runs"]
            ):
                study["runs"].append(_run(arguments.config, name, settings, seed))
                with whole_file(arguments.out) as file:
                    file.write(json.dumps(study, indent=1).encode() + b"\n")
    sys.stdout.write(_table(study["runs"]))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("config", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE", help="for every variant")
    parser.add_argument("--variant", nargs="+", action="append", metavar="WORD", help="NAME [KEY=VALUE ...]")
    return parser.parse_args()


def _run(config: Path, variant: str, changes: list[str], seed: int) -> dict[str, Any]:
    """One training run and its toggle measurement; a run that fails is kept as such."""
    sys.stderr.write(f"{time.strftime('%H:%M:%S')} {variant} {' '.join(changes)} seed {seed}\n")
    giirl = [sys.executable, "-m", "giirl"]
    with tempfile.TemporaryDirectory(prefix="giirl-study-") as folder:
        run, result = Path(folder) / "run", Path(folder) / "result.json"
        train = [*giirl, "train", str(config), *changes, f"seed={seed}", f"run={run}", "--json", str(result)]
        ended = subprocess.run(train, capture_output=True, text=True, check=False)
        if ended.returncode != 0:
            return {"variant": variant, "changes": changes, "seed": seed, "failed": ended.stderr.splitlines()[-1:]}
        found: dict[str, Any] = json.loads(result.read_text())
        toggle = [*giirl, "reward", "toggle", str(run), "--pages", "500", "--json", str(result)]
        asked = "click-button" in found["tasks"] and found["algorithm"] == "giirl"
        if asked and subprocess.run(toggle, capture_output=True, check=False).returncode == 0:
            found["toggle"] = json.loads(result.read_text())
        curve = [json.loads(line) for line in (run / "curve.jsonl").read_text().splitlines()]
    return {"variant": variant, "changes": changes, "episodes_to_95": _reached(curve, 0.95), **found}


def _reached(curve: list[dict[str, Any]], share: float, window: int = 50) -> dict[str, int | None]:
    """Per task, the training episodes of all tasks before `window` of its own in a row first reach `share`."""
    reached: dict[str, int | None] = {}
    for task in curve[-1]["outcomes"]:
        recent: list[int] = []
        reached[task] = None
        for point in curve:
            recent = (recent + point["outcomes"].get(task, []))[-window:]
            if len(recent) == window and sum(recent) >= share * window:
                reached[task] = point["episodes"]
                break
    return reached


def _table(runs: list[dict[str, Any]]) -> str:
    """Markdown: a line a run, then for each variant all its episodes together with the Wilson interval of those."""
    done = [run for run in runs if "tasks" in run]
    tasks = list(done[0]["tasks"]) if done else []
    lines = ["| variant | seed | " + " | ".join(tasks) + " | lowest, last third | own / swapped goal | s |"]
    lines.append("|-" * (len(tasks) + 5) + "|")
    for run in runs:
        if "tasks" not in run:
            lines.append(f"| {run['variant']} | {run['seed']} | failed: {run['failed']} |")
            continue
        toggle = run.get("toggle")
        goals = f"{toggle['own_goal_top1']:.3f} / {toggle['swapped_goal_top1']:.3f}" if toggle else "-"
        success = " | ".join(f"{100 * run['tasks'][task]['success']:.1f}" for task in tasks)
        lowest = " ".join(f"{run['lowest_last_third'][task]:.2f}" for task in tasks)
        lines.append(f"| {run['variant']} | {run['seed']} | {success} | {lowest} | {goals} | {run['seconds']:.0f} |")
    for variant in dict.fromkeys(run["variant"] for run in done):
        mine = [run["tasks"] for run in done if run["variant"] == variant]
        asked = sum(run["variant"] == variant for run in runs)
        cells = []
        for task in tasks:
            episodes = sum(run[task]["episodes"] for run in mine)
            won = sum(round(run[task]["success"] * run[task]["episodes"]) for run in mine)
            low, high = Score(episodes=episodes, successes=won).interval()
            cells.append(f"{100 * won / episodes:.2f} ({100 * low:.1f}-{100 * high:.1f})")
        lines.append(f"| **{variant}** | {len(mine)} of {asked} | " + " | ".join(cells) + " | | | |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
