"""An element that is in another scope of the changed model: its token goes there, or the migration is refused."""

import sys
from collections.abc import Iterator
from pathlib import Path
from random import Random

import pytest

sys.path.insert(0, str(Path(__file__).parent / "conformance"))

from engine_models import (
    Run,
    boundary,
    call,
    catch,
    element,
    end,
    gateway,
    handler,
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
from fame.engine.program import Program
from fame.engine.snapshot import all_scopes
from fame.errors import MissionError

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


# ---- any pair of models ----------------------------------------------------------------------------------------------

MAPPED = (
    '<extensionElements><camunda:inputOutput><camunda:inputParameter name="v">1</camunda:inputParameter>'
    "</camunda:inputOutput></extensionElements>"
)


class Drawn:
    """A process of nested steps, and changed versions of it: each step is ``[kind, id, steps of each branch]``."""

    def __init__(self, seed: int) -> None:
        self.chance, self.number = Random(seed), 0
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

    def text(self, steps: list[list], name: str = "", trigger: str = "") -> str:
        before, text = f"s{name}", start(f"s{name}", trigger)
        for kind, id, *branches in steps:
            made, after = self.one(kind, id, branches)
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
    assert kept > 10, (kept, refused)
    assert moved > 2, moved
