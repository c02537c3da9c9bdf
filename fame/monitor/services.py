"""How the services start that a service task can name (`fame.rooms.SERVICES`; see models/monitoring).

Each is started with the variables that the data object of its call activity names. Files are relative to the folder of
the mission's model.

``process``      a processing node: `configuration` (a file, also looked for in ``models/monitoring``), `parameters` of
                 its processors by name (a mapping or its text), `namespace` that topics are relative to (default: the
                 robot's), `blind`: what happens when it cannot judge (`continue`, `wait` or `error`)
``record``       a recording node: `configuration`, `namespace`, `output`, one place or several
``train``        ``fame monitor train``: `configuration`; sets `model` and `thresholds`
``adm_collect``  record labelled runs of an arm: `output`, `label`, `runs`, `points`, `rule`, `topic`, `field`
``adm_learn``    ``fame monitor adm learn``: `config`, `model`; sets `classifier`, the name of the best one
``adm_operate``  watch an arm and raise the signal `anomaly`: `model`, `threshold`, `points`, `rule`, `topic`, `field`
``watch_property``  watch a property of the team and raise the signal ``violated/NAME``: `property` (NAME), `sentence`

Modules with heavy dependencies are imported when a service is started, beside the engine (`LoadingService`).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from os.path import isfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

from fame.config.loader import find_object
from fame.engine.host import BpmnError
from fame.errors import ConfigError, FameError, MissionError, UnavailableError
from fame.middleware.typesystem import STRING
from fame.monitor.loading import LoadingService
from fame.robot.services import (
    CommandService,
    MissingFileError,
    RunningService,
    ServiceContext,
    ServiceTopic,
    variable,
)

if TYPE_CHECKING:
    from fame.monitor.anomaly.live import RunMonitor
    from fame.monitor.anomaly.nodes import ArmOptions
    from fame.monitor.anomaly.recording import Rule
    from fame.monitor.pipeline.configuration import Configuration, Stage
    from fame.monitor.pipeline.node import ProcessingNode
    from fame.monitor.pipeline.processor import SupportsExecute
    from fame.monitor.pipeline.processors import FindObject

BLIND = "continue", "wait", "error"
RULES, FIELDS = ("home", "signal", "count"), ("position", "velocity", "effort")


class _Node(Protocol):
    def close(self) -> None: ...


class _NodeService:
    """A node that runs until its scope ends."""

    def __init__(self, node: _Node) -> None:
        self._node = node

    def results(self) -> None:
        """Return None: the node does not end by itself."""

    def close(self) -> None:
        self._node.close()


# ---- pipelines -------------------------------------------------------------------------------------------------------


class MonitorService(_NodeService):
    """A processing node; `blind` of its variables says what happens when it cannot judge: the mission is told by
    signals alone (``continue``), is held until it can (``wait``), or gets the error ``monitor_blind`` (``error``)."""

    _node: ProcessingNode

    def __init__(
        self,
        context: ServiceContext,
        variables: dict[str, Any],
        configuration: Configuration,
        processors: Sequence[SupportsExecute],
    ) -> None:
        from fame.monitor.pipeline.node import ProcessingNode

        self._context, self._variables, self._closed = context, variables, False
        self._then, self._reason = _choice(variables, "blind", BLIND), ""
        self._name = configuration.name
        self._node = ProcessingNode(
            context.middleware, context.scheduler, configuration, processors=processors,
            namespace=_namespace(context, variables), report=context.report, on_blind=self._on_blind,
        )  # fmt: skip

    def results(self) -> None:
        """Return None: the node does not end by itself. Raises BpmnError if it is blind, and the mission wants that."""
        if self._reason and self._then == "error":
            raise BpmnError("monitor_blind", self._reason)

    def close(self) -> None:
        """Close the node, unless the mission is held for it: then once it sees."""
        self._closed = True
        if not self._reason or self._then != "wait":
            self._node.close()
            if self._reason:
                self._context.blind(self._name, None, None)

    def _on_blind(self, reason: str) -> None:
        self._reason = self._variables["monitor_blind"] = reason
        if not reason and self._closed:
            self._node.close()
        self._context.blind(self._name, reason, self._node.close if self._then == "wait" else None)
        self._context.changed()


def process(context: ServiceContext, variables: dict[str, Any]) -> RunningService:
    file, given = _configuration_file(context.folder, variables), _parameters(variables)

    def loaded() -> tuple[Configuration, list[SupportsExecute]]:
        import fame.monitor.pipeline.node  # noqa: F401 (which `MonitorService` needs)
        from fame.monitor.pipeline.configuration import load
        from fame.monitor.pipeline.processors import make_processors

        configuration = _with_parameters(load(file), given, context.folder)
        return configuration, make_processors(configuration)

    def discard(made: tuple[Configuration, list[SupportsExecute]]) -> None:
        from fame.monitor.pipeline.processors import close_processors

        close_processors(made[1])

    return LoadingService(context, loaded, lambda made: MonitorService(context, variables, *made), discard)


def record(context: ServiceContext, variables: Mapping[str, Any]) -> RunningService:
    """Record until the scope ends. An existing CSV file is continued with the next run."""
    places = [place if "://" in str(place) else context.folder / str(place) for place in _outputs(variables)]
    file = _configuration_file(context.folder, variables)

    def loaded() -> Configuration:
        import fame.monitor.pipeline.recording  # noqa: F401 (which `start` needs)
        from fame.monitor.pipeline.configuration import load

        return load(file)

    def start(configuration: Configuration) -> RunningService:
        from fame.monitor.pipeline.recording import RecordingNode, RecordingOptions

        options = RecordingOptions(namespace=_namespace(context, variables), append=True, report=context.report)
        return _NodeService(RecordingNode(context.middleware, context.scheduler, configuration, places, options))

    return LoadingService(context, loaded, start)


def train(context: ServiceContext, variables: Mapping[str, Any]) -> RunningService:
    def results(output: Mapping[str, Any]) -> Mapping[str, Any]:
        return {"model": str(Path(output["model"]).resolve()), "thresholds": output["thresholds"]}

    return CommandService(context, ["monitor", "train", str(_configuration_file(context.folder, variables))], results)


def process_topics(folder: Path, variables: Mapping[str, Any]) -> Sequence[ServiceTopic] | None:
    """Return the topics of a processing node, as far as its variables say them.

    Raises ConfigError, also for processors that cannot be made or do not fit together.
    """
    from fame.monitor.pipeline.configuration import load
    from fame.monitor.pipeline.processors import check_processors
    from fame.monitor.pipeline.stand_in import look_up

    _choice(variables, "blind", BLIND)
    if variables.get("configuration") is None:
        return None
    configuration = load(_configuration_file(folder, variables))
    given = _parameters(variables)
    if variables.get("parameters", "") is not None:
        with suppress(UnavailableError):  # packages of a processor may be on the robot alone
            check_processors(_with_parameters(configuration, given, folder, look_up))
    return _topics(configuration, variables)


def _topics(configuration: Configuration, variables: Mapping[str, Any]) -> Sequence[ServiceTopic] | None:
    if variables.get("namespace", "") is None:
        return None
    place = variables.get("namespace")
    ports = [("Inputs", port, False) for port in configuration.inputs]
    ports += [("Run", port, False) for port in configuration.recorded[len(ports) :] if not port.service]
    ports += [("Outputs", port, True) for port in configuration.outputs]
    file, line = str(configuration.file), configuration.source.line
    signals = [ServiceTopic(topic, STRING, True) for topic in ("/monitor_blind", "/monitor_sees")]
    return [
        *(
            ServiceTopic(_name(port.topic, place), port.type, throws, file, line(f"{section}.{port.name}.MessageType"))
            for section, port, throws in ports
        ),
        *signals,
    ]


def record_topics(folder: Path, variables: Mapping[str, Any]) -> Sequence[ServiceTopic] | None:
    """Return the topics of a recording node. Raises ConfigError."""
    from fame.monitor.pipeline.configuration import load

    if variables.get("output") is not None:
        _outputs(variables)
    if variables.get("configuration") is None:
        return None
    found = _topics(load(_configuration_file(folder, variables)), variables)
    return [one for one in found if not one.throws] if found is not None else None


def train_topics(folder: Path, variables: Mapping[str, Any]) -> Sequence[ServiceTopic]:
    """Return none. Raises ConfigError for a wrong configuration."""
    from fame.monitor.pipeline.configuration import load
    from fame.monitor.pipeline.training_settings import read_settings, section_of

    if variables.get("configuration") is not None:
        read_settings(section_of(load(_configuration_file(folder, variables))))
    return ()


def learn_topics(folder: Path, variables: Mapping[str, Any]) -> Sequence[ServiceTopic]:
    """Return none. Raises ConfigError if there is no such configuration."""
    if variables.get("config") is not None and not isfile(file := folder / variable(variables, "config", type=str)):
        raise MissingFileError(f"there is no file {file}")
    return ()


def configured_files(folder: Path, name: str) -> list[str]:
    """Return the files that the processors of a configuration name, as from `folder`; none of any other file."""
    from fame.monitor.pipeline.configuration import load

    try:
        stages = load(folder / name).stages if name.endswith((".yaml", ".yml")) else ()
    except FameError:
        return []
    texts = (text for stage in stages for text in (stage.cls.partition(":")[0], *stage.parameters.values()))
    paths = (os.path.normpath(Path(name).parent / text) for text in texts if isinstance(text, str))
    return [path for path in paths if isfile(folder / path)]


def _outputs(variables: Mapping[str, Any]) -> list[Any]:
    output = variables.get("output")
    return output if isinstance(output, list) else [variable(variables, "output", type=str)]


def _name(topic: str, namespace: Any) -> str:
    """A topic as models write it."""
    own = topic.removeprefix("~/")
    return (
        topic if topic.startswith("/") else f"~/{own}" if namespace is None else f"/{str(namespace).strip('/')}/{own}"
    )


def _configuration_file(folder: Path, variables: Mapping[str, Any]) -> Path:
    from fame.bpmn.library import BUILT_IN

    name = variable(variables, "configuration", type=str)
    folders = (folder, *BUILT_IN)
    found = next((folder / name for folder in folders if isfile(folder / name)), None)
    if found is None:
        raise MissingFileError(f"there is no configuration {name} in {', '.join(map(str, folders))}")
    return found


def _parameters(variables: Mapping[str, Any]) -> Mapping[str, Any]:
    from fame.config.loader import parse_document

    given = variables.get("parameters") or {}
    given = parse_document(given, "parameters").data if isinstance(given, str) else given
    if not isinstance(given, Mapping):
        raise ConfigError(f"expected a mapping such as {{cutoff: 5}}, got {given!r}", element="parameters")
    return given


def _with_parameters(
    configuration: Configuration, given: Mapping[str, Any], folder: Path, find: FindObject = find_object
) -> Configuration:
    """Pass each parameter to the stages that have it; files are relative to `folder`. Raises ConfigError."""
    from dataclasses import replace

    from fame.monitor.pipeline.processor import declared_parameters
    from fame.monitor.pipeline.processors import find_classes
    from fame.monitor.pipeline.stand_in import takes_any

    stages: list[Stage] = []
    used: set[str] = set()
    kinds = find_classes(configuration, find)
    for stage, kind in zip(configuration.stages, kinds, strict=True):
        types = {parameter.name: parameter.type for parameter in declared_parameters(kind)}
        own = {
            name: str((folder / str(value)).resolve()) if types[name] == "file" else value
            for name, value in given.items()
            if name in types
        }
        used |= own.keys()
        stages.append(replace(stage, parameters={**stage.parameters, **own}))
    unused = [name for name in given if name not in used and not any(map(takes_any, kinds))]
    if unused:
        raise ConfigError("no processor has this parameter", file=str(configuration.file), element=unused[0])
    return replace(configuration, stages=tuple(stages))


def _namespace(context: ServiceContext, variables: Mapping[str, Any]) -> str:
    given = variables.get("namespace")
    return context.namespace if given is None else str(given).strip("/")


# ---- anomaly detection -----------------------------------------------------------------------------------------------


class CollectService:
    """Records runs with a label. Ends after `runs` runs or with its scope, and writes `output` in both cases."""

    def __init__(self, context: ServiceContext, variables: Mapping[str, Any]) -> None:
        from fame.monitor.anomaly.live import Collector
        from fame.monitor.anomaly.nodes import RunNode

        self._output = context.folder / variable(variables, "output", type=str)
        label = _label(variables)
        points, runs = variable(variables, "points", 0, type=int), variable(variables, "runs", 0, type=int)
        self._collector = Collector(label, _rule(variables), cycle=points, limit=runs)
        self._report = context.report
        self._node = RunNode(context.middleware, context.scheduler, self._collector, _arm(context, variables))

    def results(self) -> Mapping[str, Any] | None:
        """Return `runs_collected`, the runs in the recording, once enough have ended."""
        return {"runs_collected": self._collector.recorded} if self._collector.done else None

    def close(self) -> None:
        """Close the node and write the recording."""
        from fame.monitor.anomaly.recording import write_csv

        self._node.close()
        try:
            recording = self._collector.recording()
            for note in recording.notes:
                self._report(note)
            write_csv(self._output, recording)
        except MissionError as error:
            self._report(error.text)


def adm_operate(context: ServiceContext, variables: Mapping[str, Any]) -> RunningService:
    threshold, rule, points = _threshold(variables), _rule(variables), variable(variables, "points", 0, type=int)
    file = context.folder / variable(variables, "model", type=str)

    def loaded() -> RunMonitor:
        import fame.monitor.anomaly.nodes  # noqa: F401 (which `start` needs)
        from fame.monitor.anomaly.live import RunMonitor
        from fame.monitor.anomaly.model import Model

        return RunMonitor(Model.load(file), threshold, rule, points)

    def start(monitor: RunMonitor) -> RunningService:
        from fame.monitor.anomaly.nodes import OperateNode

        return _NodeService(OperateNode(context.middleware, context.scheduler, monitor, _arm(context, variables)))

    return LoadingService(context, loaded, start)


def adm_learn(context: ServiceContext, variables: Mapping[str, Any]) -> RunningService:
    config = context.folder / variable(variables, "config", type=str)
    model = context.folder / variable(variables, "model", "best.skops", type=str)

    def results(output: Mapping[str, Any]) -> Mapping[str, Any]:
        return {"classifier": next(item["name"] for item in output["classifiers"] if item["best"])}

    return CommandService(context, ["monitor", "adm", "learn", str(config), "-o", str(model)], results)


def collect_topics(folder: Path, variables: Mapping[str, Any]) -> Sequence[ServiceTopic] | None:
    """Return the topics by which runs are recorded. Raises ConfigError for variables with other values than allowed."""
    if variables.get("label") is not None:
        _label(variables)
    variable(variables, "runs", 0, type=int)
    return arm_topics(folder, variables)


def arm_topics(folder: Path, variables: Mapping[str, Any]) -> Sequence[ServiceTopic] | None:
    """Return the topics by which an arm is watched. Raises ConfigError for variables with other values than allowed."""
    from fame.monitor.anomaly.nodes import bag_topics

    _choice(variables, "rule", RULES), _choice(variables, "field", FIELDS)
    variable(variables, "points", 0, type=int)
    topic, rule = variables.get("topic", "/joint_states"), variables.get("rule", "")
    if topic is None or rule is None:
        return None
    return [ServiceTopic(name, type, False) for name, type in bag_topics(_name(topic, None), rule).items()]


def operate_topics(folder: Path, variables: Mapping[str, Any]) -> Sequence[ServiceTopic] | None:
    """Return the topics of anomaly detection."""
    from fame.monitor.anomaly.nodes import PUBLISHED

    _threshold(variables)
    read = arm_topics(folder, variables)
    thrown = (ServiceTopic(_name(name, None), type, True) for name, type in PUBLISHED.items())
    return [*read, *thrown] if read is not None else None


def _arm(context: ServiceContext, variables: Mapping[str, Any]) -> ArmOptions:
    from fame.monitor.anomaly.nodes import ArmOptions

    return ArmOptions(
        topic=variable(variables, "topic", "/joint_states", type=str), field=_choice(variables, "field", FIELDS),
        namespace=context.namespace, report=context.report, done=context.changed,
    )  # fmt: skip


def _label(variables: Mapping[str, Any]) -> int:
    label = variable(variables, "label", type=int)
    if label not in (1, -1):
        raise ConfigError(f"variable label: expected 1 (benign) or -1 (anomalous), got {label}")
    return label


def _threshold(variables: Mapping[str, Any]) -> float | None:
    threshold = variable(variables, "threshold", type=float) if variables.get("threshold") is not None else None
    if threshold is not None and not 0 <= threshold < 1:
        raise ConfigError(f"variable threshold: expected a number from 0 to 1, got {threshold:g}")
    return threshold


def _rule(variables: Mapping[str, Any]) -> Rule:
    return cast("Rule", _choice(variables, "rule", RULES))


def _choice(variables: Mapping[str, Any], name: str, known: tuple[str, ...]) -> str:
    """Return one of the `known` words, the first if the variable is not set. Raises ConfigError for another."""
    value = variable(variables, name, known[0], type=str)
    if value not in known:
        raise ConfigError(f"variable {name}: expected one of {', '.join(known)}, got {value!r}")
    return value
