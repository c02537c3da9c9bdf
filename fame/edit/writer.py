"""Writes what was changed in an editor into the text of a file, which keeps everything else.

An editor (bpmn-moddle) reads a file into its own model and writes all of it anew: comments, prefixes, entities, white
space and what it does not know are lost. So three texts are compared: the `old` one of the file, the `base` that the
editor writes of it unchanged, and the `new` one. What differs between `base` and `new` was done by somebody; it is
applied to the elements of `old` that correspond to those of `base`. Elements correspond by id (shapes without one by
the element that they show), else by equal content, else by their order among those of the same tag. An element that
went into another one takes its text along. The order of elements with ids stays that of the old file.

An editor that moves a diagram, or adds one, as it opens a file has not been asked to: diagrams stay where the file has
them, and are added when something in them is changed.

Invariant, tried by tests: the editor writes of the result what it wrote as `new`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from difflib import SequenceMatcher
from typing import Any

from fame.bpmn.reader.xml import BPMNDI, DC
from fame.bpmn.tags import TYPE, QName, Tag, decoded, read_tags, written_name

# ---- what corresponds ------------------------------------------------------------------------------------------------


def _pairs(some: Sequence[Tag], others: Sequence[Tag]) -> dict[Tag, Tag]:
    """Which element of `others` corresponds to each of `some`."""
    by_key = {one.key: one for one in others if one.key is not None}
    found = {one: by_key[one.key] for one in some if one.key is not None and one.key in by_key}
    left, right = [one for one in some if one.key is None], [one for one in others if one.key is None]
    contents = [one.content for one in left], [one.content for one in right]
    for block in SequenceMatcher(None, *contents, autojunk=False).get_matching_blocks():
        found.update(zip(left[block.a : block.a + block.size], right[block.b : block.b + block.size], strict=True))
    taken = set(found.values())
    for one in (one for one in left if one not in found):
        other = next((other for other in right if other not in taken and other.name == one.name), None)
        if other is not None:
            found[one] = other
            taken.add(other)
    return found


# ---- writing ---------------------------------------------------------------------------------------------------------


def save(old: str, base: str, new: str, *, file: str = "") -> str:
    """Return the old text with what differs between two texts that an editor wrote of it. Raises ModelError."""
    texts = _in_frame(read_tags(old, file), read_tags(base, file), read_tags(new, file), base, new)
    return _Writing(old, read_tags(old, file), *(read_tags(text, file) for text in texts)).text()


def _in_frame(old: Tag, before: Tag, now: Tag, base: str, new: str) -> tuple[str, str]:
    """Both texts of the editor with each diagram where the old text has it: bpmn-js moves some as it opens a file."""
    moves = dict[tuple[Any, ...] | None, tuple[float, float]]()
    places, theirs = _shapes(old), _shapes(before)
    for plane, shapes in theirs.items():
        apart = {
            (round(places[plane][key][0] - x, 3), round(places[plane][key][1] - y, 3))
            for key, (x, y) in shapes.items()
            if key in places.get(plane, {})
        }
        if len(apart) == 1 and apart != {(0.0, 0.0)}:
            moves[plane] = apart.pop()
    return (_moved(before, base, moves), _moved(now, new, moves)) if moves else (base, new)


def _shapes(root: Tag) -> dict[tuple[Any, ...] | None, dict[tuple[Any, ...] | None, tuple[float, float]]]:
    """Where each shape of each diagram begins."""
    found: dict[tuple[Any, ...] | None, dict[tuple[Any, ...] | None, tuple[float, float]]] = {}
    for plane in (one for one in root.walk() if one.name == (BPMNDI, "BPMNPlane")):
        bounds = [(shape.key, one) for shape in plane.children for one in shape.children if one.name == (DC, "Bounds")]
        found[plane.key] = {key: place for key, one in bounds if (place := _place(one)) is not None}
    return found


def _place(tag: Tag) -> tuple[float, float] | None:
    x, y = (tag.attributes.get(("", name)) for name in "xy")
    with suppress(ValueError):
        return (float(x.value), float(y.value)) if x is not None and y is not None else None
    return None


def _moved(root: Tag, text: str, moves: Mapping[tuple[Any, ...] | None, tuple[float, float]]) -> str:
    """A text with all points of some diagrams moved."""
    changes = list[tuple[int, int, str]]()
    for plane in (one for one in root.walk() if one.name == (BPMNDI, "BPMNPlane") and one.key in moves):
        for tag in (one for one in plane.walk() if _place(one) is not None):
            for name, by in zip("xy", moves[plane.key], strict=True):
                value, start, end = tag.attributes[("", name)]
                changes.append((start, end, f' {name}="{round(float(value) + by, 6):.12g}"'))
    for start, end, written in sorted(changes, reverse=True):
        text = text[:start] + written + text[end:]
    return text


def save_bytes(old: bytes, base: str, new: str, *, file: str = "") -> bytes:
    """As `save`, for the content of a file, whose encoding stays. Raises ModelError."""
    text, encoding = decoded(old, file)
    return save(text, base, new, file=file).encode(encoding, "xmlcharrefreplace")


class _Writing:
    """One text while changes are written into it."""

    def __init__(self, source: str, old: Tag, base: Tag, new: Tag) -> None:
        self._source, self._old, self._base, self._new = source, old, base, new
        self._newline = "\r\n" if "\r\n" in source else "\n"
        first = source[old.inside : old.children[0].start] if old.children else "\n  "
        self._unit = first.rpartition("\n")[2] if "\n" in first and first.isspace() else "  "
        self._places = [{one.key: one for one in root.walk() if one.key is not None} for root in (old, base)]
        every = (item for one in new.walk() for item in one.prefixes.items())
        self._prefixes = {uri: prefix for prefix, uri in every if prefix}
        self._relocated = {
            one.key
            for diagram in new.children
            if diagram.name == (BPMNDI, "BPMNDiagram") and diagram.key not in self._places[0]
            for one in (diagram.walk() if self._differs(diagram) else ())
        }
        self._missing: dict[str, str] = {}  # namespace -> prefix to declare

    def _differs(self, new: Tag) -> bool:
        """Whether an element is not as the editor has it of the unchanged file."""
        base = self._places[1].get(new.key) if new.key is not None else None
        return base is None or base.content != new.content

    def text(self) -> str:
        """Return the whole text."""
        body = self._merged(self._old, self._base, self._new)
        if self._missing:
            declared = "".join(f' xmlns:{prefix}="{_quoted(uri)}"' for uri, prefix in self._missing.items())
            end = re.match(r"<[^\s/>]+", body)
            assert end is not None
            body = body[: end.end()] + declared + body[end.end() :]
        return self._source[: self._old.start] + body + self._source[self._old.end :]

    def _merged(self, old: Tag, base: Tag, new: Tag) -> str:
        """The text of an old element with what differs between the other two."""
        left = self._relocated and any(one.key in self._relocated for one in old.walk() if one is not old)
        if base.content == new.content and not left:
            return self._source[old.start : old.end]
        opening, body = self._opening(old, base, new), self._body(old, base, new)
        if old.is_empty:
            if not body:
                return opening
            opening = re.sub(r"\s*/>\Z", ">", opening)
            return f"{opening}{body}</{written_name(self._source, old)}>"
        return opening + body + self._source[old.close : old.end]

    def _opening(self, old: Tag, base: Tag, new: Tag) -> str:
        """The opening tag with the changed attributes."""
        text, shift = self._source[old.start : old.inside], old.start
        changes = list[tuple[int, int, str]]()
        end = old.inside - (2 if text.endswith("/>") else 1)
        while self._source[end - 1].isspace():
            end -= 1
        for name in dict.fromkeys((*base.attributes, *new.attributes)):
            before, now = base.attributes.get(name), new.attributes.get(name)
            if (before and before.value) != (now and now.value):
                place = old.attributes.get(name)
                start, stop = (place.start, place.end) if place is not None else (end, end)
                changes.append((start, stop, "" if now is None else self._attribute(old, name, now.value)))
        for start, stop, written in sorted(changes, key=lambda one: one[:2], reverse=True):
            space = re.match(r"\s*", self._source[start:stop])
            written = (space[0] if space and space[0] else " ") + written if written else ""
            text = text[: start - shift] + written + text[stop - shift :]
        return text

    def _attribute(self, old: Tag, name: QName, value: str) -> str:
        if name == TYPE:
            value = self._qualified(old, *value.split(" ", 1)) if " " in value else value
        return f'{self._qualified(old, *name, attribute=True)}="{_quoted(value)}"'

    def _qualified(self, scope: Tag, uri: str, local: str, *, attribute: bool = False) -> str:
        """A name with the prefix that the old text has for its namespace there."""
        if not uri:
            return local
        known = [prefix for prefix, one in scope.prefixes.items() if one == uri and (prefix or not attribute)]
        if not known and uri not in self._missing:
            stem = self._prefixes.get(uri) or "ns"
            taken = {*scope.prefixes, *self._missing.values()}
            self._missing[uri] = next(
                one for number in range(len(taken) + 1) if (one := f"{stem}{number or ''}") not in taken
            )
        prefix = known[0] if known else self._missing[uri]
        return f"{prefix}:{local}" if prefix else local

    # ---- content -----------------------------------------------------------------------------------------------------

    def _body(self, old: Tag, base: Tag, new: Tag) -> str:
        """What is between the tags of an old element, with what differs between the other two."""
        source, to_base, to_new = self._source, _pairs(old.children, base.children), _pairs(base.children, new.children)
        if not (base.children or new.children):
            inside = source[old.inside : old.close]
            return inside if base.text == new.text else _written(new.text, inside)
        pieces, written = list[list[str]](), dict[Tag, list[str]]()
        end = old.inside
        for child in old.children:
            gap, end = source[end : child.start], child.end
            before = to_base.get(child)
            now = to_new.get(before) if before is not None else None
            if (before is None and (child.key is None or child.key not in self._relocated)) or now is not None:
                text = self._merged(child, before, now) if before is not None and now is not None else ""
                pieces.append([gap, text or source[child.start : child.end]])
                written |= {now: pieces[-1]} if now is not None else {}
            elif gap.strip():  # a comment stays
                pieces.append([gap.rstrip(), ""])
        tail = source[end : old.close]
        self._insert(old, new, pieces, written, {now: before for before, now in to_new.items()})
        if pieces and not tail and "\n" in pieces[0][0] and not old.children:
            tail = self._newline + self._indent(old)
        return "".join(gap + text for gap, text in pieces) + tail

    def _insert(
        self, old: Tag, new: Tag, pieces: list[list[str]], written: dict[Tag, list[str]], known: Mapping[Tag, Tag]
    ) -> None:
        """Add the new children of an element, each behind the one before it. `known`: those of the base."""
        if old.children:
            first = self._source[old.inside : old.children[0].start]
            space = first[len(first.rstrip()) :]
        else:
            own = self._own_space(old)
            space = self._newline + self._indent(old) + self._unit if "\n" in own else ""
        place = 0
        for child in new.children:
            if child not in written and child in known and known[child].content == child.content:
                continue  # the editor adds it by itself
            if child in written:
                place = next(number for number, one in enumerate(pieces) if one is written[child]) + 1
            else:
                pieces.insert(place, [space, self._new_text(old, child, space)])
                place += 1

    def _new_text(self, parent: Tag, child: Tag, space: str) -> str:
        """The text of an element that is new there: as it was elsewhere, or as the editor says it."""
        old, base = (places.get(child.key) if child.key else None for places in self._places)
        if old is not None and base is not None and old.prefixes == parent.prefixes and self._has_left(old, child):
            return self._merged(old, base, child)
        name = self._qualified(parent, *child.name)
        attributes = "".join(f" {self._attribute(parent, *one)}" for one in self._values(child))
        if child.children:
            inner = space + self._unit if space else ""
            parts = "".join(inner + self._new_text(parent, one, inner) for one in child.children)
            return f"<{name}{attributes}>{parts}{space}</{name}>"
        return f"<{name}{attributes}>{_written(child.text)}</{name}>" if child.text else f"<{name}{attributes} />"

    @staticmethod
    def _values(tag: Tag) -> Iterator[tuple[QName, str]]:
        return ((name, one.value) for name, one in tag.attributes.items())

    def _has_left(self, old: Tag, new: Tag) -> bool:
        """Whether the parent of an old element does not have it any more."""
        assert old.parent is not None
        assert new.parent is not None
        return old.parent.key != new.parent.key

    def _own_space(self, old: Tag) -> str:
        """The white space before an element."""
        before = self._source[: old.start]
        return before[len(before.rstrip()) :]

    def _indent(self, old: Tag) -> str:
        return self._own_space(old).rpartition("\n")[2]


def _quoted(value: str) -> str:
    """A value between quotation marks."""
    for character, escaped in (("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ('"', "&quot;")):
        value = value.replace(character, escaped)
    return re.sub(r"[\t\r\n]", lambda found: f"&#{ord(found[0])};", value)


def _written(text: str, instead_of: str = "") -> str:
    """A text between tags: a CDATA section where there was one, or many lines of code."""
    if "]]>" not in text and (instead_of.strip().startswith("<![CDATA[") or (not instead_of and "\n" in text)):
        return f"<![CDATA[{text}]]>"
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
