"""`giirl reward`: the learned reward on its own."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from giirl.cli.options import JSON, RUN, OutputFile, Place, save_and_show, save_json
from giirl.cli.report import say_written
from giirl.run.folder import RunFolder
from giirl.run.worlds import open_web_run, world_of
from giirl_core.config import Config
from giirl_core.config_file import changed, differences
from giirl_core.files import writable
from giirl_core.progress import Display
from giirl_core.telemetry.version import commit


@click.group()
def reward() -> None:
    """The learned reward on its own."""


@reward.command()
@RUN
@click.option("--task", default="click-button", show_default=True, help="A task whose goal quotes a button.")
@click.option("--pages", default=500, show_default=True, type=click.IntRange(1), help="Number of fresh pages.")
@JSON
def goal_swap(run: Path, task: str, pages: int, json_file: Path | None) -> None:
    """Whether the reward follows the goal.

    How often it ranks the button in the goal first, and how often the other button after the goal names that one.
    """
    from giirl.analysis.goal_swap import goal_swap
    from giirl.run.train import reward_of_run
    from giirl_core.metrics import Metrics

    _, config = _open_for_task(run, task)
    result = goal_swap(config, reward_of_run(run), task, pages, Metrics(), Display())
    save_json(json_file, result)
    Display().say(
        f"{task}, {pages} fresh pages: own goal first {100 * result['own_goal_top1']:.1f} %, "
        f"after swapping the goal {100 * result['swapped_goal_top1']:.1f} %"
    )


@reward.command()
@RUN
@click.option("--pages", default=200, show_default=True, type=click.IntRange(2), help="Fresh pages per task.")
@JSON
def sensitivity(run: Path, pages: int, json_file: Path | None) -> None:
    """Whether the reward prefers an expert's own goal to the goal of another page.

    An AUC per task; 0.5 means that the reward does not depend on the goal.
    """
    from giirl.analysis.goal_sensitivity import sensitivity
    from giirl.run.train import reward_of_run
    from giirl_core.metrics import Metrics

    _, config = open_web_run(run)
    found = sensitivity(config, reward_of_run(run), pages, Metrics(), Display())
    save_json(json_file, {"tasks": found})
    for task, row in found.items():
        Display().say(f"{task}: AUC {row['auc']:.3f}, shuffled {row['shuffled']:.3f}, {row['pairs']} expert steps")


@reward.command()
@RUN
@click.option("--pages", default=25, show_default=True, type=click.IntRange(2), help="Fresh pages per task.")
@click.option("--attempts", default=8, show_default=True, type=click.IntRange(1), help="Of the policy at each page.")
@click.option("--policy", "player", type=Place(), help="The run whose policy plays.  [default: RUN]")
@JSON
def measure(run: Path, pages: int, attempts: int, player: Path | None, json_file: Path | None) -> None:
    """How well the reward judges episodes and steps of a policy, and what choosing by it is worth.

    Precision, recall and negative predictive value against the page's verdict; best of five actions; the attempt that
    the reward prefers, beside the greedy policy. A policy that is done makes few mistakes: --policy takes another.
    """
    from giirl.analysis.reward_quality import quality_table, reward_quality
    from giirl.run.train import reward_of_run
    from giirl_core.metrics import Metrics

    _, config = open_web_run(run)
    folder, other = open_web_run(player or run)
    if unlike := [key for key in differences(config, other) if key.startswith("net.")]:
        raise ValueError(f"{player} has another net than {run}: wanted a policy with the same {', '.join(unlike)}")
    policy, weights = folder.weights(folder.latest_checkpoint(), "policy"), reward_of_run(run)
    found = reward_quality(config, weights, policy, pages, attempts, Metrics(), Display())
    found["settings"] |= {
        "commit": commit(),
        "reward": {"run": str(run), "version": weights.version, "settings": changed(config)},
        "policy": {"run": str(player or run), "version": policy.version, "settings": changed(other)},
    }
    save_and_show(json_file, found, quality_table(found))


@reward.command()
@RUN
@click.option("--task", required=True, help="Any task, also one that the run did not train on.")
@click.option("--seed", required=True, type=click.IntRange(0), help="Seed of the page; reports show it.")
@click.option("--goal", help="Another instruction for the page.  [default: its own with another element's name]")
@click.option("--out", type=OutputFile(), help="The HTML file to write.  [default: RUN/TASK-SEED.html]")
def inspect(run: Path, task: str, seed: int, goal: str | None, out: Path | None) -> None:
    """Draw one page with the learned reward of every element, under its own instruction and under another."""
    from giirl.report.build import inspect
    from giirl_core.types import EpisodeSpec, Goal

    folder, config = _open_for_task(run, task)
    out = out or writable(folder.path / f"{task.replace('/', '-')}-{seed}.html")
    words = ["giirl", "reward", "inspect", str(run), "--task", task, "--seed", str(seed)]
    command = shlex.join([*words, *(["--goal", goal] if goal is not None else [])])
    other = Goal(goal) if goal is not None else None
    inspect(folder, config, EpisodeSpec(task=task, seed=seed), other, out, command)
    say_written(out)


@reward.command()
@RUN
@click.argument("file", type=Place())
@JSON
def score(run: Path, file: Path, json_file: Path | None) -> None:
    """Score every step of the episodes in a demonstration file."""
    from giirl.analysis.scores import score_file, score_table
    from giirl.run.train import reward_of_run

    _, config = open_web_run(run)
    scored = score_file(config, reward_of_run(run), file)
    save_and_show(json_file, scored, score_table(scored))
    if scored["left_out"]:
        raise ValueError(f"{file}: {len(scored['left_out'])} have no score, the first is {scored['left_out'][0]}")


@reward.command()
@RUN
@click.argument("file", type=OutputFile())
def export(run: Path, file: Path) -> None:
    """Write the reward to one safetensors FILE, from which `giirl.LearnedReward` scores without the run."""
    from giirl.run.train import reward_of_run
    from giirl_core.nets.reward import export_reward

    _, config = open_web_run(run)
    weights = reward_of_run(run)
    export_reward(config, weights, file)
    Display().say(f"{file}, {file.stat().st_size / 1e6:.1f} MB: the reward of {run}, version {weights.version}")


@reward.command()
@RUN
@click.option("--http", is_flag=True, help="As a JSON API; RUN may then be an exported file.")
@click.option("--host", default="127.0.0.1", show_default=True, help="With --http: the address to listen on.")
@click.option("--port", default=0, show_default="any free port", type=click.IntRange(0, 65535), help="The port.")
@click.option(
    "--token-file", type=Place(), help="With --http: a file with the token that clients send; needed beyond loopback."
)
def serve(run: Path, http: bool, host: str, port: int, token_file: Path | None) -> None:
    """Serve the reward on a loopback port until Ctrl-C, for `giirl_core.wire.score_client.ScoreClient`.

    With --http it is served as a JSON API, whose page /docs describes it.
    """
    from giirl.analysis.scores import serve_reward, serve_reward_over_http
    from giirl.run.api import LearnedReward
    from giirl.run.train import reward_of_run

    def on_ready(address: str) -> None:
        click.echo(address)
        Display().say(f"serving the reward of {run}, version {version}; Ctrl-C stops the service")

    if http:
        token = token_file.read_bytes().decode("ascii", "replace").strip() if token_file is not None else ""
        learned = LearnedReward(run)
        version = learned.version
        serve_reward_over_http(learned.model, host, port, token, on_ready)
        return
    if token_file is not None or host != "127.0.0.1":
        raise ValueError("--host and --token-file are for --http: the socket listens on loopback only")
    _, config = open_web_run(run)
    weights = reward_of_run(run)
    version = weights.version
    serve_reward(config, weights, port, on_ready)


def _open_for_task(run: Path, task: str) -> tuple[RunFolder, Config]:
    """A run on web pages, with `task` as the only task of its config."""
    folder, config = open_web_run(run, f'tasks=["{task}"]')
    world_of(config).check(config)
    return folder, config
