"""The splitter node: whole collaborations from a topic, robots that come late, and a role that one of several has."""

import json

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from deployment_field import TEAM, Field, kill, patrol

from fame import deploy
from fame.clock import SECOND
from fame.deploy import EngineNode, SplitterNode
from fame.deploy.options import DeploymentOptions
from fame.deploy.splitter_node import DIAGRAM, STATUS
from fame.middleware import messages


class Farm(Field):
    """Robots, splitters, and somebody who sends diagrams."""

    def __init__(self, *robots: str) -> None:
        super().__init__(*robots)
        self.diagrams = self.person.publisher(DIAGRAM, deploy.STRING)
        self.roles: list[dict] = []
        self.person.subscription(STATUS, deploy.STRING, lambda message: self.roles.append(json.loads(message.data)))
        self.wall = 1000.0
        self.lines: list[str] = []

    def splitter(self, kind: type[SplitterNode] = SplitterNode) -> SplitterNode:
        self.wall += 1
        return kind(
            scheduler=self.scheduler,
            middleware=self.middleware,
            log=self.lines.append,
            options=DeploymentOptions(wall_time=lambda at=self.wall: at + self.scheduler.now / SECOND),
        )

    def diagram(self, text: str) -> None:
        self.diagrams.publish(messages.create(deploy.STRING, text))

    def come(self, robot: str, **options) -> EngineNode:
        engine = self.add(robot, **options)
        self.person.subscription(f"/{robot}/bpmn_status", deploy.STRING, self._hear, deploy.STATUS_QOS)
        return engine

    def vanish(self, robot: str) -> None:
        """As if its process had been killed: its ends are gone, nobody said goodbye."""
        engine = self.engines.pop(robot)
        engine.status.close()
        if engine.candidate is not None:
            engine.candidate.close()
        if engine.running is not None:
            engine.running.close()
        engine.node.close()


TRACTORS = TEAM.replace(
    'name="B" processRef="pb"/>', 'name="B" processRef="pb"><participantMultiplicity minimum="1"/></participant>'
)


def test_a_diagram_is_split_and_every_robot_gets_its_part():
    farm = Farm("A", "B")
    farm.splitter()
    farm.diagram(TEAM)
    farm.pass_time(3)
    assert [farm.engines[name].state for name in "AB"] == ["running", "running"]
    assert farm.roles[-1]["state"] == "keeping"
    assert "deployed: A: started; B: started" in farm.lines


def test_a_diagram_waits_for_the_robots_of_its_pools():
    farm = Farm("A")
    farm.splitter()
    farm.diagram(TEAM)
    farm.pass_time(5)
    assert farm.engines["A"].state == "waiting"
    assert "waits: " in farm.lines[-1]
    assert "B" in farm.lines[-1]
    farm.come("B")
    farm.pass_time(3)
    assert [farm.engines[name].state for name in "AB"] == ["running", "running"]


def test_a_robot_that_comes_late_gets_its_process_and_the_others_go_on():
    farm = Farm("A", "B_1")
    farm.splitter()
    farm.diagram(TRACTORS)
    farm.pass_time(3)
    kept = farm.engines["A"].running, farm.engines["B_1"].running
    farm.come("B_2")
    farm.pass_time(3)
    assert farm.engines["B_2"].deployed
    assert (farm.engines["A"].running, farm.engines["B_1"].running) == kept


def test_a_robot_that_comes_back_after_a_crash_begins_again_and_says_so():
    farm = Farm("A", "B")
    farm.splitter()
    farm.diagram(TEAM)
    farm.pass_time(3)
    kept = farm.engines["A"].running
    farm.vanish("B")
    farm.pass_time(2)
    farm.come("B")
    farm.pass_time(3)
    assert farm.engines["A"].running is kept
    answer = [report for report in farm.said if report.robot == "B" and report.answer == "started"][-1]
    assert "takes it up again from the start" in answer.reason


def test_robots_that_all_come_back_at_once_find_each_other_again():
    farm = Farm("A", "B")
    farm.splitter()
    farm.diagram(TEAM)
    farm.pass_time(3)
    for name in "AB":
        farm.vanish(name)
        farm.come(name)
    farm.pass_time(20)
    assert [farm.engines[name].state for name in "AB"] == ["running", "running"]


def test_a_robot_that_comes_late_is_sent_what_replaces_nothing_and_does_not_get_it_if_the_team_has_left_it():
    farm = Farm("A", "B")
    farm.splitter()
    farm.diagram(TEAM)
    farm.pass_time(3)
    farm.vanish("B")
    farm.pass_time(2)
    said, sent = farm.person.publisher("/A/bpmn_status", deploy.STRING, deploy.STATUS_QOS), []

    def on_envelope(message) -> None:
        sent.append(json.loads(message.data))
        report = deploy.Report(robot="A", state="running", deployed="another", time=1e3)
        said.publish(messages.create(deploy.STRING, report.to_json()))

    farm.person.subscription("/B/bpmn_process", deploy.STRING, on_envelope)
    farm.come("B")
    farm.pass_time(2)
    assert [(one["phase"], one.get("joins")) for one in sent] == [("load", True), ("abort", None)]
    assert "B: refused: no robot has this model any more" in farm.lines
    assert farm.engines["B"].state == "waiting"


def test_a_robot_that_was_given_something_else_is_left_alone():
    farm = Farm("A", "B")
    farm.splitter()
    farm.diagram(TEAM)
    farm.pass_time(3)
    farm.send("B", patrol(1))
    farm.pass_time(20)
    assert farm.variables("B") == {"mark": 1}


def test_who_comes_late_to_a_team_that_was_given_something_else_does_not_get_the_old_diagram():
    farm = Farm("A", "B_1")
    farm.splitter()
    farm.diagram(TRACTORS)
    farm.pass_time(3)
    farm.send("B_1", patrol(1))  # A has the diagram
    farm.come("B_2")
    farm.pass_time(12)
    assert farm.engines["B_2"].deployed
    assert not farm.deploy(TRACTORS.replace('"ub"', '"ub2"'), "d2").failed
    farm.come("B_3")
    farm.pass_time(12)
    assert farm.engines["B_3"].state == "waiting"
    assert farm.lines[-1].startswith("B_3: not supplied: no robot has this model any more")


@pytest.mark.parametrize(
    "text",
    [
        "garbage",
        "",
        "<",
        '{"fame": 1}',
        f'<!DOCTYPE x [<!ENTITY a "b">]>{TEAM}',
        TEAM.replace("processRef", "processref"),
        TEAM.replace("<userTask", "<callActivity calledElement='nowhere'").replace('id="ua"', 'id="uc"'),
        "x" * 20_000_001,
    ],
    ids=["garbage", "empty", "half a tag", "envelope", "entities", "no process", "no such call", "too large"],
)
def test_a_diagram_that_is_none_is_refused_and_the_next_one_is_taken(text):
    farm = Farm("A", "B")
    farm.splitter()
    farm.pass_time(2)
    farm.diagram(text)
    farm.pass_time(0.5)
    assert farm.roles[-1]["text"].startswith("refused: ")
    farm.diagram(TEAM)
    farm.pass_time(3)
    assert [farm.engines[name].state for name in "AB"] == ["running", "running"]


def test_a_diagram_with_a_mistake_does_not_take_the_place_of_the_one_that_robots_are_supplied_with():
    farm = Farm("A")
    farm.splitter()
    farm.diagram(TEAM)
    farm.pass_time(2)
    wrong = "<timerEventDefinition><timeDuration>5s</timeDuration></timerEventDefinition>"
    farm.diagram(
        TEAM.replace('<userTask id="ub"/>', f'<intermediateCatchEvent id="ub">{wrong}</intermediateCatchEvent>')
    )
    farm.pass_time(1)
    assert any("refused" in line and "ub: timer duration: '5s' is not an ISO 8601" in line for line in farm.lines)
    farm.come("B")
    farm.pass_time(5)
    assert [farm.engines[name].state for name in "AB"] == ["running", "running"]


def test_a_diagram_that_a_robot_refuses_leaves_what_runs_running():
    farm = Farm("A", "B")
    farm.splitter()
    farm.diagram(TEAM)
    farm.pass_time(3)
    kept = [farm.engines[name].running for name in "AB"]
    farm.diagram(TEAM.replace('<userTask id="ub"/>', '<scriptTask id="ub"><script>x = = 1</script></scriptTask>'))
    farm.pass_time(3)
    assert [farm.engines[name].running for name in "AB"] == kept
    assert "syntax" in farm.lines[-1].casefold()


def test_a_robot_that_dies_between_ready_and_start_and_those_that_come_late_get_what_the_others_started():
    farm = Farm("A", "B_1", "B_2")
    farm.splitter()

    def die(message) -> None:
        if json.loads(message.data)["answer"] == "ready" and "B_1" in alive:
            alive.remove("B_1")
            farm.scheduler.soon(lambda: farm.vanish("B_1"))
            farm.scheduler.soon(lambda: farm.come("B_1"))

    alive = ["B_1"]
    farm.person.subscription("/B_1/bpmn_status", deploy.STRING, die, deploy.STATUS_QOS)
    farm.diagram(TRACTORS)
    farm.pass_time(5)
    assert any(line.startswith("not deployed") and "A: started" in line for line in farm.lines)
    farm.come("B_3")
    farm.pass_time(20)
    assert all(engine.deployed for engine in farm.engines.values())


def test_after_a_diagram_that_a_robot_refuses_those_that_come_late_get_the_one_before():
    farm = Farm("A", "B_1")
    splitter = farm.splitter()
    farm.diagram(TRACTORS)
    farm.pass_time(3)
    farm.come("B_2", trusted=[Ed25519PrivateKey.generate().public_key()])
    farm.pass_time(3)
    farm.diagram(TRACTORS.replace('"ua"', '"ua2"'))
    farm.pass_time(3)
    farm.come("B_3")
    farm.pass_time(12)
    farm.come("B_4")
    farm.pass_time(20)
    assert [bool(engine.deployed) for engine in farm.engines.values()] == [True, True, False, True, True]
    assert farm.engines["A"].running.instances[-1].waiting == ["ua"]
    assert splitter.state == "keeping"


def test_of_diagrams_that_come_in_a_burst_the_newest_is_what_the_team_ends_up_with():
    farm = Farm("A", "B")
    farm.splitter()
    farm.pass_time(2)
    for number in range(10):
        farm.diagram(TEAM.replace('"ua"', f'"ua{number}"'))
    farm.pass_time(5)
    assert farm.engines["A"].running.instances[-1].waiting == ["ua9"]
    assert farm.engines["A"].running.started == 1


def test_of_two_splitters_the_older_keeps_the_role():
    farm = Farm("A", "B")
    elder = farm.splitter()
    farm.pass_time(2)
    younger = farm.splitter()
    farm.pass_time(2)
    farm.diagram(TEAM)
    farm.pass_time(3)
    assert (elder.state, younger.state) == ("keeping", "standby")
    assert [farm.engines[name].running.started for name in "AB"] == [1, 1]


def test_splitters_that_start_together_agree():
    farm = Farm("A", "B")
    splitters = [farm.splitter() for _ in range(3)]
    farm.diagram(TEAM)
    farm.pass_time(5)
    assert [splitter.state for splitter in splitters] == ["keeping", "standby", "standby"]
    assert [farm.engines[name].running.started for name in "AB"] == [1, 1]


def test_when_the_older_is_gone_the_younger_keeps_the_team_as_it_is():
    farm = Farm("A", "B_1")
    elder = farm.splitter()
    younger = farm.splitter()
    farm.pass_time(2)
    farm.diagram(TRACTORS)
    farm.pass_time(3)
    kept = [farm.engines[name].running for name in ("A", "B_1")]
    elder.close()
    farm.pass_time(6)
    assert younger.state == "keeping"
    assert [farm.engines[name].running for name in ("A", "B_1")] == kept
    farm.come("B_2")
    farm.pass_time(3)
    assert farm.engines["B_2"].deployed


def test_a_splitter_that_came_after_the_diagram_can_take_the_role_too():
    farm = Farm("A", "B")
    elder = farm.splitter()
    farm.diagram(TEAM)
    farm.pass_time(3)
    younger = farm.splitter()
    farm.pass_time(3)
    elder.close()
    farm.pass_time(6)
    assert younger.state == "keeping"
    assert [farm.engines[name].running.started for name in "AB"] == [1, 1]
    farm.vanish("B")
    farm.come("B")
    farm.pass_time(15)
    assert farm.engines["B"].deployed


class Slow(SplitterNode):
    """A splitter that hears what others have said before two seconds later."""

    def _on_status(self, message) -> None:
        self.scheduler.after(2 * SECOND, lambda: SplitterNode._on_status(self, message))

    def _on_deployed(self, message) -> None:
        self.scheduler.after(2 * SECOND, lambda: SplitterNode._on_deployed(self, message))


def test_a_splitter_that_led_until_it_heard_of_the_older_can_take_the_role_too():
    farm = Farm("A", "B")
    elder = farm.splitter()
    farm.diagram(TEAM)
    farm.pass_time(3)
    younger = farm.splitter(Slow)
    farm.pass_time(1.5)
    assert (elder.state, younger.state) == ("keeping", "idle")
    farm.pass_time(3)
    assert (elder.state, younger.state) == ("keeping", "standby")
    elder.close()
    farm.pass_time(6)
    assert younger.state == "keeping"
    assert [farm.engines[name].running.started for name in "AB"] == [1, 1]


def test_what_the_older_could_not_deploy_any_more_the_younger_does():
    farm = Farm("A", "B")
    elder, younger = farm.splitter(), farm.splitter()
    farm.pass_time(2)
    elder.close()
    farm.diagram(TEAM)
    farm.pass_time(8)
    assert younger.state == "keeping"
    assert [farm.engines[name].state for name in "AB"] == ["running", "running"]


class Stoppable(SplitterNode):
    """A splitter whose process can be stopped: what it is told waits, and comes when it goes on."""

    def __init__(self, **options) -> None:
        self.stopped, self.queue = False, []
        super().__init__(**options)

    def _later(self, action, *arguments) -> None:
        if self.stopped:
            self.queue.append((action, arguments))
        else:
            action(*arguments)

    def _beat(self) -> None:
        self._later(super()._beat)

    def _on_status(self, message) -> None:
        self._later(super()._on_status, message)

    def _on_diagram(self, message) -> None:
        self._later(super()._on_diagram, message)

    def _on_deployed(self, message) -> None:
        self._later(super()._on_deployed, message)

    def go_on(self, *, cut_off: bool) -> None:
        """`cut_off`: what was volatile is lost, and the last words come again."""
        self.stopped = False
        kinds = [action.__name__ for action, _ in self.queue]
        for number, (action, arguments) in enumerate(self.queue):
            if not cut_off or (action.__name__ != "_on_diagram" and action.__name__ not in kinds[number + 1 :]):
                action(*arguments)


@pytest.mark.parametrize("cut_off", [True, False])
def test_an_older_splitter_that_was_stopped_takes_the_team_back_as_the_younger_left_it(cut_off):
    farm = Farm("A", "B_1")
    elder = farm.splitter(Stoppable)
    younger = farm.splitter()
    farm.pass_time(2)
    farm.diagram(TRACTORS)
    farm.pass_time(3)
    elder.stopped = True
    farm.pass_time(6)
    assert younger.state == "keeping"
    farm.diagram(TRACTORS.replace('"ub"', '"ub2"'))
    farm.pass_time(3)
    kept = [farm.engines[name].running for name in ("A", "B_1")]
    elder.go_on(cut_off=cut_off)
    farm.pass_time(4)
    assert (elder.state, younger.state) == ("keeping", "standby")
    assert [farm.engines[name].running for name in ("A", "B_1")] == kept
    farm.come("B_2")
    farm.pass_time(12)
    assert farm.engines["B_2"].hash == farm.engines["B_1"].hash
    assert [farm.engines[name].running for name in ("A", "B_1")] == kept


def test_an_older_splitter_that_was_stopped_deploys_the_diagram_that_the_younger_never_received():
    farm = Farm("A", "B_1")
    elder = farm.splitter(Stoppable)
    farm.diagram(TRACTORS)
    farm.pass_time(3)
    farm.diagram(TRACTORS.replace('"ua"', '"ua2"'))
    farm.pass_time(0.01)
    kill(elder._deployment)
    elder.stopped = True
    younger = farm.splitter()
    farm.pass_time(6)
    assert younger.state == "keeping"
    assert farm.engines["A"].running.instances[-1].waiting == ["ua"]
    elder.go_on(cut_off=False)
    farm.pass_time(15)
    assert farm.engines["A"].running.instances[-1].waiting == ["ua2"]
    assert (elder.state, younger.state) == ("keeping", "standby")
