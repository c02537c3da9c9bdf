"""How many flow nodes the engine passes in a second: one JSON line per model.

Each model is generated and run on the bare engine (`--face engine`: a host without clock and topics), through
`fame.Simulation` (`--face simulation`) and with its log on (`--face log`). A line tells flow nodes per second
(completed elements, scripts included; the best of several runs, since noise only ever slows), the CPU and wall time of
that run in seconds, and the peak memory of the process so far in MB.

    python benchmarks/engine.py
    python benchmarks/engine.py --only loop --face engine
"""

from __future__ import annotations

import argparse
import gc
import json
import resource
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import fame
from fame.bpmn import read_text
from fame.bpmn.model import Definitions, Expression
from fame.engine import Engine, compile_program
from fame.scripting import compile_expression, compile_script, interface

ROUNDS = 5
FACES = ("engine", "simulation", "log")
TYPED = (
    '<extensionElements><c:properties><c:property name="type" value="geometry_msgs/msg/Vector3"/>{}'
    "</c:properties></extensionElements>"
)
PAYLOAD = TYPED.format('<c:property name="payload" value="{x: ${i}, y: 1.0}"/>')

# ---- models ------------------------------------------------------------------------------------------------------


@dataclass
class Drawing:
    """Elements of a process, each linked to the one before it."""

    elements: list[str] = field(default_factory=list)
    last: str = ""

    def put(self, tag: str, id: str, content: str = "", attributes: str = "", after: str | None = None) -> str:
        """An element, with a sequence flow from the last one (or from `after`)."""
        self.elements.append(f'<{tag} id="{id}" {attributes}>{content}</{tag}>')
        source = self.last if after is None else after
        if source:
            self.flow(source, id)
        self.last = id
        return id

    def script(self, id: str, text: str, after: str | None = None) -> str:
        return self.put("scriptTask", id, f"<script>{escape(text)}</script>", 'scriptFormat="python"', after)

    def flow(self, source: str, target: str, condition: str = "") -> None:
        said = f"<conditionExpression>{escape(condition)}</conditionExpression>" if condition else ""
        ends = f'sourceRef="{source}" targetRef="{target}"'
        self.elements.append(f'<sequenceFlow id="{source}_{target}" {ends}>{said}</sequenceFlow>')

    def loop(self, count: int, body: Callable[[Drawing], object]) -> Drawing:
        """The body `count` times, then an end event."""
        self.put("startEvent", "s")
        self.put("exclusiveGateway", "m")
        body(self)
        self.script("i", "i = i + 1")
        self.put("exclusiveGateway", "g", attributes='default="g_e"')
        self.flow("g", "m", f"i < {count}")
        self.put("endEvent", "e")
        return self

    def xml(self, id: str = "P") -> str:
        return f'<process id="{id}" isExecutable="{str(id == "P").lower()}">{"".join(self.elements)}</process>'


def definitions(*processes: Drawing | str) -> Definitions:
    """A file of processes, with the signal A."""
    text = "".join(item if isinstance(item, str) else item.xml() for item in processes)
    return read_text(
        '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" xmlns:c="http://camunda.org/schema/1.0/bpmn" '
        f'id="D" targetNamespace="http://fame">{text}<signal id="A" name="A"/></definitions>',
        file="generated.bpmn",
    )


SIGNAL = '<signalEventDefinition signalRef="A"/>'


def sequence(count: int, text: str = "x = x + 1") -> Definitions:
    """Scripts in a row."""
    drawing = Drawing()
    drawing.put("startEvent", "s")
    for number in range(count):
        drawing.script(f"t{number}", text)
    drawing.put("endEvent", "e")
    return definitions(drawing)


def loop(count: int) -> Definitions:
    """A script in a loop with a condition."""
    return definitions(Drawing().loop(count, lambda drawing: None))


def mixed(count: int) -> Definitions:
    """Longer scripts, calls, conditions and data objects in a row."""
    drawing = Drawing()
    drawing.elements.append(
        '<dataObjectReference id="d"><extensionElements><c:properties><c:property name="k" value="${x}"/>'
        "</c:properties></extensionElements></dataObjectReference>"
    )
    drawing.put("startEvent", "s")
    reads = '<dataInputAssociation id="r{0}"><sourceRef>d</sourceRef></dataInputAssociation>'
    for n in range(count):
        drawing.script(f"a{n}", "a = x + 1\nb = a * 2\nc = [a, b]\nd = c[0]\nx = d - 1")
        drawing.put("callActivity", f"c{n}", attributes='calledElement="Q"')
        drawing.put("task", f"t{n}", reads.format(n))
        drawing.put("exclusiveGateway", f"g{n}", attributes=f'default="g{n}_d{n}"')
        drawing.script(f"d{n}", "x = x + 1")
        drawing.flow(f"g{n}", f"a{n + 1}" if n + 1 < count else "e", "x > 1000000")
    drawing.put("endEvent", "e")
    return definitions(drawing, CALLED)


def called() -> str:
    inner = Drawing()
    inner.put("startEvent", "q")
    inner.script("k", "x = x + 1")
    inner.put("endEvent", "z")
    return inner.xml("Q")


CALLED = called()


def forks(count: int) -> Definitions:
    """Blocks of a fork into four scripts and a join."""
    drawing = Drawing()
    drawing.put("startEvent", "s")
    for number in range(count):
        fork = drawing.put("parallelGateway", f"f{number}")
        drawing.elements.append(f'<parallelGateway id="j{number}"/>')
        for way in range(4):
            drawing.flow(drawing.script(f"t{number}_{way}", "x = x + 1", after=fork), f"j{number}")
        drawing.last = f"j{number}"
    drawing.put("endEvent", "e")
    return definitions(drawing)


def calls(count: int) -> Definitions:
    """Calls in a loop."""
    drawing = Drawing().loop(count, lambda drawing: drawing.put("callActivity", "c", attributes='calledElement="Q"'))
    return definitions(drawing, CALLED)


def throws(count: int, said: str = "", heard: str = "") -> Definitions:
    """A throw in a loop, and a catch of it in another."""
    drawing = Drawing().loop(count, lambda drawing: drawing.put("intermediateThrowEvent", "t", said + SIGNAL))
    drawing.put("exclusiveGateway", "n", after="s")
    drawing.put("intermediateCatchEvent", "c", heard + SIGNAL)
    drawing.script("h", "n = n + 1")
    drawing.put("exclusiveGateway", "o", attributes='default="o_f"')
    drawing.flow("o", "n", f"n < {count}")
    drawing.put("endEvent", "f")
    return definitions(drawing)


def handling(interrupting: bool) -> str:
    """An event sub-process with a script."""
    inner = Drawing()
    inner.put("startEvent", "ht", SIGNAL, f'isInterrupting="{str(interrupting).lower()}"')
    inner.script("hk", "n = n + 1")
    inner.put("endEvent", "he")
    return f'<subProcess id="h" triggeredByEvent="true">{"".join(inner.elements)}</subProcess>'


def inside(count: int) -> Definitions:
    """A non-interrupting event sub-process, triggered by the process itself."""
    drawing = Drawing().loop(count, lambda drawing: drawing.put("intermediateThrowEvent", "t", SIGNAL))
    drawing.elements.append(handling(False))
    return definitions(drawing)


def inside_interrupting(count: int) -> Definitions:
    """An interrupting one in a sub-process, in a loop."""
    inner = '<intermediateThrowEvent id="t">' + SIGNAL + "</intermediateThrowEvent>" + handling(True)
    return definitions(Drawing().loop(count, lambda drawing: drawing.put("subProcess", "p", inner)))


def outside() -> Definitions:
    """A non-interrupting event sub-process beside a task that waits."""
    drawing = Drawing()
    drawing.put("startEvent", "s")
    drawing.put("userTask", "u")
    drawing.elements.append(handling(False))
    return definitions(drawing)


def outside_interrupting() -> Definitions:
    """An interrupting one in a sub-process that waits, in an endless loop."""
    drawing = Drawing()
    drawing.put("startEvent", "s")
    drawing.put("exclusiveGateway", "m")
    drawing.put("subProcess", "p", '<userTask id="u"/>' + handling(True))
    drawing.flow("p", "m")
    return definitions(drawing)


def instances() -> Definitions:
    """Ten scripts, started by a signal."""
    drawing = Drawing()
    drawing.put("startEvent", "s", SIGNAL)
    for number in range(10):
        drawing.script(f"t{number}", "x = 1")
    drawing.put("endEvent", "e")
    return definitions(drawing)


@dataclass(frozen=True)
class Case:
    """A model, and how many signals from outside drive it."""

    name: str
    make: Callable[[], Definitions]
    signals: int = 0


CASES = (
    Case("sequence 1000", lambda: sequence(1000)),
    Case("loop 2k", lambda: loop(2_000)),
    Case("loop 20k", lambda: loop(20_000)),
    Case("loop 200k", lambda: loop(200_000)),
    Case("mixed 200", lambda: mixed(200)),
    Case("fork and join 500", lambda: forks(500)),
    Case("calls 1000", lambda: calls(1000)),
    Case("throw and catch 1000", lambda: throws(1000)),
    Case("throw and catch 1000, typed", lambda: throws(1000, PAYLOAD, TYPED.format(""))),
    Case("event sub-process, from inside", lambda: inside(1000)),
    Case("event sub-process, from inside, interrupting", lambda: inside_interrupting(1000)),
    Case("event sub-process, from outside", outside, 1000),
    Case("event sub-process, from outside, interrupting", outside_interrupting, 1000),
    Case("instances 1000", instances, 1000),
)

# ---- faces -------------------------------------------------------------------------------------------------------


class Host:
    """A world without time and topics, for the engine alone."""

    def __init__(self, types: dict[str, str]) -> None:
        self.types, self.instances = types, []

    def compile(self, expression: Expression, *, element: str, file: str, script: bool = False) -> Any:
        compiler = compile_script if script else compile_expression
        return compiler(expression, file=file, element=element)

    def publish(self, topic: str, value: Any) -> Any:
        from fame.middleware import messages

        type = self.types.get(topic)
        return value if type is None else messages.create(type, value)

    def observe(self, instance: int, scope: int, element: str, what: str, detail: Any = None) -> None:
        pass

    def ended(self, instance: Any) -> None:
        self.instances.append(instance)

    def make_safe(self, reason: str) -> None:
        pass


VARIABLES = {"x": 0, "i": 0, "n": 0}


def on_engine(model: Definitions, signals: int) -> tuple[float, float, int]:
    """CPU and wall seconds, and completed elements, on the bare engine."""
    from fame.bpmn.topics import topic_table

    process = model.process("P")
    assert process is not None
    types = {name: use.declared for name, use in topic_table(model).items() if use.declared}
    host: Any = Host(types)

    def library(name: str, file: str, call: Any) -> Any:
        return model.process(call.called), file

    program = compile_program(process, host=host, library=library)
    builtins = interface(robot=None, signal=print, log=lambda level, text: None)
    engine = Engine(program, host, lambda: {"__builtins__": builtins})

    def run() -> None:
        engine.begin(VARIABLES)
        for _ in range(signals):
            engine.deliver("/A", None)

    cpu, wall = timed(run)
    done = [*host.instances, *engine.instances.values()]
    return cpu, wall, sum(sum(instance.visits.values()) for instance in done)


def on_simulation(model: Definitions, signals: int, log: bool = False) -> tuple[float, float, int]:
    """The same through `fame.Simulation`, with or without its log."""
    events: list[Any] = []
    simulation = fame.Simulation(model, "P", VARIABLES, observer=events.append if log else None)

    def run() -> None:
        simulation.run()
        for _ in range(signals):
            simulation.signal("A")

    cpu, wall = timed(run)
    return cpu, wall, sum(sum(instance.visits.values()) for instance in simulation.instances)


def timed(run: Callable[[], None]) -> tuple[float, float]:
    """CPU and wall seconds of a call."""
    gc.collect()
    wall, cpu = time.perf_counter(), time.process_time()
    run()
    return time.process_time() - cpu, time.perf_counter() - wall


def measure(case: Case, face: str, rounds: int) -> dict[str, Any]:
    """The best of several runs."""
    model = case.make()
    run = {"engine": on_engine, "simulation": on_simulation, "log": lambda *said: on_simulation(*said, log=True)}[face]
    found = [run(model, case.signals) for _ in range(rounds)]
    cpu, wall, elements = min(found)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"case": case.name, "face": face, "elements": elements, "per_second": round(elements / cpu),
            "cpu": round(cpu, 5), "wall": round(wall, 5), "peak_mb": round(peak)}  # fmt: skip


def reading(count: int, rounds: int) -> dict[str, Any]:
    """Parsing and compiling, until the first token could move."""
    source = sequence(count).source.decode()

    def read() -> None:
        fame.Simulation(read_text(source, file="generated.bpmn"), "P")

    cpu, wall = min(timed(read) for _ in range(rounds))
    return {"case": f"read and compile {count}", "face": "simulation", "elements": count,
            "per_second": round(count / cpu), "cpu": round(cpu, 5), "wall": round(wall, 5)}  # fmt: skip


def lines(only: str, faces: tuple[str, ...], rounds: int) -> Iterator[dict[str, Any]]:
    """The results, one at a time."""
    for case in CASES:
        if only in case.name:
            for face in faces:
                yield measure(case, face, rounds)
    for count in (1000, 10_000):
        if only in f"read and compile {count}":
            yield reading(count, min(rounds, 3))


def main() -> None:
    parser = argparse.ArgumentParser(description="Flow nodes per second.")
    parser.add_argument("--only", default="", help="models with this in their name")
    parser.add_argument("--face", choices=FACES, action="append", help="engine, simulation or log (default: all)")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    arguments = parser.parse_args()
    for line in lines(arguments.only, tuple(arguments.face or FACES), arguments.rounds):
        print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()
