"""Machines outside ROS: polled, and what they say published."""

import os
import socket
from pathlib import Path
from typing import Any

import pytest
import yaml
from view_page import eventually

from fame.clock import SECOND, Scheduler
from fame.errors import ConfigError
from fame.middleware.local import LocalMiddleware
from fame.monitor.pipeline.configuration import load
from fame.monitor.pipeline.node import ProcessingNode
from fame.monitor.pipeline.polled_source import Machine


def poll(machine: Machine) -> Any:
    """What it gives, as soon as it gives something."""
    return eventually(lambda: machine.execute({}))


@pytest.mark.parametrize(
    ("said", "given"),
    [
        ((1, 2.5), {"speed": 1.0, "load": 2.5}),
        ({"load": 3, "speed": "4", "other": 0}, {"speed": 4.0, "load": 3.0}),
        (None, None),
        ((1,), None),
        ({"load": "high", "speed": 1}, None),
    ],
)
def test_what_a_callable_gives_is_given_by_name(said: Any, given: Any) -> None:
    machine = Machine(lambda: said, fields=["speed", "load"])
    reports: list[str] = []
    machine.report = reports.append
    assert machine.execute({}) == given
    assert len(reports) == (said is not None and given is None)


def test_lines_of_a_tcp_server_are_read_and_the_last_whole_one_counts() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        machine = Machine(f"tcp://127.0.0.1:{server.getsockname()[1]}", fields=["speed", "load"])
        assert machine.execute({}) is None
        other, _ = server.accept()
        other.sendall(b"1 2\n3; 4\n5 ")
        assert poll(machine) == {"speed": 3.0, "load": 4.0}
        other.sendall(b"6\nload=8 speed=7\n")
        assert poll(machine) == {"speed": 7.0, "load": 8.0}
        other.close()
        machine.close()


def test_a_server_that_goes_away_is_reported_and_found_again() -> None:
    said: list[str] = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        machine = Machine(f"tcp://127.0.0.1:{server.getsockname()[1]}")
        machine.report = said.append
        machine.execute({})
        server.accept()[0].close()
        eventually(lambda: machine.execute({}) or said)
        assert said == [f"{machine.source}: away: the other side has closed"]
        for _ in range(52):
            machine.execute({})
        other, _ = server.accept()
        other.sendall(b"42\n")
        assert poll(machine) == {"value": 42.0}
        other.close()
        machine.close()


def test_a_serial_line_is_read() -> None:
    ours, theirs = os.openpty()
    machine = Machine(f"serial://{os.ttyname(theirs)}?baud=9600", fields=["force"])
    assert machine.execute({}) is None
    os.write(ours, b"12.5\n")
    assert poll(machine) == {"force": 12.5}
    machine.close()
    os.close(ours)
    os.close(theirs)


def test_a_line_that_is_not_there_is_reported(tmp_path: Path) -> None:
    said: list[str] = []
    machine = Machine(f"serial://{tmp_path}/none")
    machine.report = said.append
    assert machine.execute({}) is None
    assert said == [f"serial://{tmp_path}/none: away: No such file or directory"]


@pytest.mark.parametrize("source", ["tcp://host", "serial:///dev/tty?baud=12345", "http://host:1", "tcp://host:x"])
def test_a_source_of_another_form_is_refused(source: str) -> None:
    with pytest.raises(ConfigError, match="tcp://host:port, serial:///dev/ttyUSB0"):
        Machine(source)


def test_a_node_publishes_what_a_machine_says(tmp_path: Path) -> None:
    (tmp_path / "lathe.py").write_text("count = 0\ndef ask():\n    global count\n    count += 1\n    return count\n")
    (tmp_path / "lathe.yaml").write_text(yaml.safe_dump({
        "Outputs": {"Speed": {"Topic": "speed", "Field": ["data"], "MessageType": "std_msgs/msg/Float64"}},
        "Processor": {"Class": "Machine", "Parameters": {"source": "lathe.py:ask", "fields": ["speed"]}},
        "Frequency": 10,
    }))  # fmt: skip
    scheduler = Scheduler()
    middleware = LocalMiddleware(scheduler)
    heard: list[float] = []
    middleware.node("other").subscription("/speed", "std_msgs/msg/Float64", lambda said: heard.append(said.data))
    node = ProcessingNode(middleware, scheduler, load(tmp_path / "lathe.yaml"))
    scheduler.run(SECOND // 2)
    node.close()
    assert heard == [1.0, 2.0, 3.0, 4.0, 5.0]
