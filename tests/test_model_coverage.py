"""Coverage of models by tests: what counts, the reports, the reasons, `fame test`."""

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
from bpmn_text import process
from fame_test_runs import fame_test as run_tests

from fame.cli import main
from fame.testing.coverage import Coverage, html_report, json_report, text_report
from fame.testing.mission import MissionLoader
from fame.text import percent

ROOT = Path(__file__).parent.parent
VEHICLES = ROOT / "models" / "ground_vehicles.bpmn"
CHOICE = """<startEvent id="s"/><exclusiveGateway id="g" default="gb"/><task id="a" name="Left"/><task id="b"/>
<sequenceFlow id="sg" sourceRef="s" targetRef="g"/><sequenceFlow id="gb" sourceRef="g" targetRef="b"/>
<sequenceFlow id="ga" sourceRef="g" targetRef="a"><conditionExpression>left</conditionExpression></sequenceFlow>"""


@pytest.fixture
def choice(tmp_path: Path) -> Path:
    """A model with two ways."""
    path = tmp_path / "choice.bpmn"
    path.write_text(process(CHOICE))
    return path


def covered(mission: MissionLoader, model: Path, *left: bool, **reasons: str) -> Coverage:
    """The coverage of one test for each way."""
    coverage = Coverage({model.name: reasons})
    for number, way in enumerate(left):
        loaded = mission.load(model)
        loaded.set(left=way).advance(1)
        coverage.add(loaded, f"test_{number}")
    return coverage


def test_elements_and_flows_count_per_process(mission: MissionLoader, choice: Path) -> None:
    coverage = covered(mission, choice, True)
    (found,) = coverage.processes()
    assert (found.counts(flows=False), found.counts(flows=True)) == ((3, 4), (2, 3))
    assert [element.id for element in found.missing()] == ["b", "gb"]
    assert round(coverage.percent(), 1) == 71.4
    lines = list(text_report(coverage))
    assert lines[1].split()[-4:] == ["3/4", "2/3", "71", "%"]
    assert lines[2].endswith(":3: P: b") or "not covered:" in lines[2]


def test_a_coverage_of_nearly_all_is_not_said_to_be_all(mission: MissionLoader, tmp_path: Path) -> None:
    row = "".join(
        f'<task id="t{n}"/><sequenceFlow id="f{n}" sourceRef="{f"t{n - 1}" if n else "a"}" targetRef="t{n}"/>'
        for n in range(300)
    )
    path = tmp_path / "long.bpmn"
    path.write_text(process(CHOICE + row))
    coverage = covered(mission, path, True)
    lines = list(text_report(coverage))
    assert (lines[1].split()[-4:], lines[-1]) == (["303/304", "302/303", "99", "%"], "total: 99.7 %")
    assert (percent(0.9999, 1), percent(1.0, 1), percent(0.0001), percent(0.0)) == ("99.9", "100.0", "1", "0")


def test_the_tests_of_an_element_are_known_and_another_process_adds_its_own(
    mission: MissionLoader, choice: Path
) -> None:
    coverage, other = covered(mission, choice, True), covered(mission, choice, False, True)
    coverage.merge(json.loads(json.dumps(other.to_plain())))
    (found,) = json_report(coverage)["processes"]
    assert json_report(coverage)["percent"] == 100
    assert found["tests"]["a"] == ["test_0", "test_1"]
    assert found["tests"]["b"] == ["test_0"]


def test_a_reason_excuses_an_element_and_a_stale_one_is_said(mission: MissionLoader, choice: Path) -> None:
    coverage = covered(mission, choice, True, b="nobody turns right", gb="the same", a="covered", z="unknown")
    assert coverage.percent() == 100
    lines = list(text_report(coverage))
    assert any(line.startswith("excused: ") and line.endswith("P: b: nobody turns right") for line in lines)
    assert "uncovered.yaml: choice.bpmn: a: tests cover it" in lines
    assert "uncovered.yaml: choice.bpmn: z: the model has no such element" in lines


def test_stubs_and_behaviours_of_fame_do_not_count(mission: MissionLoader) -> None:
    m = mission.load(VEHICLES)
    m.stub("GoTo")
    m.advance(1)
    coverage = Coverage()
    coverage.add(m, "test")
    assert [one.name for one in coverage.processes()] == ["REX", "DINGO"]


def test_the_page_has_the_diagram_coloured(mission: MissionLoader) -> None:
    m = mission.load(VEHICLES)
    m.stub("Explore", after=9)
    m.advance(1)
    coverage = Coverage()
    coverage.add(m, "test_it")
    page = html_report(coverage)
    assert "<svg" in page
    assert ">not covered</tspan>" in page
    assert '<tr class="covered"><td>&quot;Explore&quot; (Activity_Explore)</td><td>test_it</td></tr>' in page


def write_test(folder: Path, body: str, name: str = "test_choice.py") -> Path:
    path = folder / name
    path.write_text(f"def test_left(mission):\n    m = mission.load('choice.bpmn')\n    {body}\n")
    return path


def fame_test(*words: str | Path) -> int:
    return main(["test", *map(str, words)])


@pytest.mark.long
def test_fame_test_runs_tests_and_fails_under_a_coverage(
    choice: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_test(tmp_path, "m.set(left=True).expect().passed('Left')")
    assert fame_test(path) == 0
    assert "model coverage" not in capsys.readouterr().out
    reports = [tmp_path / "out" / name for name in ("cov.html", "cov.json", "cov.xml")]
    words = [f"--cov-{form}={report}" for form, report in zip(("html", "json", "junit"), reports, strict=True)]
    assert fame_test(path, "--cov-model", "--cov-fail-under", "80", *words) == 1
    assert "model coverage of 71.4 % is below 80 %" in capsys.readouterr().out
    assert json.loads(reports[1].read_text())["percent"] == 71.43
    suite = ElementTree.parse(reports[2]).getroot()[0]
    assert suite.attrib["failures"] == "2"
    assert fame_test(path, "--cov-model", "--cov-fail-under", "70") == 0
    (tmp_path / "uncovered.yaml").write_text("choice.bpmn:\n  b: nobody turns right\n  gb: as b\n")
    assert fame_test(path, "--cov-fail-under", "100") == 0


def test_fame_test_has_the_exit_codes_of_fame(choice: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_test(tmp_path, "m.set(left=False).expect().passed('Left')", "test_right.py")
    assert fame_test(path) == 1
    assert 'expected to have passed "Left" (a), but it was never entered' in capsys.readouterr().out
    assert fame_test(path, "-k", "straight") == 2
    assert fame_test(tmp_path / "nothing") == 2
    assert fame_test(path, "--cov-fail-under", "110") == 2
    assert "expected a number from 0 to 100, got '110'" in capsys.readouterr().err
    (tmp_path / "uncovered.yaml").write_text("choice.bpmn: [b]\n")
    assert fame_test(path, "--cov-model") == 2


MARKED = """
import pytest

kept = []

@pytest.mark.requirement("R1")
@pytest.mark.requirement({})
def test_left(mission):
    kept.append(mission.load("choice.bpmn"))
    kept[0].set(left=True).advance(1)

def test_the_mission_of_the_test_before_has_ended():
    assert not kept[0].begun
"""


@pytest.mark.parametrize(
    ("written", "ends"),
    [
        ('id="R2"', "2 passed"),
        ("", "expected the marker requirement(id), got requirement()"),
        ('ID="R2"', "expected the marker requirement(id), got requirement(ID='R2')"),
    ],
)
def test_a_marker_names_one_requirement_by_position_or_by_name(written: str, ends: str, choice: Path) -> None:
    (choice.parent / "test_marked.py").write_text(MARKED.format(written))
    _, output = run_tests("test_marked.py", "--cov-json=cov.json", folder=choice.parent)
    assert ends in output
    assert "2 passed" in output
    assert [*json.loads((choice.parent / "cov.json").read_text())["requirements"]] == (
        ["R2", "R1"] if ends == "2 passed" else []
    )


def test_coverage_is_collected_where_none_is_demanded(choice: Path, tmp_path: Path) -> None:
    write_test(tmp_path, "m.set(left=True).advance(1)", "test_none.py")
    assert "total: 71.4 %" in run_tests("test_none.py", "--cov-fail-under", "0", folder=tmp_path)[1]


def test_tests_that_load_no_model_cover_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "test_nothing.py"
    path.write_text("def test_nothing():\n    pass\n")
    assert fame_test(path, "--cov-model", "--cov-fail-under", "1") == 1
    assert "total: 0.0 %: no test has loaded a model" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("second", "code"), [("pytest.skip()", 3), ("pass", 0), ("pytest.xfail()", 0), ("assert False", 1)]
)
def test_tests_that_are_all_skipped_have_shown_nothing(
    second: str, code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"test_skipped_{code}_{len(second)}.py"
    skipped = "@pytest.mark.skip\ndef test_first():\n    pass\n"
    path.write_text(f"import pytest\n\n{skipped}\ndef test_second():\n    {second}\n")
    assert fame_test(path) == code
    assert ("no test has passed: all were skipped" in capsys.readouterr().err) == (code == 3)


def test_what_a_failed_test_covers_is_told(choice: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, report = write_test(tmp_path, "m.advance(1); assert False", "test_fails.py"), tmp_path / "cov.json"
    assert fame_test(path, "--cov-model", f"--cov-json={report}") == 1
    assert "covers, but has not passed: " in capsys.readouterr().out
    ((test, outcome),) = json.loads(report.read_text())["not_passed"].items()
    assert (test.rpartition("::")[2], outcome) == ("test_left", "failed")


@pytest.mark.processes
def test_the_workers_of_pytest_xdist_cover_together(
    choice: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_test(tmp_path, "m.set(left=True).expect().passed('Left')", "test_left.py")
    write_test(tmp_path, "m.set(left=False).expect().passed('b')", "test_right.py")
    report = tmp_path / "cov.json"
    words = ["--pytest=-n2", "--pytest=--dist=loadfile", f"--cov-json={report}", "--cov-fail-under", "100"]
    assert fame_test(tmp_path, "--cov-model", *words) == 0
    (found,) = json.loads(report.read_text())["processes"]
    assert {test.rpartition("/")[2] for tests in found["tests"].values() for test in tests} == {
        "test_left.py::test_left",
        "test_right.py::test_left",
    }
    assert "total: 100.0 %" in capsys.readouterr().out
