"""Parameters of nodes between processes: every node offers ROS's services, and the parts of an engine share them."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from middleware_contract import DOMAIN, WallWorld, middlewares, needs, world

from fame.clock import SECOND
from fame.errors import ConfigError
from fame.middleware import codec
from fame.middleware.interface import ENGINE
from fame.middleware.parameters import NodeParameter, ParameterTable, service_name, service_type
from fame.monitor.pipeline.parameters import ParameterClient

ROOT = Path(__file__).parent.parent
TEXT = "std_msgs/msg/String"
HASHES = {
    "ListParameters": "3e6062bfbb27bfb8730d4cef2558221f51a11646d78e7bb30a1e83afac3aad9d",
    "GetParameters": "bf9803d5c74cf989a5de3e0c2e99444599a627c7ff75f97b8c05b01003675cbc",
    "DescribeParameters": "845b484d71eb0673dae682f2e3ba3c4851a65a3dcfb97bddd82c5b57e91e4cff",
    "GetParameterTypes": "da199c878688b3e530bdfe3ca8f74cb9fa0c303101e980a9e8f260e25e1c80ca",
    "SetParameters": "56eed9a67e169f9cb6c1f987bc88f868c14a8fc9f743a263bc734c154015d7e0",
    "SetParametersAtomically": "0e192ef259c07fc3c07a13191d27002222e65e00ccec653ca05e856f79285fcd",
}
"""The hashes of Jazzy (rcl_interfaces)."""


@pytest.fixture(
    params=[
        pytest.param("dds", marks=[needs("cyclonedds"), pytest.mark.dds]),
        pytest.param("zenoh", marks=[needs("zenoh"), pytest.mark.zenoh]),
    ]
)
def here(request: pytest.FixtureRequest) -> Iterator[WallWorld]:
    made = world(request.param)
    assert isinstance(made, WallWorld)
    yield made
    made.close()


def client(here: WallWorld, other: str) -> ParameterClient:
    return ParameterClient(here.node("_asker"), here.scheduler, other)


def ask(here: WallWorld, node: str, kind: str, request: dict[str, Any]) -> Any:
    """The response of a parameter service."""
    asker, answers = here.node("_asker").client(f"{node}/{service_name(kind)}", service_type(kind)), list[Any]()
    here.until(lambda: asker.available)
    asker.call(request, answers.append)
    here.until(lambda: answers)
    return answers[0]


@pytest.mark.parametrize(("kind", "hash"), HASHES.items())
def test_the_types_of_the_services_are_those_of_jazzy(kind: str, hash: str) -> None:
    assert codec.service_hash(service_type(kind)) == f"RIHS01_{hash}"


@pytest.mark.long_but("dds")
def test_every_node_says_whether_it_follows_the_clock(here: WallWorld) -> None:
    node = here.node("driver", "REX")
    asking = client(here, "/REX/driver")
    assert asking.names() == ["use_sim_time"]
    assert asking.get(["use_sim_time"]) == [False]
    node.subscription("/clock", "rosgraph_msgs/msg/Clock", lambda message: None)
    assert asking.get(["use_sim_time"]) == [True]
    (described,) = asking.describe(["use_sim_time"])
    assert (described.type, described.read_only) == (1, True)
    with pytest.raises(ConfigError, match="use_sim_time: cannot be changed"):
        asking.set("use_sim_time", False)
    assert ask(here, "/REX/driver", "GetParameterTypes", {"names": ["use_sim_time", "x"]}).types.tolist() == [1, 0]


@pytest.mark.long_but("dds")
def test_several_are_set_all_or_none(here: WallWorld) -> None:
    node, kept = here.node("driver"), {"low.a": 1.0, "low.b": 2.0}

    def setter(name: str) -> Any:
        def keep(value: Any) -> None:
            if value > 9:
                raise ConfigError("expected at most 9", element=name)
            kept[name] = value

        return keep

    for name in kept:
        node.parameters[name] = NodeParameter("float", lambda name=name: kept[name], setter(name))  # type: ignore[attr-defined, misc]

    def setting(**values: float) -> Any:
        items = [{"name": f"low.{name}", "value": {"type": 3, "double_value": v}} for name, v in values.items()]
        return ask(here, "/driver", "SetParametersAtomically", {"parameters": items}).result

    assert setting(a=5.0, b=6.0).successful
    refused = setting(a=7.0, b=10.0)
    assert (refused.successful, refused.reason) == (False, "low.b: expected at most 9")
    assert kept == {"low.a": 5.0, "low.b": 6.0}
    assert client(here, "/driver").names() == ["use_sim_time", "low.a", "low.b"]


@pytest.mark.parametrize(
    ("prefixes", "depth", "names"),
    [([], 0, ["a", "b.c", "b.d.e"]), ([], 1, ["a"]),
     (["b"], 0, ["b.c", "b.d.e"]), (["b"], 1, ["b.c"]), (["a"], 0, ["a"])],
)  # fmt: skip
def test_names_are_listed_below_prefixes_as_rclcpp_does(prefixes: list[str], depth: int, names: list[str]) -> None:
    table = ParameterTable({name: NodeParameter("int", lambda: 1) for name in ("a", "b.c", "b.d.e")})

    class Request:
        pass

    request: Any = Request()
    request.prefixes, request.depth = prefixes, depth
    assert table._list(request)["result"]["names"] == names


def test_parts_are_one_node_to_others_until_the_last_closes(here: WallWorld) -> None:
    mission = here.node(ENGINE, "REX", part="mission")
    deployment = here.node(ENGINE, "REX", part="deployment")
    deployment.publisher("status", TEXT)
    heard: list[str] = []
    mission.subscription("/x", TEXT, lambda message: heard.append(message.data))
    (middleware,) = middlewares(here)
    here.until(lambda: middleware.offers("/REX/fame_engine/list_parameters"))
    here.until(lambda: middleware.node_names() == ["/REX/fame_engine"])
    mission.close()
    assert client(here, "/REX/fame_engine").names() == ["use_sim_time"]
    (status,) = [info for info in middleware.graph() if info.name == "/REX/status"]
    assert status.publishers == ("/REX/fame_engine",)
    deployment.close()
    here.until(lambda: middleware.node_names() == ["/_asker"] * 1)
    assert middleware.offers("/REX/fame_engine/list_parameters") == []


# ---- ROS 2 itself ----------------------------------------------------------------------------------------------------


@pytest.fixture(params=["dds"])
def engine(request: pytest.FixtureRequest) -> Iterator[subprocess.Popen[str]]:
    """An engine in a process of its own, on simulated time."""
    environment = os.environ | {"ROS_DOMAIN_ID": str(DOMAIN), "PYTHONPATH": os.pathsep.join((str(ROOT), *sys.path))}
    words = [
        sys.executable,
        "-m",
        "fame",
        "engine",
        "REX",
        "--middleware",
        request.param,
        "--use-sim-time",
        "--insecure",
    ]
    process = subprocess.Popen(words, env=environment, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    assert "waits for its process" in process.stderr.readline()
    yield process
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)


def ros2(expected: str, *words: str) -> None:
    """Ask a command of ROS 2 until it says what is expected: its node, each time a new one, finds others late."""
    until = time.monotonic() + 60
    while True:
        command = ["ros2", *words, "--no-daemon", "--spin-time", "1"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        if re.fullmatch(expected, done.stdout + done.stderr, re.DOTALL):
            return
        assert time.monotonic() < until, done


@pytest.mark.ros
@pytest.mark.processes
@needs("rclpy")
@needs("cyclonedds")
@pytest.mark.skipif(shutil.which("ros2") is None, reason="ROS 2 is not sourced")
def test_ros2_param_lists_reads_and_sets_those_of_an_engine_over_dds(engine: subprocess.Popen[str]) -> None:
    ros2("/REX/fame_engine\n", "node", "list")
    ros2("/REX/fame_engine:\n  use_sim_time\n", "param", "list")
    ros2("Boolean value is: True\n", "param", "get", "/REX/fame_engine", "use_sim_time")
    ros2(".*use_sim_time: cannot be changed.*", "param", "set", "/REX/fame_engine", "use_sim_time", "false")


@pytest.mark.ros
@pytest.mark.processes
@needs("rclpy")
@pytest.mark.skipif(shutil.which("ros2") is None, reason="ROS 2 is not sourced")
@pytest.mark.parametrize("engine", ["ros"], indirect=True)
def test_an_engine_on_rclpy_is_one_node_with_parameters(engine: subprocess.Popen[str]) -> None:
    ros2("/REX/fame_engine\n", "node", "list")
    ros2(".*/REX/fame_engine:\n.*", "param", "list")


@pytest.mark.long_but("dds")
def test_a_middleware_that_is_closed_at_once_offers_nothing_any_more(here: WallWorld) -> None:
    here.node("short")
    here.close()
    here.scheduler.run(here.scheduler.now + SECOND)
    assert here.middlewares[0].nodes == []
