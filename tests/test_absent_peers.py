"""A robot that came back without its mission, or with another one, is missed by those that wait for it."""

from deployment_field import Field, definitions, patrol, process

from fame.clock import SECOND
from fame.deploy import Report
from fame.fleet.diagnostics import WARN, diagnostic_status

CATCH = '<signalEventDefinition signalRef="S"/>'
WORK = definitions(
    '<signal id="S" name="job"/><collaboration id="c"><participant id="A" name="A" processRef="pa"/>'
    '<participant id="B" name="B" processRef="pb"/></collaboration>',
    process(
        "pa", f'<startEvent id="sa"/><intermediateCatchEvent id="wait">{CATCH}</intermediateCatchEvent>', ("sa", "wait")
    ),
    process(
        "pb",
        '<startEvent id="sb"/><userTask id="work"/>'
        f'<intermediateThrowEvent id="throw">{CATCH}</intermediateThrowEvent>',
        ("sb", "work"),
        ("work", "throw"),
    ),
)


class Working(Field):
    def __init__(self) -> None:
        super().__init__("A", "B")
        assert not self.deploy(WORK).failed

    def anew(self, after: float) -> None:
        """Kill the engine of B, and start another one without state."""
        self.engines["B"].close()
        self.pass_time(after)
        self.add("B")

    def last(self, robot: str) -> Report:
        return [report for report in self.said if report.robot == robot][-1]

    def warned(self) -> list[str]:
        return sorted({text for report in self.said for text in report.warnings})


def test_a_robot_that_came_back_without_its_mission_is_missed() -> None:
    field = Working()
    assert field.warned() == []
    field.anew(1.0)
    field.pass_time(4)
    assert field.warned() == []
    field.pass_time(5)
    report = field.last("A")
    assert report.absent == {}
    assert report.warnings == ["/job: B no longer publishes it"]
    assert diagnostic_status(report)["level"] == WARN
    assert field.last("B").warnings == []


def test_who_sends_what_nobody_hears_any_more_is_told_too() -> None:
    field = Working()
    field.engines["A"].close()
    field.pass_time(9)
    assert field.last("B").warnings == ["/job: A no longer subscribes to it"]


def test_nobody_is_missed_who_gets_the_mission_again_or_another_one_with_the_team() -> None:
    field = Working()
    field.anew(1.0)
    field.deploy(WORK, "d2", 2, only=["B"])
    assert field.engines["B"].deployed == "d2"
    field.pass_time(10)
    assert field.warned() == []
    assert not field.deploy(WORK, "d3", 3).failed
    field.pass_time(10)
    assert field.warned() == []


def test_a_mission_that_waits_for_nothing_any_more_misses_nobody() -> None:
    field = Working()
    for engine in field.engines.values():
        assert engine.running is not None
    field.engines["B"].running.complete("work")
    field.pass_time(2)
    assert field.last("A").state == "idle"
    field.send("B", patrol(1))
    field.pass_time(10)
    assert field.warned() == []


def test_a_mission_that_starts_on_demand_is_promised_as_soon_as_it_is_loaded() -> None:
    field = Field("A", "B")
    demand = WORK.replace(
        '<startEvent id="sb"/>', '<startEvent id="sb"><messageEventDefinition messageRef="go"/></startEvent>'
    )
    demand = demand.replace('<signal id="S"', '<message id="go" name="go"/><signal id="S"', 1)
    assert not field.deploy(demand).failed
    field.scheduler.run(field.scheduler.now + 20 * SECOND)
    assert {text for report in field.said for text in report.warnings if "/job" in text} == set()
