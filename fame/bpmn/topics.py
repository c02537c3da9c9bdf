"""Topics of a collaboration: who throws and who catches each, and the one message type that all of them mean.

A type may stand on any one event of a topic and holds for all of them (DESIGN section 3); so it is found by looking at
every event of every process at once. A topic of which nobody says anything carries std_msgs/msg/Empty.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from fame.bpmn.model import Definitions, Event, FlowNode, MessageDefinition, Process, SignalDefinition, Task, Topic
from fame.errors import ModelError

EMPTY_TYPE = "std_msgs/msg/Empty"


@dataclass(frozen=True, slots=True)
class TopicEnd:
    """One event or task at a topic, and what it says of it."""

    file: str
    process: str
    node: FlowNode
    topic: Topic

    @property
    def is_message(self) -> bool:
        """Whether it throws or catches a message, not a signal."""
        if not isinstance(self.node, Event):
            return True
        return any(one.topic is self.topic for one in self.node.definitions if isinstance(one, MessageDefinition))


@dataclass(frozen=True, slots=True)
class TopicUse:
    """A topic by its qualified name (``/weed_found``, ``~/odom``).

    `declared` is the type that the model says, None if it says none. `qos` holds what any of its ends asks for; where a
    throw and a catch ask for different things, that of the throw: both ends then have the same, so they match.
    """

    name: str
    declared: str | None
    throws: tuple[TopicEnd, ...]
    catches: tuple[TopicEnd, ...]
    qos: Mapping[str, str]

    @property
    def type(self) -> str:
        """The message type that it carries."""
        return self.declared or EMPTY_TYPE

    @property
    def addresses(self) -> bool:
        """Whether one of its throws is for one robot."""
        return any(end.topic.to is not None for end in self.throws)

    @property
    def takes_messages(self) -> bool:
        """Whether one of its catches waits for a message."""
        return any(end.is_message for end in self.catches)


@dataclass(slots=True)
class _Gathered:
    throws: list[TopicEnd] = field(default_factory=list)
    catches: list[TopicEnd] = field(default_factory=list)


def topic_table(
    definitions: Definitions | Sequence[Definitions],
    processes: Iterable[str] | None = None,
    *,
    types: Mapping[str, str] = MappingProxyType({}),
) -> Mapping[str, TopicUse]:
    """Every topic of some files by qualified name, in the order of first use; of `processes` (ids) alone if given.

    `types` are said elsewhere, by qualified name: they hold for topics of which these processes say none.

    A private topic (``~/odom``) is another one on each robot: where types matter, ask for the processes of one robot.
    Raises ModelError if two events of a topic (of a private one: in one process) say different types, or if one sends a
    payload and nobody says its type.
    """
    files = (definitions,) if isinstance(definitions, Definitions) else definitions
    wanted = None if processes is None else frozenset(processes)
    found: dict[str, _Gathered] = {}
    for file in files:
        for process in file.processes:
            if wanted is None or process.id in wanted:
                _gather(file, process, found)
    return MappingProxyType({name: _use(name, ends, types.get(name)) for name, ends in found.items()})


def topics_of(node: FlowNode) -> Iterator[tuple[Topic, bool]]:
    """(topic, whether it throws) for each topic that a flow node has to do with. ROS services are no topics."""
    if isinstance(node, Event):
        for definition in node.definitions:
            if isinstance(definition, SignalDefinition | MessageDefinition):
                yield definition.topic, node.place in ("throw", "end")
    elif isinstance(node, Task) and node.topic is not None and node.kind in ("send", "receive"):
        yield node.topic, node.kind == "send"


def _gather(file: Definitions, process: Process, found: dict[str, _Gathered]) -> None:
    for node in process.body.walk():
        for topic, throws in topics_of(node):
            ends = found.setdefault(topic.qualified, _Gathered())
            end = TopicEnd(file.file, process.id, node, topic)
            (ends.throws if throws else ends.catches).append(end)


def _use(name: str, ends: _Gathered, elsewhere: str | None) -> TopicUse:
    everyone = [*ends.throws, *ends.catches]
    said = [end for end in everyone if end.topic.type is not None]
    for end in said[1:]:
        if end.topic.type != said[0].topic.type and (name[0] == "/" or end.process == said[0].process):
            there = f"{said[0].node.display_name} says {said[0].topic.type}"
            raise _error(end, f"topic {name} has type {end.topic.type} here, but {there}: a topic has one type")
    if not said and elsewhere is None:
        for end in ends.throws:
            if end.topic.payload is not None:
                raise _error(end, f"topic {name} has a payload and no type: give one of its events property type")
    qos: dict[str, str] = {}
    for end in reversed(everyone):
        qos.update(end.topic.qos)
    declared = said[0].topic.type if said else elsewhere
    return TopicUse(name, declared, tuple(ends.throws), tuple(ends.catches), MappingProxyType(qos))


def _error(end: TopicEnd, text: str) -> ModelError:
    return ModelError(text, file=end.file, line=end.node.line, element=end.node.id, name=end.node.name)
