"""Failures that nothing catches, and codes that nothing knows: an exploration proves nothing about them."""

from itertools import pairwise
from pathlib import Path

import pytest
from bpmn_text import document, properties

from fame.bpmn.model import Expression
from fame.bpmn.reader import read_text
from fame.check.explore import deliveries, search
from fame.check.explore.graph import Explored
from fame.check.explore.properties import Judged
from fame.cli import main
from fame.properties.grammar import parse
from fame.properties.sentence import NOWHERE
from fame.scenario import Completion, Scenario
from fame.scenario.explore.exploration import explore
from fame.scripting.effects import effects_of
from fame.testing import MissionLoader
from fame.testing.explored_runs import play

GO = {"action": "navigate_to_pose", "type": "nav2_msgs/action/NavigateToPose"}
CALL = {"service": "door", "type": "std_srvs/srv/Trigger"}
ROOT = '<signal id="S" name="done"/><error id="Lost" errorCode="lost"/><error id="Any" errorCode="${why}"/>'
ASK = (
    '<userTask id="Ask" name="Ask"><extensionElements><camunda:formData><camunda:formField id="why" type="string"/>'
    "</camunda:formData></extensionElements></userTask>"
)


FAILS = parse("never P fails", NOWHERE, "never P fails")


def flow(first: str, second: str) -> str:
    return f'<sequenceFlow id="{first}_{second}" sourceRef="{first}" targetRef="{second}"/>'


def boundary(ref: str = "", at: str = "Go") -> str:
    """A boundary event of any code, or of an error at the root."""
    code = f'errorRef="{ref}"' if ref else ""
    return (
        f'<boundaryEvent id="At{ref}" attachedToRef="{at}"><errorEventDefinition id="D{ref}" {code}/></boundaryEvent>'
        f'<endEvent id="Gave{ref}" name="gave up {ref}"/>{flow(f"At{ref}", f"Gave{ref}")}'
    )


def goes(task: str, more: str = "", *, first: str = "", beside: str = "") -> str:
    """A process that does a task ``Go`` and throws /done, after `first` (a task ``Ask``); `beside` it: others."""
    begin = f"{first}{flow('Start', 'Ask')}{flow('Ask', 'Go')}" if first else flow("Start", "Go")
    return (
        f'<process id="P" isExecutable="true"><startEvent id="Start"/>{begin}{task}{flow("Go", "End")}'
        '<endEvent id="End" name="arrived"><signalEventDefinition id="Sd" signalRef="S"/></endEvent>'
        f"{more}</process>{beside}"
    )


def service(task: dict[str, str], **more: str) -> str:
    return f'<serviceTask id="Go" name="Go there">{properties(**task, **more)}</serviceTask>'


def script(text: str) -> str:
    return f'<scriptTask id="Go" name="Go there" scriptFormat="python"><script>{text}</script></scriptTask>'


CALLS = '<callActivity id="Go" name="Go there" calledElement="Inner"/>'


def called(inside: str) -> str:
    """The process that is called, with a task ``I2``."""
    return (
        f'<process id="Inner" isExecutable="true"><startEvent id="I1"/>{flow("I1", "I2")}{inside}{flow("I2", "I3")}'
        '<endEvent id="I3"/></process>'
    )


OTHERS = (
    '<process id="Q" isExecutable="true"><startEvent id="Q1"/><intermediateCatchEvent id="Q2">'
    f'<signalEventDefinition id="Qd" signalRef="S"/></intermediateCatchEvent><endEvent id="Q3"/>{flow("Q1", "Q2")}'
    f'{flow("Q2", "Q3")}</process><process id="R" isExecutable="true"><startEvent id="R1"/>'
    f'<manualTask id="R2" name="work"/><endEvent id="R3"/>{flow("R1", "R2")}{flow("R2", "R3")}</process>'
)
POOLS = "".join(f'<participant id="Pool_{name}" name="{name}" processRef="{name}"/>' for name in "PQR")


def judged(processes: str, sentence: str, *, team: bool = False, **options: object) -> Judged:
    """What an exploration says about a property of process P, or of a team with Q, which waits for /done, and R."""
    pools = POOLS if team else '<participant id="Pool_P" name="P" processRef="P"/>'
    text = document(f'{ROOT}<collaboration id="Team">{pools}</collaboration>{processes}{OTHERS if team else ""}')
    made = parse(sentence, NOWHERE, "p")
    (found,) = explore(read_text(text, file="m.bpmn"), properties=[made], **options).properties  # type: ignore[arg-type]
    return found


# ---- failures that nothing catches -----------------------------------------------------------------------------------


@pytest.mark.parametrize("faults", [False, True])
@pytest.mark.parametrize(
    ("sentence", "uncaught", "caught"),
    [
        ("never P fails", "not known", "proved"),
        ('P completes "arrived"', "not known", "refuted"),
        ("P completes", "not known", "proved"),
        ("Q completes", "not known", "refuted"),
        ('never P fails at "Go there"', "not known", "refuted"),
        ('P starts "Go there" at most 1 times', "proved", "proved"),
        ('never Q completes before P completes "arrived"', "proved", "proved"),
        ("R completes", "proved", "proved"),  # it hears nothing of P
        ("never R fails", "proved", "proved"),
        ("after P fails, R completes", "not known", "not triggered"),  # it may have before
    ],
)
def test_what_an_uncaught_failure_could_change_is_not_known(
    sentence: str, uncaught: str, caught: str, faults: bool
) -> None:
    found = judged(goes(service(GO)), sentence, team=True, faults=faults)
    assert found.verdict == uncaught, found
    assert ('"Go there" (Go) may fail, and nothing catches it' in found.text) == (uncaught == "not known")
    assert judged(goes(service(GO), boundary()), sentence, team=True, faults=faults).verdict == caught


@pytest.mark.parametrize("inside", [f'<serviceTask id="I2">{properties(**one)}</serviceTask>' for one in (GO, CALL)])
def test_a_behaviour_with_a_service_may_fail_too(inside: str) -> None:
    assert judged(goes(CALLS, beside=called(inside)), "P completes").verdict == "not known"
    assert judged(goes(CALLS, boundary(), beside=called(inside)), "P completes").verdict == "proved"


@pytest.mark.parametrize(("more", "verdict"), [({}, "proved"), ({"wait_cancelled": "5"}, "not known")])
def test_a_goal_that_waits_for_cancelled_ones_may_fail_by_that(more: dict[str, str], verdict: str) -> None:
    codes = ("service", "aborted", "rejected")
    errors = "".join(f'<error id="E{code}" errorCode="{code}"/>' for code in codes)
    caught = "".join(boundary(f"E{code}") for code in codes)
    assert judged(errors + goes(service(GO, **more), caught), "never P fails").verdict == verdict


WORK = '<serviceTask id="{}" name="Go there" {}/>'


@pytest.mark.parametrize("does", ['implementation="work"', 'camunda:type="external" camunda:topic="work"'])
def test_a_task_of_a_function_may_fail_too(does: str) -> None:
    uncaught = judged(goes(WORK.format("Go", does)), "never P fails")
    assert uncaught.verdict == "not known"
    assert uncaught.text.startswith('"Go there" (Go) may fail, and nothing catches it')
    assert judged(goes(WORK.format("Go", does), boundary()), "never P fails").verdict == "proved"
    inside = called(WORK.format("I2", does))
    assert judged(goes(CALLS, beside=inside), "P completes").verdict == "not known"
    assert judged(goes(CALLS, boundary(), beside=inside), "P completes").verdict == "proved"


def test_what_follows_from_a_failure_counts_against_the_limit() -> None:
    whole = explore(read_text(document(ROOT + goes(service(GO))), file="m.bpmn"), properties=[], delivery="run").states
    found = judged(goes(service(GO)), "never P fails", delivery="run", limit=whole)
    assert found.verdict == "not known"
    assert found.text.endswith("what follows is not explored whole (no budget is left)")


@pytest.mark.parametrize("faults", [False, True])
def test_all_searches_share_the_limit_and_all_their_states_are_told(
    faults: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    explored = list[Explored]()
    monkeypatch.setattr(deliveries, "explore", lambda product: explored.append(search.explore(product)) or explored[-1])
    model = read_text(document(ROOT + goes(service(GO))), file="m.bpmn")
    for limit in range(1, 25):
        explored.clear()
        result = explore(model, properties=[FAILS], faults=faults, limit=limit, samples=False)
        assert result.states == sum(len(one.states) for one in explored)
        assert faults or result.states <= limit + 1  # of faults one step leads to many


def test_its_exit_code_is_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "m.bpmn"
    (tmp_path / "m.properties.yaml").write_text("properties:\n  p: P completes\n", encoding="utf-8")
    for more, code in (("", 3), (boundary(), 0)):
        model.write_text(document(ROOT + goes(service(GO), more)), encoding="utf-8")
        assert main(["check", "--explore", str(model)]) == code
        assert main(["check", "--explore", "--faults", str(model)]) == code
        assert ("but it is not known whether p may be violated" in capsys.readouterr().out) == (code == 3)


# ---- scripts and behaviours that ask ---------------------------------------------------------------------------------

ACT = 'await robot.act("navigate_to_pose", "nav2_msgs/action/NavigateToPose")'
ASKS = 'await robot.call("door", "std_srvs/srv/Trigger")'


@pytest.mark.parametrize(
    ("text", "code", "uncaught", "caught"),
    [
        (ACT, "aborted", "not known", "refuted"),
        (ACT, "script", "proved", "proved"),
        (ACT, "still_running", "proved", "proved"),
        (f"{ACT[:-1]}, wait_cancelled=5)", "still_running", "not known", "refuted"),
        (ASKS, "script", "not known", "refuted"),
        (ASKS, "aborted", "proved", "proved"),
        (f"try:\n  {ACT}\nexcept BpmnError:\n  pass", "aborted", "proved", "proved"),
        (f"try:\n  {ASKS}\nexcept BpmnError:\n  pass", "script", "not known", "refuted"),
        (f"try:\n  pass\nexcept BpmnError:\n  {ACT}", "aborted", "not known", "refuted"),
        (f"{ACT}\nraise BpmnError('lost')", "lost", "refuted", "refuted"),
        ("await sleep(1)", "aborted", "proved", "proved"),
        ("await sleep(1)\nraise BpmnError(why)", "lost", "not known", "not known"),
        ("try:\n  raise BpmnError(why)\nexcept KeyError:\n  pass", "lost", "not known", "not known"),
    ],
)
def test_a_script_that_asks_may_fail_as_a_service_does(text: str, code: str, uncaught: str, caught: str) -> None:
    sentence = f'never P fails at "Go there" with "{code}"'
    assert judged(goes(script(text), first=ASK), sentence).verdict == uncaught
    assert judged(goes(script(text), boundary(), first=ASK), sentence).verdict == caught


def test_a_script_of_another_file_with_the_same_id_hides_no_failure(tmp_path: Path) -> None:
    inner = (
        f'<process id="Inner" isExecutable="true"><startEvent id="S1"/>{flow("S1", "Go")}{script("x = 1")}'
        f'{flow("Go", "T")}<endEvent id="T"><signalEventDefinition id="Td" signalRef="S"/></endEvent></process>'
    )
    (tmp_path / "inner.bpmn").write_text(document(ROOT + inner))
    outer = (
        f'<process id="P" isExecutable="true"><startEvent id="Start"/>{flow("Start", "Go")}{script(ACT)}'
        f'{flow("Go", "Call")}<callActivity id="Call" calledElement="Inner"/></process>'
    )
    text = document(f'{ROOT}<collaboration id="Team">{POOLS}</collaboration>{outer}{OTHERS}')
    model, made = read_text(text, file="m.bpmn"), parse("P completes", NOWHERE, "p")
    (found,) = explore(model, properties=[made], library=[tmp_path]).properties
    assert (found.verdict, found.text) == ("not known", '"Go there" (Go) may fail, and nothing catches it')


def test_its_error_event_can_be_entered() -> None:
    """It was said never to be."""
    for text in (ACT, ASKS):
        assert judged(goes(script(text), boundary()), 'never P completes "gave up"').verdict == "refuted"


def test_a_behaviour_whose_script_raises_may_fail() -> None:
    inner = called('<scriptTask id="I2" scriptFormat="python"><script>raise ValueError</script></scriptTask>')
    assert judged(goes(CALLS, beside=inner), "never P fails").verdict == "refuted"
    assert judged(goes(CALLS, boundary(), beside=inner), "never P fails").verdict == "proved"


def test_a_behaviour_whose_error_handler_raises_may_fail() -> None:
    """The error of an event sub-process starts outside of the scope that it handles; the boundary was never entered."""
    handler = (
        '<subProcess id="H" triggeredByEvent="true"><startEvent id="H1"><errorEventDefinition/></startEvent>'
        f'<endEvent id="H2"><errorEventDefinition errorRef="Lost"/></endEvent>{flow("H1", "H2")}</subProcess>'
    )
    throws = '<scriptTask id="I2" scriptFormat="python"><script>raise ValueError</script></scriptTask>'
    model = goes(CALLS, boundary("Lost"), beside=called(throws + handler))
    assert judged(model, 'never P completes "gave up Lost"').verdict == "refuted"


def inner(*leaves: str) -> str:
    """A process that calls ``Leaf`` once for each of these pieces, which are beside the calls; a leaf throws `lost`."""
    names = [f"L{number}" for number in range(len(leaves))]
    calls = "".join(f'<callActivity id="{name}" calledElement="Leaf"/>' for name in names)
    arrows = "".join(flow(a, b) for a, b in pairwise(["si", *names, "ei"]))
    ends = '<startEvent id="si"/><endEvent id="ei"/>'
    return (
        f'<process id="Inner" isExecutable="true">{ends}{calls}{"".join(leaves)}{arrows}</process>'
        '<process id="Leaf" isExecutable="true"><startEvent id="sl"/><endEvent id="el"><errorEventDefinition id="Dl" '
        f'errorRef="Lost"/></endEvent>{flow("sl", "el")}</process>'
    )


def test_what_one_call_of_a_behaviour_catches_another_call_of_it_raises() -> None:
    caught = (
        '<boundaryEvent id="AtL0" attachedToRef="L0"><errorEventDefinition id="DL0" errorRef="Lost"/></boundaryEvent>'
        f"{flow('AtL0', 'L1')}"
    )
    model = goes(CALLS, boundary("Lost"), beside=inner(caught, ""))
    assert judged(model, 'never P completes "gave up Lost"').verdict == "refuted"


@pytest.mark.parametrize("errors", ["{rejected: 'nav-busy'}", "{'rejected': nav-busy}", "rejected: nav-busy"])
def test_codes_of_outcomes_are_read_as_the_robot_reads_them(errors: str) -> None:
    drive = service(GO, errors=errors).replace('id="Go"', 'id="Drive"')
    inside = f'<subProcess id="Go"><startEvent id="si"/>{drive}{flow("si", "Drive")}</subProcess>'
    model = f'<error id="Busy" errorCode="nav-busy"/>{goes(inside, boundary("Busy"))}'
    assert judged(model, 'never P completes "gave up Busy"').verdict == "refuted"


def test_an_escalation_leaves_a_behaviour() -> None:
    late = '<escalation id="Late" escalationCode="late"/>'
    at_call = (
        '<boundaryEvent id="At" attachedToRef="Go" cancelActivity="false"><escalationEventDefinition id="D" '
        f'escalationRef="Late"/></boundaryEvent><endEvent id="Gave" name="gave up"/>{flow("At", "Gave")}'
    )
    late_at_end = (
        '<process id="Inner" isExecutable="true"><startEvent id="si"/><endEvent id="ei"><escalationEventDefinition '
        f'id="De" escalationRef="Late"/></endEvent>{flow("si", "ei")}</process>'
    )
    assert (
        judged(f"{late}{goes(CALLS, at_call, beside=late_at_end)}", 'never P completes "gave up"').verdict == "refuted"
    )


def test_a_script_in_javascript_that_throws_may_fail() -> None:
    """It was called invalid Python."""
    throws = script("throw new Error('low'); next();").replace("python", "javascript")
    assert judged(goes(throws), "never P fails").verdict == "refuted"


@pytest.mark.parametrize(
    ("text", "fails"),
    [
        ("next(error);", True),
        ("this.next(new Error('low'));", True),
        ("next(`${low}`);", True),
        ("const done = next; done(1);", True),
        ("client.sendRequest({}, next);", True),
        ("setTimeout(next, 100, 'late');", True),
        ("next();", False),
        ("next(null, 1);", False),
        ("// next(error)\nthis.next( undefined );", False),
        ("setTimeout(next, 100);", False),
    ],
)
def test_a_script_in_javascript_may_fail_by_its_callback(text: str, fails: bool) -> None:
    """It was said never to."""
    expression = Expression(text, "javascript")
    assert effects_of(expression, script=True).fails == fails
    if fails:
        assert judged(goes(script(text).replace("python", "javascript")), "never P fails").verdict == "refuted"


@pytest.mark.parametrize("text", [ACT, ASKS, "await sleep(1); raise BpmnError(x)"])
def test_a_behaviour_whose_script_may_fail_is_no_proof(text: str) -> None:
    inner = called(f'<scriptTask id="I2" scriptFormat="python"><script>{text}</script></scriptTask>')
    assert judged(goes(CALLS, beside=inner), "P completes").verdict == "not known"
    assert judged(goes(CALLS, boundary(), beside=inner), "P completes").verdict == "proved"
    assert judged(goes(CALLS, boundary(), beside=inner), 'P completes "arrived"').verdict == "refuted"


# ---- codes that only a property names --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("task", "code", "verdict"),
    [
        (service(GO), "aborted", "refuted"),
        (service(GO), "rejected", "refuted"),
        (service(GO), "nonsense", "proved"),
        (service(GO, errors="aborted: nav.lost"), "nav.lost", "refuted"),
        (service(GO, errors="aborted: nav.lost"), "aborted", "proved"),
        (service(CALL), "service", "refuted"),
        (service(CALL), "aborted", "proved"),  # only actions are
        (CALLS, "lost", "refuted"),
    ],
)
def test_a_code_that_a_property_names_is_tried(task: str, code: str, verdict: str) -> None:
    """At an activity whose failure with any code is caught; if it is not, nothing is proved about it."""
    sentence = f'never P fails at "Go there" with "{code}"'
    raises = "<script>await sleep(1); raise BpmnError(x)</script>"
    inner = called(f'<scriptTask id="I2" scriptFormat="python">{raises}</scriptTask>')
    assert judged(goes(task, boundary(), beside=inner), sentence).verdict == verdict
    assert judged(goes(task, beside=inner), sentence).verdict == ("not known" if verdict == "refuted" else verdict)


# ---- codes that are not known ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("raises", "code", "verdict"),
    [
        ("raise BpmnError(why)", "lost", "refuted"),
        ("raise BpmnError('nav_%s' % why)", "nav_lost", "refuted"),
        ("raise BpmnError('blocked', why)", "lost", "proved"),
    ],
)
def test_an_unknown_code_is_any(raises: str, code: str, verdict: str) -> None:
    sentence = f'never P fails at "Go there" with "{code}"'
    assert judged(goes(script(raises), boundary(), first=ASK), sentence).verdict == verdict
    assert judged(goes(script(raises), first=ASK), sentence).verdict == verdict


def test_an_unknown_code_comes_to_the_event_of_each_code() -> None:
    scope = (
        f'<subProcess id="Go" name="Go there"><startEvent id="S1"/>{flow("S1", "S2")}<endEvent id="S2" name="fails">'
        '<errorEventDefinition id="Sx" errorRef="Any"/></endEvent></subProcess>'
    )
    for task in (script("raise BpmnError(why)"), script("raise BpmnError(f'{why}')"), scope):
        more = boundary("Lost") + boundary()
        text = goes(task, more, first=ASK)
        for one in ("gave up ", "gave up Lost"):
            assert judged(text, f'never P completes "{one.strip()}"').verdict == "refuted"
    assert judged(goes(scope, boundary(), first=ASK), 'never P fails at "fails" with "lost"').verdict == "refuted"


def test_a_run_may_raise_it_and_the_found_run_is_played(tmp_path: Path, mission: MissionLoader) -> None:
    model = tmp_path / "m.bpmn"
    model.write_text(document(ROOT + goes(script("raise BpmnError(why)"), boundary(), first=ASK)), encoding="utf-8")
    sentence = 'never P fails at "Go there" with "lost"'
    (tmp_path / "m.properties.yaml").write_text(f"properties: {{p: '{sentence}'}}\n", encoding="utf-8")
    done = Completion("P", 1.0, "Ask", {"why": "lost"})
    assert [one.verdict for one in Scenario.load(model, completions=[done]).run().judgements] == ["violated"]
    (found,) = explore(model).properties
    assert found.verdict == "refuted"
    played = play(mission.by_hand(model), found.run)
    played.expect_property("p").is_violated()


def test_a_script_whose_failure_is_caught_fails_by_hand_as_in_a_run(tmp_path: Path, mission: MissionLoader) -> None:
    model = tmp_path / "m.bpmn"
    model.write_text(document(ROOT + goes(script("1 / 0"), boundary())), encoding="utf-8")
    for m in (mission.load(model), mission.by_hand(model)):
        m.expect("P").completed(within=5)
        m.expect("P").passed("Gave")


# ---- scripts that may raise something --------------------------------------------------------------------------------

READING = (
    '<intermediateCatchEvent id="Odom"><extensionElements><camunda:properties><camunda:property name="type" '
    'value="std_msgs/msg/Float64MultiArray"/></camunda:properties></extensionElements>'
    '<signalEventDefinition id="Od" signalRef="X"/></intermediateCatchEvent>'
)


@pytest.mark.parametrize(
    ("text", "entered"),
    [
        ("y = x.data[5]", True),
        ("y = 1 / len(x.data)", True),
        ("await sleep(1)\ny = [][0]", True),
        ("def f():\n    return [][0]\nf()", True),
        ("y = open('/nowhere').read()", True),
        ("y = 2 * len(x.data)", False),
        ("await sleep(1)\nrobot.publish('led', 'std_msgs/msg/Bool', data=True)", False),
        ("try:\n    y = x.data[5]\nexcept Exception:\n    y = 0", False),
    ],
)
@pytest.mark.parametrize("guard", ["at it", "around it", "at a call", "around a call", "of another code"])
def test_what_a_script_may_raise_comes_to_an_error_event(text: str, entered: bool, guard: str) -> None:
    error = boundary("Lost") if guard == "of another code" else boundary()
    call = guard.endswith("a call")
    inner = CALLS if call else script(text)
    if guard.startswith("around"):
        inner = (
            f'<subProcess id="Go"><startEvent id="B1"/>{inner.replace("Go", "B2", 1)}{flow("B1", "B2")}</subProcess>'
        )
    slow = script("await sleep(1)").replace("Go", "I2")
    beside = called(f"{slow}{script(text).replace('Go', 'I4')}{flow('I2', 'I4')}") if call else ""
    sensed = goes(inner, error, first=READING.replace("Odom", "Ask"), beside=beside)
    found = judged(f'<signal id="X" name="x"/>{sensed}', f"never P starts Gave{'Lost' if 'code' in guard else ''}")
    surely = guard == "at a call"  # of which nobody looks inside
    assert found.verdict == ("refuted" if surely or (entered and "code" not in guard) else "proved"), found


def test_what_a_script_may_raise_is_no_finding_where_nothing_catches_it() -> None:
    other = f"{script('pass').replace('Go', 'Other')}{boundary(at='Other')}"
    beside = called(script("y = x.data[5]\nsignal('done')").replace("Go", "I2"))
    sensed = goes(CALLS, other, first=READING.replace("Odom", "Ask"), beside=beside)
    model = read_text(document(f'{ROOT}<signal id="X" name="x"/>{sensed}'), file="m.bpmn")
    assert not [one for one in explore(model).findings if one.kind == "error"]


@pytest.mark.parametrize("sentence", ["never P fails", "P completes", 'P starts "Go there" at most 1 times'])
@pytest.mark.parametrize("call", [False, True])
@pytest.mark.parametrize(
    ("text", "may_fail"),
    [
        ("y = x.data[5]", True),
        ("await sleep(1)\ny = [][0]", True),
        ("z = []\nz[0] = 1", True),
        ("y = x", False),
    ],
)
def test_what_a_script_may_raise_uncaught_proves_nothing_that_it_could_change(
    text: str, may_fail: bool, call: bool, sentence: str
) -> None:
    """Whether it is executed, and what it sets decides something, or not."""
    slow = script("await sleep(1)").replace("Go", "I2")
    beside = called(f"{slow}{script(text).replace('Go', 'I4')}{flow('I2', 'I4')}")
    sensed = goes(CALLS if call else script(text), first=READING.replace("Odom", "Ask"), beside=beside if call else "")
    found = judged(f'<signal id="X" name="x"/>{sensed}', sentence)
    assert found.verdict == ("not known" if may_fail and "at most" not in sentence else "proved"), found


# ---- events, and gateways --------------------------------------------------------------------------------------------


def around(*inside: str) -> str:
    """A sub-process ``Go`` with a start ``B0`` and elements ``B1``, ``B2`` ... in a row."""
    flows = "".join(flow(f"B{place}", f"B{place + 1}") for place in range(len(inside)))
    return f'<subProcess id="Go" name="Go there"><startEvent id="B0"/>{"".join(inside)}{flows}</subProcess>'


def throws(payload: str) -> str:
    """A throwing event ``B1`` whose payload is a number."""
    shown = properties(type="std_msgs/msg/Int32", payload=payload) + '<signalEventDefinition id="Td" signalRef="S"/>'
    return f'<intermediateThrowEvent id="B1">{shown}</intermediateThrowEvent>'


def waits(duration: str) -> str:
    """A timer event ``B1``."""
    timer = f'<timerEventDefinition id="Td"><timeDuration>{duration}</timeDuration></timerEventDefinition>'
    return f'<intermediateCatchEvent id="B1">{timer}</intermediateCatchEvent>'


SETS = '<scriptTask id="Ask" scriptFormat="python"><script>why = x = {}</script></scriptTask>'


@pytest.mark.parametrize("guard", ["", "around it", "of another code"])
@pytest.mark.parametrize(
    ("event", "first", "fails"),
    [
        (waits("PT${why}S"), SETS.format("2"), "no"),
        (waits("PT${why}S"), SETS.format("'soon'"), "surely"),
        (waits("PT${why}S"), ASK, "perhaps"),
        (throws("${why}"), SETS.format("2"), "no"),
        (throws("${why}"), SETS.format("2.5"), "surely"),
        (throws("{data: ${why}}"), SETS.format("'two'"), "surely"),
        (throws("=why"), SETS.format("[2]"), "surely"),
    ],
)
def test_an_event_that_cannot_be_evaluated_fails(event: str, first: str, fails: str, guard: str) -> None:
    error = {"": "", "around it": boundary(), "of another code": boundary("Lost")}[guard]
    model = goes(around(event), error, first=first)
    caught = judged(model, "never P starts Gave").verdict if guard == "around it" else ""
    assert caught == {"": "", "around it": "proved" if fails == "no" else "refuted"}.get(guard, caught)
    uncaught = judged(model, "never P fails").verdict
    if guard == "around it" or (fails == "no" and "timer" in event):
        assert uncaught == "proved"
    else:  # what a payload holds that decides nothing is forgotten
        assert uncaught == ("refuted" if fails == "surely" and "timer" in event else "not known")


COVER = ("x > 0", "x &lt;= 0"), ("x == True", "x == False"), ("=x = 1", "=x != 1"), ("${x > 0}", "${x &lt;= 0}")


@pytest.mark.parametrize("conditions", COVER)
@pytest.mark.parametrize("guard", [True, False])
def test_conditions_that_cover_all_numbers_leave_out_other_values(conditions: tuple[str, str], guard: bool) -> None:
    """Where nothing catches that none is true, one is taken to be true; but a text is not compared with a number."""
    flows = "".join(
        f'<sequenceFlow id="F{place}" sourceRef="B2" targetRef="E{place}"><conditionExpression>{text}'
        f'</conditionExpression></sequenceFlow><endEvent id="E{place}"/>'
        for place, text in enumerate(conditions)
    )
    asks = '<userTask id="B1"/>'
    inside = around(asks, f'<exclusiveGateway id="B2"/>{flows}')
    model = goes(inside, boundary() if guard else "", first=SETS.format("1"))
    found = judged(model, "never P starts Gave" if guard else "never P fails")
    ordered = conditions[0] in ("x > 0", "${x > 0}")
    assert found.verdict == ("refuted" if guard else "not known" if ordered else "proved"), found


@pytest.mark.parametrize("condition", ["why.foo &lt; 1", "open(why)", "=why &lt; 1"])
def test_a_condition_that_is_not_executed_may_fail_where_that_is_caught(condition: str) -> None:
    language = "" if condition[0] == "=" else 'language="python"'
    flows = (
        f'<sequenceFlow id="F" sourceRef="B1" targetRef="E"><conditionExpression {language}>{condition}'
        f'</conditionExpression></sequenceFlow><endEvent id="E"/><endEvent id="D"/>{flow("B1", "D")}'
    )
    inside = around(f'<exclusiveGateway id="B1" default="B1_D"/>{flows}')
    found = judged(goes(inside, boundary(), first=SETS.format("1")), "never P starts Gave")
    assert found.verdict == ("refuted" if language else "proved"), found


@pytest.mark.parametrize(
    ("text", "verdict"),
    [
        ("signal('done')\nawait sleep(1)\nsignal('done')", "not known"),
        ("await sleep(1)\nfor i in range(3):\n    signal('done')", "not known"),
        ("signal('done')\nawait sleep(1)", "not known"),
        ("await sleep(1)\nrobot.publish('led', 'std_msgs/msg/Bool')\nsignal('done')", "proved"),
        ("while x:\n    robot.publish('led', 'std_msgs/msg/Bool')\n    await sleep(1)\nsignal('done')", "proved"),
    ],
)
def test_what_a_script_publishes_before_it_ends_is_no_proof(text: str, verdict: str) -> None:
    found = judged(goes(script(text)), "never Q fails", team=True)
    assert found.verdict == verdict, found


def test_a_script_that_waits_publishes_all_that_it_says() -> None:
    """In the order of its text."""
    twice = OTHERS.replace(flow("Q2", "Q3"), flow("Q2", "Q4") + flow("Q4", "Q3")).replace(
        '<endEvent id="Q3"/>',
        '<intermediateCatchEvent id="Q4"><signalEventDefinition id="Qe" signalRef="S"/></intermediateCatchEvent>'
        '<endEvent id="Q3"/>',
    )
    sends = goes(script("await sleep(1)\nsignal('done')\nsignal('done')")).replace('signalRef="S"', 'signalRef="Z"')
    pools = f'<signal id="Z" name="z"/><collaboration id="Team">{POOLS}</collaboration>'
    result = explore(read_text(document(f"{ROOT}{pools}{sends}{twice}"), file="m.bpmn"))
    assert not [str(one) for one in result.findings if one.level == "error"]


# ---- values that do not fit ------------------------------------------------------------------------------------------


def asks(kind: str = "long", *, required: bool = False) -> str:
    """A task whose form asks for ``n``."""
    rule = '<camunda:validation><camunda:constraint name="required"/></camunda:validation>' if required else ""
    return (
        '<userTask id="Ask"><extensionElements><camunda:formData>'
        f'<camunda:formField id="n" type="{kind}">{rule}</camunda:formField></camunda:formData></extensionElements>'
        "</userTask>"
    )


def activity(inside: str, tag: str = "task") -> str:
    return f'<{tag} id="Go" name="Go there">{inside}</{tag}>'


def split(condition: str) -> str:
    """A gateway with a condition, and a way out."""
    return (
        '<exclusiveGateway id="Go" name="Go there" default="Go_End"/><endEvent id="X"/><sequenceFlow id="F" '
        f'sourceRef="Go" targetRef="X"><conditionExpression>{condition}</conditionExpression></sequenceFlow>'
    )


def mapped(source: str) -> str:
    return (
        f'<extensionElements><camunda:inputOutput><camunda:inputParameter name="m">{source}</camunda:inputParameter>'
        "</camunda:inputOutput></extensionElements>"
    )


EACH = '<multiInstanceLoopCharacteristics camunda:collection="n"/>'
TIMES = "<multiInstanceLoopCharacteristics><loopCardinality>n</loopCardinality></multiInstanceLoopCharacteristics>"


def javascript(text: str) -> str:
    return script(text).replace("python", "javascript")


@pytest.mark.parametrize("sentence", ["P completes", "never P fails"])
@pytest.mark.parametrize(
    ("task", "optional", "required"),
    [
        (script("x = n"), "not known", "proved"),
        (script("x = n + 1"), "not known", "proved"),
        (script("x = n[0]"), "not known", "not known"),
        (script("k = 1; k = k + 2 * k; x = k &lt; 3"), "proved", "proved"),
        (script("way = [n.x]"), "not known", "not known"),
        (javascript("foo.bar(); next();"), "not known", "not known"),
        (
            javascript("const v = this.environment.variables; v.x = v.n > 3 ? 1 : v.n; next(null, v.x);"),
            *["proved"] * 2,
        ),
        (split("n > 3"), "not known", "proved"),
        (split("${n > 3}"), "not known", "proved"),
        (split("=n > 3"), "proved", "proved"),
        (activity(EACH), "not known", "not known"),
        (activity(TIMES), "not known", "not known"),
        (activity(mapped("${n.a}")), "not known", "not known"),
        (activity(mapped("${n}")), "not known", "proved"),
    ],
)
def test_a_value_that_may_not_fit_is_no_proof(task: str, optional: str, required: str, sentence: str) -> None:
    """Of scripts, only properties about failing were not known; of expressions, none."""
    for first, verdict in ((asks(), optional), (asks(required=True), required)):
        found = judged(goes(task.replace(" > ", " &gt; "), first=first), sentence)
        assert found.verdict == verdict, found
        assert verdict == "proved" or "(Go) may fail" in found.text or "Go may raise an error" in found.text


@pytest.mark.parametrize("inside", [EACH, TIMES, mapped("${n.a}")])
def test_a_value_that_may_not_fit_comes_to_an_error_event(inside: str) -> None:
    """It was said never to be entered."""
    assert judged(goes(activity(inside), boundary(), first=asks()), 'never P completes "gave up"').verdict == "refuted"


@pytest.mark.parametrize(("source", "verdict"), [("${n.a}", "not known"), ("1", "proved")])
def test_a_call_may_fail_by_its_mapping_alone(source: str, verdict: str) -> None:
    call = activity(mapped(source), "callActivity").replace("<callActivity", '<callActivity calledElement="Inner"', 1)
    model = goes(call, first=asks(), beside=called('<userTask id="I2"/>'))
    assert judged(model, "P completes").verdict == verdict


SCAN = '<signal id="T" name="~/scan"/>'
CATCH = '<intermediateCatchEvent id="Ask"><signalEventDefinition id="Dt" signalRef="T"/>{}</intermediateCatchEvent>'


@pytest.mark.parametrize(
    ("text", "verdict"),
    [
        ("x = 1 if scan.ranges else 2", "not known"),
        ("x = scan.ranges == [1]", "not known"),
        ("x = scan.range_max + 1", "proved"),
        ("x = len(scan.ranges)", "proved"),
    ],
)
def test_an_array_of_a_message_is_no_list(text: str, verdict: str) -> None:
    caught = CATCH.format(properties(type="sensor_msgs/msg/LaserScan"))
    for name in ("P completes", "never P fails"):
        assert judged(SCAN + goes(script(text), first=caught), name).verdict == verdict
