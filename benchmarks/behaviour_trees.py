"""Behaviour trees beside FAME: a thousand trivial actions in a row, and a reactive fallback that is ticked.

    pip install py_trees behaviortreepy
    python benchmarks/behaviour_trees.py

behaviortreepy is BehaviorTree.CPP with leaves in C++ (`native`) or in Python. Per second of processor time, the best of
seven turns. FAME's counterpart of the first is `benchmarks/engine.py --only sequence`. Of the second it has none:
a token that waits costs nothing until its signal comes.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import behaviortreepy
import py_trees

COUNT = 1000
_TREE = '<root BTCPP_format="4" main_tree_to_execute="M"><BehaviorTree ID="M">{}</BehaviorTree></root>'
_FALLBACK = '<ReactiveFallback><AlwaysFailure/><Sleep msec="100000"/></ReactiveFallback>'


def per_second(tick: Callable[[], object], ticks: int = 1) -> float:
    """How many actions, or ticks of several, in a second of processor time."""
    best = float("inf")
    for _ in range(7):
        begun = time.process_time()
        for _ in range(ticks):
            tick()
        best = min(best, time.process_time() - begun)
    return COUNT / best


def leaf(name: str, status: py_trees.common.Status) -> py_trees.behaviour.Behaviour:
    """A leaf that always gives the same status."""
    kind: Any = type(name, (py_trees.behaviour.Behaviour,), {"update": lambda self: status})
    return kind(name)


def cpp(inside: str) -> Callable[[], object]:
    """The tick of a tree of BehaviorTree.CPP."""
    factory = behaviortreepy.BehaviorTreeFactory()
    factory.register_simple_action("InPython", lambda *_: behaviortreepy.NodeStatus.SUCCESS)
    tree = factory.create_tree_from_text(_TREE.format(inside))
    kept.append((factory, tree))
    return tree.tick_exactly_once  # type: ignore[no-any-return]


kept: list[Any] = []


def main() -> None:
    done, failed, running = (getattr(py_trees.common.Status, name) for name in ("SUCCESS", "FAILURE", "RUNNING"))
    row = py_trees.composites.Sequence("row", memory=True, children=[leaf(str(n), done) for n in range(COUNT)])
    reactive = py_trees.composites.Selector("r", memory=False, children=[leaf("c", failed), leaf("g", running)])
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors, per second of processor time")
    print(f"py_trees: {per_second(row.tick_once):,.0f} actions, {per_second(reactive.tick_once, COUNT):,.0f} ticks")
    for kind, action in (("native", "AlwaysSuccess"), ("Python", "InPython")):
        actions = per_second(cpp(f"<Sequence>{f'<{action}/>' * COUNT}</Sequence>"))
        print(f"BehaviorTree.CPP, {kind}: {actions:,.0f} actions, {per_second(cpp(_FALLBACK), COUNT):,.0f} ticks")


if __name__ == "__main__":
    main()
