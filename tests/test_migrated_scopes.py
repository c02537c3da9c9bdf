"""An element that is in another scope of the changed model: its token goes there, or the migration is refused."""

import re
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent / "conformance"))

from engine_models import (
    Run,
    boundary,
    call,
    catch,
    condition,
    element,
    end,
    gateway,
    handler,
    message,
    model,
    path,
    process,
    properties,
    script,
    signal,
    start,
    sub,
    timer,
    user,
)
from test_migration import Migrated

from fame.bpmn.model import Process, SubProcess
from fame.clock import SECOND
from fame.engine.program import Program
from fame.engine.snapshot import all_scopes
from fame.errors import MissionError
from fame.robot.events import Event

SEVERAL = "<multiInstanceLoopCharacteristics><loopCardinality>3</loopCardinality></multiInstanceLoopCharacteristics>"
OPEN = start() + user("w") + script("z", "n = n + 1") + end() + path("s w z e")


def inside(*content: str, before: str = "", behind: str = "") -> str:
    """The task w in a sub-process q, with a script before z."""
    body = start("qs") + user("w") + script("k", "k = 1") + end("qe") + path("qs w k qe")
    return start() + before + sub("q", *content, body) + behind + script("z", "n = n + 1") + end() + path("s q z e")


def run(content: str) -> Run:
    return Run(model(*content.replace("</process><process", "</process>\0<process").split("\0")), {"n": 0})


def misplaced(new: Migrated) -> list[str]:
    """Return the tokens that are not in the scopes which the model has around their elements."""
    engine = new.node.engine
    homes = homes_of(engine.program)
    wrong = []
    for scope in all_scopes(engine):
        for child in scope.children:
            node = child.node
            if node is None or node.id not in homes or getattr(child, "token", True) is False or scope.body is None:
                continue
            if scope.body.id not in (homes[node.id], node.id):
                wrong.append(f"{node.id} in {scope.body.id}, not {homes[node.id]}")
        if scope.parent is None:
            expected = engine.program.body
        elif scope.node is not None and scope.node.body is not None:
            expected = scope.node.body
        else:
            continue
        if not scope.handles and scope.body not in (None, expected):
            wrong.append(f"{scope.node} has the body {scope.body.id}")
    return wrong


def homes_of(program: Program) -> dict[str, str]:
    """Return the sub-process or process of each element."""

    def owners(owner: Process | SubProcess) -> Iterator[Process | SubProcess]:
        yield owner
        for node in owner.body.nodes:
            if isinstance(node, SubProcess):
                yield from owners(node)

    return {node.id: owner.id for process in program.sources for owner in owners(process) for node in owner.body.nodes}


def test_a_token_whose_task_is_in_a_new_sub_process_gets_its_scope() -> None:
    new = Migrated(run(OPEN).run(), inside())
    assert ([str(token) for token in new.tokens], misplaced(new)) == (["w: keep (begins q around it)"], [])
    new.simulation.complete("w")
    assert (new.instance.status, new.instance.variables["n"], new.instance.variables["k"]) == ("completed", 1, 1)
    assert new.instance.visits == {"s": 1, "w": 1, "k": 1, "qe": 1, "q": 1, "z": 1, "e": 1}


def test_the_new_scope_has_its_boundary_timer_its_handlers_and_its_queues() -> None:
    timed = boundary("b", "q", timer("PT3S")) + script("y", "y = 1") + path("b y")
    caught = handler("h", start("hs", signal("A"), interrupting=False) + script("m", "m = 1") + path("hs m"))
    new = Migrated(run(OPEN).run(), inside(caught, behind=timed))
    new.simulation.signal("A")
    assert (new.waiting, new.instance.variables["m"]) == (["w"], 1)
    new.simulation.run(3.5)
    assert (new.instance.status, new.instance.variables["y"], new.instance.variables["n"]) == ("completed", 1, 0)


def test_a_token_whose_task_has_left_a_sub_process_ends_that() -> None:
    after = start() + sub("q", start("qs") + script("k") + path("qs k")) + user("w") + script("z", "n = n + 1") + end()
    for there in (after + path("s q w z e"), OPEN):  # the sub-process is there, or is gone
        old = run(inside(behind=boundary("b", "q", signal("A")) + script("y", "y = 1") + path("b y"))).run()
        new = Migrated(old, there)
        assert [str(token) for token in new.tokens] == ["w: keep (leaves q, which ends)"]
        assert (new.waiting, misplaced(new), dict(new.node.engine.listeners)) == (["w"], [], {})
        new.simulation.complete("w")
        assert (new.instance.status, new.instance.variables["n"]) == ("completed", 1)


def test_observers_learn_which_scopes_and_tokens_begin_and_end() -> None:
    def marks(old: Run, changed: str, plan: dict[str, Any]) -> list[tuple[str, str]]:
        known = len(old.events)
        new = Migrated(old, changed, {"elements": plan})
        return [
            (one.element, one.what) for one in [*old.events[known:], *new.events] if one.what in ("enter", "cancel")
        ]

    assert marks(run(OPEN).run(), inside(), {}) == [("w", "cancel"), ("q", "enter"), ("w", "enter")]
    assert marks(run(inside()).run(), OPEN, {}) == [("w", "cancel"), ("q", "cancel"), ("w", "enter")]
    assert marks(run(inside()).run(), inside(), {"w": "restart"}) == [("w", "cancel"), ("w", "enter")]
    assert marks(run(OPEN).run(), OPEN.replace('"w"', '"v"').replace("s_w", "s_v"), {"w": {"to": "v"}}) == [
        ("w", "cancel"),
        ("v", "enter"),
    ]
    assert marks(run(OPEN).run(), OPEN, {}) == []
    assert marks(run(inside()).run(), inside(), {"q": "abandon"}) == [("w", "cancel"), ("q", "cancel")]


def test_tasks_that_change_their_sub_processes_are_done_once() -> None:
    def two(first: str, second: str) -> str:
        one = sub("q1", start("s1") + user(first) + path(f"s1 {first}"))
        return start() + one + sub("q2", start("s2") + user(second) + path(f"s2 {second}")) + end() + path("s q1 q2 e")

    new = Migrated(run(two("w", "v")).run(), two("v", "w"))
    assert (new.waiting, misplaced(new)) == (["w"], [])
    new.simulation.complete("w")
    assert (new.instance.status, new.instance.visits["q2"]) == ("completed", 1)


def test_an_event_takes_its_queue_and_its_boundary_timer_to_its_new_scope() -> None:
    typed = properties(queue="5", type="std_msgs/msg/Int32")
    event = catch("c", signal("A"), typed)
    work = user("w") + boundary("b", "w", timer("PT9S")) + script("y", "y = 1") + path("b y") + path("w c")
    old = run(start() + work + event + path("s w")).run(4).signal("A", 7)
    body = start("qs") + work + event + end("qe") + path("qs w") + path("c qe")
    new = Migrated(old, start() + sub("q", body) + end() + path("s q e"))
    assert misplaced(new) == []
    new.simulation.complete("w")
    assert (new.instance.status, new.instance.variables["A"]) == ("completed", 7)


def test_a_boundary_event_takes_its_own_queue_out_of_a_scope_that_ends() -> None:
    typed = properties(queue="5", type="std_msgs/msg/Int32")
    new = Migrated(run(within("w", signal("A"), typed)).run(0), AT_TASK + noting("w", signal("A"), typed))
    assert new.simulation.signal("A", 7).instances[0].variables["A"] == 7


REFUSED = {
    "repeated": (OPEN, inside(SEVERAL), "w: w is in q in the new model, which is a repeated embedded sub-process"),
    "handler": (
        OPEN,
        start() + user("u") + path("s u") + handler("h", start("hs", signal("A")) + user("w") + path("hs w")),
        "w is in h in the new model, which is a event sub-process in which no token is",
    ),
    "called": (
        OPEN,
        process(start() + call("c", "Q") + path("s c")) + process(start("t") + user("w") + path("t w"), id="Q"),
        "w is in Q in the new model, and its token is in another process",
    ),
    "two tokens": (
        start() + gateway("parallel", "g") + user("w") + user("v") + path("s g w") + path("g v"),
        start() + sub("q", start("t") + gateway("parallel", "g") + user("w") + user("v") + path("t g w") + path("g v"))
        + path("s q"),
        "in which another token is",
    ),
    "others stay": (
        start() + sub("q", start("t") + gateway("parallel", "g") + user("w") + user("v") + path("t g w") + path("g v"))
        + path("s q"),
        start() + sub("q", start("t") + user("v") + path("t v")) + user("w") + path("s q w"),
        "w is in P in the new model, and its token is in q with 1 more",
    ),
    "a pass": (inside(SEVERAL), start() + sub("q", SEVERAL, start("t") + user("v") + path("t v")) + user("w")
               + path("s q w"), "w is in P in the new model, and its token is in q, which is no plain sub-process"),
    "a handler now": (
        OPEN,
        start() + script("a") + boundary("b", "a", "<compensateEventDefinition/>") + user("v") + path("s a v")
        + element("userTask", "w", isForCompensation="true")
        + element("association", "x", sourceRef="b", targetRef="w"),
        "w is a compensation handler in the new model",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_where_the_new_scopes_are_not_clear_the_migration_is_refused(name: str) -> None:
    old, changed, said = REFUSED[name]
    before = run(old).run()
    with pytest.raises(MissionError, match=said):
        Migrated(before, changed)
    assert before.node.engine.instances  # nothing has changed


def test_a_plan_begins_what_a_token_cannot_be_in() -> None:
    new = Migrated(run(OPEN).run(), inside(SEVERAL), {"elements": {"w": {"to": "q"}}})
    assert (new.waiting, misplaced(new)) == (["w"] * 3, [])
    new = Migrated(run(OPEN).run(), inside(), {"elements": {"w": "restart"}})
    assert (new.waiting, misplaced(new)) == (["w"], [])


def test_a_boundary_event_that_is_at_another_activity_now_is_closed() -> None:
    content = start() + user("w") + user("v") + script("y", "y = 1") + path("s w v") + path("b y")
    old = run(content + boundary("b", "w", signal("A"))).run()
    new = Migrated(old, content + boundary("b", "v", signal("A")))
    new.simulation.signal("A")
    assert new.waiting == ["w"]
    new.simulation.complete("w")
    new.simulation.signal("A")
    assert new.waiting == []


def test_a_boundary_event_that_needs_more_signals_now_is_armed_anew() -> None:
    def all_of(names: str) -> str:
        event = boundary("b", "w", *map(signal, names), parallelMultiple="true")
        return start() + user("w") + event + user("y") + path("s w") + path("b y")

    new = Migrated(run(all_of("AB")).run().signal("A"), all_of("ABC"))
    for name in "BCA":
        assert new.waiting == ["w"]
        new.simulation.signal(name)
    assert new.waiting == ["y"]


def test_a_call_gets_what_it_calls_now_and_another_call_of_the_same_process_does_not_matter() -> None:
    def two(first: str) -> str:
        calls = start() + call("c1", first) + call("c2", "Q") + path("s c1 c2")
        q, r = (process(start(f"{id}s") + user(f"{id}w") + path(f"{id}s {id}w"), id=id) for id in "QR")
        return process(calls) + q + r

    old = run(two("Q")).run()
    old.complete("Qw")
    new = Migrated(old, two("R"))
    assert (new.waiting, misplaced(new)) == (["Qw"], [])
    with pytest.raises(MissionError, match="Qw is in Q in the new model, and its token is in c1"):
        Migrated(run(two("Q")).run(), two("R"))


def test_a_refused_sub_process_of_another_id_says_what_a_plan_can_do() -> None:
    both = start("t") + gateway("parallel", "g") + user("w") + user("v") + path("t g w") + path("g v")
    event = handler("h", start("hs", signal("A"), interrupting=False) + script("m") + path("hs m"))
    for content in (both + event, SEVERAL + start("t") + user("w") + path("t w"), sub("r", both)):
        old = start() + sub("q", content) + path("s q")
        changed = old.replace('"q"', '"q9"').replace('"r"', '"r9"')
        plan = {"elements": {"q": {"to": "q9"}, "r": {"to": "r9"}}}
        with pytest.raises(MissionError, match=r"q: the new model has no element q; {to: q9} in the plan keeps its"):
            Migrated(run(old).run(0), changed)
        assert misplaced(Migrated(run(old).run(0), changed, plan)) == []


# ---- boundary events that move with it -------------------------------------------------------------------------------

AT_TASK = start() + user("w") + end() + path("s w e")
WITHIN = start() + sub("q", start("qs") + user("w") + path("qs w")) + end() + path("s q e")
DEEPER = (
    start() + sub("q", start("qs") + sub("r", start("rs") + user("w") + path("rs w")) + path("qs r")) + end()
    + path("s q e")
)  # fmt: skip
RENAMED = WITHIN.replace('"q"', '"q9"')


def noting(activity: str, *trigger: str, interrupting: bool = False, **attributes: str) -> str:
    """A boundary event b with a script that notes that it has happened."""
    event = boundary("b", activity, *trigger, interrupting=interrupting, **attributes)
    return event + script("y", "n = n + 1") + path("b y")


def within(activity: str, *trigger: str, **how: Any) -> str:
    """The task w in q, with a boundary event there."""
    inside = noting(activity, *trigger, **how) + '<userTask id="w"'
    return WITHIN.replace('<userTask id="w"', inside)


def moves(*trigger: str, **how: Any) -> Iterator[tuple[str, str]]:
    """Pairs of models in which the boundary event b moves to what is around its activity, or in it."""
    at_task, at_sub = AT_TASK + noting("w", *trigger, **how), WITHIN + noting("q", *trigger, **how)
    yield at_task, at_sub
    yield at_task, DEEPER + noting("q", *trigger, **how)
    yield at_sub, RENAMED + noting("q9", *trigger, **how)
    yield at_sub, at_task
    yield DEEPER + noting("q", *trigger, **how), at_task
    yield within("w", *trigger, **how), at_sub
    yield at_sub, within("w", *trigger, **how)


def pairs(*trigger: str, **how: Any) -> Iterator[tuple[Run, str]]:
    return ((run(old).run(0), new) for old, new in moves(*trigger, **how))


def said(new: Migrated) -> list[str]:
    return [token.reason for token in new.tokens if token.reason]


def test_a_boundary_event_that_has_happened_has_happened_where_it_is_now() -> None:
    for old, changed in pairs(timer("PT1S")):
        assert old.run(5).variables["n"] == 1
        new = Migrated(old, changed)
        new.simulation.run(20)
        assert (new.instance.variables["n"], new.waiting, misplaced(new)) == (1, ["w"], []), changed


def test_a_boundary_timer_keeps_its_time_where_it_is_now_and_a_cycle_its_count() -> None:
    for interrupting in (True, False):
        for old, changed in pairs(timer("PT14S"), interrupting=interrupting):
            new = Migrated(old.run(10), changed)
            assert new.simulation.run(13.9).instances[0].variables["n"] == 0
            assert new.simulation.run(14.1).instances[0].variables["n"] == 1, changed
            assert new.instance.status == ("completed" if interrupting else "running")
    for old, changed in pairs(timer("R3/PT4S", "Cycle")):
        new = Migrated(old.run(9), changed)
        new.simulation.run(11.9)
        assert new.instance.variables["n"] == 2
        new.simulation.run(60)
        assert new.instance.variables["n"] == 3, changed


def test_a_boundary_event_that_waits_keeps_what_it_has_where_it_is_now() -> None:
    for old, changed in pairs(condition("n >= 0")):
        assert (old.variables["n"], Migrated(old, changed).instance.variables["n"]) == (1, 1)
    for old, changed in pairs(signal("A"), signal("B"), parallelMultiple="true"):
        new = Migrated(old.signal("A"), changed)
        assert new.simulation.signal("B").instances[0].variables["n"] == 1, changed
        assert new.simulation.signal("B").instances[0].variables["n"] == 1
    for old, changed in pairs(message("M"), properties(queue="5")):
        assert old.message("M").variables["n"] == 1
        assert Migrated(old, changed).simulation.message("M").instances[0].variables["n"] == 2, changed


def test_an_event_sub_process_that_moves_with_its_task_keeps_its_state() -> None:
    event = handler("h", start("hs", timer("PT4S"), interrupting=False) + script("m", "n = n + 1") + path("hs m"))
    outer, inner = AT_TASK + event, WITHIN.replace('<userTask id="w"', event + '<userTask id="w"')
    for old, changed in ((outer, inner), (inner, outer), (inner, inner.replace('"q"', '"q9"'))):
        for second, before in ((3, 0), (9, 1)):
            new = Migrated(run(old).run(second), changed)
            assert (new.simulation.run(4.1) if not before else new.simulation).instances[0].variables["n"] == 1
            new.simulation.run(30)
            assert (new.instance.variables["n"], said(new)[0].count("anew")) == (1, 0)


TWICE = start() + gateway("parallel", "g") + user("w") + path("s g w")
TWICE += element("sequenceFlow", "f", sourceRef="g", targetRef="w")
ANEW = {
    "another kind": (AT_TASK + noting("w", timer("PT9S")), AT_TASK + noting("w", signal("A")), "arms b anew"),
    "another kind, moved": (
        AT_TASK + noting("w", timer("PT9S")),
        WITHIN + noting("q", signal("A")),
        "begins q around it, arms b anew",
    ),
    "two tokens": (
        start() + sub("q", TWICE.replace('"s"', '"qs"')) + path("s q") + noting("q", timer("PT9S")),
        start() + sub("q", TWICE.replace('"s"', '"qs"') + noting("w", timer("PT9S"))) + path("s q"),
        "arms b anew",
    ),
    "at a task beside it": (
        start() + gateway("parallel", "g") + user("w") + user("v") + path("s g w") + path("g v")
        + noting("w", timer("PT9S")),
        start() + gateway("parallel", "g") + user("w") + user("v") + path("s g w") + path("g v")
        + noting("v", timer("PT9S")),
        "arms b anew",
    ),
    "at a task that is not reached": (
        start() + user("w") + user("v") + path("s w v") + noting("w", timer("PT9S")),
        start() + user("w") + user("v") + path("s w v") + noting("v", timer("PT9S")),
        "closes b",
    ),
    "with a name": (
        AT_TASK + noting("w", timer("PT9S"), name="late"), AT_TASK + noting("w", signal("A")), 'arms "late" (b) anew'
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ANEW)
def test_a_boundary_event_that_cannot_keep_its_state_is_named(name: str) -> None:
    old, changed, expected = ANEW[name]
    new = Migrated(run(old).run(0), changed)
    assert (set(said(new)), misplaced(new)) == ({expected}, [])


def test_a_plan_can_arm_a_boundary_event_anew() -> None:
    old = run(AT_TASK + noting("w", timer("PT4S"))).run(3)
    new = Migrated(old, AT_TASK + noting("w", timer("PT4S")), {"elements": {"b": "restart"}})
    assert (said(new), new.simulation.run(6.9).instances[0].variables["n"]) == (["arms b anew"], 0)
    assert new.simulation.run(7.1).instances[0].variables["n"] == 1


# ---- any pair of models ----------------------------------------------------------------------------------------------

MAPPED = (
    '<extensionElements><camunda:inputOutput><camunda:inputParameter name="v">1</camunda:inputParameter>'
    "</camunda:inputOutput></extensionElements>"
)


class Drawn:
    """A process of nested steps, and changed versions of it: each step is ``[kind, id, steps of each branch]``.

    `timers` has boundary events: the activity of each, and its time (s).
    """

    def __init__(self, seed: int) -> None:
        self.chance, self.number = Random(seed), 0
        self.timers: dict[str, tuple[str, int]] = {}
        self.steps = self.sequence(3)

    def sequence(self, depth: int) -> list[list]:
        return [self.step(depth) for _ in range(self.chance.randint(1, 3))]

    def step(self, depth: int) -> list:
        self.number += 1
        kind = self.chance.choice(["user"] * 3 + ["sub", "sub", "both", "each", "mapped", "handled"] * bool(depth))
        branches = {"user": 0, "both": 2, "handled": 2}.get(kind, 1)
        return [kind, f"{kind[0]}{self.number}", *(self.sequence(depth - 1) for _ in range(branches))]

    def changed(self, steps: list[list]) -> list[list]:
        """Return the steps with others around some, and without those around some."""
        made: list[list] = []
        for kind, id, *branches in steps:
            inner = [self.changed(branch) for branch in branches]
            chance = self.chance.random()
            if chance < 0.15 and kind in ("sub", "each", "mapped"):
                made += inner[0]
            elif chance < 0.3:
                self.number += 1
                around = self.chance.choice(("sub", "sub", "sub", "each", "mapped"))
                made.append([around, f"{around[0]}{self.number}", [[kind, id, *inner]]])
            else:
                made.append([kind, id, *inner])
        if len(made) > 1 and self.chance.random() < 0.15:  # a step goes into the sub-process before it, or behind it
            host = next((step for step in made[:-1] if step[0] == "sub"), None)
            if host is not None:
                host[2].append(made.pop())
        return made

    def add_timers(self, chance: Random) -> None:
        """Draw boundary events."""
        for activity in activities(self.steps):
            if chance.random() < 0.6:
                self.timers[f"t{len(self.timers)}"] = activity, chance.randint(2, 30)

    def move_timers(self, steps: list[list], chance: Random) -> None:
        """Move some boundary events of the steps to what is around their activity in changed ones, or in it."""
        before, now = activities(self.steps), activities(steps)
        for event, (activity, seconds) in tuple(self.timers.items()):
            near = [each for each in now if activity in now[each] or each in now.get(activity, before[activity])]
            if activity not in now or (near and chance.random() < 0.5):
                activity = chance.choice(near or list(now))
            self.timers[event] = activity, seconds

    def text(self, steps: list[list], name: str = "", trigger: str = "") -> str:
        before, text = f"s{name}", start(f"s{name}", trigger)
        for kind, id, *branches in steps:
            made, after = self.one(kind, id, branches)
            there = [id, *(f"{id}_{each}" for each in range(2))]
            for event, (activity, seconds) in self.timers.items():
                if activity in there:
                    made += boundary(event, activity, timer(f"PT{seconds}S"), interrupting=False)
            text += made + element("sequenceFlow", f"f{id}", sourceRef=before, targetRef=id)
            before = after
        return text + end(f"e{name}") + element("sequenceFlow", f"fe{name}", sourceRef=before, targetRef=f"e{name}")

    def one(self, kind: str, id: str, branches: list[list[list]]) -> tuple[str, str]:
        match kind:
            case "user":
                return user(id), id
            case "both":
                made = gateway("parallel", id) + gateway("parallel", f"{id}j")
                for each, branch in enumerate(branches):
                    made += sub(f"{id}_{each}", self.text(branch, f"{id}_{each}")) + path(f"{id} {id}_{each} {id}j")
                return made, f"{id}j"
            case "handled":
                event = handler(f"{id}h", self.text(branches[1], f"{id}h", signal("A")))
                return sub(id, self.text(branches[0], id), event), id
            case _:
                extra = {"each": SEVERAL, "mapped": MAPPED}.get(kind, "")
                return sub(id, extra, self.text(branches[0], id)), id


def activities(steps: list[list]) -> dict[str, set[str]]:
    """Return the activities of some steps, each with those in it."""
    found: dict[str, set[str]] = {}
    for kind, id, *branches in steps:
        of_branches = [activities(branch) for branch in branches]
        if kind == "both":
            found |= {f"{id}_{each}": set(branch) for each, branch in enumerate(of_branches)}
        else:
            found[id] = {one for branch in of_branches for one in branch}
        for branch in of_branches:
            found |= branch
    return found


def times(events: list[Event], element: str, since: int) -> list[int]:
    """Return when an event has happened after a second (s)."""
    return [one.time // SECOND for one in events if (one.element, one.what) == (element, "enter")
            and one.time > since * SECOND]  # fmt: skip


def open_marks(events: list[Event]) -> dict[tuple[int, str], int]:
    """Return where observers saw more or less tokens enter an element than end there."""
    change = {"enter": 1, "leave": -1, "cancel": -1}
    marks: Counter[tuple[int, str]] = Counter()
    for one in events:
        marks[one.scope, one.element] += change.get(one.what, 0)
    return {where: number for where, number in marks.items() if number}


def unbalanced(new: Migrated) -> list[str]:
    """Return the scopes that count other tokens than they have."""
    return [
        f"{scope.node}: {scope.tokens}"
        for scope in all_scopes(new.node.engine)
        if scope.tokens
        != sum(getattr(child, "token", True) for child in scope.children)
        + sum(sum(counts[: join.spec.need]) for join, counts in (scope.joins or {}).items())
    ]


@pytest.mark.parametrize("seeds", [range(start, start + 60) for start in range(0, 300, 60)], ids=str)
def test_every_token_of_a_migrated_state_is_in_the_scopes_around_its_element(seeds: range) -> None:
    kept, moved, refused = 0, 0, 0
    for seed in seeds:
        drawn = Drawn(seed)
        old = run(drawn.text(drawn.steps)).run()
        for _ in range(drawn.chance.randint(0, 5)):
            tasks = [one for one in old.waiting if one.startswith("u")]
            if drawn.chance.random() < 0.2 and "handled" in str(drawn.steps):
                old.signal("A")
            elif tasks:
                old.complete(drawn.chance.choice(tasks))
        if old.instance.status != "running":
            continue
        try:
            new = Migrated(old, drawn.text(drawn.changed(drawn.steps)))
        except MissionError:
            refused += 1
            continue
        moved += any(token.reason for token in new.tokens)
        kept += 1
        assert (misplaced(new), unbalanced(new)) == ([], []), seed
        for _ in range(500):
            if new.instance.status != "running":
                break
            new.simulation.complete(next(one for one in new.waiting if one.startswith("u")))
        assert new.instance.status == "completed", seed
        assert open_marks([*old.events, *new.events]) == {}, seed
    assert kept > 10, (kept, refused)
    assert moved > 2, moved


@pytest.mark.parametrize("seeds", [range(start, start + 60) for start in range(0, 300, 60)], ids=str)
def test_a_boundary_event_happens_when_it_would_have_without_the_migration_or_is_named(seeds: range) -> None:
    moved, named = 0, 0
    for seed in seeds:
        drawn, chance = Drawn(seed), Random(seed)
        drawn.add_timers(chance)
        old, on = (run(drawn.text(drawn.steps)).run(0) for _ in range(2))  # `on` goes on as it was
        for _ in range(chance.randint(0, 4)):
            tasks = [one for one in old.waiting if one.startswith("u")]
            done = chance.choice(tasks) if tasks else ""
            for each in (old, on) if done else ():
                each.complete(done)
        steps, before = drawn.changed(drawn.steps), dict(drawn.timers)
        drawn.move_timers(steps, chance)
        try:
            new = Migrated(old.run(10), drawn.text(steps))
        except MissionError:
            continue
        assert (misplaced(new), unbalanced(new)) == ([], []), seed
        on.run(60)
        new.simulation.run(60)
        armed = Counter(re.findall(r"arms (\w+) anew", " ".join(said(new))))
        closed = re.findall(r"closes (\w+)", " ".join(said(new)))
        for event, (activity, seconds) in drawn.timers.items():
            found, before_that = (Counter(times(each.events, event, 10)) for each in (new, on))
            anew = Counter({10 + seconds: armed[event]})
            where = seed, event, before[event], activity
            assert found >= anew, where
            if armed[event] or event in closed:  # in some passes of a loop it may keep its state
                assert found - anew <= before_that, where
            else:
                assert found == before_that, where
            moved += (
                not armed[event]
                and event not in closed
                and before[event][0] != activity
                and bool(times(on.events, event, 0))
            )
            named += armed[event]
    assert moved
    assert named
