"""The service's figures as Prometheus reads them (https://prometheus.io/docs/instrumenting/exposition_formats/)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from prometheus_client import CollectorRegistry, Counter, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric, SummaryMetricFamily
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector

from wibam_core.adapters.counters import Counted, Sight
from wibam_core.jobs.states import JobState
from wibam_core.stages.graph import STAGES_OF

_METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS")
_STAGES = tuple(dict.fromkeys(name for graph in STAGES_OF.values() for name in graph))


class Figures:
    """Counts the requests of this process, and tells these with what the database says of the whole service.

    Args:
        look: reads the database, each time somebody asks.
    """

    def __init__(self, look: Callable[[], Sight]) -> None:
        self._registry = CollectorRegistry()
        self._requests = Counter(
            "wibam_http_requests", "Requests that this process answered", ["method", "status"], registry=self._registry
        )
        self._problems = Counter(
            "wibam_http_problems", "Problems that it answered with, by their code", ["code"], registry=self._registry
        )
        ProcessCollector(registry=self._registry)
        self._registry.register(_OfTheDatabase(look))

    def answered(self, method: str, status: int, problem: str = "") -> None:
        """A request was answered; ``problem`` is the code of the problem, if it was one."""
        self._requests.labels(method if method in _METHODS else "other", str(status)).inc()
        if problem:
            self._problems.labels(problem).inc()

    def exposition(self, accept: str) -> tuple[bytes, str]:
        """All figures now, and their media type: OpenMetrics where the client takes it, Prometheus' own text else."""
        encode, media_type = choose_encoder(accept)
        return encode(self._registry), media_type


class _OfTheDatabase(Collector):
    def __init__(self, look: Callable[[], Sight]) -> None:
        self._look = look

    def describe(self) -> Iterable[Metric]:
        return ()  # the database is not asked before somebody asks us

    def collect(self) -> Iterable[Metric]:
        sight = self._look()
        yield _gauge("wibam_stages_waiting", "Stages that wait for a worker", "stage", _STAGES, sight.waiting)
        yield _gauge("wibam_stages_running", "Stages that a worker has", "stage", _STAGES, sight.running)
        yield GaugeMetricFamily(
            "wibam_stage_oldest_waiting_seconds",
            "How long the stage that has waited longest for a worker does",
            value=sight.oldest_waiting_s,
        )
        yield _gauge("wibam_jobs", "Jobs by state", "state", [state.value for state in JobState], sight.jobs)
        seconds = SummaryMetricFamily(
            "wibam_stage_seconds", "How long attempts at stages took, by how they ended", labels=["stage", "outcome"]
        )
        losses = CounterMetricFamily("wibam_lease_losses", "Attempts at stages whose worker was lost", labels=["stage"])
        counted = sight.counted
        for what, stage, outcome in sorted(counted):
            if what is Counted.ATTEMPTS:
                taken_s = counted.get((Counted.SECONDS, stage, outcome), 0.0)
                seconds.add_metric([stage, outcome], int(counted[what, stage, outcome]), taken_s)
        for stage in _STAGES:
            losses.add_metric([stage], counted.get((Counted.LEASE_LOSSES, stage, ""), 0.0))
        yield seconds
        yield losses
        yield CounterMetricFamily(
            "wibam_uploaded_bytes",
            "Bytes of uploads that are safely on disk",
            value=counted.get((Counted.UPLOADED_BYTES, "", ""), 0.0),
        )


def _gauge(name: str, meaning: str, label: str, known: Iterable[str], found: Mapping[str, int]) -> GaugeMetricFamily:
    family = GaugeMetricFamily(name, meaning, labels=[label])
    for value in dict.fromkeys((*known, *found)):
        family.add_metric([value], found.get(value, 0))
    return family
