"""Prometheus metrics whose values stay in this process, whatever its environment says."""

from __future__ import annotations

from threading import Lock

from prometheus_client import Counter, Gauge, Histogram, values

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


class InMemoryCounter(_InMemory, Counter):
    """A counter in memory."""


class InMemoryGauge(_InMemory, Gauge):
    """A gauge in memory."""


class InMemoryHistogram(_InMemory, Histogram):
    """A histogram in memory."""
