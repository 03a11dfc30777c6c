"""What we use of the Prometheus client. The values of metrics stay in this process, whatever its environment says."""

from __future__ import annotations

from threading import Lock

import prometheus_client as library
from prometheus_client import CollectorRegistry, ProcessCollector, disable_created_metrics, values
from prometheus_client.exposition import choose_encoder
from prometheus_client.parser import text_string_to_metric_families

__all__ = [
    "CollectorRegistry",
    "Counter",
    "Gauge",
    "Histogram",
    "ProcessCollector",
    "Samples",
    "choose_encoder",
    "disable_created_metrics",
    "parse_samples",
]

Samples = dict[str, list[tuple[dict[str, str], float]]]  # by name: labels and value of each series

_VALUE_CLASS_LOCK = Lock()


class _InMemory:
    """Holds the values of a metric in this process.

    The library would put them into the files of PROMETHEUS_MULTIPROC_DIR, which belong to another service.
    """

    def _metric_init(self) -> None:
        with _VALUE_CLASS_LOCK:
            chosen, values.ValueClass = values.ValueClass, values.MutexValue
            try:
                super()._metric_init()  # type: ignore[misc]
            finally:
                values.ValueClass = chosen


class Counter(_InMemory, library.Counter):
    """A counter in memory."""


class Gauge(_InMemory, library.Gauge):
    """A gauge in memory."""


class Histogram(_InMemory, library.Histogram):
    """A histogram in memory."""


def parse_samples(text: str) -> Samples:
    """The metrics that a process has served. ValueError if the text is something else."""
    found: Samples = {}
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            found.setdefault(sample.name, []).append((dict(sample.labels), sample.value))
    return found
