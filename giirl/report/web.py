"""The report sections of a run on web pages."""

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
from giirl.statistics import WINDOW, missing_pages, percent
from giirl_core.algorithms import ALGORITHMS
from giirl_core.config import Config
from giirl_core.metrics import Metrics
from giirl_core.progress import Display


class WebReport:
    """Success rates by task, their training curves, and episodes as film strips."""

    def subject(self, config: Config) -> str:
        if config.browser == "fake":
            return f"{len(config.tasks)} tasks of the fake browser (not a benchmark result)"
        return f"{len(config.tasks)} MiniWoB tasks"

    def facts(self, config: Config) -> dict[str, str]:
        return {"browser": config.browser, "runtime": config.runtime, "demonstration source": config.demos.source}

    def result_lines(self, result: Result) -> list[str]:
        """No text: the tables contain the whole result."""
        return []

    def result_tables(self, result: Result) -> list[TableView]:
        """The evaluation result, compared with the random baseline and with the thesis (Luo 2019)."""
        rows = tuple(
            (
                task,
                percent(own["random"]),
                percent(own["success"]),
                f"{100 * own['low']:.1f}-{100 * own['high']:.1f}",
                str(own["episodes"]),
                f"{100 * THESIS[task]:.0f}" if task in THESIS else "-",
            )
            for task, own in result["tasks"].items()
        )
        tables = [_by_goal(result)] if any("held_out_goals" in own for own in result["tasks"].values()) else []
        head = ("task", "random baseline", "success rate", "95 % interval", "pages", "Luo (2019)")
        caption = f"Success rate of the greedy policy on fresh pages, %. {missing_pages(result['tasks'])}".rstrip(". ")
        return [TableView(caption=caption, head=head, rows=rows), *tables]

    def success_group(
        self, config: Config, points: Points, result: Result | None, demonstrations: Mapping[str, int]
    ) -> Group:
        """The true success rate during training by task."""
        steps = [point["env_steps"] for point in points]
        rows = result["tasks"] if result is not None else {}
        random = {task: own["random"] for task, own in rows.items() if own["random"] is not None}
        charts = [
            draw_chart(
                task,
                [Line(name="success rate", x=steps, y=_moving([point["outcomes"].get(task, []) for point in points]))],
                levels=[Level(name="random baseline", y=random[task])] if task in random else [],
                unit="%",
            )
            for task in config.tasks
        ]
        words = (
            f"Success rate of the last {WINDOW} training episodes of each task, in %, as reported by the page, "
            "against environment steps. The policy explores during training and never sees these numbers."
        )
        tables = (_outcomes(config, points, result, demonstrations),)
        return Group(title="Success rate during training", words=words, charts=tuple(charts), tables=tables)

    def strips(
        self, folder: RunFolder, config: Config, pages: int, display: Display
    ) -> tuple[dict[str, list[EpisodeView]], str]:
        """Episodes by task, with a description, or with the reason why there are none."""
        try:
            checkpoint = folder.latest_checkpoint()
        except ValueError as error:
            return {}, f"No episodes: {error}."
        strips: dict[str, list[EpisodeView]] = {task: [] for task in config.tasks}
        with (
            Inspector(config, *weights_of(folder, config, checkpoint), Metrics()) as inspector,
            display.job("playing episodes for the report", pages * len(config.tasks)) as job,
        ):
            for task in config.tasks:
                for strip in inspector.strips(task, pages):
                    strips[task].append(strip)
                    job.advance()
        words = [
            f"The greedy policy of {checkpoint.name} on the first pages reserved for reports, {pages} per task. These "
            "pages are not used for training, demonstrations, evaluation or tuning, and none is left out. Each step is "
            "also shown under a swapped instruction (goal swap), which names another element of the page. Where no "
            "other element fits, it is the instruction of another page of the task. The tasks with the lowest success "
            "come first. A failed episode says whether the reward knew better."
        ]
        if config.browser == "fake":
            words.append("The fake browser has no screenshots: elements are drawn as boxes.")
        if not ALGORITHMS[config.algorithm].has_learned_reward:
            words.append(no_reward(config))
        return strips, " ".join(words)

    def maps(self, folder: RunFolder, config: Config) -> Maps | None:
        """No heat maps: web pages have no grid."""
        return None


def _by_goal(result: Result) -> TableView:
    """Success rates under training goals and under goals that were held out of training."""
    rows = tuple(
        (task, *(f"{100 * own[goals]['success']:.1f}" for goals in ("trained_goals", "held_out_goals")))
        for task, own in result["tasks"].items()
        if "held_out_goals" in own
    )
    head = ("task", "training goals", "held-out goals")
    return TableView(caption="Success rate by goals, %", head=head, rows=rows)


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
        "success rate, %",
        f"first {WINDOW}, %",
        f"last {WINDOW}, %",
        "lowest, %",
    )
    caption = f"Success rate in training. Lowest: over any {WINDOW} consecutive episodes in the last third of the run"
    return TableView(caption=caption, head=head, rows=tuple(rows))


def _moving(outcomes: Sequence[Sequence[int]]) -> list[float]:
    """The mean of the last WINDOW outcomes after each iteration; nan before the first outcome."""
    recent = deque[int](maxlen=WINDOW)
    means = []
    for fresh in outcomes:
        recent.extend(fresh)
        means.append(sum(recent) / len(recent) if recent else float("nan"))
    return means


def _share(outcomes: Sequence[int]) -> str:
    return f"{100 * sum(outcomes) / len(outcomes):.0f}" if outcomes else "-"
