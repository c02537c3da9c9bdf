"""A field of real engine processes in a DDS domain of its own, on loopback, and a stranger who may say anything."""

from __future__ import annotations

import ctypes
import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fame.clock import SECOND
from fame.deploy import STATUS_QOS, STRING, Report, model_hash
from fame.middleware.dds import DdsMiddleware, DdsScheduler
from fame.middleware.interface import LATCHED, QoS
from fame.middleware.messages import create

ROOT = Path(__file__).resolve().parents[2]
BPMN = "http://www.omg.org/spec/BPMN/20100524/MODEL"


class Fell(Exception):
    """An attack had its effect."""


class NotRun(Exception):
    """An attack cannot be made here."""


def held(holds: object, otherwise: str) -> None:
    """Raise Fell unless it holds."""
    if not holds:
        raise Fell(otherwise)


class Engine:
    """One engine process; what it says on stderr goes to a file, or to `stderr`."""

    def __init__(
        self,
        name: str,
        words: tuple[str, ...],
        environment: Mapping[str, str],
        folder: Path,
        stderr: Any,
        where: tuple[str, ...] = (),
    ) -> None:
        self.name, self.log = name, folder / f"{name}.log"
        command = [*where, sys.executable, "-m", "fame", "engine", name, *words]
        with open(self.log, "w") as log:
            out = log if stderr is None else stderr
            self.process = subprocess.Popen(command, env=environment, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=out)

    @property
    def alive(self) -> bool:
        return self.process.poll() is None

    @property
    def megabytes(self) -> int:
        """Of memory that it holds."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")) // 1000

    def holds(self) -> tuple[int, int, int]:
        """Memory (MB), threads and open files."""
        folder = Path(f"/proc/{self.process.pid}")
        return self.megabytes, len(list((folder / "task").iterdir())), len(list((folder / "fd").iterdir()))

    @property
    def said(self) -> str:
        return self.log.read_text(errors="replace")

    def tell(self, number: signal.Signals) -> None:
        self.process.send_signal(number)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def ends(self, within: float) -> bool:
        """Whether it is over soon after a Ctrl-C."""
        self.tell(signal.SIGINT)
        try:
            self.process.wait(within)
        except subprocess.TimeoutExpired:
            return False
        return True


class Forked:
    """One of the engines that one command has started: a child of its process."""

    def __init__(self, name: str, pid: int) -> None:
        self.name, self._pid = name, pid

    @property
    def alive(self) -> bool:
        return Path(f"/proc/{self._pid}").exists()

    def tell(self, number: signal.Signals) -> None:
        os.kill(self._pid, number)

    def kill(self) -> None:
        self.tell(signal.SIGKILL)
        while self.alive:  # until its parent knows
            time.sleep(0.05)


class Field:
    """See the module. All processes are ended when it closes. `long`: attacks may take as long as they like."""

    def __init__(self, domain: int, *, long: bool = False) -> None:
        self.long = long
        self.words: tuple[str, ...] = ()  # which each command has
        self.elsewhere: dict[str, tuple[str, ...]] = {}  # before the command of an engine: where it runs
        self._folder = tempfile.TemporaryDirectory(prefix="fame-attack-")
        self.folder = Path(self._folder.name)
        self.environment = os.environ | {"ROS_DOMAIN_ID": str(domain), "PYTHONPATH": str(ROOT)}
        self.scheduler = DdsScheduler()
        self.middleware = DdsMiddleware(self.scheduler, domain=domain)
        self.stranger = self.middleware.node("stranger")
        self.engines: list[Engine] = []
        self.reports: dict[str, list[Report]] = {}
        self._publishers: dict[str, Any] = {}
        self._people: list[subprocess.Popen[str]] = []

    def close(self) -> None:
        for engine in self.engines:
            if engine.alive:
                engine.process.kill()
            engine.process.wait()
        self.middleware.close()
        for person in self._people:
            person.kill()
            person.communicate()
        self._folder.cleanup()

    def enter(self, machine: int, interface: str) -> None:
        """Go over to the network namespace of a process, before anything is started."""
        self.middleware.close()
        with open(f"/proc/{machine}/ns/net") as namespace:
            held(ctypes.CDLL(None).setns(namespace.fileno(), 0) == 0, "namespace not entered")  # os.setns: Python 3.12
        self.words = ("--network", interface)
        self.scheduler = DdsScheduler()
        self.middleware = DdsMiddleware(
            self.scheduler, domain=int(self.environment["ROS_DOMAIN_ID"]), network=interface
        )
        self.stranger = self.middleware.node("stranger")

    def change_middleware(self, backend: str) -> None:
        """Go over to another middleware, before anything is started."""
        from fame.scenario.process import connect, scheduler_for

        self.middleware.close()
        os.environ["ROS_DOMAIN_ID"] = self.environment["ROS_DOMAIN_ID"]
        self.words = ("--middleware", backend)
        self.scheduler = scheduler_for(backend)
        self.middleware = connect(backend, self.scheduler)
        self.stranger = self.middleware.node("stranger")

    # ---- engines -----------------------------------------------------------------------------------------------------

    def start(self, name: str, *words: str, stderr: Any = None) -> Engine:
        """Start an engine and wait until it has spoken."""
        self.reports[name] = []
        self.stranger.subscription(f"/{name}/bpmn_status", STRING, lambda said: self._note(name, said), STATUS_QOS)
        engine = Engine(name, words, self.environment, self.folder, stderr)
        self.engines.append(engine)
        held(self.until(lambda: self.reports[name], 20), f"{name} never spoke: {engine.said}")
        return engine

    def run(self, name: str, model: str, *words: str, stderr: Any = None) -> Engine:
        """Start an engine with a process, and wait until it runs."""
        engine = self.start(name, *words, stderr=stderr)
        self.say(f"/{name}/bpmn_process", model)
        held(self.answer(name, "started", 20), f"{name} did not start: {engine.said}")
        return engine

    def _note(self, name: str, message: Any) -> None:
        report = Report.from_json(message.data)
        if report is not None:
            self.reports[name].append(report)

    def last(self, name: str) -> Report:
        return self.reports[name][-1]

    def answer(self, name: str, answer: str, within: float) -> Report | None:
        """The next report with that answer; reports before it are forgotten."""

        def found() -> Report | None:
            return next((report for report in self.reports[name] if report.answer == answer), None)

        self.until(found, within)
        report = found()
        self.reports[name].clear()
        return report

    def speaks(self, name: str, within: float = 4.0) -> bool:
        """Whether an engine says how it is, as it does every second."""
        self.pass_time(0.1)
        self.reports[name].clear()
        return self.until(lambda: self.reports[name], within)

    # ---- the stranger ------------------------------------------------------------------------------------------------

    def publisher(self, topic: str, type: str = STRING, qos: QoS | None = None, *, within: float = 60) -> Any:
        """An end of the stranger, after somebody hears it or so many seconds."""
        if topic not in self._publishers:
            usual = LATCHED if topic.endswith("_status") else QoS(depth=1000)
            self._publishers[topic] = self.stranger.publisher(topic, type, qos or usual)
            self.until(self._publishers[topic].matched, within)
        return self._publishers[topic]

    def say(self, topic: str, text: str) -> None:
        self.publisher(topic).publish(create(STRING, text))

    def pass_time(self, seconds: float) -> None:
        self.scheduler.run(self.scheduler.now + round(seconds * SECOND))

    def until(self, holds: Callable[[], object], within: float) -> bool:
        """Whether it holds before so many seconds are over."""
        end = time.monotonic() + within
        while not holds():
            if time.monotonic() > end:
                return False
            self.pass_time(0.02)
        return True

    def fame(self, *words: str, wait: float = 60) -> subprocess.CompletedProcess[str]:
        """A command of a person."""
        command = [sys.executable, "-m", "fame", *words, *self.words]
        return subprocess.run(
            command, env=self.environment, cwd=ROOT, capture_output=True, text=True, timeout=wait, check=False
        )

    def begin(self, *words: str) -> subprocess.Popen[str]:
        """The same, which goes on meanwhile."""
        return self.open([sys.executable, "-m", "fame", *words, *self.words])

    def open(self, command: list[str]) -> subprocess.Popen[str]:
        """Start a process that ends with the field."""
        pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        self._people.append(process := subprocess.Popen(command, env=self.environment, cwd=ROOT, text=True, **pipes))
        return process

    def file(self, name: str, text: str) -> str:
        path = self.folder / name
        path.write_text(text)
        return str(path)


def process(id: str, *elements: str) -> str:
    """A process of elements in a row; each has to begin with ``<tag id=...`` of its own, given as ``tag id|rest``."""
    ids = [element.split('id="', 1)[1].split('"', 1)[0] for element in elements]
    flows = "".join(
        f'<sequenceFlow id="{id}_{n}" sourceRef="{a}" targetRef="{b}"/>'
        for n, (a, b) in enumerate(itertools.pairwise(ids))
    )
    return f'<process id="{id}" isExecutable="true">{"".join(elements)}{flows}</process>'


def model(*content: str) -> str:
    return f'<definitions xmlns="{BPMN}" targetNamespace="attack">{"".join(content)}</definitions>'


START, WAIT = '<startEvent id="start"/>', '<userTask id="wait"/>'


def script(text: str, id: str = "script") -> str:
    return f'<scriptTask id="{id}" scriptFormat="python"><script><![CDATA[{text}]]></script></scriptTask>'


def scripted(text: str) -> str:
    """A model that does a script, and then waits for somebody."""
    return model(process("p", START, script(text), WAIT))


TEAM = model(
    '<collaboration id="c"><participant id="PA" name="A" processRef="pa"/>'
    '<participant id="PB" name="B" processRef="pb"/></collaboration>',
    process("pa", '<startEvent id="sa"/>', '<userTask id="ua"/>'),
    process("pb", '<startEvent id="sb"/>', '<userTask id="ub"/>'),
)


def envelope(robot: str, phase: str, deployment: str, **more: Any) -> str:
    """What a sender says."""
    said = {"fame": 1, "deployment": deployment, "sequence": round(time.time() * 1e6), "robot": robot, "phase": phase}
    if "model" in more:
        said["hash"] = model_hash(more["model"].encode())
    return json.dumps(said | more)
