"""Collaborations built from steps, for tests and benchmarks of the exploration.

A robot is a list of steps::

    "throw x"       throws signal x                  "catch x"      waits for it
    "work"          takes time                       "fail c"       takes time, and may raise error code c
    "queue x"       waits for x, keeps the last 10   "timer PT5S"   waits
    "run x = 1"     a script                         "person"       a user task
    ("and", A, B)   branches in parallel             ("or", A, B)   one of them, by an unknown value
    ("if", C, A, B) A if condition C, else B         ("race", A, B) the first whose catch or timer comes
    ("loop", A)     again and again, or not          ("while", A)   forever
    "send m"        throws message m                 "receive m"    waits for it
    ("some", A, B)  an inclusive gateway: A, B, both or neither, by an unknown value
    ("each", N, A)  a sub-process A for each of N at once; ("turns", N, A) one after the other
    ("call", P)     calls process P
    ("scope", A, t, H)  a sub-process A with an interrupting event sub-process H; "beside": a non-interrupting one
    ("guard", A, t, H)  A with an interrupting boundary event that leads to H; "watch": a non-interrupting one
    "stop"          terminate                        "end"          an end event in a branch
    "error c"       an error end event               "raise c"      a script that may raise error code c, in no time
    "crash"         a script that may fail           "say x"        a script that throws signal x
    "escalate e"    throws an escalation             "undo"         throws compensation
    "until C"       waits for a condition            "jump"         a link
    ("done", A, H)  a sub-process A with a compensation handler H
    ("deal", A, H)  a transaction A, H after its cancellation; "cancel": a cancel end event
    ("mapped", P)   calls process P with variables of its own
    ("first", A, C) a sub-process A for each of two at once, until a condition C; "again": twice while it holds
    ("both", x, y)  waits for two signals in any order
    ("pause", A, t, H)  a sub-process A that a trigger suspends for H
    ("any", A, B)   branches in parallel, of which the first goes on
    ("adhoc", A, B) an ad-hoc sub-process of two sub-processes, one after the other

A trigger t is a signal ``x``, ``message m``, ``timer PT5S``, ``error c``, ``escalation e`` or ``condition C``;
``error`` and ``escalation`` are those of any code. The first step may be ``start x``: the robot starts with that
signal.

What is unknown to an exploration has values in a model that is made with `drawn`, a source of random numbers: times,
decisions, and whether something fails. Such a model has the same elements, and one of the runs that are explored.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import count
from random import Random
from typing import Any
from xml.sax.saxutils import escape, quoteattr

from bpmn_text import NAMESPACES

import fame
from fame.bpmn.model import Definitions

TIMES = (0.5, 1, 2, 3, 5)
"""Times that are drawn, s."""
CODES = ("c", "d")
"""Error codes."""
ODD_CODES = (*CODES, "no-go", 'it\'s "off"', "script")
ESCALATIONS = ("e", "f-1")
Step = Any
Steps = Sequence[Step]


class _Process:
    """The elements of one process, as text."""

    def __init__(self, robot: str, drawn: Random | None = None) -> None:
        self.robot, self.text, self.signals, self.messages = robot, list[str](), set[str](), set[str]()
        self.drawn = drawn
        self._numbers = count(1)

    def id(self, kind: str) -> str:
        return f"{self.robot}_{kind}_{next(self._numbers)}"

    def node(self, tag: str, inner: str = "", attributes: str = "", kind: str = "") -> str:
        id = self.id(kind or tag)
        self.text.append(f'<{tag} id="{id}" {attributes}>{inner}</{tag}>')
        return id

    def flow(self, source: str, target: str, condition: str = "") -> str:
        id = self.id("flow")
        inner = f"<conditionExpression>{condition}</conditionExpression>" if condition else ""
        self.text.append(f'<sequenceFlow id="{id}" sourceRef="{source}" targetRef="{target}">{inner}</sequenceFlow>')
        return id

    def signal(self, name: str) -> str:
        self.signals.add(name)
        return f'<signalEventDefinition signalRef="Signal_{name}"/>'

    def message(self, name: str) -> str:
        self.messages.add(name)
        return f'<messageEventDefinition messageRef="Message_{name}"/>'

    def trigger(self, text: str) -> str:
        """The event definition of a trigger."""
        kind, _, what = text.partition(" ")
        match kind:
            case "message":
                return self.message(what)
            case "timer":
                return f"<timerEventDefinition><timeDuration>{self.time(what)}</timeDuration></timerEventDefinition>"
            case "error" | "escalation":
                named = f'{kind}Ref="{_reference(kind, what)}"' if what else ""
                return f"<{kind}EventDefinition {named}/>"
            case "condition":
                return f"<conditionalEventDefinition><condition>{escape(what)}</condition></conditionalEventDefinition>"
        return self.signal(kind)

    def time(self, literal: str) -> str:
        return literal if self.drawn is None else f"PT{self.drawn.choice(TIMES)}S"

    def sleep(self) -> str:
        return f"await sleep({1 if self.drawn is None else self.drawn.choice(TIMES)})"

    def unknown(self) -> str:
        """A script that sets ``unknown``: 1, 2 or 3 if it is drawn, each time another one."""
        if self.drawn is None:
            return "unknown = robot.now"
        begin = f"try: state\nexcept NameError: state = {self.drawn.randrange(1 << 30)}\n"
        return f"{begin}state = (state * 1103515245 + 12345) % (1 << 31)\nunknown = 1 + (state >> 16) % 3"

    def steps(self, before: str | None, steps: Steps) -> str | None:
        """Add steps after a node; gives the last node, None if no token comes out."""
        for step in steps:
            if before is None:
                break
            before = self.step(before, step)
        return before

    def step(self, before: str, step: Step) -> str | None:
        if isinstance(step, tuple):
            return getattr(self, f"_{step[0]}")(before, *step[1:])
        if step == "jump":
            return self._jump(before)
        if step.startswith(("raise", "crash")):
            before = self._look(before)
        kind, _, what = step.partition(" ")
        made = self.simple(kind, what)
        self.flow(before, made)
        return None if kind in ("stop", "end", "error", "cancel") else made

    def simple(self, kind: str, what: str) -> str:
        name = f"name={quoteattr(what)}"
        match kind:
            case "throw":
                return self.node("intermediateThrowEvent", self.signal(what), name, f"throw_{what}")
            case "catch":
                return self.node("intermediateCatchEvent", self.signal(what), name, f"catch_{what}")
            case "queue":
                kept = ('<extensionElements><camunda:properties><camunda:property name="queue" value="10"/>'
                        "</camunda:properties></extensionElements>")  # fmt: skip
                return self.node("intermediateCatchEvent", kept + self.signal(what), name, f"catch_{what}")
            case "send":
                return self.node("intermediateThrowEvent", self.message(what), name, f"send_{what}")
            case "receive":
                return self.node("intermediateCatchEvent", self.message(what), name, f"receive_{what}")
            case "timer":
                return self.node("intermediateCatchEvent", self.trigger(f"timer {what}"), name, "timer")
            case "work":
                return self.script(self.sleep(), "work")
            case "fail":
                odd = "odd" if self.drawn is None else str(self.drawn.random() < 0.4)
                return self.script(f"{self.sleep()}\nif {odd}: raise BpmnError({what!r})", "work")
            case "raise" | "crash":
                fault = f"raise BpmnError({what!r})" if kind == "raise" else "raise ValueError"
                return self.script(f"if unknown == 1: {fault}", "script")
            case "say":
                return self.script(f"signal('{what}')", "script")
            case "error":
                return self.node("endEvent", self.trigger(f"error {what}"), "", "error")
            case "escalate":
                return self.node("intermediateThrowEvent", self.trigger(f"escalation {what}"), "", "escalate")
            case "until":
                return self.node("intermediateCatchEvent", self.trigger(f"condition {what}"), "", "until")
            case "undo":
                return self.node("intermediateThrowEvent", "<compensateEventDefinition/>", "", "undo")
            case "cancel":
                return self.node("endEvent", "<cancelEventDefinition/>", "", "cancel")
            case "run":
                return self.script(what, "script")
            case "person":
                return self.node("userTask", "", 'name="person"', "person")
            case "stop":
                return self.node("endEvent", "<terminateEventDefinition/>", "", "stop")
            case _:
                return self.node("endEvent", "", "", "end")

    def script(self, text: str, kind: str) -> str:
        return self.node("scriptTask", f"<script>{escape(text)}</script>", f'name="{kind}" scriptFormat="python"', kind)

    # ---- steps of several branches -------------------------------------------------------------------

    def _and(self, before: str, *branches: Steps) -> str | None:
        fork = self.node("parallelGateway", "", "", "fork")
        self.flow(before, fork)
        ends = [end for branch in branches if (end := self.steps(fork, branch)) is not None]
        if not ends:
            return None
        join = self.node("parallelGateway", "", "", "join")
        for end in ends:
            self.flow(end, join)
        return join

    def _or(self, before: str, *branches: Steps) -> str | None:
        return self._if(before, "unknown == 1", *branches)

    def _if(self, before: str, condition: str, first: Steps, *others: Steps) -> str | None:
        if condition.startswith("unknown"):
            before = self._look(before)
        split, merge = self.id("split"), self.id("merge")
        self.flow(before, split)
        ends, default = [], ""
        for number, branch in enumerate((first, *others)):
            last = number == len(others)
            mark = self.node("task", "", "", "choice")
            text = "" if last else condition if not number else f"unknown == {number + 1}"
            flow = self.flow(split, mark, text)
            default = flow if last else default
            ends.append(self.steps(mark, branch))
        self.text.append(f'<exclusiveGateway id="{split}" default="{default}"/>')
        left = [end for end in ends if end is not None]
        if not left:
            return None
        self.text.append(f'<exclusiveGateway id="{merge}"/>')
        for end in left:
            self.flow(end, merge)
        return merge

    def _look(self, before: str) -> str:
        probe = self.script(self.unknown(), "look")
        self.flow(before, probe)
        return probe

    def _some(self, before: str, first: Steps, second: Steps) -> str:
        split, join = self.id("split"), self.id("join")
        self.flow(self._look(before), split)
        for branch, condition in ((first, "unknown != 2"), (second, "unknown != 1")):
            mark = self.node("task", "", "", "choice")
            self.flow(split, mark, condition)
            end = self.steps(mark, branch)
            if end is not None:
                self.flow(end, join)
        self.text.append(f'<inclusiveGateway id="{split}" default="{self.flow(split, join)}"/>')
        self.text.append(f'<inclusiveGateway id="{join}"/>')
        return join

    def _race(self, before: str, *branches: Steps) -> str | None:
        gateway = self.node("eventBasedGateway", "", "", "race")
        self.flow(before, gateway)
        ends = [end for branch in branches if (end := self.steps(gateway, branch)) is not None]
        if not ends:
            return None
        merge = self.node("exclusiveGateway", "", "", "merge")
        for end in ends:
            self.flow(end, merge)
        return merge

    def _scope(
        self, before: str, body: Steps, trigger: str, handler: Steps, interrupting: bool = True, inside: str = ""
    ) -> str:
        how = "" if interrupting else 'isInterrupting="false"'
        outside, self.text = self.text, []
        self._inside(
            self.node("startEvent", self.trigger(trigger), f"name={quoteattr(trigger)} {how}", "start"), handler
        )
        handling = (
            f'<subProcess id="{self.id("handler")}" triggeredByEvent="true">{inside}{"".join(self.text)}</subProcess>'
        )
        self.text = outside
        return self._sub(before, body, handling)

    def _beside(self, before: str, body: Steps, trigger: str, handler: Steps) -> str:
        return self._scope(before, body, trigger, handler, interrupting=False)

    def _pause(self, before: str, body: Steps, trigger: str, handler: Steps) -> str:
        resume = '<camunda:properties><camunda:property name="resume" value="true"/></camunda:properties>'
        return self._scope(before, body, trigger, handler, inside=f"<extensionElements>{resume}</extensionElements>")

    def _both(self, before: str, first: str, second: str) -> str:
        inner = self.signal(first) + self.signal(second)
        made = self.node("intermediateCatchEvent", inner, 'parallelMultiple="true"', "both")
        self.flow(before, made)
        return made

    def _any(self, before: str, *branches: Steps) -> str | None:
        fork = self.node("parallelGateway", "", "", "fork")
        self.flow(before, fork)
        ends = [end for branch in branches if (end := self.steps(fork, branch)) is not None]
        if not ends:
            return None
        when = "<activationCondition>activationCount &gt;= 1</activationCondition>"
        join = self.node("complexGateway", when, "", "any")
        for end in ends:
            self.flow(end, join)
        return join

    def _adhoc(self, before: str, *bodies: Steps) -> str:
        outside, self.text = self.text, []
        for body in bodies:
            self._body(body)
        content, self.text = "".join(self.text), outside
        made = self.node("adHocSubProcess", content, 'ordering="Sequential"', "adhoc")
        self.flow(before, made)
        return made

    def _again(self, before: str, body: Steps, condition: str) -> str:
        loop = f'<standardLoopCharacteristics loopMaximum="2"><loopCondition>{escape(condition)}</loopCondition>'
        return self._sub(before, body, f"{loop}</standardLoopCharacteristics>")

    def _sub(self, before: str, body: Steps, more: str = "", tag: str = "subProcess") -> str:
        made = self._body(body, more, tag)
        self.flow(before, made)
        return made

    def _body(self, body: Steps, more: str = "", tag: str = "subProcess", attributes: str = "") -> str:
        outside, self.text = self.text, []
        self._inside(self.node("startEvent", "", "", "start"), body)
        content, self.text = "".join(self.text), outside
        return self.node(tag, content + more, attributes, "scope")

    def _done(self, before: str, body: Steps, handler: Steps) -> str:
        host = self._host(before, body)
        event = self.node("boundaryEvent", "<compensateEventDefinition/>", f'attachedToRef="{host}"', "compensate")
        undoing = self._body(handler, attributes='isForCompensation="true"')
        self.text.append(f'<association id="{self.id("link")}" sourceRef="{event}" targetRef="{undoing}"/>')
        return host

    def _deal(self, before: str, body: Steps, handler: Steps) -> str | None:
        host = self._sub(before, body, tag="transaction")
        event = self.node("boundaryEvent", "<cancelEventDefinition/>", f'attachedToRef="{host}"', "cancelled")
        return self._merge(host, self.steps(event, handler))

    def _first(self, before: str, body: Steps, condition: str) -> str:
        text = f"<loopCardinality>2</loopCardinality><completionCondition>{escape(condition)}</completionCondition>"
        loop = f"<multiInstanceLoopCharacteristics>{text}</multiInstanceLoopCharacteristics>"
        return self._sub(before, body, loop)

    def _jump(self, before: str) -> str:
        link = f'<linkEventDefinition name="{self.id("link")}"/>'
        self.flow(before, self.node("intermediateThrowEvent", link, "", "jump"))
        return self.node("intermediateCatchEvent", link, "", "land")

    def _merge(self, *ends: str | None) -> str:
        merge = self.node("exclusiveGateway", "", "", "merge")
        for end in ends:
            if end is not None:
                self.flow(end, merge)
        return merge

    def _each(self, before: str, number: int, body: Steps, sequential: str = "false") -> str:
        count = f"<loopCardinality>{number}</loopCardinality>"
        loop = (
            f'<multiInstanceLoopCharacteristics isSequential="{sequential}">{count}</multiInstanceLoopCharacteristics>'
        )
        return self._sub(before, body, loop)

    def _turns(self, before: str, number: int, body: Steps) -> str:
        return self._each(before, number, body, "true")

    def _call(self, before: str, name: str, mapping: str = "") -> str:
        made = self.node("callActivity", mapping, f'calledElement="P_{name}"', "call")
        self.flow(before, made)
        return made

    def _mapped(self, before: str, name: str) -> str:
        n = '<camunda:in source="n" target="n"/><camunda:out source="n" target="n"/>'
        return self._call(before, name, f"<extensionElements>{n}</extensionElements>")

    def _host(self, before: str, body: Steps) -> str:
        """An activity with these steps: the only one of them, if it can be the host of a boundary event."""
        step = body[0] if len(body) == 1 else ""
        activity = step[0] in ("call", "mapped") if isinstance(step, tuple) else step in ("work", "fail c")
        host = self.step(before, step) if activity else self._sub(before, body)
        assert host is not None
        return host

    def _guard(self, before: str, body: Steps, trigger: str, handler: Steps, interrupting: bool = True) -> str:
        host = self._host(before, body)
        how = f"attachedToRef={quoteattr(host)} name={quoteattr(trigger)}"
        how += "" if interrupting else ' cancelActivity="false"'
        event = self.node("boundaryEvent", self.trigger(trigger), how, "boundary")
        if interrupting:
            return self._merge(host, self.steps(event, handler))
        self._inside(event, handler)
        return host

    def _watch(self, before: str, body: Steps, trigger: str, handler: Steps) -> str:
        return self._guard(before, body, trigger, handler, interrupting=False)

    def _inside(self, begin: str, steps: Steps) -> None:
        end = self.steps(begin, steps)
        if end is not None:
            self.flow(end, self.node("endEvent", "", "", "end"))

    def _loop(self, before: str, body: Steps) -> str | None:
        probe = self.script(self.unknown(), "look")
        begin = self.node("exclusiveGateway", "", "", "again")
        self.flow(before, begin)
        end = self.steps(begin, body)
        if end is None:
            return None
        self.flow(end, probe)
        split, after = self.id("split"), self.node("task", "", "", "after")
        self.flow(probe, split)
        self.flow(split, begin, "unknown == 1")
        self.text.append(f'<exclusiveGateway id="{split}" default="{self.flow(split, after)}"/>')
        return after

    def _while(self, before: str, body: Steps) -> None:
        begin = self.node("exclusiveGateway", "", "", "again")
        self.flow(before, begin)
        end = self.steps(begin, body)
        if end is not None:
            self.flow(end, begin)


def _reference(kind: str, code: str) -> str:
    """The id of an error or escalation with a code."""
    return f"{kind.capitalize()}_{re.sub(r'[^a-z0-9]', '_', code)}"


def text_of(
    robots: dict[str, Steps],
    several: Sequence[str] = (),
    accept: dict[str, str] | None = None,
    single: Sequence[str] = (),
    calls: Sequence[str] = (),
    drawn: Random | None = None,
) -> str:
    """A collaboration as BPMN text; `several` names multi-instance pools, `accept` gives that property to robots.

    `single` names robots that run one instance at a time, and drop further triggers; `calls` names processes that are
    called instead of being robots.
    """
    declared = " ".join(f'xmlns{":" if prefix else ""}{prefix}="{uri}"' for prefix, uri in NAMESPACES.items())
    processes, pools, signals, messages = [], [], set[str](), set[str]()
    for robot, steps in robots.items():
        made = _Process(robot, drawn)
        first = steps[0] if steps and isinstance(steps[0], str) else ""
        if first.startswith("start "):
            begin = made.node("startEvent", made.signal(first[6:]), f'name="{first[6:]}"', "start")
            steps = steps[1:]
        else:
            begin = made.node("startEvent", "", "", "start")
        end = made.steps(begin, steps)
        if end is not None:
            made.flow(end, made.node("endEvent", "", "", "end"))
        signals |= made.signals
        messages |= made.messages
        given = {"accept": (accept or {}).get(robot, ""), "instances": "1" if robot in single else ""}
        kept = "".join(f'<camunda:property name="{name}" value="{value}"/>' for name, value in given.items() if value)
        extra = (f"<extensionElements><camunda:properties>{kept}</camunda:properties></extensionElements>"
                 if kept else "")  # fmt: skip
        processes.append(f'<process id="P_{robot}" isExecutable="true">{extra}{"".join(made.text)}</process>')
        if robot in calls:
            continue
        many = '<participantMultiplicity minimum="2"/>' if robot in several else ""
        pools.append(f'<participant id="Pool_{robot}" name="{robot}" processRef="P_{robot}">{many}</participant>')
    named = "".join(f'<signal id="Signal_{name}" name="{name}"/>' for name in sorted(signals))
    named += "".join(f'<message id="Message_{name}" name="{name}"/>' for name in sorted(messages))
    for kind, codes in (("error", ODD_CODES), ("escalation", ESCALATIONS)):
        named += "".join(f'<{kind} id="{_reference(kind, code)}" {kind}Code={quoteattr(code)}/>' for code in codes)
    team = f'<collaboration id="Team">{"".join(pools)}</collaboration>'
    return (f'<?xml version="1.0" encoding="UTF-8"?><definitions {declared} id="Definitions" '
            f'targetNamespace="http://fame">{named}{team}{"".join(processes)}</definitions>')  # fmt: skip


def team(
    robots: dict[str, Steps],
    several: Sequence[str] = (),
    accept: dict[str, str] | None = None,
    single: Sequence[str] = (),
) -> Definitions:
    """A collaboration as FAME reads it."""
    return fame.read(text_of(robots, several, accept, single).encode())


# ---- known collaborations --------------------------------------------------------------------------------------------


def philosophers(count: int, *, ordered: bool) -> dict[str, Steps]:
    """Philosophers and forks: each takes the left fork first; `ordered`: the last one takes the right one first.

    A fork hands itself to one of its two philosophers at a time, and asks for a confirmation by signals.
    """
    robots: dict[str, Steps] = {}
    for n in range(count):
        left, right = n, (n + 1) % count
        if ordered and n == count - 1:
            left, right = right, left
        robots[f"Phil{n}"] = [
            "work", f"throw take{left}by{n}", f"queue given{left}to{n}", "work",
            f"throw take{right}by{n}", f"queue given{right}to{n}",
            "work", f"throw back{left}", f"throw back{right}",
        ]  # fmt: skip
    for fork in range(count):
        users = [n for n in range(count) if fork in (n, (n + 1) % count)]
        first, second = users
        robots[f"Fork{fork}"] = [("race", _lend(fork, first, second), _lend(fork, second, first))]
    return robots


def _lend(fork: int, first: int, second: int) -> Steps:
    return [f"queue take{fork}by{first}", f"throw given{fork}to{first}", f"queue back{fork}",
            f"queue take{fork}by{second}", f"throw given{fork}to{second}", f"queue back{fork}"]  # fmt: skip


SETS = ("n = 0", "n = 1")
LISTS = ("n = len(xs) % 3", "m = n", "xs = []", "xs.append(n)", "xs += [m]", "m = xs[-1] if xs else 0", "n, m = m, n",
         "seen[n] = m", "m = seen.get(n, 0)", "n += 1; n %= 2", "y = xs; y.append(1)")  # fmt: skip
"""Scripts whose variables become dead, are counted, share a list, or decide nothing."""
TESTS = ("n == 1", "len(xs) > 1", "m == n", "sum(seen.values()) > 0")


def with_lists(seed: int) -> dict[str, Steps]:
    """A collaboration made at random in which robots have lists and mappings."""
    made = generated(seed, scripts=LISTS, conditions=TESTS)
    return {robot: [f"run {'; '.join(('m = 0', 'xs = []', 'seen = {}'))}", *steps] for robot, steps in made.items()}


def generated(
    seed: int, *, size: int = 3, scripts: Sequence[str] = SETS, conditions: Sequence[str] = ("n == 1",)
) -> dict[str, Steps]:
    """A collaboration made at random: two or three robots, three signals, one variable each, a few steps."""
    random = Random(seed)
    signals = ["a", "b", "c"]
    simple = ["throw", "throw", "catch", "work", "work", "queue", "timer", "set", "count"]

    def steps(depth: int) -> Steps:
        return [step(depth) for _ in range(random.randint(1, size))]

    def step(depth: int) -> Step:
        kind = random.choice(simple if depth > 1 else [*simple, "and", "or", "race", "if"])
        match kind:
            case "throw" | "catch" | "queue":
                return f"{kind} {random.choice(signals)}"
            case "timer":
                return "timer PT5S"
            case "set":
                return f"run {scripts[random.randint(0, len(scripts) - 1)]}"
            case "count":
                return "run n = (n + 1) % 3"
            case "and" | "or":
                return (kind, steps(depth + 1), steps(depth + 1))
            case "if":
                condition = conditions[random.randint(0, len(conditions) - 1)] if len(conditions) > 1 else conditions[0]
                return ("if", condition.replace(">", "&gt;"), steps(depth + 1), steps(depth + 1))
            case "race":
                return ("race", [f"catch {random.choice(signals)}", *steps(depth + 1)], ["timer PT9S"])
            case _:
                return "work"

    return {f"R{n}": ["run n = 0", *steps(0)] for n in range(random.randint(2, 3))}


def varied(seed: int, *, rich: bool = False) -> tuple[dict[str, Steps], dict[str, Any]]:
    """A collaboration made at random with most of what BPMN has, and the other arguments of `text_of`.

    `rich`: also with calls in calls, odd codes and those of any code, escalations, compensation, transactions, links
    and conditional events. Somebody throws each signal, and sends each message, that somebody waits for. In half of
    them several robots throw at their start.
    """
    random = Random(f"rich {seed}" if rich else seed)
    signals, messages, calls = ("a", "b", "c"), ("m", "o"), ("Help", "Move", *(["Deep"] if rich else []))
    simple = ["throw", "throw", "send", "catch", "receive", "work", "work", "queue", "timer", "set", "count", "fail"]
    nested = ["and", "or", "some", "race", "if", "each", "turns", "scope", "beside", "guard", "watch", "guard", "call"]
    codes, others = CODES, list[str]()
    ends = ["error c", "error d", "end", "stop"]
    if rich:
        simple += ["fail", "raise", "crash", "say", "escalate", "undo", "jump", "until"]
        nested += ["call", "call", "mapped", "done", "deal", "first", "guard", "scope"]
        nested += ["again", "both", "pause", "any", "adhoc"]
        codes = ODD_CODES
        others = ["error", "error", "escalation", *(f"escalation {code}" for code in ESCALATIONS), "condition n == 1"]
        ends += [f"error {code}" for code in codes] + ["cancel", "cancel"]

    def steps(depth: int, called: int = 0, deal: bool = False) -> Steps:
        made = [step(depth, called) for _ in range(random.randint(1, 3 if depth < 2 else 2))]
        last = random.choice(ends) if random.random() < (0.14 if rich else 0.06) else ""
        if deal and random.random() < 0.5:
            last = "cancel"
        return [*made, last] if last and (deal or last != "cancel") else made

    def trigger() -> str:
        errors = [f"error {random.choice(codes)}"] * 2
        return random.choice([*signals, *(f"message {name}" for name in messages), "timer PT4S", *errors, *others])

    def step(depth: int, called: int) -> Step:
        kind = random.choice(simple if depth > 1 else [*simple, *nested])
        match kind:
            case "throw" | "catch" | "queue" | "say":
                return f"{kind} {random.choice(signals)}"
            case "send" | "receive":
                return f"{kind} {random.choice(messages)}"
            case "timer" | "fail" | "raise":
                code = random.choice(codes)
                return "timer PT5S" if kind == "timer" else f"{kind} {code}"
            case "escalate":
                return f"{kind} {random.choice(ESCALATIONS)}"
            case "crash" | "undo" | "jump":
                return kind
            case "until":
                return ("race", ["until n == 1"], ["timer PT9S"])
            case "set":
                return f"run {random.choice(SETS)}"
            case "count":
                return "run n = (n + 1) % 3"
            case "and" | "or" | "some" | "any" | "adhoc":
                return (kind, steps(depth + 1, called), steps(depth + 1, called))
            case "if":
                return (kind, "n == 1", steps(depth + 1, called), steps(depth + 1, called))
            case "each" | "turns":
                return (kind, 2, steps(2, called))
            case "first" | "again":
                return (kind, steps(2, called), "n == 1")
            case "both":
                return (kind, *random.sample(signals, 2))
            case "done":
                return (kind, steps(depth + 1, called), steps(2, called))
            case "deal":
                return (kind, steps(depth + 1, called, deal=True), steps(2, called))
            case "race":
                first = random.choice((f"catch {random.choice(signals)}", f"receive {random.choice(messages)}"))
                return ("race", [first, *steps(depth + 1, called)], ["timer PT9S"])
            case "scope" | "guard" | "pause":
                return (kind, steps(depth + 1, called), trigger(), steps(2, called))
            case "beside" | "watch":
                when = random.choice((*signals, *(f"message {name}" for name in messages), "timer PT4S", *quiet))
                handler = steps(2, called)  # in no time handlers could trigger themselves, more of them each time
                if re.search("throw|send|say|escalate", repr(handler)):
                    handler = ["work", *handler]
                return (kind, steps(depth + 1, called), when, handler)
            case "call" | "mapped" if calls[called:]:
                return (kind, random.choice(calls[called:]))
            case _:
                return "work"

    quiet = [one for one in others if one.startswith("escalation")]
    robots = {f"R{n}": ["run n = 0", *steps(0)] for n in range(random.randint(2, 3))}
    begin = "start s" if rich else "start a"  # of a signal that only R0 throws, and in what is called nobody
    if random.random() < 0.25:
        robots["R1"] = [begin, *robots["R1"]]
    called = dict[str, Steps]()
    for place, name in enumerate(calls):
        if re.search(rf"\('(call|mapped)', '{name}'\)", repr((robots, called))):
            called[name] = steps(1, place + 1 if rich else len(calls))
    used = repr((robots, called))
    given = [f"throw {name}" for name in signals if f"'throw {name}'" not in used]
    given += ["throw s"] if "start s" in robots["R1"] else []
    given += [f"send {name}" for name in messages if f"'send {name}'" not in used]
    robots["R0"] = [*robots["R0"][:1], *given[:1], "work", *given[1:], *robots["R0"][1:]]
    starts = Random(f"starts {seed}")
    alone = begin in robots["R1"]  # which others could make start again and again, in no time
    for name in [*robots] if starts.random() < 0.5 and not alone else []:  # several throw in the instant of all starts
        first = [f"throw {signal}" for signal in starts.sample(signals, starts.randint(0, 2))]
        place = robots[name].index("run n = 0") + 1
        robots[name] = [*robots[name][:place], *first, *robots[name][place:]]
    return {**robots, **called}, {"calls": calls, "several": ("R1",) if seed % 5 == 0 else ()}
