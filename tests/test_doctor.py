"""`fame doctor`: what is wrong with a machine or a team is told with its mend, and what was not seen is not fine."""

import json
import os
import signal
import subprocess
import sys
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path

import pytest
from domains import PROCESSES

from fame.cli import doctor, main
from fame.cli.doctor import Finding
from fame.deploy import Report
from fame.imports import fame_version
from fame.log.clocks import ClockAnswer

MESSAGE = "float64 x\n"
SECOND = 1_000_000_000


def verdicts(findings: Iterator[Finding]) -> list[str]:
    return [finding.verdict for finding in findings]


# ---- the machine -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("says", "verdict"), [("yes", "ok"), ("no", "wrong"), ("", "not known")])
def test_the_clock_is_as_timedatectl_says(
    says: str, verdict: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "timedatectl"
    program.write_text(f"#!{sys.executable}\nprint({says!r})\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert doctor.clock().verdict == verdict
    program.unlink()
    assert doctor.clock().verdict == "not known"


def test_an_interface_that_is_down_or_without_multicast_is_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor, "_NET", tmp_path)
    monkeypatch.setattr(doctor, "_RECEIVED", tmp_path / "rmem_max")
    (tmp_path / "wlan0").mkdir()
    (tmp_path / "rmem_max").write_text("212992\n")
    for state, flags, middleware, expected in (
        ("up", "0x1003", "dds", ["ok", "warning"]),  # a small buffer
        ("down", "0x1003", "dds", ["ok", "wrong", "warning"]),
        ("up", "0x3", "dds", ["ok", "wrong", "warning"]),
        ("unknown", "0x9", "dds", ["ok", "warning"]),  # loopback
        ("up", "0x3", "zenoh", ["ok"]),
    ):
        (tmp_path / "wlan0" / "operstate").write_text(f"{state}\n")
        (tmp_path / "wlan0" / "flags").write_text(f"{flags}\n")
        asked = Namespace(network="wlan0", middleware=middleware)
        assert verdicts(doctor.network(asked)) == expected, (state, flags, middleware)


def test_a_middleware_that_is_not_installed_or_not_that_of_ros_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(doctor.PACKAGES, "zenoh", "no-such-package")
    assert verdicts(doctor.packages("zenoh")) == ["ok", "wrong"]
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_zenoh_cpp")
    *_, last = doctor.packages("dds")
    assert (last.verdict, last.mend) == ("warning", "--middleware zenoh")


def test_keys_types_and_folders_are_tried(tmp_path: Path) -> None:
    for name in ("team", "other"):
        assert main(["keys", "new", str(tmp_path / name)]) == 0
    assert verdicts(doctor.keys(Namespace(network="wlan0", trust=[], key=None))) == ["warning"]
    asked = Namespace(network="wlan0", trust=[tmp_path / "team.pub"], key=tmp_path / "team.key")
    assert verdicts(doctor.keys(asked)) == ["ok", "ok"]
    asked.key = tmp_path / "other.key"
    assert verdicts(doctor.keys(asked)) == ["ok", "wrong"]
    asked.key.chmod(0o644)
    assert "chmod 600" in list(doctor.keys(asked))[-1].text
    assert doctor.folder(tmp_path / "later" / "REX").verdict == "ok"
    assert not (tmp_path / "later").exists()
    assert doctor.folder(Path("/proc/REX")).verdict == "wrong"


@pytest.mark.processes
@pytest.mark.dds
def test_a_broken_file_of_types_is_wrong(tmp_path: Path) -> None:
    (tmp_path / "msg").mkdir()
    (tmp_path / "msg" / "Good.msg").write_text(MESSAGE)
    (tmp_path / "msg" / "Bad.msg").write_text("float65 x\n")
    words = [sys.executable, "-m", "fame", "doctor", "--types", str(tmp_path), "--wait", "0.1", "--json"]
    environment = os.environ | {"ROS_DOMAIN_ID": str(PROCESSES)}
    done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=100, check=False)
    found = [each for each in json.loads(done.stdout)["findings"] if each["check"] == "types"]
    assert [each["verdict"] for each in found] == ["ok", "wrong"]
    assert "Bad.msg" in found[1]["text"]
    assert done.returncode == 1


@pytest.mark.dds
def test_a_wrong_request_is_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--router", "10.0.0.7"]) == 2
    assert "need --middleware zenoh" in capsys.readouterr().err


def test_with_wrong_keys_robots_are_not_asked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--trust", str(tmp_path / "team.pub"), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)["findings"]
    assert [each["verdict"] for each in found if each["check"] in ("keys", "robots")] == ["wrong", "not known"]


# ---- the team --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("trip", "ahead", "verdict"),
    [
        (0.002, 0.01, "ok"),
        (0.002, -3.0, "wrong"),
        (0.002, 3.0, "wrong"),
        (0.4, 0.0, "not known"),  # the answer took so long that the clock may be apart
        (0.4, 0.05, "not known"),
        (0.4, 1.0, "wrong"),
    ],
)
def test_a_clock_is_fine_only_where_that_is_known(trip: float, ahead: float, verdict: str) -> None:
    answer = ClockAnswer(round(trip * SECOND), round(ahead * SECOND), {"fame": fame_version()})
    assert verdicts(doctor.answered("REX", answer)) == [verdict]


@pytest.mark.parametrize(
    ("fields", "verdict", "text"),
    [
        ({"state": "running"}, "ok", "running"),
        ({"state": "failed", "error": "division by zero"}, "wrong", "failed: division by zero"),
        ({"state": "failed", "failed": 1, "started": 2, "error": "why"}, "wrong", "1 of 2 instances failed: why"),
        ({"state": "running", "failed": 1, "started": 2, "error": "why"}, "warning", "1 of 2 instances failed: why"),
        ({"state": "incident", "incidents": [{"element": "Go", "text": "no way"}]}, "wrong", "Go: no way"),
        ({"state": "suspended", "suspended": {"by": "ann"}}, "warning", "suspended by ann"),
        ({"state": "running", "absent": {"DINGO": 4.0}}, "warning", "misses DINGO of its team"),
    ],
)
def test_a_robot_is_fine_only_if_its_mission_is(fields: dict, verdict: str, text: str) -> None:
    found = doctor.reported(Report(robot="REX", **fields))
    assert (found.verdict, found.text) == (verdict, text)


def test_another_version_is_told() -> None:
    for told, text in (({"fame": "0.1.0"}, "runs FAME 0.1.0"), ({}, "runs an older FAME")):
        *_, last = doctor.answered("REX", ClockAnswer(0, 0, told))
        assert last.verdict == "warning"
        assert text in last.text


@pytest.mark.processes
@pytest.mark.parametrize(
    "middleware", [pytest.param("dds", marks=pytest.mark.dds), pytest.param("zenoh", marks=pytest.mark.zenoh)]
)
def test_robots_that_are_there_answer_and_others_are_missed(middleware: str) -> None:
    environment = os.environ | {"ROS_DOMAIN_ID": str(PROCESSES)}
    fame = [sys.executable, "-m", "fame"]
    words = [*fame, "engine", "REX", "--middleware", middleware]
    with subprocess.Popen(words, env=environment, stderr=subprocess.PIPE, text=True) as engine:
        assert engine.stderr is not None
        engine.stderr.readline()  # it waits for its process
        words = [*fame, "doctor", "REX", "DINGO", "--wait", "30", "--middleware", middleware, "--json"]
        done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=120, check=False)
        engine.send_signal(signal.SIGTERM)
    found = json.loads(done.stdout)["findings"]
    assert done.returncode == 1
    assert [each["verdict"] for each in found if each["check"] == "DINGO"] == ["wrong"]
    rex = [each for each in found if each["check"] == "REX"]
    assert rex[0]["text"] == "waiting"
    assert "answers after" in rex[1]["text"]
    assert rex[1]["verdict"] in ("ok", "not known")  # a busy machine answers late
