"""What an engine publishes on /diagnostics and serves to Prometheus: a status of its mission."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from urllib.request import urlopen

import pytest
from deployment_field import Field, definitions, process
from free_ports import free_port
from middleware_contract import needs
from test_node_parameters import ros2

from fame.errors import ConfigError
from fame.fleet.diagnostics import ERROR, OK, TYPE, WARN
from fame.fleet.metrics import serve_metrics

ROOT = Path(__file__).parent.parent
WAITS = definitions(process("p", '<startEvent id="s"/><userTask id="ask" name="Ask Ann"/>', ("s", "ask")))
FAILS = definitions(
    process("p", '<startEvent id="s"/><scriptTask id="bad"><script>1 / 0</script></scriptTask>', ("s", "bad"))
)


class Robot(Field):
    """An engine that publishes diagnostics, and what somebody hears of them."""

    def __init__(self, **options) -> None:
        super().__init__("REX", diagnostics=True, wall_time=lambda: 1000.5, **options)
        self.heard: list = []
        self.person.subscription("/diagnostics", TYPE, self.heard.append)

    def run(self, model: str = "") -> tuple[int, str, dict[str, str]]:
        """Level, message and values of the last status after three seconds, of a model if there is one."""
        if model:
            self.send("REX", model)
        self.pass_time(3)
        (status,) = self.heard[-1].status
        assert (status.name, status.hardware_id) == ("REX: mission", "REX")
        return status.level, status.message, {pair.key: pair.value for pair in status.values}


def test_once_a_second_it_says_what_a_mission_waits_for() -> None:
    robot = Robot()
    assert robot.run()[:2] == (OK, "waiting")
    assert len(robot.heard) == 3
    level, message, values = robot.run(WAITS)
    assert (level, message) == (OK, "running")
    assert (values["state"], values["instances"]) == ("running", "1")
    assert values['waits at "Ask Ann" (ask)'].endswith(", for 3 s")
    assert (robot.heard[-1].header.stamp.sec, robot.heard[-1].header.stamp.nanosec) == (1000, 500_000_000)


@pytest.mark.parametrize(("hold_errors", "state"), [(False, "failed"), (True, "incident")])
def test_an_error_is_one(hold_errors: bool, state: str) -> None:
    level, message, values = Robot(hold_errors=hold_errors).run(FAILS)
    assert (level, values["state"]) == (ERROR, state)
    assert "division by zero" in message


@pytest.mark.parametrize(
    ("after", "state", "level"), [('<endEvent id="ask"/>', "failed", ERROR), ('<userTask id="ask"/>', "running", WARN)]
)
def test_a_failed_instance_is_not_forgotten_when_a_later_one_completes_or_runs(
    after: str, state: str, level: int
) -> None:
    timer = "<timerEventDefinition><timeDuration>PT{}S</timeDuration></timerEventDefinition>"
    content = (
        f'<startEvent id="one">{timer.format(1)}</startEvent><scriptTask id="bad"><script>1 / 0</script></scriptTask>'
        f'<startEvent id="two">{timer.format(2)}</startEvent>{after}'
    )
    found, message, values = Robot().run(definitions(process("p", content, ("one", "bad"), ("two", "ask"))))
    assert (found, values["state"], values["failed"]) == (level, state, "1")
    assert message.startswith("1 of 2 instances failed: ")
    assert "division by zero" in message


def test_an_older_instance_that_fails_while_a_younger_one_runs_is_told() -> None:
    timer = "<timerEventDefinition><timeDuration>PT{}S</timeDuration></timerEventDefinition>"
    content = (
        f'<startEvent id="s"/><intermediateCatchEvent id="wait">{timer.format(2)}</intermediateCatchEvent>'
        '<scriptTask id="bad"><script>1 / 0</script></scriptTask>'
        f'<startEvent id="two">{timer.format(1)}</startEvent><userTask id="ask"/>'
    )
    model = definitions(process("p", content, ("s", "wait"), ("wait", "bad"), ("two", "ask")))
    level, message, _ = Robot().run(model)
    assert (level, message.partition(": ")[0]) == (WARN, "1 of 2 instances failed")


def test_a_mission_that_somebody_suspends_is_a_warning_with_the_name() -> None:
    robot = Robot()
    robot.run(WAITS)
    robot.engines["REX"].running.suspension.suspend("ann")
    assert robot.run()[:2] == (WARN, "suspended by ann")


@pytest.mark.parametrize(("address", "port"), [("127.0.0.1", 70_000), ("a..b", 9100)])
def test_metrics_at_what_is_no_address_are_one_line(address: str, port: int) -> None:
    pytest.importorskip("prometheus_client", reason="prometheus-client is not installed")
    with pytest.raises(ConfigError, match=rf"--metrics {address}:{port} cannot be opened: .*(must be 0-65535|idna)"):
        serve_metrics(address, port).__enter__()


def test_prometheus_reads_what_a_mission_does() -> None:
    pytest.importorskip("prometheus_client", reason="prometheus-client is not installed")
    port = free_port()
    with serve_metrics("127.0.0.1", port) as metrics:
        robot = Robot(on_status=(metrics,))
        robot.run(WAITS)
        with urlopen(f"http://127.0.0.1:{port}/metrics", timeout=60) as response:
            lines = response.read().decode().splitlines()
        with pytest.raises(ConfigError, match=f"--metrics 127.0.0.1:{port} cannot be opened: Address already in use"):
            serve_metrics("127.0.0.1", port).__enter__()
    assert 'fame_mission_state{fame_mission_state="running",robot="REX"} 1.0' in lines
    assert 'fame_mission_state{fame_mission_state="failed",robot="REX"} 0.0' in lines
    assert 'fame_longest_wait_seconds{robot="REX"} 3.0' in lines
    assert 'fame_instances_started_total{robot="REX"} 1.0' in lines


@pytest.mark.ros
@pytest.mark.processes
@needs("rclpy")
@needs("cyclonedds")
@pytest.mark.skipif(shutil.which("ros2") is None, reason="ROS 2 is not sourced")
def test_ros2_sees_the_topic_with_its_type() -> None:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(ROOT), *sys.path))}
    words = [sys.executable, "-m", "fame", "engine", "REX", "--diagnostics"]
    with subprocess.Popen(words, env=environment, stderr=subprocess.PIPE, text=True) as engine:
        assert engine.stderr is not None
        try:
            assert "waits for its process" in engine.stderr.readline()
            ros2(r".*/diagnostics \[diagnostic_msgs/msg/DiagnosticArray\].*", "topic", "list", "-t")
        finally:
            engine.send_signal(signal.SIGTERM)
