"""What events do to the state of a run: the cases that the page's own tests have, too (`tests/page/store.test.mjs`)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from run_states import packer_at

from fame.robot.robot_state import EVENTS, VARIABLES, WAITING
from fame.view.state import WHATS

TABLE = json.loads((Path(__file__).parent / "page" / "state_cases.json").read_text("utf-8"))
CASES = TABLE["cases"]
NAMES = ("tokens", "counts", "ends", "variables", "waits")


def test_kinds_of_events_have_the_numbers_that_the_page_knows() -> None:
    assert list(WHATS) == TABLE["kinds"]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["says"])
def test_a_state_changes(case: Any) -> None:
    packer = packer_at(case.get("key", {}))
    known = {(robot, scope) for robot, _, scope, *_ in case.get("key", {}).get("tokens", ())}
    for time, topic, robot, data in messages(case, known):
        packer.state.robot(robot).apply(topic, data, time)
    rows = packer.key_json()
    rows["variables"] = [row for row in rows["variables"] if row[2]]
    rows["waits"] = [[robot, [plain(token) for token in tokens]] for robot, tokens in rows["waits"] if tokens]
    assert {name: sorted(rows[name]) for name in NAMES if rows[name]} == case["state"]


def plain(token: Any) -> Any:
    """A token as the cases have it: without what the page gets for it."""
    return {name: token[name] for name in ("key", "text")}


def messages(case: Any, known: set[tuple[int, int]]) -> list[tuple[int, str, int, dict[str, Any]]]:
    """The same as messages of a recording: time, topic, robot, content. Scopes open at their first event."""
    found: list[tuple[int, str, int, dict[str, Any]]] = []

    def opens(robot: int, instance: int, scope: int) -> list[dict[str, Any]]:
        if (robot, scope) in known:
            return []
        known.add((robot, scope))
        return [{"scope": scope, "instance": instance}]

    for time, robot, instance, scope, element, what, *detail in case.get("events", ()):
        marks = [[str(element), what, *detail]]
        group = {"instance": instance, "scope": scope, "marks": marks}
        found.append((time, EVENTS, robot, {"opens": opens(robot, instance, scope), "events": [group]}))
    for time, robot, scope, values, unset in case.get("variables", ()):
        change = {"gone": True} if values is None else {"set": values, "unset": unset}
        found.append((time, EVENTS, robot, {"opens": opens(robot, 1, scope), "events": []}))
        found.append((time, VARIABLES, robot, {"changes": [{"scope": scope, **change}]}))
    for time, robot, tokens, gone in case.get("waits", ()):
        waiting = [{"scope": 1, "element": "1", **token} for token in tokens]
        found.append((time, WAITING, robot, {"tokens": waiting, "gone": gone}))
    return found
