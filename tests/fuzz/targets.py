"""Every reader of bytes that others wrote: what it reads, valid input for it, and how that is damaged.

A reader reads its input or raises `FameError`. A script may raise any error when it is run: its engine handles it.
"""

from __future__ import annotations

import io
import json
import random as random_numbers
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache, partial
from itertools import islice
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

from fame.deploy.options import EngineOptions
from fame.errors import ConfigError, FameError, MessageError

from .mutations import Mutate, json_lines, json_text, text_or_bytes, xml, zipped

ROOT = Path(__file__).resolve().parents[2]
NOW = 1_800_000_000.0
"""The date of everything that is read (s since 1970)."""


@dataclass(frozen=True)
class Target:
    """A reader. `accepted`: errors besides FameError that its callers handle. `needs`: packages of an extra."""

    name: str
    read: Callable[[bytes], object]
    seeds: Callable[[], Sequence[bytes]]
    mutate: Mutate
    accepted: tuple[type[BaseException], ...] = ()
    needs: tuple[str, ...] = ()
    slow: bool = False

    def input(self, number: int) -> bytes:
        """The input with this number: the same each time."""
        random = Random(f"{self.name} {number}")
        seeds = self.valid
        return self.mutate(random, random.choice(seeds), seeds)

    @property
    def valid(self) -> Sequence[bytes]:
        """Valid input, made once."""
        return _valid(self.seeds)


@cache
def _valid(seeds: Callable[[], Sequence[bytes]]) -> Sequence[bytes]:
    return seeds()


@cache
def _folder() -> Path:
    """A folder for files to read, which ends with this process."""
    _folder.kept = TemporaryDirectory(prefix="fuzz-")  # type: ignore[attr-defined]
    return Path(_folder.kept.name)  # type: ignore[attr-defined]


def _file(name: str, data: bytes) -> Path:
    path = _folder() / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data)
    path.chmod(0o600)
    return path


def _text(data: bytes) -> str:
    return data.decode(errors="replace")


def _loose(data: bytes) -> str:
    """A text that may have lone surrogates, as JSON does."""
    return data.decode(errors="surrogatepass") if _is_loose(data) else _text(data)


def _is_loose(data: bytes) -> bool:
    try:
        data.decode(errors="surrogatepass")
    except UnicodeDecodeError:
        return False
    return True


def _examples(*patterns: str) -> list[bytes]:
    return [path.read_bytes() for pattern in patterns for path in sorted(ROOT.glob(pattern))]


def _texts(*texts: str) -> Callable[[], Sequence[bytes]]:
    return lambda: [text.encode() for text in texts]


# ---- JSON on topics --------------------------------------------------------------------------------------------------


def read_process(data: bytes) -> None:
    """`bpmn_process`: an envelope or a bare model, its signature, its plan."""
    from fame.deploy.envelope import read_envelope
    from fame.deploy.migration import plan_of
    from fame.deploy.request_verifier import RequestVerifier

    envelope = read_envelope(_loose(data), "REX", NOW)
    envelope.to_json()
    with suppress(ConfigError):
        plan_of(envelope.plan)
    RequestVerifier("REX", 5, [_key().public_key()], lambda: NOW).verify_deployment(envelope)


def _envelopes() -> list[bytes]:
    from dataclasses import replace

    from fame.deploy.envelope import Envelope, model_hash, signed

    model = (ROOT / "models/shuttle.bpmn").read_text()
    whole = Envelope(
        deployment="d", sequence=round(NOW * 1e6), robot="REX", phase="load", hash=model_hash(model.encode()),
        model=model,
        promises={"/go": "publisher"}, team=["REX", "DINGO"], engines={"REX": "5 ", "DINGO": "6 "}, migrate=True,
        plan={"moves": {"A": "B"}, "set": {"x": 1}}, who="somebody",
    )  # fmt: skip
    proof = json.loads(signed(replace(whole, model=""), _key(), born=5, now=NOW).to_json())
    del proof["fame"], proof["proof"]
    others = [replace(whole, phase=phase, model="", plan={}) for phase in ("hold", "start", "abort")]
    asking = replace(others[0], phase="ask", proof=proof)
    return [signed(each, _key(), born=5, now=NOW).to_json().encode() for each in (whole, *others, asking)]


@cache
def _key() -> Any:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    return Ed25519PrivateKey.from_private_bytes(bytes(range(32)))


def read_status(data: bytes) -> None:
    """`bpmn_status`: a report, its signature, what becomes of tokens, and how people are shown it."""
    from fame.deploy.authentication import ReportReader, proves_presence
    from fame.deploy.envelope import Problem, Report
    from fame.deploy.migration import Foreseen

    report = Report.from_json(_loose(data))
    ReportReader("REX", signed=True, trusted=[_key().public_key()]).read(_loose(data), 1.0)
    if report is not None:
        report.to_json()
        str(Problem(**report.problem))
        with suppress(TypeError, AttributeError, ValueError):  # `boundary` refuses it
            Foreseen.from_json(report.migration)
        proves_presence(report, "REX", [_key().public_key()], NOW)


def _reports() -> list[bytes]:
    from fame.deploy.envelope import Report

    problem = {"file": "a.bpmn", "line": 3, "element": "T", "text": "is wrong", "name": "Turn"}
    token = {"element": "T", "fate": "stays", "target": "T", "reason": "", "name": "Turn", "others": ["U"]}
    report = Report(
        robot="REX", state="running", hash="0" * 64, deployed="d", sequence=7, deployment="d", answer="ready",
        reason="no",
        problem=problem, migration={"hash": "", "tokens": [token], "gone": [], "state": {"a": 1}}, instances=1,
        waits=[{"element": "T", "for": "a message", "since": 1.5, "topics": {"/go": 1}, "place": "P",
        "suspended": "x"}],
        untaken={"/go": 2}, offers=["A"], absent={"DINGO": 2.5}, warnings=["w"], errors=[{**problem, "code": "script"}],
        incidents=[{"element": "T", "code": "c", "text": "t"}], now=5.0, born=5, time=7.5, key="AAAA", voucher="AAAA",
        signature="AAAA",
    )  # fmt: skip
    return [report.to_json().encode(), Report(robot="REX", state="waiting", born=5).to_json().encode()]


def read_task(data: bytes) -> None:
    """`bpmn_task`: a request of a person, and its signature."""
    from fame.deploy.request_verifier import RequestVerifier
    from fame.deploy.requests import read_request

    request = read_request(_loose(data))
    request.to_json()
    RequestVerifier("REX", 5, [_key().public_key()], lambda: NOW).verify_task(request)


def _requests() -> list[bytes]:
    from fame.deploy.requests import TaskRequest

    plain = [
        TaskRequest(id="1", element="T", values={"approved": True, "x": [1, {"y": None}]}, who="somebody"),
        TaskRequest(id="2", element="T", act="move", to="U"),
        TaskRequest(id="3", element="", act="set", values={"x": 1.5}),
        TaskRequest(id="4", element="", act="take_over", lease="5"),
    ]
    return [each.signed("REX", _key(), born=5, now=NOW).to_json().encode() for each in plain]


def read_splitter(data: bytes) -> None:
    """`/fame_splitter` and `/collaboration_diagram` of signed teams."""
    from fame.deploy.authentication import DiagramReader
    from fame.deploy.leader_election import SplitterStatus

    status = SplitterStatus.from_json(_loose(data))
    if status is not None:
        status.is_believed([_key().public_key()], NOW)
        status.to_json()
        return
    DiagramReader([_key().public_key()]).read(_loose(data), "deploy", NOW)


def _splitters() -> list[bytes]:
    from fame.deploy.authentication import Diagram
    from fame.deploy.leader_election import SplitterStatus

    status = SplitterStatus(born=5, state="keeping", deployed="0" * 64, text="deployed").signed(_key(), NOW)
    diagram = Diagram.of("<definitions/>", purpose="deploy", now=NOW, key=_key())
    return [status.to_json().encode(), diagram.to_json().encode()]


def read_signal(data: bytes) -> None:
    """`bpmn_signal` and `bpmn_answer`: acknowledged signals, and answers to them."""
    from fame.middleware import messages

    scheduler, publishers = _receiver()
    for publisher in publishers:
        publisher.publish(messages.create("std_msgs/msg/String", _loose(data)))
    scheduler.run(scheduler.now + 10**7)


@cache
def _receiver() -> tuple[Any, list[Any]]:
    """A robot that throws and catches an acknowledged signal, and publishers to it."""
    from fame.bpmn.reader import read_text
    from fame.clock import Scheduler
    from fame.middleware.local import LocalMiddleware
    from fame.robot import RobotNode, make_mission

    scheduler = Scheduler()
    middleware = LocalMiddleware(scheduler)
    properties = (
        '<c:property name="type" value="std_msgs/msg/Int32"/><c:property name="delivery" value="acknowledged"/>'
    )
    tick = f"<extensionElements><c:properties>{properties}</c:properties></extensionElements>"
    tick += '<signalEventDefinition signalRef="S"/>'
    definitions = read_text(
        '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="t"'
        ' xmlns:c="http://camunda.org/schema/1.0/bpmn"><signal id="S" name="tick"/><process id="p" isExecutable="true">'
        f'<startEvent id="s"/><intermediateThrowEvent id="t">{tick}</intermediateThrowEvent>'
        f'<intermediateCatchEvent id="c">{tick}</intermediateCatchEvent>'
        '<sequenceFlow id="f" sourceRef="s" targetRef="t"/><sequenceFlow id="g" sourceRef="t" targetRef="c"/>'
        '<sequenceFlow id="h" sourceRef="c" targetRef="t"/></process></definitions>',
        file="tick.bpmn",
    )
    mission = make_mission(definitions, definitions.processes[0])
    node = RobotNode("REX", mission, scheduler=scheduler, middleware=middleware)
    node.load()
    node.start()
    other = middleware.node("other")
    topics = "/REX/bpmn_signal/tick", "/REX/bpmn_answer/tick"
    return scheduler, [other.publisher(topic, "std_msgs/msg/String") for topic in topics]


def _signals() -> list[bytes]:
    signal = {
        "robot": "A",
        "life": "a",
        "sequence": 0,
        "receiver": "1",
        "follows": 0,
        "number": 1,
        "data": "AAEAAAcAAAA=",
    }
    answer = {"robot": "B", "life": "b", "sender": "1", "number": 1, "left": False}
    return [json.dumps(one).encode() for one in (signal, answer)]


def read_events(data: bytes) -> None:
    """`bpmn_events`: batches of a robot, as the view and the recorder of a team take them."""
    from fame.clock import Scheduler
    from fame.log.live_team import LiveTeam
    from fame.text import read_json

    scheduler = Scheduler()
    team = LiveTeam(None, None, scheduler, lambda topic, time, text: None)
    for line in data.split(b"\n"):
        with suppress(ValueError):
            team.feed("REX", read_json(_loose(line)))
    scheduler.run(until=10**10)


def _batches() -> list[bytes]:
    from fame.clock import Scheduler
    from fame.deploy.engine_node import EngineNode
    from fame.deploy.envelope import PROCESS_QOS, STRING
    from fame.middleware import messages
    from fame.middleware.local import LocalMiddleware
    from fame.robot.robot_state import EVENTS_TOPIC

    scheduler = Scheduler()
    middleware, found = LocalMiddleware(scheduler), []
    engine = EngineNode("REX", scheduler=scheduler, middleware=middleware, options=EngineOptions(wall_time=lambda: NOW))
    observer = middleware.node("observer")
    observer.subscription(f"/REX/{EVENTS_TOPIC}", STRING, lambda message: found.append(message.data.encode()))
    sender = observer.publisher("/REX/bpmn_process", STRING, PROCESS_QOS)
    model = (ROOT / "models/shuttle.bpmn").read_text()
    scheduler.after(10**9, lambda: sender.publish(messages.create(STRING, model)))
    scheduler.run(until=6 * 10**9)
    engine.close()
    assert found
    return [b"\n".join(found)]


# ---- messages and recordings -----------------------------------------------------------------------------------------

TYPES = (
    "std_msgs/msg/String", "sensor_msgs/msg/JointState", "nav_msgs/msg/Odometry", "sensor_msgs/msg/PointCloud2",
    "diagnostic_msgs/msg/DiagnosticArray", "rcl_interfaces/msg/ParameterEvent", "std_msgs/msg/Empty",
    "nav_msgs/msg/Path",
)  # fmt: skip
"""The first byte of an input says which of these it claims to be."""


def read_cdr(data: bytes) -> None:
    """A message on the wire."""
    from fame.middleware import codec, messages

    if data:
        messages.to_mapping(codec.deserialize(data[1:], TYPES[data[0] % len(TYPES)]))


def _cdr() -> list[bytes]:
    from fame.middleware import codec, messages

    values: list[Any] = [
        "text", {"name": ["a", "b"], "position": [1.0, 2.0]}, {"child_frame_id": "base"}, {"data": list(range(20))},
        {"status": [{"name": "n", "values": [{"key": "k", "value": "v"}]}]}, {"node": "/a"}, {}, {"poses": [{}, {}]},
    ]  # fmt: skip
    return [
        bytes([number]) + codec.serialize(messages.create(type, value))
        for number, (type, value) in enumerate(zip(TYPES, values, strict=True))
    ]


def read_definition(data: bytes) -> None:
    """A `.msg` or `.action` file, and a message of its type."""
    from fame.middleware import definitions

    name = "fuzz_msgs/action/Drive" if b"---" in data else "fuzz_msgs/msg/Wheel"
    for each in definitions.from_text(_text(data), name):
        with suppress(MessageError):  # of a type that is not here
            definitions.check_size(each.name, lambda name, each=each: each if name == each.name else None, {})


def read_recording(data: bytes) -> None:
    """A recording: everything that it has."""
    from fame.log import Recording
    from fame.log.recording import models_of
    from fame.mining.conversion import convert

    path = _file("run.mcap", data)
    with Recording(path) as recording:
        models_of(recording)
        _ = recording.runs, recording.world(recording.end), recording.ground(recording.end)
        recording.state((recording.start + recording.end) // 2)
        for message in recording.messages():
            recording.decode(message)
    for suffix in (".jsonl", ".csv", ".xes", ".ocel.json"):
        convert(path, _folder() / f"converted{suffix}")


def read_bag(data: bytes) -> None:
    """A bag in MCAP, SQLite or of ROS 1: the messages of each topic."""
    from fame.log.bag_reader import open_bag

    with open_bag(_file("bag", data)) as reader:
        for name in reader.topics:
            with suppress(FameError):
                list(reader.messages([name]))


def _bags() -> list[bytes]:
    from mcap.writer import CompressionType, Writer
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin, Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    type, folder = "geometry_msgs/msg/PoseStamped", _folder() / "sqlite"
    store = get_typestore(Stores.ROS2_JAZZY)
    text, sent = store.generate_msgdef(type, ros_version=2)[0].encode(), bytes(4) + bytes(80)
    found = []
    for compression in CompressionType:
        stream = io.BytesIO()
        writer = Writer(stream, compression=compression)
        writer.start(profile="ros2")
        channel = writer.register_channel("/pose", "cdr", writer.register_schema(type, "ros2msg", text))
        for number in range(5):
            writer.add_message(channel, number, sent, number)
        writer.finish()
        found.append(stream.getvalue())
    with Writer2(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as second:
        second.write(second.add_connection("/pose", type, typestore=store), 1, sent)
    found.append((folder / "sqlite.db3").read_bytes())
    for kind in (*Writer1.CompressionFormat, None):
        first = Writer1(folder / f"{kind}.bag")
        if kind is not None:
            first.set_compression(kind)
        with first:
            first.write(first.add_connection("/pose", type, typestore=store), 1, bytes(80))
        found.append((folder / f"{kind}.bag").read_bytes())
    return found


@cache
def _run() -> bytes:
    from fame.log import logging_to
    from fame.scenario import Scenario

    scenario = Scenario.load(ROOT / "examples/ground_vehicles.yaml", duration=4)
    path = _folder() / "valid.mcap"
    with logging_to(path, scenario.closures()) as log:
        scenario.run(observer=log)
    return path.read_bytes()


def read_channels(data: bytes) -> None:
    """A recording whose messages are these lines: [topic, time, content]; others are left out."""
    from fame.log.channels import CHANNELS
    from fame.log.recording_file import RecordingFile

    stream = io.BytesIO()
    file = RecordingFile(stream)
    file.describe({})
    for line in data.split(b"\n"):
        with suppress(ValueError, RecursionError):
            match json.loads(line):
                case [str(topic), int(time), content] if topic in CHANNELS and 0 <= time < 2**63:
                    file.put(topic, time, content)
    file.finish()
    read_recording(stream.getvalue())


def _channels() -> list[bytes]:
    from fame.log import Recording

    path = _file("valid.mcap", _run())
    with Recording(path) as recording:
        lines = [
            json.dumps([each.topic, each.time, each.json()]) for each in recording.messages() if each.data[:1] == b"{"
        ]
    picked = random_numbers.Random(1).sample(lines, min(40, len(lines)))
    return ["\n".join(lines[:25]).encode(), "\n".join(lines[-25:]).encode(), "\n".join(picked).encode()]


def read_log(data: bytes) -> None:
    """A log of a run as JSON Lines or CSV: the way of its tokens, and what properties say of it."""
    from fame.log.reading import rows_of

    suffix = ".jsonl" if data[:1] == b"{" else ".csv"
    with rows_of(_file(f"run{suffix}", data)) as rows:
        list(rows)
    judge_log(suffix, data)


def judge_log(suffix: str, data: bytes, **columns: str) -> None:
    """A log of events, judged by properties; `columns`: as one of another tool."""
    from fame.log.judge import judge_log

    judge_log(_file(f"run{suffix}", data), *_judging(), columns=columns)


@cache
def _judging() -> tuple[Sequence[Any], Any]:
    """The properties and the model of the run from which logs are made."""
    from fame.bpmn.reader import read
    from fame.properties import parse

    model = read(ROOT / "models/ground_vehicles.bpmn")
    return [parse(sentence) for sentence in _SENTENCES], model


def _converted(suffix: str) -> bytes:
    from fame.mining.conversion import convert

    convert(_file("valid.mcap", _run()), _folder() / f"valid{suffix}")
    return (_folder() / f"valid{suffix}").read_bytes()


def _xes() -> list[bytes]:
    """A log with the first events of each trace."""
    from lxml import etree

    root = etree.fromstring(_converted(".xes"))
    for trace in root.findall("{*}trace"):
        for event in trace.findall("{*}event")[10:]:
            trace.remove(event)
    return [etree.tostring(root)]


def _logs() -> list[bytes]:
    return [b"\n".join(_converted(suffix).split(b"\n")[:60]) for suffix in (".jsonl", ".csv")]


_SENTENCES = (
    "REX completes within 300 s", "REX fails at most 0 times", 'never DINGO fails at "Go To" with "no way"',
    'after DINGO throws /done until DINGO completes "Fire", some DINGO starts "Go To" within 1.5e1 min',
    "between REX starts and DINGO ends, never distance(REX, DINGO) <= 0.4 and REX.battery != 1",
    "always REX.map[0].x > -1e3 and REX.done == true", 'DINGO reports "fired" only after DINGO is cancelled at "Go To"',
    "after DINGO throws /done, exists DINGO throws /done where x >= 1 and y[2].z == \"a\" with the same data",
    "DINGO starts each time only after REX starts", "always /REX/odom.pose.pose.position.x < 6 until REX ends",
)  # fmt: skip


def read_sentence(data: bytes) -> None:
    """The sentence of a property, and its monitor for a team."""
    from fame.log.judge import judge_log
    from fame.properties import parse

    judge_log(_valid_log(), [parse(_loose(data))], _judging()[1])


@cache
def _valid_log() -> Path:
    return _file("judged.jsonl", _logs()[0])


_PROCESSOR = """from fame.monitor import Parameter
class Power:
    outputs, parameters = ("power",), [Parameter("gain", "float", 1.0, (0, 10), unit="")]
    def __init__(self, gain=1.0, *, mode="a", **more): self.gain = gain
    def execute(self, inputs): return None
"""


def read_processor(data: bytes) -> None:
    """The text of a processor of others, which a check reads and does not run."""
    from fame.monitor.pipeline.stand_in import look_up

    look_up("own.py:Power", _file("own.py", data).parent)


def read_coverage(data: bytes) -> None:
    """The coverage of tests, as a page for people who sign has it."""
    from fame.scenario.explore.coverage_file import read_coverage
    from fame.scenario.explore.safety_report import safety_report

    coverage = read_coverage(_file("coverage.json", data))
    result, scenario = _explored()
    safety_report(result, scenario, command="", version="", faults=True, coverage=coverage).encode()


@cache
def _explored() -> tuple[Any, Any]:
    from fame.scenario import Scenario
    from fame.scenario.explore.exploration import explore

    path = ROOT / "models/ground_vehicles.bpmn"
    return explore(path, limit=10), Scenario.load(path)


def _coverages() -> list[bytes]:
    process = {
        "file": str(ROOT / "models/ground_vehicles.bpmn"), "name": "REX", "elements": {"covered": 1, "total": 2},
        "flows": {"covered": 0, "total": 1}, "tests": {"a": ["test_a", "test_b"], "b": []},
        "missing": [{"id": "b", "name": "Turn", "line": 3}, {"id": "c", "name": "", "line": 4}],
        "excused": {"d": "cannot happen"},
    }  # fmt: skip
    return [json.dumps({"percent": 50.0, "requirements": {"R1": ["test_a"]}, "processes": [process]}).encode()]


# ---- models and expressions ------------------------------------------------------------------------------------------


def read_model(data: bytes) -> None:
    """A model as a splitter or a robot receives it."""
    from fame.bpmn import topic_table
    from fame.bpmn.library import Library
    from fame.bpmn.pools import pools_of
    from fame.bpmn.reader import read_bytes, read_text
    from fame.bpmn.split import split
    from fame.check.gate import refuse_errors

    definitions = read_bytes(data, file="a.bpmn")
    topic_table(definitions)
    definitions = read_text(_text(data), file="a.bpmn", sent=True)
    refuse_errors(definitions, [pool.process for pool in pools_of(definitions)], Library(), sent=True)
    split(definitions, Library())


def check_model(data: bytes) -> None:
    """A model as `fame check`, `fame draw` and `fame convert` read it."""
    from fame.bpmn.conversion import convert
    from fame.bpmn.draw.diagram import draw
    from fame.bpmn.reader import read_bytes
    from fame.check import check

    definitions = read_bytes(data, file="a.bpmn")
    check(definitions, guidelines=True)
    draw(definitions)
    convert(definitions)


def _models() -> list[bytes]:
    found = _examples("models/*.bpmn", "models/library/*.bpmn", "tests/models/*/*.bpmn", "tests/other_tools/*")
    return [each for each in found if len(each) < 40_000]


class _RaisedByScript(Exception):
    """A script or expression raised an error when it was run."""


def evaluate(language: Any, data: bytes) -> None:
    """An expression of a model: compiled, and evaluated with some variables."""
    from fame.bpmn.model import Expression
    from fame.scripting.budget import BudgetExceeded
    from fame.scripting.interface import interface
    from fame.scripting.languages import compile_expression, compile_script

    script = language in ("python", "javascript") and data.endswith(b"\n")
    expression = Expression(_text(data), language, 1)
    run = (compile_script if script else compile_expression)(expression, file="a.bpmn", element="T")
    if language == "python":
        return  # it has no sandbox: it is compiled and never run
    names = interface(robot=None, signal=lambda *given: None, log=lambda *given: None, budget=100_000)
    try:
        run(
            {
                "x": 3,
                "xs": [1, 2, 3],
                "robot": {"name": "REX", "battery": 0.5},
                "t": "2026-01-01",
                "__builtins__": names,
            }
        )
    except (RecursionError, MemoryError):
        raise
    except (Exception, BudgetExceeded) as error:
        raise _RaisedByScript from error


def _feel() -> list[bytes]:
    import yaml

    cases = yaml.safe_load((ROOT / "tests/feel/cases.yaml").read_text())
    return [str(case[0]).encode() for topic in cases.values() for case in topic]


_SCRIPTS = (
    "x = 1\nfor i in range(3):\n    x += i\n", "await sleep(1.0)\nlog(f'{x!r}')\n", "[i for i in xs if i]",
    "lambda a, *b, c=1: a",
    "match x:\n    case {'a': [1, *rest]} if rest:\n        pass\n",
    "async for m in robot.subscribe('odom'):\n    break\n",
)  # fmt: skip
_JAVASCRIPTS = (
    "let y = x + 1;\nthis.environment.variables.y = y;\nnext();\n", "next(null, [1, 2, 3].map(n => n * x));\n",
    "x > 2 && xs.length == 3",
    "({a: [1, {b: null}], c: `t${x}`})", "for (const i of xs) { if (i > 1) break; }\nnext();\n",
    "JSON.parse('{\"a\": 1e400}')",
    "new Promise(done => done(1)).then(() => next());\n",
)  # fmt: skip


def read_javascript_value(data: bytes) -> None:
    """A value that a realm gives back."""
    from fame.scripting.javascript.values import decode, encode

    encode(decode(json.dumps(json.loads(data))))


# ---- files of the user -----------------------------------------------------------------------------------------------


def read_yaml(data: bytes) -> None:
    """A scenario, world, pipeline or learning file, whichever its keys say."""
    from fame.config.loader import parse_document
    from fame.monitor.anomaly import learning_file
    from fame.monitor.pipeline import configuration
    from fame.scenario.scenario import Scenario
    from sim2d.config import read_world

    keys = parse_document(_text(data)).data
    keys = keys if isinstance(keys, dict) else {}
    path = _file("examples/read.yaml", data)
    link = _folder() / "models"
    if not link.exists():
        link.symlink_to(ROOT / "models")
    if "Inputs" in keys or "Outputs" in keys:
        configuration.load(path)
    elif "Files" in keys:
        learning_file.load(path)
    elif "model" in keys:
        Scenario.load(path)
    else:
        read_world(path)


def _yaml() -> list[bytes]:
    found = _examples("examples/*.yaml", "models/monitoring/**/*.yaml", "tests/**/*.yaml")
    return [each for each in found if len(each) < 20_000]


def read_journal(data: bytes) -> None:
    """The state of an engine: every record of it."""
    from fame.robot.journal import read_segment

    list(read_segment(_file("journal-00000001", data)).records())


def _journal() -> list[bytes]:
    from fame.robot.journal import Journal, StateDirectory

    with TemporaryDirectory() as name:
        directory = StateDirectory(name)
        journal = Journal(directory, {"robot": "REX", "envelope": "deployment-1"})
        journal.begin_segment({"engine": {"tokens": [1, 2], "values": {"x": 1}}})
        for number in range(8):
            journal.append({"set": {"x": number}, "text": "ü" * number})
        journal.close()
        data = directory.segments()[0].read_bytes()
        directory.close()
    return [data]


def journal_lines(random: Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """Damage of a journal whose checksums fit again, as often as not."""
    if random.random() < 0.4:
        return text_or_bytes(random, data, others)
    lines, seed = data.split(b"\n"), 0
    with suppress(ValueError, LookupError, TypeError):
        number = random.randrange(len(lines))
        sequence, synced, text = lines[number][9:].split(b" ", 2)
        text = json_text(random, text, others)
        sequence = random.choice((sequence, b"-1", b"9" * 30, b"1_0", sequence))
        content = b"%s %s %s" % (sequence, synced, text)
        seed = 0 if number == 0 else zlib.crc32(json.loads(lines[0][9:].split(b" ", 2)[2])["journal"].encode())
        lines[number] = b"%08x %s" % (zlib.crc32(content, seed), content)
    return b"\n".join(lines)


def read_promise(data: bytes) -> None:
    """What an engine before was ready to start, with its checksum: of bare envelopes it is written here."""
    from contextlib import closing
    from hashlib import sha256

    from fame.clock import Scheduler
    from fame.deploy.resumption import StateKeeper
    from fame.robot.journal import StateDirectory

    whole = data if data[64:65] == b"\n" else sha256(data).hexdigest().encode() + b"\n" + data
    with closing(StateDirectory(_folder() / "state")) as directory:
        (directory.path / "promise").write_bytes(whole)
        for trusted in ([], [_key().public_key()]):
            with suppress(ConfigError):
                StateKeeper(directory, "REX", Scheduler(), lambda text: None).promised(trusted)


def read_trained_model(data: bytes) -> None:
    """A trained detector, or a model of an arm."""
    from fame.monitor.model_card import load_any

    load_any(_file("read.skops", data))


def read_table(data: bytes) -> None:
    """A table of numbers."""
    from fame.monitor.data_files import read_labelled_runs
    from fame.monitor.tables import read_table

    path = _file("runs.csv", data)
    read_table(path, recorded=True)
    read_labelled_runs([path])


_TABLES = (
    "stamp,effort_0,effort_1,label\n" + "".join(f"{n / 10},{n},{-n}e-3,{n % 2}\n" for n in range(30)),
    "run;stamp;a\n1;0.0;1\n1;0.1;nan\n2;0.0;\n", "2026-01-01T00:00:00Z,1\nx,y\n",
)  # fmt: skip


def read_key(data: bytes) -> None:
    """A file of keys, of each kind."""
    from fame.deploy import signing

    path = _file("a.key", data)
    for read in (lambda: signing.read_trusted([path]), lambda: signing.read_private(path)):
        with suppress(ConfigError):
            read()
    signing.read_identity(path, "REX")


def _keys() -> list[bytes]:
    from fame.deploy import signing

    with TemporaryDirectory() as name:
        secret, public = signing.new_keys(Path(name) / "team")
        signing.new_identity("REX", _key(), Path(name) / "REX.key")
        return [secret.read_bytes(), public.read_bytes() * 2, (Path(name) / "REX.key").read_bytes()]


def read_time(data: bytes) -> None:
    """A date, duration or cycle of a timer."""
    from fame import iso8601

    for read in (iso8601.parse_datetime, iso8601.parse_duration):
        with suppress(ValueError):
            str(read(_text(data)))
    with suppress(ValueError):
        now = datetime(2026, 1, 1, tzinfo=UTC)
        list(islice(iso8601.parse_cycle(_text(data)).due_times(now), 5))


DEFINITIONS = (
    "fame/middleware/interfaces/**/*.action",
    "fame/middleware/interfaces/**/*.msg",
    "tests/ros_workspace/**/*.action",
)
TARGETS = tuple(
    Target(name, read, seeds, mutate, **more)
    for name, read, seeds, mutate, more in (
        ("process", read_process, _envelopes, json_text, {"needs": ("cryptography",)}),
        ("status", read_status, _reports, json_text, {"needs": ("cryptography",)}),
        ("task", read_task, _requests, json_text, {"needs": ("cryptography",)}),
        ("splitter", read_splitter, _splitters, json_text, {"needs": ("cryptography",)}),
        ("signal", read_signal, _signals, json_text, {}),
        ("events", read_events, _batches, json_lines, {}),
        ("cdr", read_cdr, _cdr, text_or_bytes, {}),
        ("definition", read_definition, partial(_examples, *DEFINITIONS), text_or_bytes, {}),
        ("recording", read_recording, lambda: [_run()], text_or_bytes, {"slow": True, "needs": ("pymunk",)}),
        ("bag", read_bag, _bags, text_or_bytes, {"slow": True}),
        ("channels", read_channels, _channels, json_lines, {"slow": True, "needs": ("pymunk",)}),
        ("log", read_log, _logs, text_or_bytes, {"needs": ("pymunk",)}),
        ("xes", partial(judge_log, ".xes"), _xes, xml, {"needs": ("pymunk",)}),
        ("foreign_xes", partial(judge_log, ".xes", element="element"), _xes, xml, {"needs": ("pymunk",)}),
        ("ocel", partial(judge_log, ".ocel.json"), lambda: [_converted(".ocel.json")], json_text,
         {"needs": ("pymunk",)}),
        ("sentence", read_sentence, _texts(*_SENTENCES), text_or_bytes, {"needs": ("pymunk",)}),
        ("processor", read_processor, _texts(_PROCESSOR, _PROCESSOR.replace(", parameters", "\n    parameters")),
         text_or_bytes, {}),
        ("coverage", read_coverage, _coverages, json_text, {}),
        ("model", read_model, _models, xml, {"slow": True}),
        ("check", check_model, _models, xml, {"slow": True}),
        *(
            (language, partial(evaluate, language), seeds, text_or_bytes, {"accepted": (_RaisedByScript,), **more})
            for language, seeds, more in (
                ("feel", _feel, {}),
                ("juel", _texts("${x > 2 && empty xs}", "${robot.name == 'REX' ? xs[0] : x % 2}", "a ${x} b ${t}"), {}),
                ("value", _texts("a ${x}", "[1, 2, {a: b}]", "= x + 1", "{a: ${x}, b: [1.5, true]}", "- 1\n- ${t}"),
                {}),
                ("payload", _texts("{x: ${x}, y: ${nothing}}", "={a: x, b: xs}", "data: ${t}\nlist: [${x}]"), {}),
                ("python", _texts(*_SCRIPTS), {}),
                ("javascript", _texts(*_JAVASCRIPTS), {"needs": ("quickjs",)}),
            )
        ),
        ("javascript-value", read_javascript_value, _texts('{"a": [1, "x", null, 1.5]}', '["\\u0000NaN"]'), json_text,
         {"accepted": (ValueError, RecursionError)}),
        ("yaml", read_yaml, _yaml, text_or_bytes, {"needs": ("pymunk", "sklearn")}),
        ("journal", read_journal, _journal, journal_lines, {}),
        ("promise", read_promise, _envelopes, json_text, {"needs": ("cryptography",)}),
        ("trained-model", read_trained_model, partial(_examples, "models/*.skops"), zipped,
         {"slow": True, "needs": ("sklearn", "skops")}),
        ("table", read_table, _texts(*_TABLES), text_or_bytes, {}),
        ("keys", read_key, _keys, text_or_bytes, {"needs": ("cryptography",)}),
        ("time", read_time, _texts("P1DT2H", "R3/PT5S", "2026-01-01T00:00:00+02:00", "R/2026-01-01T00:00:00Z/PT1M"),
         text_or_bytes, {}),
    )
)  # fmt: skip
BY_NAME = {target.name: target for target in TARGETS}
assert len(BY_NAME) == len(TARGETS)
