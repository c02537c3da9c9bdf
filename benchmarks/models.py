"""Models for benchmarks of engines: generated, plain BPMN 2.0, any size.

Scripts and conditions are Python; `in_javascript` gives the same file with them in JavaScript. A process starts with
the variables `VARIABLES` and ends with those that its case expects.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from xml.sax.saxutils import escape, unescape

VARIABLES: Mapping[str, int] = MappingProxyType({"x": 0, "i": 0, "n": 0})

SIGNAL = '<signalEventDefinition signalRef="A"/>'
_TYPED = (
    '<extensionElements><c:properties><c:property name="type" value="geometry_msgs/msg/Vector3"/>{}'
    "</c:properties></extensionElements>"
)
_PAYLOAD = _TYPED.format('<c:property name="payload" value="{x: ${i}, y: 1.0}"/>')


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
        formal = 'xsi:type="tFormalExpression" language="python"'
        said = f"<conditionExpression {formal}>{escape(condition)}</conditionExpression>" if condition else ""
        ends = f'sourceRef="{source}" targetRef="{target}"'
        self.elements.append(f'<sequenceFlow id="{source}_{target}" {ends}>{said}</sequenceFlow>')

    def loop(self, count: int, body: Callable[[Drawing], object]) -> Drawing:
        """The body `count` times, then an end event."""
        self.put("exclusiveGateway", "m")
        body(self)
        self.script("i", "i = i + 1")
        self.put("exclusiveGateway", "g", attributes='default="g_e"')
        self.flow("g", "m", f"i < {count}")
        self.put("endEvent", "e")
        return self

    def xml(self, id: str = "P") -> str:
        """The process; only P is run by itself."""
        return f'<process id="{id}" isExecutable="{str(id == "P").lower()}">{"".join(self.elements)}</process>'


def started(attributes: str = "") -> Drawing:
    """A drawing with its start event."""
    drawing = Drawing()
    drawing.put("startEvent", "s", attributes)
    return drawing


def file(*processes: Drawing | str) -> str:
    """A file of processes, with the signal A."""
    text = "".join(item if isinstance(item, str) else item.xml() for item in processes)
    return (
        '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" xmlns:c="http://camunda.org/schema/1.0/bpmn" '
        'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" '
        f'id="D" targetNamespace="http://fame">{text}<signal id="A" name="A"/></definitions>'
    )


def in_javascript(text: str) -> str:
    """The same file with its scripts and conditions in JavaScript, for engines that offer ``environment``.

    The variables stand in one object, since some engines give each sub-process a copy of its own.
    """

    def put(pattern: str, form: str) -> None:
        nonlocal text

        def translated(found: re.Match[str]) -> str:
            names = re.sub(r"\b([a-z])\b", r"v.\1", unescape(found[1]))
            return escape(form.format("; ".join(names.splitlines())))

        text = re.sub(f"(?<={pattern})([^<]*)(?=</)", translated, text)

    put("<script>", "const v = environment.variables.v; {}; next();")
    put('language="python">', "const v = environment.variables.v; next(null, {});")
    return text.replace('"python"', '"javascript"')


_SCRIPT = re.compile(r'<scriptTask id="([^"]*)" [^>]*><script>([^<]*)</script></scriptTask>')


def in_services(text: str) -> str:
    """The same file for engines without script tasks: service tasks named by the Python code; conditions ``${...}``."""

    def service(found: re.Match[str]) -> str:
        name = found[2].replace("\n", "&#10;").replace('"', "&quot;")
        return f'<serviceTask id="{found[1]}" name="{name}" c:delegateExpression="${{code_{found[1]}}}"/>'

    return re.sub(r'language="python">([^<]*)<', r">${\1}<", _SCRIPT.sub(service, text))


# ---- models ------------------------------------------------------------------------------------------------------


def sequence(count: int) -> str:
    """Scripts in a row."""
    drawing = started()
    for number in range(count):
        drawing.script(f"t{number}", "x = x + 1")
    drawing.put("endEvent", "e")
    return file(drawing)


def gateways(count: int) -> str:
    """Exclusive gateways in a row: nothing but moves of a token."""
    drawing = started()
    for number in range(count):
        drawing.put("exclusiveGateway", f"g{number}")
    drawing.put("endEvent", "e")
    return file(drawing)


def loop(count: int) -> str:
    """A script in a loop with a condition."""
    return file(started().loop(count, lambda drawing: None))


def mixed(count: int, objects: bool = False) -> str:
    """Longer scripts, calls and conditions in a row; with `objects` tasks that read a data object, too."""
    drawing = started()
    if objects:
        drawing.elements.append(
            '<dataObjectReference id="d"><extensionElements><c:properties><c:property name="k" value="${x}"/>'
            "</c:properties></extensionElements></dataObjectReference>"
        )
    for n in range(count):
        drawing.script(f"a{n}", "a = x + 1\nb = a * 2\nc = [a, b]\nd = c[0]\nx = d - 1")
        drawing.put("callActivity", f"c{n}", attributes='calledElement="Q"')
        if objects:
            reads = f'<dataInputAssociation id="r{n}"><sourceRef>d</sourceRef></dataInputAssociation>'
            drawing.put("task", f"t{n}", reads)
        drawing.put("exclusiveGateway", f"g{n}", attributes=f'default="g{n}_d{n}"')
        drawing.script(f"d{n}", "x = x + 1")
        drawing.flow(f"g{n}", f"a{n + 1}" if n + 1 < count else "e", "x > 1000000")
    drawing.put("endEvent", "e")
    return file(drawing, called())


def called() -> str:
    """A process to call."""
    inner = Drawing()
    inner.put("startEvent", "q")
    inner.script("k", "x = x + 1")
    inner.put("endEvent", "z")
    return inner.xml("Q")


def forks(count: int) -> str:
    """Blocks of a fork into four scripts and a join."""
    drawing = started()
    for number in range(count):
        fork = drawing.put("parallelGateway", f"f{number}")
        drawing.elements.append(f'<parallelGateway id="j{number}"/>')
        for way in range(4):
            drawing.flow(drawing.script(f"t{number}_{way}", "x = x + 1", after=fork), f"j{number}")
        drawing.last = f"j{number}"
    drawing.put("endEvent", "e")
    return file(drawing)


def calls(count: int) -> str:
    """Calls in a loop."""
    call = 'calledElement="Q"'
    return file(started().loop(count, lambda drawing: drawing.put("callActivity", "c", attributes=call)), called())


def throws(count: int, typed: bool = False) -> str:
    """A throw in a loop, and a catch of it in another.

    In any order of tokens the catch is armed before the throw; and `i` is the number of throws for the catching token
    too, whether engines share variables, copy them, or send them along with the signal.
    """
    said, heard = (_PAYLOAD, _TYPED.format("")) if typed else ("", "")
    drawing = started()
    drawing.put("exclusiveGateway", "n")
    drawing.put("intermediateCatchEvent", "c", heard + SIGNAL)
    drawing.script("h", "n = n + 1")
    drawing.put("exclusiveGateway", "o", attributes='default="o_f"')
    drawing.flow("o", "n", f"i < {count}")
    drawing.put("endEvent", "f")
    drawing.put("exclusiveGateway", "m", after="s")
    drawing.script("k", "x = x + 1")
    drawing.script("i", "i = i + 1")
    drawing.put("intermediateThrowEvent", "t", said + SIGNAL)
    drawing.put("exclusiveGateway", "g", attributes='default="g_e"')
    drawing.flow("g", "m", f"i < {count}")
    drawing.put("endEvent", "e")
    return file(drawing)


def handling(interrupting: bool) -> str:
    """An event sub-process with a script."""
    inner = Drawing()
    inner.put("startEvent", "ht", SIGNAL, f'isInterrupting="{str(interrupting).lower()}"')
    inner.script("hk", "n = n + 1")
    inner.put("endEvent", "he")
    return f'<subProcess id="h" triggeredByEvent="true">{"".join(inner.elements)}</subProcess>'


def with_handler(tag: str, content: str = "") -> str:
    """The content of a sub-process: one element between start and end, and an interrupting event sub-process."""
    inner = Drawing()
    inner.put("startEvent", "ps")
    inner.put(tag, "pt", content)
    inner.put("endEvent", "pe")
    return "".join(inner.elements) + handling(True)


def inside(count: int) -> str:
    """A non-interrupting event sub-process, triggered by the process itself."""
    drawing = started().loop(count, lambda drawing: drawing.put("intermediateThrowEvent", "t", SIGNAL))
    drawing.elements.append(handling(False))
    return file(drawing)


def inside_interrupting(count: int) -> str:
    """An interrupting one in a sub-process, in a loop."""
    content = with_handler("intermediateThrowEvent", SIGNAL)
    return file(started().loop(count, lambda drawing: drawing.put("subProcess", "p", content)))


def outside(count: int) -> str:
    """A non-interrupting event sub-process beside a task that waits."""
    drawing = started()
    drawing.put("userTask", "u")
    drawing.put("endEvent", "e")
    drawing.elements.append(handling(False))
    return file(drawing)


def outside_interrupting(count: int) -> str:
    """An interrupting one in a sub-process that waits, in an endless loop."""
    drawing = started()
    drawing.put("exclusiveGateway", "m")
    drawing.put("subProcess", "p", with_handler("userTask"))
    drawing.flow("p", "m")
    return file(drawing)


def ten(count: int, signal: bool = False) -> str:
    """Ten scripts; with `signal` it starts a new instance for each."""
    drawing = started(SIGNAL if signal else "")
    for number in range(10):
        drawing.script(f"t{number}", "x = 1")
    drawing.put("endEvent", "e")
    return file(drawing)


@dataclass(frozen=True)
class Case:
    """A model in its largest size, and how it is driven.

    make       gives the model for a size
    signals    whether as many signals A from outside drive it as its size says
    instances  whether as many instances are started
    expected   variables at the end, of those whose value does not depend on how branches share them, from the size
    own        whether it is run on FAME alone
    """

    name: str
    make: Callable[[int], str]
    size: int
    signals: bool = False
    instances: bool = False
    expected: Callable[[int], Mapping[str, int]] = lambda size: {}
    own: bool = False


CASES = (
    Case("gateways", gateways, 1000),
    Case("sequence", sequence, 1000, expected=lambda size: {"x": size}),
    Case("loop", loop, 2_000, expected=lambda size: {"i": size}),
    Case("long loop", loop, 20_000, expected=lambda size: {"i": size}, own=True),
    Case("longest loop", loop, 200_000, expected=lambda size: {"i": size}, own=True),
    Case("mixed", mixed, 200, expected=lambda size: {"x": 2 * size}),
    Case("mixed, data objects", lambda size: mixed(size, True), 200, expected=lambda size: {"x": 2 * size}, own=True),
    Case("fork and join", forks, 500),
    Case("calls", calls, 1000, expected=lambda size: {"i": size, "x": size}),
    Case("throw and catch", throws, 1000),
    Case("throw and catch, typed", lambda size: throws(size, True), 1000, own=True),
    Case("event sub-process, inside", inside, 1000, expected=lambda size: {"n": size}),
    Case("interrupting, inside", inside_interrupting, 1000, expected=lambda size: {"n": size}),
    Case("event sub-process, outside", outside, 1000, signals=True, expected=lambda size: {"n": size}),
    Case("interrupting, outside", outside_interrupting, 1000, signals=True, expected=lambda size: {"n": size}),
    Case("instances", ten, 1000, instances=True, expected=lambda size: {"x": 1}),
    Case("instances, by signal", lambda size: ten(size, True), 1000, signals=True, own=True),
)
