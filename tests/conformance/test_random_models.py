"""Random block-structured models: they complete, visit what a walk over the blocks visits, and leave nothing behind."""

from collections import Counter
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import pytest
from engine_models import (
    Run,
    boundary,
    element,
    flow,
    gateway,
    handler,
    model,
    path,
    script,
    signal,
    start,
    sub,
    throw,
    user,
)
from hypothesis import given, settings, strategies as st

KINDS = ("task", "script", "wait", "user", "throw", "sequence", "choice", "fork", "some", "loop", "sub", "handled")
LEAVES = KINDS[:5]
WAYS = ("straight", "restored", "recorded")
Block = tuple[Any, ...]


def blocks(depth: int) -> st.SearchStrategy[Block]:
    leaf = st.tuples(st.sampled_from(LEAVES))
    if depth == 0:
        return leaf
    inner = blocks(depth - 1)
    several = st.lists(inner, min_size=1, max_size=3)
    return st.one_of(
        leaf,
        st.tuples(st.sampled_from(("sequence", "fork", "ad hoc", "in turns")), several),
        st.tuples(st.just("choice"), several, st.integers(0, 2)),
        st.tuples(st.just("some"), several, st.integers(1, 7)),
        st.tuples(st.just("loop"), inner, st.integers(1, 3)),
        st.tuples(st.sampled_from(("sub", "handled")), inner),
    )


@dataclass
class Writer:
    """Writes blocks as BPMN, and counts what a walk over them visits."""

    content: list[str] = field(default_factory=list)
    count: int = 0
    visits: Counter[str] = field(default_factory=Counter)

    def name(self, kind: str) -> str:
        self.count += 1
        return f"{kind}{self.count}"

    def put(self, kind: str, passes: int) -> str:
        """A leaf, or a gateway."""
        id = self.name(kind)
        made = {
            "task": lambda: f'<task id="{id}"/>',
            "script": lambda: script(id, "n = n + 1"),
            "wait": lambda: script(id, "await sleep(0.5)"),
            "user": lambda: user(id),
            "throw": lambda: throw(id, signal("A")),
        }
        self.content.append(made[kind]() if kind in made else gateway(kind, id))
        self.visits[id] += passes
        return id

    def write(self, block: Block, passes: int) -> tuple[str, str]:
        """The first and the last element of a block that is passed so often."""
        kind = block[0]
        if kind in LEAVES:
            id = self.put(kind, passes)
            return id, id
        if kind == "sequence":
            ends = [self.write(item, passes) for item in block[1]]
            for (_, last), (first, _) in pairwise(ends):
                self.content.append(flow(last, first))
            return ends[0][0], ends[-1][1]
        if kind == "loop":
            return self.loop(block, passes)
        if kind in ("sub", "handled"):
            return self.scope(block, passes)
        if kind in ("ad hoc", "in turns"):
            return self.ad_hoc(block, passes)
        return self.split(block, passes)

    def split(self, block: Block, passes: int) -> tuple[str, str]:
        kind, ways = block[0], block[1]
        if kind == "fork":
            chosen = list(range(len(ways)))
        elif kind == "choice":
            chosen = [block[2] % len(ways)]
        else:
            chosen = [n for n in range(len(ways)) if block[2] >> n & 1] or [0]
        tag = {"fork": "parallel", "choice": "exclusive", "some": "inclusive"}[kind]
        opening, closing = self.put(tag, passes), self.put(tag, passes)
        for number, way in enumerate(ways):
            first, last = self.write(way, passes if number in chosen else 0)
            when = "" if kind == "fork" else str(number in chosen)
            self.content += [flow(opening, first, when), flow(last, closing)]
        return opening, closing

    def loop(self, block: Block, passes: int) -> tuple[str, str]:
        times, name = block[2], self.name("i")
        opening = self.put("exclusive", passes * times)
        first, last = self.write(block[1], passes * times)
        step, closing = self.name("step"), self.name("exclusive")
        after = self.put("task", passes)
        self.visits[step] += passes * times
        self.visits[closing] += passes * times
        text = f"{name} = globals().get('{name}', 0) % {times} + 1"
        self.content += [script(step, text), gateway("exclusive", closing), path(f"{opening} {first}")]
        self.content += [path(f"{last} {step} {closing}"), flow(closing, opening, f"{name} < {times}")]
        self.content.append(flow(closing, after, f"{name} == {times}"))
        return opening, after

    def scope(self, block: Block, passes: int) -> tuple[str, str]:
        id, outside = self.name("sub"), self.content
        self.content = []
        first, _ = self.write(block[1], passes)
        begin = self.name("start")
        self.content += [start(begin), path(f"{begin} {first}")]
        if block[0] == "handled":
            self.content.append(handler(self.name("h"), start(self.name("t"), signal("never"))))
        outside.append(sub(id, *self.content))
        self.content = outside
        self.visits[begin] += passes
        self.visits[id] += passes
        return id, id

    def ad_hoc(self, block: Block, passes: int) -> tuple[str, str]:
        id, outside = self.name("sub"), self.content
        self.content = []
        for way in block[1]:
            begin = self.put("task", passes)
            self.content.append(flow(begin, self.write(way, passes)[0]))
        order = {"ad hoc": "Parallel", "in turns": "Sequential"}[block[0]]
        outside.append(element("adHocSubProcess", id, *self.content, ordering=order))
        self.content = outside
        self.visits[id] += passes
        return id, id


def written(block: Block) -> tuple[str, Counter[str]]:
    writer = Writer()
    first, _ = writer.write(block, 1)
    writer.visits["s"] = 1
    return "".join([start(), path(f"s {first}"), *writer.content]), +writer.visits


def carry_through(run: Run, steps: int = 10_000) -> None:
    """Complete what waits, so often at the most."""
    run.run(0)
    for _ in range(steps):
        run.run(run.simulation.now + 1)
        users = [id for id in run.waiting if id.startswith("user")]
        if run.status != "running":
            return
        if users:
            run.complete(users[-1])


@pytest.mark.long_but("recorded")
@pytest.mark.parametrize("after", WAYS)
@settings(max_examples=50)
@given(block=blocks(4))
def test_they_complete_visit_what_a_walk_visits_and_leave_nothing_behind(block: Block, after: str) -> None:
    content, visits = written(block)
    run = Run(content, {"n": 0}, after=after)
    carry_through(run)
    assert run.status == "completed"
    assert run.instance.visits == visits
    assert not run.left_behind()
    assert run.simulation.scheduler.next_time() is None


@pytest.mark.long_but("recorded")
@pytest.mark.parametrize("after", WAYS)
@settings(max_examples=50)
@given(block=blocks(4), steps=st.integers(0, 12), how=st.sampled_from(("boundary", "handler")))
def test_cancelled_anywhere_they_leave_nothing_behind(block: Block, steps: int, how: str, after: str) -> None:
    content, _ = written(block)
    if how == "boundary":
        content = start("z") + sub("whole", content) + boundary("b", "whole", signal("stop")) + path("z whole")
    else:
        content += handler("b", start("bt", signal("stop")))
    run = Run(model(content), {"n": 0}, after=after)
    carry_through(run, steps)
    if run.status == "running":
        run.signal("stop").run()
        assert run.instance.visits["b"] == 1
    assert run.status == "completed"
    assert not run.left_behind()


@settings(max_examples=80)
@given(blocks(3), st.integers(0, 8), st.integers(1, 3))
def test_suspended_anywhere_they_go_on_as_if_nothing_had_happened(block: Block, steps: int, times: int) -> None:
    content, visits = written(block)
    run = Run(content + handler("h", start("ht", signal("pause")), resume=True), {"n": 0})
    carry_through(run, steps)
    for _ in range(times):
        run.signal("pause")
    carry_through(run)
    assert run.status == "completed"
    found = run.instance.visits
    assert {id: n for id, n in found.items() if id not in ("h", "ht")} == dict(visits)
    assert not run.left_behind()
