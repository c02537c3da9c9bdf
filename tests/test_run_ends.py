"""A run ends when nothing runs and nothing will start by itself; what never started is not completed."""

from pathlib import Path

import pytest
from bpmn_text import document

from fame.campaign.runs import cause_of
from fame.cli import main
from fame.deploy import Report
from fame.middleware.network import Delay, Link, NetworkConfig, Partition
from fame.scenario import Fault, Result, Scenario
from fame.scenario.result import reported_result

SIGNALS = '<signal id="Go" name="go"/><signal id="Own" name="~/go"/><message id="Order" name="order"/>'
ODOMETRY = (
    '<extensionElements><camunda:properties><camunda:property name="type" value="nav_msgs/msg/Odometry"/>'
    "</camunda:properties></extensionElements>"
)
OPTIONAL = (
    '<extensionElements><camunda:properties><camunda:property name="optional" value="true"/></camunda:properties>'
    "</extensionElements>"
)


def started_by(kind: str, text: str) -> str:
    """A timer start event's definition."""
    return f"<timerEventDefinition><{kind}>{text}</{kind}></timerEventDefinition>"


def pool(name: str, *starts: str, work: str = "await sleep(0.5)", head: str = "", many: int = 0) -> tuple[str, str]:
    """A pool whose process has these start events, and works a while."""
    events = "".join(
        f'<startEvent id="{name}_s{n}">{start}</startEvent><sequenceFlow id="{name}_f{n}" sourceRef="{name}_s{n}"'
        f' targetRef="{name}_t"/>'
        for n, start in enumerate(starts)
    )
    task = f'<scriptTask id="{name}_t"><script>{work}</script></scriptTask>'
    mark = f'<participantMultiplicity minimum="{many}"/>' if many else ""
    participant = f'<participant id="{name}_p" name="{name}" processRef="{name}_b">{mark}</participant>'
    return participant, f'<process id="{name}_b" isExecutable="true">{head}{events}{task}</process>'


def write(folder: Path, *pools: tuple[str, str]) -> Path:
    drawn, processes = ("".join(parts) for parts in zip(*pools, strict=True))
    path = folder / "mission.bpmn"
    path.write_text(document(f'{SIGNALS}<collaboration id="C">{drawn}</collaboration>{processes}'))
    return path


def run(folder: Path, *pools: tuple[str, str], duration: float = 20, **options: object) -> Result:
    return Scenario.load(write(folder, *pools), duration=duration, **options).run()  # type: ignore[arg-type]


def completed(result: Result) -> dict[str, int]:
    return {robot.name: robot.completed for robot in result.robots}


# ---- what starts by itself -------------------------------------------------------------------------------------------


def test_a_cycle_starts_as_often_as_it_says(tmp_path: Path) -> None:
    result = run(tmp_path, pool("A", started_by("timeCycle", "R3/PT2S")))
    assert (result.status, completed(result), result.simulated) == ("completed", {"A": 3}, 6.5)


def test_a_timer_starts_also_when_all_else_has_ended(tmp_path: Path) -> None:
    result = run(tmp_path, pool("A", ""), pool("B", started_by("timeDuration", "PT3S")))
    assert (result.status, completed(result), result.simulated) == ("completed", {"A": 1, "B": 1}, 3.5)


def test_a_date_starts_on_its_day(tmp_path: Path) -> None:
    result = run(tmp_path, pool("A", started_by("timeDate", "1970-01-01T00:00:07Z")))
    assert (result.status, completed(result), result.simulated) == ("completed", {"A": 1}, 7.5)


def test_a_cycle_without_end_is_completed_with_the_duration(tmp_path: Path) -> None:
    result = run(tmp_path, pool("A", started_by("timeCycle", "R/PT2S")), duration=7)
    assert (result.status, result.exit_code, result.messages) == ("completed", 0, [])
    assert (completed(result), result.simulated) == ({"A": 3}, 7.0)


def test_what_runs_when_the_duration_is_over_is_not_completed(tmp_path: Path) -> None:
    result = run(tmp_path, pool("A", started_by("timeCycle", "R/PT2S")), duration=6.2)
    assert (result.status, result.messages[0][:8]) == ("timeout", "not over")


def test_nor_is_what_was_still_to_start(tmp_path: Path) -> None:
    result = run(tmp_path, pool("A", started_by("timeCycle", "R3/PT2S")), duration=5)
    assert (result.status, result.exit_code, completed(result)) == ("timeout", 1, {"A": 2})
    assert result.messages[1] == "A waits at A_s0 for its start, due at 6 s"


def test_a_start_by_a_date_is_said_with_the_date(tmp_path: Path) -> None:
    result = run(tmp_path, pool("A", started_by("timeDate", "2026-11-22T09:00:00Z")), duration=5)
    assert result.messages[-1] == "A waits at A_s0 for its start, due at 2026-11-22T09:00:00Z"


def test_each_robot_of_a_pool_has_its_timers(tmp_path: Path) -> None:
    result = run(tmp_path, pool("Ant", started_by("timeCycle", "R2/PT2S"), many=3))
    assert (result.status, completed(result)) == ("completed", {"Ant_1": 2, "Ant_2": 2, "Ant_3": 2})


def test_a_timer_beside_a_message_start(tmp_path: Path) -> None:
    message = '<messageEventDefinition messageRef="Order"/>'
    result = run(tmp_path, pool("A", started_by("timeDuration", "PT3S"), message), pool("B", ""))
    assert (result.status, completed(result), result.simulated) == ("completed", {"A": 1, "B": 1}, 3.5)


def test_a_cycle_that_is_over_before_the_beginning_keeps_nobody(tmp_path: Path) -> None:
    past = started_by("timeCycle", "R2/1969-01-01T00:00:00Z/PT1H")
    result = run(tmp_path, pool("A", "", past))
    assert (result.status, completed(result), result.simulated) == ("completed", {"A": 1}, 0.5)


def test_a_robot_whose_engine_dies_starts_no_more(tmp_path: Path) -> None:
    pools = pool("A", started_by("timeCycle", "R3/PT2S")), pool("B", "")
    result = run(tmp_path, *pools, faults=[Fault("A", 3.0, "engine")])
    assert (result.status, completed(result), result.simulated) == ("completed", {"A": 1, "B": 1}, 3.0)


# ---- what is under way, or promised ----------------------------------------------------------------------------------

ON_GO = '<signalEventDefinition signalRef="Go"/>'
SAYS_GO = 'await sleep(1)\nrobot.publish("/go", "std_msgs/msg/Empty")'


@pytest.mark.parametrize(
    ("network", "end"),
    [
        (NetworkConfig((Link(Delay("fixed", 0.05)),)), 1.55),
        (NetworkConfig((Link(Delay("fixed", 0.05), loss=0.9),)), 1.75),  # sent again
        (NetworkConfig(partitions=(Partition(("A", "B"), 0, 8),)), 8.5),  # held back
    ],
    ids=["delayed", "sent again", "held back"],
)
def test_a_run_is_not_over_while_a_message_that_starts_a_process_is_under_way(
    tmp_path: Path, network: NetworkConfig, end: float
) -> None:
    result = run(tmp_path, pool("A", "", work=SAYS_GO), pool("B", ON_GO), network=network)
    assert (result.status, completed(result), result.simulated) == ("completed", {"A": 1, "B": 1}, end)


def test_nor_while_an_acknowledged_signal_is_owed_to_who_starts_by_it(tmp_path: Path) -> None:
    head = (
        '<extensionElements><camunda:properties><camunda:property name="delivery" value="acknowledged"/>'
        f"</camunda:properties></extensionElements>{ON_GO}"
    )
    throw = (
        '<process id="A_b" isExecutable="true"><startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/>'
        f'<intermediateThrowEvent id="t">{head}</intermediateThrowEvent></process>'
    )
    cut = NetworkConfig(partitions=(Partition(("A", "B"), 0, 15),))  # longer than the lease: what is sent is lost
    result = run(tmp_path, (pool("A", "")[0], throw), pool("B", ON_GO), network=cut)
    assert (result.status, completed(result)) == ("completed", {"A": 1, "B": 1})


@pytest.mark.parametrize(
    ("start", "faults"), [("", []), (ON_GO, [Fault("B", 0.5, "engine")])], ids=["starts otherwise", "its engine died"]
)
def test_a_message_that_nobody_can_take_keeps_no_run(tmp_path: Path, start: str, faults: list[Fault]) -> None:
    network = NetworkConfig((Link(Delay("fixed", 5.0)),))
    pools = pool("A", "", work=SAYS_GO), pool("B", start, head=OPTIONAL)
    assert run(tmp_path, *pools, network=network, faults=faults).simulated == 1.0


def test_what_the_world_publishes_all_the_time_keeps_no_run(tmp_path: Path) -> None:
    start = '<signalEventDefinition signalRef="Odom"/>'
    signals = '<signal id="Odom" name="/A/odom"/>'
    drawn, bodies = zip(pool("A", "", work="await sleep(2.03)"), pool("B", start, work="pass"), strict=True)
    typed = f'<startEvent id="B_s0">{ODOMETRY}'
    text = "".join(bodies).replace('<startEvent id="B_s0">', typed)
    (tmp_path / "m.bpmn").write_text(document(f'{signals}<collaboration id="C">{"".join(drawn)}</collaboration>{text}'))
    (tmp_path / "s.yaml").write_text(
        "model: m.bpmn\nnetwork: {delay: 0.2}\n"
        "world: {size: [9, 9], robots: {A: {type: car, at: [1, 1]}, B: {type: car, at: [4, 4]}}}\n"
    )
    result = Scenario.load(tmp_path / "s.yaml", duration=20).run()
    assert (result.status, result.simulated < 3) == ("completed", True)


# ---- what never started ----------------------------------------------------------------------------------------------

ON_ITS_GO = '<signalEventDefinition signalRef="Own"/>'


def test_a_pool_that_never_started_is_not_completed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = run(tmp_path, pool("A", ""), pool("B", ON_GO))
    assert (result.status, result.exit_code, result.never_started) == ("failed", 1, ("B",))
    assert result.messages[0] == "pool B never started: no robot of it ran its process"
    assert main(["run", str(tmp_path / "mission.bpmn"), "--quiet"]) == 1
    assert "fame: pool B never started" in capsys.readouterr().err


def test_unless_its_process_is_optional(tmp_path: Path) -> None:
    result = run(tmp_path, pool("A", ""), pool("B", ON_GO, head=OPTIONAL))
    assert (result.status, result.messages) == ("completed", [])


def test_a_pool_of_many_has_started_with_one_of_its_robots(tmp_path: Path) -> None:
    calls = 'robot.publish("/Ant_1/go", "std_msgs/msg/Empty")'
    result = run(tmp_path, pool("A", "", work=calls), pool("Ant", ON_ITS_GO, many=2))
    assert (result.status, completed(result)) == ("completed", {"A": 1, "Ant_1": 1, "Ant_2": 0})
    result = run(tmp_path, pool("A", ""), pool("Ant", ON_ITS_GO, many=2))
    assert result.never_started == ("Ant",)


def test_optional_is_true_or_false(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path, pool("A", "", head=OPTIONAL.replace("true", "maybe")))
    assert main(["run", str(path)]) == 2
    assert "property optional='maybe': expected true or false" in capsys.readouterr().err


# ---- what is told of tokens and messages that are left ---------------------------------------------------------------

STOP = (
    '<subProcess id="h" name="Emergency stop" triggeredByEvent="true"><extensionElements><camunda:properties>'
    '<camunda:property name="resume" value="true"/></camunda:properties></extensionElements>'
    '<startEvent id="ht"><timerEventDefinition><timeDuration>PT2S</timeDuration></timerEventDefinition></startEvent>'
    '<sequenceFlow id="hf" sourceRef="ht" targetRef="hu"/>'
    '<scriptTask id="hu"><script>await sleep(60)</script></scriptTask></subProcess>'
)
WAITING = (
    '<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="c"/><callActivity id="c" name="Go home" '
    'calledElement="Drive"/>'
)
INNER = (
    '<process id="Drive"><intermediateCatchEvent id="o" name="odom"><signalEventDefinition signalRef="Go"/>'
    "</intermediateCatchEvent></process>"
)


def test_a_token_is_told_by_what_is_drawn_and_by_who_suspends_it(tmp_path: Path) -> None:
    (tmp_path / "Drive.bpmn").write_text(document(SIGNALS + INNER))
    path = tmp_path / "mission.bpmn"
    path.write_text(document(f'<process id="P" isExecutable="true">{WAITING}{STOP}</process>'))
    result = Scenario.load(path, duration=10).run()
    place = 'P waits at "Go home" (c), inside it Drive at "odom" (o)'
    assert f'{place}, suspended by "Emergency stop" since 8 s' in result.messages
    assert result.to_json()["robots"]["P"]["waits"][0]["suspended"] == 'suspended by "Emergency stop" since 8 s'
    assert cause_of(result).startswith(f'{place.replace("waits", "waited")}, suspended by "Emergency stop"; ')
    path.write_text(document(f'<process id="P" isExecutable="true">{WAITING}</process>'))
    assert f"{place}, for topic /go, which no other node publishes" in Scenario.load(path, duration=10).run().messages


def test_messages_that_no_event_took_are_counted(tmp_path: Path) -> None:
    send = "".join(f'<sendTask id="m{n}" messageRef="Order"/>' for n in range(3))
    flows = "".join(
        f'<sequenceFlow id="f{n}" sourceRef="{a}" targetRef="m{n}"/>' for n, a in enumerate(("s", "m0", "m1"))
    )
    path = tmp_path / "team.bpmn"
    path.write_text(document(
        f'{SIGNALS}<collaboration id="C"><participant id="p" name="Boss" processRef="A"/>'
        '<participant id="q" name="Worker" processRef="B"/></collaboration>'
        f'<process id="A" isExecutable="true"><startEvent id="s"/>{send}{flows}</process><process id="B" isExecutable='
        '"true"><receiveTask id="r" messageRef="Order"/><sequenceFlow id="g" sourceRef="r" targetRef="t"/><scriptTask '
        'id="t"><script>await sleep(1)</script></scriptTask></process>'
    ))  # fmt: skip
    result = Scenario.load(path, duration=10).run()
    assert result.status == "completed"
    assert result.messages == ["Worker: 2 messages on /order reached it, and no event took them"]
    assert result.to_json()["robots"]["Worker"]["untaken"] == {"/order": 2}
    report = Report.from_json(Report(robot="Worker", state="idle", untaken={"/order": 2}).to_json())
    assert reported_result("Worker", report).untaken == {"/order": 2}


def test_dropped_triggers_of_an_element_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one = '<extensionElements><camunda:properties><camunda:property name="instances" value="1"/></camunda:properties>'
    head = f"{one}</extensionElements>"
    path = write(tmp_path, pool("A", started_by("timeCycle", "R4/PT2S"), work="await sleep(30)", head=head))
    assert main(["run", str(path), "--duration", "50"]) == 0
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "trigger dropped" in line]
    assert line == "    4.0 s   A: A_s0: trigger dropped: 1 instance(s) of A_b are already running (3 times)"
