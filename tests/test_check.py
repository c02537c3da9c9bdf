"""What `fame check` says of a file, of several, and on the command line; nothing of the good models."""

import io
import re
from pathlib import Path

import pytest
from check_drawing import (
    BOOL,
    MODELS,
    ROOT,
    VECTOR,
    alone,
    catch,
    checked,
    row,
    script,
    team,
    throw,
    told,
)
from gallery import gallery
from test_check_concurrency import WARNINGS as OF_CALLS
from test_check_errors import ERRORS
from test_check_flow import WARNINGS as OF_FLOWS
from test_check_kinds import WARNINGS as OF_KINDS
from test_check_scripts import WARNINGS as OF_SCRIPTS
from test_check_signals import WARNINGS as OF_SIGNALS
from test_check_warnings import NOTES, WARNINGS

from fame.bpmn import read, read_text
from fame.bpmn.model import Definitions
from fame.bpmn.split import split
from fame.check import Finding, check, parts_of_one_mission, summary
from fame.check.scope import arranged
from fame.cli import main


@pytest.mark.parametrize("model", MODELS, ids=lambda file: file.stem)
def test_the_models_that_come_with_fame_have_no_error_and_no_warning(model: Path) -> None:
    assert [str(one) for one in check(read(model)) if one.level != "note"] == []


def test_a_file_with_everything_is_checked_to_its_end() -> None:
    found = check(read_text(gallery(), file="gallery.bpmn"))
    assert {one.level for one in found} == {"error", "warning", "note"}
    assert len(set(found)) == len(found)
    assert all(one.file == "gallery.bpmn" and "\n" not in str(one) for one in found)


def test_findings_come_in_the_order_of_the_file_and_once() -> None:
    first, second = Finding("note", "a", "m.bpmn", 2), Finding("error", "b", "m.bpmn", 2)
    third, other = Finding("error", "c", "m.bpmn", 7), Finding("error", "d", "lib.bpmn", 1)
    assert arranged([other, third, first, third, second], ["m.bpmn", "lib.bpmn"]) == [second, first, third, other]


def test_a_summary_counts_by_level() -> None:
    found = checked(alone(row(script("x = (1"), '<task id="a"/>', '<task id="b"/>')))
    assert summary(found) == "1 error, 2 notes"
    assert summary([]) == "No problems found."


def test_a_finding_is_one_line() -> None:
    assert str(Finding("warning", "no way out", "m.bpmn", 12, "g")) == "m.bpmn:12: warning: g: no way out"
    assert str(Finding("note", "no pool", "m.bpmn")) == "m.bpmn: note: no pool"
    assert str(Finding("note", "no pool")) == "note: no pool"


@pytest.mark.parametrize(
    "text",
    [
        text
        for table in (ERRORS, WARNINGS, NOTES, OF_CALLS, OF_FLOWS, OF_KINDS, OF_SCRIPTS, OF_SIGNALS)
        for _, text in table.values()
    ],
)
def test_the_documentation_shows_it(text: str) -> None:
    pages = [*ROOT.glob("docs/check*.md")]
    assert any(text.partition(": ")[2] in page.read_text("utf-8") for page in pages)


def parts(*contents: str) -> list[Definitions]:
    """The files of a split mission."""
    return [
        read_text(part.source.decode(), file=part.filename)
        for part in split(read_text(team(*contents), file="whole.bpmn"))
    ]


def told_of(files: list[Definitions]) -> list[str]:
    """What is found in files that are given together."""
    return [
        str(one) for mission in parts_of_one_mission(files) for file in mission for one in check(file, team=mission)
    ]


TALK = (row(throw("a", type=BOOL)), row(catch("b", type=BOOL), mark="2"))


def test_the_parts_of_a_mission_hear_each_other() -> None:
    rex, dingo = parts(*TALK)
    assert any("throws /done, but nothing in REX.bpmn catches it" in text for text in told_of([rex]))
    assert told_of([rex, dingo]) == []


def test_what_no_part_hears_is_a_note_since_others_may_not_have_been_given() -> None:
    found = told_of(parts(row(throw("a", type=BOOL)), row(catch("b", "found", type=BOOL), mark="2")))
    assert [text.partition(": ")[2] for text in found] == [
        'note: "done" (a): throws /done, but nothing in the 2 files of the mission catches it',
        'note: "found" (b): waits for /found, but nothing in the 2 files of the mission throws it',
    ]


def test_two_types_of_one_topic_in_two_parts_are_an_error_of_the_second() -> None:
    rex, dingo = parts(*TALK)
    edited = read_text(dingo.source.decode().replace(BOOL, VECTOR), file="DINGO.bpmn")
    (found,) = told_of([rex, edited])
    assert found.startswith("DINGO.bpmn:")
    text = f'topic /done has type {VECTOR} here, but "done" (a) says {BOOL}: a topic has one type'
    assert found.endswith(f'error: "done" (b): {text}')


def test_files_of_other_missions_and_other_splits_of_the_same_are_apart() -> None:
    rex, dingo = parts(*TALK)
    again, whole = parts(*TALK)[0], read_text(team(*TALK), file="whole.bpmn")
    other = read_text(rex.source.decode().replace('collaboration id="C"', 'collaboration id="D"'), file="other.bpmn")
    library = read_text(alone(row(script("x = 1"))), file="library.bpmn")
    found = parts_of_one_mission([rex, whole, other, again, library, dingo])
    assert [[file.file for file in mission] for mission in found] == [
        ["REX.bpmn", "DINGO.bpmn"], ["whole.bpmn"], ["other.bpmn"], ["REX.bpmn"], ["library.bpmn"],
    ]  # fmt: skip


def test_what_the_reader_notes_at_many_places_is_told_at_the_first() -> None:
    tasks = [
        script("pass", f"t{n}").replace("<scriptTask", '<scriptTask camunda:asyncBefore="true"') for n in (1, 2, 3)
    ]
    notes = told(alone(row(*tasks)), "note")
    assert notes == ["t1: camunda:asyncBefore has no effect, here and in 2 more places"]
    assert told(alone(row(tasks[0])), "note") == ["t1: camunda:asyncBefore has no effect"]


def test_a_model_comes_from_stdin(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    text = alone(row(script("x = (1")))
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
    assert main(["check", "-"]) == 1
    assert re.match(r"<stdin>:\d: error: t: not valid Python", capsys.readouterr().out)


NO_MODELS = {
    "notes.txt": (b"take milk", 1, "notes.txt:1: error: not well-formed XML: "),
    "empty.bpmn": (b"", 1, "empty.bpmn:1: error: not well-formed XML: "),
    "model.zip": (b"PK\x03\x04and so on", 1, "model.zip: error: is a zip archive: extract the .bpmn file from it"),
    "folder": (None, 2, "folder: expected files, got a folder: "),
    "gone.bpmn": (None, 2, "gone.bpmn: there is no such file"),
}


@pytest.mark.parametrize("name", NO_MODELS)
def test_what_is_no_model_is_told_in_one_line(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content, code, said = NO_MODELS[name]
    (tmp_path / "folder").mkdir()
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert main(["check", str(tmp_path / name)]) == code
    out, err = capsys.readouterr()
    assert said in (out if code == 1 else err)
    assert (out + err).count("\n") == (2 if code == 1 else 1)


@pytest.mark.long
def test_thousands_of_findings_are_all_told_and_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "many.bpmn"
    path.write_text(alone(row(*(f'<manualTask id="t{n}"/>' for n in range(2000)))))
    assert main(["check", "--guidelines", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert (len(lines), lines[-1]) == (2001, "2000 notes")
