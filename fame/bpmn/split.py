"""Splits a collaboration into one self-contained file per pool.

It works on the XML, so that unknown content is kept. A new file has the pool and its process, the processes that it
calls, the root elements that these use (signals, messages, errors ...), and their diagrams. Ids that several source
files use get a number; what is named by its id keeps that as a name. Every call names the process that it called in its
own file. Every event gets the message type of its topic, and whether its signals are acknowledged, since the event that
says so may be in another robot's file.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from copy import deepcopy
from pathlib import Path

from lxml import etree

from fame.bpmn.extension_writing import add_property, has_property
from fame.bpmn.fragments import Fragment, copy_fragment
from fame.bpmn.library import Find, Library, calls_of, closure, identity
from fame.bpmn.model import CallActivity, Definitions, Participant, Process
from fame.bpmn.namespaces import add_prefixes, contract_types, repair_prefixes
from fame.bpmn.part_reading import Original, assert_same_reading
from fame.bpmn.pools import pools_of, shared_topics
from fame.bpmn.reader import read, read_bytes
from fame.bpmn.reader.dialects import is_original_fame
from fame.bpmn.reader.dialects.original_fame import CALL
from fame.bpmn.reader.expressions import variable_name
from fame.bpmn.reader.xml import BPMN, CAMUNDA, ZEEBE, Node, local_id, unique_ids
from fame.dataclasses import dataclass
from fame.errors import ModelError

_B = f"{{{BPMN}}}"


@dataclass(frozen=True, slots=True)
class PoolModel:
    """The self-contained executable model of a pool, as XML. `filename` has no folder."""

    name: str
    multi_instance: bool
    process_id: str
    source: bytes

    @property
    def filename(self) -> str:
        """The name of the pool as a file name, with only letters, digits, ``.``, ``-`` and ``_``; without any letter
        and digit, the id of its process."""
        names = (
            re.sub(r"[^\w.-]+", "_", name).lstrip("._-").rstrip("._") for name in (self.name, self.process_id, "pool")
        )
        return f"{next(filter(None, names))}.bpmn"


def split(definitions: Definitions | str | Path, library: Library | None = None) -> list[PoolModel]:
    """Return one self-contained model per pool: its process, called processes, signals with their types, and diagram.

    `definitions` may be a path. Raises ModelError.
    """
    definitions, library = read(definitions), library or Library()
    pools = pools_of(definitions)
    shared = shared_topics(definitions, pools, library)
    types = {name: use.declared for name, use in shared.items() if use.declared and name[0] == "/"}
    acknowledged = {name for name, use in shared.items() if use.ttl}
    trees: dict[str | bytes, Node] = {}
    return [
        PoolModel(
            pool.name,
            pool.multi_instance,
            pool.process.id,
            extract_process(
                definitions,
                pool.process.id,
                name=pool.name if definitions.participants else "",
                find=library.find,
                topic_types=types,
                acknowledged=acknowledged,
                trees=trees,
            ),
        )
        for pool in pools
    ]


def extract_process(
    definitions: Definitions,
    process_id: str,
    *,
    name: str = "",
    find: Find | None = None,
    topic_types: Mapping[str, str] | None = None,
    acknowledged: Collection[str] = (),
    trees: dict[str | bytes, Node] | None = None,
) -> bytes:
    """Return one process as a self-contained executable file, UTF-8.

    `name` selects the pool if several have this process, and becomes the name of the pool. `find` gives the processes
    that are called, by default those of the same file; other calls stay as they are. `topic_types` maps qualified
    topics to types, `acknowledged` are those with acknowledgements, `trees` as of `copy_fragment`. Message flows are
    left out, since topics carry the messages. Raises ModelError if there is no such process, or if it would read
    differently in the new file.
    """
    process = _process(definitions, process_id)
    find = find or _in_its_file
    files = _by_file(closure(definitions, process, find))
    pool = _pool(definitions, process_id, name)
    fragments: list[Fragment] = []
    taken = Counter[str]()
    for file, processes in files:
        its_pool = pool if file is definitions else None
        fragment = copy_fragment(file, processes, its_pool, topic_types or {}, acknowledged, trees)
        _make_unique(fragment, taken)
        fragments.append(fragment)
    _write_defaults(fragments, [processes for _, processes in files])
    ids = {identity(fragment.definitions): fragment.ids for fragment in fragments}
    originals: list[Original] = []
    for fragment, (file, processes) in zip(fragments, files, strict=True):
        calls = (call for one in processes for call in calls_of(one))
        targets = ((call.called, target) for call in calls if (target := find(file, call)) is not None)
        called = {name: ids[identity(home)][one.id] for name, (home, one) in targets}
        _update_calls(fragment, called)
        originals.append(Original(file, processes, fragment.ids, called, topic_types or {}, acknowledged))
    if fragments[0].collaboration is not None and name:
        next(fragments[0].collaboration.iterchildren(f"{_B}participant")).set("name", name)
    source = etree.tostring(_assemble(fragments), xml_declaration=True, encoding="UTF-8") + b"\n"
    part = read_bytes(source, file=definitions.file)
    for original in originals:
        assert_same_reading(part, original)
    return source


def _process(definitions: Definitions, id: str) -> Process:
    process = definitions.process(id)
    if process is None:
        has = ", ".join(one.id for one in definitions.processes) or "none"
        raise ModelError(f"the file has no process {id!r}; its processes are: {has}", file=definitions.file)
    return process


def _by_file(found: Sequence[tuple[Definitions, Process]]) -> list[tuple[Definitions, list[Process]]]:
    """The files with their needed processes, in the order in which they are met."""
    files: dict[str | bytes, tuple[Definitions, list[Process]]] = {}
    for home, process in found:
        files.setdefault(identity(home), (home, []))[1].append(process)
    return list(files.values())


def _in_its_file(home: Definitions, call: CallActivity) -> tuple[Definitions, Process] | None:
    process = home.process(call.called)
    return None if process is None else (home, process)


def _pool(definitions: Definitions, process_id: str, name: str) -> Participant | None:
    pools = [one for one in definitions.participants if one.process == process_id]
    named = [one for one in pools if one.label == name]
    return next(iter(named or pools), None)


# ---- ids -------------------------------------------------------------------------------------------------------------


def _make_unique(fragment: Fragment, taken: Counter[str]) -> None:
    """Number the ids that are already taken, and their uses in the fragment."""
    for element in fragment.elements():
        if element.get("id") in taken:
            _name_by_id(element)
    renamed = unique_ids(fragment.everything(), taken)
    fragment.ids = {id: id for id in fragment.ids} | renamed


def _name_by_id(element: Node) -> None:
    """Give an element the name that the reader takes from its id."""
    name = element.get("name", "").strip()
    if element.tag in _VARIABLES and name:
        element.set("name", variable_name(element))
    elif element.tag in _ROOTS or not all(it.get("signalRef") or it.get("messageRef") for it in _with_topic(element)):
        element.set("name", name or element.get("id", ""))


def _with_topic(element: Node) -> list[Node]:
    """The element or its definitions that refer to a signal or message."""
    tags = (f"{_B}signalEventDefinition", f"{_B}messageEventDefinition")
    return [element] if element.tag in (f"{_B}sendTask", f"{_B}receiveTask") else list(element.iterchildren(*tags))


_ROOTS = {f"{_B}{name}" for name in ("signal", "message", "error", "escalation", "operation", "correlationProperty")}
_VARIABLES = {f"{_B}{name}" for name in ("property", "dataInput", "dataOutput")}


def _update_calls(fragment: Fragment, ids: Mapping[str, str]) -> None:
    """Let the calls of a fragment name the processes as in the new file; `ids` are by called element."""
    for element in fragment.elements():
        for tag, attribute in _CALLS:
            if element.tag == tag and element.get(attribute):
                called = ids.get(element.get(attribute, "").strip()) or ids.get(local_id(element, attribute))
                if called is not None:
                    element.set(attribute, called)


_CALLS = (
    (f"{_B}callActivity", "calledElement"),
    (f"{{{ZEEBE}}}calledElement", "processId"),
    (f"{{{CALL}}}process", "process"),
)


# ---- what holds for a whole file -------------------------------------------------------------------------------------

_CODE = {
    f"{_B}{name}"
    for name in ("script", "conditionExpression", "condition", "activationCondition", "completionCondition",
                 "transformation", "from", "messagePath")
}  # fmt: skip


def _write_defaults(fragments: Sequence[Fragment], processes: Sequence[Sequence[Process]]) -> None:
    """Write what each file says for all of its processes into these, since other files say something else."""
    roots = [fragment.root for fragment in fragments]
    if any(map(is_original_fame, roots)):
        for fragment, models in zip(fragments, processes, strict=True):
            for copy, process in zip(fragment.processes, models, strict=True):
                if not has_property(copy, "fields"):
                    add_property(copy, "fields", "prefix" if process.by_prefix else "associations")
    if len({root.get("expressionLanguage") for root in roots}) > 1:
        for fragment in fragments:
            language = fragment.root.attrib.pop("expressionLanguage", "")
            for element in fragment.elements() if language else ():
                if element.tag in _CODE and not element.get("language"):
                    element.set("language", language)
    if fragments[0].collaboration is None:  # no pool says which one is to be run
        copies = [copy for fragment in fragments for copy in fragment.processes]
        for copy in copies if len(copies) > 1 else ():
            copy.set("isExecutable", "true" if copy is copies[0] else "false")


# ---- the new file ----------------------------------------------------------------------------------------------------


def _new_root(home: Node, others: Iterable[Node], parts: Sequence[Node]) -> Node:
    prefixes = dict[str | None, str]({"camunda": CAMUNDA})
    for other in (*others, home):
        prefixes.update({prefix: uri for prefix, uri in other.nsmap.items() if prefix or other is home})
    add_prefixes(prefixes, parts)
    prefixes = {prefix: uri for prefix, uri in prefixes.items() if _is_valid_name(f"{{{uri}}}any")}
    attributes = {name: value for name, value in home.attrib.items() if _is_valid_name(name)}
    root = etree.Element(home.tag, attributes, nsmap=prefixes)  # type: ignore[arg-type]
    for one in home.iterchildren(f"{_B}documentation", f"{_B}extensionElements"):
        root.append(deepcopy(one))
    return root


def _is_valid_name(name: str | bytes) -> bool:
    """Whether a new element can have this name: lxml only copies a namespace that is not a URI."""
    try:
        etree.Element(name)
    except ValueError:
        return False
    return True


def _assemble(fragments: list[Fragment]) -> Node:
    parts = [fragment.collaboration for fragment in fragments if fragment.collaboration is not None]
    parts += [one for fragment in fragments for one in fragment.processes]
    parts += [one for fragment in fragments for one in fragment.shared]
    parts += [one for fragment in fragments for one in fragment.diagrams]
    root = _new_root(fragments[0].root, [fragment.root for fragment in fragments[1:]], parts)
    root.extend(parts)
    etree.indent(root, "  ")
    repair_prefixes(root)
    contract_types(root)
    return root
