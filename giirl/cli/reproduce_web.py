"""`giirl reproduce` for the web chapter: each study one command, one JSON, one table."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean, median
from typing import Any

import click
from rich.table import Column, Table

from giirl.cli.demos import writable
from giirl.studies.web import STUDIES, Study, base_settings
from giirl_core.files import atomic_write, folder_lock
from giirl_core.progress import Display

ROOT = Path("runs/studies")
TUNING_SEEDS = 100  # from here on: choices are made on these, and reports on those below


def commands() -> list[click.Command]:
    """One for each study, and one for all there is to reproduce."""
    return [*(_command(name, study) for name, study in STUDIES.items()), everything]


@click.command("all")
@click.option("--demos", type=click.Path(path_type=Path), help="Public human recordings; scripted experts if not.")
@click.option("--seeds", type=click.IntRange(1), default=5, show_default=True, help="How many, of each web study.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("runs/reproduced"), show_default=True)
@click.pass_context
def everything(context: click.Context, demos: Path | None, seeds: int, out: Path) -> None:
    """Every figure, table and study, each into its own JSON: a day's work. The same command goes on."""
    group = context.parent.command if context.parent else None
    assert isinstance(group, click.Group)
    for name, command in group.commands.items():
        file = out / f"{name}.json"
        if command is context.command or file.exists():
            continue
        out.mkdir(parents=True, exist_ok=True)
        Display().say(f"{name}: {file}")
        given = {"demos": demos, "seeds": seeds} if name in STUDIES else {"out": out}
        known = {parameter.name for parameter in command.params}
        context.invoke(command, json_file=file, **{key: value for key, value in given.items() if key in known})


def _command(name: str, study: Study) -> click.Command:
    @click.command(name, help=f"{study.what}; real Chrome, some minutes a run.")
    @click.option("--demos", type=click.Path(path_type=Path), help="Public human recordings; scripted experts if not.")
    @click.option("--seeds", type=click.IntRange(1), default=1, show_default=True, help="How many.")
    @click.option(
        "--first-seed",
        type=click.IntRange(0),
        default=TUNING_SEEDS if study.tuning else 0,
        show_default=True,
        help=f"{TUNING_SEEDS} and above are for choices, those below for reports.",
    )
    @click.option("--jobs", type=click.IntRange(1), default=2, show_default=True, help="Runs at the same time.")
    @click.option("--set", "changes", multiple=True, metavar="KEY=VALUE", help="For all runs; may be given again.")
    @click.option("--json", "json_file", type=click.Path(path_type=Path), help="Write the numbers here.")
    def command(
        demos: Path | None, seeds: int, first_seed: int, jobs: int, changes: tuple[str, ...], json_file: Path | None
    ) -> None:
        _reproduce(name, study, demos, range(first_seed, first_seed + seeds), jobs, changes, json_file)

    return command


def _reproduce(
    name: str,
    study: Study,
    demos: Path | None,
    seeds: Sequence[int],
    jobs: int,
    changes: Sequence[str],
    json_file: Path | None,
) -> None:
    """Runs that share nothing but the machine play in one thread each; a single one has the machine to itself."""
    from giirl.studies.runner import evaluate_rewards, measure_transfer, plan, record, run_all

    writable(json_file)
    if study.tuning and seeds[0] < TUNING_SEEDS:
        raise click.UsageError(
            f"seed {seeds[0]} is for reports and {name} is for choices: wanted {TUNING_SEEDS} or more"
        )
    if seeds[0] < TUNING_SEEDS <= seeds[-1]:
        raise click.UsageError(
            f"seeds {seeds[0]} to {seeds[-1]} are for reports and for tuning: wanted all below {TUNING_SEEDS}, or none"
        )
    display, since_s = Display(), time.monotonic()
    alone = len(seeds) * len(study.variants) == 1
    base = (*base_settings(study, demos), f"runtime={'local' if alone else 'serial'}", *changes)
    runs = plan(base, study.variants, seeds, ROOT)
    ROOT.mkdir(parents=True, exist_ok=True)
    with folder_lock(ROOT):
        run_all(runs, jobs=jobs, display=display)
        if study.evaluates_reward:
            evaluate_rewards(runs, display)
        measure_transfer(runs, display)
    result = summary(name, [record(run, evaluates_reward=study.evaluates_reward) for run in runs])
    if alone:
        result["wall_seconds"] = round(time.monotonic() - since_s, 1)
    if study.curves:
        from giirl.figures import draw_successes

        beside = ROOT / f"{name}.json" if json_file is None else json_file
        figure = beside.with_name(f"{beside.name.removesuffix('.json')}.png")
        draw_successes(figure, result["runs"])
        display.say(f"drawn: {figure}")
    if json_file is not None:
        with atomic_write(json_file) as file:
            file.write(json.dumps(result, indent=1).encode() + b"\n")
    display.table(study_table(study.what, result))


def summary(name: str, runs: list[dict[str, Any]]) -> dict[str, Any]:
    """A study's numbers: every variant's, and behind them every run's; at the top those of an only variant.

    Intervals are over pages, given these seeds; `worst_seed` says how far those are apart.
    """
    from giirl.studies.runner import pooled

    variants: dict[str, dict[str, Any]] = {}
    for variant in dict.fromkeys(run["variant"] for run in runs):
        mine = [run for run in runs if run["variant"] == variant]
        variants[variant] = {"tasks": pooled(mine), "seeds": [run["seed"] for run in mine]}
        for unit in ("episodes_to", "env_steps_to"):
            variants[variant][unit] = _reached([run[unit] for run in mine])
        variants[variant]["lowest_last_third"] = {task: _lowest(mine, task) for task in variants[variant]["tasks"]}
        if toggles := [run["goal_swap"] for run in mine if "goal_swap" in run]:
            variants[variant]["goal_swap"] = {
                name: min(found[name] for found in toggles) for name in ("own_goal_top1", "swapped_goal_top1")
            }
        if asked := [run["sensitivity"] for run in mine if "sensitivity" in run]:
            variants[variant]["sensitivity"] = {task: _sensitivity(task, asked) for task in asked[0]}
        for group in ("trained_goals", "held_out_goals"):
            if all(group in row for run in mine for row in run["tasks"].values()):
                variants[variant][group] = pooled(mine, group)
    head = {}
    if len(variants) == 1:
        head = {
            "tasks": variants[runs[0]["variant"]]["tasks"],
            "seconds": max(run["seconds"] for run in runs),
            "env_steps": max(run["env_steps"] for run in runs),
            "demonstrations": runs[0]["demonstrations"],
        }
    return {"study": name, **head, "variants": variants, "runs": runs}


def study_table(title: str, result: dict[str, Any]) -> Table:
    """Success of every variant with its interval, over all seeds, and below that of chance."""
    tasks = list(dict.fromkeys(task for found in result["variants"].values() for task in found["tasks"]))
    table = Table("", Column("seeds", justify="right"), *(Column(task, justify="right") for task in tasks), title=title)
    for name, found in result["variants"].items():
        cells = [_cell(found["tasks"][task]) if task in found["tasks"] else "-" for task in tasks]
        table.add_row(name, str(len(found["seeds"])), *cells)
        lowest = [found["lowest_last_third"].get(task) for task in tasks]
        until = found["env_steps_to"]["0.95"]
        table.add_row("  steps until 95 %, median", "", *(_when(until.get(task), found) for task in tasks))
        table.add_row("  lowest in the last third", "", *("-" if low is None else f"{low:.2f}" for low in lowest))
        if "goal_swap" in found:
            own, swapped = (found["goal_swap"][name] for name in ("own_goal_top1", "swapped_goal_top1"))
            table.add_row(f"  goal's button first: {own:.3f}, after a swap {swapped:.3f}")
        if told := found.get("sensitivity"):
            table.add_row(
                "  AUC of own and others' goals, worst seed",
                "",
                *(_auc(told[task]) if task in told else "-" for task in tasks),
            )
        if "held_out_goals" in found:
            table.add_row("  goals never seen", "", *(_cell(found["held_out_goals"][task]) for task in tasks))
    chance = {task: row["random"] for found in result["variants"].values() for task, row in found["tasks"].items()}
    table.add_row("any element, any word", "", *(f"{100 * chance[task]:.1f}" for task in tasks))
    from giirl.run.evaluate import THESIS

    if set(tasks) & set(THESIS):
        table.add_row("thesis", "", *(f"{100 * THESIS[task]:.0f}" if task in THESIS else "-" for task in tasks))
    return table


def _reached(found: Sequence[dict[str, dict[str, int | None]]]) -> dict[str, dict[str, dict[str, Any]]]:
    """Per share of success and task, how many seeds got there, and the median of when."""
    reached: dict[str, dict[str, dict[str, Any]]] = {}
    for share, tasks in found[0].items():
        for task in tasks:
            when = [at for one in found if (at := one[share].get(task)) is not None]
            reached.setdefault(share, {})[task] = {"seeds": len(when), "median": median(when) if when else None}
    return reached


def _when(reached: dict[str, Any] | None, variant: dict[str, Any]) -> str:
    if not reached or not reached["seeds"]:
        return "-" if reached is None else "never"
    few = f" ({reached['seeds']} of {len(variant['seeds'])})" if reached["seeds"] < len(variant["seeds"]) else ""
    return f"{reached['median']:,.0f}{few}"


def _lowest(runs: Sequence[dict[str, Any]], task: str) -> float | None:
    """Of all seeds; None where no run was long enough to tell."""
    return min((low for run in runs if (low := run["lowest_last_third"].get(task)) is not None), default=None)


def _sensitivity(task: str, asked: Sequence[dict[str, Any]]) -> dict[str, float]:
    """The AUC of the worst seed, and the mean of its control; where goals were held out, either kind's apart."""
    rows = [found[task] for found in asked]
    told = {"auc": min(row["auc"] for row in rows), "shuffled": fmean(row["shuffled"] for row in rows)}
    for group in ("trained_goals", "held_out_goals"):
        if all(group in row for row in rows):
            told[group] = min(row[group]["auc"] for row in rows)
    return {name: round(value, 4) for name, value in told.items()}


def _auc(told: dict[str, float]) -> str:
    never_seen = f", never seen {told['held_out_goals']:.3f}" if "held_out_goals" in told else ""
    return f"{told.get('trained_goals', told['auc']):.3f}{never_seen} (shuffled {told['shuffled']:.2f})"


def _cell(row: dict[str, Any]) -> str:
    worst = f", worst {100 * row['worst_seed']:.1f}" if row["worst_seed"] < row["success"] else ""
    return f"{100 * row['success']:.1f} ({100 * row['low']:.1f} - {100 * row['high']:.1f}{worst})"
