"""`giirl feedback`: a person judges and corrects episodes of a run; and the study of what that is worth."""

from __future__ import annotations

from pathlib import Path

import click

from giirl.cli.options import JSON, RUN, save_and_show, seeds
from giirl_core.files import folder_lock
from giirl_core.progress import Display


@click.command()
@RUN
@click.option("--port", default=0, show_default="any free port", type=click.IntRange(0, 65535), help="On loopback.")
def feedback(run: Path, port: int) -> None:
    """Serve a page on which you judge and correct episodes of the policy, until Ctrl-C.

    A run under way learns from the answers at once, another one when it is resumed.
    """
    from giirl.feedback.session import give_feedback, how_to_learn, open_feedback_run

    folder, config = open_feedback_run(run)
    display = Display()

    def on_ready(address: str) -> None:
        click.echo(address)
        display.say("open this address in a browser on this machine; Ctrl-C ends the page")

    answers = give_feedback(folder, config, port, on_ready)
    display.say(f"answers in {folder.feedback}: {answers}; {how_to_learn(folder, config)}")


@click.command(name="feedback")
@seeds(3)
@click.option("--set", "changes", multiple=True, metavar="KEY=VALUE", help="For all runs; may be given again.")
@JSON
def feedback_study(seeds: int, changes: tuple[str, ...], json_file: Path | None) -> None:
    """Success against answers of a simulated person, beside as many demonstrations. Real Chrome, 15 minutes a seed."""
    from giirl.studies.feedback import feedback_study, feedback_table

    root = Path("runs/studies")
    root.mkdir(parents=True, exist_ok=True)
    with folder_lock(root):
        result = feedback_study(range(seeds), root, changes, Display())
    save_and_show(json_file, result, feedback_table(result))
