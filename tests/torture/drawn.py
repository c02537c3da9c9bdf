"""Missions that are drawn: data in the plan of a run, from which the BPMN of each version is made.

A step is ``[kind, number, ...]``: the steps of `tests.collaborations`, from which other missions are taken as they are,
and those of `_Lasting`. The number stays in all versions, so that elements keep their ids.

A mission is *calm* if what comes of it does not depend on when anything happens: what branches do commutes, nothing
races, what one robot tells waits for the others. However often its robots crash, its variables, visits and tokens
become those of a run in which none did (`reference`).
"""

from __future__ import annotations

import random
import sys
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from fame.bpmn import reader
from fame.bpmn.library import Library
from fame.bpmn.pools import pools_of, shared_topics
from fame.clock import SECOND, Scheduler, date_text
from fame.engine.program import USER
from fame.middleware import messages
from fame.middleware.actions import ActionServer, ServerGoal
from fame.middleware.interface import QoS
from fame.middleware.local import LocalMiddleware
from fame.middleware.network import Delay, Link, Network, NetworkConfig, Partition
from fame.robot import RobotNode, make_mission
from fame.robot.options import RobotOptions

sys.path.insert(0, str(Path(__file__).parents[1]))

from collaborations import CODES, _Process, varied

NAMES = ("A", "B", "C", "D", "E")
Step = list[Any]
Mission = dict[str, Any]
"""``robots`` and ``calls``: steps by name; ``calm``; ``edits``: by version, those of all versions before included."""
LAST = 99
"""The version that is deployed at the end: a drawn mission then does nothing."""
START = 1_700_000_000
_DECLARED = 'xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" xmlns:camunda="http://camunda.org/schema/1.0/bpmn"'
LOOSE = ("break", "go", "ask", "loose")
"""Kinds in the ids of elements whose visits depend on when they are, or on how often a person repairs them."""
IGNORED = {"helped", "loose", "unknown", "state", "recovered", "told", "go", "mine"}
"""Variables that a person sets, or that depend on times."""


def _properties(**named: str) -> str:
    kept = "".join(f'<camunda:property name="{name}" value="{value}"/>' for name, value in named.items())
    return f"<extensionElements><camunda:properties>{kept}</camunda:properties></extensionElements>"


_TOLD = {"type": "std_msgs/msg/Int32", "delivery": "acknowledged", "ttl": "100000"}
DRIVE = "nav2_msgs/action/NavigateToPose"
ASK = "std_srvs/srv/SetBool"
_ALL = QoS(history="keep_all")
_PAIR = "diagnostic_msgs/msg/KeyValue"
GOALS = {"fast": 0, "slow": 1, "rejected": 2, "aborted": 3, "long": 4}
"""What the server makes of a goal: `y` of its position. `x` is its number, and its frame the robot."""


class _Lasting(_Process):
    """The elements of one process, with steps that last, and ids that stay."""

    def __init__(self, robot: str, version: int) -> None:
        super().__init__(robot, random.Random(0))
        self._version = version
        self._place = 0, Counter[str]()

    def id(self, kind: str) -> str:
        number, ids = self._place
        ids[kind] += 1
        return f"{self.robot}_{kind}_{number}_{ids[kind]}"

    def step(self, before: str, step: Step) -> str | None:
        kind, number, *rest = step
        outside, self._place = self._place, (number, Counter())
        self.drawn = random.Random(f"{self.robot} {number}")  # another version draws the same
        try:
            if special := getattr(self, f"_{kind}", None):
                return special(before, *rest)  # type: ignore[no-any-return]
            made = self.simple(kind, *map(str, rest)) if rest else self.simple(kind, "")
            self.flow(before, made)
            return None if kind in ("stop", "end", "error") else made
        finally:
            self._place = outside

    def signal(self, name: str) -> str:
        """One that is for the same robot is of one version: what is loaded hears the one before."""
        return super().signal(f"{name}_{self._version}" if name.startswith("pause") else name)

    def unknown(self) -> str:
        return f"unknown = {self.drawn.randint(1, 3)}"

    def counted(self, kind: str, text: str = "", after: str = "") -> str:
        """A script that does something, and counts that in the same step."""
        id = self.id(kind)
        count = f"done['{id}'] = done.get('{id}', 0) + 1"
        script = "\n".join(filter(None, (text, count, after)))
        safe = script.replace("&", "&amp;").replace("<", "&lt;")
        self.text.append(f'<scriptTask id="{id}" scriptFormat="python"><script>{safe}</script></scriptTask>')
        return id

    def time(self, literal: str) -> str:
        return literal

    def after(self, before: str, made: str) -> str:
        self.flow(before, made)
        return made

    def _work(self, before: str, seconds: str = "") -> str:
        return self.after(before, self.counted("work", f"await sleep({seconds or self.drawn.choice((0.5, 1, 2))})"))

    def _note(self, before: str) -> str:
        return self.after(before, self.counted("note"))

    def _break(self, before: str) -> str:
        return self.after(before, self.counted("break", "if not helped: raise ValueError('broken')", "helped = 0"))

    def _date(self, before: str, seconds: int) -> str:
        date = date_text(datetime.fromtimestamp(START + seconds, UTC))
        timer = f"<timerEventDefinition><timeDate>{date}</timeDate></timerEventDefinition>"
        return self.after(before, self.node("intermediateCatchEvent", timer, "", "date"))

    def _tell(self, before: str) -> str:
        topic = f"tell_{self.robot}"
        numbered = self.script("done['told'] = done.get('told', 0) + 1\ntold = 1000 * version + done['told']", "number")
        thrown = _properties(**_TOLD, payload="${told}") + self.signal(topic)
        return self.after(self.after(before, numbered), self.node("intermediateThrowEvent", thrown, "", "tell"))

    def _hear(self, before: str, robot: str) -> str:
        topic = f"tell_{robot}"
        heard = _properties(queue="50") + self.signal(topic)
        caught = self.after(before, self.node("intermediateCatchEvent", heard, "", "hear"))
        return self.after(caught, self.script(f"kept['{robot}'] = kept.get('{robot}', []) + [{topic}]", "keep"))

    def _inbox(self, before: str, what: str) -> str:
        kept = _properties(queue="5") + self.message(what)
        return self.after(before, self.node("intermediateCatchEvent", kept, "", "inbox"))

    def _go(self, before: str, retry: str, how: str, limit: str = "", recovers: bool = False) -> str:
        """A goal; one that is refused, aborted or not done within `limit` is an error, which goes on.

        If it `recovers`, it is given up as soon as the robot is back after a crash.
        """
        goal = f"goal_{self._place[0]}"  # branches share variables
        count = f"done['goal'] = done.get('goal', 0) + 1\n{goal} = 1000 * version + done['goal']"
        position = f"{{x: ${{{goal}}}, y: {GOALS[how]}, z: {RETRIES.index(retry)}}}"
        payload = f"{{pose: {{header: {{frame_id: {self.robot}}}, pose: {{position: {position}}}}}}}"
        called = _properties(action="/go", type=DRIVE, payload=payload, retry=retry)
        numbered = self.after(before, self.script(count, "number"))
        made = self.after(numbered, self.node("serviceTask", called, "", "go"))
        if limit:
            late = self.node("boundaryEvent", self.trigger(f"timer {limit}"), f'attachedToRef="{made}"', "go")
            merge = self.node("exclusiveGateway", "", "", "merge")
            self.flow(made, merge)
            if recovers:
                caught = _properties(type="std_msgs/msg/Float64") + self.signal("recovered")
                self.flow(self.node("boundaryEvent", caught, f'attachedToRef="{made}"', "go"), merge)
            return self.after(late, merge)
        if how not in ("rejected", "aborted"):
            return made
        self.flow(made, self.node("endEvent", "", "", "loose_end"))
        return self.node("boundaryEvent", self.trigger(f"error {how}"), f'attachedToRef="{made}"', "caught")

    def _ask(self, before: str, data: str, retry: str) -> str:
        """A service call, whose answer is what was asked."""
        variable = f"answer_{self._place[0]}"
        called = _properties(service="/ask", type=ASK, payload=f"{{data: {data}}}", retry=retry)
        asking = self.id("ask")
        self.text.append(f'<serviceTask id="{asking}" camunda:resultVariable="{variable}">{called}</serviceTask>')
        self.flow(before, asking)
        return self.after(asking, self.script(f"{variable} = {variable}.success", "answered"))

    def _order(self, before: str, number: int) -> str:
        """Several orders at once; each takes the answer that has its key, and what is sent for the ticket in that."""
        robot, outside, self.text = self.robot, self.text, []
        last = self.node("startEvent", "", "", "start")
        for asks, key, answer, keys in (
            ("order", "loopCounter", "picked", "loopCounter = key, ticket = value"),
            ("claim", "ticket", "shipped", "ticket = key"),
        ):
            last = self.after(last, self._pair(asks, f"{asks}_{robot}", f"${{{key}}}", robot))
            taken = _properties(type=_PAIR, correlate=keys, queue="10") + self.message(f"{answer}_{robot}")
            last = self.after(last, self.node("intermediateCatchEvent", taken, "", answer))
            kept = f"done[f'{answer} {{loopCounter}}'] = {answer}_{robot}.key + {answer}_{robot}.value"
            last = self.after(last, self.script(kept, "keep"))
        self.after(last, self.node("endEvent", "", "", "end"))
        loop = f"<multiInstanceLoopCharacteristics><loopCardinality>{number}</loopCardinality>"
        content, self.text = "".join(self.text) + loop + "</multiInstanceLoopCharacteristics>", outside
        return self.after(before, self.node("subProcess", content, "", "orders"))

    def _serve(self, before: str, robot: str) -> str:
        """An order of another robot, which is answered; before what its ticket is for, something that it is not for."""
        for asked, answers in (("order", [("picked", "")]), ("claim", [("shipped", "nobody"), ("shipped", "")])):
            message = f"{asked}_{robot}"
            taken = _properties(type=_PAIR, queue="50") + self.message(message)
            before = self.after(before, self.node("intermediateCatchEvent", taken, "", "serve"))
            for answer, other in answers:
                key = f"${{{message}.key}}"
                before = self.after(before, self._pair(answer, f"{answer}_{robot}", other or key, f"{robot}{key}"))
        return before

    def _pair(self, kind: str, message: str, key: str, value: str) -> str:
        """An acknowledged message with a key and a value."""
        pair = _properties(**_TOLD | {"type": _PAIR}, payload=f"{{key: {key}, value: {value}}}")
        return self.node("intermediateThrowEvent", pair + self.message(message), "", kind)

    def _alert(self, before: str) -> str:
        """A condition beside others, which becomes true, and stays so for a while: its handler runs once."""
        flag = f"flag_{self._place[0]}"
        host = self._sub(
            before, [["run", 2000 + self._place[0], f"{flag} = True"], ["timer", 3000 + self._place[0], "PT3S"]]
        )
        condition = f"<conditionalEventDefinition><condition>{flag}</condition></conditionalEventDefinition>"
        event = self.node("boundaryEvent", condition, f'attachedToRef="{host}" cancelActivity="false"', "alert")
        self.after(self.after(event, self.counted("alerted")), self.node("endEvent", "", "", "end"))
        return host

    def _until(self, before: str, body: Sequence[Step]) -> str:
        """A branch that waits for a condition which another one makes true."""
        fork, join = self.node("parallelGateway", "", "", "fork"), self.id("join")
        self.flow(before, fork)
        flag = f"flag_{self._place[0]}"
        setting = self.script(f"{flag} = True", "flag")
        end = self.steps(fork, body)
        self.flow(end or fork, setting)
        condition = f"<conditionalEventDefinition><condition>{flag}</condition></conditionalEventDefinition>"
        waiting = self.after(fork, self.node("intermediateCatchEvent", condition, "", "condition"))
        self.text.append(f'<parallelGateway id="{join}"/>')
        self.flow(waiting, join)
        return self.after(setting, join)

    def _times(self, before: str, number: int, body: Sequence[Step]) -> str:
        """A loop that ends after so many passes."""
        again, split, leave = self.node("exclusiveGateway", "", "", "again"), self.id("split"), self.id("leave")
        self.flow(before, again)
        end = self.steps(again, body)
        counted = self.after(end or again, self.counted("pass"))
        self.flow(counted, split)
        self.flow(split, again, f"done['{counted}'] % {number} != 0")
        self.text.append(f'<exclusiveGateway id="{split}" default="{self.flow(split, leave)}"/><task id="{leave}"/>')
        return leave

    def _limit(self, before: str, time: str, body: Sequence[Step]) -> str:
        """What never comes, until a timer ends it; beside it a cycle whose handler counts nothing that matters."""
        never = self._repeat(self._sub(before, [*body, ["catch", 2000 + self._place[0], "never"]]), "R3/PT1.5S")
        timer = f"<timerEventDefinition><timeDuration>{time}</timeDuration></timerEventDefinition>"
        self.flow(never, self.node("endEvent", "", "", "end"))
        return self.node("boundaryEvent", timer, f'attachedToRef="{never}"', "limit")

    def _beat(self, before: str, cycle: str, body: Sequence[Step]) -> str:
        """What a cycle goes on beside: its handler counts nothing that matters."""
        return self._repeat(self._sub(before, body), cycle)

    def _repeat(self, host: str, cycle: str) -> str:
        repeated = f"<timerEventDefinition><timeCycle>{cycle}</timeCycle></timerEventDefinition>"
        event = self.node("boundaryEvent", repeated, f'attachedToRef="{host}" cancelActivity="false"', "loose_cycle")
        counted = self.after(event, self.script("loose = globals().get('loose', 0) + 1", "loose"))
        self.after(counted, self.node("endEvent", "", "", "loose_end"))
        return host

    def _never(self, before: str, body: Sequence[Step]) -> str:
        """An activity with a boundary event that is armed, and never comes."""
        made = self.steps(before, body)
        assert made is not None
        if made != before:  # it has not been removed
            how = f'attachedToRef="{made}" cancelActivity="{str(self.drawn.random() < 0.5).lower()}"'
            event = self.node("boundaryEvent", self.signal("never"), how, "unheard")
            self.flow(event, self.node("endEvent", "", "", "loose_end"))
        return made

    def _caught(self, before: str, body: Sequence[Step], code: str) -> str:
        """A sub-process that ends with an error, which its boundary event catches."""
        host = self._sub(before, [*body, ["error", 2000 + self._place[0], code]])
        self.flow(host, self.node("endEvent", "", "", "end"))
        return self.node("boundaryEvent", self.trigger(f"error {code}"), f'attachedToRef="{host}"', "caught")

    def _undo(self, before: str, body: Sequence[Step]) -> str:
        """A sub-process that does something, and compensates it."""
        outside, self.text = self.text, []
        host = self._sub(self.node("startEvent", "", "", "start"), body)
        event = self.node("boundaryEvent", "<compensateEventDefinition/>", f'attachedToRef="{host}"', "compensation")
        handler = self.counted("undo", "await sleep(0.5)")
        self.text[-1] = self.text[-1].replace("<scriptTask ", '<scriptTask isForCompensation="true" ')
        self.text.append(f'<association id="{self.id("association")}" sourceRef="{event}" targetRef="{handler}"/>')
        thrown = self.after(host, self.node("intermediateThrowEvent", "<compensateEventDefinition/>", "", "compensate"))
        self.flow(thrown, self.node("endEvent", "", "", "end"))
        content, self.text = "".join(self.text), outside
        return self.after(before, self.node("subProcess", content, "", "undoing"))

    def _mapped(self, before: str, body: Sequence[Step]) -> str:
        """A sub-process with a variable of its own."""
        mapping = (
            '<extensionElements><camunda:inputOutput><camunda:inputParameter name="mine">${version}'
            '</camunda:inputParameter><camunda:outputParameter name="theirs">${mine + 1}</camunda:outputParameter>'
            "</camunda:inputOutput></extensionElements>"
        )
        return self._sub(before, [*body, ["run", 2000 + self._place[0], "mine = mine + 1"]], mapping)

    def _own(self, before: str, name: str) -> str:
        """A call whose process has variables of its own."""
        id = self.id("own")
        mapping = (
            '<extensionElements><camunda:in source="version" target="version"/>'
            f'<camunda:out source="done" target="done_{id}"/></extensionElements>'
        )
        self.text.append(f'<callActivity id="{id}" calledElement="P_{name}">{mapping}</callActivity>')
        return self.after(before, id)

    def _resume(self, before: str, body: Sequence[Step], trigger: str, handler: Sequence[Step]) -> str:
        """A sub-process that an event sub-process suspends for a while."""
        outside, self.text = self.text, []
        start = self.node("startEvent", self.trigger(trigger), "", "start")
        self._inside(start, handler)
        content, self.text = _properties(resume="true") + "".join(self.text), outside
        return self._sub(
            before, body, f'<subProcess id="{self.id("handler")}" triggeredByEvent="true">{content}</subProcess>'
        )


def text_of(mission: Mission, version: int) -> str:
    """The BPMN of a version."""
    if version == LAST:
        mission = {"robots": {name: [["timer", 1, "PT1H"]] for name in mission["robots"]}, "calls": {}, "edits": {}}
    edited = edits_of(mission, version)
    processes, pools, signals, messages = list[str](), list[str](), set[str](), set[str]()
    for name, steps in {**mission["calls"], **mission["robots"]}.items():
        made = _Lasting(name, version)
        first = steps[0][2] if steps and steps[0][0] == "start" else ""
        begin = made.node("startEvent", made.signal(first) if first else "", "", "start")
        begins = f"version = {version}\nhelped, done, kept = 0, {{}}, {{}}\nn = 0"
        if name in mission["calls"]:
            begins = "try: done, version, helped\nexcept NameError: done, helped = {}, 0"
        begin = made.after(begin, made.script(begins, "init"))
        end = made.steps(begin, list(_edited(steps[1:] if first else steps, edited)))
        if end is not None:
            made.flow(end, made.node("endEvent", "", "", "end"))
        signals |= made.signals
        messages |= made.messages
        processes.append(f'<process id="P_{name}" isExecutable="true">{"".join(made.text)}</process>')
        if name in mission["robots"]:
            pools.append(f'<participant id="Pool_{name}" name="{name}" processRef="P_{name}"/>')
    own = {"recovered": "~/recovered"}
    named = "".join(f'<signal id="Signal_{name}" name="{own.get(name, name)}"/>' for name in sorted(signals))
    named += "".join(f'<message id="Message_{name}" name="{name}"/>' for name in sorted(messages))
    named += "".join(f'<error id="Error_{code}" errorCode="{code}"/>' for code in (*CODES, *GOALS))
    team = f'<collaboration id="Team">{"".join(pools)}</collaboration>'
    return f'<definitions {_DECLARED} targetNamespace="t">{named}{team}{"".join(processes)}</definitions>'


# ---- versions --------------------------------------------------------------------------------------------------------


def is_started(mission: Mission, robot: str) -> bool:
    """Whether a signal starts its instances, each of which counts for itself."""
    return bool(mission["robots"][robot]) and mission["robots"][robot][0][0] == "start"


def kinds_met(mission: Mission, entered: Collection[str]) -> set[str]:
    """The kinds of steps of which some element was entered."""
    numbers = {id.rsplit("_", 2)[1] for id in entered if id.count("_") > 2}
    return {
        "pause" if kind == "resume" and mission["calm"] else kind
        for part in ("robots", "calls")
        for steps in mission[part].values()
        for kind, number, *_ in walk(steps)
        if str(number) in numbers
    }


def edits_of(mission: Mission, version: Any) -> dict[int, Step]:
    """What has become of steps, by number, up to a version."""
    known = [int(key) for key in mission["edits"] if int(key) <= version]
    return {number: [what, *more] for key in sorted(known) for number, what, *more in mission["edits"][str(key)]}


def _edited(steps: Sequence[Step], edits: Mapping[int, Step]) -> Iterator[Step]:
    for step in steps:
        kind, number, *rest = step
        step = [kind, number, *(list(_edited(each, edits)) if _is_steps(each) else each for each in rest)]
        match edits.get(number):
            case ["removed"]:
                continue
            case ["wrapped"]:  # a queue of a scope that begins later would miss what is told before
                hears = any(inner[0] in ("hear", "serve") for inner in walk([step]))
                step = step if hears else ["sub", 1000 + number, [step]]
            case ["before", other]:
                yield [other, 1000 + number]
            case ["bare"]:  # without its handler
                step = ["sub", number, rest[1 if kind == "limit" else 0]]
            case ["changed"]:  # a handler that interrupts no more must not start itself
                body, trigger, handler = step[2:]
                step = [_OTHER[kind], number, body, trigger, _quiet(handler)]
            case ["changed", *others]:
                step = [kind, number, *others]
        yield step


def steps_of(mission: Mission, robot: str, version: Any) -> list[list[Step]]:
    """What a robot does in a version: its own steps, and those of what it calls."""
    edits, own = edits_of(mission, version), mission["robots"][robot]
    called = sorted({step[2] for step in walk(own) if step[0] in ("call", "own")})
    return [list(_edited(steps, edits)) for steps in (own, *map(mission["calls"].get, called))]


def closed(mission: Mission, begun: Mapping[str, int]) -> dict[str, int]:
    """Those of which all partners have begun with the same version: whom each hears of, serves, and is served by."""
    steps = [(name, step) for name in mission["robots"] for step in walk(mission["robots"][name])]
    pairs = [(name, step[2]) for name, step in steps if step[0] in ("hear", "serve")]
    pairs += [(step[2], name) for name, step in steps if step[0] == "serve"]
    found = dict(begun)
    while alone := {one for one, other in pairs if one in found and found.get(other) != found[one]}:
        found = {name: version for name, version in found.items() if name not in alone}
    return found


def _is_steps(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(each, list) for each in value)


def walk(steps: Sequence[Step], without: str = "") -> Iterator[Step]:
    """All steps, at any depth, but for what is in those of a kind."""
    for step in steps:
        yield step
        for part in step[2:] if step[0] != without else ():
            if _is_steps(part):
                yield from walk(part, without)


def durations_of(mission: Mission) -> dict[str, float]:
    """How long timers wait that are the same in all versions, by id (s): none that a handler may suspend."""
    suspends = any(step[0] == "resume" for steps in mission["robots"].values() for step in walk(steps))
    edited = {edit[0] for edits in mission["edits"].values() for edit in edits}
    return {
        f"{name}_timer_{step[1]}_1": float(step[2][2:-1])
        for name, steps in {**({} if suspends else mission["calls"]), **mission["robots"]}.items()
        for step in walk(steps, "resume")
        if step[0] == "timer" and step[1] not in edited and mission["calm"]
    }


# ---- drawing ---------------------------------------------------------------------------------------------------------


def draw(seed: int) -> Mission:
    """A mission: one in ten is one of those that explorations are compared with; most others are calm."""
    chance = random.Random(f"mission {seed}")
    mission = _explored(seed) if chance.random() < 0.08 else _Drawing(chance, calm=chance.random() < 0.9).mission()
    steps = [step for part in ("robots", "calls") for all in mission[part].values() for step in _editable(all)]
    for version in ("2", "3", "4"):
        if steps and chance.random() < 0.8:
            mission["edits"][version] = [_edit(chance, chance.choice(steps)) for _ in range(chance.randint(1, 3))]
    beats = random.Random(f"beats {seed}")  # of its own, so that no other draw changes
    for number, (name, steps) in enumerate(mission["robots"].items(), 900):
        if not is_started(mission, name) and beats.random() < 0.4:
            mission["robots"][name] = [["beat", number, beats.choice(("R9/PT2S", "R6/PT3.3S", "R4/PT7S")), steps]]
    return mission


def _editable(steps: Sequence[Step], first: int = 0) -> Iterator[Step]:
    """All steps but those that begin a branch of a race, and those that have a limit, which a person would pass."""
    yield from steps[first:]
    for kind, _, *rest in steps:
        for part in rest if kind != "limit" else ():
            yield from _editable(part, int(kind == "race")) if _is_steps(part) else ()


_OTHER = {"beside": "scope", "scope": "beside", "watch": "guard", "guard": "watch"}
"""The same with a handler that interrupts, or does not."""


def _edit(chance: random.Random, step: Step) -> Step:
    kind, number, *_ = step
    if kind in ("start", "tell", "hear", "order", "serve", "error", "stop", "end"):
        return [number, "kept"]
    if kind == "timer":
        return [number, "changed", f"PT{chance.choice((1, 2, 8))}S"]
    if kind in ("throw", "catch", "queue", "send", "inbox") and chance.random() < 0.5:
        return [number, "changed", chance.choice("abm")]
    handled = [["changed"]] * (kind in _OTHER) + [["bare"]] * (kind in (*_OTHER, "limit", "resume", "never"))
    others = [["wrapped"], ["before", "note"], ["before", "work"], ["before", "person"], ["removed"]]
    return [number, *chance.choice(handled * 3 or others)]


def _explored(seed: int) -> Mission:
    """A collaboration of those that explorations are compared with."""
    made, more = varied(seed)
    robots = [name for name in made if name not in more["calls"]]
    names = dict(zip(robots, NAMES, strict=False))
    numbers = iter(range(1, 1000))

    def convert(step: Any) -> Step:
        if isinstance(step, str):
            kind, _, what = step.partition(" ")
            return [kind, next(numbers), *([what] if what else [])]
        kind, *rest = step
        return [
            kind,
            next(numbers),
            *([convert(one) for one in each] if isinstance(each, list) else each for each in rest),
        ]

    converted = {names.get(name, name): _quiet([convert(step) for step in steps], 0) for name, steps in made.items()}
    if starts := {name for name, steps in converted.items() if steps and steps[0][0] == "start"}:
        loud = starts.union(more["calls"])
        converted = {name: _quiet(steps) if name in loud else steps for name, steps in converted.items()}
    calls = {name: steps for name, steps in converted.items() if name in more["calls"]}
    return {
        "robots": {name: steps for name, steps in converted.items() if name not in calls},
        "calls": calls,
        "calm": False,
        "edits": {},
    }


RETRIES = ("safe", "never", "ask")
_SIMPLE = ("work", "work", "timer", "timer", "note", "person", "break", "tell", "go", "go", "ask", "date", "alert")
_NESTED = ("and", "and", "each", "turns", "sub", "call", "own", "until", "times", "limit", "caught", "undo", "some",
           "mapped", "pause")  # fmt: skip
_WILD = ("throw", "catch", "queue", "send", "inbox", "race", "resume", "beside", "watch", "guard", "scope", "fail")


KINDS = tuple(dict.fromkeys((*_SIMPLE, *_NESTED, *_WILD, "hear", "order", "serve", "beat")))
EDITS = ("removed", "wrapped", "before", "changed", "bare")
"""What is counted: kinds of steps, a robot of which has come to one; kinds of edits between two versions that met."""


_ACTIVITIES = ("work", "person", "sub", "each", "turns", "call", "mapped")
_LEAVES = (*_SIMPLE, "throw", "catch", "queue", "send", "inbox", "fail")


class _Drawing:
    """Draws the steps of a mission."""

    def __init__(self, chance: random.Random, *, calm: bool) -> None:
        self.chance, self.calm, self._number = chance, calm, 0
        few = chance.sample(_NESTED, 5), chance.sample(_SIMPLE, 6), chance.sample(_WILD, 5)
        self._nested, self._simple, self._wild = few  # swarm testing: what is rare meets itself
        self._tells = 0

    def mission(self) -> Mission:
        names = NAMES[: self.chance.choice((2, 2, 3, 3, 3, 4, 5))]
        calls = {"Help": self.steps(2, 1, alone=True)}
        robots, told, serves = {}, {}, dict[str, list[list[Step]]]()
        for name in names:
            self._tells = 0
            robots[name] = [self.step(0) for _ in range(self.chance.randint(2, 4))]
            told[name] = _told(robots[name])
        for name in names:
            others = [other for other in names if other != name and told[other] and self.chance.random() < 0.6]
            hears = [[["times", self.next(), told[other], [["hear", self.next(), other]]]] for other in others]
            if self.chance.random() < 0.2:
                count, other = self.chance.choice((2, 3)), self.chance.choice([one for one in names if one != name])
                hears.append([["order", self.next(), count]])
                serves.setdefault(other, []).append([["times", self.next(), count, [["serve", self.next(), name]]]])
            if hears:
                robots[name] = [["and", self.next(), robots[name], *hears]]
        for name, branches in serves.items():
            robots[name] = [["and", self.next(), robots[name], *branches]]
        if not self.calm and self.chance.random() < 0.4:  # one robot runs as often as the others throw
            robots = {**robots, names[-1]: [["start", self.next(), "s"], *_quiet(robots[names[-1]])]}
            robots[names[0]] = [
                ["times", self.next(), 3, [["timer", self.next(), "PT3S"], ["throw", self.next(), "s"]]]
            ]
        return {"robots": robots, "calls": calls, "calm": self.calm, "edits": {}}

    def next(self) -> int:
        self._number += 1
        return self._number

    def steps(self, depth: int, most: int = 2, *, alone: bool = False) -> list[Step]:
        return [self.step(depth, alone=alone) for _ in range(self.chance.randint(1, most))]

    def step(self, depth: int, *, alone: bool = False, nests: bool = False) -> Step:
        made = self._step(depth, alone=alone, nests=nests)
        guarded = made[0] in _ACTIVITIES and self.chance.random() < 0.4
        return ["never", self.next(), [made]] if guarded else made

    def _step(self, depth: int, *, alone: bool = False, nests: bool = False) -> Step:
        """`alone`: in a process that others call, with their variables or its own. `nests`: in another pause."""
        chance, number = self.chance, self.next()
        kinds = [*self._simple, *self._nested, *(() if self.calm else self._wild)]
        kind = chance.choice([kind for kind in kinds if depth < 2 or kind in _LEAVES])
        if alone and kind in ("tell", "go", "ask", "call", "own", "break"):
            kind = "work"
        if depth and kind == "pause" and not nests:  # its signal would reach others of its scope
            kind = "sub"
        body = lambda: self.steps(depth + 1, alone=alone)  # noqa: E731
        match kind:
            case "timer":
                return [kind, number, f"PT{chance.choice(('0.7', '1.5', '3', '6', '12'))}S"]
            case "date":
                return [kind, number, chance.choice((5, 15, 30))]
            case "work":
                return [kind, number, chance.choice(("0.5", "2", "5"))]
            case "go":
                how = chance.choice((*GOALS, "fast", "slow", "long"))
                limits: list[Any] = [[chance.choice(("PT0.3S", "PT2S", "PT2S"))], ["PT8S", True], []]
                limit = chance.choice(limits[: 3 - (how == "long")]) if how in ("slow", "long") else []
                return [kind, number, chance.choice(RETRIES), how, *limit]
            case "ask":
                return [kind, number, chance.choice(("true", "false")), chance.choice(RETRIES)]
            case "and":
                return [kind, number, body(), body()]
            case "some":
                return [kind, number, self.steps(2, alone=True), self.steps(2, alone=True)]
            case "each" | "turns" | "times":
                return [kind, number, chance.choice((2, 2, 3)), body()]
            case "sub" | "until" | "undo":
                return [kind, number, body()]
            case "mapped":
                return [kind, number, self.steps(2, alone=True)]
            case "pause":
                trigger = f"pause{number}"
                handler = [[*chance.choice((("timer", "PT1S"), ("timer", "PT6S"), ("work", "6")))]]
                handler[0].insert(1, self.next())
                throwing = [
                    ["timer", self.next(), chance.choice(("PT0.5S", "PT1.5S"))],
                    ["throw", self.next(), trigger],
                ]
                inner = [self.step(1, nests=not (depth or self.calm)) for _ in range(chance.randint(1, 2))]
                return ["resume", number, [["and", self.next(), throwing, inner]], trigger, handler]
            case "call" | "own":
                return [kind, number, "Help"]
            case "limit":
                return [kind, number, f"PT{chance.choice((2, 5, 9))}S", [["note", self.next()]]]
            case "caught":
                return [kind, number, body(), "c"]
            case "throw" | "catch" | "queue":
                return [kind, number, chance.choice("ab")]
            case "send" | "inbox":
                return [kind, number, "m"]
            case "fail":
                return [kind, number, "c"]
            case "race":
                return [kind, number, [["catch", self.next(), "a"], *body()], [["timer", self.next(), "PT4S"]]]
            case "resume" | "scope" | "guard":
                trigger = chance.choice(("a", "timer PT2S", "message m", "timer PT0.7S"))
                return [kind, number, body(), trigger, body()]
            case "beside" | "watch":
                trigger = chance.choice(("b", "timer PT2S", "message m"))
                return [kind, number, body(), trigger, _quiet([["work", self.next(), "0.5"], *body()])]
        return [kind, number]


def _quiet(steps: Sequence[Step], handlers: int = 1) -> list[Step]:
    """The same, but what handlers beside others do throws nothing, which could start more of them each time.

    Nor does what a signal starts: `handlers` is 1 for all of a process.
    """
    found = []
    for kind, number, *rest in steps:
        if handlers and kind in ("throw", "send", "tell"):
            found.append(["note", number])
            continue
        inner = handlers or (kind in ("beside", "watch"))
        found.append([kind, number, *(_quiet(part, inner) if _is_steps(part) else part for part in rest)])
    return found


def _told(steps: Sequence[Step], times: int = 1) -> int:
    """How often a robot tells something."""
    found = 0
    for kind, _, *rest in steps:
        found += times * (kind == "tell")
        repeated = times * (rest[0] if kind in ("each", "turns", "times") else 1)
        found += sum(_told(part, repeated) for part in rest if _is_steps(part))
    return found


# ---- the reference ---------------------------------------------------------------------------------------------------


Outcome = dict[str, Any]
"""Of a robot: the status, variables, visits and waiting tokens of each of its instances."""


def outcome_of(node: RobotNode) -> Outcome:
    """What has become of a robot's mission, without what depends on times."""
    return {
        f"instance {number}": {
            "status": one.status,
            "variables": {name: value for name, value in one.variables.items() if not _ignored(name)},
            "visits": {id: count for id, count in sorted(one.visits.items()) if not _is_loose(id)},
            "waiting": sorted(one.waiting),
        }
        for number, one in enumerate(node.instances)
    }


def _ignored(variable: str) -> bool:
    return variable in IGNORED or variable.startswith(("pause", "goal"))


def _is_loose(id: str) -> bool:
    return any(f"_{kind}_" in f"_{id}_" for kind in LOOSE)


@lru_cache(maxsize=16)
def reference(text: str) -> tuple[dict[str, Outcome], list[str]]:
    """What becomes of each robot where nothing fails: bare engines, and a person who helps at once.

    They share the simulated network of ``fame run``, with short partitions: also what does not hold of that.
    """
    scheduler, definitions, chance = Scheduler(), reader.read_text(text), random.Random(text)
    robots = [pool.name for pool in pools_of(definitions)]
    begins = [(chance.sample(robots, 2), chance.uniform(0, 10)) for _ in range(3)]
    cuts = [Partition((one, other), begin, begin + chance.uniform(1, 9)) for (one, other), begin in begins]
    links = (Link(Delay("uniform", 0, 0.1)),)
    middleware = LocalMiddleware(scheduler, network=Network(NetworkConfig(links, tuple(cuts)), 0, scheduler))
    telling = [f"tell_{name}" for name in robots if f'"{name}_tell_' in text] + [f"beat_{name}" for name in robots]
    arrived = {(name, topic): list[int]() for topic in telling for name in robots if name != topic[-1]}
    for (name, topic), counts in arrived.items():
        observer = middleware.node("observer", name)
        observer.subscription(f"/{topic}", _TOLD["type"], lambda one, counts=counts: counts.append(one.data), _ALL)
    for name in robots:  # something that is always under way
        beat = middleware.node("beating", name).publisher(f"/beat_{name}", _TOLD["type"], _ALL)
        for number in range(24):
            message = messages.create(_TOLD["type"], {"data": number})
            scheduler.at(number * SECOND // 2, partial(beat.publish, message))
    base = middleware.node("base")
    server = ActionServer(base, "/go", DRIVE, end_goal, lambda goal: True, accept=accepts)
    base.service("/ask", ASK, lambda request: {"success": request.data})
    pools = pools_of(definitions)
    shared = shared_topics(definitions, pools, Library().declared)
    nodes = [
        RobotNode(
            pool.name,
            make_mission(definitions, pool.process, shared=shared),
            scheduler=scheduler,
            middleware=middleware,
            options=RobotOptions(hold_errors=True, epoch=datetime.fromtimestamp(START, UTC)),
        )
        for pool in pools
    ]
    for node in nodes:
        node.load()
    for node in nodes:
        node.start()
    for _ in range(200):
        scheduler.run(scheduler.now + SECOND)
        for node in nodes:
            help_out(node)
        if all(one.status != "running" for node in nodes for one in node.instances):
            break
    found = {node.name: outcome_of(node) for node in nodes}
    for node in nodes:
        node.close()
    server.close()
    wrong = [
        f"{name} hears {counts} of {topic}" for (name, topic), counts in arrived.items() if counts != sorted(counts)
    ]
    return found, wrong


def accepts(goal: Any) -> bool:
    """Whether the server accepts a goal."""
    return round(goal.pose.pose.position.y) != GOALS["rejected"]


def end_goal(goal: ServerGoal) -> None:
    """A goal ends as it is to."""
    goal.end("aborted" if round(goal.message.pose.pose.position.y) == GOALS["aborted"] else "succeeded", {})


def help_out(node: RobotNode) -> None:
    """Complete each task of a person that waits, and retry what has failed."""
    for element, act, values in help_needed(node):
        node.complete(element) if act == "complete" else node.retry(element, values)


def help_needed(node: RobotNode) -> list[tuple[str, str, dict[str, Any]]]:
    """What a person has to do: element, act and values."""
    waits = [wait for one in node.engine.instances.values() for wait in one.waits()]
    persons = [wait.node.id for wait in waits if wait.catch.trigger is USER and not wait.due]
    failed = [element for element, *_ in node.incidents]
    return [(id, "complete", {}) for id in persons] + [(id, "retry", {"helped": 1}) for id in failed]
