"""What the report says about a run on web pages."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence

from giirl.report.charts import Level, Line, draw_chart
from giirl.report.element_rewards import EpisodeView
from giirl.report.heatmap import Maps
from giirl.report.inspector import Inspector
from giirl.report.numbers import Group, Points, Result, TableView, count, no_reward, weights_of
from giirl.run.evaluate import THESIS
from giirl.run.folder import RunFolder
from giirl.statistics import WINDOW
from giirl_core.algorithms import ALGORITHMS
from giirl_core.config import Config
from giirl_core.metrics import Metrics
from giirl_core.progress import Display
from learner.checkpoint import latest_checkpoint


class WebReport:
    """Success by task, its curves, and episodes as film strips."""

    def subject(self, config: Config) -> str:
        if config.browser == "fake":
            return f"{len(config.tasks)} tasks of the fake browser, which are no result"
        return f"{len(config.tasks)} MiniWoB tasks"

    def facts(self, config: Config) -> dict[str, str]:
        return {"browser": config.browser, "runtime": config.runtime, "demonstrations from": config.demos.source}

    def result_lines(self, result: Result) -> list[str]:
        """Nothing: the table has all of it."""
        return []

    def result_tables(self, result: Result) -> list[TableView]:
        """Success beside the random baseline and the thesis; a second table if goals were held out of training."""
        rows = tuple(
            (
                task,
                f"{100 * own['random']:.1f}",
                f"{100 * own['success']:.1f}",
                f"{100 * own['low']:.1f}-{100 * own['high']:.1f}",
                str(own["episodes"]),
                f"{100 * THESIS[task]:.0f}" if task in THESIS else "-",
            )
            for task, own in result["tasks"].items()
        )
        tables = [_by_goal(result)] if any("held_out_goals" in own for own in result["tasks"].values()) else []
        head = ("task", "random", "success", "95 % interval", "pages", "thesis")
        return [TableView(caption="Greedy policy on fresh pages, % that succeed", head=head, rows=rows), *tables]

    def success_group(
        self, config: Config, points: Points, result: Result | None, demonstrations: Mapping[str, int]
    ) -> Group:
        """Success while training, by the page's own reward, for each task."""
        steps = [point["env_steps"] for point in points]
        random = {task: own["random"] for task, own in result["tasks"].items()} if result is not None else {}
        charts = [
            draw_chart(
                task,
                [Line(name="success", x=steps, y=_moving([point["outcomes"].get(task, []) for point in points]))],
                levels=[Level(name="random", y=random[task])] if task in random else [],
                unit="%",
            )
            for task in config.tasks
        ]
        words = (
            f"Share of the last {WINDOW} training episodes of a task that succeeded by the page's own reward, in %, "
            "against environment steps. The policy explores here, and never sees these numbers."
        )
        tables = (_outcomes(config, points, result, demonstrations),)
        return Group(title="Success while training", words=words, charts=tuple(charts), tables=tables)

    def strips(
        self, folder: RunFolder, config: Config, pages: int, display: Display
    ) -> tuple[dict[str, list[EpisodeView]], str]:
        """Episodes by task, and a text about them, or about why there are none."""
        try:
            checkpoint = latest_checkpoint(folder.checkpoints)
        except ValueError as error:
            return {}, f"None: {error}."
        strips: dict[str, list[EpisodeView]] = {task: [] for task in config.tasks}
        with (
            Inspector(config, *weights_of(folder, config, checkpoint), Metrics()) as inspector,
            display.job("playing for the report", pages * len(config.tasks)) as job,
        ):
            for task in config.tasks:
                for strip in inspector.strips(task, pages):
                    strips[task].append(strip)
                    job.advance()
        words = [
            f"The greedy policy of {checkpoint.name} on the first {pages} pages of each task that are reserved for "
            "inspection: training, demonstrations, evaluation and tuning never use their seeds, and none was left out. "
            "Each step also shows the same page under another instruction: one that names another element of the page, "
            "or, if no other element fits, the instruction of another page of the task."
        ]
        if config.browser == "fake":
            words.append("The fake browser draws no screenshots: its elements are shown as boxes.")
        if not ALGORITHMS[config.algorithm].has_learned_reward:
            words.append(no_reward(config))
        return strips, " ".join(words)

    def maps(self, folder: RunFolder, config: Config) -> Maps | None:
        """Nothing: pages are no map."""
        return None


def _by_goal(result: Result) -> TableView:
    """Success under the goals of the training, and under those held out of it."""
    rows = tuple(
        (task, *(f"{100 * own[goals]['success']:.1f}" for goals in ("trained_goals", "held_out_goals")))
        for task, own in result["tasks"].items()
        if "held_out_goals" in own
    )
    head = ("task", "goals of the training", "goals held out")
    return TableView(caption="The same by instruction, % that succeed", head=head, rows=rows)


def _outcomes(config: Config, points: Points, result: Result | None, demonstrations: Mapping[str, int]) -> TableView:
    lowest = (result or {}).get("lowest_last_third", {})
    rows = []
    for task in config.tasks:
        played = [won for point in points for won in point["outcomes"].get(task, [])]
        rows.append(
            (
                task,
                count(demonstrations.get(task)),
                count(len(played)),
                _share(played),
                _share(played[:WINDOW]),
                _share(played[-WINDOW:]),
                "-" if lowest.get(task) is None else f"{100 * lowest[task]:.0f}",
            )
        )
    head = (
        "task",
        "demonstrations",
        "episodes",
        "succeeded, %",
        f"first {WINDOW}",
        f"last {WINDOW}",
        "lowest, last third",
    )
    caption = f"Training episodes by outcome; the lowest is of {WINDOW} in a row in the last third of the run"
    return TableView(caption=caption, head=head, rows=tuple(rows))


def _moving(outcomes: Sequence[Sequence[int]]) -> list[float]:
    """After each iteration the mean of the last WINDOW outcomes; nan before the first."""
    recent = deque[int](maxlen=WINDOW)
    means = []
    for fresh in outcomes:
        recent.extend(fresh)
        means.append(sum(recent) / len(recent) if recent else float("nan"))
    return means


def _share(outcomes: Sequence[int]) -> str:
    return f"{100 * sum(outcomes) / len(outcomes):.0f}" if outcomes else "-"
