"""The processing node: subscriptions and publications of a configuration, processors called at a fixed frequency.

A call without new samples is left out, unless the node has no inputs. A processor that raises loses its samples and is
called again at the next period; what it raised is reported. Calls are due on multiples of the period from the start. A
processor that takes longer than the period misses calls, which are counted and reported with their share; the next call
gets all that has arrived.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.dataclasses import dataclass
from fame.errors import ConfigError, FameError
from fame.middleware.interface import Middleware, Node, Publisher
from fame.monitor.arrays import Floats
from fame.monitor.pipeline.blindness import Blindness
from fame.monitor.pipeline.configuration import Configuration, Port
from fame.monitor.pipeline.fields import UnusableMessage, Writer, has_stamp, reader, stamp_of, writer
from fame.monitor.pipeline.input_node import InputNode, ThrottledReport, listen
from fame.monitor.pipeline.join import Joiner
from fame.monitor.pipeline.parameters import ParameterServer
from fame.monitor.pipeline.processor import Samples
from fame.monitor.pipeline.processors import as_samples, assign, close_processors, make_processors, pair
from fame.monitor.pipeline.run_trigger import RunTracker

_LAST_SECOND = 2.0**31
"""Seconds of builtin_interfaces/msg/Time end here."""


@dataclass(frozen=True, slots=True)
class _Publication:
    ports: tuple[Port, ...]
    publisher: Publisher
    writer: Writer


class Publications:
    """The publishers. `publish` sends what was computed, a message per sample and topic."""

    count: int

    def __init__(self, node: Node, ports: Sequence[Port], report: ThrottledReport) -> None:
        self._report, self.count = report, 0
        self._publications = []
        for topic in dict.fromkeys(port.topic for port in ports):
            of_it = tuple(port for port in ports if port.topic == topic)
            publisher = node.publisher(topic, of_it[0].type, of_it[0].qos)
            self._publications.append(
                _Publication(of_it, publisher, writer(of_it[0].type, [port.path for port in of_it]))
            )

    def publish(self, computed: Mapping[str, Samples]) -> None:
        """Send, by name of the output. What does not fit, or is not finite, is reported and not sent."""
        for publication in self._publications:
            there = [computed[port.name] for port in publication.ports if port.name in computed]
            if not there:
                continue
            lengths = {len(samples) for samples in there}
            if len(there) < len(publication.ports) or len(lengths) > 1:
                text = f"{publication.publisher.topic}: its outputs were not computed together; nothing is sent"
                self._report(f"together {publication.publisher.topic}", text)
                continue
            try:
                self._send(publication, there)
            except FameError as error:
                self._report(
                    f"unfit {publication.publisher.topic}", f"{publication.publisher.topic}: not sent: {error}"
                )

    def _send(self, publication: _Publication, there: Sequence[Samples]) -> None:
        names = next((item.names for item in there if item.names), ())
        channels = tuple(name.rpartition(".")[2] for name in names)
        finite = _finite_rows([item.values for item in there], there[0].stamps)
        if not finite.all():
            self._report(
                f"finite {publication.publisher.topic}", f"{publication.publisher.topic}: not sent: it is not finite"
            )
        rows = [np.ascontiguousarray(item.values[finite]) for item in there]  # as a middleware writes them
        stamps = there[0].stamps[finite].tolist()
        for index, stamp in enumerate(stamps):
            message = publication.writer.message([item[index] for item in rows], stamp, channels)
            publication.publisher.publish(message)
        self.count += len(stamps)


def _finite_rows(arrays: Sequence[Any], stamps: Floats) -> Any:
    """Return which rows are finite in all arrays, at a time that a message can hold."""
    finite = np.isfinite(stamps) & (np.abs(stamps) < _LAST_SECOND)
    for values in arrays:
        if values.dtype.kind == "f":
            finite &= np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
    return finite


class ProcessingNode(InputNode):
    """The node. It lives until `close`; `report` gets a line for everything unusual.

    `processors` stand in for those of the configuration, if given; `on_blind` gets what keeps the node from judging
    (`fame.monitor.pipeline.blindness`). A processor may say so by an attribute `blind`, a text. Raises ConfigError and
    MessageError before anything runs.
    """

    processors: list[Any]
    calls: int
    missed: int

    def __init__(
        self,
        middleware: Middleware,
        scheduler: Scheduler,
        configuration: Configuration,
        *,
        processors: Sequence[Any] | None = None,
        namespace: str = "",
        report: Callable[[str], object] = lambda text: None,
        on_blind: Callable[[str], object] = lambda text: None,
    ) -> None:
        self.processors = list(processors) if processors is not None else make_processors(configuration)
        self._assigned = assign(self.processors, configuration)
        self._by_phase = [each for each in self.processors if getattr(each, "needs_elements", False)]
        self._by_run = [each for each in self.processors if hasattr(each, "runs")]
        super().__init__(
            middleware, scheduler, configuration, namespace=namespace, report=report, outputs=configuration.outputs,
            elements=bool(self._by_phase),
        )  # fmt: skip
        for processor in self.processors:
            if hasattr(processor, "report"):
                processor.report = partial(self._on_processor_report, type(processor).__name__)
        try:
            self._publications = Publications(self.node, configuration.outputs, self.report)
            self._parameters = ParameterServer(self.node, self.processors, self.report)
            self._blindness = Blindness(middleware, self.node, self.configuration.name, on_blind)
            self._runs = RunTracker(configuration.run) if configuration.run is not None else None
            if configuration.trigger is not None and self._runs is not None:
                listen(self.node, configuration.trigger, partial(self._on_trigger, self._runs, configuration.trigger))
        except BaseException:
            super().close()
            raise
        self._joiner = Joiner(configuration.join, self.report) if configuration.join is not None else None
        self.calls = self.missed = 0
        self._raised, self._doubts = "", dict[str, str]()
        self._period = round(SECOND / configuration.frequency)
        self._due = scheduler.now + self._period
        self._entries: list[Entry] = [
            scheduler.at(self._due, self._call, Kind.TIMER),
            scheduler.after(SECOND, self._check_rates, Kind.TIMER),
        ]

    @property
    def published(self) -> int:
        return self._publications.count

    def close(self) -> None:
        """Close all endpoints, and what its processors have opened."""
        for entry in self._entries:
            entry.cancel()
        close_processors(self.processors)
        super().close()

    def set(self, name: str, value: Any) -> Any:
        """Set a parameter, as `fame param set` does. Raises ConfigError."""
        return self._parameters.set(name, value)

    def _check_rates(self) -> None:
        self.check_rates()
        self._entries[1] = self.scheduler.after(SECOND, self._check_rates, Kind.TIMER)
        said = [self._raised, *(str(getattr(each, "blind", "")) for each in self.processors)]
        before, self._doubts = self._doubts, {_without_numbers(text): text for text in said if text}
        lasting = {kind: text for kind, text in self._doubts.items() if kind in before}  # not of one window alone
        self._blindness.look(self.unseen() | lasting, self.scheduler.now)

    def _on_processor_report(self, who: str, text: str) -> None:
        self.report(_without_numbers(f"{who} {text}"), f"{who}: {text}")

    def _on_trigger(self, runs: RunTracker, port: Port, message: Any) -> None:
        stamp = stamp_of(message) if has_stamp(port.type) else 0.0
        try:
            runs.feed(stamp or self.scheduler.now / SECOND, reader(port.type, port.path)(message)[0])
        except UnusableMessage as reason:
            self.report(f"unusable {port.topic} {reason}", f"{port.topic}: a message is left out: {reason}")

    def _call(self) -> None:
        if not self.calls:  # other nodes of the process may have been made in between
            self._due = self.scheduler.now
        late = max(0, (self.scheduler.now - self._due) // self._period)
        if late:
            self.missed += late
            share = 100 * self.missed / (self.calls + self.missed + 1)
            self.report(
                "slow", f"slower than its period of {self._period / 1e6:g} ms: {share:.3g} % of its calls missed"
            )
        self._due += (late + 1) * self._period
        self.calls += 1
        inputs = self.take() if self._joiner is None else self._joiner.feed(self.take())
        if not inputs or self._by_phase or any(map(len, inputs.values())):
            self._execute(inputs)
        self._entries[0] = self.scheduler.at(self._due, self._call, Kind.TIMER)

    def _execute(self, inputs: Mapping[str, Samples]) -> None:
        current: Mapping[str, Any] = inputs
        for processor in self._by_phase:
            processor.elements, processor.lost = self.follower.changes, self.follower.lost
        if self._runs is not None:
            for processor in self._by_run:
                processor.runs = self._runs.spans
        latest = max((float(item.stamps[-1]) for item in inputs.values() if len(item)), default=None)
        stamp = self.scheduler.now / SECOND if latest is None else latest
        for processor in self.processors:
            who = type(processor).__name__
            try:
                result = processor.execute(current)
                current = {name: as_samples(value, stamp) for name, value in (result or {}).items()}
            except Exception as error:
                reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
                text = self._raised = f"{who} raised {' '.join(reason.split())}; nothing is sent"
                self.report(_without_numbers(text), text)
                return
            if not current:
                return
        self._raised = ""
        try:
            self._publications.publish(self._by_output(current))
        except Exception as error:  # what a processor gives may be anything
            text = f"what {type(self.processors[-1]).__name__} gives cannot be sent: {type(error).__name__}: {error}"
            self.report(_without_numbers(text), text)

    def _by_output(self, computed: Mapping[str, Samples]) -> dict[str, Samples]:
        """Return what was computed by name of the output."""
        assigned = self._assigned
        if assigned is None:
            outputs, who = self.configuration.outputs, type(self.processors[-1]).__name__
            try:
                assigned = pair(tuple(computed), outputs, who)
            except ConfigError as error:
                self.report(f"output {error}", str(error))
                return {}
        return {assigned[name]: samples for name, samples in computed.items() if name in assigned}


def _without_numbers(text: str) -> str:
    """Return a text without its numbers: reports that differ in them alone are the same."""
    return re.sub(r"\d[\d.]*", "#", text)
