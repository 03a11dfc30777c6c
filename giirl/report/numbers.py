"""The facts, result tables and training curves of a run for its report."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from giirl.report.charts import Chart, Level, Line, draw_chart
from giirl.statistics import WINDOW
from giirl_core.config import Config

ACCURACY = "d_accuracy_"
SOURCES = {
    "expert": "expert steps",
    "rollouts": "new rollouts",
    "replay": "replayed rollouts",
    "policy_on_expert_states": "policy actions in expert states",
    "random_actions": "random actions",
    "wrong_goal": "expert steps, wrong instruction",
}
TITLES = {
    "d_loss": "Discriminator loss, nats",
    "d_penalty": "Gradient penalty",
    "p_loss": "Policy loss",
    "p_entropy": "Policy entropy, nats",
    "p_distance": "Cross-entropy to soft optimum, nats",
    "p_value_error": "Squared value error",
    "p_reward": "Learned reward of the rollouts",
    "p_ratio": "Importance ratio",
}
COUNTS = frozenset({"step", "env_steps", "episodes", "seconds"})

Points = Sequence[Mapping[str, Any]]
Result = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class TableView:
    """A table of text; the first column is the row header, the other columns are numbers."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """A section of the report: a title, a description, charts and tables."""

    title: str
    words: str
    charts: tuple[Chart, ...]
    tables: tuple[TableView, ...] = ()


def lead_of(config: Config, points: Points, result: Result | None) -> str:
    """A one-sentence summary of the run."""
    what = "GIIRL" if config.algorithm == "giirl" else config.algorithm.replace("_", " ").capitalize()
    where = f"{len(config.tasks)} MiniWoB tasks" if config.world == "miniwob" else "LanguageGridCraft"
    if config.world == "miniwob" and config.browser == "fake":
        where = f"{len(config.tasks)} tasks of the fake browser (not a benchmark result)"
    step = points[-1]["step"] if points else 0
    if result is not None:
        return f"{what} on {where}: finished after {step} iterations."
    return f"{what} on {where}: unfinished, after {step} of {config.iterations} iterations."


def facts_of(config: Config, points: Points, result: Result | None, demonstrations: int | None) -> dict[str, str]:
    """The key facts of the run, by name. Unknown facts are left out."""
    last = points[-1] if points else {}
    result = result or {}
    facts = {
        "algorithm": config.algorithm,
        "seed": str(config.seed),
        "iterations": f"{last.get('step', 0)} of {config.iterations}",
        "demonstrations": _count(demonstrations),
        "environment steps": _count(result.get("env_steps", last.get("env_steps"))),
        "training episodes": _count(result.get("training_episodes", last.get("episodes"))),
        "run time, seconds": _count(result.get("seconds", last.get("seconds"))),
        "SHA-256 of the networks": str(result.get("parameters_sha256", ""))[:12],
    }
    if config.world == "miniwob":
        facts |= {"browser": config.browser, "runtime": config.runtime, "demonstration source": config.demos.source}
    return {name: value for name, value in facts.items() if value}


def result_tables(config: Config, result: Result | None, thesis: Mapping[str, float]) -> list[TableView]:
    """The evaluation result, compared with the random baseline and with the success rates of the thesis (Luo 2019)."""
    if result is None:
        return []
    if config.world == "gridcraft":
        return [_returns(result)]
    rows = tuple(
        (
            task,
            f"{100 * own['random']:.1f}",
            f"{100 * own['success']:.1f}",
            f"{100 * own['low']:.1f}-{100 * own['high']:.1f}",
            str(own["episodes"]),
            f"{100 * thesis[task]:.0f}" if task in thesis else "-",
        )
        for task, own in result["tasks"].items()
    )
    tables = [_by_goal(result)] if any("held_out_goals" in own for own in result["tasks"].values()) else []
    head = ("task", "random baseline", "success rate", "95 % interval", "pages", "Luo (2019)")
    return [TableView(caption="Success rate of the greedy policy on fresh pages, %", head=head, rows=rows), *tables]


def _by_goal(result: Result) -> TableView:
    """Success rates under training goals and under goals that were held out of training."""
    rows = tuple(
        (task, *(f"{100 * own[goals]['success']:.1f}" for goals in ("trained_goals", "held_out_goals")))
        for task, own in result["tasks"].items()
        if "held_out_goals" in own
    )
    head = ("task", "training goals", "held-out goals")
    return TableView(caption="Success rate by goals, %", head=head, rows=rows)


def _returns(result: Result) -> TableView:
    rows = tuple(
        (goal, f"{own['return_over_optimal']:.3f}", f"{own['reoptimised_over_optimal']:.3f}")
        for goal, own in result["goals"].items()
    )
    head = ("instruction", "learned policy", "re-optimised policy")
    return TableView(
        caption="Return: 1 optimal, 0 random. Re-optimised: by planning on the learned reward", head=head, rows=rows
    )


def result_lines(config: Config, result: Result | None) -> list[str]:
    """Sentences above the result tables."""
    if result is None:
        return ["The run is not finished, so it has no evaluation result."]
    if config.world == "gridcraft":
        avoid = result["avoid"]
        return [
            f"Learned reward: correlation with the optimal value {result['spearman']:.2f} (Spearman) and "
            f"{result['pearson']:.2f} (Pearson), EPIC distance to the true reward {result['epic']:.2f}. The policy "
            f"re-optimised on it enters the avoided colour in {100 * avoid['entered']:.1f} % of episodes; the expert "
            f"in {100 * avoid['expert_entered']:.1f} %."
        ]
    return []


def success_group(config: Config, points: Points, result: Result | None, demonstrations: Mapping[str, int]) -> Group:
    """The true success rate during training by task; for grids the return by instruction."""
    steps = [point["env_steps"] for point in points]
    if config.world == "gridcraft":
        goals = list(points[0]["returns"])
        charts = [draw_chart(g, [Line(name="return", x=steps, y=[p["returns"][g] for p in points])]) for g in goals]
        words = "Normalised return (1 optimal, 0 random) of the exploring policy, against environment steps."
        return Group(title="Return during training", words=words, charts=tuple(charts))
    random = {task: own["random"] for task, own in result["tasks"].items()} if result is not None else {}
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
    return Group(
        title="Success rate during training",
        words=words,
        charts=tuple(charts),
        tables=(_outcomes(config, points, result, demonstrations),),
    )


def learning_group(points: Points) -> Group:
    """Statistics of the updates: discriminator accuracy by source, then every other number that varies."""
    steps = [point["env_steps"] for point in points]
    names = [name for name in points[-1] if name not in COUNTS and isinstance(points[-1][name], int | float)]
    curves = {name: [float(point.get(name, float("nan"))) for point in points] for name in names}
    sources = {name.removeprefix(ACCURACY): curves.pop(name) for name in names if name.startswith(ACCURACY)}
    charts = []
    if sources:
        lines = [Line(name=SOURCES.get(name, _plain(name)), x=steps, y=_smooth(y)) for name, y in sources.items()]
        charts.append(draw_chart("Discriminator accuracy by source, %", lines, unit="%"))
    charts += [
        draw_chart(TITLES.get(name, _plain(name)), [Line(name=_plain(name), x=steps, y=y)])
        for name, y in curves.items()
        if min(y) != max(y)
    ]
    return Group(title="Training statistics", words="Plotted against environment steps.", charts=tuple(charts))


def _outcomes(config: Config, points: Points, result: Result | None, demonstrations: Mapping[str, int]) -> TableView:
    lowest = (result or {}).get("lowest_last_third", {})
    rows = []
    for task in config.tasks:
        played = [won for point in points for won in point["outcomes"].get(task, [])]
        rows.append(
            (
                task,
                _count(demonstrations.get(task)),
                _count(len(played)),
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


def _smooth(values: Sequence[float]) -> list[float]:
    """Moving average over a twentieth of the points, because single batches are noisy."""
    width = max(1, len(values) // 20)
    return [sum(values[max(0, i + 1 - width) : i + 1]) / min(width, i + 1) for i in range(len(values))]


def _share(outcomes: Sequence[int]) -> str:
    return f"{100 * sum(outcomes) / len(outcomes):.0f}" if outcomes else "-"


def _count(number: float | None) -> str:
    return "" if number is None else f"{number:,.0f}"


def _plain(name: str) -> str:
    return name.replace("_", " ")
