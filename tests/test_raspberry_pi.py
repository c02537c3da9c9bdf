"""The commands of docs/raspberry_pi.md, in their order: base and robot on one machine, on its loopback alone."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from domains import PROCESSES
from free_ports import free_port

pytest.importorskip("zenoh")
pytestmark = pytest.mark.processes

PAGE = (Path(__file__).parent.parent / "docs" / "raspberry_pi.md").read_text(encoding="utf-8")
COMMANDS = [
    line.partition("#")[0].strip()
    for block in re.findall(r"^```sh\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    for line in block.splitlines()
    if "# not run" not in line
]


@dataclass
class Machine:
    """A folder, and the programs that go on there."""

    folder: Path
    port: int = field(default_factory=free_port)
    running: dict[str, subprocess.Popen[str]] = field(default_factory=dict)

    def run(self, line: str) -> str:
        """Run a command to its end; one that ends in ``&`` goes on. Gives what it prints, or its first line."""
        here = line.replace("--network eth0", f"--port {self.port}")
        words = shlex.split(re.sub(r"--router [\d.]+", f"--router 127.0.0.1:{self.port}", here.rstrip(" &")))
        command = [sys.executable, "-m", *words]
        program = subprocess.Popen(
            command, cwd=self.folder, env=os.environ | {"ROS_DOMAIN_ID": str(PROCESSES)}, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        if line.endswith("&"):
            self.running[words[1]] = program
            assert program.stdout is not None
            return program.stdout.readline()
        said = program.communicate(timeout=120)[0]
        # Here the clock need not be synchronized, and there is no robot at first: not known.
        assert program.returncode == 0 or (words[1] == "doctor" and program.returncode == 3), f"{line}\n{said}"
        return said

    def end(self, name: str) -> str:
        """End a program. Gives what it has printed since."""
        program = self.running.pop(name)
        program.terminate()
        return program.communicate(timeout=60)[0]


def test_the_page_leads_to_the_first_mission(tmp_path: Path) -> None:
    (tmp_path / "hello.bpmn").write_text(re.findall(r"^```xml\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)[0])
    machine = Machine(tmp_path)
    try:
        said = {line: machine.run(line) for line in COMMANDS}
        heard = machine.end("engine")
    finally:
        for name in [*machine.running]:
            machine.end(name)
    assert len(said) == 9
    found = {start: text for line, text in said.items() for start in (line[:11], line[:14], line[:9]) if text}
    assert re.search(r"Pi +started", found["fame deploy"])
    assert "hello from Pi" in heard
    assert re.search(
        r"(ok|not known) +Pi: answers", found["fame doctor Pi"]
    )  # a slow answer tells too little of a clock
    assert "ExecStart=" in found["fame unit"]
    assert "--state" in found["fame unit"]
