"""Splits a collaboration into one self-contained file per pool.

It works on the XML, so that unknown content is kept. A new file has the pool and its process, the processes that it
calls, the root elements that these use (signals, messages, errors ...), and their diagrams. Ids that several source
files use get a number. Every event gets the message type of its topic, since the event that gives the type may be in
another robot's file.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path

from lxml import etree

from fame.bpmn.library import Library
from fame.bpmn.merging import Fragment, copy_fragment
from fame.bpmn.model import CallActivity, Definitions, Participant, Process
from fame.bpmn.pools import pools_of, shared_topics
from fame.bpmn.reader import read
from fame.bpmn.reader.dialects.original_fame import CALL
from fame.bpmn.reader.xml import BPMN, CAMUNDA, ZEEBE, Node, resolve, unique_ids
from fame.errors import ModelError

_B = f"{{{BPMN}}}"
_XSI_TYPE = "{http://www.w3.org/2001/XMLSchema-instance}type"


@dataclass(frozen=True, slots=True)
class Part:
    """The self-contained executable model of a pool, as XML. `filename` has no folder."""

    name: str
    multi_instance: bool
    process_id: str
    source: bytes

    @property
    def filename(self) -> str:
        """The name of the pool as a file name, with only letters, digits, ``.``, ``-`` and ``_``."""
        return re.sub(r"[^\w.-]+", "_", self.name).strip("._") + ".bpmn"


CalledProcesses = Mapping[str, tuple[Definitions, str]]
"""Called element -> its file, and the id of the process there."""


def split(definitions: Definitions | str | Path, library: Library | None = None) -> list[Part]:
    """One self-contained model per pool: its process, called processes, signals with their types, and diagram.

    `definitions` may be a path. Raises ModelError.
    """
    definitions, library = read(definitions), library or Library()
    pools = pools_of(definitions)
    types = {name: use.declared for name, use in shared_topics(definitions, pools, library).items() if use.declared}
    return [
        Part(
            pool.name,
            pool.multi_instance,
            pool.process.id,
            extract_process(
                definitions,
                pool.process.id,
                name=pool.name if definitions.participants else "",
                called=library.called(definitions, pool.process),
                topic_types=types,
            ),
        )
        for pool in pools
    ]


def extract_process(
    definitions: Definitions,
    process_id: str,
    *,
    name: str = "",
    called: CalledProcesses | None = None,
    topic_types: Mapping[str, str] | None = None,
) -> bytes:
    """One process as a self-contained executable file, UTF-8.

    `name` selects the pool if several have this process, and becomes the name of the pool. `called` maps called
    elements, at any depth, to processes; processes of the same file may be omitted. `topic_types` maps qualified topics
    to types. Message flows are left out, since topics carry the messages. Raises ModelError if a process is missing.
    """
    process = _process(definitions, process_id)
    reached = _reachable(definitions, process, called or {})
    files = _by_file(definitions, process, reached.values())
    pool = _pool(definitions, process_id, name)
    fragments: list[Fragment] = []
    taken: set[str] = set()
    for file, processes in files:
        fragment = copy_fragment(file, processes, pool if file is definitions else None, topic_types or {})
        _make_unique(fragment, taken)
        fragments.append(fragment)
    homes = {_key(fragment.definitions): fragment for fragment in fragments}
    ids = {key: homes[_key(file)].ids[id] for key, (file, id) in reached.items()}
    for fragment in fragments:
        _update_calls(fragment, ids)
    if fragments[0].collaboration is not None and name:
        next(fragments[0].collaboration.iterchildren(f"{_B}participant")).set("name", name)
    return etree.tostring(_assemble(fragments), xml_declaration=True, encoding="UTF-8") + b"\n"


def _process(definitions: Definitions, id: str) -> Process:
    process = definitions.process(id)
    if process is None:
        has = ", ".join(one.id for one in definitions.processes) or "none"
        raise ModelError(f"the file has no process {id!r}; its processes are: {has}", file=definitions.file)
    return process


def _by_file(
    definitions: Definitions, process: Process, reached: Iterable[tuple[Definitions, str]]
) -> list[tuple[Definitions, list[Process]]]:
    """The files with their needed processes; the file of the pool comes first."""
    found = {_key(definitions): (definitions, [process])}
    for file, id in reached:
        home, processes = found.setdefault(_key(file), (file, []))
        if all(one.id != id for one in processes):
            processes.append(_process(home, id))
    return list(found.values())


def _key(definitions: Definitions) -> str | bytes:
    """The identity of a file: its name, or its content if it has no name."""
    return definitions.file or definitions.source


def _reachable(
    definitions: Definitions, process: Process, called: CalledProcesses
) -> dict[str, tuple[Definitions, str]]:
    """All processes called directly or indirectly; all of `called` if a called element is computed."""
    found: dict[str, tuple[Definitions, str]] = {}
    waiting = [(definitions, process)]
    for file, one in waiting:
        for node in one.body.walk():
            if isinstance(node, CallActivity):
                named = {node.called: called.get(node.called) or (file, node.called)}
                for key, target in (called if node.called_expression is not None else named).items():
                    if key not in found and (key in called or file.process(key) is not None):
                        found[key] = target
                        waiting.append((target[0], _process(*target)))
    return found


def _pool(definitions: Definitions, process_id: str, name: str) -> Participant | None:
    pools = [one for one in definitions.participants if one.process == process_id]
    named = [one for one in pools if one.label == name]
    return next(iter(named or pools), None)


# ---- ids -------------------------------------------------------------------------------------------------------------


def _make_unique(fragment: Fragment, taken: set[str]) -> None:
    """Number the ids that are already taken, and their uses in the fragment."""
    renamed = unique_ids(fragment.everything(), taken)
    fragment.ids = {id: renamed.get(id, id) for id in fragment.ids}


def _update_calls(fragment: Fragment, ids: Mapping[str, str]) -> None:
    """Update the called elements to the ids in the new file."""
    for element in fragment.elements():
        for tag, attribute in _CALLS:
            value = element.get(attribute) if element.tag == tag else None
            called = resolve(ids, value)
            if called is not None:
                element.set(attribute, called)


_CALLS = (
    (f"{_B}callActivity", "calledElement"),
    (f"{{{ZEEBE}}}calledElement", "processId"),
    (f"{{{CALL}}}process", "process"),
)


# ---- the new file ----------------------------------------------------------------------------------------------------


def _new_root(home: Node, others: Iterable[Node]) -> Node:
    prefixes: dict[str | None, str] = {"camunda": CAMUNDA}
    for other in (*others, home):
        prefixes.update({prefix: uri for prefix, uri in other.nsmap.items() if prefix or other is home})
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
    root = _new_root(fragments[0].root, [fragment.root for fragment in fragments[1:]])
    parts = [fragment.collaboration for fragment in fragments if fragment.collaboration is not None]
    parts += [one for fragment in fragments for one in fragment.processes]
    parts += [one for fragment in fragments for one in fragment.shared]
    parts += [one for fragment in fragments for one in fragment.diagrams]
    for part in parts:
        update_type_prefixes(part, root)
        root.append(part)
    etree.indent(root, "  ")
    return root


def update_type_prefixes(part: Node, root: Node) -> None:
    """Update the namespace prefix in the values of ``xsi:type`` to that of the new file."""
    prefix = next((prefix for prefix, uri in root.nsmap.items() if uri == BPMN), None)
    for element in part.iter("*"):
        value = element.get(_XSI_TYPE)
        if value is not None:
            bare = value.rpartition(":")[2]
            element.set(_XSI_TYPE, f"{prefix}:{bare}" if prefix else bare)
