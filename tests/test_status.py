"""`fame status` shows every robot of a team, and nothing that somebody else made up can look like a row of it."""

import json
from dataclasses import replace

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from deployment_field import TEAM, Field

from fame.cli.output import LiveTable, table
from fame.cli.robots import rows, silences
from fame.deploy import Report
from fame.deploy.envelope import read_report
from fame.text import printable
from fame.version import PROTOCOL

SAME = {"state": {"protocol": PROTOCOL}}


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain, also Grün 木", "plain, also Grün 木"),
        ("a\nREX  running", r"a\nREX  running"),
        ("\x1b[31mred\x1b[0m\r", r"\x1b[31mred\x1b[0m\r"),
        ("\u202egnp", r"\u202egnp"),
        ("\ud800", r"\ud800"),
    ],
)
def test_what_is_not_printable_is_shown_as_an_escape_once(text, shown):
    assert printable(text) == printable(printable(text)) == shown


def test_a_cell_cannot_make_a_row():
    assert table(("a", "b"), [("x\ny", "\x1b[2J")]).splitlines() == ["a     b", r"x\ny  \x1b[2J"]


def test_a_received_line_cannot_draw_on_the_terminal(capsys):
    import sys

    LiveTable(sys.stdout).write("REX\x1b[2J\nDINGO  running")
    assert capsys.readouterr().out == "REX\\x1b[2J\\nDINGO  running\n"


def test_a_report_with_every_field_at_its_limit_has_rows():
    waits = [{"element": "t", "for": "x", "since": -(2**52), "topics": {"/a": 3}}]
    said = {"robot": "REX", "state": "running", "instances": 2**52, "now": 1e300, "offers": ["a", "b\n"]}
    report = Report.from_json(json.dumps({**said, "waits": waits, "migration": SAME}))
    assert report is not None
    assert len(table(["head"] * 8, list(rows("REX", report))).splitlines()) == 3


def test_a_robot_that_holds_says_for_what_and_how_a_person_ends_that():
    report = Report(robot="REX", migration=SAME, state="holding", candidate="d1")
    ends = "a newer deployment or fame abort REX ends that"
    assert [row[6] for row in rows("REX", report)] == [f"its sender and the others for d1; {ends}"]


def test_a_robot_of_the_team_whose_engine_is_gone_is_reported_by_the_others_with_since_when():
    field = Field("A", "B")
    field.deploy(TEAM)
    field.engines["B"].close()
    field.pass_time(8.5)
    report = field.said[-1]
    assert (report.robot, list(report.absent)) == ("A", ["B"])
    assert 7 <= report.absent["B"] <= 8.5
    field.engines["A"].close()


def test_a_failed_instance_is_told_beside_the_tokens_of_those_that_run():
    report = Report(
        robot="A",
        migration=SAME,
        state="running",
        waits=[{"element": "t"}],
        started=3,
        failed=1,
        error="gripper broken",
    )
    assert [row[6] for row in rows("A", report)] == ["", "1 of 3 instances failed: gripper broken"]


@pytest.mark.parametrize("key", [None, Ed25519PrivateKey.generate()], ids=["plain", "signed"])
def test_a_robot_that_fails_with_a_long_text_is_still_heard(key):
    """Nobody accepts a report of more than a million characters."""
    text = "x" * 900_000
    report = Report(robot="REX", state="failed", error=text, errors=[{"code": "lost", "line": 3, "text": text}])
    heard = read_report(report.to_json(key))
    assert (heard.state, heard.error, heard.errors[0]["line"]) == ("failed", "x" * 997 + "...", 3)
    assert bool(heard.signature) == bool(key)
    assert read_report(replace(report, errors=[]).to_json(key)).error == text


def test_silent_are_those_who_are_missed_or_there_without_a_word():
    report = Report(robot="A", state="running", absent={"B": 9.0, "C": 4.0})
    reports = {"A": report, "C": replace(report, robot="C", absent={})}
    assert silences(reports, ["A", "C", "D"], 1.5) == {"B": 9.0, "D": 1.5}
