"""`fame check --explore --report`: a page for people who sign says what was checked, and what was not."""

import hashlib
import re
from html import unescape
from pathlib import Path

import pytest
from bpmn_text import process, properties
from fame_test_runs import fame_test

from fame.cli import main

CHOICE = f"""<startEvent id="s"/><scriptTask id="w" scriptFormat="python"><script>import random
left, aside = random.random() &lt; 0, random.random() &lt; 0</script></scriptTask>
<exclusiveGateway id="g" default="gb"/>
<task id="a" name="Left &amp; out">{properties(requirement="R1")}</task>
<task id="b" name="Right">{properties(requirement="R2", deadline="PT5S")}</task>
<task id="c" name="Aside">{properties(requirement="R3")}</task>
<sequenceFlow id="sw" sourceRef="s" targetRef="w"/><sequenceFlow id="wg" sourceRef="w" targetRef="g"/>
<sequenceFlow id="gb" sourceRef="g" targetRef="b"/>
<sequenceFlow id="ga" sourceRef="g" targetRef="a"><conditionExpression>left</conditionExpression></sequenceFlow>
<sequenceFlow id="gc" sourceRef="g" targetRef="c"><conditionExpression>aside</conditionExpression></sequenceFlow>"""
PROPERTIES = """\
properties:
  R4: P completes "Right" only after P starts
  R5: never P completes "Left & out"
"""
TESTS = """
import pytest

@pytest.mark.requirement("R5")
@pytest.mark.requirement("R6")
def test_right(mission):
    mission.load("choice.bpmn").advance(1)
"""


def rows(page: str, title: str) -> list[list[str]]:
    """The table of a section of the page, without its head."""
    table = page.partition(f"<h2>{title}</h2>")[2].partition("<h2>")[0]
    lines = [re.findall(r"<td[^>]*>(.*?)</td>", line) for line in re.findall(r"<tr>(.*?)</tr>", table)]
    return [[unescape(cell) for cell in line] for line in lines if line]


def test_the_page_says_what_was_checked_and_what_was_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "choice.bpmn").write_text(process(CHOICE))
    (tmp_path / "choice.properties.yaml").write_text(PROPERTIES)
    (tmp_path / "test_choice.py").write_text(TESTS)
    assert fame_test("--cov-json", "cov.json")[0] == 0
    words = ["check", "--explore", "--faults", "choice.bpmn", "--report", "out/safety.html", "--coverage", "cov.json"]
    assert main(words) == 1
    page = (tmp_path / "out" / "safety.html").read_text()
    digest = hashlib.sha256((tmp_path / "choice.bpmn").read_bytes()).hexdigest()
    assert ["choice.bpmn", digest] in rows(page, "Files and versions")
    assert "fame " + " ".join(words) in page
    verdicts = {name: verdict for name, _, verdict, _ in rows(page, "Properties")}
    assert verdicts == {"R4": "proved", "R5": "refuted", "deadline_b": "not known"}
    told = {id: (elements, tests.rpartition("::")[2], status) for id, elements, _, tests, status in
            rows(page, "Requirements")}  # fmt: skip
    assert told == {
        "R1": ('"Left & out" (a)', "", "not covered"),
        "R2": ('"Right" (b)', "test_right", "covered"),
        "R3": ('"Aside" (c)', "", "not covered"),
        "R5": ("", "test_right", "refuted"),
        "R6": ("", "test_right", "covered"),
    }
    assert rows(page, "Coverage by tests")[0][1] == "4 of 6"
    left = [what for what, _ in rows(page, "Not covered")]
    assert left[:3] == ["property deadline_b", "requirement R1", "requirement R3"]
    assert "single faults" not in left
    assert "<script" not in page


def test_what_was_not_looked_at_is_not_called_none(tmp_path: Path) -> None:
    (tmp_path / "choice.bpmn").write_text(process(CHOICE))
    page = tmp_path / "page.html"
    assert main(["check", "--explore", str(tmp_path / "choice.bpmn"), "--report", str(page)]) == 3
    assert rows(page.read_text(), "Single faults") == [["not explored", "", ""]]
    assert rows(page.read_text(), "Coverage by tests")[0][0] == "not given"


def test_a_report_does_not_replace_the_mission(tmp_path: Path) -> None:
    model = tmp_path / "choice.bpmn"
    model.write_text(process(CHOICE))
    assert main(["check", "--explore", str(model), "--report", str(model)]) == 2
    assert model.read_text() == process(CHOICE)


def test_a_test_that_fails_covers_no_requirement(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "choice.bpmn").write_text(process(CHOICE))
    lines = ["    import pytest", "    pytest.skip('not today')"]
    skipped = TESTS.replace("test_right", "test_later").replace("R5", "R7").replace("R6", "R8") + "\n".join(lines)
    (tmp_path / "test_choice.py").write_text(f"{TESTS}    assert False\n{skipped.replace('import pytest', '', 1)}\n")
    assert fame_test("--cov-json", "cov.json")[0] == 1
    assert main(["check", "--explore", "choice.bpmn", "--report", "page.html", "--coverage", "cov.json"]) == 3
    page = (tmp_path / "page.html").read_text()
    assert {id: status for id, *_, status in rows(page, "Requirements")} == dict.fromkeys(
        ("R1", "R2", "R3", "R5", "R6", "R7", "R8"), "not covered"
    )
    left = dict(rows(page, "Not covered"))
    assert left["requirement R6"] == "no property proves it, and a test of it has not passed"
    assert left["test test_choice.py::test_right"] == "it was failed"
    assert left["test test_choice.py::test_later"] == "it was skipped"


@pytest.mark.parametrize("change", ["version", "other"])
def test_coverage_of_another_model_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: str) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "choice.bpmn").write_text(process(CHOICE))
    (tmp_path / "test_choice.py").write_text(TESTS)
    assert fame_test("--cov-json", "cov.json")[0] == 0
    model = "choice.bpmn" if change == "version" else "new.bpmn"
    (tmp_path / model).write_text(process(CHOICE.replace("Right", "Onward")))
    main(["check", "--explore", model, "--report", "page.html", "--coverage", "cov.json"])
    left = dict(rows((tmp_path / "page.html").read_text(), "Not covered"))
    said = {
        "version": "the coverage is that of another version of this file",
        "other": "the coverage does not have this file",
    }
    assert left[f"by tests of {model}"] == said[change]


PROCESS = '{"file": "f", "name": "n", "elements": {}, "flows": {}, "tests": {}, "missing": [], "excused": {}}'


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[" * 100_000,
        "[]",
        '{"processes": []}',
        '{"processes": [], "requirements": {}}',
        '{"processes": [1], "requirements": {}, "not_passed": {}}',
        f'{{"processes": [{PROCESS}], "requirements": {{}}, "not_passed": {{}}}}',
        '{"processes": [], "requirements": {"R1": [1]}, "not_passed": {}}',
        '{"processes": [], "requirements": {}, "not_passed": {"R1": 1}}',
    ],
)
def test_a_wrong_coverage_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "choice.bpmn").write_text(process(CHOICE))
    (tmp_path / "cov.json").write_text(text)
    given = ["--report", str(tmp_path / "page.html"), "--coverage", str(tmp_path / "cov.json")]
    assert main(["check", "--explore", str(tmp_path / "choice.bpmn"), *given]) == 2
    assert main(["check", str(tmp_path / "choice.bpmn"), *given]) == 2
    assert not (tmp_path / "page.html").exists()
