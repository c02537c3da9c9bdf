"""What happens in a run: what people do, and which faults strike when, drawn from the seed.

Swarm testing: each seed first draws which kinds of fault it uses at all, so that rare ones meet each other undisturbed.
A plan is data (JSON): what once failed is kept as a plan, since a seed means something else after a change of code.
"""

from __future__ import annotations

import json
import random
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from . import drawn
from .missions import ROBOTS

LONG = 45.0
"""When all faults end at the latest (s)."""
DESK = "desk"
"""The machine of the senders."""


@dataclass(frozen=True, slots=True, order=True)
class Step:
    """Something that happens at `time` (s). `target` is a robot, a machine or the number of a sender.

    With `on` it happens after `time`, as soon as a robot gives this answer (``A ready``).
    """

    time: float
    kind: str
    target: str = ""
    value: Any = None
    on: str = ""

    def __str__(self) -> str:
        on = f"  on {self.on}" if self.on else ""
        return f"{self.time:8.3f}  {self.kind} {self.target} {'' if self.value is None else self.value}".rstrip() + on


@dataclass(frozen=True, slots=True)
class Plan:
    """All that happens in the run of a seed; all faults end at `heal` (s). `mission`: what is drawn, see `drawn`."""

    seed: int
    steps: tuple[Step, ...]
    heal: float = LONG
    mission: drawn.Mission | None = None

    def to_json(self) -> str:
        steps = [list(asdict(step).values()) for step in self.steps]
        mission = {"mission": self.mission} if self.mission is not None else {}
        return json.dumps({"seed": self.seed, "heal": self.heal, "steps": steps, **mission})

    def with_steps(self, steps: Sequence[Step]) -> Plan:
        """The same with other steps."""
        return replace(self, steps=tuple(steps))

    @classmethod
    def from_json(cls, text: str) -> Plan:
        found = json.loads(text)
        steps = tuple(Step(*step) for step in found["steps"])
        return cls(found["seed"], steps, found.get("heal", LONG), found.get("mission"))

    @property
    def robots(self) -> tuple[str, ...]:
        """The names of the robots."""
        return ROBOTS if self.mission is None else tuple(self.mission["robots"])


SPLITTERS = ("S1", "S2")
FAULTS = ("kill", "stop", "cut", "loss", "delay", "match", "clock", "drift", "kill sender", "stop sender")
KEYS = ("stranger",)
"""What strikes only teams with keys."""
SERVER = "kill server", "stop server"
SPLITTER = "kill splitter", "stop splitter"
MONITOR = "kill monitor", "stop monitor", "cut monitor"
PROGRAMS = " server", " splitter", " monitor"
"""How the kinds of fault end that strike what runs beside the robots."""
MORE = ("twice", "mute", "slow disk")
"""What strikes in a few phases only."""
RARE = ("battery", "flip")
"""Drawn twice as often as others: few of them meet what a robot has to notice (a digit of a state, a timer)."""
DISK_FAULTS = ("power", "battery", "fuse", "full", "read-only", "flip", "erase")

_OF_ROBOTS = ("kill", "stop", "match", *DISK_FAULTS)
_OF_CLOCKS = ("clock", "drift")
_OF_NETWORKS = ("cut", "loss", "delay", "twice")
_STAGES = ("waiting", "loading", "matching", "ready", "holding", "running")
_SENDING = ("discovery", "load", "start")
PHASES = (
    {f"{kind} / {stage}" for kind in (*_OF_ROBOTS, *_OF_CLOCKS, *KEYS) for stage in _STAGES}
    | {f"{kind} / {phase}" for kind in (*_OF_CLOCKS, *_OF_NETWORKS) for phase in (*_SENDING, "nothing under way")}
    | {f"{kind} sender / {phase}" for kind in ("kill", "stop") for phase in _SENDING}
    | {f"{kind} {target} / running" for kind in ("kill", "stop") for target in ("server", "splitter", "monitor")}
)
"""Each fault with the phases in which it has to strike some time: those of the robot that it strikes, or of the newest
sender (of a clock: that of the senders' machine)."""


ACTS = ("complete", "complete", "complete", "retry", "move", "set", "skip", "suspend", "continue", "take_over", "steer",
        "fail", "restart", "note")  # fmt: skip
KINDS = {
    "elements": [("element ", kind) for kind in drawn.KINDS],
    "edits": [("edit ", kind) for kind in drawn.EDITS],
    "acts": [("", act) for act in (*dict.fromkeys(ACTS), "deploy", "migrate", "diagram")],
    "faults": [("", kind) for kind in (*FAULTS, *DISK_FAULTS, *SERVER, *MORE, "removed", "memory", "stubborn")],
    "row": [("", "crashes in a row")],
}
"""What is counted, by group: prefix in the counts, and name."""


KEPT = sorted((Path(__file__).parent / "found").glob("*.json"))
"""Plans that failed once."""


def draw(seed: int, *, fixed: bool = False) -> Plan:
    """The plan of a seed; one in ten varies a plan that failed once: where one fault was, others are near.

    Every second one has a mission that is drawn, too, unless missions are `fixed`.
    """
    if (varies := random.Random(f"kept {seed}")).random() < 0.1:
        return _varied(Plan.from_json(varies.choice(KEPT).read_text()), seed, varies)
    chance = random.Random(f"plan {seed}")
    steps = [Step(_rounded(chance.uniform(0, 2)), "start", robot) for robot in ROBOTS]
    steps += _deployments(chance)
    durable = chance.choice(((), ROBOTS, ROBOTS, tuple(robot for robot in ROBOTS if chance.random() < 0.5)))
    steps += [Step(0.0, "directory", robot) for robot in durable]
    begun = [step.time for step in steps if step.kind in ("deploy", "migrate")]
    signed = chance.random() < 0.3
    if signed:
        steps.append(Step(0.0, "keys"))
    kinds = FAULTS + DISK_FAULTS * bool(durable) + KEYS * signed
    if chance.random() < 0.25:
        steps.append(Step(0.0, "drives"))
        kinds += SERVER
    if chance.random() < 0.25:
        steps.append(Step(0.0, "breaks"))
        steps += [Step(_rounded(chance.uniform(5, 40)), "repair", "C", _by(chance)) for _ in range(4)]
    if random.Random(f"acknowledges {seed}").random() < 0.3:
        steps.append(Step(0.0, "acknowledges"))
    if chance.random() < 0.2:
        steps = [replace(step, kind="diagram") if step.kind in ("deploy", "migrate") else step for step in steps]
        steps += [Step(_rounded(chance.uniform(0, 4)), "splitter", name) for name in SPLITTERS[: chance.randint(1, 2)]]
        kinds = tuple(kind for kind in kinds if not kind.endswith(" sender")) + SPLITTER
    moments = [_moment(chance, begun) for _ in range(chance.randint(1, 2))]
    for kind in [kind for kind in kinds if chance.random() < 0.3]:
        for _ in range(chance.randint(1, 4)):
            step = _when(chance, moments, _fault(chance, kind, min(begun)))
            steps += _everywhere(chance, step) if kind in _OF_ROBOTS else [step]
    steps += _added(random.Random(f"added {seed}"), moments, min(begun), durable=bool(durable))
    steps += _working(random.Random(f"works {seed}"), moments, min(begun))
    if signed and "splitter" in {step.kind for step in steps}:  # what is signed later has to be dated later
        steps = [step for step in steps if not (step.kind in ("clock", "drift") and step.target == DESK)]
    heal = chance.choice((12.0, 20.0, 30.0, LONG))  # many short runs try more than a few long ones
    if chance.random() < 0.5:
        steps.append(Step(0.0, "delay", "", [chance.choice((0.05, 0.5, 2.0)), heal]))
    sooner = [replace(step, time=_rounded(step.time * max(heal / LONG, 0.4))) for step in steps]
    plan = Plan(seed, _sorted(step for step in sooner if step.time < heal), heal)
    missions = random.Random(f"drawn {seed}")
    return _with_mission(plan, drawn.draw(seed), missions) if not fixed and missions.random() < 0.7 else plan


def _added(chance: random.Random, moments: list[tuple[float, str]], begun: float, *, durable: bool) -> list[Step]:
    """What is drawn from numbers of its own, so that no other draw has changed since there is more to draw."""
    watched = chance.random() < 0.25
    steps = [Step(0.0, "watched")] if watched else []
    for kind in [kind for kind in (*MORE, *MONITOR * watched, *RARE * durable) if chance.random() < 0.3]:
        steps += [_when(chance, moments, _fault(chance, kind, begun)) for _ in range(chance.randint(1, 3))]
    return steps


def _working(chance: random.Random, moments: list[tuple[float, str]], begun: float) -> list[Step]:
    """Something that goes on all the time, and a person who suspends it for a while."""
    if chance.random() > 0.3:
        return []
    steps = [Step(_rounded(chance.uniform(begun, 30)), "suspend", "A", _rounded(chance.uniform(1, 15)))]
    steps = [_when(chance, moments, step) for step in steps * chance.randint(0, 2)]
    return [Step(0.0, "works"), *([Step(0.0, "stubborn")] if chance.random() < 0.5 else []), *steps]


def _varied(plan: Plan, seed: int, chance: random.Random) -> Plan:
    """A plan with another seed, whose steps come sooner or later, and a few of its faults not at all."""
    far, steps = chance.choice((0.02, 0.2, 2.0)), list[Step]()
    for step in plan.steps:
        time = _rounded(max(0.0, step.time + chance.choice((0.0, chance.gauss(0, far)))) if step.time else 0.0)
        if time < plan.heal and (step.kind not in (*FAULTS, *DISK_FAULTS) or chance.random() < 0.9):
            steps.append(replace(step, time=time))
    return Plan(seed, _sorted(steps), plan.heal, plan.mission)


_OF_MISSIONS = {"drives", "breaks", "repair", "acknowledges", "watched", "works", "stubborn", "suspend"}
_OF_MISSIONS |= {"start", "directory"}
"""What belongs to the missions that are not drawn, or is drawn again."""


def _with_mission(plan: Plan, mission: drawn.Mission, chance: random.Random) -> Plan:
    """The same for a drawn mission: other robots, which crash several times in a row, and people who act."""
    names = tuple(mission["robots"])
    cast = {robot: chance.choice(names) for robot in ROBOTS}
    cast |= dict(zip(ROBOTS, chance.sample(names, len(names)), strict=False))
    heal = max(plan.heal, 20.0)
    steps = [Step(_rounded(chance.uniform(0, 2)), "start", robot) for robot in names]
    keep = chance.random() < 0.97
    steps += [Step(0.0, "directory", robot) for robot in names if keep or chance.random() < 0.5]
    alone = chance.random() < 0.65  # what strikes is drawn here alone, while the mission runs
    for step in plan.steps if not alone else _first(plan.steps, chance):
        words = [cast.get(word, word) for word in step.target.split()]
        robot, _, answer = step.on.partition(" ")
        on = f"{cast[robot]} {answer}" if step.on else ""
        foreign = step.kind in _OF_MISSIONS or step.kind.endswith(" monitor") or "monitor" in words
        foreign = foreign or (step.kind in ("flip", "erase") and chance.random() < 0.85)
        if not foreign and len(set(words)) == len(words):
            steps.append(replace(step, target=" ".join(words), on=on))
    begun = min((step.time for step in plan.steps if step.kind in ("deploy", "diagram")), default=2.0)
    for _ in range(chance.choice((2, 3, 5) if alone else (0, 1, 2))):
        steps += _row(chance, chance.choice(names), begun + _early(chance, heal - begun - 5))
    if chance.random() < 0.4:
        steps += _around(chance, names, chance.uniform(begun + 1, heal - 3))
    if chance.random() < 0.3:
        steps += [Step(0.0, "slow disk", robot, chance.choice((0.3, 1.0, 2.5))) for robot in names]
    acts = chance.sample(ACTS, 5)
    for _ in range(chance.choice((0, 0, 3, 8))):
        steps.append(_act(chance, names, _wanted(chance, acts, begun + _early(chance, heal - begun))))
    if chance.random() < 0.5:
        steps += _replaced(chance, names, begun + 1 + _early(chance, heal - begun - 5))
    if chance.random() < 0.25:
        steps.append(Step(0.0, "stubborn"))
    if chance.random() < 0.15:  # robots that have promised give up a sender about when it is heard again
        steps.append(Step(_rounded(begun), "mute", DESK, _rounded(chance.uniform(4.5, 7.5)), f"{names[0]} ready"))
    if chance.random() < 0.4:  # a network that is bad all the time
        bad = {"delay": chance.choice((0.2, 0.6, 2.0)), "twice": 0.5, "loss": 0.3}
        steps += [Step(0.0, kind, "", [bad[kind], heal]) for kind in chance.sample(sorted(bad), 2)]
    migrations = [step.time for step in steps if step.kind == "migrate"]
    steps += _moments(random.Random(f"moments {plan.seed}"), mission, begun, migrations)
    return Plan(plan.seed, _sorted(step for step in steps if step.time < heal), heal, mission)


def _moments(chance: random.Random, mission: drawn.Mission, begun: float, migrations: Sequence[float]) -> list[Step]:
    """Crashes where it matters most: when a robot has come to some element, or has promised, and again once it is back.

    Numbers of its own, so that no other draw has changed since there is more to draw.
    """
    names, steps, soon = tuple(mission["robots"]), list[Step](), _rounded(begun + chance.random())
    if chance.random() < 0.5:
        robot = chance.choice(names)
        kinds = sorted({step[0] for step in drawn.walk(mission["robots"][robot])} - {"beat"})
        moments = [f"at {chance.choice(kinds)}"] * bool(kinds) + ["goal", "goal", "at timer", "effect"]
        again = f"{robot} resumed"
        for on in (f"{robot} {chance.choice(moments)}", *[again] * chance.choice((0, 1, 1, 2))):
            kind = chance.choices(("kill", "battery", "power"), (6, 1, 1))[0]
            away = _rounded(chance.choice((0.1, 0.5, 3.0)) * (0.5 + chance.random()))
            value = [away, _rounded(chance.choice((9, 200)) * chance.random())] if kind == "battery" else away
            steps.append(Step(soon, kind, robot, value, on))
    if chance.random() < 0.2:
        robot, away = chance.choice(names), _rounded(0.5 + 3 * chance.random())
        steps += [Step(soon, "kill", robot, away, f"{robot} {on}") for on in ("ready", "resuming")]
    if chance.random() < 0.2:  # others give a sender up just as it is heard again
        steps.append(Step(soon, "mute", DESK, _rounded(chance.uniform(5, 6.5)), f"{chance.choice(names)} ready"))
        steps.append(Step(0.0, "delay", "", [chance.choice((0.6, 2.0)), 20.0]))
    if chance.random() < 0.15:
        robot, moment = chance.choice(names), chance.choice(("at tell", "at go", "effect"))
        steps.append(Step(soon, "full", robot, [chance.randrange(2000), 2.0], f"{robot} {moment}"))
    if migrations and chance.random() < 0.5:  # people move tokens that a robot has promised to migrate
        robot, time = chance.choice(names), min(migrations)
        on = f"{robot} promises"
        steps.append(Step(time, "stop sender", "", _rounded(chance.uniform(1.5, 3.5)), on))
        for act in chance.choices(("move", "skip", "complete", "retry"), k=3):
            steps.append(Step(time, "act", robot, [act, chance.randrange(100), 0.0], on))
    return steps


def _early(chance: random.Random, end: float) -> float:
    """A time since a deployment began, mostly while the mission does something (s)."""
    return chance.uniform(chance.choice((1, 3, 3, 3)), min(end, chance.choice((10, 18, end))))


def _wanted(chance: random.Random, acts: Sequence[str], time: float) -> Step:
    """One of these acts."""
    value = [chance.choice(acts), chance.randrange(100), _rounded(chance.choice((0, 1, 8)) * chance.random())]
    return Step(_rounded(time), "act", "", value)


def _replaced(chance: random.Random, names: Sequence[str], time: float) -> list[Step]:
    """Another version comes, mostly by a migration; from two senders, one that is stopped, or beside acts."""
    version, robot, time = chance.randint(2, 4), chance.choice(names), _rounded(time)
    kinds = [chance.choice(("migrate", "migrate", "migrate", "deploy")) for _ in range(chance.choice((1, 1, 1, 2)))]
    steps = [Step(_rounded(time + n * chance.random()), kind, str(version), version) for n, kind in enumerate(kinds)]
    if chance.random() < 0.15:
        steps.append(Step(time, "stop sender", "", _rounded(chance.uniform(5, 25)), f"{robot} ready"))
    if chance.random() < 0.4:
        wanted = [_wanted(chance, ("move", "skip", "complete", "retry", "set", "restart"), time) for _ in range(2)]
        steps += [replace(step, target=robot, on=f"{robot} ready") for step in wanted]
    return steps


def _act(chance: random.Random, names: Sequence[str], step: Step) -> Step:
    """What somebody does, sometimes at an answer of a robot, or while it resumes."""
    robot = chance.choice(names)
    moment = chance.choice(("ready", "ready", "asking", "started", "resuming", "resuming"))
    on = f"{robot} {moment}" if chance.random() < 0.4 else ""
    return replace(step, target=step.target or robot, on=on)


def _around(chance: random.Random, names: Sequence[str], time: float) -> list[Step]:
    """What strikes around the robots: the server, the network, or half of the team at once."""
    kind, long = (
        chance.choice(("kill server", "stop server", "stop server", "loss", "twice", "delay", "cut", "stop", "mute")),
        6 * chance.random(),
    )
    time, long, robot = _rounded(time), _rounded(long), chance.choice(names)
    if kind == "mute":  # the sender, when robots have promised
        on = (f"{robot} ready", DESK) if chance.random() < 0.7 else ("", robot)
        return [Step(time, kind, on[1], _rounded(4 + long), on[0])]
    if kind == "stop":
        return [Step(time, kind, robot, long) for robot in chance.sample(names, max(1, len(names) // 2))]
    if kind == "cut":
        return [Step(time, kind, " ".join(chance.sample(names, 2)), 2 * long)]
    amount = _rounded(chance.choice((0.1, 0.5, 2.0 if kind == "delay" else 0.9)))
    on = f"{robot} goal" if kind.endswith("server") and chance.random() < 0.5 else ""
    return [Step(time, kind, "", long if kind.endswith("server") else [amount, long], on)]


def _first(steps: Sequence[Step], chance: random.Random) -> list[Step]:
    """The first deployment, perhaps the next one and keys, and no fault."""
    deploys = [step for step in steps if step.kind in ("deploy", "migrate", "diagram")]
    more = [replace(step, time=step.time + 8 * chance.random()) for step in deploys[1:2] if chance.random() < 0.5]
    return [*deploys[:1], *more, *(step for step in steps if step.kind in ("keys", "splitter"))]


_ROW = {"kill": 20, "power": 8, "fuse": 6, "full": 6, "memory": 3, "removed": 1}
"""What strikes a robot again and again, and how often."""


def _row(chance: random.Random, robot: str, time: float) -> list[Step]:
    """A robot crashes two or three times, each time soon after it is back."""
    steps = []
    if chance.random() < 0.3:  # while somebody has suspended it, or has asked for something else
        acts = ("suspend", "suspend", "suspend", "take_over", "steer", "complete", "set")
        steps.append(replace(_wanted(chance, acts, time - chance.uniform(0.2, 2)), target=robot))
    moment = chance.choice(("started", "goal", "effect", "", "", "", ""))
    for _ in range(chance.choice((1, 2, 2, 3))):
        away = _rounded(chance.choice((0.2, 1.0, 4.0)) * (0.5 + chance.random()))
        kind = chance.choices(*zip(*_ROW.items(), strict=True))[0]
        value = {"fuse": [chance.choice((0, chance.randrange(12))), away], "full": [chance.randrange(3000), away]}
        on = f"{robot} {moment}" if moment and kind in ("fuse", "kill", "power") else ""
        moment = ""  # what follows is later
        steps.append(Step(_rounded(time), kind, robot, value.get(kind, away), on))
        if kind == "full":  # and again, until it is removed
            steps.append(Step(_rounded(time + away + 0.5), kind, robot, [chance.randrange(3000), away]))
            steps += [Step(_rounded(time + 2 * away), "removed", robot, away)] * (chance.random() < 0.1)
        if chance.random() < 0.05:
            steps.append(
                Step(
                    _rounded(time + away / 2), "clock", robot, _rounded(chance.choice((9, 1e4)) * chance.uniform(-1, 1))
                )
            )
        time += away + chance.choice((0.3, 3.0, 8.0)) * chance.random()
    return steps


def _sorted(steps: Iterable[Step]) -> tuple[Step, ...]:
    return tuple(sorted(steps, key=lambda step: step.time))


def _moment(chance: random.Random, begun: list[float]) -> tuple[float, str]:
    """Soon after a deployment begins, or then at an answer of a robot."""
    soon = _rounded(chance.choice(begun) + chance.choice((0.7, 2, 10)) * chance.random())
    answer = chance.choice(("ready", "ready", "started", "started", "asking", "aborted", "refused"))
    return soon, chance.choice(("", f"{chance.choice(ROBOTS)} {answer}"))


def _when(chance: random.Random, moments: list[tuple[float, str]], step: Step) -> Step:
    """Faults strike at any time, or together at a moment."""
    if chance.random() < 0.3:
        return step
    time, on = chance.choice(moments)
    return replace(step, time=_rounded(time + (0 if on else 0.5 * chance.random())), on=on)


def _everywhere(chance: random.Random, step: Step) -> list[Step]:
    """Sometimes a fault of one robot strikes all at that moment: they share a room, its power, and what fills disks."""
    return [replace(step, target=robot) for robot in (ROBOTS if chance.random() < 0.15 else (step.target,))]


def _deployments(chance: random.Random) -> list[Step]:
    time, steps = 2.0, []
    for version in range(1, chance.randint(2, 5)):
        time += chance.choice((0.3, 2.0, 8.0, 15.0)) * chance.random()
        kind = "migrate" if version > 1 and chance.random() < 0.2 else "deploy"
        steps.append(Step(_rounded(time), kind, str(version), version))
    return steps


def _by(chance: random.Random) -> str:
    """How a person mends what has failed."""
    return chance.choice(("retry", "retry", "move"))


def _fault(chance: random.Random, kind: str, begun: float) -> Step:
    time = _rounded(chance.uniform(begun - 1, 30))
    long = _rounded(chance.choice((0.2, 2.0, 8.0, 14.0)) * (0.5 + chance.random()))
    match kind:
        case "kill" | "stop" | "match" | "power" | "read-only" | "flip" | "erase" | "stranger":
            return Step(time, kind, chance.choice(ROBOTS), long)
        case "cut":
            return Step(time, kind, " ".join(chance.sample((*ROBOTS, DESK), 2)), long)
        case "battery":
            back = _rounded(chance.choice((10, 1e3, 1e5)) * chance.random())
            return Step(time, kind, chance.choice(ROBOTS), [long, back])
        case "cut monitor":
            return Step(time, "cut", f"{chance.choice(ROBOTS[:2])} monitor", long)
        case "fuse" | "full":
            return Step(
                time, kind, chance.choice(ROBOTS), [chance.randrange(30) * (100 if kind == "full" else 1), long]
            )
        case "loss" | "twice":
            return Step(time, kind, "", [_rounded(chance.uniform(0.01, 0.6)), long])
        case "delay":
            return Step(time, kind, "", [_rounded(chance.choice((0.05, 0.5, 3.0))), long])
        case "mute":
            return Step(time, kind, chance.choice((*ROBOTS, DESK, DESK)), long)
        case "slow disk":
            return Step(time, kind, chance.choice((ROBOTS[0], *ROBOTS)), chance.choice((0.3, 1.0, 2.5)))
        case "clock":
            return Step(
                time,
                kind,
                chance.choice((*ROBOTS, DESK)),
                _rounded(chance.choice((1, 60, 1e5)) * chance.uniform(-1, 1)),
            )
        case "drift":
            return Step(
                time,
                kind,
                chance.choice((*ROBOTS, DESK)),
                round(10 ** chance.uniform(-5, -1) * chance.choice((-1, 1)), 6),
            )
    return Step(time, kind, chance.choice(SPLITTERS) if "splitter" in kind else "", long)


def _rounded(value: float) -> float:
    return round(value, 3)
