"""The elements of a file with their places in its text, for who changes a part of it and leaves everything else."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import lru_cache
from typing import Any, NamedTuple

from fame.bpmn.reader.xml import parse
from fame.dataclasses import dataclass, field
from fame.errors import ModelError

_TOKEN = re.compile(
    r"<!--.*?-->|<\?.*?\?>|<!\[CDATA\[(?P<data>.*?)\]\]>|</(?P<close>[^\s>]+)\s*>"
    r"|<(?P<open>[^\s/>!?]+)(?P<attributes>(?:\s+[^\s=]+\s*=\s*(?:\"[^\"]*\"|'[^']*'))*)\s*(?P<empty>/?)>",
    re.DOTALL,
)
_ATTRIBUTE = re.compile(r"\s+(?P<name>[^\s=]+)\s*=\s*(?P<quote>[\"'])(?P<value>.*?)(?P=quote)", re.DOTALL)
_NAME = re.compile(r"<([^\s/>]+)")
_REFERENCE = re.compile(r"&(?:#x([0-9a-fA-F]+)|#([0-9]+)|(lt|gt|amp|quot|apos));")
_NAMED = {"lt": "<", "gt": ">", "amp": "&", "quot": '"', "apos": "'"}
TYPE = ("http://www.w3.org/2001/XMLSchema-instance", "type")

QName = tuple[str, str]
"""(namespace, local name)"""


class Attribute(NamedTuple):
    """An attribute, and where it is in the text, with the white space before it."""

    value: str
    start: int
    end: int


@dataclass(slots=True, eq=False)
class Tag:
    """An element and its places in the text: of the element, and of what is between its tags.

    `key` tells it from others of its file, if anything does.
    """

    name: QName
    attributes: dict[QName, Attribute]
    prefixes: Mapping[str, str]
    start: int
    inside: int
    key: tuple[Any, ...] | None = None
    parent: Tag | None = None
    close: int = 0
    end: int = 0
    text: str = ""
    children: list[Tag] = field(default_factory=list)
    _content: tuple[Any, ...] | None = None

    @property
    def content(self) -> tuple[Any, ...]:
        """All that it says, whatever the prefixes, the order of attributes and white space between elements."""
        if self._content is None:
            attributes = sorted((name, one.value) for name, one in self.attributes.items())
            text = "" if self.children and not self.text.strip() else self.text
            self._content = (self.name, tuple(attributes), text, tuple(one.content for one in self.children))
        return self._content

    @property
    def is_empty(self) -> bool:
        """Whether it is one tag: ``<a/>``."""
        return self.inside == self.end

    def walk(self) -> Iterator[Tag]:
        """Yield it and all that is in it, in the order of the file."""
        yield self
        for one in self.children:
            yield from one.walk()


def written_name(text: str, tag: Tag) -> str:
    """Return the name of an element as it is written in the text."""
    found = _NAME.match(text, tag.start)
    assert found is not None
    return found[1]


def _unescaped(text: str) -> str:
    def character(found: re.Match[str]) -> str:
        hexadecimal, decimal, name = found.groups()
        return _NAMED[name] if name else chr(int(hexadecimal, 16) if hexadecimal else int(decimal))

    return _REFERENCE.sub(character, text.replace("\r\n", "\n"))


@lru_cache(maxsize=4)
def read_tags(text: str, file: str) -> Tag:
    """Return the elements of a document, which is kept for the next call. Raises ModelError."""
    parse(re.sub(r"\A\ufeff?(<\?xml[^>]*?)\sencoding\s*=\s*[\"'][^\"']*[\"']", r"\1", text).encode(), file)
    top = Tag(("", ""), {}, {"": "", "xml": "http://www.w3.org/XML/1998/namespace"}, 0, 0)
    inner, end = top, 0
    for token in _TOKEN.finditer(text):
        inner.text += _unescaped(text[end : token.start()]) + (token["data"] or "").replace("\r\n", "\n")
        end = token.end()
        if token["open"]:
            tag = _opened(inner, token)
            inner.children.append(tag)
            inner = tag if not token["empty"] else inner
        elif token["close"]:
            inner.close, inner.end = token.start(), end
            assert inner.parent is not None
            inner = inner.parent
    return top.children[0]


def _opened(parent: Tag, token: re.Match[str]) -> Tag:
    given = list(_ATTRIBUTE.finditer(token["attributes"]))
    declared = {one["name"][6:]: one["value"] for one in given if one["name"].partition(":")[0] == "xmlns"}
    prefixes = {**parent.prefixes, **declared} if declared else parent.prefixes

    def name(text: str, default: str) -> QName:
        prefix, colon, local = text.rpartition(":")
        return prefixes.get(prefix, prefix) if colon else default, local

    shift, attributes = token.start("attributes"), dict[QName, Attribute]()
    for one in given:
        if one["name"].partition(":")[0] != "xmlns":
            value = _unescaped(re.sub(r"\r\n|[\t\n]", " ", one["value"]))  # moddle writes \r as it is
            place = name(one["name"], "")
            if place == TYPE:  # a qualified name
                value = " ".join(name(value, prefixes[""]))
            attributes[place] = Attribute(value, shift + one.start(), shift + one.end())
    inside, end = token.end(), token.end()
    tag = name(token["open"], prefixes[""])
    told = attributes.get(("", "id")) or attributes.get(("", "bpmnElement"))
    key = (tag, told.value.rpartition(":")[2]) if told is not None else None
    return Tag(tag, attributes, prefixes, token.start(), inside, key, parent, inside, end)


def decoded(content: bytes, file: str) -> tuple[str, str]:
    """Return the text of a file, with its byte order mark, and its encoding. Raises ModelError."""
    encoding = parse(content, file).getroottree().docinfo.encoding or "utf-8"
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encoding = "utf-16-le" if content[0] == 0xFF else "utf-16-be"
    with suppress(LookupError, UnicodeError):
        text = content.decode(encoding)
        if text.encode(encoding) == content:
            return text, encoding
    raise ModelError(f"expected a file in UTF-8 or another encoding of Python, got {encoding}", file=file)
