"""The agriculture mission over DDS: migrated while it runs, and with a tractor's engine that is killed in its midst."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="Cyclone DDS is not installed: pip install 'fame-robots[dds]'")

from test_processes import DOMAIN, ENVIRONMENT, ROOT, Field

import fame
from fame.errors import NOT_KNOWN
from fame.robot.journal import read_segment
from fame.robot.state_tables import fold
from fame.scenario.world_process import EMPTY, PAUSE, RESUME

pytestmark = pytest.mark.processes

SMALLER = {'value="20.0"': 'value="8.0"', 'value="15.0"': 'value="6.0"'}
MODEL = (ROOT / "models" / "agriculture.bpmn").read_text()
for before, now in SMALLER.items():
    MODEL = MODEL.replace(before, now)
RENAMED = "Activity_DriveToWeed"
NOTE = (
    '<bpmn:scriptTask id="Activity_CountWeed" name="Count Weed" scriptFormat="python">'
    "<bpmn:script>counted = 1</bpmn:script></bpmn:scriptTask>"
    '<bpmn:sequenceFlow id="Flow_Count" sourceRef="Activity_CountWeed" targetRef="Event_WeedCut" />'
)
"""Another task after a weed has been cut."""
CHANGED = (
    MODEL.replace("Activity_GoTo", RENAMED)
    .replace('<bpmn:endEvent id="Event_WeedCut"', f'{NOTE}<bpmn:endEvent id="Event_WeedCut"')
    .replace(
        'sourceRef="Activity_StopBlade" targetRef="Event_WeedCut"',
        'sourceRef="Activity_StopBlade" targetRef="Activity_CountWeed"',
    )
)
CHANGED = CHANGED[: CHANGED.index("<bpmndi:BPMNDiagram")] + "</bpmn:definitions>"
ONE_MORE = (
    '<bpmn:intermediateCatchEvent id="Event_OneMore" name="one more"><bpmn:extensionElements><camunda:properties>'
    '<camunda:property name="type" value="geometry_msgs/msg/Vector3" /></camunda:properties></bpmn:extensionElements>'
    '<bpmn:signalEventDefinition signalRef="Signal_weed_position" /></bpmn:intermediateCatchEvent>'
    '<bpmn:sequenceFlow id="Flow_OneMore" sourceRef="Event_OneMore" targetRef="Event_WeedCut" />'
)
WAITS_FOR_MORE = (
    CHANGED.replace(NOTE, ONE_MORE).replace(RENAMED, "Activity_GoTo").replace("Activity_CountWeed", "Event_OneMore")
)
"""After a weed each tractor waits for another one: forever, after the last."""
ROBOTS = ("Drone", "Tractor_1", "Tractor_2")
WORLD = """
model: MODEL
world:
  bounds: [-2, -1, 9, 9]
  resolution: 0.1
  weeds:
    - {name: thistle, at: [2.5, 2]}
    - {name: dock, at: [6, 4.5]}
  robots:
    Drone: {type: drone, at: [-1, 0]}
    Tractor_1: {type: tractor, at: [-1, 6]}
    Tractor_2: {type: tractor, at: [-1, 7.5]}
seed: 1
duration: 600
"""


class Farm(Field):
    """A field of two weeds with a drone and two tractors at work, in lockstep: also a slow machine sees the same."""

    limit = 120

    def begin(self, folder: Path) -> None:
        self.folder = folder
        self.clocks = {"pause": self.node.client(PAUSE, EMPTY), "resume": self.node.client(RESUME, EMPTY)}
        (folder / "mission.bpmn").write_text(MODEL)
        (folder / "farm.yaml").write_text(WORLD.replace("MODEL", str(folder / "mission.bpmn")))
        lockstep = [word for robot in ROBOTS for word in ("--lockstep", robot)]
        self.start("world", str(folder / "farm.yaml"), "--pause", "--speed", "4", *lockstep)
        for robot in ROBOTS:
            self.begin_engine(robot)
        self.until(lambda: all(self.last(robot) for robot in ROBOTS) and self.world, "all to be there")
        code, said = self.fame("deploy", str(folder / "mission.bpmn"), "--wait", "30")
        assert code == 0, said
        self.time("resume")

    def begin_engine(self, robot: str) -> None:
        state = str(self.folder / robot)
        self.engine(robot, "--type", robot.split("_")[0].lower(), "--lockstep", "--state", state)

    def time(self, word: str) -> None:
        """Pause or resume the time of the world, at once: its state is the same from then on."""
        done: list[object] = []
        self.clocks[word].call(None, done.append)
        self.until(lambda: done, f"the world to {word}")

    def busy(self, element: str) -> str:
        """A tractor that is at an element, or nothing."""
        return next((robot for robot in ROBOTS[1:] if element in self.at(robot)), "")

    def plan(self, line: str) -> Path:
        """A plan with one line."""
        path = self.folder / "plan.yaml"
        path.write_text(f"elements: {{{line}}}\n")
        return path

    def deploy(self, model: str, *words: str) -> tuple[int, dict]:
        (self.folder / "changed.bpmn").write_text(model)
        for _ in range(5):
            code, said = self.fame("deploy", str(self.folder / "changed.bpmn"), "--migrate", "--wait", "30", *words)
            reasons = [one.get("reason", "") for one in said.get("robots", {}).values()]
            held = any("would be held for more than" in reason for reason in reasons)
            if code != NOT_KNOWN and not held:  # a machine with much to do takes longer than robots may be held
                break
        return code, said


@pytest.fixture
def farm() -> Iterator[Farm]:
    made = Farm()
    yield made
    made.close()


def visits(folder: Path, robot: str, process: str, model: str = "mission.bpmn") -> Counter[str]:
    """How often each element of a robot's process has completed in all, by its journal."""
    directory = sorted((folder / robot).glob("journal-*"))[-1]
    tables: dict = {}
    found = read_segment(directory)
    for change in found.records():
        fold(tables, change)
    program = fame.Simulation(fame.read(folder / model), process).node.engine.program
    counts: Counter[str] = Counter()
    for data in tables.get("ended", {}).values():
        each = data["counts"]
        counts.update(dict(zip(program.elements, bytes.fromhex(each) if isinstance(each, str) else each, strict=True)))
    return counts


def test_a_mission_is_migrated_while_it_runs_all_weeds_are_cut_and_nothing_starts_again(
    farm: Farm, tmp_path: Path
) -> None:
    farm.begin(tmp_path)
    farm.until(lambda: farm.busy("Event_GoTo_Odometry"), "a tractor to be on its way")
    farm.time("pause")
    kept = {robot: farm.last(robot).deployed for robot in ROBOTS}

    code, said = farm.deploy(CHANGED, "--dry-run", "--plan", str(farm.plan("")))
    assert code == 1, said
    (token,) = [one for robot in said["robots"].values() for one in robot["tokens"] if one["fate"] == "blocked"]
    assert (token["element"], token["others"]) == ("Activity_GoTo", [RENAMED])

    code, said = farm.deploy(WAITS_FOR_MORE, "--plan", str(farm.plan("")))
    assert code == 1, said
    (finding, *_) = said["findings"]
    assert "Event_OneMore" in finding["text"]
    assert finding["run"]
    assert {robot: farm.last(robot).deployed for robot in ROBOTS} == kept

    code, said = farm.deploy(CHANGED, "--plan", str(farm.plan(f"Activity_GoTo: {{to: {RENAMED}}}")))
    assert code == 0, said
    farm.until(lambda: all(farm.last(robot).deployed != kept[robot] for robot in ROBOTS), "the changed mission")
    farm.time("resume")
    farm.until(lambda: all(farm.last(robot).state == "idle" for robot in ROBOTS), "the mission to be over")
    assert [weed["cut"] is not None for weed in farm.world["weeds"].values()] == [True, True]
    assert farm.last("Drone").started == 1
    drone = visits(tmp_path, "Drone", "Process_Drone", "changed.bpmn")
    assert {drone[one] for one in ("Activity_TakeOff", "Activity_Explore", "Activity_Land")} == {1}
    tractors = sum((visits(tmp_path, robot, "Process_Tractor", "changed.bpmn") for robot in ROBOTS[1:]), Counter())
    assert tractors["Activity_CutGrass"] == 2
    assert tractors["Activity_CountWeed"] == 2
    assert tractors[RENAMED] == 2


def test_a_tractor_whose_engine_is_killed_goes_on_and_the_field_is_finished(farm: Farm, tmp_path: Path) -> None:
    farm.begin(tmp_path)
    farm.until(lambda: farm.busy("Event_GoTo_Odometry"), "a tractor to be on its way")
    robot = farm.busy("Event_GoTo_Odometry")
    farm.kill(farm.process(robot))
    farm.begin_engine(robot)
    farm.until(lambda: all(farm.last(robot).state == "idle" for robot in ROBOTS), "the mission to be over")
    assert [weed["cut"] is not None for weed in farm.world["weeds"].values()] == [True, True]
    assert [farm.last("Drone").started, farm.last("Drone").failed] == [1, 0]
    done = sum((visits(tmp_path, robot, "Process_Tractor") for robot in ROBOTS[1:]), Counter())
    assert done["Activity_GoTo"] == 2
    assert done["Activity_CutGrass"] == 2


# ---- fame run --state ------------------------------------------------------------------------------------------------


class Whole:
    """``fame run --middleware dds --state`` of the small field, and its children."""

    def __init__(self, folder: Path, speed: str) -> None:
        (folder / "mission.bpmn").write_text(MODEL)
        (folder / "farm.yaml").write_text(WORLD.replace("MODEL", str(folder / "mission.bpmn")))
        self.said = folder / "said"
        words = [
            "run",
            str(folder / "farm.yaml"),
            "--middleware",
            "dds",
            "--state",
            str(folder / "state"),
            "--speed",
            speed,
        ]
        with self.said.open("wb") as file:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "fame", *words],
                env=ENVIRONMENT | {"ROS_DOMAIN_ID": str(DOMAIN)}, cwd=ROOT, stdout=file, stderr=file,
            )  # fmt: skip

    def kill(self, *words: str) -> None:
        """Kill the child with these words in its command line, as soon as there is one."""
        until = time.monotonic() + 120
        while not (found := [item for item in Path("/proc").iterdir() if self._is_child(item, words)]):
            assert time.monotonic() < until, (words, self.said.read_text())
            time.sleep(0.1)
        (child,) = found
        os.kill(int(child.name), signal.SIGKILL)

    def _is_child(self, item: Path, words: tuple[str, ...]) -> bool:
        try:
            state, parent = (item / "stat").read_text().rpartition(")")[2].split()[:2]
            return int(parent) == self.process.pid and state != "Z" and {*words} <= {*_words(item)}
        except OSError:
            return False

    def until(self, text: str, times: int = 1) -> None:
        """Wait until it has said something so often."""
        until = time.monotonic() + 120
        while self.said.read_text().count(text) < times:
            assert time.monotonic() < until, self.said.read_text()
            assert self.process.poll() is None, self.said.read_text()
            time.sleep(0.1)

    def end(self) -> str:
        """What it has said, when it has ended by itself."""
        self.process.wait(120)
        return self.said.read_text()


def _words(item: Path) -> list[str]:
    try:
        return (item / "cmdline").read_text().split("\0")
    except OSError:
        return []


@pytest.fixture
def whole(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Whole]:
    made = Whole(tmp_path, getattr(request, "param", "2"))
    yield made
    if made.process.poll() is None:
        made.process.send_signal(signal.SIGINT)
        made.process.wait(60)


def begun(whole: Whole) -> None:
    """Wait until all robots run their mission: what ends before ends the run."""
    for robot in ROBOTS:
        whole.until(f"{robot} runs ")


@pytest.mark.parametrize("whole", ["0.25"], indirect=True)  # on a busy machine, the mission must last for all restarts
def test_a_run_starts_an_engine_again_three_times_at_most(whole: Whole) -> None:
    begun(whole)
    for times in (1, 2, 3):
        whole.kill("engine", "Tractor_1")
        whole.until(f"it is started again ({times} of 3)")
        whole.until("Tractor_1: continues its mission")  # repetitions are counted at the end
    whole.kill("engine", "Tractor_1")
    said = whole.end()
    assert whole.process.returncode == 1
    assert said.count("it is started again") == said.count("Tractor_1 was killed by SIGKILL; it is") == 3
    assert "Tractor_1 was killed by SIGKILL" in said.rpartition("it is started again")[2]


def test_a_run_whose_world_ends_says_that_it_cannot_be_resumed(whole: Whole) -> None:
    begun(whole)
    whole.kill("world")
    said = whole.end()
    assert whole.process.returncode == 1
    assert "the world has no journal, so the run cannot be resumed" in said
