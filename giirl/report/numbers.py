"""The facts and training curves of a run for its report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from giirl.report.charts import Chart, Line, draw_chart
from giirl.run.folder import RunFolder
from giirl_core.algorithms import ALGORITHMS
from giirl_core.config import Config
from giirl_core.weights import Weights
from learner.protocols import ACCURACY

SOURCES = {
    "expert": "expert steps",
    "rollouts": "new rollouts",
    "replay": "replayed rollouts",
    "policy_on_expert_states": "policy actions in expert states",
    "random_actions": "random actions",
    "wrong_goal": "expert steps, wrong instruction",
    "wrong_step": "expert steps, wrong words or time",
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
FLOW: tuple[tuple[str, Literal["", "%"], dict[str, str]], ...] = (  # title, unit, and the lines: key, name
    ("Episodes per second", "", {"episodes_per_s": "taken by the learner"}),
    ("Share of time waiting, %", "%", {"learner_waits": "learner waits", "actors_idle": "actors idle"}),
    ("Policy lag, versions", "", {"lag": "mean of the episodes"}),
    ("Stale episodes, %", "%", {"stale": "dropped"}),
)
FLOW_WORDS = (
    "The learner waits when the actors are too slow, and the actors are idle when the learner is. An episode is stale, "
    "and dropped, when the policy that played it is too many versions old."
)
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


def lead_of(config: Config, subject: str, points: Points, result: Result | None) -> str:
    """A one-sentence summary of the run; `subject` names the tasks or the world."""
    what = ALGORITHMS[config.algorithm].title
    step = points[-1]["step"] if points else 0
    if result is not None:
        return f"{what} on {subject}: finished after {step} iterations."
    return f"{what} on {subject}: unfinished, after {step} of {config.iterations} iterations."


def facts_of(config: Config, points: Points, result: Result | None, demonstrations: int | None) -> dict[str, str]:
    """The key facts of the run, by name. Unknown facts are left out."""
    last = points[-1] if points else {}
    result = result or {}
    facts = {
        "algorithm": config.algorithm,
        "seed": str(config.seed),
        "iterations": f"{last.get('step', 0)} of {config.iterations}",
        "demonstrations": count(demonstrations),
        "environment steps": count(result.get("env_steps", last.get("env_steps"))),
        "training episodes": count(result.get("training_episodes", last.get("episodes"))),
        "run time, seconds": count(result.get("seconds", last.get("seconds"))),
        "SHA-256 of the networks": str(result.get("parameters_sha256", ""))[:12],
    }
    return {name: value for name, value in facts.items() if value}


def no_reward(config: Config) -> str:
    """The sentence for algorithms that learn no reward."""
    return f"No reward is shown: {config.algorithm} learns only a policy."


def weights_of(folder: RunFolder, config: Config, checkpoint: Path) -> tuple[Weights, Weights | None]:
    """The policy and the reward of a checkpoint; the reward is None for algorithms that learn none."""
    has_reward = ALGORITHMS[config.algorithm].has_learned_reward
    return folder.weights(checkpoint, "policy"), folder.weights(checkpoint, "reward") if has_reward else None


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


def flow_group(points: Points) -> list[Group]:
    """How fast the run went and who waited for whom. No group for a run whose curve has no such numbers."""
    measured = [point for point in points if "flow" in point]
    if not measured:
        return []
    steps = [point["env_steps"] for point in measured]
    charts = []
    for title, unit, lines in FLOW:
        curves = {key: [float(point["flow"][key]) for point in measured] for key in lines}
        drawn = [Line(name=name, x=steps, y=curves[key]) for key, name in lines.items()]
        charts.append(draw_chart(title, drawn, unit=unit))
    words = "Over the last seconds before each iteration, against environment steps. " + FLOW_WORDS
    return [Group(title="Throughput", words=words, charts=tuple(charts))]


def _smooth(values: Sequence[float]) -> list[float]:
    """Moving average over a twentieth of the points, because single batches are noisy."""
    width = max(1, len(values) // 20)
    return [sum(values[max(0, i + 1 - width) : i + 1]) / min(width, i + 1) for i in range(len(values))]


def count(number: float | None) -> str:
    """A number with thousands separators; "" for None."""
    return "" if number is None else f"{number:,.0f}"


def _plain(name: str) -> str:
    return name.replace("_", " ")
