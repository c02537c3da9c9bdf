"""Services that run as long as their service task."""

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
from fame.robot import RobotNode, make_mission
from fame.robot.options import RobotOptions
from fame.robot.services import ServiceContext, variable
from fame.rooms import SERVICES, load

TASK = '<serviceTask id="u" camunda:type="external" camunda:topic="counter"/>'
FLOWS = '<sequenceFlow id="f" sourceRef="s" targetRef="u"/><sequenceFlow id="g" sourceRef="u" targetRef="e"/>'
ENDLESS = f'<startEvent id="s"/>{TASK}<endEvent id="e"/>{FLOWS}'
LIMITED = f"""{ENDLESS}<boundaryEvent id="b" attachedToRef="u"><timerEventDefinition>
<timeDuration>PT10S</timeDuration></timerEventDefinition></boundaryEvent>
<sequenceFlow id="h" sourceRef="b" targetRef="e"/>"""


class Counter:
    """Counts seconds up to a limit; says what becomes of it."""

    def __init__(self, context: ServiceContext, variables: Mapping[str, Any]) -> None:
        self.context, self.seconds, self.closed = context, 0, 0
        self.limit = variable(variables, "limit", type=int)
        COUNTERS.append(self)
        self.entry = context.scheduler.after(SECOND, self.tick)

    def tick(self) -> None:
        self.seconds += 1
        self.entry = self.context.scheduler.after(SECOND, self.tick)
        if self.seconds == self.limit:
            self.context.changed()

    def results(self) -> Mapping[str, Any] | None:
        return {"counted": self.seconds} if self.seconds >= self.limit else None

    def close(self) -> None:
        self.entry.cancel()
        self.closed += 1


COUNTERS: list[Counter] = []


class Robot:
    def __init__(self, content: str, *, files: Path | None = None, **variables: Any) -> None:
        COUNTERS.clear()
        self.scheduler = Scheduler()
        definitions = read_text(process(content), file="there/m.bpmn")
        self.node = RobotNode(
            "REX",
            make_mission(definitions, definitions.processes[0]),
            scheduler=self.scheduler,
            middleware=LocalMiddleware(self.scheduler),
            options=RobotOptions(service_starts={"counter": Counter}, files=files),
        )
        self.node.load()
        self.node.start(variables)
        self.scheduler.run(20 * SECOND)

    @property
    def instance(self) -> Any:
        return self.node.instances[0]


@pytest.mark.parametrize("name", SERVICES)
def test_the_required_variables_of_a_service_are_those_it_asks_for(name: str, tmp_path: Path) -> None:
    scheduler = Scheduler()
    context = ServiceContext("REX", "REX", LocalMiddleware(scheduler), scheduler, tmp_path, print, print, print)

    def asks(variables: Mapping[str, Any]) -> str:
        try:
            load(SERVICES[name].start)(context, variables).close()
        except FameError as error:
            found = re.match(r"needs the variable (\w+)", str(error))
            return found[1] if found else ""
        return ""

    values: dict[str, Any] = {each: 1 if each == "label" else "nowhere" for each in SERVICES[name].required}
    assert asks(values) == ""
    for each in values:
        assert asks({other: value for other, value in values.items() if other != each}) == each


def test_a_service_that_ends_by_itself_ends_its_task_and_sets_variables() -> None:
    robot = Robot(ENDLESS, limit=3)
    assert (robot.instance.status, robot.instance.variables["counted"]) == ("completed", 3)
    assert [counter.closed for counter in COUNTERS] == [1]


def test_files_are_those_beside_the_model_or_in_the_folder_of_the_engine(tmp_path: Path) -> None:
    Robot(ENDLESS, limit=3)
    assert COUNTERS[0].context.folder == Path("there")
    Robot(ENDLESS, limit=3, files=tmp_path)
    assert COUNTERS[0].context.folder == tmp_path


def test_a_service_is_closed_when_its_task_is_interrupted() -> None:
    robot = Robot(LIMITED, limit=100)
    assert robot.instance.status == "completed"
    assert "counted" not in robot.instance.variables
    assert [(counter.seconds, counter.closed) for counter in COUNTERS] in ([(9, 1)], [(10, 1)])


def test_a_service_is_closed_when_the_robot_leaves() -> None:
    robot = Robot(ENDLESS, limit=100)
    assert robot.instance.waiting == ["u"]
    robot.node.stop()
    robot.node.close()
    assert [counter.closed for counter in COUNTERS] == [1]


def test_what_a_service_lacks_fails_its_task_by_name() -> None:
    robot = Robot(ENDLESS)
    assert robot.instance.status == "failed"
    assert robot.instance.error.element == "u"
    assert "needs the variable limit" in str(robot.instance.error)


def test_a_service_knows_the_robot_and_the_folder_of_the_model() -> None:
    Robot(ENDLESS, limit=1)
    context = COUNTERS[0].context
    assert (context.robot, context.namespace, context.folder) == ("REX", "REX", Path("there"))


@pytest.mark.parametrize(
    ("value", "type", "expected"), [(2, float, 2.0), (2.5, float, 2.5), ("a", str, "a"), (None, str, "else")]
)
def test_a_service_reads_a_variable_or_its_default(value: Any, type: Any, expected: Any) -> None:
    assert variable({"x": value}, "x", "else" if value is None else None, type=type) == expected


@pytest.mark.parametrize(("value", "type"), [(True, int), ("2", float), (2.5, int), (3, str), (None, int)])
def test_a_variable_of_another_type_is_refused_by_name(value: Any, type: Any) -> None:
    with pytest.raises(ConfigError, match="x"):
        variable({"x": value}, "x", type=type)
