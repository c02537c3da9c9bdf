"""``fame deploy`` watches what it has deployed: failures, the end, engines that leave."""

from dataclasses import replace

import pytest
from deployment_field import ERROR, Field, definitions, job, patrol, process, timer

from fame.clock import SECOND
from fame.deploy import Deployment
from fame.scenario.deployment import MissionWatch


def mission(seconds: int, end: str = "") -> str:
    """A robot that waits for some seconds and then ends, perhaps in an error."""
    content = f'<startEvent id="s"/>{timer("t", seconds)}<endEvent id="e" name="no way">{end}</endEvent>'
    return definitions(
        '<error id="E" name="unreachable" errorCode="unreachable"/>', process("p", content, ("s", "t"), ("t", "e"))
    )


def watched(field: Field, sent: Deployment, seconds: float) -> tuple[MissionWatch, list[str]]:
    """What is said until the end, at most some seconds."""
    watch, lines = MissionWatch(sent.id, sent.pools), list[str]()
    until = field.scheduler.now + seconds * SECOND
    while not watch.over and field.scheduler.now < until:
        field.pass_time(0.05)
        lines += watch.look(sent.reports, field.scheduler.now)
    return watch, lines


@pytest.mark.parametrize("seconds", [0, 1, 60])
def test_a_mission_that_fails_after_its_start_is_told_with_its_reason(seconds: int):
    field = Field("p")
    sent = field.deploy(mission(seconds, ERROR))
    assert sent.robots["p"].state == "started"
    watch, lines = watched(field, sent, 120)
    assert watch.over
    assert lines == ["p: the mission has failed: e (team.bpmn:1): error unreachable was not caught"]
    assert list(watch.failures) == ["p"]


def test_a_mission_that_completes_is_over_without_a_failure():
    field = Field("p")
    watch, lines = watched(field, field.deploy(mission(60)), 120)
    assert (watch.over, lines, watch.failures) == (True, ["p: the mission has ended"], {})
    assert field.scheduler.now >= 60 * SECOND


def test_a_mission_that_waits_is_not_over():
    field = Field("p")
    watch, lines = watched(field, field.deploy(patrol(1)), 60)
    assert (watch.over, lines, watch.failures) == (False, [], {})


def test_another_process_and_an_engine_that_leaves_are_failures():
    field = Field("p")
    sent = field.deploy(patrol(1))
    watch = MissionWatch(sent.id, sent.pools)
    assert watch.look(sent.reports, field.scheduler.now) == []
    field.deploy(patrol(2), "d2", 2)
    assert watch.look(sent.reports, field.scheduler.now) == ["p: another process has replaced this one"]
    other = Field("p")
    sent = other.deploy(patrol(1))
    watch = MissionWatch(sent.id, sent.pools)
    other.pass_time(3)
    watch.look(sent.reports, other.scheduler.now)
    reports = sent.reports
    lines = [line for second in range(15) for line in watch.look(reports, other.scheduler.now + second * SECOND)]
    assert lines == ["p: its engine has been silent for 5 s"]
    assert not watch.over  # a robot that roams may come back
    for second in range(15, 20):
        watch.look(reports, other.scheduler.now + second * SECOND)
    assert watch.over
    assert list(watch.failures) == ["p"]


def test_it_is_over_when_all_engines_leave_before_anything_has_started() -> None:
    starts = '<startEvent id="s"><signalEventDefinition signalRef="S"/></startEvent><endEvent id="e"/>'
    field = Field("p")
    sent = field.deploy(definitions('<signal id="S" name="go"/>', process("p", starts, ("s", "e"))))
    watch, reports, lines = MissionWatch(sent.id, sent.pools), dict(sent.reports), list[str]()
    for second in range(30):
        lines += watch.look(reports, field.scheduler.now + second * SECOND)
    assert lines == ["p: its engine has been silent for 5 s"]
    assert watch.over
    assert list(watch.failures) == ["p"]


def test_an_engine_that_is_heard_again_has_not_failed() -> None:
    field = Field("p")
    sent = field.deploy(mission(60))
    watch, lines, reports = MissionWatch(sent.id, sent.pools), list[str](), dict(sent.reports)
    begun = field.scheduler.now
    while not watch.over and field.scheduler.now < 120 * SECOND:
        field.pass_time(0.05)
        if not 5 * SECOND < field.scheduler.now - begun < 17 * SECOND:  # its link is down
            reports = dict(sent.reports)
        lines += watch.look(reports, field.scheduler.now)
    said = ["its engine has been silent for 5 s", "its engine is heard again", "the mission has ended"]
    assert (lines, watch.failures) == ([f"p: {text}" for text in said], {})


OPTIONAL = (
    '<extensionElements><c:properties xmlns:c="http://camunda.org/schema/1.0/bpmn">'
    '<c:property name="optional" value="true"/></c:properties></extensionElements>'
)


def pair(properties: str = "") -> str:
    """A ends without the signal that starts B."""
    starts = '<startEvent id="sb"><signalEventDefinition signalRef="S"/></startEvent>'
    return definitions(
        '<signal id="S" name="go"/><collaboration id="c"><participant id="A" name="A" processRef="pa"/>'
        '<participant id="B" name="B" processRef="pb"/></collaboration>',
        process("pa", '<startEvent id="sa"/><endEvent id="ea"/>', ("sa", "ea")),
        process("pb", f'{properties}{starts}<endEvent id="eb"/>', ("sb", "eb")),
    )


def test_a_required_pool_that_never_started_is_a_failure():
    field = Field("A", "B")
    watch, lines = watched(field, field.deploy(pair()), 60)
    why = "nothing has started: no robot of pool B ran its process"
    assert (watch.over, lines, watch.failures) == (True, ["A: the mission has ended", f"B: {why}"], {"B": why})


def test_an_optional_pool_need_not_start():
    field = Field("A", "B")
    watch, lines = watched(field, field.deploy(pair(OPTIONAL)), 60)
    assert (lines, watch.failures) == (["A: the mission has ended", "B: nothing has started"], {})


@pytest.mark.parametrize("wakes", ["with what it has done", "with a report of before"])
def test_a_robot_that_is_not_heard_since_the_others_ended_has_not_ended(wakes: str):
    field = Field("A", "B")
    sent = field.deploy(job(15, 0, ERROR))
    watch, lines, old = MissionWatch(sent.id, sent.pools), list[str](), sent.reports["B"]
    frozen, until = field.scheduler.now + SECOND, field.scheduler.now + 7 * SECOND
    while not watch.over and field.scheduler.now < 60 * SECOND:
        field.pass_time(0.05)
        now, reports = field.scheduler.now, sent.reports
        if frozen < now < until:
            reports["B"] = old
        elif wakes == "with a report of before" and until <= now < until + SECOND:
            reports["B"] = replace(old, time=old.time + 1)
        elif now <= frozen:
            old = reports["B"]
        lines += watch.look(reports, now)
    assert lines == [
        "B: its engine has been silent for 5 s",
        "B: its engine is heard again",
        "B: the mission has failed: cut (team.bpmn:1): error broken was not caught",
        "A: the mission has ended",
    ]
    assert list(watch.failures) == ["B"]
