"""The `giirl reproduce` commands of the web chapter: each study is one command with one JSON and one table."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import click

from giirl.cli.options import DEMOS, JSON, OutputFolder, save_and_show, seeds
from giirl.studies.runner import Variant
from giirl.studies.web import STUDIES, Study, base_settings
from giirl_core.files import explain, folder_lock, writable
from giirl_core.progress import Display

ROOT = Path("runs/studies")
TUNING_SEEDS = 100  # settings are chosen on seeds from here on, results are reported on those below


def commands() -> list[click.Command]:
    """One for each web study, and `all`."""
    return [*(_command(name, study) for name, study in STUDIES.items()), reproduce_all]


@click.command("all")
@DEMOS
@click.option("--seeds", type=click.IntRange(1), default=5, show_default=True, help="Seeds of each web study.")
@click.option("--out", type=OutputFolder(), default=Path("runs/reproduced"), show_default=True)
@click.pass_context
def reproduce_all(context: click.Context, demos: Path | None, seeds: int, out: Path) -> None:
    """Every figure, table and study, each with a JSON of its own, in about a day.

    The same command resumes where it stopped: a study with a JSON in the folder is skipped.
    """
    group = context.parent.command if context.parent else None
    assert isinstance(group, click.Group)
    failed: list[str] = []
    for name, command in group.commands.items():
        file = out / f"{name}.json"
        if command is context.command or file.exists():
            continue
        out.mkdir(parents=True, exist_ok=True)
        Display().say(f"{name}: {file}")
        given = {"demos": demos, "seeds": seeds} if name in STUDIES else {"out": out}
        known = {parameter.name for parameter in command.params}
        try:
            context.invoke(command, json_file=file, **{key: value for key, value in given.items() if key in known})
        except (ValueError, RuntimeError, OSError) as error:  # the other studies do not depend on this one
            failed.append(f"{name}: {explain(error)}")
    if failed:
        raise RuntimeError(f"{len(failed)} studies failed, the first is {failed[0]}; the same command tries again")


def _command(name: str, study: Study) -> click.Command:
    @click.command(
        name,
        help=f"{study.title}. Real Chrome; a run takes minutes, one of many tasks up to three quarters of an hour.",
        epilog=f"Variants: {', '.join(repr(variant.name) for variant in study.variants)}.",
    )
    @DEMOS
    @seeds(1)
    @click.option(
        "--first-seed",
        type=click.IntRange(0),
        default=TUNING_SEEDS if study.tuning else 0,
        show_default=True,
        help=f"Seeds from {TUNING_SEEDS} on are for tuning, those below for reported results.",
    )
    @click.option("--jobs", type=click.IntRange(1), default=2, show_default=True, help="Runs at the same time.")
    @click.option("--set", "changes", multiple=True, metavar="KEY=VALUE", help="For all runs; may be given again.")
    @click.option("--variant", "variants", multiple=True, help="Only this part of the study; may be given again.")
    @JSON
    def command(
        demos: Path | None,
        seeds: int,
        first_seed: int,
        jobs: int,
        changes: tuple[str, ...],
        variants: tuple[str, ...],
        json_file: Path | None,
    ) -> None:
        _reproduce(
            name, study, study.only(variants), demos, range(first_seed, first_seed + seeds), jobs, changes, json_file
        )

    return command


def _reproduce(
    name: str,
    study: Study,
    variants: Sequence[Variant],
    demos: Path | None,
    seeds: Sequence[int],
    jobs: int,
    changes: Sequence[str],
    json_file: Path | None,
) -> None:
    """Run what is missing of these variants of a study, then write and print their result.

    Several runs use the serial runtime, one process each. The run of a study that has only one uses `local`.
    """
    from giirl.studies.fifty_two import PUBLISHED, TASKS, fifty_two
    from giirl.studies.runner import evaluate_rewards, measure_transfer, plan, run_all
    from giirl.studies.summary import record, summary
    from giirl.studies.table import study_table, task_table

    _check_seeds(name, study, seeds)
    display, since_s = Display(), time.monotonic()
    alone = len(seeds) * len(study.variants) == 1
    base = (*base_settings(study, demos), f"runtime={'local' if alone else 'serial'}", *changes)
    runs = plan(base, variants, seeds, ROOT)
    ROOT.mkdir(parents=True, exist_ok=True)
    json_path = json_file or ROOT / f"{name}.json"
    picture = json_path.with_name(f"{json_path.name.removesuffix('.json')}.png")
    figure = writable(picture) if study.curves else None
    with folder_lock(ROOT):
        run_all(runs, jobs=jobs, display=display)
        if study.evaluates_reward:
            evaluate_rewards(runs, display)
        measure_transfer(runs, display)
    records = [record(run, evaluates_reward=study.evaluates_reward) for run in runs]
    result = summary(name, records, left_out=[variant.name for variant in study.variants if variant not in variants])
    if alone:
        result["wall_seconds"] = round(time.monotonic() - since_s, 1)
    if study.compared is not None and set(study.compared) <= set(variants):
        result = {**result, **fifty_two(result, *(variant.name for variant in study.compared))}
        table = task_table(study.title, TASKS, result, PUBLISHED)
    else:
        table = study_table(study.title, result)
    save_and_show(json_file, result, table)
    if figure is not None:
        from giirl.figures import draw_successes

        draw_successes(figure, result["runs"])
        display.say(f"figure: {figure}")


def _check_seeds(name: str, study: Study, seeds: Sequence[int]) -> None:
    """UsageError for seeds that would mix tuning and reported results."""
    first, last = seeds[0], seeds[-1]
    if study.tuning and first < TUNING_SEEDS:
        raise click.UsageError(
            f"seed {first} is for reported results and {name} is a tuning study: wanted seeds from {TUNING_SEEDS} on"
        )
    if first < TUNING_SEEDS <= last:
        raise click.UsageError(
            f"seeds {first} to {last} are partly for reported results and partly for tuning: "
            f"wanted all below {TUNING_SEEDS}, or none"
        )
