"""A robot's reports as metrics of Prometheus, at ``http://ADDRESS:PORT/metrics``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from time import monotonic
from typing import TYPE_CHECKING

from fame.deploy.envelope import STATES, Report
from fame.deploy.status import WAITS
from fame.errors import ConfigError
from fame.imports import require

if TYPE_CHECKING:
    from prometheus_client.metrics_core import Metric

_SERIES: Mapping[str, tuple[str, Callable[[Report], float]]] = {
    "instances": ("Process instances that run now.", lambda report: report.instances),
    "waiting_tokens": ("Tokens that wait.", lambda report: len(report.waits) + report.more_waits),
    "longest_wait_seconds": (f"How long the oldest of the first {WAITS} waits, in mission time.", lambda report: max(
        (report.now - wait.get("since", report.now) for wait in report.waits), default=0.0)),
    "incidents": (f"Elements that have failed and wait for repair, at most {WAITS}.",
        lambda report: len(report.incidents)),
    "warnings": ("Latest warnings: lost messages, endpoints that do not match, clocks that jump.",
        lambda report: len(report.warnings)),
    "instances_started_total": ("Process instances started since the deployment.", lambda report: report.started),
    "instances_completed_total": ("Of these, those that have completed.", lambda report: report.completed),
    "instances_failed_total": ("Of these, those that have failed.", lambda report: report.failed),
    "elements_completed_total": ("Elements completed since the deployment.", lambda report: report.elements),
}  # fmt: skip
"""By name, without ``fame_``: help text and value of a series; one in ``_total`` grows until the next deployment."""


class Metrics:
    """What the last report says: call it with each. A collector of prometheus-client, which any thread may ask."""

    def __init__(self) -> None:
        self._report: Report | None = None
        self._heard = 0.0

    def __call__(self, report: Report) -> None:
        self._report, self._heard = report, monotonic()

    def collect(self) -> Iterator[Metric]:
        """Yield all metrics; those of a robot that has not reported have no samples."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, StateSetMetricFamily

        report = self._report
        if report is None:
            return
        labels = [report.robot]
        age = GaugeMetricFamily(
            "fame_report_age_seconds", "Age of the report that all this is from: over 5 s is silence.", labels=["robot"]
        )
        age.add_metric(labels, monotonic() - self._heard)
        yield age
        state = StateSetMetricFamily("fame_mission_state", "State of the engine and its mission.", labels=["robot"])
        state.add_metric(labels, {name: name == report.state for name in STATES})
        yield state
        for name, (text, value) in _SERIES.items():
            family = CounterMetricFamily if name.endswith("_total") else GaugeMetricFamily
            series = family(f"fame_{name}", text, labels=["robot"])
            series.add_metric(labels, value(report))
            yield series
        untaken = CounterMetricFamily(
            "fame_messages_untaken", "BPMN messages that no event has taken.", labels=["robot", "topic"]
        )
        for topic, count in report.untaken.items():
            untaken.add_metric([*labels, topic], count)
        yield untaken
        absent = GaugeMetricFamily(
            "fame_peer_absent_seconds", "For how long a robot of its team has had no engine.", labels=["robot", "peer"]
        )
        for peer, seconds in report.absent.items():
            absent.add_metric([*labels, peer], seconds)
        yield absent


@contextmanager
def serve_metrics(address: str, port: int) -> Iterator[Metrics]:
    """Serve metrics from a thread of their own, until the block ends.

    Raises UnavailableError without prometheus-client, and ConfigError for an address or port that cannot be opened.
    """
    require("prometheus_client")
    from prometheus_client import CollectorRegistry, start_http_server

    metrics, registry = Metrics(), CollectorRegistry()
    registry.register(metrics)
    try:
        server, thread = start_http_server(port, address, registry)
    except (OSError, OverflowError, ValueError) as error:  # the latter two: not a port, not the name of a host
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"--metrics {address}:{port} cannot be opened: {reason}") from None
    try:
        yield metrics
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
