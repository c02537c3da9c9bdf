"""The behaviours of a library path: the inputs, topics, calls and documentation of each.

A behaviour is a process that a call activity can name by its id, whatever the name of its file. Everything is derived
from the diagram; nothing is declared twice.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from fame.bpmn.library import BUILT_IN, Library
from fame.bpmn.model import Body, DataObject, Definitions, FlowNode, Process
from fame.bpmn.topics import topic_table
from fame.check.expressions import expressions_in
from fame.dataclasses import dataclass
from fame.errors import ConfigError
from fame.scripting.effects import Direction, script_effects


@dataclass(frozen=True, slots=True)
class BehaviourTopic:
    """A topic (``~/odom`` is the robot's own, ``/weed_found`` everyone's) or, of direction ``call``, a service.

    `type` is empty where the behaviour does not say it.
    """

    name: str
    type: str
    direction: Direction


@dataclass(frozen=True, slots=True)
class Behaviour:
    """A process to call.

    name    the id of the process, which `calledElement` says; `label` what is drawn
    inputs  the variables of its data objects that something reads before anything has set them
    topics  those that it uses itself, not those of what it calls
    calls   the called elements, each once
    """

    name: str
    label: str
    file: str
    inputs: tuple[str, ...]
    topics: tuple[BehaviourTopic, ...]
    calls: tuple[str, ...]
    documentation: str


def behaviours(folders: Sequence[Path] = ()) -> list[Behaviour]:
    """Return the behaviours of `folders` and the built-in ones by name; those of `folders` hide built-in ones.

    A name that two files of `folders` define is there twice: a call of it is refused. Raises ConfigError for a folder
    that does not exist and ModelError for a file that cannot be read.
    """
    library, by_name = Library(), dict[str, list[Behaviour]]()
    for level in (folders, BUILT_IN):
        here: dict[str, list[Behaviour]] = {}
        for folder in level:
            if not folder.is_dir():
                raise ConfigError("there is no such folder", file=str(folder))
            for path in sorted(folder.glob("*.bpmn")):
                definitions = library.read(path)
                for process in definitions.processes:
                    here.setdefault(process.id, []).append(_behaviour(definitions, process, library))
        by_name = here | by_name
    return [one for name in sorted(by_name) for one in by_name[name]]


def _behaviour(definitions: Definitions, process: Process, library: Library) -> Behaviour:
    nodes = list(process.body.walk())
    return Behaviour(
        name=process.id,
        label=process.label,
        file=definitions.file,
        inputs=tuple(_inputs(definitions, process, library)),
        topics=tuple(_topics(definitions, process, nodes)),
        calls=tuple(dict.fromkeys(call.called for call in process.body.calls())),
        documentation=process.documentation.strip(),
    )


# ---- topics ----------------------------------------------------------------------------------------------------------


def _topics(definitions: Definitions, process: Process, nodes: Iterable[FlowNode]) -> Iterator[BehaviourTopic]:
    """The topics by direction and name; a type that one script omits may be declared elsewhere."""
    used: dict[tuple[Direction, str], str] = {}
    for use in topic_table(definitions, [process.id]).values():
        directions: dict[Direction, object] = {"publish": use.throws, "subscribe": use.catches}
        used.update({(direction, use.name): use.type for direction, ends in directions.items() if ends})
    types = {name: type for (_, name), type in used.items()}
    for node in nodes:
        for topic in script_effects(node).topics:
            used.setdefault((topic.direction, topic.qualified), topic.type or "")
            types[topic.qualified] = types.get(topic.qualified) or topic.type or ""
    for direction, name in sorted(used):
        yield BehaviourTopic(name, used[direction, name] or types[name], direction)


# ---- inputs ----------------------------------------------------------------------------------------------------------


def _inputs(definitions: Definitions, process: Process, library: Library) -> Iterator[str]:
    """The inputs in the order of the data objects."""
    uses = _Uses({}, {}, {})
    for body in process.body.bodies():
        _gather(body, uses)
    for call in process.body.calls():
        if call.io is None:  # it shares the variables, and sets them as it likes
            for _, called in library.closure(*library.find(definitions, call)):
                uses.sets[call.id] |= {name for body in called.body.bodies() for name in _set_in(body)}
    for name in dict.fromkeys(name for item in uses.objects.values() for name in item.names):
        if _passes(process.body, name, uses)[0]:
            yield name


@dataclass(frozen=True, slots=True)
class _Uses:
    """The data objects of a process, and the variables that each flow node and flow reads and sets."""

    objects: dict[str, DataObject]
    reads: dict[str, set[str]]
    sets: dict[str, set[str]]


def _gather(body: Body, uses: _Uses) -> None:
    objects = {item.id: item for item in body.data_objects}
    uses.objects.update(objects)
    for element in (*body.nodes, *body.flows):
        uses.reads[element.id], uses.sets[element.id] = set(), set()
    for text in expressions_in(body):
        if text.element.id in uses.reads:
            first = text.effects.read_first if text.use == "script" else text.reads
            uses.reads[text.element.id] |= first & text.reads
            uses.sets[text.element.id] |= text.effects.sets
    for node in body.nodes:
        for item in (uses.objects[id] for id in node.data_inputs if id in uses.objects):
            given = {name for name in item.names if _has_value(item, name)}
            uses.reads[node.id] |= set(item.names) - given
            uses.reads[node.id] -= given
            uses.sets[node.id] |= given
        uses.sets[node.id].update(*(uses.objects[id].names for id in node.data_outputs if id in uses.objects))


def _set_in(body: Body) -> set[str]:
    uses = _Uses({}, {}, {})
    _gather(body, uses)
    return set().union(*uses.sets.values())


def _has_value(item: DataObject, name: str) -> bool:
    """Whether a data object gives a variable a value other than its own."""
    return all(text.text.strip() not in ("", f"${{{name}}}") for given, text in item.values if given == name)


def _passes(body: Body, name: str, uses: _Uses) -> tuple[bool, bool]:
    """Whether a variable is read before it is set, and whether a token may pass without setting it.

    Every way that is drawn counts, whatever its condition.
    """
    flows, nodes = {flow.id: flow for flow in body.flows}, {node.id: node for node in body.nodes}
    pending = [node for node in body.nodes if not node.incoming and not node.attached_to]
    reads, through, seen = False, False, set[str]()
    for node in pending:
        if node.id in seen:
            continue
        seen.add(node.id)
        pending += body.boundary(node.id)
        reads |= name in uses.reads[node.id]
        onward = name not in uses.sets[node.id]
        if node.body is not None and onward:
            inner, onward = _passes(node.body, name, uses)
            reads |= inner
        if onward and not node.triggered_by_event:
            leaving = [flows[id] for id in node.outgoing if id in flows]
            reads |= any(name in uses.reads[flow.id] for flow in leaving)
            pending += [nodes[flow.target] for flow in leaving]
            through |= not leaving
    return reads, through
