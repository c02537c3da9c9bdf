"""The `type:` of a robot: built in, installed by a package, a class of a module, a class of a file beside the world."""

from pathlib import Path

import pytest
from grounds import Ground

from fame.config.values import ConfigValue, Source
from fame.errors import ConfigError
from fame.middleware import codec
from fame.scenario import Scenario
from fame.scenario.distributed import TeamOptions, command_lines
from robots.vehicles import Car
from sim2d import robot as robot_module
from sim2d.config import read_world, world_config
from sim2d.robot import BUILT_IN, robot_class

EXAMPLES = Path(__file__).parent.parent / "examples"


def world(type: str) -> dict:
    return {"size": [4, 4], "robots": {"REX": {"type": type, "at": [1, 1]}}}


@pytest.mark.parametrize("type", BUILT_IN)
def test_the_types_that_come_with_fame_are_found_by_name(type: str) -> None:
    assert robot_class(type).__name__ == BUILT_IN[type].partition(":")[2]


def test_a_class_of_a_file_beside_the_world_is_a_robot_with_topics_and_parameters_of_its_own() -> None:
    config = read_scenario_world(EXAMPLES / "courier.yaml")
    ground = Ground(config)
    heard = ground.hear("/PORTER/temperature", "sensor_msgs/msg/Temperature")
    ground.run(3)
    assert [round(message.temperature) for message in heard] == [4, 4, 4, 4]
    assert {message.variance for message in heard} == {0.1**2}


def read_scenario_world(path: Path):
    world = Scenario.load(path).world
    assert world is not None
    return world


def test_a_mission_runs_with_a_robot_that_fame_does_not_know() -> None:
    result = Scenario.load(EXAMPLES / "courier.yaml").run()
    usual = Scenario.load(EXAMPLES / "delivery.yaml").run()
    assert (result.status, result.world) == (usual.status, usual.world)
    assert result.status == "completed"


def test_an_installed_package_registers_a_type_by_an_entry_point(monkeypatch) -> None:
    monkeypatch.setattr(robot_module, "registered", {"fame.robots": {"rover": "robots.vehicles:Car"}}.__getitem__)
    assert robot_class("rover") is Car
    assert Ground(world("rover")).world.robots["REX"].type == "rover"


def test_a_class_of_a_module_is_found_by_its_place() -> None:
    assert robot_class("robots.vehicles:Car") is Car


@pytest.mark.parametrize(
    ("type", "text"),
    [
        (
            "boat",
            "expected a robot type, got 'boat'; known are: car, carrier, drone, mh5, tractor, ur5e, module:Class, "
            "file.py:",
        ),
        ("trakctor", "got 'trakctor'; did you mean 'tractor'?"),
        ("no_such_module:Boat", "no_such_module cannot be imported: ModuleNotFoundError"),
        ("none.py:Boat", "there is no file "),
        ("robots.vehicles:Boat", "robots.vehicles has no 'Boat'"),
        ("pathlib:Path", "expected a class of robots (sim2d.robot), got 'pathlib:Path', which has no Parameters, "),
    ],
)
def test_what_is_no_robot_type_is_refused_with_its_place(type: str, text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        world_config(ConfigValue(world(type), source=Source("w.yaml", {"robots.REX.type": 4})))
    assert str(caught.value).startswith("w.yaml:4: robots.REX.type: ")
    assert text in str(caught.value)


def test_an_engine_in_a_process_of_its_own_is_given_the_whole_path_of_the_file() -> None:
    scenario = Scenario.load(EXAMPLES / "courier.yaml")
    lines = command_lines(scenario, "dds", TeamOptions(), Path("run.pub"))
    assert f"{EXAMPLES.resolve() / 'courier.py'}:Courier" in lines["PORTER"]


def test_a_file_is_relative_to_the_world_and_not_to_where_fame_was_started(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "world.yaml").write_text("size: [4, 4]\nrobots: {REX: {type: 'own.py:Own', at: [1, 1]}}\n")
    (tmp_path / "own.py").write_text("from robots.vehicles import Car\n\n\nclass Own(Car):\n    pass\n")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    (robot,) = read_world(tmp_path / "world.yaml").robots
    assert robot.make.__name__ == "Own"


@pytest.mark.parametrize("kind", BUILT_IN)
def test_what_a_robot_publishes_can_be_written_for_the_wire(kind: str) -> None:
    robot = {"type": kind, "at": [1, 2]}
    ground = Ground({"size": [6, 4], "step": 0.002 if kind in ("mh5", "ur5e") else 0.05, "robots": {"REX": robot}})
    types = {info.name: info.types[0] for info in ground.middleware.graph() if info.publishers}
    heard = {topic: ground.hear(topic, type) for topic, type in types.items()}
    ground.run(until=1)
    assert any(heard.values())
    for topic, messages in heard.items():
        for message in messages[-1:]:
            data = codec.serialize(message)
            assert codec.serialize(codec.deserialize(data, types[topic])) == data
