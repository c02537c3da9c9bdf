"""The configuration of processing and recording nodes: the published sections, and those that were added.

::

    Inputs:
      Efforts:
        Description: torque of each joint
        Topic: joint_states
        Field: [effort]                      path into the message, with indices and names: [effort, elbow_joint]
        MessageType: JointState              a key of Imports, or a whole name: sensor_msgs/msg/JointState
        Rate: 500                            Hz, that are expected; reported if others come       (added)
    Outputs:
      Filtered: {Topic: effort_lp, Field: [effort], MessageType: JointState}
    Imports:
      JointState: {Package: sensor_msgs.msg, Module: JointState}
      EncoderLoss: {File: msg/EncoderLoss.msg, Package: ros_m1_messages}
    Processor: {Class: LowPass, Parameters: {cutoff: 20}}         or a list: one after the other  (added)
    Frequency: 50                            Hz, of the calls                                     (added)
    QoS: {reliability: best_effort}          of all; an entry may have its own                    (added)
    Name: low_pass                           of the node; default: that of the file               (added)
    Training: {...}                          see fame.monitor.pipeline.train                              (added)

An import whose type is not known is looked for as ``<Module>.msg`` beside the file, in ``msg/`` and in
``<package>/msg/``. Files are relative to the folder of the configuration.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fame.config.loader import read_document
from fame.errors import ConfigError, MessageError
from fame.middleware import messages, qos
from fame.middleware.interface import SIGNAL, QoS
from fame.monitor.pipeline import fields, writing

_SECTIONS = ("Inputs", "Outputs", "Imports", "Processor", "Frequency", "QoS", "Name", "Training")
_PORT = ("Topic", "Field", "MessageType", "Description", "QoS", "Rate")
_IMPORT = ("Package", "Module", "File")
FREQUENCY = 50.0
INPUT = QoS(reliability="best_effort", depth=1000)
"""Of inputs: hears every publisher, and has room for what comes while a processor is at work."""


@dataclass(frozen=True, slots=True)
class Port:
    """An entry of Inputs or Outputs. `rate` (Hz) is what is expected to arrive; 0: anything."""

    name: str
    topic: str
    type: str
    path: fields.Path
    qos: QoS
    description: str = ""
    rate: float = 0.0


@dataclass(frozen=True, slots=True)
class Stage:
    """A processor to make: its class by name, and values of its parameters."""

    cls: str
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Configuration:
    """A configuration, checked against the message types."""

    file: Path
    name: str
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    stages: tuple[Stage, ...] = ()
    frequency: float = FREQUENCY
    training: Mapping[str, Any] | None = None

    @property
    def folder(self) -> Path:
        """What names of files are relative to."""
        return self.file.parent


def load(path: str | Path) -> Configuration:
    """Read a configuration. Raises ConfigError with file, line and key path."""
    path = Path(path)
    document = read_document(path, "node")
    try:
        return _configuration(path, document.data)
    except ConfigError as error:
        if error.file:
            raise
        raise document.source.error(error.element, error.text) from None


def stages_of(value: Any) -> tuple[Stage, ...]:
    """The section `Processor`. Raises ConfigError."""
    items = value if isinstance(value, list) else [value] if value is not None else []
    stages = []
    for number, item in enumerate(items):
        key = "Processor" if len(items) == 1 else f"Processor[{number}]"
        parts = _mapping({"Class": item} if isinstance(item, str) else item, key, ("Class", "Parameters"))
        if not isinstance(parts.get("Class"), str):
            raise ConfigError("needs a Class, such as {Class: LowPass}", element=key)
        stages.append(Stage(parts["Class"], _mapping(parts.get("Parameters") or {}, f"{key}.Parameters", None)))
    return tuple(stages)


def _configuration(path: Path, content: Any) -> Configuration:
    sections = _mapping(content, "", _SECTIONS)
    imports = {
        str(name): _imported(path.parent, str(name), value)
        for name, value in _mapping(sections.get("Imports") or {}, "Imports", None).items()
    }
    general = _policies(sections.get("QoS") or {}, "QoS", {})
    inputs, outputs = (_ports(sections, section, imports, general) for section in ("Inputs", "Outputs"))
    if not inputs and not outputs:
        raise ConfigError("has neither Inputs nor Outputs", element="Inputs")
    return Configuration(
        file=path,
        name=_node_name(sections.get("Name", re.sub(r"\W", "_", path.stem))),
        inputs=inputs,
        outputs=outputs,
        stages=stages_of(sections.get("Processor")),
        frequency=hertz(sections.get("Frequency", FREQUENCY), "Frequency"),
        training=sections.get("Training"),
    )


def _ports(
    sections: Mapping[str, Any], section: str, imports: Mapping[str, str], general: Mapping[str, Any]
) -> tuple[Port, ...]:
    entries = _mapping(sections.get(section) or {}, section, None)
    ports = tuple(
        _port(str(name), value, f"{section}.{name}", imports, general, INPUT if section == "Inputs" else SIGNAL)
        for name, value in entries.items()
    )
    spelled: dict[str, str] = {}
    for port in ports:
        other = spelled.setdefault(port.name.lower(), port.name)
        if other != port.name:
            raise ConfigError(f"{other} and {port.name} differ in capitals only", element=section)
    _check_paths(section, ports)
    return ports


def _port(name: str, value: Any, key: str, imports: Mapping[str, str], general: Mapping[str, Any], base: QoS) -> Port:
    parts = _mapping(value, key, _PORT)
    for needed in ("Topic", "MessageType"):
        if not isinstance(parts.get(needed), str) or not parts[needed]:
            raise ConfigError(f"found {parts.get(needed)!r}; a text would be right", element=f"{key}.{needed}")
    path = parts.get("Field", [])
    path = tuple(path) if isinstance(path, list) else (path,)
    topic = parts["Topic"]
    if not re.fullmatch(r"(~?/)?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", topic):
        raise ConfigError(f"found {topic!r}, which is no name of a topic", element=f"{key}.Topic")
    try:
        profile = qos.parse(_policies(parts.get("QoS") or {}, f"{key}.QoS", general), base)
    except MessageError as error:
        raise ConfigError(str(error), element=f"{key}.QoS") from None
    return Port(
        name=name,
        topic=topic,
        type=_type(parts["MessageType"], imports, f"{key}.MessageType"),
        path=path,
        qos=profile,
        description=str(parts.get("Description", "")),
        rate=hertz(parts["Rate"], f"{key}.Rate") if "Rate" in parts else 0.0,
    )


def _check_paths(section: str, ports: Sequence[Port]) -> None:
    """Every path against its type, every topic against one type. Raises ConfigError."""
    types: dict[str, Port] = {}
    for port in ports:
        other = types.setdefault(port.topic, port)
        if other.type != port.type:
            text = f"topic {port.topic} is {other.type} in {other.name}, {port.type} here; a topic has one type"
            raise ConfigError(text, element=f"{section}.{port.name}.MessageType")
        try:
            if section == "Inputs":
                fields.reader(port.type, port.path)
            else:
                together = [each for each in ports if each.topic == port.topic]
                writing.writer(port.type, [each.path for each in together])
        except MessageError as error:
            raise ConfigError(str(error), element=f"{section}.{port.name}.Field") from None


def _type(name: str, imports: Mapping[str, str], key: str) -> str:
    if name in imports:
        return imports[name]
    try:
        return messages.message_type(name).__msgtype__
    except MessageError as error:
        known = ", ".join(imports) or "nothing"
        raise ConfigError(f"Imports has {known}, and {error}", element=key) from None


def _imported(folder: Path, name: str, value: Any) -> str:
    """The full name of the type of an import, read from its .msg file if need be."""
    key = f"Imports.{name}"
    parts = _mapping(value, key, _IMPORT)
    package = str(parts.get("Package", "")).removesuffix(".msg").removesuffix("/msg")
    module = str(parts.get("Module", name))
    try:
        if "File" in parts:
            (full,) = messages.register_files(folder / str(parts["File"]), package)
            return full
        if not package:
            raise ConfigError("needs a Package and a Module, or a File", element=key)
        full = f"{package}/msg/{module}"
        found = None if full in messages.types() else _beside(folder, package, module)
        if found is not None:
            messages.register(found.read_text(encoding="utf-8"), full)
        return messages.message_type(full).__msgtype__
    except (MessageError, OSError, UnicodeDecodeError) as error:
        text = f"{error}; a file {module}.msg beside the configuration, or the key File, would give it"
        raise ConfigError(text, element=key) from None


def _beside(folder: Path, package: str, module: str) -> Path | None:
    places = (folder, folder / "msg", folder / package / "msg")
    return next((path for place in places if (path := place / f"{module}.msg").is_file()), None)


def _policies(value: Any, key: str, general: Mapping[str, Any]) -> Mapping[str, Any]:
    given = {**general, **{str(name): policy for name, policy in _mapping(value, key, None).items()}}
    try:
        qos.parse(given)
    except MessageError as error:
        raise ConfigError(str(error), element=key) from None
    return given


def _node_name(value: Any) -> str:
    if not isinstance(value, str) or not re.fullmatch(r"[A-Za-z_]\w*", value):
        raise ConfigError(f"found {value!r}; a name of letters, digits and _ would be right", element="Name")
    return value


def hertz(value: Any, key: str) -> float:
    """A rate whose period is one. Raises ConfigError."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 1e-6 <= value <= 1e6:
        raise ConfigError(f"found {value!r}; a number of Hz from 1e-06 to 1e+06 would be right", element=key)
    return float(value)


def _mapping(value: Any, key: str, known: Sequence[str] | None) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        right = f"a mapping with {', '.join(known)}" if known else "a mapping"
        raise ConfigError(f"found {value!r}; {right} would be right", element=key)
    unknown = [str(name) for name in value if known is not None and name not in known]
    if unknown:
        raise ConfigError(f"found the key {unknown[0]!r}; known are {', '.join(known or ())}", element=key)
    return value
