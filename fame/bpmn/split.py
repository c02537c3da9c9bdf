"""Splits a collaboration into one self-contained file per pool.

It works on the XML, so that what FAME does not know comes along. The new file has the pool and its process, the
processes that it calls, what these declare at the root (signals, messages, errors ...), and their drawings. Files that
were drawn apart use the same ids, so those of a called process that are taken get a number; and every event whose
topic's type is said elsewhere gets it written down, for elsewhere is another robot's file from now on.
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
    """What one robot (or many alike) gets: a self-contained executable model, as XML. `filename` has no folder."""

    name: str
    multi_instance: bool
    process_id: str
    source: bytes

    @property
    def filename(self) -> str:
        """A name for its file: that of the pool, without what file systems do not like."""
        return re.sub(r"[^\w.-]+", "_", self.name).strip("._") + ".bpmn"


CalledProcesses = Mapping[str, tuple[Definitions, str]]
"""What call activities name -> the file that has it, and the id of the process in it."""


def split(definitions: Definitions | str | Path, library: Library | None = None) -> list[Part]:
    """One self-contained model per pool: its process, what that calls, its signals with their types, its drawing.

    The model may be a path. Raises ModelError.
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
    """One process as an executable file of its own, self-contained, UTF-8.

    `name` picks the pool where several have this process, and is the name of the pool in the new file. `called` says
    which process each call activity means, at any depth; processes of the same file need not be there. `topic_types`
    maps qualified topics to types. Message flows are left out: topics carry messages. Raises ModelError if a file lacks
    a process that it should have.
    """
    process = _process(definitions, process_id)
    reached = _reachable(definitions, process, called or {})
    files = _by_file(definitions, process, reached.values())
    pool = _pool(definitions, process_id, name)
    pieces: list[Fragment] = []
    taken: set[str] = set()
    for file, processes in files:
        piece = copy_fragment(file, processes, pool if file is definitions else None, topic_types or {})
        _make_unique(piece, taken)
        pieces.append(piece)
    homes = {_key(piece.definitions): piece for piece in pieces}
    ids = {key: homes[_key(file)].ids[id] for key, (file, id) in reached.items()}
    for piece in pieces:
        _point_calls(piece, ids)
    if pieces[0].collaboration is not None and name:
        next(pieces[0].collaboration.iterchildren(f"{_B}participant")).set("name", name)
    return etree.tostring(_assemble(pieces), xml_declaration=True, encoding="UTF-8") + b"\n"


def _process(definitions: Definitions, id: str) -> Process:
    process = definitions.process(id)
    if process is None:
        has = ", ".join(one.id for one in definitions.processes) or "none"
        raise ModelError(f"the file has no process {id!r}: it has {has}", file=definitions.file)
    return process


def _by_file(
    definitions: Definitions, process: Process, reached: Iterable[tuple[Definitions, str]]
) -> list[tuple[Definitions, list[Process]]]:
    """Files with the processes that are wanted of them; that of the pool first."""
    found = {_key(definitions): (definitions, [process])}
    for file, id in reached:
        home, processes = found.setdefault(_key(file), (file, []))
        if all(one.id != id for one in processes):
            processes.append(_process(home, id))
    return list(found.values())


def _key(definitions: Definitions) -> str | bytes:
    """What tells files apart: the name, or the content of one that has no name."""
    return definitions.file or definitions.source


def _reachable(
    definitions: Definitions, process: Process, called: CalledProcesses
) -> dict[str, tuple[Definitions, str]]:
    """What the process calls, and what that calls, in the order of meeting; all of `called` if a call is computed."""
    found: dict[str, tuple[Definitions, str]] = {}
    waiting = [(definitions, process)]
    for file, one in waiting:
        for node in one.body.walk():
            if isinstance(node, CallActivity):
                named = {node.called: called.get(node.called) or (file, node.called)}
                for key, there in (called if node.called_expression is not None else named).items():
                    if key not in found and (key in called or file.process(key) is not None):
                        found[key] = there
                        waiting.append((there[0], _process(*there)))
    return found


def _pool(definitions: Definitions, process_id: str, name: str) -> Participant | None:
    pools = [one for one in definitions.participants if one.process == process_id]
    named = [one for one in pools if one.label == name]
    return next(iter(named or pools), None)


# ---- ids -------------------------------------------------------------------------------------------------------------


def _make_unique(piece: Fragment, taken: set[str]) -> None:
    """Gives ids that are taken a number, wherever the piece uses them."""
    renamed = unique_ids(piece.everything(), taken)
    piece.ids = {id: renamed.get(id, id) for id in piece.ids}


def _point_calls(piece: Fragment, ids: Mapping[str, str]) -> None:
    """Makes every call activity name the process as it is called in the new file."""
    for element in piece.elements():
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
    prefixes = {prefix: uri for prefix, uri in prefixes.items() if _can_be_new(f"{{{uri}}}any")}
    known = {name: value for name, value in home.attrib.items() if _can_be_new(name)}
    root = etree.Element(home.tag, known, nsmap=prefixes)  # type: ignore[arg-type]
    for one in home.iterchildren(f"{_B}documentation", f"{_B}extensionElements"):
        root.append(deepcopy(one))
    return root


def _can_be_new(name: str | bytes) -> bool:
    """Whether a name can be given to a new element: a namespace that is no URI can only be copied."""
    try:
        etree.Element(name)
    except ValueError:
        return False
    return True


def _assemble(pieces: list[Fragment]) -> Node:
    root = _new_root(pieces[0].root, [piece.root for piece in pieces[1:]])
    parts = [piece.collaboration for piece in pieces if piece.collaboration is not None]
    parts += [one for piece in pieces for one in piece.processes]
    parts += [one for piece in pieces for one in piece.shared]
    parts += [one for piece in pieces for one in piece.diagrams]
    for part in parts:
        update_type_prefixes(part, root)
        root.append(part)
    etree.indent(root, "  ")
    return root


def update_type_prefixes(part: Node, root: Node) -> None:
    """``xsi:type`` holds a prefix in its value: that of the new file."""
    prefix = next((prefix for prefix, uri in root.nsmap.items() if uri == BPMN), None)
    for element in part.iter("*"):
        value = element.get(_XSI_TYPE)
        if value is not None:
            bare = value.rpartition(":")[2]
            element.set(_XSI_TYPE, f"{prefix}:{bare}" if prefix else bare)
