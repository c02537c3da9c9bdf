"""Each room can be taken away: the core and its commands go on, and what needs the room says so in one line."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from bpmn_text import process

from fame.cli import NAMES
from fame.rooms import COMMANDS, ROOMS, install, room_of

ROOT = Path(__file__).parent.parent
FLOWS = '<startEvent id="s"/><endEvent id="e"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/>'
FLOWS += '<sequenceFlow id="g" sourceRef="t" targetRef="e"/>'
SCRIPT = '<scriptTask id="t" scriptFormat="{}"><script>x = 1</script></scriptTask>'
FILES = {
    "m.bpmn": process(FLOWS + SCRIPT.format("python")),
    "js.bpmn": process(FLOWS + SCRIPT.format("javascript")),
    "el.bpmn": process(FLOWS.replace('targetRef="t"/>', 'targetRef="t"><conditionExpression>${1 == 1}'
                                     "</conditionExpression></sequenceFlow>") + SCRIPT.format("python")),
    "node.bpmn": process(f'{FLOWS}<serviceTask id="t" camunda:type="external" camunda:topic="process"/>'),
    "p.bpmn": process(FLOWS + SCRIPT.format("python")),
    "p.properties.yaml": "properties: {ends: P completes}",
    "test_m.py": "def test_m(mission): pass",
}  # fmt: skip
CORE = ("check m.bpmn", "run m.bpmn --log m.mcap", "split m.bpmn -o parts",
        "log merge m.mcap -o n.mcap", "convert m.bpmn -o c.bpmn", "--help")  # fmt: skip
"""Command lines that need no room."""
OF_ROOMS = {
    "campaign": ("campaign m.bpmn --runs 1",),
    "dds": ("engine REX", "deploy m.bpmn", "status"),
    "draw": (f"draw {ROOT}/models/convoy.bpmn -o m.svg", "run m.bpmn --picture m.png"),
    "edit": ("diff m.bpmn m.bpmn", "edit --fetch"),
    "explore": ("check --explore m.bpmn",),
    "feel": ("check el.bpmn", "run el.bpmn"),
    "fleet": ("doctor", "inventory", "log collect", "log collect -o logs"),
    "foxglove": ("view --foxglove 0",),
    "javascript": ("run js.bpmn",),
    "judge": (
        "log judge p.properties.yaml m.mcap",
        "run p.bpmn",
        "log record --properties p.properties.yaml -o r.mcap",
    ),
    "mining": ("log convert m.mcap -o m.xes", "run m.bpmn --log m.xes"),
    "layout": ("layout m.bpmn -o l.bpmn",),
    "monitor": ("monitor judge m.skops m.csv", "monitor", "run node.bpmn", "topic list", "record x.yaml -o m.csv"),
    "ros": ("engine REX --middleware ros",),
    "testing": ("test test_m.py",),
    "view": ("run m.bpmn --view", "view m.bpmn"),
    "zenoh": ("engine REX --middleware zenoh", "router"),
}
"""Command lines that need one."""
TESTS = ("test_simulation.py",)
MORE_TESTS = (
    *(f"conformance/test_{name}.py" for name in ("mappings", "sequence", "signals")),
    *("test_clock.py", "test_local_middleware.py", "test_logs.py"),
)


@cache
def home(name: str) -> str:
    """The room of a command; empty for one of the core, and for a group."""
    places = (names[name] for group, names in COMMANDS.items() if name in names and group != "monitor")
    return "monitor" if name == "monitor" else room_of(next(places, "").partition(":")[0])


def without(room: str, lines: list[str], files: tuple[str, ...], folder: Path) -> list[tuple[int, str]]:
    """The exit code and output of each command line without a room, then those of the tests of files."""
    for name, content in FILES.items():
        (folder / name).write_text(content, "utf-8")
    tests = [str(ROOT / "tests" / name) for name in files]
    done = subprocess.run(
        [sys.executable, str(ROOT / "tests" / "without_room.py"), room, *tests],
        input=json.dumps([line.split() for line in lines]), cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return [(code, output) for code, output in json.loads(done.stdout)]


@pytest.mark.long_but("explore")
@pytest.mark.parametrize("room", ROOMS)
def test_without_a_room_the_core_goes_on_and_its_commands_say_what_is_lacking(room: str, tmp_path: Path) -> None:
    lines = [*CORE, *(f"{name} --help" for name in NAMES if home(name) != room)]
    needing = [*OF_ROOMS[room], *(f"{name} --help" for name in NAMES if home(name) == room)]
    *found, (code, output) = without(room, lines + needing, TESTS, tmp_path)
    assert (code, "passed" in output) == (0, True), output
    assert [(line, said) for line, (code, said) in zip(lines, found, strict=False) if code] == []
    lacking = f"fame: error: this installation lacks {room} "
    for line, (code, said) in zip(needing, found[len(lines) :], strict=True):
        (error,) = [each for each in said.splitlines() if not each.startswith("fame: note:")]
        assert (line, code, error[: len(lacking)]) == (line, 2, lacking)
        assert error.endswith(install(ROOMS[room].extra) if ROOMS[room].extra else "fame-robots")


@pytest.mark.long
@pytest.mark.parametrize("room", ROOMS)
def test_without_a_room_the_tests_of_the_core_pass(room: str, tmp_path: Path) -> None:
    ((code, output),) = without(room, [], MORE_TESTS, tmp_path)
    assert code == 0, output
    assert int(re.findall(r"(\d+) passed", output)[-1]) > 100
