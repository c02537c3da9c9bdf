"""Within rclpy, what a processor can be told is a parameter of its node: of ``-p``, a launch file, `ros2 param`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from middleware_contract import WallWorld, needs, world

from fame.errors import ConfigError
from fame.middleware.simulated_time import ClockFollower
from fame.monitor.pipeline.configuration import Configuration, load
from fame.monitor.pipeline.node import ProcessingNode
from fame.monitor.pipeline.processor import Parameter, Processor

pytestmark = [needs("rclpy"), pytest.mark.ros]


class Scaled(Processor):
    parameters = (
        Parameter("gain", "float", 1.0, (0, 10), "", "what it is multiplied by"),
        Parameter("names", "strs", ()),
        Parameter("model", "str", "a.skops", fixed=True),
    )

    def execute(self, inputs: Any) -> None:
        return None


@pytest.fixture
def here() -> Iterator[WallWorld]:
    made = world("ros")
    assert isinstance(made, WallWorld)
    yield made
    made.close()


@pytest.fixture
def configuration(tmp_path: Path) -> Configuration:
    path = tmp_path / "scaled.yaml"
    path.write_text(
        "Name: scaled\nFrequency: 10\nInputs: {x: {Topic: /x, Field: data, MessageType: std_msgs/Float64}}\n"
    )
    return load(path)


def processing(here: WallWorld, configuration: Configuration, *arguments: str) -> ProcessingNode:
    """A node with a processor, in a process that was started with these arguments for ROS."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["fame", "monitor", "process", "scaled.yaml", "--ros-args", *arguments])
        here.node("first")
        return ProcessingNode(here.middlewares[0], here.scheduler, configuration, processors=[Scaled()])


def test_a_parameter_begins_with_what_the_command_line_says(here: WallWorld, configuration: Configuration) -> None:
    made = processing(here, configuration, "-p", "gain:=2.5")
    here.until(lambda: made.processors[0].gain == 2.5)
    assert made.node.ros.get_parameter("gain").value == 2.5
    assert made.node.ros.get_parameter("model").value == "a.skops"


@pytest.mark.parametrize("said", ["gain:=20.0", "gain:=fast", "model:=b.skops"])
def test_what_does_not_fit_is_refused_by_name(here: WallWorld, configuration: Configuration, said: str) -> None:
    with pytest.raises(ConfigError, match=said.partition(":")[0]):
        processing(here, configuration, "-p", said)


def started_with(here: WallWorld, *arguments: str) -> Any:
    """The node of robot REX in a process that was started with these arguments for ROS."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["fame", "engine", "REX", "--ros-args", *arguments])
        return here.node("fame_engine", "REX", "clock")


def test_the_clock_of_a_process_is_not_changed_while_it_runs(here: WallWorld) -> None:
    from rclpy.parameter import Parameter

    node = started_with(here)
    (result,) = node.ros.set_parameters([Parameter("use_sim_time", value=True)])
    assert not result.successful
    assert result.reason.startswith("use_sim_time is decided when the process starts: --use-sim-time")
    ClockFollower(here.scheduler).subscribe(node)
    assert node.ros.get_parameter("use_sim_time").value is True
    (result,) = node.ros.set_parameters([Parameter("use_sim_time", value=False)])
    assert not result.successful


def test_a_namespace_that_is_pushed_onto_a_robot_is_refused(here: WallWorld) -> None:
    with pytest.raises(ConfigError, match=r"the namespace of robot REX is its name, but ROS .* make it /site1"):
        started_with(here, "-r", "__ns:=/site1")
    here.middlewares.pop().close()
    assert started_with(here, "-r", "__ns:=/REX").full_name == "/REX/fame_engine"
