"""`fame unit`, and what an engine tells systemd: that it is ready, alive, and about to end."""

import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from domains import PROCESSES

from fame.cli import main


@pytest.fixture(params=["a file", "an abstract name"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[socket.socket]:
    """A service manager: the socket on which it is told of services."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as made:
        made.bind(str(tmp_path / "notify") if request.param == "a file" else f"\0fame-{os.getpid()}")
        made.settimeout(30)
        yield made


@pytest.mark.processes
@pytest.mark.dds
def test_an_engine_says_that_it_is_ready_alive_and_about_to_end(manager: socket.socket) -> None:
    name = manager.getsockname()
    address = name if isinstance(name, str) else f"@{name[1:].decode()}"
    told = {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "200000", "ROS_DOMAIN_ID": str(PROCESSES)}
    words = [sys.executable, "-m", "fame", "engine", "REX"]
    with subprocess.Popen(words, env=os.environ | told, stderr=subprocess.PIPE) as engine:
        texts = [manager.recv(100) for _ in range(4)]
        engine.send_signal(signal.SIGTERM)
        while texts[-1] == b"WATCHDOG=1":
            texts.append(manager.recv(100))
        assert (engine.wait(60), texts[-1]) == (0, b"STOPPING=1")
    assert texts[:4] == [b"READY=1", *[b"WATCHDOG=1"] * 3]


@pytest.mark.processes
@pytest.mark.dds
def test_without_a_watchdog_it_gives_no_signs_of_life(manager: socket.socket) -> None:
    name = manager.getsockname()
    address = name if isinstance(name, str) else f"@{name[1:].decode()}"
    told = {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "1000", "WATCHDOG_PID": "1", "ROS_DOMAIN_ID": str(PROCESSES)}
    words = [sys.executable, "-m", "fame", "engine", "REX"]
    with subprocess.Popen(words, env=os.environ | told, stderr=subprocess.PIPE) as engine:
        assert manager.recv(100) == b"READY=1"
        engine.send_signal(signal.SIGTERM)
        assert (manager.recv(100), engine.wait(60)) == (b"STOPPING=1", 0)


def test_a_unit_may_be_for_another_machine(capsys: pytest.CaptureFixture[str]) -> None:
    assert "--network wlan99" in printed(capsys, "--network", "wlan99")


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["unit", "REX", *words]) == 0
    return capsys.readouterr().out


def test_a_unit_has_the_options_of_the_engine_and_a_state_directory(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    lines = printed(capsys, "--type", "car", "--user", "robot", "--library", "50 % of $HOME").splitlines()
    engine = '-m fame engine REX --type car --library "50 %% of $$HOME" --state /var/lib/fame/REX'
    assert f"ExecStart={sys.executable} {engine}" in lines
    assert {f"WorkingDirectory={tmp_path}", "User=robot", "StateDirectory=fame", "Type=notify"} <= set(lines)
    assert {"Environment=ROS_DOMAIN_ID=7", "WatchdogSec=30", "Restart=on-failure"} <= set(lines)
    assert "RestartPreventExitStatus=2 203 217" in lines  # a mistyped command is not started for ever
    assert f"ReadWritePaths=/tmp /var/tmp {tmp_path}" in lines


def test_a_sandbox_opens_the_folders_that_the_engine_writes(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    lines = printed(capsys, "--user", "robot", "--state", "here", "--log", "a b", "--files", "/srv/code").splitlines()
    assert "StateDirectory=fame" not in lines
    made = f'{tmp_path}/here "{tmp_path}/a b"'
    assert f"ExecStartPre=+install --directory --mode=0700 --owner=robot {made}" in lines
    assert f"ReadWritePaths=/tmp /var/tmp {tmp_path} /srv/code {made}" in lines


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="there is no systemd-analyze")
def test_systemd_finds_a_unit_hardened(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Exposure from 0 (none) to 10: below 3. The network and this machine's shared memory are what a robot needs."""
    unit = tmp_path / "fame-REX.service"
    unit.write_text(printed(capsys, "--user", "robot"))
    words = ["systemd-analyze", "security", "--offline=yes", "--threshold=29", "--no-pager", unit]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="there is no systemd-analyze")
@pytest.mark.parametrize("words", [(), ("--state", "a b", "--library", 'quotes "and" \\ $x %h; #')])
def test_systemd_accepts_a_unit(capsys: pytest.CaptureFixture[str], tmp_path: Path, words: tuple[str, ...]) -> None:
    unit = tmp_path / "fame-REX.service"
    unit.write_text(printed(capsys, *words))
    done = subprocess.run(["systemd-analyze", "verify", unit], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, "fame-REX" in done.stderr) == (0, False), done.stderr


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("REX", "DINGO"), "expected one robot: each engine has a unit of its own"),
        (("REX", "--identity", "x.key"), "--identity needs --trust FILE.pub"),
        (("REX", "--type", "nope"), "expected a robot type, got 'nope'; known are: "),
        (("REX", "--fresh"), "--fresh would start over after each crash"),
        (("REX", "--files", "a\nb"), "expected text of one line"),
        (("REX", "--user", "x y"), "expected the name of an account, got 'x y'"),
        (("REX", "--tipe", "car"), "unknown option '--tipe'; did you mean '--type'?"),
    ],
)
def test_what_a_unit_cannot_contain_is_refused(
    capsys: pytest.CaptureFixture[str], words: tuple[str, ...], text: str
) -> None:
    assert main(["unit", *words]) == 2
    assert text in capsys.readouterr().err
