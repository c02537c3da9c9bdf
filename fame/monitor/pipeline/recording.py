"""The recording node: what a configuration calls Inputs, into files and databases; live, or from a bag."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import partial
from itertools import chain, islice
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from time import time_ns
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from fame.clock import SECOND, Entry, Kind, Scheduler, WallScheduler
from fame.dataclasses import dataclass, replace
from fame.errors import ConfigError
from fame.middleware import messages
from fame.middleware.interface import Middleware, resolve
from fame.middleware.local import LocalMiddleware
from fame.middleware.typesystem import STRING
from fame.monitor.pipeline.configuration import Configuration, Port, load
from fame.monitor.pipeline.input_node import InputNode, LeftOut
from fame.monitor.pipeline.sinks import BagWriter, CsvFile, Influx, Row, RowsStored
from fame.robot.robot_state import EVENTS_TOPIC

if TYPE_CHECKING:
    from fame.monitor.data_files import LabelledRun

FLUSH = 0.1
"""How long (s) a row may wait before it is on disk."""

_PAUSE = 5 * SECOND
EMPTY = "std_msgs/msg/Empty"


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingOptions:
    """Options of a `RecordingNode`.

    namespace  of relative topics
    append     go on with a CSV file that is there
    run_topic  a message on it (std_msgs/msg/Empty) begins the next run; one on `end_topic` ends it
    ordered    leave out messages whose stamps do not grow
    elements   add to CSV files the active element of the mission, by the topic ``bpmn_events`` of the robot
    report     gets a line for everything unusual
    """

    namespace: str = ""
    append: bool = False
    run_topic: str = ""
    end_topic: str = ""
    ordered: bool = True
    elements: bool = False
    report: Callable[[str], object] = lambda text: None


class RecordingNode(InputNode):
    """The recording node. It lives until `close`.

    outputs  where to: ``.csv``; a folder, which becomes a bag of ROS 2; ``.mcap``; ``http://host:8086/database``
    """

    done: bool = False
    """Whether nothing more is wanted."""
    rows: int
    run: int

    def __init__(
        self,
        middleware: Middleware,
        scheduler: Scheduler,
        configuration: Configuration,
        outputs: Sequence[str | Path] = (),
        options: RecordingOptions | None = None,
        name: str = "",
    ) -> None:
        options, configuration = options or RecordingOptions(), replace(configuration, inputs=configuration.recorded)
        if not configuration.inputs:
            raise ConfigError("has no Inputs to record", file=str(configuration.file), element="Inputs")
        self.rows, self.run, self._begun = 0, 0, False
        self._first, self._length = inf, inf
        self._stop: Callable[[], object] = lambda: None
        self._outputs: list[CsvFile | Influx | BagWriter] = []
        self._entry: Entry | None = None
        super().__init__(
            middleware, scheduler, configuration, name or f"{configuration.name}_recorder",
            namespace=options.namespace, report=options.report, elements=options.elements, on_sample=self._on_sample,
            ordered=options.ordered,
        )  # fmt: skip
        ports = {resolve(port.topic, options.namespace): port for port in configuration.inputs}
        try:
            for output in outputs:
                self._outputs.append(self._open(output, options))
            self._sinks = [each for each in self._outputs if not isinstance(each, BagWriter)]
            self._bags = [each for each in self._outputs if isinstance(each, BagWriter)]
            for topic, port in ports.items() if self._bags else ():
                if not port.service:
                    self.node.subscription(topic, port.type, partial(self._message, topic), port.qos)
            for topic, handler in ((options.run_topic, self.begin), (options.end_topic, self.end)):
                if topic:
                    self.handlers[self.node.subscription(topic, EMPTY, handler).topic] = handler
        except BaseException:
            RecordingNode.close(self)
            raise
        self._watched = scheduler.now
        self._entry = self._flush_later()

    def end_after(self, seconds: float, stop: Callable[[], object]) -> None:
        """Call `stop` when stamps of that length have been recorded, or when nothing has come for as long."""
        self._length, self._stop = seconds, stop
        self._look()

    def _look(self, rows: int = -1) -> None:
        """Stop if there are no more rows than before, else look again."""
        if self.rows == rows:
            self._stop()
        else:
            self.scheduler.after(round(self._length * SECOND), partial(self._look, self.rows), Kind.TIMER)

    def begin(self, message: Any = None) -> None:
        self.run += self._begun
        self._begun = False

    def end(self, message: Any = None) -> None:
        """End the run; what comes until the next is recorded with it."""

    def wait(self, until: int) -> None:
        """Let simulated time pass without messages. It may be years: once silence is reported, nothing is done."""
        if until - self.scheduler.now > _PAUSE:
            self.scheduler.run(self.scheduler.now + _PAUSE)
            self._stop_flushing()
            self.scheduler.run(until)
            self._flush()
        self.scheduler.run(until)

    def close(self) -> None:
        """Write what is left and close all endpoints."""
        self._stop_flushing()
        super().close()
        for output in self._outputs:
            output.close()

    @property
    def recorded_runs(self) -> int:
        """How many runs have rows."""
        return self.run + self._begun

    @property
    def stored(self) -> list[RowsStored]:
        """What each output has, in their order, once the node is closed."""
        return [each.stored for each in self._outputs]

    @property
    def is_whole(self) -> bool:
        """Whether every output has all that came: no row is missing, no message was left out but of joints that the
        configuration does not name. Bags have messages that are left out of rows."""
        lost = any(each.number > each.unwanted for each in self.left_out)
        return all(each.whole for each in self.stored) and not (lost and self._sinks)

    def _open(self, output: str | Path, options: RecordingOptions) -> CsvFile | Influx | BagWriter:
        path, configuration, ports = Path(output), self.configuration, self.configuration.inputs
        if "://" in str(output):
            place = re.sub(r"\W+", "_", str(output).partition("://")[2])  # what waits for one must not go to another
            spool = configuration.folder / f".{configuration.name}_influx_{place}"
            live = isinstance(self.scheduler, WallScheduler)
            origin = time_ns() - self.scheduler.now if live else 0
            return Influx(str(output), spool, configuration.name, self.report.always, origin=origin)
        if path.suffix == ".csv":
            follower = self.follower if options.elements else None
            return CsvFile(
                path, ports, self.report, self._now, append=options.append, follower=follower,
                trigger=configuration.trigger,
            )  # fmt: skip
        if path.suffix in ("", ".mcap"):
            return BagWriter(path, ports, [resolve(port.topic, options.namespace) for port in ports])
        text = f"expected .csv, .mcap, no ending (a bag) or http://, got {path.suffix!r}"
        raise ConfigError(text, file=str(output))

    def _now(self) -> float:
        return self.scheduler.now / SECOND

    def _on_sample(self, ports: Sequence[Port], stamp: float, values: Sequence[Any], names: Any) -> None:
        row = Row(stamp, self.run, ports, values, tuple(names))
        self.rows += 1
        self._begun = True
        self._first = min(self._first, stamp)
        if stamp - self._first >= self._length:
            self._stop()
        for sink in self._sinks:
            sink.put(row)
        if ports[0].service:  # bags have its calls as messages
            topic = next(each.topic for each in self.streams if each.ports == ports)
            self._message(topic, messages.create(ports[0].type, {"data": bool(values[0])}))

    def _message(self, topic: str, message: Any) -> None:
        for bag in self._bags:
            bag.put(topic, self._now(), message)

    def _flush(self) -> None:
        for sink in self._sinks:
            sink.flush()
        if self.scheduler.now - self._watched >= SECOND:
            self._watched = self.scheduler.now
            self.check_rates()
        self._entry = self._flush_later()

    def _flush_later(self) -> Entry | None:
        """Flush later, unless there are no outputs: simulated time without messages may then end."""
        return self.scheduler.after(round(FLUSH * SECOND), self._flush, Kind.TIMER) if self._outputs else None

    def _stop_flushing(self) -> None:
        if self._entry is not None:
            self._entry.cancel()


def record_bag(
    bag: Path, configuration: Configuration, outputs: Sequence[str | Path], options: RecordingOptions | None = None
) -> RecordingNode:
    """Record from a bag, as fast as it can be read. Returns the node, which is closed.

    Raises ConfigError, of a damaged bag before a row is written: it is read twice.
    """
    from fame.monitor.data_files import incomplete, read_bag

    options = options or RecordingOptions()
    make = partial(RecordingNode, configuration=configuration, outputs=outputs, options=options)
    if any(Path(output).suffix != ".csv" and "://" not in str(output) for output in outputs):
        raise ConfigError("with --bag, expected a .csv file or a database as output", file=str(bag))
    for text in incomplete(bag):
        options.report(text)
    topics = [(port.topic, port.type) for port in configuration.recorded]
    topics += [(options.run_topic, EMPTY)] if options.run_topic else []
    topics += [(EVENTS_TOPIC, STRING)] if options.elements else []
    types = {resolve(topic, options.namespace): type for topic, type in topics}
    for _ in read_bag(bag, types):
        pass
    return play(bag, make, types)


class BagTables(NamedTuple):
    """Files, and of those that are made of bags what was left out."""

    paths: tuple[str, ...]
    left_out: Mapping[str, tuple[LeftOut, ...]]

    def completed(self, runs: Sequence[LabelledRun], columns: Sequence[str]) -> list[LabelledRun]:
        """Return runs of these files, with what was left out of the topics of their columns."""
        return [self._completed(run, columns) for run in runs]

    def _completed(self, run: LabelledRun, columns: Sequence[str]) -> LabelledRun:
        found = [each for each in self.left_out.get(run.file, ()) if each.concerns(columns)]
        return run._replace(
            seconds=run.seconds + max((each.unseen for each in found), default=0.0),
            seen=min([run.seen, *(each.seen for each in found)]), notes=(*run.notes, *(each.text for each in found)),
        )  # fmt: skip


@contextmanager
def tables_of(
    paths: Sequence[str | Path], configuration: Path | None, options: RecordingOptions
) -> Iterator[BagTables]:
    """Yield files with a CSV file for each bag, by the Inputs of a configuration; without one, bags are not converted.

    The CSV files last until the block ends; an error about one names its bag. Raises ConfigError.
    """
    from fame.monitor.data_files import is_bag

    tables, bags, left_out = list(map(str, paths)), dict[str, str](), dict[str, tuple[LeftOut, ...]]()
    with TemporaryDirectory(prefix="fame-bags-") as folder:
        for number, path in enumerate(map(Path, tables)):
            if configuration is not None and is_bag(path):
                table = Path(folder) / str(number) / f"{path.name}.csv"
                table.parent.mkdir()
                node = record_bag(path, load(configuration), [table], options)
                tables[number], bags[str(table)] = str(table), str(path)
                left_out[str(table)] = node.left_out
                if not node.rows:
                    why = "; ".join(each.text for each in node.left_out)
                    raise ConfigError(why or f"has no messages on {', '.join(node.handlers)}", file=str(path))
        try:
            yield BagTables(tuple(tables), left_out)
        except ConfigError as error:
            if error.file not in bags:
                raise
            raise ConfigError(error.text, file=bags[error.file], element=error.element) from None


Playing = TypeVar("Playing", bound=RecordingNode)


def play(bag: Path, make: Callable[[Middleware, Scheduler], Playing], topics: Mapping[str, str]) -> Playing:
    """Pass the messages of a bag on some topics (full name -> type) to a node, in the time of the bag, until it is
    done. Returns the node, which is closed. Raises ConfigError."""
    from fame.monitor.data_files import read_bag

    with closing(read_bag(bag, topics)) as messages:
        first = list(islice(messages, 1))  # before any file is made: what is wrong with the bag is known now
        scheduler = Scheduler()
        scheduler.now = round(first[0][0] * SECOND) if first else 0
        node = make(LocalMiddleware(scheduler), scheduler)
        try:
            for time, topic, message in chain(first, messages):
                node.wait(until=round(time * SECOND))
                node.handlers[topic](message)
                if node.done:
                    break
        finally:
            node.close()
    return node
