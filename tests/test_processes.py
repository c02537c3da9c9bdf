"""Robots in processes of their own, over DDS on loopback: deployed, redeployed, killed; nothing else stops."""

import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path

import pytest
from domains import DOMAIN as SHARED, PROCESSES as DOMAIN

pytest.importorskip("cyclonedds", reason="Cyclone DDS is not installed: pip install 'fame-robots[dds]'")

from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.topic import Topic

import fame.scenario
from fame.clock import SECOND
from fame.deploy import STATUS_QOS, STRING, Report
from fame.deploy.splitter_node import DIAGRAM, STATUS
from fame.log import Recording
from fame.middleware import messages
from fame.middleware.dds import DdsMiddleware, DdsScheduler, wire
from fame.middleware.interface import ENGINE, LATCHED, Publisher
from fame.middleware.parameters import KINDS, service_name

pytestmark = pytest.mark.processes

ROOT = Path(__file__).parent.parent
LIMIT = 90
"""Seconds after which something is taken never to happen."""
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}

HEAD = '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="t">'
THROW = '<intermediateThrowEvent id="{0}"><signalEventDefinition signalRef="{1}"/></intermediateThrowEvent>'
CATCH = '<intermediateCatchEvent id="{0}"><signalEventDefinition signalRef="{1}"/></intermediateCatchEvent>'


def flows(prefix: str, *ids: str) -> str:
    return "".join(
        f'<sequenceFlow id="{prefix}{n}" sourceRef="{a}" targetRef="{b}"/>' for n, (a, b) in enumerate(pairwise(ids))
    )


PING_PONG = (
    f'{HEAD}<signal id="Ping" name="ping"/><signal id="Pong" name="pong"/><collaboration id="c">'
    '<participant id="A" name="A" processRef="pa"/><participant id="B" name="B" processRef="pb"/></collaboration>'
    '<process id="pa"><startEvent id="sa"/>'
    f'{THROW.format("ping", "Ping")}{CATCH.format("pong", "Pong")}<endEvent id="ea"/>'
    f"{flows('a', 'sa', 'ping', 'pong', 'ea')}</process>"
    '<process id="pb"><startEvent id="sb"><signalEventDefinition signalRef="Ping"/></startEvent>'
    f'{THROW.format("answer", "Pong")}<endEvent id="eb"/>{flows("b", "sb", "answer", "eb")}</process></definitions>'
)


def waiting(name: str) -> str:
    """A pool that waits at an event `name` forever."""
    return (
        f'{HEAD}<signal id="S" name="never"/><collaboration id="c"><participant id="A" name="A" processRef="pa"/>'
        f'</collaboration><process id="pa"><startEvent id="s"/>{CATCH.format(name, "S")}{flows("f", "s", name)}'
        "</process></definitions>"
    )


BOTH_WAIT = (
    f'{HEAD}<signal id="S" name="never"/><collaboration id="c"><participant id="A" name="A" processRef="pa"/>'
    '<participant id="B" name="B" processRef="pb"/></collaboration>'
    f'<process id="pa"><startEvent id="sa"/>{CATCH.format("wait_a", "S")}{flows("a", "sa", "wait_a")}</process>'
    f'<process id="pb"><startEvent id="sb"/>{CATCH.format("wait_b", "S")}{flows("b", "sb", "wait_b")}</process>'
    "</definitions>"
)

Process = subprocess.Popen


def start(domain: int, *words: str) -> Process:
    """A process of FAME."""
    return Process(
        [sys.executable, "-m", "fame", *words],
        env=ENVIRONMENT | {"ROS_DOMAIN_ID": str(domain)},
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


class Field:
    """Processes, and somebody who listens to them."""

    limit = LIMIT

    def __init__(self, domain: int = DOMAIN) -> None:
        self.domain = domain
        self.processes: list[Process] = []
        self.engines: dict[str, Process] = {}
        self.senders: dict[str, Publisher] = {}
        self.scheduler = DdsScheduler()
        self.middleware = DdsMiddleware(self.scheduler, domain=domain)
        self.node = self.middleware.node("person")
        self.diagrams = self.node.publisher(DIAGRAM, STRING)
        self.said: dict[str, list[Report]] = {}
        self.ended = set[int]()
        self.world: dict = {}
        self.roles: dict[int, str] = {}
        self.node.subscription(
            "/world_state", STRING, lambda message: self.world.update(json.loads(message.data)), LATCHED
        )
        self.node.subscription(STATUS, STRING, self._hear_splitter, STATUS_QOS)

    def start(self, *words: str) -> Process:
        process = start(self.domain, *words)
        self.processes.append(process)
        return process

    def command(self, *words: str) -> Process:
        """A command under way, which is to say something as JSON."""
        return self.start(*words, "--json")

    def fame(self, *words: str) -> tuple[int, dict]:
        """A command to its end."""
        return said_by(self.command(*words))

    def engine(self, robot: str, *words: str) -> Process:
        if robot not in self.said:
            self.said[robot] = []
            self.node.subscription(f"/{robot}/bpmn_status", STRING, partial(self._hear, robot), STATUS_QOS)
        self.engines[robot] = self.start("engine", robot, *words)
        return self.engines[robot]

    def process(self, robot: str) -> Process:
        """The newest engine of a robot."""
        return self.engines[robot]

    def publish(self, robot: str, text: str) -> None:
        """A bare model, as anybody may send it."""
        if robot not in self.senders:
            self.senders[robot] = self.node.publisher(f"/{robot}/bpmn_process", STRING)
            self.until(lambda: not self.middleware.connecting(self.node), "the engine to be connected")
        self.senders[robot].publish(messages.create(STRING, text))

    def refused(self, robot: str, reason: str, act: Callable[[], object]) -> None:
        """Do something that a robot refuses, and wait until it says why."""
        before = len(self.said[robot])
        act()

        def told() -> bool:
            return any(said.answer == "refused" and reason in said.reason for said in self.said[robot][before:])

        self.until(told, f"{robot} to refuse: {reason}")

    def kill(self, process: Process) -> None:
        """Kill a process; what an engine has said before, and is heard late, does not count."""
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        robots = [robot for robot, engine in self.engines.items() if engine is process]
        self.ended |= {report.born for robot in robots for report in self.said[robot]}

    def _hear(self, robot: str, message) -> None:
        report = Report.from_json(message.data)
        assert report is not None
        if report.born not in self.ended:
            self.said[robot].append(report)

    def _hear_splitter(self, message) -> None:
        said = json.loads(message.data)
        self.roles[said["born"]] = said["state"]

    def last(self, robot: str) -> Report | None:
        return self.said[robot][-1] if self.said[robot] else None

    def at(self, robot: str) -> list[str]:
        """Where its tokens are."""
        report = self.last(robot)
        return [wait["element"] for wait in report.waits] if report is not None and report.instances else []

    def alive(self, *robots: str) -> None:
        """Wait until each of them has spoken again."""
        counts = {robot: len(self.said[robot]) for robot in robots}
        self.until(lambda: all(len(self.said[robot]) > count for robot, count in counts.items()), f"{robots} to speak")

    def until(self, holds: Callable[[], object], what: str) -> None:
        deadline = self.scheduler.now + self.limit * SECOND
        while not holds():
            assert self.scheduler.now < deadline, f"waited for {what}; last: {[self.last(name) for name in self.said]}"
            self.scheduler.run(self.scheduler.now + SECOND // 50)

    def close(self) -> None:
        self.middleware.close()
        for process in self.processes:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        for process in self.processes:
            try:
                process.communicate(timeout=LIMIT)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()


@pytest.fixture
def field() -> Iterator[Field]:
    made = Field()
    yield made
    made.close()


@pytest.fixture(scope="module")
def team() -> Iterator[Field]:
    """Two engines that several tests share: each gives them what it needs, and leaves them alive."""
    made = Field(SHARED)
    for robot in "AB":
        made.engine(robot)
    made.until(lambda: made.last("A") and made.last("B"), "both")
    yield made
    made.close()


def said_by(process: Process) -> tuple[int, dict]:
    """A command at its end: exit code, and what it said as JSON."""
    text, _ = process.communicate(timeout=LIMIT)
    return process.returncode, json.loads(text)


# ---- engines -------------------------------------------------------------------------------------------------------


def test_an_engine_is_deployed_to_redeployed_and_shown(tmp_path, team):
    for name in ("first", "second"):
        (tmp_path / f"{name}.bpmn").write_text(waiting(name))
    (tmp_path / "wrong.bpmn").write_text(waiting("x").replace("</process>", "<dance/></process>"))
    wrong = team.command("deploy", str(tmp_path / "wrong.bpmn"))
    code, said = team.fame("deploy", str(tmp_path / "first.bpmn"))
    assert (code, said["robots"]["A"]["state"]) == (0, "started"), said
    assert said_by(wrong)[0] == 2
    assert team.fame("deploy", str(tmp_path / "second.bpmn"))[0] == 0
    team.until(lambda: team.at("A") == ["second"], "the second process")
    asked = [
        team.command(*words.split())
        for words in ("status A", "complete A first --value approved=true", "activate A look")
    ]
    (status, shown), (complete, completed), (activate, activated) = (said_by(process) for process in asked)
    assert (status, complete, activate) == (0, 1, 1)
    (wait,) = shown["robots"]["A"]["waits"]
    assert (wait["element"], wait["topics"]) == ("second", {"/never": 0})
    assert shown["robots"]["A"]["now"] >= wait["since"]
    assert completed["reason"] == "first: is not waiting; currently waiting: second"
    assert activated["reason"].rpartition("; ")[2] == "can start: nothing"
    chores = '<adHocSubProcess id="chores"><userTask id="look"/><task id="photo"/></adHocSubProcess>'
    (tmp_path / "third.bpmn").write_text(waiting("chores").replace(CATCH.format("chores", "S"), chores))
    assert team.fame("deploy", str(tmp_path / "third.bpmn"))[0] == 0
    code, said = team.fame("activate", "A", "photo")
    assert (code, said) == (0, {"status": "completed", "robot": "A", "element": "photo", "reason": ""})
    team.until(lambda: team.last("A").offers == ["look", "photo"], "what could be activated")


def test_a_mission_that_fails_after_its_start_is_told_by_the_command_that_deployed_it(tmp_path, team):
    text = '<endEvent id="here" name="no way"><errorEventDefinition/></endEvent>'
    (tmp_path / "fails.bpmn").write_text(waiting("here").replace(CATCH.format("here", "S"), text))
    (tmp_path / "ends.bpmn").write_text(waiting("here").replace(CATCH.format("here", "S"), '<endEvent id="here"/>'))
    code, said = team.fame("deploy", str(tmp_path / "fails.bpmn"))
    assert (code, said["status"], said["robots"]["A"]["state"]) == (1, "failed", "started"), said
    assert said["failures"]["A"].startswith("the mission has failed: here ("), said
    until_ended = team.start("deploy", str(tmp_path / "fails.bpmn"), "--until-ended")
    _, error = until_ended.communicate(timeout=LIMIT)
    assert until_ended.returncode == 1
    assert "A: the mission has failed: here (" in error
    code, said = team.fame("deploy", str(tmp_path / "ends.bpmn"), "--until-ended")
    assert (code, said["status"], said["failures"]) == (0, "completed", {}), said


def test_recordings_of_engines_are_collected_and_what_is_missing_is_told(tmp_path, field):
    log = tmp_path / "log"
    field.engine("A", "--log", str(log))
    field.engine("B")
    field.until(lambda: field.last("A") and field.last("B"), "both")
    field.publish("A", waiting("here"))
    field.until(lambda: field.at("A") == ["here"] and any(log.glob("*.mcap")), "a recording")
    field.process("A").send_signal(signal.SIGINT)
    assert field.process("A").wait(LIMIT) == 0
    field.said["A"].clear()
    field.engine("A", "--log", str(log))
    field.until(lambda: field.last("A"), "its engine again")
    words = ("log", "collect", "-o", str(tmp_path / "got"), "--robot", "A")
    code, said = field.fame(*words)
    assert (code, len(said["robots"]["A"]["files"])) == (0, 1), said
    (fetched,) = (tmp_path / "got" / "A").iterdir()
    assert fetched.read_bytes() == (log / fetched.name).read_bytes()
    code, said = field.fame(*words, "--robot", "B")
    assert (code, said["robots"]["A"]["fetched"]) == (1, 0)
    assert said["robots"]["B"]["missing"] == ["its engine keeps no recordings (--log), or has an older FAME"]


def test_a_mission_that_does_not_end_in_time_gives_way_to_what_ran_before(tmp_path, team):
    for name in ("before", "after"):
        (tmp_path / f"{name}.bpmn").write_text(waiting(name))
    assert team.fame("deploy", str(tmp_path / "before.bpmn"))[0] == 0
    code, said = team.fame("deploy", str(tmp_path / "after.bpmn"), "--rollback-unless-ended", "1")
    assert (code, said["status"], said["rolled_back"]["A"]["state"]) == (1, "failed", "started"), said
    team.until(lambda: team.at("A") == ["before"], "what ran before")
    code, listed = team.fame("inventory")
    assert (code, set(listed["robots"])) == (0, set(listed["robots"]) | {"A"})
    code, said = team.fame("deploy", "--previous", "--to", "A")
    assert (code, said["robots"]["A"]["state"]) == (0, "started"), said
    team.until(lambda: team.at("A") == ["after"], "what was rolled back")


def test_what_is_no_model_is_refused_by_a_robot_that_goes_on_as_it_was(team):
    topic = "/A/bpmn_process"
    team.publish("A", waiting("here"))
    team.until(lambda: team.at("A") == ["here"], "the model that runs")
    entities = "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10}">' for n in range(1, 10))
    laughs = f'<!DOCTYPE x [<!ENTITY l0 "ha">{entities}]>' + waiting("here").replace("never", "&l9;")
    for text, reason in (
        (laughs, "DOCTYPE"),
        (waiting("here").replace("never", "n" * 50_000_000), "at most"),
        ("\x01\x02\x03", "neither"),
    ):
        team.refused("A", reason, partial(team.publish, "A", text))
    stranger = DdsMiddleware(team.scheduler, domain=SHARED)
    node = stranger.node("stranger")
    team.refused("A", "std_msgs/msg/Int64", partial(node.publisher, topic, "std_msgs/msg/Int64"))
    stranger.close()
    participant = DomainParticipant(SHARED)
    qos = Qos(Policy.Reliability.Reliable(10**9), Policy.DataRepresentation(use_cdrv0_representation=True))
    kind = wire.declared(STRING, False)
    writer = DataWriter(participant, Topic(participant, wire.dds_topic(topic), kind), qos)
    team.until(writer.get_matched_subscriptions, "the robot to listen")
    garbage = kind(b"\x00\x01\x00\x00\x04\x00\x00\x00\xff\xfe\xfd\x00")
    team.refused("A", "dropped a message", partial(writer.write, garbage))
    team.alive("A", "B")
    assert team.at("A") == ["here"]


def test_a_robot_that_does_not_answer_is_named_and_nobody_starts(tmp_path, team):
    path = tmp_path / "ping.bpmn"
    path.write_text(PING_PONG)
    kept = [team.last(robot).deployed for robot in "AB"]
    b = team.process("B")
    os.kill(b.pid, signal.SIGSTOP)  # there, and silent
    code, said = team.fame("deploy", str(path), "--wait", "1")
    os.kill(b.pid, signal.SIGCONT)
    # Who comes after it was stopped may not find it at all.
    reason = said["robots"]["B"]["reason"] if "robots" in said else said["error"]["text"]
    assert code == 1, said
    assert "did not answer within 1 s" in reason or "has no robot B" in reason
    team.alive("A", "B")
    team.until(lambda: not {team.last(robot).state for robot in "AB"} & {"loading", "ready"}, "the end of it")
    assert [team.last(robot).deployed for robot in "AB"] == kept


def test_a_deployment_that_is_interrupted_leaves_all_what_they_had_at_once(tmp_path, team):
    path = tmp_path / "both.bpmn"
    path.write_text(BOTH_WAIT.replace('name="B"', 'name="C"'))
    silent = team.middleware.node("silent", "C")
    silent.publisher("bpmn_status", STRING, LATCHED).publish(messages.create(STRING, "says nothing that is a report"))
    kept = team.last("A").deployed
    sender = team.command("deploy", str(path))
    team.until(lambda: team.last("A").state == "ready", "A to be ready")
    sender.send_signal(signal.SIGINT)
    _, complaint = sender.communicate(timeout=LIMIT)
    silent.close()
    assert (sender.returncode, "Traceback" in complaint) == (130, False)
    team.until(lambda: team.last("A").state != "ready", "A to be free")
    answer = next(report for report in reversed(team.said["A"]) if report.answer)
    assert (answer.answer, answer.reason, answer.deployed) == ("aborted", "", kept)


def test_a_burst_in_the_middle_of_a_running_script_ends_with_the_newest_and_the_other_robot_goes_on(team):
    left: list[object] = []
    team.node.subscription("/A/left", "std_msgs/msg/Empty", left.append)
    script = (
        "try:\n    while True:\n        await sleep(0.01)\nfinally:\n    robot.publish('left', 'std_msgs/msg/Empty')"
    )
    task = f'<scriptTask id="task"><script>{script}</script></scriptTask>'
    team.publish("A", waiting("task").replace(CATCH.format("task", "S"), task))
    team.until(lambda: team.at("A") == ["task"], "the script to run")
    other, heard = team.last("B"), len(team.said["A"])
    for number in range(10):
        team.publish("A", waiting(f"w{number}"))
    team.until(lambda: team.at("A") == ["w9"] and left, "the newest")
    answers = [report.answer for report in team.said["A"][heard:] if report.answer]
    assert (len(answers), set(answers) - {"superseded"}, answers[-1]) == (10, {"started"}, "started")
    team.alive("B")
    assert (team.last("B").deployed, team.last("B").started) == (other.deployed, other.started)


def test_after_many_redeployments_an_engine_holds_what_it_held_after_ten(team):
    def redeploy(*names: str) -> dict[str, int]:
        for name in names:
            team.publish("A", waiting(name))
            team.until(lambda name=name: team.at("A") == [name], "the next one")
        team.alive("A")
        team.until(lambda: offers_parameters(team, "A"), "the services of its parameters, which come late")
        return held_by(team, "A")

    after_ten, after_many = redeploy(*(f"x{n}" for n in range(10))), redeploy(*(f"y{n}" for n in range(100)))
    grown = after_many.pop("memory") - after_ten.pop("memory")
    assert after_many == after_ten
    assert grown < 8_000_000


def offers_parameters(team: Field, robot: str) -> bool:
    """Whether its engine offers all services of its parameters."""
    return all(team.middleware.offers(f"/{robot}/{ENGINE}/{service_name(kind)}") for kind in KINDS)


def held_by(team: Field, robot: str) -> dict[str, int]:
    """What its engine has open, as the system and the others see it."""
    proc = Path(f"/proc/{team.process(robot).pid}")
    there = team.middleware.participant.discovery.nodes.values()
    nodes = [node for nodes in there for node in nodes if node.namespace.strip("/") == robot]
    return {
        "threads": len(os.listdir(proc / "task")),
        "files": len(os.listdir(proc / "fd")),
        "DDS entities": sum(len(node.gids) for node in nodes),
        "memory": int((proc / "statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE"),
    }


def test_engines_and_splitters_are_killed_and_come_back_and_nothing_else_stops(field):
    a = field.engine("A")
    field.until(lambda: field.last("A"), "A to be there")
    twin = field.start("engine", "A")  # before a splitter: one that finds A late, and is given a process, stays
    _, complaint = twin.communicate(timeout=LIMIT)
    assert (twin.returncode, "there is an engine 'A' already" in complaint) == (2, True)
    first = field.start("splitter")
    field.until(lambda: "idle" in field.roles.values() and not field.last("A").warnings, "A to be alone")
    field.diagrams.publish(messages.create(STRING, BOTH_WAIT))
    b = field.engine("B")  # late
    field.until(lambda: (field.at("A"), field.at("B")) == (["wait_a"], ["wait_b"]), "the team to run")
    kept = field.last("B").deployed
    second = field.start("splitter")
    field.until(lambda: sorted(field.roles.values()) == ["keeping", "standby"], "the second to stand by")

    field.kill(a)
    field.alive("B")
    field.said["A"].clear()
    again = field.engine("A")
    field.until(lambda: field.at("A") == ["wait_a"], "A to take its process up again")

    successor = next(born for born, role in field.roles.items() if role == "standby")
    field.kill(first)
    field.until(lambda: field.roles[successor] == "keeping", "the second to have the role")
    field.kill(b)
    field.said["B"].clear()
    field.alive("A")
    field.engine("B")
    field.until(lambda: field.at("B") == ["wait_b"], "the second splitter to supply B")
    assert field.last("B").deployed != kept
    assert second.poll() is None
    again.send_signal(signal.SIGINT)  # who finds an engine late gets its last report, and not each answer
    assert "takes it up again from the start" in again.communicate(timeout=LIMIT)[1]


# ---- a mission -----------------------------------------------------------------------------------------------------


def test_in_mid_mission_one_tractor_is_called_home_the_others_go_on_also_without_a_world(field):
    world = field.start("world", "examples/agriculture.yaml", "--speed", "10")
    robots = ["Drone", "Tractor_1", "Tractor_2", "Tractor_3"]
    for robot in robots:
        field.engine(robot, "--type", robot.split("_")[0].lower(), "--use-sim-time")
    field.until(lambda: all(field.last(robot) for robot in robots) and field.world, "all to be there")
    code, said = field.fame("deploy", "models/agriculture.bpmn")
    assert code == 0, said
    field.until(lambda: field.last("Tractor_2").started, "a weed to be found")
    kept = {robot: field.last(robot).deployed for robot in robots}

    code, said = field.fame("deploy", "models/agriculture_return.bpmn", "--to", "Tractor_2")
    assert (code, list(said["robots"])) == (0, ["Tractor_2"]), said
    field.until(lambda: field.last("Tractor_2").deployed != kept["Tractor_2"], "the new process")
    field.until(lambda: field.last("Tractor_2").completed, "it to come home")
    field.alive(*robots)
    home = field.world["robots"]["Tractor_2"]
    # At ten times the speed an engine that waits 0.2 s for a processor brakes 2 s late.
    assert math.dist((home["x"], home["y"]), (-1, 7.5)) < 1.5
    assert field.last("Drone").state == "running"
    assert {robot for robot in robots if field.last(robot).deployed == kept[robot]} == {*robots} - {"Tractor_2"}

    field.kill(world)
    field.alive(*robots)
    assert {robot for robot in robots if field.last(robot).deployed == kept[robot]} == {*robots} - {"Tractor_2"}


# ---- all of them together ------------------------------------------------------------------------------------------


def test_a_mission_in_many_processes_completes(tmp_path, field):
    path = tmp_path / "ping.bpmn"
    path.write_text(PING_PONG)
    (tmp_path / "ping.properties.yaml").write_text("properties: {ends: A completes}\n")
    logs = tmp_path / "run.mcap", tmp_path / "run.xes"
    words = [word for log in logs for word in ("--log", str(log))]
    code, said = field.fame("run", str(path), "--middleware", "dds", "--duration", "20", *words)
    assert (code, said["status"]) == (0, "completed"), said
    with Recording(logs[0]) as recording:
        assert (recording.warnings, recording.verdicts) == ([], said["properties"])
    assert '<string key="property:ends" value="holds">' in logs[1].read_text()
    assert {name: robot["completed"] for name, robot in said["robots"].items()} == {"A": 1, "B": 1}
    here = fame.scenario.Scenario.load(path).run().to_json()
    assert said.keys() == here.keys()
    measured = {"simulated", "wall"}
    assert {key: said[key] for key in said.keys() - measured} == {key: here[key] for key in here.keys() - measured}


def test_a_message_for_one_robot_reaches_that_alone(tmp_path, field):
    order = '<messageEventDefinition messageRef="Order"/>'
    to = (
        '<extensionElements><camunda:properties><camunda:property name="to" value="Worker_2"/></camunda:properties>'
        "</extensionElements>"
    )
    head = HEAD.replace(" targetN", ' xmlns:camunda="http://camunda.org/schema/1.0/bpmn" targetN')
    path = tmp_path / "team.bpmn"
    path.write_text(
        f'{head}<message id="Order" name="order"/><collaboration id="c">'
        '<participant id="B" name="Boss" processRef="b"/>'
        '<participant id="W" name="Worker" processRef="w"><participantMultiplicity minimum="2"/></participant>'
        f'</collaboration><process id="b"><startEvent id="s"/><endEvent id="m">{to}{order}</endEvent>'
        f"{flows('b', 's', 'm')}</process>"
        f'<process id="w"><startEvent id="ws">{order}</startEvent></process></definitions>'
    )
    code, said = field.fame("run", str(path), "--middleware", "dds", "--duration", "20")
    assert code == 0, said
    assert {name: robot["completed"] for name, robot in said["robots"].items()} == {
        "Boss": 1, "Worker_1": 0, "Worker_2": 1,
    }  # fmt: skip


def test_a_pool_that_never_started_and_a_timer_that_still_starts_one(tmp_path, field):
    timer = "<timerEventDefinition><timeCycle>R2/PT1S</timeCycle></timerEventDefinition>"
    go = '<signalEventDefinition signalRef="Ping"/>'
    path = tmp_path / "two.bpmn"
    path.write_text(
        f'{HEAD}<signal id="Ping" name="ping"/><collaboration id="c">'
        '<participant id="A" name="A" processRef="pa"/><participant id="B" name="B" processRef="pb"/></collaboration>'
        f'<process id="pa"><startEvent id="sa">{timer}</startEvent><task id="ta"/>{flows("a", "sa", "ta")}</process>'
        f'<process id="pb"><startEvent id="sb">{go}</startEvent></process></definitions>'
    )
    code, said = field.fame("run", str(path), "--middleware", "dds", "--duration", "20")
    assert (code, said["status"], said["never_started"]) == (1, "failed", ["B"]), said
    assert said["robots"]["A"]["completed"] == 2
    assert said["messages"] == [
        "pool B never started: no robot of it ran its process",
        "B waits at sb for its start on topic /ping, which no other node publishes",
    ]


def test_what_a_robot_refuses_is_said_once_with_the_place_in_the_file_that_was_given(tmp_path, field):
    path = tmp_path / "grip.bpmn"
    task = '\n<serviceTask id="t" xmlns:c="http://camunda.org/schema/1.0/bpmn" c:type="external" c:topic="grip"/>\n'
    path.write_text(f'{HEAD}<process id="A"><startEvent id="s"/>{task}{flows("f", "s", "t")}</process></definitions>')
    process = field.start("run", str(path), "--middleware", "dds", "--duration", "20")
    _, err = process.communicate(timeout=LIMIT)
    assert process.returncode == 1
    (line,) = [line for line in err.splitlines() if "unknown service" in line]
    assert line.startswith(f"fame: A: refused: {path}:2: t: unknown service 'grip'; known are: ")


def test_a_warning_of_a_script_names_the_line_of_the_file_that_was_given(tmp_path, field):
    path = tmp_path / "warn.bpmn"
    script = '\n\n<scriptTask id="t"><script>import warnings\nwarnings.warn("mind")</script></scriptTask>\n'
    path.write_text(f'{HEAD}<process id="A"><startEvent id="s"/>{script}{flows("f", "s", "t")}</process></definitions>')
    process = field.start("run", str(path), "--middleware", "dds", "--duration", "20")
    _, err = process.communicate(timeout=LIMIT)
    assert process.returncode == 0, err
    assert f"{path}:4: UserWarning: mind" in err.splitlines()


def test_a_mission_in_many_processes_ends_when_its_simulated_seconds_are_over(tmp_path, field):
    model = tmp_path / "both.bpmn"
    model.write_text(BOTH_WAIT)
    path = tmp_path / "wait.yaml"
    path.write_text(
        "model: both.bpmn\nworld:\n  size: [9, 9]\n  robots:\n"
        "    A: {type: car, at: [1, 1]}\n    B: {type: car, at: [5, 5]}\n"
    )
    code, said = field.fame("run", str(path), "--middleware", "dds", "--duration", "30", "--speed", "40")
    assert (code, said["status"]) == (1, "timeout"), said
    assert said["messages"][0] == f"not over after {said['simulated']:g} simulated seconds"
    assert said["simulated"] >= 30
    assert len(said["messages"]) == 3
    assert 30 <= said["world"]["time"] < 300


@pytest.mark.parametrize("how", ["an engine is killed", "Ctrl-C", "we are killed"])
def test_processes_of_one_run_end_together(tmp_path, field, how):
    path = tmp_path / "both.bpmn"
    path.write_text(BOTH_WAIT)
    for robot in "AB":
        field.said[robot] = []
        field.node.subscription(f"/{robot}/bpmn_status", STRING, partial(field._hear, robot), STATUS_QOS)
    run = field.start("run", str(path), "--middleware", "dds")
    field.until(lambda: (field.at("A"), field.at("B")) == (["wait_a"], ["wait_b"]), "the team to run")
    children = {pid for pid in children_of(run.pid) if b"engine" in command_of(pid)}
    assert len(children) == 2
    if how == "an engine is killed":
        os.kill(min(children), signal.SIGKILL)
        _, text = run.communicate(timeout=LIMIT)
        assert (run.returncode, "was killed by SIGKILL" in text) == (1, True)
    elif how == "Ctrl-C":
        run.send_signal(signal.SIGINT)
        assert run.wait(LIMIT) == 130
    else:
        field.kill(run)
    field.until(lambda: not any(b"engine" in command_of(pid) for pid in children), "the engines to end")


def test_a_team_of_a_run_with_a_key_is_redeployed_with_it_and_refuses_what_is_not_signed(tmp_path, field):
    for name, text in (("both.bpmn", BOTH_WAIT), ("new.bpmn", BOTH_WAIT.replace('"wait_', '"later_'))):
        (tmp_path / name).write_text(text)
    assert field.start("keys", "new", str(tmp_path / "team")).wait(LIMIT) == 0
    key, new = str(tmp_path / "team.key"), str(tmp_path / "new.bpmn")
    for robot in "AB":
        field.said[robot] = []
        field.node.subscription(f"/{robot}/bpmn_status", STRING, partial(field._hear, robot), STATUS_QOS)
    run = field.start("run", str(tmp_path / "both.bpmn"), "--middleware", "dds", "--key", key)
    field.until(lambda: (field.at("A"), field.at("B")) == (["wait_a"], ["wait_b"]), "the team to run")
    code, said = field.fame("deploy", new)
    assert (code, "of a team of fame run: its --key" in json.dumps(said)) == (1, True), said
    assert (field.at("A"), field.at("B")) == (["wait_a"], ["wait_b"])
    code, said = field.fame("deploy", new, "--key", key)
    assert code == 0, said
    field.until(lambda: (field.at("A"), field.at("B")) == (["later_a"], ["later_b"]), "the team to run the new model")
    run.send_signal(signal.SIGINT)
    assert run.wait(LIMIT) == 130


def children_of(parent: int) -> list[int]:
    return [int(pid) for pid in Path(f"/proc/{parent}/task/{parent}/children").read_text().split()]


def command_of(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def test_a_second_world_in_a_domain_is_refused_and_told_of_the_domain() -> None:
    environment = {**ENVIRONMENT, "ROS_DOMAIN_ID": str(DOMAIN + 1)}
    words = [sys.executable, "-m", "fame", "world", str(ROOT / "examples" / "convoy.yaml")]
    with subprocess.Popen(words, env=environment, cwd=ROOT, stderr=subprocess.PIPE, text=True) as first:
        assert first.stderr is not None
        assert first.stderr.readline().startswith("a world with ")
        second = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=LIMIT, check=False)
        first.send_signal(signal.SIGINT)
    assert second.returncode == 2
    assert second.stderr.startswith(f"fame: error: another world is on /clock in ROS domain {DOMAIN + 1}; for a second")


def test_a_scenario_completes_tasks_and_publishes_signals_of_types_of_its_own_to_processes_too(tmp_path, field):
    types = tmp_path / "msgs" / "orchard_msgs" / "msg"
    types.mkdir(parents=True)
    (types / "Apple.msg").write_text("float64 weight\nbool ripe\n")
    properties = (
        '<extensionElements><camunda:properties><camunda:property name="type" value="orchard_msgs/msg/Apple"/>'
        '<camunda:property name="queue" value="1"/></camunda:properties></extensionElements>'  # "u" may complete late
    )
    head = HEAD.replace(" targetN", ' xmlns:camunda="http://camunda.org/schema/1.0/bpmn" targetN')
    (tmp_path / "m.bpmn").write_text(
        f'{head}<signal id="G" name="go"/><process id="p" name="A" isExecutable="true"><startEvent id="s"/>'
        '<userTask id="u"/>'
        f'<intermediateCatchEvent id="c">{properties}<signalEventDefinition signalRef="G"/></intermediateCatchEvent>'
        f"{flows('p', 's', 'u', 'c')}</process></definitions>"
    )
    path = tmp_path / "s.yaml"
    path.write_text(
        "model: m.bpmn\ncomputers: [A]\ntypes: [msgs]\ncomplete: {at: 0.5, robot: A, element: u}\n"
        "signal: {at: 2, name: go, payload: {weight: 2}}\n"
    )
    code, said = field.fame("run", str(path), "--middleware", "dds", "--duration", "20")
    assert (code, said["status"]) == (0, "completed"), said
