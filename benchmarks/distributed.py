"""What engines in processes of their own cost and how fast they are, on loopback: a table, or JSON.

round trip    throw -> the other robot's catch -> throw -> catch, between two engine processes; beside it a ping-pong of
              bare Cyclone or Zenoh (and of rclpy, where it is installed) with the same message, in turns, so that all
              meet the same noise. Of the engines every round is counted whole: with the gateway and the script of the
              loop.
start         of one engine, until it is there: processor time, memory
deployment    from the first word to the last robot's "started", by two phases; the first one of engines apart
twenty        engines started at once: until all have been found, and until all run their process; beside it how much
              else the machine had to do, and what went over loopback
hundred       a hundred, all started by one command, only if it is asked for; engines:30 with another number, apart:30
              each by a command of its own
messages      how many messages a second go from one process to another
idle          an engine whose process waits: share of a core, memory
redeployed    the same engine after 10 and after 1000 new processes: memory, threads, files, DDS entities

Engines find their bytecode, as installed ones do: the first start writes it, in a folder that goes with the run.

Run as ``python benchmarks/distributed.py [--json] [--middleware dds|zenoh|ros] [CASE ...]``. Nothing else should
run meanwhile.
"""

from __future__ import annotations

import atexit
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import partial
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import trips

from fame.bpmn.library import Library
from fame.bpmn.reader import read, read_text
from fame.clock import SECOND
from fame.deploy import STATUS_QOS, STRING, Deployment, Report
from fame.deploy.options import DeploymentOptions
from fame.middleware.interface import QoS
from fame.middleware.messages import create
from fame.scenario.process import PARENT, connect, scheduler_for

ROOT = Path(__file__).resolve().parents[1]
DOMAIN = 1 + os.getpid() % 90
ROUNDS, TRIPS = 6, 1000
PATIENCE = 180.0
ENDING = 20.0  # s
LONGEST = 1800  # s
FIELDS: list[Field] = []
"""All that were made, to end their engines whatever happens."""
REST = 5.0  # s after which engines have loaded what they will need
BYTECODE: dict[str, str] = {}
MIDDLEWARE = ["dds"]
REACH: list[str] = []
NETWORK: list[Any] = [None]
"""What engines are told of the network, and what this process opens: for `lossy_network`."""


@dataclass(frozen=True, slots=True)
class Row:
    """A line of the table."""

    case: str
    value: float
    unit: str = ""
    goal: str = ""


HEAD = '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" xmlns:camunda="http://camunda.org/schema/1.0/bpmn"'


def _event(tag: str, id: str, signal: str, payload: str = "") -> str:
    said = f'<camunda:property name="payload" value="{payload}"/>' if payload else ""
    return (
        f'<{tag} id="{id}"><extensionElements><camunda:properties><camunda:property name="type" value="{STRING}"/>'
        f'{said}</camunda:properties></extensionElements><signalEventDefinition signalRef="{signal}"/></{tag}>'
    )


def _flows(prefix: str, *ids: str) -> str:
    return "".join(
        f'<sequenceFlow id="{prefix}{n}" sourceRef="{a}" targetRef="{b}"/>' for n, (a, b) in enumerate(pairwise(ids))
    )


SIGNALS = "".join(f'<signal id="{name}" name="{name}"/>' for name in ("go", "ping", "pong", "result"))
PING_PONG = f"""{HEAD} targetNamespace="t">{SIGNALS}<collaboration id="c">
<participant id="A" name="A" processRef="pa"/><participant id="B" name="B" processRef="pb"/></collaboration>
<process id="pa">{_event("startEvent", "sa", "go")}
<scriptTask id="begin"><script>import time
text, times = "{trips.PAYLOAD}", [time.perf_counter_ns()]</script></scriptTask>
<exclusiveGateway id="again"/>{_event("intermediateThrowEvent", "ask", "ping", "${text}")}
{_event("intermediateCatchEvent", "answered", "pong")}
<scriptTask id="note"><script>times.append(time.perf_counter_ns())</script></scriptTask>
<exclusiveGateway id="enough" default="more"/>
<scriptTask id="tell"><script>result = str([b - a for a, b in zip(times, times[1:])])</script></scriptTask>
{_event("endEvent", "ea", "result", "${result}")}
{_flows("a", "sa", "begin", "again", "ask", "answered", "note", "enough")}{_flows("z", "tell", "ea")}
<sequenceFlow id="more" sourceRef="enough" targetRef="again"/>
<sequenceFlow id="over" sourceRef="enough" targetRef="tell">
<conditionExpression>len(times) &gt; {TRIPS}</conditionExpression></sequenceFlow></process>
<process id="pb"><startEvent id="sb"/><exclusiveGateway id="back"/>{_event("intermediateCatchEvent", "asked", "ping")}
{_event("intermediateThrowEvent", "answer", "pong", "${ping}")}
{_flows("b", "sb", "back", "asked", "answer", "back")}</process></definitions>"""


def _waiting(name: str, pool: str) -> str:
    """A process that waits forever at an event `name`."""
    return f"""{HEAD} targetNamespace="t"><signal id="S" name="never"/><collaboration id="c">
<participant id="P" name="{pool}" processRef="p"><participantMultiplicity minimum="1"/></participant></collaboration>
<process id="p"><startEvent id="s"/><intermediateCatchEvent id="{name}"><signalEventDefinition signalRef="S"/>
</intermediateCatchEvent>{_flows("f", "s", name)}</process></definitions>"""


class Field:
    """Engines in processes of their own, and a participant that deploys to them and hears them."""

    def __init__(self, domain: int, *robots: str, together: bool = False) -> None:
        os.environ["ROS_DOMAIN_ID"] = str(domain)
        self.scheduler = scheduler_for(MIDDLEWARE[0])
        own = {
            "ROS_DOMAIN_ID": str(domain),
            "PYTHONPATH": os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH")))),
            PARENT: str(os.getpid()),
        }
        environment = {**os.environ, **BYTECODE, **own}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        self.began = time.monotonic()
        self.engines = {
            names[0]: subprocess.Popen(
                [sys.executable, "-m", "fame", "engine", *names, *_middleware(), *_kind(names[0])],
                env=environment,
                process_group=0,
            )
            for names in ([robots] if together else zip(robots, strict=True))
        }
        FIELDS.append(self)
        # Engines that start together meet in their own process, which is to be the first.
        self.middleware: Any = connect(MIDDLEWARE[0], self.scheduler, NETWORK[0], crowd=len(robots) * together)
        self.node = self.middleware.node("benchmark")
        self.last: dict[str, Report] = {}
        for robot in robots:
            self.node.subscription(f"/{robot}/bpmn_status", STRING, partial(self._hear, robot), STATUS_QOS)
        self.until(lambda: len(self.last) == len(robots))
        self.found = time.monotonic() - self.began

    def _hear(self, robot: str, message: Any) -> None:
        report = Report.from_json(message.data)
        if report is not None:
            self.last[robot] = report
            self.scheduler.stop()  # look whether it is what somebody waits for

    def until(self, holds: Callable[[], object]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not holds():
            if time.monotonic() > deadline:
                raise SystemExit(f"waited {PATIENCE:g} s; last: {self.last}")
            self.scheduler.run(self.scheduler.now + SECOND // 50)

    def deploy(self, model: Any, *only: str) -> float:
        """How long it took until the last robot had started (s)."""
        number = time.time_ns()
        sent = Deployment(
            model,
            id=f"benchmark-{number}",
            sequence=number // 1000,
            scheduler=self.scheduler,
            middleware=self.middleware,
            ended=lambda deployment: self.scheduler.stop(),
            options=DeploymentOptions(only=only, library=Library(), patience=PATIENCE),
        )
        sent.begin()
        while not sent.done:
            self.scheduler.run()
        if sent.failed:
            raise SystemExit(f"not deployed: {list(map(str, sent.robots.values()))}")
        self.scheduler.run(self.scheduler.now + SECOND // 100)
        sent.close()
        return max(each.took for each in sent.robots.values())

    def processes(self) -> list[int]:
        """The processes of all engines, and of what has forked them."""
        own = [engine.pid for engine in self.engines.values()]
        forked = [Path(f"/proc/{pid}/task/{pid}/children").read_text().split() for pid in own]
        return own + [int(pid) for pids in forked for pid in pids]

    def close(self) -> None:
        """End all engines: politely, and after a while by force."""
        for engine in self.engines.values():
            engine.send_signal(signal.SIGINT)
        deadline = time.monotonic() + ENDING
        try:
            for engine in self.engines.values():
                engine.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            print(f"engines were ended by force after {ENDING:g} s", file=sys.stderr)
        finally:
            self.kill()
        self.middleware.close()

    def kill(self) -> None:
        """End all engines at once, with what they have forked."""
        for engine in self.engines.values():
            with suppress(ProcessLookupError):
                os.killpg(engine.pid, signal.SIGKILL)
            engine.wait()


def _middleware() -> list[str]:
    """ROS confines discovery, not sockets, so that an engine asks for keys or for this word."""
    return ["--middleware", MIDDLEWARE[0], *REACH, *(["--insecure"] if MIDDLEWARE == ["ros"] else [])]


def _kind(robot: str) -> list[str]:
    """What a tractor's engine is told, so that it brings it to a stop before another process begins."""
    return ["--type", "tractor"] if robot.startswith("Tractor") else []


@contextmanager
def field(*robots: str, together: bool = False) -> Iterator[Field]:
    """Engines of a domain of their own; started `together`, by one command."""
    global DOMAIN
    DOMAIN += 1
    made = Field(DOMAIN, *robots, together=together)
    try:
        yield made
    finally:
        made.close()


# ---- the cases -----------------------------------------------------------------------------------------------------


def round_trip() -> Iterator[Row]:
    """Engines, the bare middleware and rclpy in turns."""
    if MIDDLEWARE == ["zenoh"]:
        import zenoh_trips as plain

        name = "bare Zenoh"
    else:
        import dds as plain

        name = "bare Cyclone"
    echo = subprocess.Popen([sys.executable, plain.__file__, "bare", str(trips.DOMAIN)])
    try:
        with field("A", "B") as team:
            team.deploy(read_text(PING_PONG, file="ping_pong.bpmn"))
            kinds: dict[str, Callable[[int], list[int]]] = {name: plain.bare(), "engines": partial(_trips, team)}
            if find_spec("rclpy") is not None:
                kinds["rclpy"] = rclpy_trips()
            time.sleep(1)
            times: dict[str, list[int]] = {kind: [] for kind in kinds}
            for number in range(ROUNDS + 1):
                for kind, trip in kinds.items():
                    taken = trip(TRIPS)
                    times[kind] += taken if number else []  # the first round warms up
    finally:
        echo.kill()
        echo.wait()
    medians = {kind: median(taken) / 1000 for kind, taken in times.items()}
    for kind, taken in times.items():
        tail = sorted(taken)[len(taken) * 99 // 100] / 1000
        yield Row(f"round trip, {kind}: median", round(medians[kind]), "us")
        yield Row(f"round trip, {kind}: 99 of 100", round(tail), "us")
    ratio = medians["engines"] / medians[name]
    yield Row(f"round trip, engines / {name}", round(ratio, 2), "", goal="<= 2")
    if "rclpy" in medians:
        ratio = medians["engines"] / medians["rclpy"]
        yield Row("round trip, engines / rclpy", round(ratio, 2), "", goal="< 1")


def _trips(team: Field, number: int) -> list[int]:
    """Let robot A make its round trips."""
    told: list[str] = []
    end = team.node.subscription("/result", STRING, lambda message: told.append(message.data))
    go = team.node.publisher("/go", STRING)
    team.middleware.wait_matched(["/result", "/go"], PATIENCE)
    go.publish(create(STRING, "go"))
    deadline = time.monotonic() + PATIENCE
    while not told and time.monotonic() < deadline:
        time.sleep(0.1)  # asleep, so as not to disturb
        team.scheduler.run(team.scheduler.now + SECOND // 1000)
    end.close()
    go.close()
    taken: list[int] = json.loads(told[0])
    return taken[:number]


def rclpy_trips() -> trips.Trips:
    """A ping-pong between two processes of plain rclpy nodes."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from std_msgs.msg import String

    child = subprocess.Popen([sys.executable, __file__, "rclpy-echo"])
    atexit.register(child.kill)
    rclpy.init()
    node = rclpy.create_node("asker")
    executor = SingleThreadedExecutor()  # kept, as in a program that spins
    executor.add_node(node)
    heard: list[Any] = []
    publisher = node.create_publisher(String, "/rclpy_ping", 100)
    node.create_subscription(String, "/rclpy_pong", heard.append, 100)
    while not (publisher.get_subscription_count() and node.count_publishers("/rclpy_pong")):
        executor.spin_once(timeout_sec=0.1)

    def ask(number: int) -> list[int]:
        taken = []
        for _ in range(number):
            began = time.perf_counter_ns()
            publisher.publish(String(data=trips.PAYLOAD))
            heard.clear()
            while not heard:
                executor.spin_once()
            taken.append(time.perf_counter_ns() - began)
        return taken

    return ask


def rclpy_echo() -> None:
    """The other process of it."""
    import rclpy
    from std_msgs.msg import String

    rclpy.init()
    node = rclpy.create_node("echo")
    publisher = node.create_publisher(String, "/rclpy_pong", 100)
    node.create_subscription(String, "/rclpy_ping", publisher.publish, 100)
    rclpy.spin(node)


def start() -> Iterator[Row]:
    """One engine alone, several times."""
    used, held = [], []
    for _ in range(5):
        with field("R") as team:
            used.append(_cpu(team.engines["R"].pid))
            held.append(_memory(team.engines["R"].pid))
    yield Row("start of an engine, processor time: median", round(median(used), 2), "s")
    yield Row("start of an engine, memory", round(median(held) / 1e6, 1), "MB")


def deployment() -> Iterator[Row]:
    """Two robots of a small collaboration, then one with the largest model that comes with FAME."""
    small, large = read_text(PING_PONG, file="ping_pong.bpmn"), read(ROOT / "models" / "agriculture.bpmn")
    lone = read(ROOT / "models" / "agriculture_return.bpmn")
    with field("A", "B", "Tractor_1") as team:
        yield Row("deployment, engines just started: two robots", round(team.deploy(small) * 1e3), "ms")
        yield Row("deployment, engines just started: a tractor", round(team.deploy(large, "Tractor_1") * 1e3), "ms")
    with field("A", "B", "Tractor_1") as team:
        time.sleep(REST)
        yield Row("deployment, the first: two robots", round(team.deploy(small) * 1e3), "ms", goal="< 100")
        yield Row("deployment, the first: a tractor", round(team.deploy(large, "Tractor_1") * 1e3), "ms", goal="< 100")
        took = [team.deploy(small) for _ in range(20)]
        yield Row("deployment, two robots: median", round(median(took) * 1e3, 1), "ms", goal="< 100")
        yield Row("deployment, two robots: slowest of 20", round(max(took) * 1e3, 1), "ms")
        for topic, type in (("cmd_vel", "Twist"), ("blade_force", "Wrench")):  # as a tractor's motors listen
            team.node.subscription(f"/Tractor_1/{topic}", f"geometry_msgs/msg/{type}", lambda message: None)
        for name, model in (("Cut the weed", large), ("Drive home", lone)):
            took = [team.deploy(model, "Tractor_1") for _ in range(21)][1:]
            yield Row(f"deployment, a tractor's {name!r}: median", round(median(took) * 1e3, 1), "ms", goal="< 100")


def twenty() -> Iterator[Row]:
    """Twenty engines, all started at once."""
    yield from _many(20, found=10, running=10)


def hundred() -> Iterator[Row]:
    """A hundred, by one command."""
    yield from engines(100)


def engines(number: int) -> Iterator[Row]:
    """As many as are asked for, by one command, with goals in proportion to those for a hundred."""
    found, running = max(5, 15 * number // 100), max(10, 30 * number // 100)
    yield from _many(number, found=found, running=running, together=True)


def apart(number: int) -> Iterator[Row]:
    """The same, each engine by a command of its own."""
    yield from _many(number, found=max(5, 15 * number // 100), running=max(10, 30 * number // 100))


def _many(number: int, found: int, running: int, *, together: bool = False) -> Iterator[Row]:
    robots = [f"R_{number}" for number in range(1, number + 1)]
    yield Row("load of the machine before", round(os.getloadavg()[0], 1))
    before = _loopback_bytes()
    with field(*robots, together=together) as team:
        sent = (_loopback_bytes() - before) / number
        yield Row(f"{number} engines, until all are found", round(team.found, 1), "s", goal=f"< {found}")
        used = sum(map(_cpu, team.processes()))
        yield Row(f"{number} engines, processor time of each until found", round(used / number, 2), "s")
        yield Row(f"{number} engines, discovery traffic of each", round(sent / 1000), "kB")
        yield Row(f"{number} engines, of that for each other engine", round(sent / 1000 / (number - 1), 2), "kB")
        took = team.deploy(read_text(_waiting("here", "R"), file="many.bpmn"))
        team.until(lambda: all(report.instances for report in team.last.values()))
        total = time.monotonic() - team.began
        used = sum(map(_cpu, team.processes()))
        held = sum(map(_part_of_memory, team.processes()))
        yield Row(f"{number} engines, deployment to all", round(took * 1e3), "ms")
        yield Row(f"{number} engines, until all run their process", round(total, 1), "s", goal=f"< {running}")
        yield Row(f"{number} engines, processor time of each until they run", round(used / number, 2), "s")
        yield Row(f"{number} engines, memory of each, shared memory divided", round(held / number / 1e6, 1), "MB")


def _loopback_bytes() -> int:
    """What has gone over loopback since the machine, or this network namespace, began."""
    lines = Path("/proc/self/net/dev").read_text().splitlines()
    (counts,) = [line.split(":")[1].split() for line in lines if line.strip().startswith("lo:")]
    return int(counts[8])


def messages() -> Iterator[Row]:
    """From this process to another one, as fast as it takes them."""
    number, domain = 20_000, DOMAIN + 60
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    scheduler, taken = scheduler_for(MIDDLEWARE[0]), list[str]()
    middleware: Any = connect(MIDDLEWARE[0], scheduler)
    node = middleware.node("sender")
    publisher = node.publisher("/many", STRING, QoS(history="keep_all", depth=1))
    node.subscription("/taken", STRING, lambda message: (taken.append(message.data), scheduler.stop()))
    child = subprocess.Popen([sys.executable, __file__, "count", MIDDLEWARE[0], str(number)])
    try:
        middleware.wait_matched(["/many", "/taken"], PATIENCE)
        time.sleep(1)
        message = create(STRING, trips.PAYLOAD)
        for _ in range(number):
            publisher.publish(message)
        scheduler.run(scheduler.now + 30 * SECOND)
    finally:
        child.kill()
        child.wait()
        middleware.close()
    seconds, count = json.loads(taken[0]) if taken else (30.0, 0)
    yield Row("messages, taken a second", round(count / seconds), "1/s")
    yield Row("messages, lost", number - count)


def count(middleware: str, number: int) -> None:
    """The other process: it counts messages until no more come."""
    scheduler = scheduler_for(middleware)
    node = connect(middleware, scheduler).node("counter")
    times: list[float] = []
    node.subscription("/many", STRING, lambda _: times.append(time.monotonic()), QoS(history="keep_all", depth=1))
    out = node.publisher("/taken", STRING)

    def look(last: int) -> None:
        if times and (len(times) >= number or len(times) == last):
            out.publish(create(STRING, json.dumps([times[-1] - times[0], len(times)])))
        else:
            scheduler.after(SECOND, partial(look, len(times)))

    look(0)
    scheduler.run()


def idle() -> Iterator[Row]:
    """An engine that waits for what does not come."""
    with field("R_1") as team:
        team.deploy(read_text(_waiting("here", "R"), file="idle.bpmn"))
        pid = team.engines["R_1"].pid
        time.sleep(2)
        before, began = _cpu(pid), time.monotonic()
        time.sleep(20)
        share = (_cpu(pid) - before) / (time.monotonic() - began)
        yield Row("idle engine, share of a core", round(100 * share, 2), "%", goal="< 1")
        yield Row("idle engine, memory", round(_memory(pid) / 1e6, 1), "MB", goal="< 80")


def redeployed() -> Iterator[Row]:
    """What 1000 processes leave behind that 10 did not."""
    with field("R_1") as team:
        out = team.node.publisher("/R_1/bpmn_process", STRING)
        team.middleware.wait_matched(["/R_1/bpmn_process"], PATIENCE)
        pid, measured = team.engines["R_1"].pid, []
        for number in range(1, 1001):
            model = _waiting(f"here_{number % 3}", "R")
            before = team.last["R_1"].started, team.last["R_1"].deployed
            out.publish(create(STRING, model))
            team.until(lambda was=before: (team.last["R_1"].started, team.last["R_1"].deployed) != was)
            if number in (10, 1000):
                time.sleep(3)
                team.scheduler.run(team.scheduler.now + SECOND // 10)
                measured.append(_holdings(team, pid))
        for what, unit in (("memory", "MB"), ("threads", ""), ("files", ""), ("endpoints", "")):
            after_10, after_1000 = (held[what] for held in measured)
            yield Row(f"redeployed, {what} after 10", after_10, unit)
            yield Row(f"redeployed, {what} after 1000", after_1000, unit, goal="the same")


def _holdings(team: Field, pid: int) -> dict[str, float]:
    ends = [name for info in team.middleware.graph() for name in (*info.publishers, *info.subscribers)]
    return {
        "memory": round(_memory(pid) / 1e6, 1),
        "threads": len(os.listdir(f"/proc/{pid}/task")),
        "files": len(os.listdir(f"/proc/{pid}/fd")),
        "endpoints": sum("fame_engine" in name for name in ends),
    }


def _cpu(pid: int) -> float:
    """CPU time that a process has used (s)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _memory(pid: int) -> int:
    """Resident memory (bytes)."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def _part_of_memory(pid: int) -> int:
    """Resident memory (bytes), but of what processes share, only its part."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("Pss:"))


def write_bytecode() -> None:
    """All that an engine needs, as if it had been installed."""
    with field("Tractor_1") as team:
        team.deploy(read(ROOT / "models" / "agriculture.bpmn"), "Tractor_1")


CASES: dict[str, Callable[[], Iterator[Row]]] = {
    "round_trip": round_trip,
    "start": start,
    "deployment": deployment,
    "twenty": twenty,
    "messages": messages,
    "idle": idle,
    "redeployed": redeployed,
    "hundred": hundred,
}
ON_REQUEST = ("hundred",)


def kill_all() -> None:
    for each in FIELDS:
        each.kill()


def give_up(number: int, _: object) -> None:
    """End at once, and all engines."""
    kill_all()
    raise SystemExit(f"ended by signal {number}")


def main() -> None:
    words = [word for word in sys.argv[1:] if word != "--json"]
    if words[:1] == ["count"]:
        count(words[1], int(words[2]))
        return
    if "--middleware" in words:
        place = words.index("--middleware")
        MIDDLEWARE[:] = words[place + 1 : place + 2]
        del words[place : place + 2]
    if words == ["rclpy-echo"]:
        rclpy_echo()
        return
    for word in words:
        for case in (engines, apart):
            if word.startswith(f"{case.__name__}:"):
                CASES[word] = partial(case, int(word.partition(":")[2]))
    unknown = [word for word in words if word not in CASES]
    if unknown:
        print(f"no case {', '.join(unknown)}; there are {', '.join(CASES)}", file=sys.stderr)
        raise SystemExit(2)
    rows = []
    atexit.register(kill_all)
    for number in (signal.SIGTERM, signal.SIGALRM):
        signal.signal(number, give_up)
    signal.alarm(LONGEST)
    with tempfile.TemporaryDirectory() as folder:
        BYTECODE["PYTHONPYCACHEPREFIX"] = folder
        write_bytecode()
        for name in words or [case for case in CASES if case not in ON_REQUEST]:
            for row in CASES[name]():
                rows.append(row)
                if "--json" not in sys.argv:
                    print(f"{row.case:<52} {f'{row.value:g} {row.unit}':>10}   {row.goal}".rstrip(), flush=True)
    if "--json" in sys.argv:
        print(json.dumps([asdict(row) for row in rows], indent=2))


if __name__ == "__main__":
    main()
