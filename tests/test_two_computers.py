"""The commands of docs/network.md for two robots over DDS, in their order, in two network namespaces."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from networked_machines import forbidden

pytest.importorskip("cyclonedds")
pytestmark = pytest.mark.processes

PAGE = (Path(__file__).parent.parent / "docs" / "network.md").read_text(encoding="utf-8")
(SECTION,) = re.findall(r"^## Over DDS\n(.*?)^## ", PAGE, re.DOTALL | re.MULTILINE)
BASE, ROBOT, DEPLOY, PEERS, NAMESPACES = re.findall(r"^```sh\n(.*?)^```", SECTION, re.DOTALL | re.MULTILINE)
NO_MULTICAST = "".join(f"ip -n {name} link set wlan0 multicast off\n" for name in ("base", "robot"))


def inside(name: str, block: str) -> str:
    """The commands of a block in a namespace. Those that go on are waited for until they are ready."""
    lines = []
    for number, line in enumerate(block.splitlines()):
        command = f"ip netns exec {name} {line}"
        if line.endswith("&"):
            file = f"{name}{number}.txt"
            command = f"{command[:-1]} > {file} 2>&1 &\nuntil grep -q 'Ctrl-C ends it' {file}; do sleep 0.1; done"
        lines.append(command)
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("before", ["", NO_MULTICAST + PEERS], ids=["multicast", "peers"])
def test_two_robots_on_two_computers_complete_their_mission(before: str, tmp_path: Path) -> None:
    if why := forbidden():
        pytest.skip(why)
    fame = tmp_path / "bin" / "fame"
    fame.parent.mkdir()
    fame.write_text(f'#!/bin/sh\nexec {sys.executable} -m fame "$@"\n')
    fame.chmod(0o755)
    private = "mount -t tmpfs tmpfs /run\ntrap 'kill $(jobs -p); wait' EXIT\n"  # the names of the namespaces
    script = private + NAMESPACES + before + inside("base", BASE) + inside("robot", ROBOT) + inside("base", DEPLOY)
    done = subprocess.run(
        ["unshare", "-m", "-n", "bash", "-e", "-c", f'PATH="{fame.parent}:$PATH"\n{script}'],
        cwd=tmp_path, capture_output=True, text=True, timeout=240, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"^HELPER +started .*^SCOUT +started ", done.stdout, re.DOTALL | re.MULTILINE)
    assert "SCOUT: the mission has ended\n" in done.stderr
    assert re.search(r"^HELPER +idle .*^SCOUT +idle ", done.stdout, re.DOTALL | re.MULTILINE)
