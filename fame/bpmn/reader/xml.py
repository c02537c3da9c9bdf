"""Parses XML from untrusted sources, and helpers for its elements, ids and references.

Document types, and with them entities, are refused. Nothing is loaded over the network. Size and depth (256, by the
parser) are bounded.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TypeVar

from lxml import etree

from fame.errors import ModelError
from fame.text import open_file

Node = etree._Element
T = TypeVar("T")

BPMN = "http://www.omg.org/spec/BPMN/20100524/MODEL"
BPMNDI = "http://www.omg.org/spec/BPMN/20100524/DI"
DC = "http://www.omg.org/spec/DD/20100524/DC"
DI = "http://www.omg.org/spec/DD/20100524/DI"
CAMUNDA = "http://camunda.org/schema/1.0/bpmn"
ACTIVITI = "http://activiti.org/bpmn"
FLOWABLE = "http://flowable.org/bpmn"
ZEEBE = "http://camunda.org/schema/zeebe/1.0"

LIMIT = 20_000_000
"""Largest size of a document, in bytes."""

_B = f"{{{BPMN}}}"
_IN_BPMN = f"{{{BPMN}"
_PROLOG = re.compile(rb"(?>\s*(?><\?.*?\?>|<!--.*?-->))*+\s*<!DOCTYPE", re.DOTALL)
_MARKS = b"\xef\xbb\xbf\xff\xfe"


def parse(source: bytes, file: str, *, keep_all: bool = False) -> Node:
    """Return the root element of a BPMN document.

    `keep_all` keeps comments, processing instructions and CDATA sections, for writing the document again. Raises
    ModelError if it is too large, has a document type, is not well-formed, or its root is not ``definitions`` of BPMN
    2.0.
    """
    root = parse_any(source, file, keep_all=keep_all)
    if root.tag != f"{_B}definitions":
        name = etree.QName(root)
        where = f"of namespace {name.namespace}" if name.namespace else "without a namespace"
        text = f"the root is <{name.localname}> {where}: expected <definitions> of {BPMN}"
        raise ModelError(text, file=file, line=line_of(root))
    return root


def parse_any(source: bytes, file: str, *, keep_all: bool = False) -> Node:
    """Return the root element of any XML document; otherwise as `parse`."""
    check_size(len(source), file)
    if _PROLOG.match(source.replace(b"\0", b"").lstrip(_MARKS)):
        raise _has_document_type(file)
    try:
        root = _tree(source, keep_all)
    except etree.XMLSyntaxError as error:
        if source.startswith(b"PK\x03\x04"):
            raise ModelError("is a zip archive: extract the .bpmn file from it", file=file) from None
        if file.endswith((".yaml", ".yml")):
            raise ModelError(
                "expected a model (.bpmn), such as the one that a scenario names, got YAML", file=file
            ) from None
        reason = re.sub(r", line \d+, column \d+.*", "", error.msg or "it is empty")
        raise ModelError(f"not well-formed XML: {reason}", file=file, line=error.lineno or 0) from None
    if root.getroottree().docinfo.internalDTD is not None:
        raise _has_document_type(file)
    return root


def _tree(source: bytes, keep_all: bool, recover: bool = False) -> Node:
    """The root of a document. `recover` ignores errors."""
    parser = etree.XMLParser(
        resolve_entities=False,
        load_dtd=False,
        no_network=True,
        huge_tree=False,
        remove_comments=not keep_all,
        remove_pis=not keep_all,
        strip_cdata=not keep_all,
        collect_ids=False,
        recover=recover,
    )
    try:
        return etree.fromstring(source, parser)
    except etree.XMLSyntaxError:
        if any(one.type != etree.ErrorTypes.WAR_NS_URI for one in parser.error_log):
            raise
    return _tree(source, keep_all, recover=True)  # only warnings about namespace names, which need not be URIs here


def read_file(path: Path) -> bytes:
    """Return the content of a file, however little its size says of it. Raises OSError, and
    ModelError if it is too large."""
    check_size(path.stat().st_size, str(path))
    with open_file(path) as file:
        content = file.read(LIMIT + 1)
    if len(content) > LIMIT:
        raise ModelError(f"expected at most {LIMIT // 1_000_000} MB, got more", file=str(path))
    return content


def check_size(size: int, file: str) -> None:
    """Raise ModelError if a document of `size` bytes is too large."""
    if size > LIMIT:
        text = f"expected at most {LIMIT // 1_000_000} MB, got {size / 1e6:.0f} MB"
        raise ModelError(text, file=file)


def _has_document_type(file: str) -> ModelError:
    return ModelError("the file has a document type (<!DOCTYPE ...>), which is not allowed: remove it", file=file)


def line_of(element: Node) -> int:
    """Return the line where the opening tag ends, 1-based; 0 if unknown."""
    line: int | None = element.sourceline  # type: ignore[assignment]
    return line or 0


def local_name(element: Node) -> str:
    """Return the tag without its namespace."""
    return element.tag.rpartition("}")[2]


def attributes(element: Node) -> list[str]:
    """Return the names of the attributes, ``{namespace}name`` for those with a namespace."""
    return element.keys()  # type: ignore[return-value]


def text_of(element: Node) -> str:
    return element.text or "" if not len(element) else "".join(str(piece) for piece in element.itertext())


Parts = dict[str, list[Node]]


def parts_of(element: Node) -> Parts:
    """Return the BPMN children by local name, in document order."""
    found: Parts = {}
    for child in element:
        namespace, _, name = child.tag.rpartition("}")
        if namespace == _IN_BPMN:
            if name in found:
                found[name].append(child)
            else:
                found[name] = [child]
    return found


def children(element: Node, name: str) -> Iterator[Node]:
    """Return the BPMN children with that local name."""
    return element.iterchildren(_B + name)


def child(element: Node, name: str) -> Node | None:
    """Return the first BPMN child with that local name, or None."""
    return element.find(_B + name)


# ---- ids and references ----------------------------------------------------------------------------------------------


def resolve(table: Mapping[str, T], reference: str | None) -> T | None:
    """Return the entry that a reference names, or None. References are qualified names: the id may have a prefix."""
    if not reference:
        return None
    reference = reference.strip()
    found = table.get(reference)
    return found if found is not None else table.get(reference.rpartition(":")[2])


def local_id(element: Node, name: str) -> str:
    """Return the id in an attribute that is a qualified name, without a prefix that the file declares."""
    prefix, colon, id = element.get(name, "").strip().partition(":")
    return id if colon and prefix in element.nsmap else prefix + colon + id


def ids_in(root: Node) -> Counter[str]:
    """Return the ids of a tree, to be given to `invented_id`."""
    return Counter({id: 1 for one in root.iter("*") if (id := one.get("id"))})


def invented_id(stem: str, taken: Counter[str]) -> str:
    """Return the stem, numbered from 2 if it is taken, and add it to `taken`: each id with the last number tried."""
    id = stem
    while id in taken:
        taken[stem] += 1
        id = f"{stem}_{taken[stem]}"
    taken[id] = 1
    return id


def unique_ids(elements: Iterable[Node], taken: Counter[str]) -> dict[str, str]:
    """Number the ids of elements that are already taken, also in their references. Adds all their ids to `taken`.

    Returns old id -> new id.
    """
    elements = list(elements)
    own = {id for one in elements if (id := one.get("id"))}
    twice = sorted(own & taken.keys())
    taken |= Counter(own)
    renamed = {id: invented_id(id, taken) for id in twice}
    for element in elements if renamed else ():
        _rename(element, renamed)
    return renamed


def is_reference(name: str) -> bool:
    """Return whether attributes of that name are references to ids."""
    return name in ("default", "bpmnElement") or name.endswith("Ref")


def _rename(element: Node, renamed: Mapping[str, str]) -> None:
    for name, value in element.items():
        new = resolve(renamed, str(value)) if name == "id" or is_reference(str(name)) else None
        if new is not None:
            element.set(name, new)
    if element.tag.endswith(("Ref", "Refs")) or element.tag in (f"{_B}incoming", f"{_B}outgoing"):
        element.text = resolve(renamed, text_of(element)) or element.text
