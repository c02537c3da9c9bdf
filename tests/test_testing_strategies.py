"""Strategies of hypothesis for missions, and the command that repeats a failing case."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st

from fame.errors import ConfigError, MessageError
from fame.middleware.network import Delay, Link, NetworkConfig, Partition
from fame.scenario import Fault, Scenario
from fame.testing.strategies import command, faults, load, networks, payloads, places

pytest_plugins = ["pytester"]
ROOT = Path(__file__).parent.parent
VEHICLES = ROOT / "models" / "ground_vehicles.bpmn"
FEW = settings(max_examples=10, derandomize=True)


@pytest.mark.long
@FEW
@given(network=networks("REX", "DINGO", delay=0.3, loss=0.3, partition=9.0, until=10.0))
def test_the_vehicles_finish_over_any_network_whose_partitions_are_short(network: NetworkConfig) -> None:
    with load(VEHICLES, network=network) as m:
        m.stub("Explore", after=5, signals={"target_found": {"x": 1.0, "y": 1.0}})
        m.stub("GoTo", after=5)
        m.expect("REX").completed(within=60)


@FEW
@given(broken=faults("REX", "DINGO", until=4.0))
def test_nobody_fires_unless_the_target_was_found(broken: list[Fault]) -> None:
    with load(VEHICLES, faults=broken) as m:
        m.stub("Explore", after=5)
        m.advance(20)
        m.expect("DINGO").never_entered("Fire")


@FEW
@given(change=places(ROOT / "examples" / "ground_vehicles.yaml", "world.robots.DINGO.at", clearance=0.5))
def test_free_places_make_possible_worlds(change: dict[str, Any]) -> None:
    (place,) = change.values()
    scenario = Scenario.load(ROOT / "examples" / "ground_vehicles.yaml", changes=change)
    assert scenario.world is not None
    assert [robot.at for robot in scenario.world.robots if robot.name == "DINGO"] == [tuple(place)]


@FEW
@given(message=payloads("geometry_msgs/msg/PoseStamped", header=st.just({"frame_id": "map"})))
def test_messages_fit_their_type(message: Any) -> None:
    assert message.header.frame_id == "map"
    assert isinstance(message.pose.position.x, float)


def test_what_is_not_there_is_refused() -> None:
    with pytest.raises(MessageError, match="rnge"):
        payloads("sensor_msgs/msg/Range", rnge=st.just(1))
    with pytest.raises(ConfigError, match="expected two robots or more to cut off, got REX"):
        networks("REX", partition=5)


def test_the_command_repeats_the_options_of_a_case() -> None:
    network = NetworkConfig((Link(Delay("fixed", 0.05), 0.1),), (Partition(("REX", "DINGO"), 3, 6.5),))
    options: dict[str, Any] = {"variables": {"REX": {"x_min": 1}}, "changes": {"world.robots.REX.at": [1, 2]}}
    broken = [Fault("REX", 4.0, "engine")]
    assert command("a.yaml", seed=7, network=network, faults=broken, **options) == (
        "fame run a.yaml --seed 7 --fault REX@4:engine --set REX.x_min=1 --change 'world.robots.REX.at=[1, 2]' "
        "--network-delay 0.05 --loss 0.1 --partition REX,DINGO@3-6.5"
    )


@pytest.mark.parametrize(
    ("played", "repeat"),
    [
        ("", "fame run *ground_vehicles.bpmn --network-delay 0 --loss 0"),
        ("m.stub('Explore')", "fame test *test_a_failing_case*.py::test_it"),
    ],
)
def test_a_failing_case_prints_the_command_that_repeats_it(pytester: pytest.Pytester, played: str, repeat: str) -> None:
    pytester.makepyfile(
        f"""
        from hypothesis import Phase, given, settings
        from fame.testing.strategies import load, networks

        @settings(max_examples=5, deadline=None, database=None, phases=[Phase.generate])
        @given(network=networks(delay=0.5))
        def test_it(network):
            with load({str(VEHICLES)!r}, network=network) as m:
                {played}
                m.expect("REX").completed(within=5)
        """
    )
    result = pytester.runpytest_inprocess("-p", "fame.testing.plugin")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines([f"*repeat it with: {repeat}"])
    saved = next(line for line in result.outlines if "saved: " in line and line.endswith("run.mcap"))
    assert Path(saved.partition("saved: ")[2]).is_file()
