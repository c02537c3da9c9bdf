"""`fame doctor`: what is wrong with a machine or a team is told with its mend, and what was not seen is not fine."""

import json
import os
import signal
import socket
import subprocess
import sys
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest
from domains import PROCESSES

from fame.cli import main
from fame.cli.fleet import doctor, installation, inventory
from fame.cli.fleet.doctor import Finding
from fame.cli.network import interface_of
from fame.clock import Scheduler
from fame.deploy import Report
from fame.deploy.signing import Identity, new_identity, read_identity, read_private
from fame.log.clocks import ClockAnswer
from fame.middleware.local import LocalMiddleware
from fame.version import PROTOCOL, current as fame_version

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
    monkeypatch.setattr(doctor, "interface_of", {"wlan0": "wlan0", "10.0.0.5": "wlan0", "eth9": "eth9"}.get)
    for state, flags, middleware, expected in (
        ("up", "0x1003", "dds", ["ok", "warning"]),  # a small buffer
        ("down", "0x1003", "dds", ["wrong", "warning"]),
        ("up", "0x3", "dds", ["wrong", "warning"]),
        ("unknown", "0x9", "dds", ["ok", "warning"]),  # loopback
        ("up", "0x3", "zenoh", ["ok"]),
    ):
        (tmp_path / "wlan0" / "operstate").write_text(f"{state}\n")
        (tmp_path / "wlan0" / "flags").write_text(f"{flags}\n")
        for name in ("wlan0", "10.0.0.5"):
            asked = Namespace(network=name, middleware=middleware)
            assert verdicts(doctor.network(asked)) == expected, (name, state, flags, middleware)
    for name in ("10.0.0.6", "eth9"):  # no interface has it; the system says nothing of it
        assert verdicts(doctor.network(Namespace(network=name, middleware="dds"))) == ["not known", "warning"]


def test_the_interface_of_an_address_is_found() -> None:
    assert [interface_of(name) for name in ("lo", "127.0.0.1", "::1")] == ["lo"] * 3
    assert interface_of("192.0.2.1") is None  # of no machine (RFC 5737)


@pytest.mark.processes
def test_an_interface_without_multicast_is_wrong_also_by_its_address_and_one_that_is_down_is_not_asked() -> None:
    veth = "ip link set lo up && ip link add dum0 type veth peer name dum1 && ip addr add 10.9.9.1/24 dev dum0"
    made = f"mount -t sysfs sysfs /sys && {veth} && ip link set dum0 multicast off"
    up = f"{made} && ip link set dum0 up && ip link set dum1 up"
    fame = f"{sys.executable} -m fame doctor --network 10.9.9.1 --wait 0.5 --json"
    found = {}
    for name, before in (("up", up), ("down", made)):
        words = ["unshare", "-nm", "sh", "-c", f"{before} || exit 77; exec {fame}"]
        done = subprocess.run(words, capture_output=True, text=True, timeout=100, check=False)
        if not done.stdout:
            pytest.skip(f"no network of one's own: {done.stderr}")
        found[name] = json.loads(done.stdout)["findings"]
        assert done.returncode == 1
    for name, text in (("up", "has no multicast"), ("down", "is down")):
        (first, *_) = (each for each in found[name] if each["check"] == "network")
        assert first["verdict"] == "wrong"
        assert ", 10.9.9.1 (dum0): " in first["text"]
        assert text in first["text"]


@pytest.mark.processes
@pytest.mark.zenoh
def test_a_router_that_nobody_runs_is_wrong() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
    words = [sys.executable, "-m", "fame", "doctor", "--middleware", "zenoh", "--router", f"127.0.0.1:{port}"]
    done = subprocess.run([*words, "--wait", "1", "--json"], capture_output=True, text=True, timeout=100, check=False)
    (found,) = (each for each in json.loads(done.stdout)["findings"] if each["check"] == "network")
    assert (found["verdict"], done.returncode) == ("wrong", 1)
    assert f"127.0.0.1:{port}: no router answers there" in found["text"]


def test_a_middleware_that_is_not_installed_or_not_that_of_ros_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(doctor.PACKAGES, "zenoh", "no-such-package")
    assert verdicts(doctor.packages("zenoh")) == ["ok", "wrong"]
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_zenoh_cpp")
    *_, last = doctor.packages("dds")
    assert (last.verdict, last.mend) == ("warning", "--middleware zenoh")


def test_memory_that_processes_cannot_share_or_that_is_small_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert installation.shared_memory(str(tmp_path / "none")).verdict == "wrong"
    for free, verdict in ((1e9, "ok"), (1e6, "warning")):
        monkeypatch.setattr("shutil.disk_usage", lambda folder, free=free: Mock(free=free))
        assert installation.shared_memory(str(tmp_path)).verdict == verdict


def test_a_port_of_the_router_that_is_taken_is_told() -> None:
    with socket.create_server(("", 0)) as taken:
        assert "is taken" in installation.router_port(taken.getsockname()[1]).text


def test_a_message_between_two_participants_arrives_or_loopback_is_wrong() -> None:
    scheduler = Scheduler()
    one, other = LocalMiddleware(scheduler), LocalMiddleware(scheduler)
    assert installation.loopback(scheduler, one, one).verdict == "ok"
    assert installation.loopback(scheduler, one, other).verdict == "wrong"


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


def test_a_report_of_a_fault_has_what_was_found_and_where(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    monkeypatch.setenv("SECRET", "of mine")
    file = tmp_path / "fault.json"
    words = ["doctor", "--trust", str(tmp_path / "team.pub")]
    assert main([*words, "--json", "--report", str(file)]) == 1
    report = json.loads(file.read_text())
    assert report["findings"] == json.loads(capsys.readouterr().out)["findings"]
    assert report["environment"]["ROS_DOMAIN_ID"] == "7"
    assert {"lxml", "numpy"} <= report["packages"].keys()
    assert "of mine" not in file.read_text()
    assert main([*words, "--report", str(tmp_path)]) == 2
    key = tmp_path / "team.key"
    key.write_text("secret")
    assert main(["doctor", "--key", str(key), "--report", str(key)]) == 2
    assert key.read_text() == "secret"


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
    answer = ClockAnswer(round(trip * SECOND), round(ahead * SECOND), {"fame": fame_version(), "protocol": PROTOCOL})
    assert verdicts(doctor.answered("REX", answer)) == [verdict]


def test_simulated_time_is_not_compared_with_the_clock_here() -> None:
    told = {"fame": fame_version(), "protocol": PROTOCOL, "simulated": True}
    answer = ClockAnswer(2_000_000, -1_795_990_527 * SECOND, told)
    (found,) = doctor.answered("REX", answer)
    assert (found.verdict, found.text) == ("ok", "answers after 2.0 ms; its time is that of /clock")
    assert "simulated" in [*inventory._cells(inventory.item("REX", None, answer, []))]


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


def test_a_robot_that_proves_nothing_to_the_trusted_keys_is_not_known(tmp_path: Path) -> None:
    """Its key is its own, or another team's key vouches for it: who knows whether it takes missions of this team."""
    for name in ("team", "other"):
        assert main(["keys", "new", str(tmp_path / name)]) == 0
    asked = Namespace(trust=[tmp_path / "team.pub"], key=None)
    found, team = [], doctor._Team(asked, Mock(), Mock())
    for robot, key in (("", ""), ("REX", "other"), ("DINGO", "team"), ("REX", "team")):
        identity = Identity.new()
        if robot:
            path = tmp_path / key / f"{robot}.key"
            path.parent.mkdir(exist_ok=True)
            new_identity(robot, read_private(tmp_path / f"{key}.key"), path)
            identity = read_identity(path, robot)
        report = Report(robot="REX", state="waiting", key=identity.key, voucher=identity.voucher)
        found += verdicts(team._vouched(report))
        failed = replace(report, state="failed", error="division by zero")
        assert verdicts(team._vouched(failed))[-1] == "wrong"
    assert found == ["not known", "not known", "not known", "ok"]
    asked.trust = []
    assert verdicts(team._vouched(report)) == ["ok"]


def test_another_version_is_told() -> None:
    for told, text in (({"fame": "0.1.0"}, "runs FAME 0.1.0"), ({}, "runs an older FAME")):
        *_, last = doctor.answered("REX", ClockAnswer(0, 0, told))
        assert last.verdict == "warning"
        assert text in last.text


@pytest.mark.processes
@pytest.mark.parametrize(
    "middleware", [pytest.param("dds", marks=pytest.mark.dds), pytest.param("zenoh", marks=pytest.mark.zenoh)]
)
def test_robots_that_are_there_answer_and_others_are_missed(middleware: str, tmp_path: Path) -> None:
    environment = os.environ | {"ROS_DOMAIN_ID": str(PROCESSES)}
    fame = [sys.executable, "-m", "fame"]
    words = [*fame, "engine", "REX", "--middleware", middleware]
    with subprocess.Popen(words, env=environment, stderr=subprocess.PIPE, text=True) as engine:
        assert engine.stderr is not None
        engine.stderr.readline()  # it waits for its process
        words = [*fame, "doctor", "REX", "DINGO", "--wait", "30", "--middleware", middleware, "--json"]
        words += ["--report", str(tmp_path / "fault.json")]
        done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=120, check=False)
        for names, code in ((["REX"], 0), (["REX", "DINGO"], 1)):
            words = [*fame, "status", *names, "--middleware", middleware, "--json"]
            told = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=120, check=False)
            assert (told.returncode, list(json.loads(told.stdout)["robots"])) == (code, ["REX"])
        engine.send_signal(signal.SIGTERM)
    found = json.loads(done.stdout)["findings"]
    assert done.returncode == 1
    assert [each["verdict"] for each in found if each["check"] == "DINGO"] == ["wrong"]
    rex = [each for each in found if each["check"] == "REX"]
    assert rex[0]["text"] == "waiting"
    assert "answers after" in rex[1]["text"]
    assert rex[1]["verdict"] in ("ok", "not known")  # a busy machine answers late
    assert json.loads((tmp_path / "fault.json").read_text())["robots"]["REX"]["state"] == "waiting"
