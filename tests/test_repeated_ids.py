"""Elements of two files of a mission with one id: no event says at which of them it was, so nothing is said of them."""

from pathlib import Path

import pytest
from bpmn_text import document, process

from fame.check import check
from fame.cli import main
from fame.errors import ConfigError
from fame.scenario import Scenario
from fame.testing import MissionLoader

MAIN = """<startEvent id="Start"/><sequenceFlow id="f1" sourceRef="Start" targetRef="Deliver"/>
<callActivity id="Deliver" calledElement="Drive"/><sequenceFlow id="f2" sourceRef="Deliver" targetRef="G"/>
<exclusiveGateway id="G" default="f4"/>
<sequenceFlow id="f3" sourceRef="G" targetRef="Task"><conditionExpression>False</conditionExpression></sequenceFlow>
<scriptTask id="Task" name="Lock door"><script>y = 1</script></scriptTask>
<sequenceFlow id="f5" sourceRef="Task" targetRef="Say"/><sequenceFlow id="f4" sourceRef="G" targetRef="End"/>
<endEvent id="End"/><endEvent id="Say"><signalEventDefinition id="d" signalRef="S"/></endEvent>"""
CALLED = """<startEvent id="Start"/><sequenceFlow id="f1" sourceRef="Start" targetRef="Task"/>
<scriptTask id="Task" name="Move"><script>z = 1</script></scriptTask>
<sequenceFlow id="f2" sourceRef="Task" targetRef="Say"/>
<endEvent id="Say">SAYS</endEvent>"""
SIGNAL = '<signal id="S" name="said"/>'
SAYS = '<signalEventDefinition id="d" signalRef="S"/>'


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A mission that calls a file, in which other elements have the ids `Task` and `Say`."""
    write(tmp_path, says="")
    return tmp_path / "main.bpmn"


def write(folder: Path, *, says: str) -> None:
    inner = CALLED.replace("SAYS", says)
    (folder / "drive.bpmn").write_text(document(f'{SIGNAL}<process id="Drive" isExecutable="true">{inner}</process>'))
    (folder / "main.bpmn").write_text(document(f'{SIGNAL}<process id="P" isExecutable="true">{MAIN}</process>'))


def wanted(model: Path, sentence: str) -> Path:
    path = model.with_name("main.properties.yaml")
    path.write_text(f"properties:\n  wanted: {sentence}\n")
    return path


@pytest.mark.parametrize(
    ("sentence", "column", "shown"),
    [
        ('P completes "Lock door"', 23, '"Lock door" (Task)'),
        ('P completes "Task"', 23, '"Lock door" (Task)'),
        ('never P fails at "Move"', 28, '"Lock door" (Task)'),
        ("P throws /said", 20, "Say"),
    ],
)
def test_a_property_that_names_one_of_them_is_refused(
    model: Path, sentence: str, column: int, shown: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = wanted(model, sentence)
    id = "Say" if shown == "Say" else "Task"
    text = f"elements of main.bpmn and drive.bpmn have the id {id!r}, and no event says which it was: rename one"
    assert main(["run", str(model)]) == 2
    assert f"{path}:2:{column}: properties.wanted: {shown}: {text}" in capsys.readouterr().err
    assert main(["check", str(model)]) == 1
    assert f"{path}:2:{column}: error: properties.wanted: {shown}: {text}" in capsys.readouterr().out
    assert main(["check", "--explore", str(model)]) == 2
    assert text in capsys.readouterr().err
    path.unlink()
    log = model.with_name("run.mcap")
    assert main(["run", str(model), "--quiet", "--log", str(log)]) == 0
    wanted(model, sentence)
    capsys.readouterr()
    assert main(["log", "judge", str(path), str(log)]) == 2
    assert text in capsys.readouterr().err


@pytest.mark.parametrize("sentence", ["P completes", 'P completes "G"'])
def test_other_elements_can_be_named(model: Path, sentence: str) -> None:
    wanted(model, sentence)
    assert [one.verdict for one in Scenario.load(model).run().judgements] == ["holds"]
    assert [finding for finding in check(model) if finding.level == "error"] == []


def test_a_topic_can_be_named_that_all_of_them_throw(model: Path) -> None:
    write(model.parent, says=SAYS)
    wanted(model, "P throws /said")
    (found,) = Scenario.load(model).run().judgements
    assert found.verdict == "holds"


def test_a_file_that_is_called_twice_repeats_no_id(tmp_path: Path) -> None:
    calls = "".join(f'<callActivity id="Call_{n}" calledElement="Drive"/>' for n in (1, 2))
    (tmp_path / "main.bpmn").write_text(process(calls))
    inner = '<scriptTask id="Task" name="Move"><script>z = 1</script></scriptTask>'
    (tmp_path / "drive.bpmn").write_text(document(f'<process id="Drive" isExecutable="true">{inner}</process>'))
    wanted(tmp_path / "main.bpmn", 'P completes "Move"')
    (found,) = Scenario.load(tmp_path / "main.bpmn").run().judgements
    assert found.verdict == "holds"


def test_a_test_that_expects_something_of_one_of_them_is_refused(model: Path, tmp_path: Path) -> None:
    mission = MissionLoader(lambda: tmp_path / "saved").load(model)
    mission.advance(1)
    with pytest.raises(ConfigError, match=r"'Lock door' has the id of \"Move\" \(Task\) in drive.bpmn: rename one"):
        mission.expect("P").passed("Lock door")
    with pytest.raises(ConfigError, match=r"'Task' is the id of \"Move\" \(Task\) in drive.bpmn: rename one of them"):
        mission.expect("P").passed("Task")  # only that of drive.bpmn did
    mission.expect("P").passed("G")
    mission.close()
