"""`fame check SCENARIO.yaml`: the scenario and its model, without running it."""

from pathlib import Path

import pytest
from check_drawing import BOOL, ROOT, call, catch, data, given, reading, row, script, team

from fame.cli import main

WORLD = "world: {size: [4, 4], robots: {REX: {type: car, at: [1, 1]}}}\n"
GOOD = "model: m.bpmn\nlibrary: [lib]\nseed: 3\n" + WORLD


def found(tmp_path: Path, capsys: pytest.CaptureFixture[str], scenario: str, content: str) -> tuple[int, list[str]]:
    """The exit code, and the lines that are printed, of a scenario beside a model."""
    (tmp_path / "lib").mkdir(exist_ok=True)
    (tmp_path / "m.bpmn").write_text(team(content))
    (tmp_path / "s.yaml").write_text(scenario)
    code = main(["check", str(tmp_path / "s.yaml")])
    out, err = capsys.readouterr()
    assert err == ""
    return code, [line.removeprefix(f"{tmp_path}/") for line in out.splitlines()]


def test_a_scenario_is_checked_with_its_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert found(tmp_path, capsys, GOOD, row(script("x = 1")))[0] == 0
    code, lines = found(tmp_path, capsys, GOOD, row(script("log(sped)")))
    assert (code, lines) == (0, ["m.bpmn:5: warning: t: reads `sped`, which nothing sets", "1 warning"])


def test_nothing_of_it_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    touches = f"open({str(tmp_path / 'ran')!r}, 'w')"
    assert found(tmp_path, capsys, GOOD, row(script(touches))) == (0, ["No problems found."])
    assert not (tmp_path / "ran").exists()


WRONG = {
    "a key": (f"{GOOD}sed: 3", "s.yaml:5: error: sed: unknown key"),
    "no robot for a pool": (GOOD.replace("REX", "TIM"), "s.yaml:4: error: world.robots.TIM: "),
    "no such model": (GOOD.replace("m.bpmn", "n.bpmn"), "s.yaml:1: error: model: expected a file"),
    "a robot that stands outside": (GOOD.replace("[1, 1]", "[9, 1]"), "s.yaml:4: error: world.robots.REX.at: "),
    "positions of another robot": (
        f"{GOOD}poses: {{RXE: /x}}",
        "s.yaml:5: error: poses.RXE: unknown robot or pool 'RXE'",
    ),
    "not YAML": ("model: [", "s.yaml:1: error: is not valid YAML: "),
    "another file": ("Files: {}", "s.yaml: error: is a learning file, which is for fame monitor adm learn"),
}


@pytest.mark.parametrize(("scenario", "expected"), WRONG.values(), ids=WRONG.keys())
def test_what_is_wrong_with_it_is_an_error(
    scenario: str, expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, lines = found(tmp_path, capsys, scenario, row(script("x = 1")))
    assert (code, len(lines), lines[-1]) == (1, 2, "1 error")
    assert lines[0].startswith(expected)


def test_behaviours_are_looked_for_in_its_folders(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    called = (ROOT / "models" / "library" / "Turn.bpmn").read_text().replace('id="Turn"', 'id="Pivot"')
    calling = row('<callActivity id="c" calledElement="Pivot"/>')
    assert found(tmp_path, capsys, GOOD, calling)[0] == 1
    (tmp_path / "lib" / "Pivot.bpmn").write_text(called)
    assert found(tmp_path, capsys, GOOD, calling)[0] == 0


def test_what_only_its_robots_refuse_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, lines = found(tmp_path, capsys, GOOD, row(catch("a", "odom", scope="robot", type=BOOL)))
    assert (code, len(lines)) == (1, 2)
    assert lines[0].startswith(
        f'm.bpmn:5: error: "odom" (a): {BOOL}: topic /REX/odom is in use with nav_msgs/msg/Odometry'
    )


@pytest.mark.parametrize("scenario", ["delivery.yaml", "shuttle.yaml"])
def test_an_example_has_no_errors_and_no_warnings(scenario: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(ROOT / "examples" / scenario)]) == 0
    assert "warning" not in capsys.readouterr().out


TOPICS = script(
    'robot.publish("lde", "std_msgs/msg/ColorRGBA", g=1.0)\nawait receive("range", "sensor_msgs/msg/Range")', "t"
)


@pytest.mark.parametrize(
    ("type", "told"),
    [
        ("car", ["REX publishes on /REX/lde, which has no subscriber; did you mean /REX/led?"]),
        ("drone", ["REX waits for /REX/range, which nothing here publishes; there are: battery_state, camera/weeds, "]),
    ],
)
def test_topics_that_a_robot_of_the_world_does_not_have_are_told(
    type: str, told: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, lines = found(tmp_path, capsys, GOOD.replace("car", type), row(TOPICS))
    texts = [line.partition("s.yaml: warning: ")[2] for line in lines if "warning: REX" in line]
    assert (code, len(texts)) == (0, len(told))
    assert [text[: len(each)] for text, each in zip(texts, told, strict=True)] == told


@pytest.mark.parametrize("computed", ['robot.publish("ran" + n, "std_msgs/msg/Bool")', 'robot.latest(f"l{n}")'])
def test_topics_of_the_robot_that_a_script_may_compute_are_not_told(
    computed: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    type = "car" if "latest" in computed else "drone"
    content = row(TOPICS, script(f"n = 'x'\n{computed}", "u"))
    assert found(tmp_path, capsys, GOOD.replace("car", type), content) == (0, ["No problems found."])


FORM = (
    '<userTask id="ask"><extensionElements><camunda:formData><camunda:formField id="bags" type="long"/>'
    "</camunda:formData></extensionElements></userTask>"
)
REQUIRED = FORM.replace(
    'type="long"/>',
    'type="long"><camunda:validation><camunda:constraint name="required"/></camunda:validation></camunda:formField>',
)


@pytest.mark.parametrize(
    ("before", "values", "told"), [("x = 1", "{}", True), ("bags = 1", "{}", False), ("x = 1", "{bags: 2}", False)]
)
def test_an_answer_without_what_the_form_requires_is_a_warning(
    before: str, values: str, told: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    answer = f"complete: [{{at: 1, robot: REX, element: ask, values: {values}}}]\n"
    _, lines = found(tmp_path, capsys, GOOD + answer, row(script(before), REQUIRED))
    text = "s.yaml: warning: completes ask of REX without bags, which its form requires"
    assert (text in lines) == told, lines


IN_VAIN = {
    "duration: 9\ncomplete: [{at: 10, robot: REX, element: ask}]": (
        "ask of REX is completed at 10 s, which is after the end of the run (9 s)"
    ),
    "duration: 9\nsignal: [{at: 9.5, name: done}]": (
        "/done is published at 9.5 s, which is after the end of the run (9 s)"
    ),
    "network: {links: [{topic: /doen, loss: 0.5}]}": (
        "network: no robot uses the topic /doen; did you mean '/done'?"
    ),
}  # fmt: skip


@pytest.mark.parametrize(("says", "told"), IN_VAIN.items())
def test_what_it_says_in_vain_is_a_warning(
    says: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, lines = found(tmp_path, capsys, f"{GOOD}{says}\n", row(FORM, catch("a", "done")))
    assert f"s.yaml: warning: {told}" in lines


LINK = GOOD + "network: {links: [{topic: /REX/filtered, loss: 0.5}]}\n"
PORT = "{%s: {Topic: %s, Field: [range], MessageType: sensor_msgs/msg/Range}}"


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (row(script("x = 1")), True),
        (row(script("robot.publish('filt' + 'ered', 'sensor_msgs/msg/Range')")), False),
        (row(script("robot.latest(f'f{1}')")), False),
        (data("goal", configuration="unit.yaml") + row(call("c", "ProcessingUnit", given("c", "goal"))), False),
        (data("goal", configuration="${file}") + row(call("c", "ProcessingUnit", given("c", "goal"))), False),
    ],
)
def test_a_link_of_a_topic_that_something_may_use_is_used(
    content: str, told: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ports = f"Inputs: {PORT % ('In', 'range')}\nOutputs: {PORT % ('Out', 'filtered')}\n"
    (tmp_path / "unit.yaml").write_text(f"{ports}Processor: {{Class: LowPass, Parameters: {{cutoff: 5}}}}\n")
    _, lines = found(tmp_path, capsys, LINK.replace("car", "drone"), content)
    assert any("network: no robot uses the topic /REX/filtered" in line for line in lines) is told, lines


def test_what_it_publishes_is_published(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content, lonely = row(catch("a", "done"), catch("b", "found")), "m.bpmn throws it"
    _, lines = found(tmp_path, capsys, f"{GOOD}signal: [{{at: 1, name: done}}]\n", content)
    assert len([line for line in lines if line.endswith(lonely)]) == 1, lines


@pytest.mark.parametrize("given", ["speed: 1", "REX: {speed: 1}"])
def test_a_variable_that_it_sets_is_set(given: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content, wanted = row(script("log(speed + pace)")), "reads `pace`, which nothing sets"
    _, lines = found(tmp_path, capsys, f"{GOOD}variables: {{{given}}}\n", content)
    assert [line.partition("t: ")[2].partition(";")[0] for line in lines if "nothing sets" in line] == [wanted]


INPUT = (
    '<property id="p"/><dataInputAssociation id="i"><sourceRef>goal</sourceRef><targetRef>p</targetRef>'
    "</dataInputAssociation>"
)


@pytest.mark.parametrize(
    ("read", "topic", "told"),
    [("odom", "range", []), ("odom", "rnage", ["range"]), ("odmo", "range", ["odmo"]), ("~/range", "range", [])],
)
def test_what_a_pipeline_of_the_robot_publishes_is_there_and_what_it_reads_should_be(
    read: str, topic: str, told: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    port = "{%s: {Topic: %s, Field: [range], MessageType: sensor_msgs/msg/Range}}"
    ports = f"Inputs: {port % ('In', read)}\nOutputs: {port % ('Out', topic)}\n"
    (tmp_path / "unit.yaml").write_text(f"{ports}Processor: {{Class: LowPass, Parameters: {{cutoff: 5}}}}\n")
    content = data("goal", configuration="unit.yaml") + row(call("c", "ProcessingUnit", INPUT), TOPICS)
    _, lines = found(tmp_path, capsys, GOOD.replace("car", "drone"), content)
    waits = [line.partition("REX waits for /REX/")[2].partition(",")[0] for line in lines if "REX waits" in line]
    assert waits == told


COMPUTER = GOOD.replace("car", "drone") + "computers: [DINGO]\n"
UNIT = (
    "Inputs: {In: {Topic: odom, Field: [pose, pose, position, x],\n  MessageType: nav_msgs/msg/Odometry}}\n"
    "Outputs: {Out: {Topic: low, Field: [data], MessageType: std_msgs/msg/Float64}}\n"
    "Processor: {Class: LowPass, Parameters: {cutoff: 5}}\n"
)


def monitored(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], called: str, unit: str = UNIT, **values: str
) -> list[str]:
    """What is found about REX, a drone, and DINGO, a computer that runs a service with these variables."""
    (tmp_path / "unit.yaml").write_text(unit)
    content = data("goal", **values) + row(call("c", called, INPUT), mark="2")
    (tmp_path / "m.bpmn").write_text(team(row(script("x = 1")), content))
    (tmp_path / "s.yaml").write_text(COMPUTER)
    (tmp_path / "lib").mkdir()
    main(["check", str(tmp_path / "s.yaml")])
    out, _ = capsys.readouterr()
    return [line.removeprefix(f"{tmp_path}/") for line in out.splitlines() if "warning:" in line or "error:" in line]


@pytest.mark.parametrize("called", ["ProcessingUnit", "Record"])
@pytest.mark.parametrize(("space", "waits"), [("", "DINGO"), ("RXE", "RXE"), ("rex", "rex"), ("REX", "")])
def test_a_monitor_on_another_computer_names_the_robot_that_it_monitors(
    called: str, space: str, waits: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    values = {"configuration": "unit.yaml", "output": "o.csv"} | ({"namespace": space} if space else {})
    told = (
        f"s.yaml: warning: DINGO waits for /{waits}/odom, which nothing here publishes; did you mean /REX/odom? "
        "`namespace` of a monitor names its robot"
    )
    assert monitored(tmp_path, capsys, called, **values) == ([told] if waits else [])


def test_a_computer_that_catches_what_it_does_not_have_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = row(catch("a", "odom", scope="robot", type="nav_msgs/msg/Odometry"), mark="2")
    (tmp_path / "m.bpmn").write_text(team(row(script("x = 1")), content))
    (tmp_path / "s.yaml").write_text(COMPUTER)
    (tmp_path / "lib").mkdir()
    main(["check", str(tmp_path / "s.yaml")])
    assert (
        "DINGO waits for /DINGO/odom, which nothing here publishes; did you mean /REX/odom?" in capsys.readouterr()[0]
    )


def test_a_monitor_has_the_message_type_of_the_robot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    unit = UNIT.replace("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovarianceStamped")
    lines = monitored(tmp_path, capsys, "ProcessingUnit", unit, configuration="unit.yaml", namespace="REX")
    assert lines == [
        "unit.yaml:2: error: does not start: geometry_msgs/msg/PoseWithCovarianceStamped: topic /REX/odom is in use "
        "with nav_msgs/msg/Odometry, by /REX/planner, /REX/robot: it has one type"
    ]


def test_the_trigger_of_runs_is_published_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    unit = f"{UNIT}Run: {{Topic: input_3}}\n"
    (line,) = monitored(tmp_path, capsys, "Record", unit, configuration="unit.yaml", output="o", namespace="REX")
    assert "DINGO waits for /REX/input_3, which nothing here publishes" in line


@pytest.mark.parametrize(
    ("called", "values", "expected"),
    [
        ("adm_learn", {"config": "no.yaml"}, "warning: c: does not start: there is no file "),
        ("Record", {"configuration": "unit.yaml", "output": "5"}, "error: c: does not start: variable output: "),
        ("Train", {"configuration": "unit.yaml"}, "error: c: does not start: {0}/unit.yaml: has no section Training"),
        ("ProcessingUnit", {"blnd": "wait"}, "warning: c: gives 'blnd', which its service does not take; did you mean"),
        ("Record", {"Namespace": "REX"}, "warning: c: gives 'Namespace', which its service does not take; did you "),
    ],
)
def test_what_services_do_not_take_is_told(
    called: str, values: dict[str, str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = monitored(tmp_path, capsys, called, **{"configuration": "unit.yaml", **values})
    assert any(line.startswith(f"m.bpmn:13: {expected.format(tmp_path)}") for line in lines), lines


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("Files: 5", "Training.Files: expected a text, got 5"),
        ("Fils: [a.csv]", "Training.Fils: unknown key"),
        ("Files: [later*.csv]", ""),
    ],
)
def test_the_settings_of_a_training_are_read_whose_files_the_mission_may_record(
    setting: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = monitored(tmp_path, capsys, "Train", f"{UNIT}Training: {{{setting}}}\n", configuration="unit.yaml")
    assert [said in line for line in lines] == ([True] if said else []), lines


@pytest.mark.parametrize(("given", "told"), [("fast", True), ("2.5", False)])
def test_a_mission_parameter_is_of_the_kind_that_the_model_sets(
    given: str, told: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = data("goal", speed="1") + row(reading("r", "goal", "x = speed"))
    _, lines = found(tmp_path, capsys, f"{GOOD}variables: {{speed: {given}}}\n", content)
    expected = "s.yaml: warning: variables: speed = 'fast', a text; elsewhere it is a number"
    assert (expected in lines) == told


@pytest.mark.parametrize(
    ("x", "where"),
    [("45", "outside the ground (x -0.05 to 4.05 m, y -0.05 to 4.05 m)"), ("2.5", "inside an obstacle"), ("3.5", "")],
)
def test_a_constant_goal_is_where_a_robot_can_be(
    x: str, where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rock = GOOD.replace("robots:", "obstacles: [{name: rock, at: [2.5, 1], radius: 0.4}], robots:")
    content = data("goal", x_goal=x, y_goal="1.0") + row(call("g", "GoTo", INPUT))
    _, lines = found(tmp_path, capsys, rock, content)
    assert [line.partition("warning: ")[2] for line in lines if "is sent to" in line] == (
        [f"g: REX is sent to x={x} y=1, {where}"] if where else []
    )


@pytest.mark.parametrize(("value", "told"), [("two", True), ("2", False)])
def test_an_answer_without_a_form_is_of_the_kind_that_the_model_sets(
    value: str, told: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    answer = f"complete: [{{at: 1, robot: REX, element: ask, values: {{bags: {value}}}}}]\n"
    _, lines = found(tmp_path, capsys, GOOD + answer, row(script("bags = 1"), '<userTask id="ask"/>'))
    expected = "s.yaml: warning: completes ask of REX with bags = 'two', a text; elsewhere it is a number"
    assert (expected in lines) == told
