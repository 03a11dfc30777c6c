"""CPU time of the learner: each part of an iteration, optionally compared with another commit."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from giirl_core.progress import Display

ROOT = Path(__file__).resolve().parent.parent
CASES = {"four": 10, "mix": 4}  # the four tasks of the thesis, all tasks of the fixture: iterations per turn
TIMEOUT_S = 600.0
Parts = dict[str, Any]


def measure(display: Display, *, before: str = "", turns: int = 3) -> dict[str, Any]:
    """Measure all cases `turns` times; returns the JSON of `giirl bench learner`.

    `before` is a commit to compare with. The two take turns, so that both see the same load of the machine. ValueError
    if git does not know the commit.
    """
    with _checkout(before) as baseline:
        trees = {"now": ROOT, **({"before": baseline} if baseline is not None else {})}
        found: dict[str, dict[str, list[Parts]]] = {case: {name: [] for name in trees} for case in CASES}
        with display.job("turns", turns * len(CASES) * len(trees)) as job:
            for _ in range(turns):
                for case in CASES:
                    for name, tree in trees.items():
                        found[case][name].append(run_turn(case, tree))
                        job.advance()
    summaries = {case: {name: _summary(parts) for name, parts in by_tree.items()} for case, by_tree in found.items()}
    four, mix = summaries["four"], summaries["mix"]
    result: dict[str, Any] = {
        "four": {"episodes_per_cpu_s": round(four["now"]["episodes_per_cpu_s"], 1)},
        "mix": {"cpu_ms_per_step": round(mix["now"]["ms_per_step"], 3)},
        "cloning": {"cpu_ms_per_step": round(mix["now"]["cloning_ms_per_step"], 4)},
        "parts_ms": {case: by_tree["now"]["ms"] for case, by_tree in summaries.items()},
        "memory_mb": {case: by_tree["now"]["memory_mb"] for case, by_tree in summaries.items()},
        "settings": {"turns": turns, "iterations": CASES, "before": before},
        "load_average": round(os.getloadavg()[0], 1),
    }
    if before:
        result["four"]["ratio_before"] = _ratio(four, "episodes_per_cpu_s")
        result["mix"]["ratio_before"] = round(1 / _ratio(mix, "ms_per_step"), 2)
        result["cloning"]["ratio_before"] = round(1 / _ratio(mix, "cloning_ms_per_step"), 2)
        result["memory_mb_before"] = {case: by_tree["before"]["memory_mb"] for case, by_tree in summaries.items()}
        result["parts_ms_before"] = {case: by_tree["before"]["ms"] for case, by_tree in summaries.items()}
    return result


def _ratio(case: dict[str, Parts], name: str) -> float:
    return round(float(case["now"][name] / case["before"][name]), 4)


def _summary(turns: list[Parts]) -> Parts:
    """The medians over the turns."""
    ms = {name: statistics.median(turn["ms"][name] for turn in turns) for name in turns[0]["ms"]}
    total, first = sum(ms.values()), turns[0]
    return {
        "ms": {name: round(value, 2) for name, value in ms.items()},
        "ms_per_step": total / first["steps"],
        "episodes_per_cpu_s": 1e3 * first["episodes"] / total,
        "cloning_ms_per_step": statistics.median(turn["cloning_ms_per_step"] for turn in turns),
        "memory_mb": statistics.median(turn["memory_mb"] for turn in turns),
    }


def run_turn(case: str, tree: Path) -> Parts:
    """One turn of a case in a separate process, with the code in `tree` on this checkout's fixture.

    The program is that of `tree`, which knows its interfaces, or ours if it has none. RuntimeError if it fails.
    """
    ours = Path(__file__).with_name("learner_parts.py")
    theirs = tree / "benchmarks" / ours.name
    program = theirs if theirs.exists() else ours
    command = [sys.executable, "-P", str(program), case, str(CASES[case]), str(ours.parent)]
    environment = {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S)
    if done.returncode:
        raise RuntimeError(f"the benchmark failed in {tree}: {done.stderr.strip().splitlines()[-1:]}")
    parts: Parts = json.loads(done.stdout)
    return parts


@contextmanager
def _checkout(commit: str) -> Iterator[Path | None]:
    """A temporary folder with the files of a commit; None if `commit` is empty. ValueError for an unknown commit."""
    if not commit:
        yield None
        return
    with tempfile.TemporaryDirectory() as folder:
        archive = subprocess.run(["git", "archive", commit], cwd=ROOT, capture_output=True)
        if archive.returncode:
            raise ValueError(f"--before {commit}: {archive.stderr.decode().strip()}; wanted a commit of this checkout")
        subprocess.run(["tar", "-x", "-C", folder], input=archive.stdout, check=True)
        yield Path(folder)
