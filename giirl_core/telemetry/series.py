"""Every Prometheus metric of the system: names, help texts, labels, and which kinds of process serve it.

Names follow the Prometheus conventions: the prefix `giirl_`, the unit as a suffix, `_total` for counters. Labels take
a few fixed values only (a reason, a task), never a seed. `giirl_actor_last_heard_timestamp_seconds` alone is labelled
with the actor. Prometheus adds the labels `run`, `process` and `node` when it scrapes (`giirl_core.telemetry.targets`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Literal, TypeVar, get_args

from giirl_core.telemetry.prometheus import (
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    ProcessCollector,
    choose_encoder,
    disable_created_metrics,
)
from giirl_core.telemetry.version import REVISION, VERSION

LEARNER, ACTOR, SERVICE = KINDS = ("learner", "actor", "reward-service")
LAG_BUCKETS = (0, 1, 2, 3, 4, 6, 8, 12, 16)  # versions
DURATION_BUCKETS = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)  # seconds
SAVE_BUCKETS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0)  # seconds

# The values of labels. If all values of a metric's labels are known, its series exist from the start, at 0.
Values = tuple[str, ...]
ANY: Values = ()  # not known before
WORKERS = (ACTOR, SERVICE)
WorkerState = Literal["running", "starting", "waiting", "stopping", "given_up"]
WORKER_STATES = get_args(WorkerState)
PHASES = ("demonstrations", "starting", "training", "evaluation")
PURPOSES = ("train", "demonstrate", "evaluate", "inspect", "random", "feedback")
OUTCOMES = ("success", "failure", "step_limit", "lost", "empty_page")
PAGE_CAUSES = ("page_hung", "tab_crashed", "navigated", "page_error", "browser_died")
SITE_CAUSES = ("unreachable", "refused", "not_quiet", "missing", "login_expired", "outside")  # on own pages
PAGE_LIMITS = ("elements_left_out", "requests_refused", "file_inputs_refused", "script_errors")
DROPPED = ("stale", "stale_queued", "invalid", "repeated", "held_out")
REJECTED = ("duplicate", "over_credit", "damaged", "fenced", "other_run")
SCORING_RESULTS = ("ok", "overloaded", "malformed", "no_weights", "failed", "unreachable")

M = TypeVar("M", Counter, Gauge, Histogram)

disable_created_metrics()  # type: ignore[no-untyped-call] # a second series for each counter, which nobody reads


class Series:
    """The metrics of one process, in a registry of their own: two instances share no state.

    Every metric is an attribute and can be updated in any process. One that does not belong to the `kind` of this
    process is not served; without a kind all are.
    """

    def __init__(self, kind: str = "") -> None:
        assert kind in ("", *KINDS)
        self.registry = CollectorRegistry()
        self._kind = kind
        self._define_processes()
        self._define_run()
        self._define_environment()
        self._define_delivery()
        self._define_training()
        self._define_scoring()

    def render(self, accept: str) -> tuple[bytes, str]:
        """All series in the format that the header `Accept` asks for, and its content type."""
        encode, content_type = choose_encoder(accept)
        return encode(self.registry), content_type

    def _define_processes(self) -> None:
        ProcessCollector(registry=self.registry)
        self.build_info = self._gauge("giirl_build_info", "Version of the code.", KINDS, version=ANY, revision=ANY)
        self.build_info.labels(VERSION, REVISION or "unknown").set(1)
        self.waiting_seconds = self._counter(
            "giirl_waiting_seconds_total", "Time that threads spent waiting.", KINDS, reason=ANY
        )
        self.waiting_threads = self._gauge(
            "giirl_waiting_threads", "Number of threads that are waiting.", KINDS, reason=ANY
        )
        self.connections_refused = self._counter(
            "giirl_connections_refused_total",
            "Number of refused socket connections, for example because of a wrong or missing key.",
            (LEARNER, SERVICE),
            socket=("trajectories", "scoring"),
        )
        self.workers = self._gauge(
            "giirl_workers", "Number of worker processes, by state.", (LEARNER,), kind=WORKERS, state=WORKER_STATES
        )
        self.worker_exits = self._counter(
            "giirl_worker_exits_total",
            "Number of worker processes that exited or were killed as hung.",
            (LEARNER,),
            kind=WORKERS,
        )
        self.actor_last_heard = self._gauge(
            "giirl_actor_last_heard_timestamp_seconds",
            "Time of the last message of an actor, from the first message to the goodbye.",
            (LEARNER,),
            actor=ANY,
        )

    def _define_run(self) -> None:
        self.run_info = self._gauge(
            "giirl_run_info",
            "Identity and settings of the run.",
            (LEARNER,),
            identity=ANY,
            algorithm=ANY,
            device=ANY,
        )
        self.run_phase = self._gauge(
            "giirl_run_phase", "Whether the run is in a phase: 1 or 0.", (LEARNER,), phase=PHASES
        )
        self.iterations_goal = self._gauge(
            "giirl_iterations_goal", "Iterations after which the training ends; 0 before it begins.", (LEARNER,)
        )
        self.checkpoint_time = self._gauge(
            "giirl_checkpoint_timestamp_seconds", "Time of the last checkpoint; 0 before the first.", (LEARNER,)
        )
        self.checkpoint_duration = self._histogram(
            "giirl_checkpoint_duration_seconds", "Duration of saving a checkpoint.", (LEARNER,), SAVE_BUCKETS
        )
        self.success = self._gauge(
            "giirl_success_ratio", "Success over the last 100 training episodes of a task.", (LEARNER,), task=ANY
        )
        self.flow = self._gauge(
            "giirl_flow",
            "A rate or share over the last 20 s, as in `flow` of curve.jsonl.",
            (LEARNER,),
            key=ANY,
        )

    def _define_environment(self) -> None:
        played_by = (LEARNER, ACTOR)
        self.env_steps = self._counter(
            "giirl_env_steps_total", "Number of environment steps.", played_by, purpose=PURPOSES
        )
        self.episodes = self._counter(
            "giirl_episodes_total",
            "Number of episodes that ended.",
            played_by,
            task=ANY,
            outcome=OUTCOMES,
            purpose=PURPOSES,
        )
        self.browser_recoveries = self._counter(
            "giirl_browser_recoveries_total",
            "Number of browser recoveries: one for each broken tab, one for each relaunch of a dead browser.",
            played_by,
            cause=(*PAGE_CAUSES, *SITE_CAUSES),
        )
        self.page_limits = self._counter(
            "giirl_page_limits_total",
            "Number of elements left out of large pages, and of requests and file inputs refused, on own pages.",
            played_by,
            what=PAGE_LIMITS,
        )
        self.episodes_unscored = self._counter(
            "giirl_episodes_unscored_total",
            "Number of episodes that an actor sent to the learner without rewards from the reward service.",
            (ACTOR,),
        )

    def _define_delivery(self) -> None:
        self.trajectories_received = self._counter(
            "giirl_trajectories_received_total",
            "Number of trajectory messages that the learner received, including those it rejected.",
            (LEARNER,),
        )
        self.trajectories_rejected = self._counter(
            "giirl_trajectories_rejected_total",
            "Number of trajectory messages that brought no new trajectory, or one that is sent again.",
            (LEARNER,),
            reason=REJECTED,
        )
        self.trajectories_dropped = self._counter(
            "giirl_trajectories_dropped_total",
            "Number of trajectories that the learner received and does not train on.",
            (LEARNER,),
            reason=DROPPED,
        )
        self.trajectories_lost = self._counter(
            "giirl_trajectories_lost_total",
            "Number of trajectories that an actor finished and that never arrived.",
            (LEARNER,),
        )
        self.trajectories_taken = self._counter(
            "giirl_trajectories_taken_total", "Number of trajectories that the learner trained on.", (LEARNER,)
        )
        self.trajectories_queued = self._gauge(
            "giirl_trajectories_queued", "Number of trajectories in the learner's queue.", (LEARNER,)
        )
        self.policy_lag = self._histogram(
            "giirl_policy_lag_versions",
            "Number of versions by which a trajectory's policy is older than the learner's policy.",
            (LEARNER,),
            LAG_BUCKETS,
        )
        self.reward_lag = self._histogram(
            "giirl_reward_lag_versions",
            "Number of versions by which a trajectory's reward is older than the learner's reward.",
            (LEARNER,),
            LAG_BUCKETS,
        )

    def _define_training(self) -> None:
        self.policy_version = self._gauge(
            "giirl_policy_version", "Learner step of the policy weights in use.", (LEARNER, ACTOR)
        )
        self.reward_version = self._gauge(
            "giirl_reward_version", "Learner step of the reward weights in use.", (LEARNER, SERVICE)
        )
        self.weights_refused = self._counter(
            "giirl_weights_refused_total",
            "Number of weights refused because they are corrupt, older than those in use, or of another net.",
            WORKERS,
            network=("policy", "reward"),
        )
        self.gradient_updates = self._counter(
            "giirl_gradient_updates_total", "Number of completed gradient updates.", (LEARNER,), network=ANY
        )
        self.gradient_update_duration = self._histogram(
            "giirl_gradient_update_duration_seconds",
            "Duration of one gradient update.",
            (LEARNER,),
            DURATION_BUCKETS,
            network=ANY,
        )
        self.device_memory = self._gauge(
            "giirl_device_memory_bytes",
            "Memory that tensors use on the learner's CUDA device; 0 on the CPU.",
            (LEARNER,),
        )
        self.rewards_used = self._counter(
            "giirl_rewards_used_total",
            "Number of rewards the policy was trained on, by the process that computed them.",
            (LEARNER,),
            source=("service", "learner"),
        )
        self.discriminator_accuracy = self._gauge(
            "giirl_discriminator_accuracy_ratio",
            "Fraction of each source's samples that the discriminator classifies correctly, in its last update.",
            (LEARNER,),
            source=ANY,
        )
        self.training_statistic = self._gauge(
            "giirl_training_statistic", "A number of the last line of curve.jsonl, by its key.", (LEARNER,), key=ANY
        )

    def _define_scoring(self) -> None:
        self.scoring_requests = self._counter(
            "giirl_scoring_requests_total",
            "Number of scoring requests, by result.",
            (SERVICE,),
            result=SCORING_RESULTS,
        )
        self.scoring_duration = self._histogram(
            "giirl_scoring_duration_seconds",
            "Time from the arrival of a scoring request to its reply.",
            (SERVICE,),
            DURATION_BUCKETS,
        )

    def _counter(self, name: str, help_text: str, kinds: Sequence[str], **labels: Values) -> Counter:
        return _begun(Counter(name, help_text, labels, registry=self._registry_for(kinds)), labels)

    def _gauge(self, name: str, help_text: str, kinds: Sequence[str], **labels: Values) -> Gauge:
        return _begun(Gauge(name, help_text, labels, registry=self._registry_for(kinds)), labels)

    def _histogram(
        self, name: str, help_text: str, kinds: Sequence[str], buckets: tuple[float, ...], **labels: Values
    ) -> Histogram:
        made = Histogram(name, help_text, labels, buckets=buckets, registry=self._registry_for(kinds))
        return _begun(made, labels)

    def _registry_for(self, kinds: Sequence[str]) -> CollectorRegistry | None:
        return self.registry if self._kind in ("", *kinds) else None


def _begun(metric: M, labels: Mapping[str, Values]) -> M:
    """The metric with a series for every combination of the known values of its labels."""
    if all(labels.values()):
        for combination in product(*labels.values()) if labels else ():
            metric.labels(*combination)
    return metric
