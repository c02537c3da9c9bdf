"""Units: service tasks that keep something running for as long as their scope lasts."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from bpmn_text import process

from fame.bpmn.reader import read_text
from fame.clock import SECOND, Scheduler
from fame.errors import ConfigError, FameError
from fame.middleware.local import LocalMiddleware
from fame.monitor.services import NEEDS, UNITS
from fame.robot import RobotNode, mission
from fame.robot.services import Around, Unit, setting

UNIT = '<serviceTask id="u" camunda:type="external" camunda:topic="counter"/>'
FLOWS = '<sequenceFlow id="f" sourceRef="s" targetRef="u"/><sequenceFlow id="g" sourceRef="u" targetRef="e"/>'
ENDLESS = f'<startEvent id="s"/>{UNIT}<endEvent id="e"/>{FLOWS}'
LIMITED = f"""{ENDLESS}<boundaryEvent id="b" attachedToRef="u"><timerEventDefinition>
<timeDuration>PT10S</timeDuration></timerEventDefinition></boundaryEvent>
<sequenceFlow id="h" sourceRef="b" targetRef="e"/>"""


class Counter:
    """Counts seconds up to a limit; says what becomes of it."""

    def __init__(self, around: Around, variables: Mapping[str, Any]) -> None:
        self.around, self.seconds, self.closed = around, 0, 0
        self.limit = setting(variables, "limit", type=int)
        COUNTERS.append(self)
        self.entry = around.scheduler.after(SECOND, self.tick)

    def tick(self) -> None:
        self.seconds += 1
        self.entry = self.around.scheduler.after(SECOND, self.tick)
        if self.seconds == self.limit:
            self.around.changed()

    def results(self) -> Mapping[str, Any] | None:
        return {"counted": self.seconds} if self.seconds >= self.limit else None

    def close(self) -> None:
        self.entry.cancel()
        self.closed += 1


COUNTERS: list[Counter] = []


class Robot:
    def __init__(self, content: str, **variables: Any) -> None:
        COUNTERS.clear()
        self.scheduler = Scheduler()
        definitions = read_text(process(content), file="there/m.bpmn")
        self.node = RobotNode(
            "REX", mission(definitions, definitions.processes[0]),
            scheduler=self.scheduler, middleware=LocalMiddleware(self.scheduler), units={"counter": made},
        )  # fmt: skip
        self.node.load()
        self.node.start(variables)
        self.scheduler.run(20 * SECOND)

    @property
    def instance(self) -> Any:
        return self.node.instances[0]


def made(around: Around, variables: Mapping[str, Any]) -> Unit:
    return Counter(around, variables)


@pytest.mark.parametrize("name", UNITS)
def test_what_a_unit_cannot_do_without_is_what_it_asks_for(name: str, tmp_path: Path) -> None:
    scheduler = Scheduler()
    around = Around("REX", "REX", LocalMiddleware(scheduler), scheduler, tmp_path, print, print)

    def asks(variables: Mapping[str, Any]) -> str:
        try:
            UNITS[name](around, variables).close()
        except FameError as error:
            found = re.match(r"needs the variable (\w+)", str(error))
            return found[1] if found else ""
        return ""

    values: dict[str, Any] = {each: 1 if each == "label" else "nowhere" for each in NEEDS[name]}
    assert asks(values) == ""
    for each in values:
        assert asks({other: value for other, value in values.items() if other != each}) == each


def test_a_unit_that_ends_by_itself_ends_its_task_and_sets_variables() -> None:
    robot = Robot(ENDLESS, limit=3)
    assert (robot.instance.status, robot.instance.variables["counted"]) == ("completed", 3)
    assert [counter.closed for counter in COUNTERS] == [1]


def test_a_unit_is_closed_when_its_task_is_interrupted() -> None:
    robot = Robot(LIMITED, limit=100)
    assert robot.instance.status == "completed"
    assert "counted" not in robot.instance.variables
    assert [(counter.seconds, counter.closed) for counter in COUNTERS] in ([(9, 1)], [(10, 1)])


def test_a_unit_is_closed_when_the_robot_leaves() -> None:
    robot = Robot(ENDLESS, limit=100)
    assert robot.instance.waiting == ["u"]
    robot.node.stop()
    robot.node.close()
    assert [counter.closed for counter in COUNTERS] == [1]


def test_what_a_unit_lacks_fails_its_task_by_name() -> None:
    robot = Robot(ENDLESS)
    assert robot.instance.status == "failed"
    assert robot.instance.error.element == "u"
    assert "needs the variable limit" in str(robot.instance.error)


def test_a_unit_knows_the_robot_and_the_folder_of_the_model() -> None:
    Robot(ENDLESS, limit=1)
    around = COUNTERS[0].around
    assert (around.robot, around.namespace, around.folder) == ("REX", "REX", Path("there"))


@pytest.mark.parametrize(
    ("value", "type", "expected"), [(2, float, 2.0), (2.5, float, 2.5), ("a", str, "a"), (None, str, "else")]
)
def test_a_setting_is_a_variable_or_its_default(value: Any, type: Any, expected: Any) -> None:
    assert setting({"x": value}, "x", "else" if value is None else None, type=type) == expected


@pytest.mark.parametrize(("value", "type"), [(True, int), ("2", float), (2.5, int), (3, str), (None, int)])
def test_a_setting_of_another_type_is_refused_by_name(value: Any, type: Any) -> None:
    with pytest.raises(ConfigError, match="x"):
        setting({"x": value}, "x", type=type)
