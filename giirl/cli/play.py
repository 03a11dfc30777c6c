"""`giirl play`: a trained policy does a task."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import click

from giirl.cli.options import JSON, RUN, SEED, save_json
from giirl.run.worlds import open_web_run, world_of
from giirl_core.algorithms import ALGORITHMS
from giirl_core.progress import Display, visible


@click.command()
@RUN
@click.option("--task", required=True, help="A MiniWoB task or a task file, also one that the run did not train on.")
@click.option("--goal", help="Another instruction.  [default: the page's own]")
@click.option("--show", is_flag=True, help="Play in a window, slowly enough to watch.")
@click.option(
    "--min-confidence",
    default=0.0,
    show_default=True,
    type=click.FloatRange(0.0, 1.0),
    help="Stop before an action that the policy chooses with a lower probability.",
)
@SEED
@JSON
def play(
    run: Path, task: str, goal: str | None, show: bool, min_confidence: float, seed: int, json_file: Path | None
) -> None:
    """Let the policy of a run do one task: each action, with the learned reward of the best candidates.

    Under --goal the agent follows that sentence on the page as it begins, and the page's verdict is not asked for. With
    --min-confidence an uncertain choice is not done, and the exit status is 1.
    """
    from actors.browser import measured_tasks, open_browser
    from browser_farm.chrome.launcher import check_screen
    from giirl.report.play import PAUSE_S, Play, candidates_table
    from giirl.run.api import load_policy, load_reward
    from giirl_core.metrics import Metrics
    from giirl_core.types import EpisodeSpec, Goal, Purpose, page_seed

    _, config = open_web_run(run, f"tasks={[task]!r}")
    world_of(config).check(config)
    asked = Goal(goal) if goal is not None else None
    spec = EpisodeSpec(task=task, seed=page_seed(Purpose.INSPECT, seed, 0))
    if show:
        check_screen()
    agent = load_policy(run)
    reward = load_reward(run) if ALGORITHMS[config.algorithm].has_learned_reward else None
    with closing(open_browser(config, Metrics(), tabs=1, headless=not show)) as browser:
        played = Play(
            browser,
            agent,
            reward,
            spec,
            config.step_limit,
            goal=asked,
            least=min_confidence,
            pause_s=PAUSE_S if show else 0.0,
            is_measured=bool(measured_tasks(config)),
        )
        try:
            for number, step in enumerate(played.steps(), start=1):
                if number == 1:
                    click.echo(visible(played.instruction))
                click.echo(visible(f"step {number}: {step.chosen.description}"))
                Display().table(candidates_table(step))
        finally:
            save_json(json_file, played.summary())
    click.echo(played.verdict)
