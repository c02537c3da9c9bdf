"""The configuration file of processing and recording nodes: the published sections, and additions of FAME.

::

    Inputs:
      Efforts:
        Description: torque of each joint
        Topic: joint_states
        Field: [effort]                      path into the message, with indices and names: [effort, elbow_joint]
        MessageType: JointState              a key of Imports, or a whole name: sensor_msgs/msg/JointState
        Rate: 500                            Hz, expected; another rate is reported               (added)
    Outputs:
      Filtered: {Topic: effort_lp, Field: [effort], MessageType: JointState}
    Imports:
      JointState: {Package: sensor_msgs.msg, Module: JointState}
      EncoderLoss: {File: msg/EncoderLoss.msg, Package: ros_m1_messages}
    Processor: {Class: LowPass, Parameters: {cutoff: 20}}         or a list, a chain              (added)
    Frequency: 50                            Hz, of the calls                                     (added)
    QoS: {reliability: best_effort}          of all ports; a port may have its own                (added)
    Name: low_pass                           of the node; default: that of the file               (added)
    Join: {Rate: 50, Fill: hold}             of topics with rates of their own                    (added)
    Run: {Topic: input_3, Field: data, Starts: 1}    when a run begins: a digital input          (added)
    Training: {...}                          see fame.monitor.pipeline.train                      (added)

An import of an unknown type is looked for as ``<Module>.msg`` beside the file, in ``msg/`` and in
``<package>/msg/``. Files are relative to the folder of the configuration.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from os.path import isfile
from pathlib import Path
from typing import Any

from fame.config.loader import read_document
from fame.config.values import ConfigValue, Source, entries, join
from fame.dataclasses import dataclass, field, replace
from fame.errors import ConfigError, MessageError
from fame.middleware import messages, qos
from fame.middleware.interface import SIGNAL, QoS
from fame.monitor.pipeline import fields, run_trigger
from fame.monitor.pipeline.join import Join, join_of
from fame.monitor.pipeline.run_trigger import RunTrigger, trigger_of

KEYS = {
    "Inputs": "name -> topic that is read, with the keys below",
    "Outputs": "name -> topic that is published, with the keys below",
    "Imports": "name of a type -> where it is: `{Package: my_msgs, Module: Force}`, or `{File: Force.msg}`",
    "Processor": "a class, `{Class: LowPass, Parameters: {cutoff: 5}}`, or a list: each one gets what the last gave",
    "Frequency": "how often the processor is called, Hz (50)",
    "QoS": "policies of ROS 2 for all topics of the file",
    "Name": "of the node (that of the file)",
    "Join": "how topics with rates of their own become rows: `{Rate: 50, Tolerance: 0.03, Fill: hold}`",
    "Run": "when a run of the task begins and ends: a trigger, with the keys below",
    "Training": "settings of `fame monitor train`, with the keys below",
}
"""Of a configuration of a node, with their meanings."""
PORT_KEYS = {
    "Topic": "name of the topic; without a leading slash in the robot's namespace",
    "Field": "path to numbers in the message: `effort`, `[effort, 3]`, `[pose, position, x]`; without it, the message",
    "MessageType": "`pkg/msg/Type`, or a name of Imports",
    "Description": "text for people",
    "QoS": "policies of this topic",
    "Rate": "expected rate, Hz; another rate is reported",
}
"""Of an entry of Inputs or Outputs."""
_IMPORT = ("Package", "Module", "File")
FREQUENCY = 50.0
INPUT = QoS(reliability="best_effort", depth=1000)
"""QoS of inputs: it matches every publisher, and has room for what arrives while a processor runs."""


_NO_SOURCE, _NOWHERE = Source(), ConfigValue(None)


@dataclass(frozen=True, slots=True)
class Port:
    """An entry of Inputs or Outputs, or the trigger of runs. `rate` (Hz) is the expected rate of messages; 0: any. Of a
    `service` (std_srvs/srv/SetBool) that the node offers, the requests are the messages."""

    name: str
    topic: str
    type: str
    path: fields.FieldPath
    qos: QoS
    description: str = ""
    rate: float = 0.0
    service: bool = False


@dataclass(frozen=True, slots=True)
class Stage:
    """A processor to make: its class by name, values of its parameters, and its place in the configuration."""

    cls: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    place: ConfigValue = _NOWHERE

    def error(self, key: str, text: str) -> ConfigError:
        """Return an error about a key of this stage, which may be written as its class alone."""
        if isinstance(self.place.data, str):
            name = key.partition("Parameters.")[2]  # given by a mission
            return self.place.source.error(self.place.path, f"{name}: {text}" if name else text)
        return self.place.source.error(join(self.place.path, key), text)


@dataclass(frozen=True, slots=True)
class Configuration:
    """A configuration, checked against the message types."""

    file: Path
    name: str
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    stages: tuple[Stage, ...] = ()
    frequency: float = FREQUENCY
    training: ConfigValue | None = None
    source: Source = _NO_SOURCE
    join: Join | None = None
    run: RunTrigger | None = None
    trigger: Port | None = None

    @property
    def recorded(self) -> tuple[Port, ...]:
        """What files have columns of: the inputs and the trigger of runs."""
        return (*self.inputs, *([self.trigger] if self.trigger is not None else []))

    @property
    def folder(self) -> Path:
        """The folder that file names are relative to."""
        return self.file.parent


def load(path: str | Path) -> Configuration:
    """Read a configuration. Raises ConfigError with file, line and key path."""
    path = Path(path)
    document = read_document(path, "node")
    sections = document.mapping(KEYS)
    imports = {name: _import(name, value, path.parent) for name, value in entries(sections, "Imports").items()}
    policies = _policies(sections["QoS"], {}) if "QoS" in sections else {}
    inputs = _ports(sections, "Inputs", imports, policies, INPUT)
    outputs = _ports(sections, "Outputs", imports, policies, SIGNAL)
    if not inputs and not outputs and "Training" not in sections:
        raise document.error("expected the key Inputs or Outputs with at least one entry, or Training with Files")
    run, trigger = _trigger(sections["Run"], inputs, imports, policies) if "Run" in sections else (None, None)
    return Configuration(
        file=path,
        name=_node_name(sections["Name"]) if "Name" in sections else re.sub(r"\W", "_", path.stem),
        inputs=inputs,
        outputs=outputs,
        stages=stages_of(sections["Processor"]) if "Processor" in sections else (),
        frequency=hertz(sections["Frequency"]) if "Frequency" in sections else FREQUENCY,
        training=sections.get("Training"),
        source=document.source,
        join=join_of(sections["Join"]) if "Join" in sections else None,
        run=run,
        trigger=trigger,
    )


def stages_of(value: ConfigValue) -> tuple[Stage, ...]:
    """Read the section `Processor`: a stage or a list of stages, each a class or a mapping. Raises ConfigError."""
    if value.data is None:
        return ()
    items = value.items() if isinstance(value.data, list) else [value]
    return tuple(map(_stage, items))


def hertz(value: ConfigValue) -> float:
    """Read a rate (Hz). Raises ConfigError."""
    return value.number(minimum=1e-6, maximum=1e6)


def _stage(value: ConfigValue) -> Stage:
    if isinstance(value.data, str):
        return Stage(value.data, {}, value)
    parts = value.mapping(("Class", "Parameters"))
    cls = value.required("Class", "LowPass").text()
    return Stage(cls, {name: item.data for name, item in entries(parts, "Parameters").items()}, value)


def _ports(
    sections: Mapping[str, ConfigValue],
    section: str,
    imports: Mapping[str, str],
    policies: Mapping[str, Any],
    base: QoS,
) -> tuple[Port, ...]:
    given = entries(sections, section)
    ports = tuple(_port(name, value, imports, policies, base) for name, value in given.items())
    spelled: dict[str, str] = {}
    for port in ports:
        other = spelled.setdefault(port.name.lower(), port.name)
        if other != port.name:
            raise given[port.name].error(f"{other} and {port.name} differ in capitals only")
    _check_paths(given, ports, fields.writer if section == "Outputs" else None)
    return ports


def _port(name: str, value: ConfigValue, imports: Mapping[str, str], policies: Mapping[str, Any], base: QoS) -> Port:
    parts = value.mapping(PORT_KEYS)
    topic = value.required("Topic", "joint_states")
    if not re.fullmatch(r"(~?/)?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", topic.text()):
        raise topic.expected("the name of a topic")
    path = parts["Field"].data if "Field" in parts else []
    try:
        profile = qos.parse(_policies(parts["QoS"], policies) if "QoS" in parts else policies, base)
    except MessageError as error:
        raise value.source.error(join(value.path, "QoS"), str(error)) from None
    return Port(
        name=name,
        topic=topic.text(),
        type=_type(value.required("MessageType", "sensor_msgs/msg/JointState"), imports),
        path=tuple(path) if isinstance(path, list) else (path,),
        qos=profile,
        description=str(parts["Description"].data) if "Description" in parts else "",
        rate=hertz(parts["Rate"]) if "Rate" in parts else 0.0,
    )


def _trigger(
    value: ConfigValue, inputs: Sequence[Port], imports: Mapping[str, str], policies: Mapping[str, Any]
) -> tuple[RunTrigger, Port | None]:
    """Read the section `Run`: the trigger, and its topic or service if it has one. Raises ConfigError."""
    parts = value.mapping(run_trigger.KEYS)
    run = trigger_of(parts)
    if run.calls:
        if more := {*PORT_KEYS} & {*parts}:
            raise value.error(f"got the keys Service and {min(more)}: expected a topic or a service")
        parts["Topic"] = parts["Service"]
    if "Topic" not in parts:
        if inputs or "Column" not in parts:
            raise value.error("expected the key Topic: a digital input, such as {Topic: input_3, Starts: 1}")
        return run, None
    if twice := next((port for port in inputs if port.name.lower() == run.column.lower()), None):
        text = f"the value of the trigger is called {run.column}, and so is an entry of Inputs: expected another name"
        raise value.source.error(join(value.path, "Column" if "Column" in parts else "Topic"), f"{text}, {twice.name}")
    beside = next((port.type for port in inputs if port.topic == parts["Topic"].data), "std_msgs/msg/Bool")
    given = {"Field": "data", "MessageType": beside, **{key: parts[key].data for key in PORT_KEYS if key in parts}}
    port = _port(run.column, ConfigValue(given, value.path, value.source), imports, policies, INPUT)
    port = replace(port, service=run.calls)
    _check_paths({each.name: value for each in (*inputs, port)}, (*inputs, port), None)
    try:
        single = isinstance(fields.reader(port.type, port.path)(messages.create(port.type))[0], float)
    except fields.UnusableMessage:
        single = False
    if not single:
        path = join(value.path, "Field") if "Field" in parts else value.path
        raise value.source.error(path, f"expected one number or boolean of {port.type}, got several")
    return run, port


def _check_paths(given: Mapping[str, ConfigValue], ports: Sequence[Port], writer: Any) -> None:
    """Check every path against its type, and that a topic has one type. Raises ConfigError."""
    first: dict[str, Port] = {}
    for port in ports:
        value, other = given[port.name], first.setdefault(port.topic, port)
        if other.type != port.type:
            text = f"topic {port.topic} has the type {other.type} in {other.name}, {port.type} here; expected one type"
            raise value.source.error(join(value.path, "MessageType"), text)
        try:
            if writer is None:
                fields.reader(port.type, port.path)
            else:
                writer(port.type, [each.path for each in ports if each.topic == port.topic])
        except MessageError as error:
            raise value.source.error(join(value.path, "Field"), str(error)) from None


def _type(value: ConfigValue, imports: Mapping[str, str]) -> str:
    name = value.text()
    if name in imports:
        return imports[name]
    try:
        return messages.message_type(name).__msgtype__
    except MessageError as error:
        known = ", ".join(imports) or "none"
        raise value.error(f"expected a message type or one of the Imports ({known}), got {error}") from None


def _import(name: str, value: ConfigValue, folder: Path) -> str:
    """Return the full name of an imported type, read from its .msg file where it is unknown."""
    parts = {key: str(part.data) for key, part in value.mapping(_IMPORT).items()}
    package = parts.get("Package", "").removesuffix(".msg").removesuffix("/msg")
    module = parts.get("Module", name)
    try:
        if "File" in parts:
            (full,) = messages.register_files(folder / parts["File"], package)
            return full
        if not package:
            raise value.error("expected the keys Package and Module, or File")
        full = f"{package}/msg/{module}"
        found = None if full in messages.types() else _beside(folder, package, module)
        if found is not None:
            messages.register(found.read_text(encoding="utf-8"), full)
        return messages.message_type(full).__msgtype__
    except (MessageError, OSError, UnicodeDecodeError) as error:
        raise value.error(f"{error}; put a file {module}.msg beside the configuration, or use the key File") from None


def _beside(folder: Path, package: str, module: str) -> Path | None:
    places = (folder, folder / "msg", folder / package / "msg")
    return next((path for place in places if isfile(path := place / f"{module}.msg")), None)


def _policies(value: ConfigValue, general: Mapping[str, Any]) -> Mapping[str, Any]:
    given = {**general, **({} if value.data is None else {name: item.data for name, item in value.mapping().items()})}
    try:
        qos.parse(given)
    except MessageError as error:
        raise value.error(str(error)) from None
    return given


def _node_name(value: ConfigValue) -> str:
    if not isinstance(value.data, str) or not re.fullmatch(r"[A-Za-z_]\w*", value.data):
        raise value.expected("a name of ASCII letters, digits and _")
    return value.data
