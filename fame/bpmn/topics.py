"""The topics of a collaboration: the events that throw and catch each one, and its message type.

One event of a topic may give the type for all of them, so the events of all processes are considered together. The
default type is std_msgs/msg/Empty.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from types import MappingProxyType

from fame.bpmn.model import Definitions, FlowNode, Process, SignalDefinition, Topic
from fame.dataclasses import dataclass, field, replace
from fame.errors import ModelError

EMPTY_TYPE = "std_msgs/msg/Empty"
TTL = 60.0
"""How long an acknowledged signal is kept, unless its property ``ttl`` says otherwise (s)."""


@dataclass(frozen=True, slots=True)
class TopicEnd:
    """An event or task that throws or catches on a topic, with its own `fame.bpmn.model.Topic`."""

    file: str
    process: str
    node: FlowNode
    topic: Topic

    @property
    def is_message(self) -> bool:
        """Whether it throws or catches a message rather than a signal."""
        return all(one.topic is not self.topic for one in self.node.defined(SignalDefinition))


@dataclass(frozen=True, slots=True)
class TopicUse:
    """A topic by its qualified name (``/weed_found``, ``~/odom``).

    `declared` is the type given in the model, or None. `qos` combines the policies of all its ends. Those of the throw
    ends take precedence, so that publishers and subscribers match. `ttl` is the longest of its ends (s), 0 if its
    signals are not acknowledged.
    """

    name: str
    declared: str | None
    throws: tuple[TopicEnd, ...]
    catches: tuple[TopicEnd, ...]
    qos: Mapping[str, str]
    ttl: float = 0.0

    @property
    def type(self) -> str:
        return self.declared or EMPTY_TYPE

    @property
    def addresses(self) -> bool:
        """Whether one of its throw ends addresses a single robot."""
        return any(end.topic.to is not None for end in self.throws)

    @property
    def takes_messages(self) -> bool:
        """Whether one of its catch ends waits for a message."""
        return any(end.is_message for end in self.catches)


@dataclass(slots=True)
class _Ends:
    throws: list[TopicEnd] = field(default_factory=list)
    catches: list[TopicEnd] = field(default_factory=list)


def topic_table(
    definitions: Definitions | Sequence[Definitions],
    processes: Iterable[str] | None = None,
    *,
    types: Mapping[str, str] = MappingProxyType({}),
) -> Mapping[str, TopicUse]:
    """Return the topics of some files by qualified name, in the order of first use; only those of
    `processes` (ids) if given.

    `types`: types given elsewhere, by qualified name, for topics to which these processes give none.

    A private topic (``~/odom``) is a different one on each robot: where types matter, pass the processes of one robot.
    Raises ModelError if two events of a topic (of a private one: in one process) give different types or have different
    names of which it is made, or if an event sends a payload and the topic has no type.
    """
    files = (definitions,) if isinstance(definitions, Definitions) else definitions
    wanted = None if processes is None else frozenset(processes)
    named = ((file, one) for file in files for one in file.processes if wanted is None or one.id in wanted)
    return topics_of_processes(named, types=types)


def topics_of_processes(
    processes: Iterable[tuple[Definitions, Process]],
    *,
    types: Mapping[str, str] = MappingProxyType({}),
    acknowledged: Collection[str] = (),
) -> Mapping[str, TopicUse]:
    """As `topic_table`, for processes with their files, where two files may have processes of one id.

    `acknowledged`: topics whose signals others throw with acknowledgements.
    """
    ends_by_topic: dict[str, _Ends] = {}
    for file, process in processes:
        _gather(file, process, ends_by_topic)
    uses = {name: _use(name, ends, types.get(name)) for name, ends in ends_by_topic.items()}
    for name in [name for name in acknowledged if name in uses and not uses[name].ttl]:
        uses[name] = replace(uses[name], ttl=TTL)
    return MappingProxyType(uses)


def _gather(file: Definitions, process: Process, ends_by_topic: dict[str, _Ends]) -> None:
    for node in process.body.walk():
        for topic, throws in node.topics():
            ends = ends_by_topic.setdefault(topic.qualified, _Ends())
            end = TopicEnd(file.file, process.id, node, topic)
            (ends.throws if throws else ends.catches).append(end)


def name_conflict(topic: str, label: str, other: str, first: str) -> str:
    """Return the error of an end whose name makes the topic that another end (as it is displayed) makes of another."""
    text = f"the name {label!r} and that of {other}, {first!r}, are the same topic {topic}"
    return f"{text}: expected names that differ in letters and digits, or one name"


def _together(topic: str, end: TopicEnd, other: TopicEnd) -> bool:
    """Whether two ends of this name have one topic: a private topic of another robot is another one."""
    return topic[0] == "/" or (end.file, end.process) == (other.file, other.process)


def _use(name: str, ends: _Ends, default_type: str | None) -> TopicUse:
    all_ends = [*ends.throws, *ends.catches]
    labelled = [end for end in all_ends if end.topic.label]
    for end in labelled[1:]:
        if end.topic.label != labelled[0].topic.label and _together(name, end, labelled[0]):
            text = name_conflict(name, end.topic.label, labelled[0].node.display_name, labelled[0].topic.label)
            raise ModelError.at(end.node, text, file=end.file)
    typed = [end for end in all_ends if end.topic.type is not None]
    for end in typed[1:]:
        if end.topic.type != typed[0].topic.type and _together(name, end, typed[0]):
            there = f"{typed[0].node.display_name} says {typed[0].topic.type}"
            raise ModelError.at(
                end.node,
                f"topic {name} has type {end.topic.type} here, but {there}: a topic has one type",
                file=end.file,
            )
    if not typed and default_type is None:
        for end in ends.throws:
            if end.topic.payload is not None:
                raise ModelError.at(
                    end.node,
                    f"topic {name} has a payload and no type: give one of its events property type",
                    file=end.file,
                )
    qos: dict[str, str] = {}
    for end in reversed(all_ends):
        qos.update(end.topic.qos)
    declared = typed[0].topic.type if typed else default_type
    ttl = max(end.topic.ttl for end in all_ends)
    return TopicUse(name, declared, tuple(ends.throws), tuple(ends.catches), MappingProxyType(qos), ttl)
