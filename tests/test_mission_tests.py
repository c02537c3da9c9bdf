"""Tests of missions: what drives them, what is expected of them, what a failed expectation shows."""

import math
import re
from pathlib import Path

import numpy
import pytest
from action_server import DRIVE
from bpmn_text import document, process, properties

from fame.errors import ConfigError, MessageError, MissionError
from fame.middleware import codec, messages
from fame.testing import ExpectationError, MissionLoader, MissionUnderTest

pytest_plugins = ["pytester"]
ROOT = Path(__file__).parent.parent
VEHICLES = ROOT / "models" / "ground_vehicles.bpmn"
FOUND = {"target_found": {"x": 1.0, "y": 2.0}}


def flows(*pairs: str) -> str:
    """Sequence flows between elements of one letter: ``flows("st", "te")``."""
    return "".join(f'<sequenceFlow id="{a}{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in pairs)


@pytest.fixture
def vehicles(mission: MissionLoader) -> MissionUnderTest:
    """Two cars without a world; REX finds the target after 2 s."""
    loaded = mission.load(VEHICLES)
    loaded.stub("Explore", after=2, signals=FOUND)
    return loaded


def one(folder: Path, content: str, root: str = "") -> Path:
    """A model with one process."""
    path = folder / "mission.bpmn"
    path.write_text(process(content, root))
    return path


# ---- driving ---------------------------------------------------------------------------------------------------------


def test_nothing_runs_before_the_first_advance(vehicles: MissionUnderTest) -> None:
    assert not vehicles.begun
    assert (vehicles.now, vehicles.trace.steps) == (0.0, [])
    vehicles.advance(0)
    assert vehicles.begun
    vehicles.expect("REX").waits_at("Explore")


def test_a_mission_goes_on_to_an_element_and_tells_the_way(vehicles: MissionUnderTest) -> None:
    go = vehicles.stub("GoTo", after=3)
    vehicles.run_until("DINGO", at="Go To")
    assert vehicles.now == 2
    vehicles.expect("REX").passed("Explore").before("done").within(2)
    vehicles.expect("DINGO").never_entered("Fire").has(x_target=1.0, y_target=2.0)
    vehicles.expect("DINGO").completed(within=10)
    vehicles.expect("REX").completed()
    assert [(call.robot, call.variables["x_goal"]) for call in go.calls] == [("DINGO", 1.0)]
    (found,) = vehicles.published("/target_found")
    assert (found.time, found.robot, found.message.y) == (2.0, "REX", 2.0)


def test_a_signal_before_the_beginning_arrives_when_all_have_started(mission: MissionLoader) -> None:
    m = mission.load(VEHICLES)
    m.stub("Explore")
    m.stub("GoTo")
    m.signal("target_found", x=3.0, y=0.5).advance(0)
    m.expect("DINGO").passed("Go To", times=1)


def test_it_runs_until_a_topic_a_robot_or_a_condition(vehicles: MissionUnderTest) -> None:
    vehicles.stub("GoTo", after=3)
    assert vehicles.run_until(published="/target_found").now == 2
    assert vehicles.run_until(condition=lambda: vehicles.now >= 2).now == 2
    vehicles.run_until(completed="REX")
    vehicles.expect("REX").passed("done").after("Explore")


def test_a_message_at_time_0_counts_for_the_first_run_until(vehicles: MissionUnderTest) -> None:
    vehicles.stub("Explore", signals=FOUND)
    vehicles.stub("GoTo")
    assert vehicles.run_until(published="/target_found").now == 0
    with pytest.raises(ExpectationError, match="expected a message on /target_found within 9 s"):
        vehicles.run_until(published="/target_found", within=9)


def test_a_robot_of_run_until_is_the_sender_or_refused(vehicles: MissionUnderTest) -> None:
    vehicles.stub("GoTo")
    with pytest.raises(ExpectationError, match="expected a message of DINGO on /target_found within 9 s"):
        vehicles.run_until("DINGO", published="/target_found", within=9)
    with pytest.raises(ConfigError, match=r"expected no robot besides condition= or completed=ROBOT, got 'REKS'"):
        vehicles.run_until("REKS", condition=lambda: True)
    with pytest.raises(ConfigError, match=r"expected no robot besides condition= or completed=ROBOT, got 'DINGO'"):
        vehicles.run_until("DINGO", completed="REX")
    with pytest.raises(ConfigError, match="expected one of"):
        vehicles.run_until(completed=False)


def test_variables_are_set_before_and_while_it_runs(mission: MissionLoader, tmp_path: Path) -> None:
    waits = '<conditionalEventDefinition id="c"><condition>x &gt; limit</condition></conditionalEventDefinition>'
    content = f'<startEvent id="s"/><intermediateCatchEvent id="w">{waits}</intermediateCatchEvent><endEvent id="e"/>'
    m = mission.load(one(tmp_path, content + flows("sw", "we")))
    m.set(x=1, limit=3).advance(1)
    m.expect().waits_at("w").has(x=1)
    m.set(x=4)
    m.expect().completed()
    with pytest.raises(MissionError, match="no instance is running, so there are no variables to set"):
        m.set(x=5)


def test_a_list_that_is_set_is_one_of_its_own_for_each_robot(vehicles: MissionUnderTest) -> None:
    vehicles.run_until("DINGO", at="Go To").set(found=(found := list[int]()))
    first, second = (vehicles.variables(robot)["found"] for robot in vehicles.robots)
    assert first == second == found
    assert len({id(first), id(second), id(found)}) == 3


def test_variables_that_are_set_before_the_beginning_replace_the_defaults_of_the_model(mission: MissionLoader) -> None:
    m = mission.load(ROOT / "models" / "sabotage.bpmn")
    with pytest.raises(ConfigError, match="Arm has no variable 'parts_wantd'; did you mean 'parts_wanted'"):
        m.set("Arm", parts_wantd=1)
    for behaviour in ("adm_collect", "adm_learn", "adm_operate"):
        m.stub(behaviour, after=9)
    m.set("Arm", parts_wanted=1).run_until("Arm", at="part_cut")
    m.signal("Arm", "~/part_cut", data=1)
    m.expect("Arm").completed().has(parts_wanted=1, part=1)


def test_people_complete_tasks(mission: MissionLoader, tmp_path: Path) -> None:
    content = '<startEvent id="s"/><userTask id="u" name="Sign it"/><userTask id="v"/><endEvent id="e"/>'
    m = mission.load(one(tmp_path, content + flows("su", "uv", "ve")))
    m.person({"Sign it": {"approved": True}}, after=5)
    m.run_until(at="v")
    assert m.now == 5
    m.complete("v", count=2)
    m.expect().completed().has(approved=True, count=2)


def test_an_instance_that_fails_is_expected_by_its_code(vehicles: MissionUnderTest) -> None:
    vehicles.stub("GoTo", after=1, raises="blocked")
    vehicles.expect("DINGO").failed("blocked", at="Go To", within=10)
    with pytest.raises(ExpectationError, match="with code 'lost', but it failed with code 'blocked'"):
        vehicles.expect("DINGO").failed("lost")


def test_an_element_that_was_cancelled_before_the_failure_has_not_failed(
    mission: MissionLoader, tmp_path: Path
) -> None:
    late = """<boundaryEvent id="late" attachedToRef="u"><timerEventDefinition><timeDuration>PT5S</timeDuration>
    </timerEventDefinition></boundaryEvent>
    <scriptTask id="v" scriptFormat="python"><script>1 / 0</script></scriptTask>"""
    content = f'<startEvent id="s"/><userTask id="u" name="Sign"/>{late}<sequenceFlow id="f" sourceRef="late"'
    m = mission.load(one(tmp_path, f'{content} targetRef="v"/>{flows("su")}'))
    m.expect().failed(at="v", within=10)
    text = "to have failed at \"Sign\" (u), but it failed with code 'script' at v"
    with pytest.raises(ExpectationError, match=re.escape(text)):
        m.expect().failed(at="Sign")


def test_a_branch_that_is_cancelled_by_the_failure_of_another_has_not_failed(
    mission: MissionLoader, tmp_path: Path
) -> None:
    inner = """<startEvent id="i"/><scriptTask id="b" name="Cut" scriptFormat="python"><script>1 / 0</script>
    </scriptTask>"""
    content = f"""<startEvent id="s"/><parallelGateway id="p"/><userTask id="w" name="Stand by"/>
    <subProcess id="m" name="Mow">{inner}{flows("ib")}</subProcess>{flows("sp", "pw", "pm")}"""
    m = mission.load(one(tmp_path, content))
    m.advance(1)
    m.expect().failed(at="Cut").failed(at="Mow")
    text = 'to have failed at "Stand by" (w), but it failed with code \'script\' at "Cut" (b)'
    with pytest.raises(ExpectationError, match=re.escape(text)):
        m.expect().failed(at="Stand by")


def test_a_call_has_failed_if_what_it_calls_has(mission: MissionLoader, tmp_path: Path) -> None:
    fails = '<startEvent id="qs"/><scriptTask id="b" scriptFormat="python"><script>1 / 0</script></scriptTask>'
    called = f'<process id="Q">{fails}<sequenceFlow id="qf" sourceRef="qs" targetRef="b"/></process>'
    pool = '<collaboration id="k"><participant id="o" name="P" processRef="P"/></collaboration>'
    calls = """<startEvent id="s"/><parallelGateway id="p"/><callActivity id="c" calledElement="Q"/>
    <userTask id="w"/>"""
    m = mission.load(one(tmp_path, f"{calls}{flows('sp', 'pc', 'pw')}", called + pool))
    m.advance(1)
    m.expect().failed(at="c")
    with pytest.raises(ExpectationError, match="to have failed at w, but"):
        m.expect().failed(at="w")


# ---- failures --------------------------------------------------------------------------------------------------------


def test_a_failed_expectation_shows_tokens_reasons_and_events_and_saves_the_run(mission: MissionLoader) -> None:
    m = mission.load(VEHICLES)
    m.stub("Explore", after=2)
    m.stub("GoTo")
    with pytest.raises(ExpectationError) as caught:
        m.expect("DINGO").completed(within=60)
    lines = str(caught.value).splitlines()
    assert lines[0] == "DINGO: expected to have completed within 60 s"
    assert '  REX  at "done" (Event_DoneCaught) since 2 s, waits for topic /done' in lines
    start = '  DINGO  at "target_found" (Event_TargetFound), waits for its start on topic /target_found'
    assert any(line.startswith(start) for line in lines)
    assert '      2.000 s  REX  left "Explore" (Activity_Explore)' in lines
    saved = [Path(line.removeprefix("saved: ")) for line in lines if line.startswith("saved: ")]
    assert [path.name for path in saved] == ["run.mcap", "ground_vehicles.svg"]
    assert "waiting" in saved[1].read_text()
    from fame.log import Recording

    with Recording(saved[0]) as recording:
        assert "REX" in recording.robots


@pytest.mark.parametrize(
    ("expected", "text"),
    [
        (lambda e: e.passed("Fire"), 'expected to have passed "Fire" (Activity_Fire), but it was never entered'),
        (lambda e: e.passed("Go To", times=2), "expected to have passed"),
        (lambda e: e.never_entered("Go To"), "but it was entered at 2 s"),
        (lambda e: e.waits_at("Fire"), "but it was never entered"),
        (lambda e: e.entered("Go To").before("target_found"), 'and "target_found" (Event_TargetFound) was entered'),
        (lambda e: e.entered("Go To").within(1), "within 1 s, but it was at 2 s"),
        (lambda e: e.has(x_target=7), "expected the variable x_target = 7, but it is 1.0"),
        (lambda e: e.has(speed=7), "expected the variable speed = 7, but it is not set"),
        (lambda e: e.failed(), "but it has not failed"),
    ],
)
def test_what_does_not_hold_is_said(vehicles: MissionUnderTest, expected: object, text: str) -> None:
    vehicles.stub("GoTo", after=30)
    vehicles.run_until("DINGO", at="Go To")
    with pytest.raises(ExpectationError) as caught:
        expected(vehicles.expect("DINGO"))  # type: ignore[operator]
    assert text in str(caught.value).splitlines()[0]


def test_an_element_may_be_expected_to_have_completed_never(vehicles: MissionUnderTest) -> None:
    with pytest.raises(ConfigError, match=r"passed\('Fire', times=0\): nothing has run yet"):
        vehicles.expect("DINGO").passed("Fire", times=0)
    vehicles.stub("GoTo", after=30)
    vehicles.run_until("DINGO", at="Go To")
    passage = vehicles.expect("DINGO").passed("Go To", times=0).passed("Fire", times=0)
    assert passage.times == []
    for late in (lambda: passage.within(5), lambda: passage.before("Go To")):
        with pytest.raises(ConfigError, match="has not been passed: there is no time to compare"):
            late()
    with pytest.raises(ExpectationError, match=r"passed .* 0 times, but it has completed 1 times"):
        vehicles.expect("REX").passed("Explore", times=0)
    with pytest.raises(ConfigError, match="expected times to be a whole number from 0 on, got -1"):
        vehicles.expect("REX").passed("Explore", times=-1)


@pytest.mark.parametrize(
    ("script", "equal", "other"),
    [
        ("import numpy\nx = numpy.array([1.0, 2.0])", [1.0, 2.0000001], [1.0, 3.0]),
        ("import numpy\nx = {'a': numpy.array([[1], [2]])}", {"a": numpy.array([[1], [2]])}, {"a": [[1], [3]]}),
        ("import numpy\nx = numpy.float32(0.1)", 0.1, 0.2),
        ("x = [0.1 + 0.2, (1,)]", [0.3, (1.0,)], [0.3, [1]]),
        ("x = 1", 1.0000001, 1.1),
        ("x = {'a': 0.1 + 0.2}", {"a": 0.3}, {"a": 0.3, "b": 1}),
        ("x = 'a'", "a", "b"),
        ("x = 1", 1, True),
        ("x = [True]", [True], [1.0]),
    ],
)
def test_numbers_are_compared_to_a_millionth_at_any_depth(
    mission: MissionLoader, tmp_path: Path, script: str, equal: object, other: object
) -> None:
    m = mission.load(one(tmp_path, f'<scriptTask id="s" scriptFormat="python"><script>{script}</script></scriptTask>'))
    m.advance(1).expect().has(x=equal)
    with pytest.raises(ExpectationError, match="expected the variable x = "):
        m.expect().has(x=other)


@pytest.mark.parametrize("seconds", [-1, math.nan, math.inf, "5"])
def test_a_time_is_a_number_of_seconds(vehicles: MissionUnderTest, seconds: float) -> None:
    passage = vehicles.advance(3).expect("REX").passed("Explore")
    for name, asked in (
        ("completed", lambda: passage.completed(within=seconds)),
        ("failed", lambda: passage.failed(within=seconds)),
        ("within", lambda: passage.within(seconds)),
        ("run_until", lambda: vehicles.run_until("DINGO", at="Fire", within=seconds)),
        ("advance", lambda: vehicles.advance(seconds)),
    ):
        with pytest.raises(ConfigError, match=f"{name}: expected a number of seconds from 0 on, got"):
            asked()


def test_unknown_names_get_similar_ones(vehicles: MissionUnderTest) -> None:
    with pytest.raises(
        ConfigError, match=r"""REX has no element 'Exploe'; did you mean "Explore" \(Activity_Explore\)"""
    ):
        vehicles.expect("REX").passed("Exploe")
    with pytest.raises(ConfigError, match="unknown robot 'REKS'; known are: REX, DINGO"):
        vehicles.expect("REKS")
    with pytest.raises(ConfigError, match="name the robot first: robots are REX, DINGO"):
        vehicles.expect()
    with pytest.raises(ConfigError, match="no process uses the topic /target_fond; did you mean '/target_found'"):
        vehicles.signal("/target_fond")
    with pytest.raises(ConfigError, match="no process uses the topic /odom"):
        vehicles.published("/odom")
    with pytest.raises(ConfigError, match="unknown fault 'engin' of REX; known are: engine"):
        vehicles.fault("REX", "engin")
    with pytest.raises(ConfigError, match="expected one argument, or a robot before it, got none"):
        vehicles.fault()
    with pytest.raises(
        ConfigError, match=r"expected a topic and its payload or fields, got \{'x': 1\}, '/target_found'"
    ):
        vehicles.signal({"x": 1}, "/target_found")


def test_an_element_that_is_not_reached_ends_the_run_when_nothing_can_happen(vehicles: MissionUnderTest) -> None:
    vehicles.stub("GoTo", raises="blocked")
    with pytest.raises(ExpectationError, match=r'DINGO: expected to come to "Fire" \(Activity_Fire\) within 600 s'):
        vehicles.run_until("DINGO", at="Fire")


# ---- stubs -----------------------------------------------------------------------------------------------------------


def test_a_stub_has_other_results_at_successive_calls(mission: MissionLoader, tmp_path: Path) -> None:
    loop = (
        '<startEvent id="s"/><callActivity id="c" calledElement="GoTo"/><boundaryEvent id="b" attachedToRef="c">'
        '<errorEventDefinition id="d"/></boundaryEvent><endEvent id="e"/>'
    )
    m = mission.load(one(tmp_path, loop + flows("sc", "bc", "ce")))
    go = m.stub("GoTo", after=[1, 2, 3], raises=["blocked", "blocked", None], sets=lambda found: {"done": True})
    m.expect().completed(within=6).has(done=True)
    assert (m.now, len(go.calls)) == (6.0, 3)
    m.expect().passed("b", times=2)


def test_a_stub_sets_variables_where_its_behaviour_would_and_a_list_anew(
    mission: MissionLoader, tmp_path: Path
) -> None:
    """In a multi-instance activity, variables around it are seen and set."""
    loop = (
        '<startEvent id="s"/><scriptTask id="t"><script>done, size = 0, 2</script></scriptTask>'
        '<subProcess id="m"><multiInstanceLoopCharacteristics isSequential="true"><loopCardinality>2</loopCardinality>'
        '</multiInstanceLoopCharacteristics><startEvent id="a"/><callActivity id="c" calledElement="GoTo"/>'
        f'<scriptTask id="u"><script>found.append(done)</script></scriptTask>{flows("ac", "cu")}</subProcess>'
        '<endEvent id="e"/>'
    )
    m = mission.load(one(tmp_path, loop + flows("st", "tm", "me")))
    m.stub("GoTo", sets=[{"done": 2, "found": (empty := list[int]())}, {"done": 4, "found": empty}])
    m.expect().completed().has(done=4)
    assert empty == []
    again = mission.load(one(tmp_path, (loop + flows("st", "tm", "me")).replace("found.append(done)", "pass")))
    go = again.stub("GoTo", sets=lambda now: {"done": now["done"] + now["size"]})
    again.expect().completed().has(done=4)
    assert len(go.calls) == 2


def test_a_behaviour_of_the_library_may_be_named_that_nothing_calls(vehicles: MissionUnderTest) -> None:
    assert vehicles.stub("Sweep").calls == []
    with pytest.raises(
        ConfigError, match=r"stub: no behaviour 'Gooto' is called or in the library; did you mean 'GoTo'"
    ):
        vehicles.stub("Gooto")
    with pytest.raises(ConfigError, match="stub: after: expected seconds from 0 on, got -1"):
        vehicles.stub("GoTo", after=-1)
    vehicles.advance(0)
    with pytest.raises(ConfigError, match="expected before the mission begins"):
        vehicles.stub("GoTo")


# ---- fakes -----------------------------------------------------------------------------------------------------------

LISTEN = """<startEvent id="s"/><scriptTask id="t"><script>
seen = []
for number in range(3):
    message = await receive("range", "sensor_msgs/msg/Range")
    seen.append((round(message.range, 3), round(now() , 3)))
</script></scriptTask><endEvent id="e"/>""" + flows("st", "te")
RANGE = "sensor_msgs/msg/Range"


def test_a_fake_topic_and_a_signal_are_named_as_in_the_diagram(mission: MissionLoader, tmp_path: Path) -> None:
    text = 'both = [(await receive("/All_done", "std_msgs/msg/Int32")).data for _ in "ab"]'
    task = f'<scriptTask id="t"><script>{text}</script></scriptTask>'
    m = mission.load(one(tmp_path, f'<startEvent id="s"/>{task}<endEvent id="e"/>' + flows("st", "te")))
    m.fake_topic("All done", "std_msgs/msg/Int32", series={1: 7})
    m.advance(2).signal("All done!", data=8)
    m.expect().completed().has(both=[7, 8])


@pytest.mark.parametrize("way", ["values", "series", "csv"])
def test_a_fake_topic_says_its_values_at_their_times(mission: MissionLoader, tmp_path: Path, way: str) -> None:
    table = tmp_path / "range.csv"
    table.write_text("stamp,range\n0,1.5\n2,1.25\n4,1.0\n")
    m = mission.load(one(tmp_path, LISTEN.replace("now()", "robot.now")))
    said = {
        "values": {"values": [{"range": 1.5}, {"range": 1.25}, {"range": 1.0}], "every": 2},
        "series": {"series": {0: {"range": 1.5}, 2: {"range": 1.25}, 4: {"range": 1.0}}},
        "csv": {"csv": table},
    }[way]
    m.fake_topic("/P/range", RANGE, **said)
    m.expect().completed(within=10).has(seen=[(1.5, 0.0), (1.25, 2.0), (1.0, 4.0)])


def test_a_fake_topic_says_a_value_once(mission: MissionLoader, tmp_path: Path) -> None:
    m = mission.load(one(tmp_path, LISTEN.replace("now()", "robot.now")))
    m.fake_topic("/P/range", RANGE, values=[{"range": 1.5}, {"range": 1.25}])
    with pytest.raises(AssertionError):
        m.expect().completed(within=10)  # it waits for a third one


@pytest.mark.parametrize("name", ["bag", "bag/bag.mcap"])
def test_a_fake_topic_says_what_a_bag_of_ros_has_from_its_first_message_on(
    mission: MissionLoader, tmp_path: Path, name: str
) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer

    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connection = bag.add_connection("/P/range", RANGE, typestore=codec.typestore(RANGE))
        for second, value in ((100, 1.5), (102, 1.25), (104, 1.0)):
            said = codec.serialize(messages.create(RANGE, {"range": value}))
            bag.write(connection, second * 10**9, said)
    m = mission.load(one(tmp_path, LISTEN.replace("now()", "robot.now")))
    m.fake_topic("/P/range", bag=tmp_path / name)
    m.expect().completed(within=10).has(seen=[(1.5, 0.0), (1.25, 2.0), (1.0, 4.0)])
    other = mission.load(one(tmp_path, LISTEN.replace("now()", "robot.now")))
    other.fake_topic("/P/near", RANGE, bag=tmp_path / name)
    with pytest.raises(ConfigError, match="has no topic /P/near; it has /P/range"):
        other.advance(1)


def test_a_fake_topic_says_what_a_recording_of_fame_has_at_its_times(
    mission: MissionLoader, vehicles: MissionUnderTest
) -> None:
    vehicles.stub("Explore", after=40, signals={"target_found": {"x": 5.5, "y": 0.6}})
    vehicles.stub("GoTo", after=1)
    vehicles.expect("DINGO").completed(within=100)
    recording = next(line.removeprefix("saved: ") for line in vehicles.save() if line.endswith(".mcap"))
    m = mission.load(VEHICLES)
    m.stub("Explore", after=400)
    go = m.stub("GoTo", after=1)
    m.fake_topic("/target_found", bag=recording)
    m.expect("DINGO").completed(within=100).passed("target_found").within(40)
    assert (go.calls[0].variables["x_goal"], m.now) == (5.5, 41)
    other = mission.load(VEHICLES)
    other.fake_topic("/target_found", "std_msgs/msg/String", bag=recording)
    with pytest.raises(MessageError, match="is in use with geometry_msgs/msg/Vector3"):
        other.advance(1)
    broken = mission.load(VEHICLES)
    broken.fake_topic("/target_found", bag=VEHICLES)
    with pytest.raises(ConfigError, match=r"ground_vehicles.bpmn: is not a readable bag"):
        broken.advance(1)


def test_a_fake_of_the_wrong_type_is_refused_with_the_field(mission: MissionLoader, tmp_path: Path) -> None:
    m = mission.load(one(tmp_path, LISTEN.replace("now()", "robot.now")))
    m.fake_topic("/P/range", RANGE, values=[{"rnge": 1.5}])
    with pytest.raises(MessageError, match=r"sensor_msgs/msg/Range: .*rnge"):
        m.advance(1)


def test_a_fake_topic_of_another_type_than_the_mission_uses_is_refused(mission: MissionLoader, tmp_path: Path) -> None:
    m = mission.load(one(tmp_path, LISTEN.replace("now()", "robot.now")))
    m.fake_topic("/P/range", "std_msgs/msg/String", values=["far"])
    with pytest.raises(MessageError, match="topic /P/range is in use with sensor_msgs/msg/Range"):
        m.advance(1)
    other = mission.load(one(tmp_path, LISTEN.replace("now()", "robot.now")))
    other.fake_topic("/P/rang")
    with pytest.raises(ConfigError, match="no process uses the topic /P/rang; did you mean '/P/range'"):
        other.advance(1)


def test_a_table_without_stamps_is_refused_with_its_line(mission: MissionLoader, tmp_path: Path) -> None:
    table = tmp_path / "range.csv"
    m = mission.load(one(tmp_path, LISTEN.replace("now()", "robot.now")))
    table.write_text("time,range\n0,1\n")
    with pytest.raises(ConfigError, match=r"range.csv:1: expected a column stamp \(s\), got the columns time, range"):
        m.fake_topic("/P/range", RANGE, csv=table)
    table.write_text("stamp,range\nsoon,1\n")
    with pytest.raises(ConfigError, match=r"range.csv:2: stamp: "):
        m.fake_topic("/P/range", RANGE, csv=table)


ASK = '<startEvent id="s"/><serviceTask id="t" camunda:resultVariable="answer">{}</serviceTask><endEvent id="e"/>'


def test_a_fake_service_answers_after_its_time(mission: MissionLoader, tmp_path: Path) -> None:
    said = properties(service="/enable", type="std_srvs/srv/SetBool", payload="{data: true}")
    m = mission.load(one(tmp_path, ASK.format(said) + flows("st", "te")))
    enable = m.fake_service(
        "/enable", "std_srvs/srv/SetBool", response=lambda asked: {"success": asked.data}, after=1.5
    )
    m.expect().completed(within=5)
    assert (m.variables()["answer"].success, m.now, len(enable.requests)) == (True, 1.5, 1)
    with pytest.raises(MessageError, match="sucess"):
        m.fake_service("/enable", "std_srvs/srv/SetBool", response={"sucess": True})


def test_a_fake_service_or_action_of_the_wrong_type_is_refused(mission: MissionLoader, tmp_path: Path) -> None:
    said = properties(service="/enable", type="std_srvs/srv/SetBool", payload="{data: true}")
    m = mission.load(one(tmp_path, ASK.format(said) + flows("st", "te")))
    m.fake_service("/enable", "std_srvs/srv/Trigger")
    with pytest.raises(ConfigError, match=r"'/enable'\): P calls it as std_srvs/srv/SetBool, got std_srvs/srv/Trigger"):
        m.advance(1)
    with pytest.raises(MessageError, match=r"std_srvs/srv/Triger: .*did you mean std_srvs/srv/Trigger"):
        m.fake_service("/disable", "std_srvs/srv/Triger")
    with pytest.raises(MessageError, match=rf"{DRIVE}_Result: .*drivn"):
        m.fake_action("/drive", DRIVE, result={"drivn": 3})
    with pytest.raises(MessageError, match=rf"{DRIVE}_Feedback: .*left"):
        m.fake_action("/drive", DRIVE, feedback=[{"left": 3}])


@pytest.mark.parametrize(("fail", "code"), [(False, None), (True, "aborted"), ("rejected", "rejected")])
def test_a_fake_action_gives_feedback_and_a_result(
    mission: MissionLoader, tmp_path: Path, fail: bool | str, code: str | None
) -> None:
    said = properties(service="/drive", type=DRIVE, payload="{distance: 3}", feedback="so_far")
    m = mission.load(one(tmp_path, ASK.format(said) + flows("st", "te")))
    drive = m.fake_action(
        "/drive", DRIVE, after=4, feedback=[{"remaining": 2}, {"remaining": 1}], result={"driven": 3}, fail=fail
    )
    if code is not None:
        m.expect().failed(code, within=10)
        return
    m.advance(2)
    assert m.variables()["so_far"].remaining == 2
    m.expect().completed(within=10)
    assert (m.variables()["answer"].driven, m.now) == (3.0, 4.0)
    assert [goal.distance for goal in drive.goals] == [3.0]


# ---- the plugin ------------------------------------------------------------------------------------------------------


def test_the_report_of_a_failed_test_has_the_state_of_its_missions(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        f"""
        def test_it(mission):
            m = mission.load({str(VEHICLES)!r})
            m.stub("Explore", after=2)
            m.advance(5)
            assert m.now == 3
        """
    )
    result = pytester.runpytest_inprocess("-p", "fame.testing.plugin")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        ["*assert 5.0 == 3*", "*mission ground_vehicles.bpmn*", "at 5 s", '*REX  at "done"*', "saved: *run.mcap"]
    )


@pytest.mark.parametrize("full", [False, True])
def test_what_is_refused_is_shown_at_the_line_of_the_test(pytester: pytest.Pytester, full: bool) -> None:
    pytester.makepyfile(f"def test_it(mission):\n    mission.load({str(VEHICLES)!r}).stub('Explor')\n")
    result = pytester.runpytest_inprocess("-p", "fame.testing.plugin", *["--full-trace"] * full)
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*did you mean 'Explore'*"])
    assert ("fame/testing/mission.py" in result.stdout.str()) == full


def test_a_folder_shows_the_runs_of_tests_that_failed(pytester: pytest.Pytester) -> None:
    text = f"""
        import pytest

        @pytest.mark.parametrize("now", ["<script>", 0.5])
        def test_it(mission, now):
            m = mission.load({str(VEHICLES)!r})
            m.stub("Explore", after=2)
            mission.load({str(VEHICLES)!r})  # which does not run
            m.advance(0.5)
            assert m.now == now, "<script>"
        """
    pytester.makepyfile(text)
    folder = pytester.path / "report"
    result = pytester.runpytest_inprocess("-p", "fame.testing.plugin", "--fame-report", str(folder))
    result.assert_outcomes(failed=1, passed=1)
    result.stdout.fnmatch_lines(["*report/index.html"])
    page = (folder / "index.html").read_text()
    assert "<h1>1 failed, 1 passed</h1>" in page
    assert page.index("test_it[&lt;script&gt;]") < page.index("test_it[0.5]")
    assert "<script>" not in page
    links = re.findall('<a href="([^"#]+)#t=0.5">watch it</a>', page)
    assert len(links) == 1
    assert 'id="block/0.json"' in (folder / links[0]).read_text()
    assert {path.suffix for path in folder.iterdir()} == {".html", ".mcap"}
    assert len([*folder.iterdir()]) == 3


def test_stubs_and_fakes_that_a_mission_does_not_use_are_named(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        f"""
        def test_it(mission):
            m = mission.load({str(VEHICLES)!r})
            m.stub("Explore", after=2)
            m.stub("GoTo")
            m.person({{"Go To": {{}}}}, robot="DINGO")
            m.fake_service("/never", "std_srvs/srv/SetBool")
            m.fake_topic("/REX/alone", "std_msgs/msg/String", values=["nobody hears it"])
            m.fake_topic("/target_found", values=[{{"x": 1.0}}], every=0.5)
            m.fake_topic("/fire", "std_msgs/msg/Empty")
            m.advance(1)
            m.expect("DINGO").entered("Go To")
        """
    )
    result = pytester.runpytest_inprocess("-p", "fame.testing.plugin")
    result.assert_outcomes(passed=1)
    expected = ["fake_service('/never')", "fake_topic('/REX/alone')", "fake_topic('/fire')"]
    result.stdout.fnmatch_lines(["*stubs and fakes not used*", *(f"*::test_it: {text}" for text in expected)])
    result.stdout.no_fnmatch_line("*::test_it: [sp]*")


def test_a_mission_that_has_not_run_has_entered_nothing_by_no_merit(vehicles: MissionUnderTest) -> None:
    with pytest.raises(ConfigError, match="nothing has run yet: advance the mission before"):
        vehicles.expect("DINGO").never_entered("Go To")
    vehicles.advance(0).expect("DINGO").never_entered("Go To")


def test_a_model_is_found_beside_the_test(pytester: pytest.Pytester) -> None:
    folder = pytester.mkdir("missions")
    one(folder, '<startEvent id="s"/>')
    (folder / "test_it.py").write_text("def test_it(mission):\n    mission.load('mission.bpmn').expect().completed()\n")
    pytester.runpytest_inprocess("-p", "fame.testing.plugin", str(folder)).assert_outcomes(passed=1)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ([(-1, {"x": 1.0})], "expected times from 0 s on, got -1"),
        ({float("nan"): {"x": 1.0}}, "expected times from 0 s on, got nan"),
        ({"soon": {"x": 1.0}}, "expected times from 0 s on, got 'soon'"),
        ([1, 2], "expected (seconds, message) pairs, got [1, 2]"),
    ],
)
def test_a_series_has_times_from_the_start_on(vehicles: MissionUnderTest, given: object, text: str) -> None:
    with pytest.raises(ConfigError) as error:
        vehicles.fake_topic("/target_found", series=given)
    assert text in str(error.value)


def test_a_network_that_is_none_is_refused(mission: MissionLoader) -> None:
    with pytest.raises(ConfigError, match=r"network: expected a .*NetworkConfig, got 0"):
        mission.load(VEHICLES, network=0.1)


def test_expectations_of_a_passage_and_of_its_robot_follow_each_other(vehicles: MissionUnderTest) -> None:
    vehicles.run_until("DINGO", at="Go To")
    vehicles.expect("DINGO").entered("Go To").never_entered("Fire").has(x_target=1.0).entered("Go To").within(2)


def test_a_person_without_a_robot_does_the_tasks_of_whoever_has_them(mission: MissionLoader, tmp_path: Path) -> None:
    task = '<startEvent id="s{0}"/><userTask id="{1}"/><sequenceFlow id="f{0}" sourceRef="s{0}" targetRef="{1}"/>'
    pools = "".join(f'<participant id="N{n}" name="R{n}" processRef="Q{n}"/>' for n in (1, 2))
    processes = "".join(
        f'<process id="Q{n}" isExecutable="true">{task.format(n, name)}</process>'
        for n, name in ((1, "sign"), (2, "load"))
    )
    path = tmp_path / "two.bpmn"
    path.write_text(document(f'<collaboration id="C">{pools}</collaboration>{processes}'))
    m = mission.load(path)
    m.person({"sign": {"by": "Ada"}, "load": None}, after=2)
    m.advance(3)
    m.expect("R1").completed().has(by="Ada")
    m.expect("R2").completed()
    with pytest.raises(ConfigError, match="no robot has an element 'sing'; robots are R1, R2"):
        m.person({"sing": {}})
