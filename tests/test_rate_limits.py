"""Garbage in masses: what is refused is told once a second and cause."""

import json

import pytest
from deployment_field import Field, patrol

from fame.clock import SECOND, Scheduler
from fame.deploy import Report
from fame.deploy.requests import read_request
from fame.deploy.status import RateLimiter
from fame.errors import DeploymentError


def told(*texts: str | tuple[str, str], times: int = 1) -> list[str]:
    """What is said of refusals: a text that is its own cause, or (text, cause)."""
    scheduler, said = Scheduler(), []
    digest = RateLimiter(scheduler, said.append)
    for second in range(times):
        scheduler.run(second * SECOND)
        for text in texts:
            digest(*([text] if isinstance(text, str) else text))
    scheduler.run()
    return said


def test_the_first_is_told_at_once_and_the_others_with_their_number():
    many = [f"no task: '{number}'" for number in range(1500)]
    assert told(*((text, "syntax") for text in many)) == [many[0], f"{many[-1]} (1499 like this within a second)"]


def test_a_flood_is_told_once_a_second():
    assert len(told(*["too long: 5"] * 1000, times=5)) == 6


def test_causes_are_told_apart_but_not_without_end():
    different = told(("no task: 'x'", "syntax"), ("phase 'y'", "phase"), ("phase 'z'", "phase"))
    assert different == ["no task: 'x'", "phase 'y'", "phase 'z'"]
    assert len(told(*(f"{chr(97 + number % 26)}{chr(97 + number // 26)}" for number in range(400)))) == 22


def test_an_engine_tells_of_garbage_once_a_second_and_answers_whoever_waits_for_an_answer():
    notes = []
    field = Field("A", on_report=notes.append)
    field.send("A", patrol(1))
    field.pass_time(0.5)
    for number in range(500):
        field.send("A", f"garbage {number}")
        field.send(
            "A", json.dumps({"fame": 1, "deployment": f"d{number}", "sequence": 1, "robot": "A", "phase": "start"})
        )
        field.pass_time(0.001)
    field.pass_time(2)
    refused = [report for report in field.said if report.answer == "refused"]
    assert len([report for report in refused if not report.deployment]) == 2
    assert {report.deployment for report in refused} >= {f"d{number}" for number in range(500)}
    assert len(notes) == 4
    assert "499 like this" in notes[-1].detail
    field.engines["A"].close()


@pytest.mark.parametrize("long", [{"id": "i" * 1001}, {"element": "e" * 1001}, {"values": {"x": "v" * 1_000_000}}])
def test_tasks_with_long_names_or_values_are_refused_and_not_kept(long):
    with pytest.raises(DeploymentError, match="task"):
        read_request(json.dumps({"id": "i", "element": "e"} | long))


def test_a_long_report_is_none():
    report = {"robot": "A", "state": "idle", "reason": "r"}
    assert Report.from_json(json.dumps(report)) is not None
    assert Report.from_json(json.dumps(report | {"reason": "r" * 1_000_000})) is None
