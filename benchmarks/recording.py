"""What a recording costs, and what an engine spends on being watched.

    python benchmarks/recording.py [run] [engine] [large] [--pairs N] [--missions A,B]

run     `fame run` with and without ``--log``, alternately: CPU of all its processes and wall clock, medians of pairs.
        A recorded run as fast as possible may take 1.4 times the CPU of an unrecorded one
engine  CPU of engines over DDS in alternate spans with and without a page: one that waits, one with 10 steps a second,
        one of the ground vehicles. Being watched may take 2 % of a core
large   a recording of 4 GB: time and memory of opening it and of a state in its middle (needs 4 GB of disk)
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
_MODEL = """<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" id="d" targetNamespace="t">
<process id="REX" isExecutable="true"><startEvent id="Start" />{}</process></definitions>"""
_FLOW = '<sequenceFlow id="{0}_{1}" sourceRef="{0}" targetRef="{1}" />'
STAMPING = _MODEL.format(
    f"""{_FLOW.format("Start", "Stamp")}{_FLOW.format("Stamp", "Wait")}{_FLOW.format("Wait", "Stamp")}
<scriptTask id="Stamp" scriptFormat="python"><script>import time
stamp = time.time()</script></scriptTask>
<intermediateCatchEvent id="Wait">
<timerEventDefinition id="t"><timeDuration>PT0.1S</timeDuration></timerEventDefinition></intermediateCatchEvent>"""
)
WAITING = _MODEL.format(f'{_FLOW.format("Start", "Wait")}<userTask id="Wait" />')


def runs(pairs: int, missions: list[str]) -> None:
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
                time_, counts = second * 1_000_000_000, {"Task": {"enter": second}}
                robot = {"process": "P", "instances": [], "tokens": [], "variables": [], "counts": counts}
                file.put("/fame/key", time_, {"robots": {"REX": robot}})
                group = {"instance": 1, "scope": 1, "marks": [["Task", "enter"]]}
                file.put("/fame/events", time_, {"robot": "REX", "events": [group]})
                file.write(camera, time_, image)
            file.finish()
        print(f"{path.stat().st_size / 1e9:.1f} GB:", end=" ", flush=True)
        subprocess.run([sys.executable, "-c", OPEN, str(path)], check=True)


PARTS: dict[str, Callable[..., None]] = {"run": runs, "engine": watched, "large": large}


def main() -> None:
    """Measure what is asked for, and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="by default: run, engine")
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--missions", default=MISSIONS)
    arguments = parser.parse_args()
    print(f"load: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    for name in arguments.parts or ("run", "engine"):
        if name == "run":
            runs(arguments.pairs, arguments.missions.split(","))
        else:
            PARTS[name](arguments.pairs)


if __name__ == "__main__":
    main()
