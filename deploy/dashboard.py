"""The Grafana dashboard of a run, built from the definitions of the metrics: no panel can ask for what does not exist.

After a change: `python -m deploy.dashboard > deploy/grafana.json`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

from grafana_foundation_sdk.builders import common, dashboard, prometheus, timeseries
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.models import common as common_model
from grafana_foundation_sdk.models.dashboard import DashboardCursorSync, DataSourceRef, VariableRefresh
from prometheus_client import Counter, Gauge, Histogram

from giirl_core.metrics import Metrics

RUN = "$run"  # the variable of the dashboard
WINDOW = "$__rate_interval"
SOURCE = DataSourceRef(type_val="prometheus", uid="${source}")
WIDTH, HEIGHT = 8, 8  # of a panel, in Grafana's grid of 24 columns

M = Metrics()


@dataclass(frozen=True, slots=True)
class Panel:
    """A diagram over time."""

    title: str
    unit: str  # as Grafana names it
    queries: Sequence[tuple[str, str]]  # legend, PromQL
    description: str = ""


def select(metric: Counter | Gauge | Histogram, suffix: str = "", **labels: str) -> str:
    """The series of a metric in the chosen run. KeyError for a label that it does not have."""
    for label in labels:
        if label not in metric._labelnames:
            raise KeyError(f"{metric._name} has no label {label!r}")
    matchers = ",".join(f'{name}="{value}"' for name, value in {"run": RUN, **labels}.items())
    return f"{metric._name}{'_total' if isinstance(metric, Counter) else suffix}{{{matchers}}}"


def rate(counter: Counter, *by: str, **labels: str) -> str:
    """Events per second, summed over all processes."""
    return _sum(f"rate({select(counter, **labels)}[{WINDOW}])", by)


def busy(histogram: Histogram, *by: str) -> str:
    """Seconds per second in what a histogram of durations measures."""
    return _sum(f"rate({select(histogram, '_sum')}[{WINDOW}])", by)


def quantile(q: float, histogram: Histogram, *by: str) -> str:
    """A quantile of a histogram over the last minutes."""
    buckets = _sum(f"rate({select(histogram, '_bucket')}[{WINDOW}])", ("le", *by))
    return f"histogram_quantile({q}, {buckets})"


def level(gauge: Gauge, *by: str, **labels: str) -> str:
    """A gauge, summed over all processes."""
    return _sum(select(gauge, **labels), by)


def age(gauge: Gauge, *by: str) -> str:
    """Seconds since the time in a gauge, the longest."""
    return f"time() - min by ({', '.join(by)}) ({select(gauge)})"


def process(name: str, *by: str, aggregate: str = "sum") -> str:
    """A series of the process collector, such as process_open_fds. KeyError if there is none."""
    if name.removesuffix("_total") not in {family.name for family in M.registry.collect()}:
        raise KeyError(name)
    series = f'{name}{{run="{RUN}"}}'
    return f"{aggregate} by ({', '.join(by)}) ({f'rate({series}[{WINDOW}])' if name.endswith('_total') else series})"


def _sum(expression: str, by: Sequence[str]) -> str:
    return f"sum by ({', '.join(by)}) ({expression})" if by else f"sum({expression})"


def statistic(key: str) -> str:
    """A key of curve.jsonl."""
    return level(M.training_statistic, key=key)


ROWS: dict[str, Sequence[Panel]] = {
    "Learning": (
        Panel("Success", "percentunit", [("{{task}}", level(M.success, "task"))], "Last 100 training episodes."),
        Panel(
            "Losses and entropy",
            "none",
            [("reward loss", statistic("d_loss")), ("policy entropy", statistic("p_entropy"))],
            "1.386 is the loss of a discriminator that cannot tell policy from expert.",
        ),
        Panel(
            "Discriminator",
            "percentunit",
            [
                ("{{source}}", level(M.discriminator_accuracy, "source")),
                ("logits at the clip", statistic("d_clipped")),
            ],
            "Accuracy on each source of samples. Logits at the clip carry no gradient of the reward.",
        ),
        Panel("Reward of an episode", "none", [("learned reward", statistic("p_reward"))]),
        Panel("Importance ratio", "none", [("pi / mu", statistic("p_ratio"))], "Far from 1: rollouts are old."),
        Panel(
            "Iteration",
            "none",
            [
                ("policy of {{process}}", level(M.policy_version, "process")),
                ("reward of {{process}}", level(M.reward_version, "process")),
                ("goal", level(M.iterations_goal)),
            ],
            "Of the learner, and of the weights that each actor and reward service uses.",
        ),
    ),
    "Throughput and lag": (
        Panel(
            "Episodes per second",
            "ops",
            [("trained on", rate(M.trajectories_taken)), ("{{outcome}}", rate(M.episodes, "outcome", purpose="train"))],
        ),
        Panel("Environment steps per second", "ops", [("{{process}}", rate(M.env_steps, "process", purpose="train"))]),
        Panel(
            "Lag",
            "none",
            [
                ("policy, median", quantile(0.5, M.policy_lag)),
                ("policy, 95 %", quantile(0.95, M.policy_lag)),
                ("reward, 95 %", quantile(0.95, M.reward_lag)),
            ],
            "Versions by which the policy and the reward of an episode are behind when it is trained on.",
        ),
        Panel(
            "Who waits for what",
            "percentunit",
            [("{{process}}: {{reason}}", rate(M.waiting_seconds, "process", "reason"))],
        ),
        Panel("Threads that wait", "none", [("{{reason}}", level(M.waiting_threads, "reason"))]),
        Panel("Idle tabs", "percentunit", [("of the actors", level(M.flow, key="actors_idle"))]),
        Panel("Gradient updates per second", "ops", [("{{network}}", rate(M.gradient_updates, "network"))]),
        Panel("Time in updates", "percentunit", [("{{network}}", busy(M.gradient_update_duration, "network"))]),
    ),
    "Delivery": (
        Panel("Queue", "none", [("episodes", level(M.trajectories_queued))]),
        Panel(
            "Episodes dropped and lost per second",
            "ops",
            [("{{reason}}", rate(M.trajectories_dropped, "reason")), ("lost", rate(M.trajectories_lost))],
        ),
        Panel(
            "Messages per second",
            "ops",
            [("received", rate(M.trajectories_received)), ("{{reason}}", rate(M.trajectories_rejected, "reason"))],
            "Rejected ones by reason: they are sent again, or came twice.",
        ),
        Panel(
            "Refused per second",
            "ops",
            [
                ("connections: {{socket}}", rate(M.connections_refused, "socket")),
                ("weights: {{network}}", rate(M.weights_refused, "network")),
            ],
        ),
        Panel("Silence of actors", "s", [("{{actor}}", age(M.actor_last_heard, "actor"))]),
        Panel("Age of the checkpoint", "s", [("age", age(M.checkpoint_time, "run"))]),
        Panel("Time to save a checkpoint", "s", [("95 %", quantile(0.95, M.checkpoint_duration))]),
    ),
    "Browsers": (
        Panel("Workers", "none", [("{{kind}} {{state}}", level(M.workers, "kind", "state"))]),
        Panel("Browser recoveries per second", "ops", [("{{cause}}", rate(M.browser_recoveries, "cause"))]),
        Panel("Left out of pages per second", "ops", [("{{what}}", rate(M.page_limits, "what"))]),
        Panel("Exits of workers per second", "ops", [("{{kind}}", rate(M.worker_exits, "kind"))]),
    ),
    "Reward service": (
        Panel("Requests per second", "ops", [("{{result}}", rate(M.scoring_requests, "result"))]),
        Panel(
            "Time to a reply",
            "s",
            [("median", quantile(0.5, M.scoring_duration)), ("95 %", quantile(0.95, M.scoring_duration))],
        ),
        Panel(
            "Rewards in training per second, by who computed them",
            "ops",
            [("{{source}}", rate(M.rewards_used, "source")), ("unscored episodes", rate(M.episodes_unscored))],
        ),
    ),
    "Machine": (
        Panel("Phase", "none", [("{{phase}}", level(M.run_phase, "phase"))]),
        Panel("Processes", "none", [("{{version}} {{revision}}", level(M.build_info, "version", "revision"))]),
        Panel("Cores in use", "none", [("{{process}}", process("process_cpu_seconds_total", "process"))]),
        Panel(
            "Memory",
            "bytes",
            [
                ("{{process}}", process("process_resident_memory_bytes", "process")),
                ("tensors on the device", level(M.device_memory)),
            ],
            "Without Chrome, which the actor starts as processes of its own.",
        ),
        Panel(
            "Open files",
            "none",
            [
                ("{{process}}", process("process_open_fds", "process")),
                ("lowest limit", process("process_max_fds", "run", aggregate="min")),
            ],
        ),
    ),
}


def build() -> dashboard.Dashboard:
    """The dashboard. It asks for a Prometheus data source and for a run."""
    made = (
        dashboard.Dashboard("GIIRL")
        .uid("giirl")
        .tags(["giirl"])
        .description("A training run: learning, throughput, delivery, browsers, reward service, machines.")
        .refresh("10s")
        .time("now-30m", "now")
        .tooltip(DashboardCursorSync.CROSSHAIR)
        .with_variable(dashboard.DatasourceVariable("source").type("prometheus").label("Prometheus"))
        .with_variable(
            dashboard.QueryVariable("run")
            .label("run")
            .datasource(SOURCE)
            .query(f"label_values({M.run_info._name}, run)")
            .refresh(VariableRefresh.ON_TIME_RANGE_CHANGED)
        )
    )
    numbers = count(1)
    for title, panels in ROWS.items():
        made.with_row(dashboard.Row(title).id(next(numbers)))
        for panel in panels:
            made.with_panel(_panel(panel).id(next(numbers)))
    return made


def _panel(panel: Panel) -> timeseries.Panel:
    made = (
        timeseries.Panel()
        .title(panel.title)
        .description(panel.description)
        .unit(panel.unit)
        .datasource(SOURCE)
        .span(WIDTH)
        .height(HEIGHT)
        .axis_soft_min(0)
        .show_points(common_model.VisibilityMode("never"))
        .legend(
            common.VizLegendOptions()
            .show_legend(True)
            .display_mode(common_model.LegendDisplayMode.LIST)
            .placement(common_model.LegendPlacement.BOTTOM)
        )
    )
    for index, (legend, expression) in enumerate(panel.queries):
        query = prometheus.Dataquery().expr(expression).legend_format(legend).ref_id(chr(ord("A") + index))
        made.with_target(query.datasource(SOURCE).range())
    return made


if __name__ == "__main__":
    sys.stdout.write(JSONEncoder(sort_keys=True, indent=2).encode(build().build()) + "\n")
