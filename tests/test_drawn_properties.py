"""Properties that are drawn, of all files of a mission and in each spelling: each is judged, or is named."""

from pathlib import Path

import pytest
from bpmn_text import document, properties

from fame.check import check
from fame.cli import main
from fame.errors import ConfigError, ModelError
from fame.scenario import Scenario

LATE = properties(deadline="PT1S")
FALSE = 'never A completes "Deliver"'


def wait(id: str, seconds: int, inside: str = "") -> str:
    timer = f'<timerEventDefinition id="t_{id}"><timeDuration>PT{seconds}S</timeDuration></timerEventDefinition>'
    return f'<intermediateCatchEvent id="{id}">{inside}{timer}</intermediateCatchEvent>'


def flows(*pairs: str) -> str:
    """Sequence flows, as in `"a b"`."""
    found = (pair.split() for pair in pairs)
    return "".join(
        f'<sequenceFlow id="f_{one}_{other}" sourceRef="{one}" targetRef="{other}"/>' for one, other in found
    )


def note(text: str, id: str = "N") -> str:
    return f'<textAnnotation id="{id}"><text>{text}</text></textAnnotation>'


def mission(inner: str, *, called: str = "", inside: str = "", pool: str = "") -> str:
    """A mission of robot A; `called` is a process `Drive` beside its own, `inside` and `pool` extensions."""
    collaboration = f'<collaboration id="C"><participant id="p" name="A" processRef="P">{pool}</participant>'
    other = f'<process id="Drive" isExecutable="true">{called}</process>' if called else ""
    own = f'<process id="P" isExecutable="true">{inside}{inner}</process>'
    return document(f"{collaboration}</collaboration>{own}{other}")


CALLS = '<startEvent id="S"/><callActivity id="X" name="Deliver" calledElement="Drive"/>' + flows("S X")
DRIVE = '<startEvent id="DS"/>' + wait("W", 5) + flows("DS W")


def judged(path: Path) -> dict[str, tuple[str, float | None]]:
    return {one.name: (one.verdict, one.time) for one in Scenario.load(path).run().judgements}


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return tmp_path / "m.bpmn"


@pytest.mark.parametrize("robot", ["Weed Robot", "R2/D2", "some", "say &quot;x&quot;"])
def test_a_deadline_counts_for_a_robot_with_any_name(model: Path, robot: str) -> None:
    named = mission('<startEvent id="S"/>' + wait("W", 2, LATE) + flows("S W")).replace('name="A"', f'name="{robot}"')
    model.write_text(named)
    assert judged(model) == {"deadline_W": ("violated", 1.0)}


@pytest.mark.parametrize("apart", [True, False])
def test_a_deadline_of_a_called_process_counts_for_each_call(
    model: Path, apart: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of the file that is called, or of its own."""
    twice = '<callActivity id="Y" calledElement="Drive">{}</callActivity>' + flows("X Y")
    again = (
        '<standardLoopCharacteristics loopMaximum="2"><loopCondition>True</loopCondition></standardLoopCharacteristics>'
    )
    called = LATE.replace("PT1S", "PT5S") + DRIVE
    model.write_text(mission(CALLS + twice.format(again), called="" if apart else called))
    (model.parent / "drive.bpmn").write_text(document(f'<process id="Drive" isExecutable="true">{called}</process>'))
    assert judged(model) == {"deadline_Drive": ("holds", None), "deadline_A_Drive": ("holds", None)}
    file = model.parent / "drive.bpmn" if apart else model
    file.write_text(file.read_text().replace("PT5S", "PT4S", 1))
    assert judged(model) == {"deadline_Drive": ("violated", 4.0), "deadline_A_Drive": ("violated", 9.0)}
    file.write_text(file.read_text().replace("PT4S", "soon", 1))
    assert main(["check", str(model)]) == 1
    assert f"{file}:2: error: Drive: expected a duration as deadline, as in PT5S, got 'soon'" in capsys.readouterr().out


def test_annotations_of_called_files_are_judged(model: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model.write_text(mission(CALLS))
    drive = model.parent / "drive.bpmn"
    said = note(f"property inner: {FALSE}")
    drive.write_text(document(f'<process id="Drive" isExecutable="true">{DRIVE}{said}</process>'))
    assert judged(model) == {"inner": ("violated", 5.0)}
    drive.write_text(drive.read_text().replace("never A", "never B"))
    assert main(["check", str(model)]) == 1
    assert f"{drive}:2: error: properties.inner: unknown robot or pool 'B'" in capsys.readouterr().out


@pytest.mark.parametrize(
    "text",
    ["property no-stop: {}", "Property stop: {}", "PROPERTY  stop :\n {}", "property stop:{}", "property no stop: {}"],
)
def test_a_property_is_read_in_each_spelling(model: Path, text: str) -> None:
    model.write_text(mission(CALLS + note(text.format(FALSE)), called=DRIVE))
    assert [*judged(model).values()] == [("violated", 5.0)]
    assert not [one for one in check(model) if "property" in one.text]


@pytest.mark.parametrize("text", ["property: {}", "properties a: {}", "property a, {}", "property of ACME: keep out"])
def test_an_annotation_that_is_not_read_is_named_if_it_seems_to_be_a_property(model: Path, text: str) -> None:
    model.write_text(mission(CALLS + note(text.format(FALSE)) + note("Deliver: a box", "M"), called=DRIVE))
    assert judged(model) == {}
    (found,) = (one for one in check(model) if "property" in one.text)
    assert (found.level, found.file, found.line) == ("warning", str(model), 2)
    assert found.text == "is not read as a property, and not judged: expected property NAME: SENTENCE"


def test_a_wrong_annotation_is_an_error_of_the_check(model: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model.write_text(mission(CALLS + note("property stop: nevr A completes"), called=DRIVE))
    assert main(["check", str(model)]) == 1
    assert "error: properties.stop: " in capsys.readouterr().out


@pytest.mark.parametrize("second", ["", '<process id="Other" isExecutable="false"><startEvent id="O"/></process>'])
def test_a_called_file_may_name_the_robots_of_missions_that_call_it(model: Path, second: str) -> None:
    said = note(f"property inner: {FALSE}")
    model.write_text(document(f'<process id="Drive" isExecutable="true">{LATE}{DRIVE}{said}</process>{second}'))
    assert main(["check", str(model)]) == 0
    model.write_text(document(f'<process id="Drive" isExecutable="true">{DRIVE}{said.replace("A", "Drive")}</process>'))
    assert main(["check", str(model)]) == 1  # alone it is the robot Drive, which has no element "Deliver"


def test_two_annotations_of_one_name_are_refused(model: Path) -> None:
    model.write_text(mission(CALLS + note(f"property a: {FALSE}") + note("property a: A completes", "M"), called=DRIVE))
    with pytest.raises(
        ConfigError, match=r"m.bpmn:2: properties.a: a second property of this name: the first one is at"
    ):
        Scenario.load(model)


ON_K = wait("B", 5, LATE).replace("intermediateCatchEvent", "boundaryEvent")
ON_K = ON_K.replace(' id="B"', ' id="B" attachedToRef="K"')
WAITS = '<startEvent id="S"/><eventBasedGateway id="G"/>{}{}<endEvent id="E"/>' + flows(
    "S G", "G T", "G U", "T E", "U E"
)


@pytest.mark.parametrize(
    ("first", "second", "verdict"), [(1, 3, "holds"), (2, 3, "violated"), (3, 1, "holds"), (3, 2, "violated")]
)
def test_a_deadline_of_an_event_counts_from_when_the_gateway_waits_for_it(
    model: Path, first: int, second: int, verdict: str
) -> None:
    model.write_text(mission(WAITS.format(wait("T", first, LATE), wait("U", second))))
    assert judged(model) == {"deadline_T": (verdict, 1.0 if verdict == "violated" else None)}


@pytest.mark.parametrize(
    ("inner", "name"),
    [
        (f'<startEvent id="S">{LATE}</startEvent>' + wait("T", 5) + flows("S T"), "S"),
        ('<startEvent id="S"/><task id="K"/>' + f'<endEvent id="E">{LATE}</endEvent>' + flows("S K", "K E"), "E"),
        ('<startEvent id="S"/><userTask id="K"/>' + flows("S K") + ON_K, "B"),
        (f'<startEvent id="S"/><exclusiveGateway id="G">{LATE}</exclusiveGateway>' + flows("S G"), "G"),
    ],
)
def test_a_deadline_where_nothing_waits_is_refused(
    model: Path, inner: str, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = f"{name}: a deadline says nothing here, as it is left in the instant in which it is entered; expected it at"
    model.write_text(mission(inner))
    with pytest.raises(ModelError, match=text):
        Scenario.load(model)
    assert main(["check", str(model)]) == 1
    assert f"m.bpmn:2: error: {text}" in capsys.readouterr().out


def test_a_deadline_of_a_pool_or_a_flow_is_refused(model: Path) -> None:
    model.write_text(mission('<startEvent id="S"/>', pool=LATE))
    with pytest.raises(ModelError, match=r"a deadline says nothing here, as this is a pool"):
        Scenario.load(model)
    flow = f'<sequenceFlow id="f" sourceRef="S" targetRef="T">{LATE}</sequenceFlow>'
    model.write_text(mission('<startEvent id="S"/>' + wait("T", 5) + flow))
    with pytest.raises(ModelError, match=r"f: a deadline says nothing here, as a token takes a flow at once"):
        Scenario.load(model)


def test_a_deadline_of_a_process_counts_from_its_start(model: Path) -> None:
    model.write_text(mission('<startEvent id="S"/>' + wait("T", 5) + flows("S T"), inside=LATE))
    assert judged(model) == {"deadline_P": ("violated", 1.0)}
