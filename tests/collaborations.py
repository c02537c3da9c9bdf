"""Collaborations built from steps, for tests and benchmarks of the exploration.

A robot is a list of steps::

    "throw x"       throws signal x                  "catch x"      waits for it
    "work"          takes time                       "fail c"       takes time, and may raise error code c
    "queue x"       waits for x, keeps the last 10   "timer PT5S"   waits
    "run x = 1"     a script                         "person"       a user task
    ("and", A, B)   branches in parallel             ("or", A, B)   one of them, by an unknown value
    ("if", C, A, B) A if condition C, else B         ("race", A, B) the first whose catch or timer comes
    ("loop", A)     again and again, or not          ("while", A)   forever
    ("scope", A, x, H)  a sub-process A with an interrupting event sub-process H for signal x
    "stop"          terminate                        "end"          an end event in a branch

The first step may be ``start x``: the robot starts with that signal.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from random import Random
from typing import Any

from bpmn_text import NAMESPACES

import fame
from fame.bpmn.model import Definitions

Step = Any
Steps = Sequence[Step]


class _Process:
    """The elements of one process, as text."""

    def __init__(self, robot: str) -> None:
        self.robot, self.text, self.signals = robot, list[str](), set[str]()
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
        kind, _, what = step.partition(" ")
        made = self.simple(kind, what)
        self.flow(before, made)
        return None if kind in ("stop", "end") else made

    def simple(self, kind: str, what: str) -> str:
        name = f'name="{what}"'
        match kind:
            case "throw":
                return self.node("intermediateThrowEvent", self.signal(what), name, f"throw_{what}")
            case "catch":
                return self.node("intermediateCatchEvent", self.signal(what), name, f"catch_{what}")
            case "queue":
                kept = ('<extensionElements><camunda:properties><camunda:property name="queue" value="10"/>'
                        "</camunda:properties></extensionElements>")  # fmt: skip
                return self.node("intermediateCatchEvent", kept + self.signal(what), name, f"catch_{what}")
            case "timer":
                time = f"<timerEventDefinition><timeDuration>{what}</timeDuration></timerEventDefinition>"
                return self.node("intermediateCatchEvent", time, name, "timer")
            case "work":
                return self.script("await sleep(1)", "work")
            case "fail":
                return self.script(f"await sleep(1)\nif odd: raise BpmnError('{what}')", "work")
            case "run":
                return self.script(what, "script")
            case "person":
                return self.node("userTask", "", 'name="person"', "person")
            case "stop":
                return self.node("endEvent", "<terminateEventDefinition/>", "", "stop")
            case _:
                return self.node("endEvent", "", "", "end")

    def script(self, text: str, kind: str) -> str:
        safe = text.replace("&", "&amp;").replace("<", "&lt;")
        return self.node("scriptTask", f"<script>{safe}</script>", f'name="{kind}" scriptFormat="python"', kind)

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
            probe = self.script("unknown = robot.now", "look")
            self.flow(before, probe)
            before = probe
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

    def _scope(self, before: str, body: Steps, signal: str, handler: Steps) -> str:
        outside, self.text = self.text, []
        self._inside(self.node("startEvent", "", "", "start"), body)
        content, self.text = self.text, []
        self._inside(self.node("startEvent", self.signal(signal), f'name="{signal}"', "start"), handler)
        handling = f'<subProcess id="{self.id("handler")}" triggeredByEvent="true">{"".join(self.text)}</subProcess>'
        self.text = outside
        made = self.node("subProcess", "".join(content) + handling, "", "scope")
        self.flow(before, made)
        return made

    def _inside(self, begin: str, steps: Steps) -> None:
        end = self.steps(begin, steps)
        if end is not None:
            self.flow(end, self.node("endEvent", "", "", "end"))

    def _loop(self, before: str, body: Steps) -> str | None:
        probe = self.script("unknown = robot.now", "look")
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


def text_of(
    robots: dict[str, Steps],
    several: Sequence[str] = (),
    accept: dict[str, str] | None = None,
    single: Sequence[str] = (),
) -> str:
    """A collaboration as BPMN text; `several` names multi-instance pools, `accept` gives that property to robots.

    `single` names robots that run one instance at a time, and drop further triggers.
    """
    declared = " ".join(f'xmlns{":" if prefix else ""}{prefix}="{uri}"' for prefix, uri in NAMESPACES.items())
    processes, pools, signals = [], [], set[str]()
    for robot, steps in robots.items():
        made = _Process(robot)
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
        given = {"accept": (accept or {}).get(robot, ""), "instances": "1" if robot in single else ""}
        kept = "".join(f'<camunda:property name="{name}" value="{value}"/>' for name, value in given.items() if value)
        extra = (f"<extensionElements><camunda:properties>{kept}</camunda:properties></extensionElements>"
                 if kept else "")  # fmt: skip
        processes.append(f'<process id="P_{robot}" isExecutable="true">{extra}{"".join(made.text)}</process>')
        many = '<participantMultiplicity minimum="2"/>' if robot in several else ""
        pools.append(f'<participant id="Pool_{robot}" name="{robot}" processRef="P_{robot}">{many}</participant>')
    named = "".join(f'<signal id="Signal_{name}" name="{name}"/>' for name in sorted(signals))
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
