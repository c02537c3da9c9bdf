"""What recording and watching cost: a run with and without a recording, an engine with and without a page, live events.

    python benchmarks/view_costs.py [recording] [watched] [live] [large] [--pairs N] [--missions A,B]

recording  `fame run` with and without ``--log``, alternately: wall clock and CPU (of all its processes), medians
watched    CPU of engines over DDS in alternate spans with and without a page: one that waits, one with 10 steps a
           second, one of the ground vehicles
large      a recording of 4 GB: time and memory of opening it and of a state in its middle (needs 4 GB of disk)
live       from a script in an engine over DDS until the page has drawn its result: median and 95th percentile
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
FAME = (sys.executable, "-m", "fame")
MISSIONS = "ground_vehicles,agriculture,warehouse,reassembly"
STAMPING = """<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" id="d" targetNamespace="t">
<process id="REX" isExecutable="true">
  <startEvent id="Start"><outgoing>f0</outgoing></startEvent>
  <sequenceFlow id="f0" sourceRef="Start" targetRef="Stamp" />
  <scriptTask id="Stamp" scriptFormat="python"><incoming>f0</incoming><incoming>f2</incoming><outgoing>f1</outgoing>
    <script>import time
stamp = time.time()</script></scriptTask>
  <sequenceFlow id="f1" sourceRef="Stamp" targetRef="Wait" />
  <intermediateCatchEvent id="Wait"><incoming>f1</incoming><outgoing>f2</outgoing>
    <timerEventDefinition id="t"><timeDuration>PT0.1S</timeDuration></timerEventDefinition></intermediateCatchEvent>
  <sequenceFlow id="f2" sourceRef="Wait" targetRef="Stamp" />
</process></definitions>"""
WAITING = """<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" id="d" targetNamespace="t">
<process id="REX" isExecutable="true">
  <startEvent id="Start"><outgoing>f0</outgoing></startEvent>
  <sequenceFlow id="f0" sourceRef="Start" targetRef="Wait" />
  <userTask id="Wait"><incoming>f0</incoming></userTask>
</process></definitions>"""
SEEN = """() => {
  fame.ages = [];
  let last = null;
  const draw = fame.draw.bind(fame);
  fame.draw = (now) => {
    draw(now);
    for (const scope of fame.state?.variables.values() ?? []) {
      const stamp = scope.values.get("stamp")?.[0];
      if (stamp !== undefined && stamp !== last) fame.ages.push(Date.now() - 1000 * stamp);
      last = stamp ?? last;
    }
  };
}"""


def recording(pairs: int, missions: list[str]) -> None:
    """Alternate runs with and without a recording."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        for mission in missions:
            command = [*FAME, "run", f"examples/{mission}.yaml", "--quiet"]
            found = [[measured(command), measured([*command, "--log", str(path)])] for _ in range(pairs)]
            for place, what in enumerate(("wall", "CPU")):
                plain, recorded = ([pair[side][place] for pair in found] for side in (0, 1))
                ratio = statistics.median(two / one for one, two in zip(plain, recorded, strict=True))
                without, with_ = statistics.median(plain), statistics.median(recorded)
                print(f"{mission}: {what} {without:.2f} s, recorded {with_:.2f} s: {ratio - 1:+.0%} ({pairs} pairs)")
            print(f"{mission}: {path.stat().st_size / 1e6:.2f} MB")


def measured(command: list[str]) -> tuple[float, float]:
    """Wall clock and CPU (s) of a command with all its processes."""
    before, begun = os.times(), time.monotonic()
    subprocess.run(command, cwd=ROOT, check=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wall, after = time.monotonic() - begun, os.times()
    return wall, sum(after[2:4]) - sum(before[2:4])


@contextmanager
def process(*words: str, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """A process of FAME, as long as the block lasts."""
    child = subprocess.Popen([*FAME, *words], cwd=ROOT, text=True, **options)
    try:
        yield child
    finally:
        child.terminate()
        child.communicate(timeout=30)


@contextmanager
def engine(text: str = STAMPING) -> Iterator[subprocess.Popen[str]]:
    """An engine of REX that runs a process; by default, it stamps the time ten times a second."""
    with tempfile.TemporaryDirectory() as folder:
        model = Path(folder) / "stamping.bpmn"
        model.write_text(text)
        with process("engine", "REX", stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as child:
            subprocess.run([*FAME, "deploy", str(model)], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
            yield child


def watched(pairs: int, span: float = 8.0) -> None:
    """CPU of engines in alternate spans: one that waits, one with 10 steps a second, one of the ground vehicles."""
    for what, text in (("that waits", WAITING), ("with 10 steps a second", STAMPING)):
        with engine(text) as child:
            time.sleep(2)
            compare(f"engine {what}", child.pid, pairs, span)
    words = ("run", "examples/ground_vehicles.yaml", "--middleware", "dds", "--quiet")
    with process(*words, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as child:
        while (pid := engine_of(child.pid, "REX")) is None:
            time.sleep(0.1)
        time.sleep(3)
        compare("engine of a ground vehicle", pid, min(pairs, 4), span)  # the mission takes 97 s


def compare(what: str, pid: int, pairs: int, span: float) -> None:
    """Print the CPU of a process over DDS without and with a page."""
    rates: list[tuple[float, float]] = []
    for _ in range(pairs):
        alone = rate(pid, span)
        with process("view", "--no-open", stdout=subprocess.DEVNULL):
            time.sleep(4)
            rates.append((alone, rate(pid, span)))
        time.sleep(1)
    plain, more = statistics.median(one for one, _ in rates), statistics.median(two - one for one, two in rates)
    print(
        f"{what}, over DDS: {plain:.2%} of a core, watched {more:+.2%} of a core "
        f"({more / plain:+.0%} of its own; median of {pairs} spans of {span:g} s)",
        flush=True,
    )


def engine_of(pid: int, robot: str) -> int | None:
    """The process of a robot's engine that a run has started."""
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        words = Path(f"/proc/{child}/cmdline").read_bytes().split(b"\0")
        if b"engine" in words and robot.encode() in words:
            return int(child)
    return None


def rate(pid: int, span: float) -> float:
    """The CPU of a process per second over a span (s)."""
    before, begun = cpu(pid), time.monotonic()
    time.sleep(span)
    return (cpu(pid) - before) / (time.monotonic() - begun)


def cpu(pid: int) -> float:
    """The CPU of a process until now (s), by all threads, exact to the nanosecond where the kernel has schedstat."""
    return sum(int(task.read_text().split()[0]) for task in Path(f"/proc/{pid}/task").glob("*/schedstat")) / 1e9


def live(pairs: int, span: float = 15.0) -> None:
    """How old a result is when it is on the screen."""
    import shutil

    from playwright.sync_api import sync_playwright

    program = shutil.which("chromium") or shutil.which("google-chrome")
    with engine(), process("view", "--no-open", stdout=subprocess.PIPE) as view, sync_playwright() as play:
        assert view.stdout is not None
        browser = play.chromium.launch(executable_path=program, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.goto(view.stdout.readline().strip())
        while not page.evaluate("window.fame && fame.state && fame.state.variables.size > 0"):
            time.sleep(0.1)
        page.evaluate(SEEN)
        time.sleep(span)
        ages = sorted(page.evaluate("fame.ages"))
        late = sum(age > 200 for age in ages) / len(ages)
        print(
            f"live: {len(ages)} results, drawn after {statistics.median(ages):.0f} ms, 95 % within "
            f"{ages[int(0.95 * len(ages))]:.0f} ms; {late:.1%} later than 200 ms"
        )
        browser.close()


OPEN = """
import resource, sys, time
from fame.log import Recording
begun = time.monotonic()
with Recording(sys.argv[1]) as recording:
    opened = time.monotonic()
    state = recording.state((recording.start + recording.end) // 2)
    sought = time.monotonic()
    assert state.robots["REX"].counts["Task"]["enter"] > 0
memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
print(f"opened in {opened - begun:.2f} s, the state in the middle in {sought - opened:.2f} s, {memory:.0f} MB")
"""


def large(pairs: int, size: int = 4_000_000_000) -> None:
    """A recording with images: each of a megabyte, which zstd cannot make smaller."""
    from fame.log.recording_file import RecordingFile

    image = os.urandom(1_000_000)
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR")) as folder:
        path = Path(folder) / "large.mcap"
        with path.open("wb") as stream:
            file = RecordingFile(stream)
            file.describe({"seed": "0"})
            camera = file.message_channel("/REX/image", "sensor_msgs/msg/CompressedImage", "/REX/camera")
            for second in range(size // len(image)):
                time_, counts = second * 1_000_000_000, f'{{"Task":{{"enter":{second}}}}}'
                robot = f'{{"process":"P","instances":[],"tokens":[],"variables":[],"counts":{counts}}}'
                file.put("/fame/key", time_, f'{{"robots":{{"REX":{robot}}}}}')
                group = '{"instance":1,"scope":1,"marks":[["Task","enter"]]}'
                file.put("/fame/events", time_, f'{{"robot":"REX","events":[{group}]}}')
                file.write(camera, time_, image)
            file.finish()
        print(f"{path.stat().st_size / 1e9:.1f} GB:", end=" ", flush=True)
        subprocess.run([sys.executable, "-c", OPEN, str(path)], check=True)


PARTS: dict[str, Callable[..., None]] = {"recording": recording, "watched": watched, "live": live, "large": large}


def main() -> None:
    """Measure what is asked for, and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="by default: recording, watched, live")
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--missions", default=MISSIONS)
    arguments = parser.parse_args()
    print(f"load: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    for name in arguments.parts or ("recording", "watched", "live"):
        if name == "recording":
            recording(arguments.pairs, arguments.missions.split(","))
        else:
            PARTS[name](arguments.pairs)


if __name__ == "__main__":
    main()
