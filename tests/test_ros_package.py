"""FAME as a package of a ROS 2 workspace: what colcon installs is what there is."""

from __future__ import annotations

import re
import runpy
import tomllib
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest
from lxml import etree
from middleware_contract import needs

from fame.cli import parser
from fame.version import RELEASE

ROOT = Path(__file__).parent.parent
PACKAGE = etree.parse(ROOT / "package.xml").getroot()
CMAKE = (ROOT / "CMakeLists.txt").read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


ARGUMENTS = {
    "engine": ["REX"],
    "deploy": ["m.bpmn"],
    "complete": ["REX", "Task"],
    "activate": ["REX", "Task"],
    "abort": ["REX"],
    "retry": ["REX", "Task"],
    "suspend": ["REX"],
    "continue": ["REX"],
    "take-over": ["REX"],
    "skip": ["REX", "Task"],
    "restart": ["REX", "Task"],
    "fail": ["REX", "Task"],
    "set": ["REX", "speed=1"],
    "move": ["REX", "A", "B"],
    "world": ["w.yaml"],
    "log": ["-o", "run.mcap"],
    "monitor": ["low_pass.yaml"],
    "process": ["low_pass.yaml"],
    "record": ["low_pass.yaml", "-o", "a.csv"],
}
"""What a command cannot do without."""
PARTS = {"log": ["log", "record"], **{old: ["monitor", old] for old in ("process", "record")}}
PARTS["monitor"] = PARTS["process"]


def words(pattern: str) -> list[str]:
    found = re.search(pattern, CMAKE)
    assert found is not None
    return found[1].split()


def test_the_package_is_of_format_3_and_says_of_itself_what_the_project_says() -> None:
    assert (PACKAGE.tag, PACKAGE.get("format"), PACKAGE.findtext("name")) == ("package", "3", "fame")
    assert PACKAGE.findtext("version") == RELEASE
    assert PACKAGE.findtext("description") == PROJECT["project"]["description"]
    assert PACKAGE.findtext("license") == PROJECT["project"]["license"]
    assert "@" in PACKAGE.find("maintainer").get("email")
    order = [child.tag for child in PACKAGE if child.tag in ("name", "version", "description", "maintainer", "license")]
    assert order == ["name", "version", "description", "maintainer", "license"]


def test_what_cmake_looks_for_is_declared() -> None:
    declared = {child.text for child in PACKAGE.findall("buildtool_depend")}
    assert declared == set(re.findall(r"find_package\((\w+)", CMAKE))
    assert PACKAGE.findtext("export/build_type") in declared


def test_the_packages_of_the_wheel_are_installed_and_the_models_inside_fame() -> None:
    wheel = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    packages = words(r"foreach\(package ([\w ]+)\)")
    assert packages == wheel["only-include"]
    assert all((ROOT / package / "__init__.py").exists() for package in packages)
    assert words(r"install\(DIRECTORY models examples DESTINATION \$\{PYTHON_INSTALL_DIR\}/(\w+)\)") == ["fame"]
    assert wheel["force-include"] == {"models": "fame/models", "examples": "fame/examples"}


@pytest.mark.long
def test_each_installed_command_is_one_that_takes_a_middleware() -> None:
    commands = words(r"foreach\(command ([\w -]+)\)")
    assert "engine" in commands
    assert {"retry", "set", "move", "view", "log"} < {*commands}
    for command in commands:
        needed = ARGUMENTS.get(command, [])
        said = PARTS.get(command, [command])
        assert parser().parse_args([*said, "--middleware", "ros", *needed]).middleware == "ros"


@pytest.mark.parametrize(
    ("said", "run"),
    [
        ("retry REX Task", "retry --middleware ros REX Task"),
        ("log record -o run.mcap", "log record --middleware ros -o run.mcap"),
        ("log convert run.mcap -o run.xes", "log convert run.mcap -o run.xes"),
        ("log", "log"),
        ("monitor process x.yaml", "monitor process --middleware ros x.yaml"),
        ("monitor train x.yaml", "monitor train x.yaml"),
    ],
)
def test_what_talks_to_robots_does_so_over_ros(monkeypatch: pytest.MonkeyPatch, said: str, run: str) -> None:
    ran: list[list[str]] = []
    monkeypatch.setattr("fame.cli.main", ran.append)
    monkeypatch.setattr("sys.argv", ["/opt/ros/lib/fame/" + said.split()[0], *said.split()[1:]])
    spec = spec_from_file_location("command", ROOT / "launch" / "command.py")
    assert spec is not None
    assert spec.loader is not None
    with pytest.raises(SystemExit):
        spec.loader.exec_module(module_from_spec(spec))
    assert ran == [run.split()]


def test_what_is_installed_exists_and_can_be_executed() -> None:
    for file in (*words(r"install\(FILES ([\w/. ]+) DESTINATION"), *words(r"install\(PROGRAMS ([\w/. ]+) DESTINATION")):
        assert (ROOT / file).is_file()
    launched = {str(file.relative_to(ROOT)) for file in (ROOT / "launch").glob("*.launch.*")}
    assert launched == set(words(r"install\(FILES ([\w/. ]+) DESTINATION"))
    script = ROOT / "launch" / "command.py"
    assert script.read_text().startswith("#!/usr/bin/env python3\n")
    assert script.stat().st_mode & 0o111


@pytest.mark.ros
@needs("launch_ros")
def test_the_launch_file_starts_each_engine_in_the_namespace_of_its_robot() -> None:
    from launch import LaunchContext

    made = runpy.run_path(str(ROOT / "launch" / "team.launch.py"))
    description = made["generate_launch_description"]()
    context = LaunchContext()
    said = {"robots": "REX:car DINGO", "world": "w.yaml", "use_sim_time": "", "options": "--insecure"}
    assert {action.name for action in description.entities[:-1]} == said.keys()
    context.launch_configurations.update(said)
    world, rex, dingo = made["_nodes"](context)
    assert [node.node_executable for node in (world, rex, dingo)] == ["world", "engine", "engine"]
    assert rex._Node__node_namespace == "REX"


def test_the_program_of_gazebo_reads_what_a_launch_file_appends(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["gazebo_robot.py", "--ros-args", "-r", "__ns:=/REX"])
    with pytest.raises(SystemExit):
        runpy.run_path(str(ROOT / "launch" / "gazebo_robot.py"), run_name="__main__")
    assert "the following arguments are required: robot" in capsys.readouterr().err
