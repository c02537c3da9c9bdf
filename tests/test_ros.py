"""rclpy: what can be said of it without a ROS 2. What it does with one is in `test_middleware_contract`."""

from __future__ import annotations

import importlib.util
import socket

import pytest

from fame.cli import main
from fame.cli.network import interface
from fame.errors import UnavailableError

pytestmark = pytest.mark.skipif(importlib.util.find_spec("rclpy") is not None, reason="there is an rclpy")


def test_without_rclpy_the_backend_says_what_to_source() -> None:
    with pytest.raises(UnavailableError, match=r"source /opt/ros/jazzy/setup\.bash"):
        importlib.import_module("fame.middleware.ros")


def test_without_rosbags_it_says_so_at_the_start_and_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UnavailableError, match=r"venv --system-site-packages .* pip install rosbags"):
        importlib.import_module("fame.middleware.ros")


def test_what_a_launch_file_appends_for_ros_is_no_argument_of_ours(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "no_such.bpmn", "--ros-args", "-p", "use_sim_time:=true"]) == 2
    assert "no_such.bpmn" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["world w.yaml", "engine REX", "deploy m.bpmn", "status"])
def test_a_network_interface_that_is_not_there_is_refused_with_those_that_are(
    capsys: pytest.CaptureFixture[str], command: str
) -> None:
    assert main([*command.split(), "--network", "wlan99"]) == 2
    said = capsys.readouterr().err
    assert "wlan99" in said
    assert all(name in said for _, name in socket.if_nameindex())


def test_an_interface_is_named_or_has_an_address() -> None:
    name = socket.if_nameindex()[0][1]
    assert (interface(name), interface("127.0.0.1")) == (name, "127.0.0.1")


def test_an_address_that_is_not_of_this_machine_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", "--network", "192.0.2.1"]) == 2  # RFC 5737: nobody has it
    assert capsys.readouterr().err.startswith("fame: error: argument --network: expected one of ")


def test_localhost_and_network_exclude_each_other(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", "--localhost", "--network", "127.0.0.1"]) == 2
    assert "not allowed with" in capsys.readouterr().err
