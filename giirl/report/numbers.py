"""The numbers of a run for its report: what it was, what came out, and the curves on the way there."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from giirl.report.charts import Chart, Level, Line, draw_chart
from giirl.statistics import WINDOW
from giirl_core.algorithms import ALGORITHMS
from giirl_core.config import Config

ACCURACY = "d_accuracy_"
SOURCES = {
    "expert": "the expert's steps",
    "rollouts": "new rollouts",
    "replay": "older rollouts",
    "policy_on_expert_states": "the policy on the expert's pages",
    "random_actions": "random actions",
    "wrong_goal": "the expert under a wrong instruction",
}
TITLES = {
    "d_loss": "Loss of the discriminator, nats",
    "d_penalty": "Gradient penalty",
    "p_loss": "Loss of the policy",
    "p_entropy": "Entropy of the policy, nats",
    "p_distance": "Policy from what the reward asks for, nats",
    "p_value_error": "Squared error of the value",
    "p_reward": "Learned reward of what was played",
    "p_ratio": "Importance ratio",
}
COUNTS = frozenset({"step", "env_steps", "episodes", "seconds"})

Points = Sequence[Mapping[str, Any]]
Result = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class TableView:
    """Rows of text; the first column names the row, the others are numbers."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Charts and tables that belong together."""

    title: str
    words: str
    charts: tuple[Chart, ...]
    tables: tuple[TableView, ...] = ()


def lead_of(config: Config, points: Points, result: Result | None) -> str:
    """The run in one sentence."""
    what = ALGORITHMS[config.algorithm].title
    where = f"{len(config.tasks)} MiniWoB tasks" if config.world == "miniwob" else "LanguageGridCraft"
    if config.world == "miniwob" and config.browser == "fake":
        where = f"{len(config.tasks)} tasks of the fake browser, which are no result"
    step = points[-1]["step"] if points else 0
    if result is not None:
        return f"{what} on {where}: finished after {step} iterations."
    return f"{what} on {where}: not finished; what there is after {step} of {config.iterations} iterations."


def facts_of(config: Config, points: Points, result: Result | None, demonstrations: int | None) -> dict[str, str]:
    """What a reader asks first."""
    last = points[-1] if points else {}
    result = result or {}
    facts = {
        "algorithm": config.algorithm,
        "seed": str(config.seed),
        "iterations": f"{last.get('step', 0)} of {config.iterations}",
        "demonstrations": _count(demonstrations),
        "environment steps": _count(result.get("env_steps", last.get("env_steps"))),
        "training episodes": _count(result.get("training_episodes", last.get("episodes"))),
        "seconds": _count(result.get("seconds", last.get("seconds"))),
        "SHA-256 of the nets": str(result.get("parameters_sha256", ""))[:12],
    }
    if config.world == "miniwob":
        facts |= {"browser": config.browser, "runtime": config.runtime, "demonstrations from": config.demos.source}
    return {name: value for name, value in facts.items() if value}


def result_tables(config: Config, result: Result | None, thesis: Mapping[str, float]) -> list[TableView]:
    """How good it is, beside chance and what the thesis reports."""
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
    head = ("task", "chance", "success", "95 % interval", "pages", "thesis")
    return [TableView(caption="Greedy policy on fresh pages, % that succeed", head=head, rows=rows), *tables]


def _by_goal(result: Result) -> TableView:
    """Where goals were held out of training: success under those it saw, and under the others."""
    rows = tuple(
        (task, *(f"{100 * own[goals]['success']:.1f}" for goals in ("trained_goals", "held_out_goals")))
        for task, own in result["tasks"].items()
        if "held_out_goals" in own
    )
    head = ("task", "goals of the training", "goals held out")
    return TableView(caption="The same by instruction, % that succeed", head=head, rows=rows)


def _returns(result: Result) -> TableView:
    rows = tuple(
        (goal, f"{own['return_over_optimal']:.3f}", f"{own['reoptimised_over_optimal']:.3f}")
        for goal, own in result["goals"].items()
    )
    head = ("instruction", "the policy", "re-optimised")
    return TableView(
        caption="Return; 1 is optimal, 0 chance. Re-optimised: on the learned reward alone", head=head, rows=rows
    )


def result_lines(config: Config, result: Result | None) -> list[str]:
    """What stands above the table."""
    if result is None:
        return ["The run has not come to its end, so nothing was measured."]
    if config.world == "gridcraft":
        avoid = result["avoid"]
        return [
            f"The reward against the truth: Spearman {result['spearman']:.2f} and Pearson {result['pearson']:.2f} with "
            f"the optimal value, EPIC distance {result['epic']:.2f}. An agent optimised on the reward alone enters the "
            f"avoided colour in {100 * avoid['entered']:.1f} % of episodes, the expert in "
            f"{100 * avoid['expert_entered']:.1f} %."
        ]
    return []


def success_group(config: Config, points: Points, result: Result | None, demonstrations: Mapping[str, int]) -> Group:
    """True success while training, task by task; for grids the return, instruction by instruction."""
    steps = [point["env_steps"] for point in points]
    if config.world == "gridcraft":
        goals = list(points[0]["returns"])
        charts = [draw_chart(g, [Line(name="return", x=steps, y=[p["returns"][g] for p in points])]) for g in goals]
        words = "Return of the policy as it explores, as a fraction of optimal above chance, against environment steps."
        return Group(title="Return", words=words, charts=tuple(charts))
    chance = {task: own["random"] for task, own in result["tasks"].items()} if result is not None else {}
    charts = [
        draw_chart(
            task,
            [Line(name="success", x=steps, y=_moving([point["outcomes"].get(task, []) for point in points]))],
            levels=[Level(name="chance", y=chance[task])] if task in chance else [],
            unit="%",
        )
        for task in config.tasks
    ]
    words = (
        f"Share of the last {WINDOW} training episodes of a task that succeeded by the page's own reckoning, in %, "
        "against environment steps. The policy explores here, and never sees these numbers."
    )
    return Group(
        title="Success while training",
        words=words,
        charts=tuple(charts),
        tables=(_outcomes(config, points, result, demonstrations),),
    )


def learning_group(points: Points) -> Group:
    """What the updates told: the discriminator's accuracy by source, then everything else that was a number."""
    steps = [point["env_steps"] for point in points]
    names = [name for name in points[-1] if name not in COUNTS and isinstance(points[-1][name], int | float)]
    curves = {name: [float(point.get(name, float("nan"))) for point in points] for name in names}
    sources = {name.removeprefix(ACCURACY): curves.pop(name) for name in names if name.startswith(ACCURACY)}
    charts = []
    if sources:
        lines = [Line(name=SOURCES.get(name, _plain(name)), x=steps, y=_smooth(y)) for name, y in sources.items()]
        charts.append(draw_chart("What the discriminator judges rightly, %", lines, unit="%"))
    charts += [
        draw_chart(TITLES.get(name, _plain(name)), [Line(name=_plain(name), x=steps, y=y)])
        for name, y in curves.items()
        if min(y) != max(y)
    ]
    return Group(title="Learning", words="Against environment steps.", charts=tuple(charts))


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


def _smooth(values: Sequence[float]) -> list[float]:
    """Mean of the last twentieth of the points; one batch alone says little."""
    width = max(1, len(values) // 20)
    return [sum(values[max(0, i + 1 - width) : i + 1]) / min(width, i + 1) for i in range(len(values))]


def _share(outcomes: Sequence[int]) -> str:
    return f"{100 * sum(outcomes) / len(outcomes):.0f}" if outcomes else "-"


def _count(number: float | None) -> str:
    return "" if number is None else f"{number:,.0f}"


def _plain(name: str) -> str:
    return name.replace("_", " ")
