"""What events do to the state of a run: the cases that the page's own tests have, too (`tests/page/store.test.mjs`)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from run_states import run_state

from fame.log.reading import tally
from fame.robot.robot_state import EVENTS, VARIABLES, WAITING, RobotState
from fame.view.state import END, WHATS, TokenKey

TABLE = json.loads((Path(__file__).parent / "page" / "state_cases.json").read_text("utf-8"))
CASES = TABLE["cases"]
NAMES = ("tokens", "counts", "ends", "variables", "waits")

RECORDED = [case for case in CASES if "key" not in case and not case.get("counted_by_instance")]
"""A recording counts marks by element: that needs all of them, and does not tell instances of a robot apart."""


def test_kinds_of_events_have_the_numbers_that_the_page_knows() -> None:
    assert list(WHATS) == TABLE["kinds"]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["says"])
def test_a_view_does_it(case: Any) -> None:
    state = run_state(case.get("key", {}))
    for time, robot, instance, scope, element, what, *detail in case.get("events", ()):
        number = WHATS.index(what)
        state.event(time, TokenKey(robot, instance, scope, element), number)
        if number == END:
            state.end(robot, detail[0], time)
    for row in case.get("variables", ()):
        state.change_variables(*row)
    for _, *row in case.get("waits", ()):
        state.change_waits(*row)
    found = state.to_json()
    assert {name: sorted(found[name]) for name in NAMES if found[name]} == case["state"]


@pytest.mark.parametrize("case", RECORDED, ids=lambda case: case["says"])
def test_a_recording_does_it(case: Any) -> None:
    robots: dict[int, RobotState] = {}
    for topic, robot, data in messages(case):
        robots.setdefault(robot, RobotState()).apply(topic, data)
    counts, ends = [], []
    for robot, state in sorted(robots.items()):
        for element, marks in state.counts.items():
            done = tally(marks, over=bool(state.ended))
            counts.append([robot, int(element), *(done[outcome] for outcome in ("completed", "failed", "cancelled"))])
        if state.ended:
            ends.append([robot, sum(state.ended.values()), state.ended.get("failed", 0)])
    assert [row for row in counts if any(row[2:])] == case["state"].get("counts", [])
    assert ends == [row[:3] for row in case["state"].get("ends", [])]
    assert [
        [robot, scope, values.values] for robot, state in robots.items() for scope, values in state.scopes.items()
    ] == [
        [robot, scope, {name: value for name, (value, _) in values.items()}]
        for robot, scope, values in case["state"].get("variables", [])
    ]
    assert [[robot, list(state.tokens.values())] for robot, state in robots.items() if state.tokens] == case[
        "state"
    ].get("waits", [])


def messages(case: Any) -> list[tuple[str, int, dict[str, Any]]]:
    """The same as messages of a recording."""
    found: list[tuple[str, int, dict[str, Any]]] = []
    for _, robot, instance, scope, element, what, *detail in case.get("events", ()):
        marks = [[str(element), what, *detail]]
        found.append((EVENTS, robot, {"events": [{"instance": instance, "scope": scope, "marks": marks}]}))
    for _, robot, scope, values, unset in case.get("variables", ()):
        change = {"gone": True} if values is None else {"set": values, "unset": unset}
        found.append((VARIABLES, robot, {"changes": [{"instance": 1, "path": (), "scope": scope, **change}]}))
    for _, robot, tokens, gone in case.get("waits", ()):
        found.append((WAITING, robot, {"tokens": tokens, "gone": gone}))
    return found
