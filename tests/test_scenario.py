"""A world, its robots and a collaboration in one process: the ground-vehicle mission, and what can go wrong with it."""

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from bpmn_text import document, process, properties
from collaborations import text_of

import fame
from fame.bpmn.model.forms import FormField, unfit_value
from fame.cli import main
from fame.errors import ConfigError, MissionError
from fame.log import Recording
from fame.robot import Event
from fame.scenario import Progress, Result, Scenario
from fame.scenario.run import Run
from fame.testing import MissionLoader

EXAMPLE = Path("examples/ground_vehicles.yaml")
MODEL = Path("models/ground_vehicles.bpmn")


def changed(tmp_path: Path, *replacements: tuple[str, str], model: tuple[tuple[str, str], ...] = ()) -> Path:
    """The example with some of its text replaced, in a folder of its own."""
    drawn, text = MODEL.read_text(), EXAMPLE.read_text()
    for old, new in model:
        assert old in drawn
        drawn = drawn.replace(old, new)
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "mission.bpmn").write_text(drawn)
    path = tmp_path / "scenario.yaml"
    path.write_text(text.replace("../models/ground_vehicles.bpmn", "mission.bpmn"))
    return path


def run(path: Path, **options) -> Result:
    return Scenario.load(path).run(**options)


@pytest.fixture(scope="module")
def played() -> tuple[Result, list[Event], list[Progress]]:
    events: list[Event] = []
    progress: list[Progress] = []
    result = Scenario.load(EXAMPLE).run(observer=events.append, progress=progress.append)
    return result, events, progress


def test_the_mission_is_completed_by_both_robots(played):
    result, _, _ = played
    assert (result.status, result.exit_code, result.messages) == ("completed", 0, [])
    assert [each.verdict for each in result.judgements] == ["holds"] * 3
    assert [(robot.name, robot.instances, robot.completed) for robot in result.robots] == [
        ("REX", 1, 1),
        ("DINGO", 1, 1),
    ]


BLIND = """\
model: m.bpmn
world:
  size: [6, 4]
  obstacles:
    - {name: rock, at: [2.5, 1], radius: 0.4}
  stations:
    - {name: shelf, at: [1.5, 3]}
    - {name: packing, at: [5, 3]}
  parcels:
    - {name: parcel, at: shelf, to: packing}
    - {name: other, at: shelf}
  robots:
    P: {type: car, at: [0.8, 1]}
"""
AHEAD = """<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/>
<scriptTask id="t" scriptFormat="python"><script>for speed in (0.5, 0.5, 0.5, 0.5, 0.5, 0.5, -0.5, -0.5, 0.5, 0.5, 0.5):
    robot.publish("cmd_vel", "geometry_msgs/msg/Twist", linear={"x": speed})
    await sleep(0.45)</script></scriptTask>"""


def test_what_is_wrong_in_the_world_is_said_of_a_run_that_has_completed(tmp_path: Path) -> None:
    (tmp_path / "m.bpmn").write_text(process(AHEAD))
    path = tmp_path / "m.yaml"
    path.write_text(BLIND)
    result = run(path)
    assert (result.status, result.exit_code) == ("completed", 0)
    collided, parcel = result.messages
    assert re.fullmatch(r"P collided with rock 2 times, first at 2\.\d+ s", collided)
    assert parcel == "parcel parcel is at shelf, not at packing"
    path.write_text(BLIND.replace("type: car", "type: tractor, battery: {charge: 0}"))
    assert run(path).messages[0] == "the battery of P is empty"


def test_dingo_stands_at_the_target_and_its_led_is_red(played):
    dingo = played[0].world["robots"]["DINGO"]
    assert dingo["distances"]["target"] < 0.3
    assert dingo["led"] == "red"
    assert played[0].world["collisions"] == []


def test_progress_says_what_the_robots_are_at(played):
    result, _, progress = played
    assert progress[-1].simulated == result.simulated
    assert set(progress[-1].robots) == {"REX", "DINGO"}
    assert any(one.robots["REX"].startswith("Explore") for one in progress)


@pytest.mark.long
def test_the_same_seed_gives_the_same_events_and_another_seed_others(played):
    again: list[Event] = []
    Scenario.load(EXAMPLE).run(observer=again.append)
    assert again == played[1]
    other: list[Event] = []
    result = Scenario.load(EXAMPLE, seed=2).run(observer=other.append)
    assert result.status == "completed"
    assert other != again


def test_moving_the_target_changes_where_dingo_goes(tmp_path):
    result = run(changed(tmp_path, ("[5.5, 0.6]", "[0.9, 2.2]")))
    dingo = result.world["robots"]["DINGO"]
    assert result.status == "completed"
    assert dingo["distances"]["target"] < 0.3
    assert dingo["x"] < 1.3


@pytest.mark.long
def test_an_obstacle_taken_away_is_no_longer_in_the_way(tmp_path, played):
    line = "    - {name: crate, at: [1.9, 1.2], size: [0.8, 0.5]}\n"
    result = run(changed(tmp_path, (line, "")))
    assert result.status == "completed"
    assert result.simulated != played[0].simulated


@pytest.mark.long
def test_a_renamed_pool_is_played_by_the_robot_of_that_name(tmp_path):
    result = run(
        changed(
            tmp_path,
            ("DINGO:", "SPOT:"),
            ("never DINGO", "never SPOT"),
            ("target_found, DINGO", "target_found, SPOT"),
            ("(REX, DINGO)", "(REX, SPOT)"),
            model=(('name="DINGO"', 'name="SPOT"'),),
        )
    )
    assert [robot.name for robot in result.robots] == ["REX", "SPOT"]
    assert result.status == "completed"


def test_a_world_without_the_target_fails_the_mission_and_says_why(tmp_path):
    result = run(changed(tmp_path, ("    - {name: target, at: [5.5, 0.6], radius: 0.08}\n", ""), ("targets:", "")))
    assert (result.status, result.exit_code) == ("failed", 1)
    assert "target_not_found" in result.messages[0]


def test_a_robot_that_no_pool_knows_is_refused(tmp_path):
    with pytest.raises(
        fame.ConfigError,
        match=r"scenario\.yaml:\d+: world\.robots\.ROVER: expected a robot of a pool \(REX, DINGO\), got 'ROVER'",
    ):
        run(changed(tmp_path, ("    DINGO:", "    ROVER: {type: car, at: [5, 4]}\n    DINGO:")))


def test_a_pool_without_a_robot_is_refused(tmp_path):
    with pytest.raises(fame.ConfigError, match=r"scenario\.yaml:\d+: world\.robots: pool 'DINGO' has no robot"):
        run(changed(tmp_path, ("    DINGO: {type: car, at: [-0.5, 3.5]}\n", "")))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("network: {links: [{between: [REX, X], loss: 0.1}]}", r": network: unknown robot 'X'"),
        ("variables: {REX: {sped: 1}}", r": variables\.REX\.sped: REX has no variable 'sped'"),
        ("variables: {sped: 1}", r": variables\.sped: the mission has no variable 'sped'"),
        ("variables: {REKS: {speed: 1}}", r": variables\.REKS: unknown robot 'REKS'"),
    ],
)
def test_a_value_that_does_not_fit_the_model_is_refused_with_its_line(tmp_path, line: str, message: str):
    with pytest.raises(fame.ConfigError, match=r"scenario\.yaml:\d+" + message):
        run(changed(tmp_path, ("seed: 1", f"seed: 1\n{line}")))


def test_a_model_that_is_not_there_is_refused_with_its_line(tmp_path):
    (tmp_path / "s.yaml").write_text("seed: 1\nmodel: none.bpmn\n")
    with pytest.raises(fame.ConfigError, match=r"s\.yaml:2: model: expected a file.*, got 'none\.bpmn'"):
        run(tmp_path / "s.yaml")


def test_an_unknown_key_is_refused_with_its_line(tmp_path):
    with pytest.raises(fame.ConfigError, match=r"scenario\.yaml:\d+: sead: unknown key"):
        run(changed(tmp_path, ("seed: 1", "sead: 1")))


FIRE = 'robot.publish("led"'


def with_fire(tmp_path: Path, text: str) -> Path:
    """The mission with the first line of DINGO's script replaced, and a duration that suits it."""
    return changed(tmp_path, ("[5.5, 0.6]", "[0.9, 2.2]"), ("300", "60"), model=((FIRE, f"{text}\n{FIRE}"),))


def test_a_script_that_raises_fails_its_robot_and_the_others_are_stopped(tmp_path):
    result = run(with_fire(tmp_path, "1 / 0"))
    rex, dingo = result.robots
    assert (result.status, dingo.failed, rex.failed) == ("failed", 1, 0)
    assert "ZeroDivisionError" in result.messages[0]
    assert "mission.bpmn" in result.messages[0]
    assert any(message.startswith("REX waits at") and "/done" in message for message in result.messages)


@pytest.mark.long
def test_a_script_that_loops_for_ever_is_ended_and_its_robot_fails(tmp_path):
    result = run(with_fire(tmp_path, "while True: pass"))
    assert result.status == "failed"
    assert result.robots[1].errors[0].code == "script"


@pytest.mark.long
def test_a_script_that_waits_for_what_nobody_publishes_ends_with_the_duration(tmp_path):
    result = run(with_fire(tmp_path, 'await receive("silence", "std_msgs/msg/Bool")'))
    assert (result.status, result.exit_code, result.simulated) == ("timeout", 1, 60.0)
    assert any(message.startswith("DINGO waits at") and "silence" in message for message in result.messages)


def test_a_model_alone_runs_its_robots_as_engines_without_a_world():
    result = Scenario.load(MODEL, duration=5).run()
    assert result.world is None
    assert result.status == "timeout"
    assert any(message.startswith("REX waits at") for message in result.messages)


def many(tmp_path, multiplicity):
    """A model alone with a pool of many robots."""
    path = tmp_path / "ants.bpmn"
    path.write_text(
        '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="t"><collaboration id="c">'
        f'<participant id="A" name="Ant" processRef="p"><participantMultiplicity {multiplicity}/></participant>'
        '</collaboration><process id="p"><startEvent id="s"/></process></definitions>'
    )
    return path


@pytest.mark.parametrize(
    ("multiplicity", "number"),
    [("", 1), ('minimum="2"', 2), ('minimum="3" maximum="4"', 3), ('minimum="0" maximum="*"', 1), ('maximum="9"', 1)],
)
def test_a_model_alone_has_as_many_robots_as_its_multiplicity_has_at_least(tmp_path, multiplicity, number):
    scenario = Scenario.load(many(tmp_path, multiplicity))
    assert list(scenario.cast) == [f"Ant_{n}" for n in range(1, number + 1)]
    assert scenario.run().status == "completed"


def test_how_many_robots_there_are_is_for_who_runs_it_to_say_up_to_the_maximum(tmp_path):
    path = many(tmp_path, 'minimum="2" maximum="3"')
    assert [len(Scenario.load(path, robots={"Ant": number}).cast) for number in (0, 1, 3)] == [0, 1, 3]
    with pytest.raises(fame.ConfigError, match=r"expected at most 3 robots for pool 'Ant' .*, got 4"):
        Scenario.load(path, robots={"Ant": 4})


@pytest.mark.parametrize("wrong", [{"seed": -1}, {"duration": 0}, {"duration": float("nan")}])
def test_a_seed_or_a_duration_that_cannot_be_is_refused(wrong):
    with pytest.raises(fame.ConfigError, match=r"expected .*, got"):
        Scenario.load(MODEL, **wrong)


def test_what_is_thrown_last_is_still_heard_before_a_run_is_over(tmp_path):
    ends = ('<endEvent id="{}"><signalEventDefinition signalRef="S"/></endEvent>', '<endEvent id="{}"/>')
    starts = ('<startEvent id="{}"/>', '<startEvent id="{}"><signalEventDefinition signalRef="S"/></startEvent>')
    pools = "".join(f'<participant id="P{number}" name="R{number}" processRef="Q{number}"/>' for number in (0, 1))
    flow = '<sequenceFlow id="f{0}" sourceRef="s{0}" targetRef="e{0}"/>'
    processes = "".join(
        f'<process id="Q{number}">{starts[number].format(f"s{number}")}{ends[number].format(f"e{number}")}'
        f"{flow.format(number)}</process>"
        for number in (0, 1)
    )
    signal = '<signal id="S" name="go"/>'
    path = tmp_path / "relay.bpmn"
    path.write_text(document(f'<collaboration id="C">{pools}</collaboration>{processes}{signal}'))
    result = run(path)
    assert (result.status, [robot.completed for robot in result.robots]) == ("completed", [1, 1])


def test_messages_that_come_faster_than_a_robot_takes_them_are_counted_at_the_end(tmp_path, capsys):
    pools = "".join(f'<participant id="P{number}" name="R{number}" processRef="Q{number}"/>' for number in (0, 1))
    burst = "<script>for _ in range(102):\n    robot.publish('/go', 'std_msgs/msg/Empty')</script>"
    talks = (
        f'<process id="Q0"><startEvent id="s0"/><scriptTask id="burst" scriptFormat="python">{burst}</scriptTask>'
        '<sequenceFlow id="f0" sourceRef="s0" targetRef="burst"/></process>'
    )
    hears = '<process id="Q1"><startEvent id="s1"><signalEventDefinition signalRef="S"/></startEvent></process>'
    path = tmp_path / "burst.bpmn"
    path.write_text(document(f'<collaboration id="C">{pools}</collaboration>{talks}{hears}<signal id="S" name="go"/>'))
    assert main(["run", str(path)]) == 0
    assert "   0.0 s   /go: /R1/fame_engine lost 2 messages" in capsys.readouterr().err


def test_a_join_that_waits_in_vain_is_named(tmp_path):
    pairs = ("s g", "g a", "g b", "a j", "b j", "j e")
    flows = "".join(
        f'<sequenceFlow id="{pair[0]}{pair[2]}" sourceRef="{pair[0]}" targetRef="{pair[2]}"/>' for pair in pairs
    )
    tasks = '<task id="a"/><task id="b"/><parallelGateway id="j"/><endEvent id="e"/>'
    path = tmp_path / "join.bpmn"
    path.write_text(
        process(
            f'<startEvent id="s"/><exclusiveGateway id="g" default="ga"/>{tasks}{flows}'.replace(
                'sourceRef="g" targetRef="b"/>',
                'sourceRef="g" targetRef="b"><conditionExpression>False</conditionExpression></sequenceFlow>',
            )
        )
    )
    assert run(path).messages[-1] == "P waits at j for a token on 1 of its 2 flows"


def test_a_complex_gateway_whose_condition_is_false_is_named(tmp_path):
    gateway = '<complexGateway id="j"><activationCondition>False</activationCondition></complexGateway>'
    flow = '<sequenceFlow id="f" sourceRef="s" targetRef="j"/>'
    path = tmp_path / "complex.bpmn"
    path.write_text(process(f'<startEvent id="s"/>{gateway}{flow}'))
    assert run(path).messages[-1] == "P waits at j for another token: its activation condition is false"


def test_a_run_without_a_world_is_over_when_its_last_element_is(tmp_path):
    timer = "<timerEventDefinition><timeDuration>PT0.25S</timeDuration></timerEventDefinition>"
    path = tmp_path / "wait.bpmn"
    path.write_text(
        process(
            f'<startEvent id="s"/><intermediateCatchEvent id="w">{timer}</intermediateCatchEvent>'
            '<sequenceFlow id="f" sourceRef="s" targetRef="w"/>'
        )
    )
    assert run(path).simulated == 0.25


@pytest.mark.long
def test_a_topic_that_nobody_hears_is_told_with_the_one_that_was_meant(tmp_path):
    path = changed(tmp_path, model=(('robot.publish("led"', 'robot.publish("Led"'),))
    told = [(event.robot, event.detail) for event in run(path).reports]
    assert told == [("DINGO", "publishes on /DINGO/Led, which has no subscriber; did you mean /DINGO/led?")]


# ---- message types of the mission ------------------------------------------------------------------------------------


def own_types(folder: Path, package: str) -> Path:
    """A scenario whose model throws and catches a signal of a type of its own, beside a file that is no type."""
    types = folder / "msgs" / package / "msg"
    types.mkdir(parents=True)
    (types / "Apple.msg").write_text("float64 weight\nbool ripe\n")
    (types / "Broken.msg").write_text("float65 weight;\n")
    said = properties(type=f"{package}/msg/Apple", payload="{weight: 0.2, ripe: true}")
    event = '<signalEventDefinition signalRef="S"/>'
    (folder / "m.bpmn").write_text(
        process(
            f'<startEvent id="s"/><intermediateThrowEvent id="t">{said}{event}</intermediateThrowEvent>'
            f'<intermediateCatchEvent id="c"><signalEventDefinition signalRef="R"/></intermediateCatchEvent>'
            '<scriptTask id="k"><script>w = Picked_again.weight</script></scriptTask>'
            '<sequenceFlow id="f" sourceRef="s" targetRef="t"/><sequenceFlow id="g" sourceRef="t" targetRef="c"/>'
            '<sequenceFlow id="h" sourceRef="c" targetRef="k"/>',
            '<signal id="S" name="picked"/><signal id="R" name="Picked again"/>',
            'name="P"',
        ).replace(
            '<intermediateCatchEvent id="c">',
            f'<intermediateCatchEvent id="c">{properties(type=f"{package}/msg/Apple")}',
        )
    )
    path = folder / "s.yaml"
    path.write_text(
        "model: m.bpmn\ncomputers: [P]\ntypes: [msgs]\nsignal: {at: 3, name: Picked again, payload: {weight: 2}}\n"
    )
    return path


@pytest.mark.long
def test_types_of_ones_own_are_known_wherever_the_scenario_is_read(tmp_path: Path, capsys) -> None:
    def fresh(package: str) -> str:
        (tmp_path / package).mkdir()
        return str(own_types(tmp_path / package, package))

    without = Path(fresh("pears_msgs"))
    without.write_text("model: m.bpmn\ncomputers: [P]\n")
    assert main(["run", str(without)]) == 2
    assert "no such message type" in capsys.readouterr().err
    log = tmp_path / "run.mcap"
    assert main(["run", fresh("run_msgs"), "--log", str(log), "--json"]) == 0
    with Recording(log) as recording:
        assert recording.topics["/picked"].type == "run_msgs/msg/Apple"
    assert main(["check", fresh("check_msgs")]) == 0
    assert main(["check", "--explore", fresh("explore_msgs")]) in (0, 1)
    assert "no such message type" not in capsys.readouterr().err
    folder = tmp_path / "campaign"
    assert main(["campaign", fresh("many_msgs"), "--runs", "4", "--jobs", "2", "-o", str(folder)]) == 0
    loader = MissionLoader(lambda: tmp_path)
    loader.load(fresh("test_msgs")).advance(4).expect().completed().has(w=2.0)
    loader.close()


def test_a_broken_file_of_a_type_is_named_where_the_type_is_needed(tmp_path: Path, capsys) -> None:
    path = own_types(tmp_path, "plum_msgs")
    model = tmp_path / "m.bpmn"
    model.write_text(model.read_text().replace("plum_msgs/msg/Apple", "plum_msgs/msg/Broken"))
    assert main(["run", str(path)]) == 2
    assert "its file cannot be used: " in (shown := capsys.readouterr().err)
    assert "Broken.msg: " in shown
    path.write_text("model: m.bpmn\ncomputers: [P]\ntypes: [nowhere]\n")
    assert main(["run", str(path)]) == 2
    assert "s.yaml:3: types[0]: there is no .msg, .srv or .action file at" in capsys.readouterr().err


def test_what_an_instance_changes_in_a_variable_of_the_scenario_no_other_one_sees(tmp_path):
    steps = {"A": ["start go", "run seen.append(1); assert seen == [1]"], "B": ["throw go", "timer PT1S", "throw go"]}
    (tmp_path / "m.bpmn").write_text(text_of(steps))
    (tmp_path / "s.yaml").write_text("model: m.bpmn\nvariables: {A: {seen: []}}\n")
    result = run(tmp_path / "s.yaml")
    assert (result.status, result.robots[0].instances) == ("completed", 2)


# ---- the values of forms ---------------------------------------------------------------------------------------------


def asking(folder: Path, field: str) -> Path:
    """A scenario in which somebody is asked for `bags`."""
    form = f"<extensionElements><camunda:formData>{field}</camunda:formData></extensionElements>"
    (folder / "m.bpmn").write_text(process(
        f'<startEvent id="s"/><userTask id="ask">{form}</userTask><sequenceFlow id="f" sourceRef="s" targetRef="ask"/>'
    ))  # fmt: skip
    path = folder / "s.yaml"
    path.write_text("model: m.bpmn\ncomputers: [P]\ncomplete: [{at: 1, robot: P, element: ask, values: {bags: 3}}]\n")
    return path


BOUNDS = '<camunda:validation><camunda:constraint name="min" config="1"/></camunda:validation>'


@pytest.mark.parametrize(
    ("field", "fits", "wrong", "right"),
    [
        ('<camunda:formField id="bags" type="long"/>', [2.0, 10**400, None], ["two", 2.5, True, math.nan], "a whole"),
        ('<camunda:formField id="bags" type="double"/>', [2.5], ["two", math.inf], "a number"),
        (f'<camunda:formField id="bags" type="long">{BOUNDS}</camunda:formField>', [1], [0], "a whole number of 1 or"),
        ('<camunda:formField id="bags" type="boolean"/>', [True], ["yes", 1], "true or false"),
        ('<camunda:formField id="bags" type="string"/>', ["two", 2], [], ""),
        ('<camunda:formField id="bags" type="enum"><camunda:value id="a" name="A"/></camunda:formField>', ["a"], ["b"],
         "one of a"),
    ],
    ids=["long", "double", "least", "boolean", "string", "enum"],
)  # fmt: skip
def test_a_value_that_the_form_of_a_task_does_not_take_is_refused(
    field: str, fits: list[object], wrong: list[object], right: str, tmp_path: Path
) -> None:
    path = asking(tmp_path, field)
    text = path.read_text()
    for value, is_right in (*((one, True) for one in fits), *((one, False) for one in wrong)):
        path.write_text(text.replace("bags: 3", f"bags: {yaml.safe_dump(value).splitlines()[0]}"))
        if is_right:
            assert Scenario.load(path).run().status == "completed"
        else:
            with pytest.raises(ConfigError, match=re.escape(f"complete[0].values: ask: bags: expected {right}")):
                Scenario.load(path)


@pytest.mark.parametrize(
    ("field", "value", "right"),
    [
        (FormField(kind="number", least=1, most=9), 10, "a number from 1 to 9"),
        pytest.param(FormField(kind="number", most=9), 10**400, "a number of 9 or less", id="beyond every float"),
        (FormField(kind="text", least=2, most=3), "four", "a text with a length from 2 to 3"),
        (FormField(kind="textarea", least=2), "a", "a text with a length of 2 or more"),
        (FormField(kind="text", required=True), "", "a value"),
        (FormField(kind="text", least=2), "", ""),
        (FormField(kind="text", least=2), 5, ""),
    ],
)
def test_what_a_field_expects_is_said(field: FormField, value: object, right: str) -> None:
    for key, values in (("bags", {"bags": value}), ("order.bags", {"order": {"bags": value}})):
        text = unfit_value([replace(field, key=key)], values)
        assert text.startswith(f"{key}: expected {right}, got ") if right else text == ""
    assert unfit_value([replace(field, key="order.bags")], {"order": 3}) == ""


@pytest.mark.parametrize(
    ("keys", "name", "said"),
    [
        (["bags", "note"], "bgs", "the form has no field 'bgs'; did you mean 'bags'?"),
        (["bags", "note"], "weight", "the form has no field 'weight'; known are: bags, note"),
        (["order.bags"], "order", ""),
        (["bags", ""], "bgs", "the form has no field 'bgs'; did you mean 'bags'?"),
        (["bags", ""], "weight", ""),  # it may be the field that FAME does not draw
        ([], "bgs", ""),
    ],
)
def test_a_value_for_a_field_that_a_form_does_not_have_is_refused(keys: list[str], name: str, said: str) -> None:
    form = [FormField(key=key, kind="text" if key else "other") for key in keys]
    assert unfit_value(form, {name: "x"}) == said


def test_what_a_person_leaves_out_of_a_form_is_reported(tmp_path: Path) -> None:
    required = '<camunda:validation><camunda:constraint name="required"/></camunda:validation>'
    path = asking(tmp_path, f'<camunda:formField id="bags" type="long">{required}</camunda:formField>')
    path.write_text(path.read_text().replace("bags: 3", ""))
    reports = [str(event.detail) for event in Scenario.load(path).run().reports]
    assert reports == ["completed by a person, without bags, which its form requires"]


def test_nor_does_a_running_robot_take_it(tmp_path: Path) -> None:
    path = asking(tmp_path, '<camunda:formField id="bags" type="long"/>')
    path.write_text(path.read_text().partition("complete:")[0])
    run = Run(Scenario.load(path), False, None, None)
    run.begin()
    run.scheduler.run(0)
    with pytest.raises(MissionError, match="bags: expected a whole number, got 'two'"):
        run.nodes[0].complete("ask", {"bags": "two"})
    with pytest.raises(MissionError, match="the form has no field 'bgs'; did you mean 'bags'"):
        run.nodes[0].complete("ask", {"bgs": 2})
    assert run.nodes[0].complete("ask", {"bags": 2})
    run.close()
