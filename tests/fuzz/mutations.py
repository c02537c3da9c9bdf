"""Damage to valid input: bytes, texts, JSON, XML and zip files, by the numbers of a `Random`."""

from __future__ import annotations

import copy
import io
import json
import zlib
from collections.abc import Callable, Sequence
from random import Random
from typing import Any
from zipfile import BadZipFile, ZipFile

from lxml import etree

Mutate = Callable[[Random, bytes, Sequence[bytes]], bytes]
"""Makes an input from a valid one and all valid ones."""

_BYTES = (b"\0", b"\xff", b"\x7f", b"\x80", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"\xff" * 8, b"\n")
_WORDS = (
    "", "0", "-1", "1e400", "nan", "NaN", "Infinity", "-Infinity", "null", "true", "9" * 30, "9" * 5000,
    "1" + "0" * 400, "\0", "\u200b",
    "\ud800", "ü", "\U0001f600", "\u202e", "..", "../..", "/dev/zero", "/", "~", "%s%n", "${", "${x}", "=", "#", "---",
    "<", "&amp;",
    "<!-- -->", "]]>", "'", '"', "\\", "{", "}", "[", "]", "(", ")", ":", ",", "\t", "\r\n", "2026-02-30",
    "PT99999999999999H",
    "R/PT0S", "0x10", "1_0", "!!python/object/apply:os.getcwd []", "!!binary x", "&a [*a]", "*a", "<<: 1",
    "? [a]\n: b", "- - - -",
)  # fmt: skip
_DEEP = (
    ("[", "]"),
    ("{", "}"),
    ("(", ")"),
    ('{"a":', "}"),
    ("[[", "]]"),
    ("- ", ""),
    ("-", ""),
    ("not(", ")"),
    ("<a>", "</a>"),
)


def text_or_bytes(random: Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """Damage of a few places: bits, pieces left out, doubled, moved or taken from other input, words, depth, length."""
    found = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 5))):
        begin = random.randrange(len(found) + 1)
        end = min(len(found), begin + random.choice((1, 1, 2, 4, 8, 40, 400)))
        match random.randrange(10):
            case 0 if begin < len(found):
                found[begin] ^= 1 << random.randrange(8)
            case 1:
                del found[begin:end]
            case 2:
                found[begin:begin] = found[begin:end] * random.choice((1, 2, 50))
            case 3:
                del found[begin:]
            case 4:
                other = random.choice(others)
                start = random.randrange(len(other) + 1)
                found[begin:end] = other[start : start + random.choice((1, 10, 100, 1000))]
            case 5:
                found[begin:end] = random.choice(_BYTES)
            case 6 | 7:
                found[begin:end] = random.choice(_WORDS).encode(errors="surrogatepass")
            case 8:
                left, right = random.choice(_DEEP)
                depth = random.choice((3, 40, 1200, 20_000))
                found[begin:begin] = (left * depth + right * random.choice((0, depth))).encode()
            case _:
                found[begin:begin] = random.choice(_WORDS).encode(errors="surrogatepass") * random.choice(
                    (2, 100, 3000)
                )
        if len(found) > 300_000:
            del found[300_000:]
    return bytes(found)


# ---- JSON ------------------------------------------------------------------------------------------------------------

_VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**53, 2**63, 2**64, -(2**63) - 1, 10**30, 10**400, 0.5, -0.0, 1e308,
    float("nan"), float("inf"),
    float("-inf"), "", "x", "\0", "\ud800", "\u202e\x1b[31m", "/a/b", "../x", "REX", "a" * 70_000, [], {}, [[]],
    [None], {"": 0},
    {"a": {"b": {"c": []}}}, [1, "a", None], [0] * 20_000, {str(number): number for number in range(12_000)},
)  # fmt: skip


def json_text(random: Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """Damage of values and names of a JSON text; sometimes of the text, as no value writes it."""
    kind = random.randrange(8)
    try:
        value = json.loads(data)
    except (ValueError, RecursionError):
        kind = 0
    if kind == 0:
        return text_or_bytes(random, data, others)
    try:
        for _ in range(random.choice((1, 1, 2, 6))):
            value = changed(random, value, others)
        text = json.dumps(value, ensure_ascii=random.random() < 0.5)
    except RecursionError:  # deep in what was made deep
        return text_or_bytes(random, data, others)
    if kind == 1 and isinstance(value, dict) and value:
        twice = f"{json.dumps(random.choice(sorted(value)))}: {random.choice(('1', 'null', '[]', '{}'))}"
        text = f"{{{twice}, {text[1:]}" if random.random() < 0.5 else f"{text[:-1]}, {twice}}}"
    return text.encode(errors="surrogatepass")


def changed(random: Random, value: Any, others: Sequence[bytes] = ()) -> Any:
    """A value with one place of it changed."""
    place = random.randrange(5)
    if isinstance(value, dict) and value and place:
        found = dict(value)
        name = random.choice(sorted(found))
        if place == 1:
            del found[name]
        elif place == 2:
            found[random.choice((name.upper(), f"{name}_", "", "__class__", "\0", *found))] = found[name]
        else:
            found[name] = changed(random, found[name], others)
        return found
    if isinstance(value, list) and value and place:
        found = list(value)
        number = random.randrange(len(found))
        if place == 1:
            del found[number]
        elif place == 2:
            found.insert(random.randrange(len(found) + 1), found[number])
        else:
            found[number] = changed(random, found[number], others)
        return found
    if isinstance(value, str) and value.startswith("{") and random.random() < 0.5:
        return json_text(random, value.encode(errors="replace"), others).decode(errors="replace")
    if isinstance(value, str) and random.random() < 0.5:
        return text_or_bytes(random, value.encode(errors="replace"), others or (b"x",)).decode(errors="replace")
    if random.random() < 0.1:
        return nested(random, value)
    return random.choice(_VALUES)


def nested(random: Random, value: Any) -> Any:
    """A value deep in lists or objects."""
    for _ in range(random.choice((5, 31, 33, 100, 400))):
        value = [value] if random.random() < 0.5 else {"a": value}
    return value


def json_lines(random: Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """Damage of one line of JSON, or of the order of the lines."""
    lines = data.split(b"\n")
    number = random.randrange(len(lines))
    match random.randrange(6):
        case 0:
            random.shuffle(lines)
        case 1:
            del lines[number]
        case _:
            lines[number] = json_text(random, lines[number], others)
    return b"\n".join(lines)


# ---- XML -------------------------------------------------------------------------------------------------------------

_BOMB = b'<!DOCTYPE d [<!ENTITY a "aaaaaaaaaa">' + b"".join(
    b'<!ENTITY %c "%s">' % (98 + number, b"&%c;" % (97 + number) * 10) for number in range(9)
) + b'<!ENTITY x SYSTEM "file:///etc/hostname">]>'  # fmt: skip


def xml(random: Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """Damage of the elements and attributes of an XML file; sometimes of its text, as no tree writes it."""
    kind = random.randrange(10)
    if kind == 0:
        return text_or_bytes(random, data, others)
    try:
        root = etree.fromstring(data, etree.XMLParser(remove_blank_text=True))
    except (etree.XMLSyntaxError, ValueError):
        return text_or_bytes(random, data, others)
    for _ in range(random.choice((1, 1, 2, 5))):
        _damage(random, root)
    found = etree.tostring(root)
    if kind == 1:
        begin = random.choice((found.find(b">"), found.rfind(b"</")))
        found = _BOMB + found[:begin] + random.choice((b"&j;", b"&x;", b"")) + found[begin:]
    elif kind == 2:
        depth = random.choice((100, 255, 300, 5000))
        end = found.rfind(b"</")
        name = random.choice((b"a", b"bpmn:subProcess", b"extensionElements"))
        found = found[:end] + b"<%s>" % name * depth + b"</%s>" % name * depth + found[end:]
    return found


def _damage(random: Random, root: etree._Element) -> None:
    elements = list(root.iter("*"))
    one, other = random.choice(elements), random.choice(elements)
    name = random.choice(sorted(map(str, one.attrib))) if one.attrib else "id"
    words = [word for word in _WORDS if word.isprintable()]
    inside = other in list(one.iter("*"))
    match random.randrange(9):
        case 0 if one.getparent() is not None:
            one.getparent().remove(one)  # type: ignore[union-attr]
        case 1:
            one.attrib.pop(name, None)
        case 2:
            one.set(name, random.choice((*words, "a" * 100_000, other.get("id", ""), other.get("name", ""))))
        case 3:
            one.text = random.choice((*words, "x" * 100_000, other.text or ""))
        case 4 if not inside:
            other.append(copy.deepcopy(one))  # the same id twice
        case 5 if not inside and one is not root:
            other.append(one)
        case 6:
            one.tag = other.tag
        case 7:
            for key in [key for key in one.attrib if str(key).endswith("Ref")] or [name]:
                one.set(key, other.get("id", ""))
        case _:
            found = text_or_bytes(random, (one.text or "x").encode(), [b"${x + 1}"]).decode(errors="replace")
            one.text = "".join(sign for sign in found[:2000] if sign.isprintable() or sign in "\t\n")


# ---- files with checksums --------------------------------------------------------------------------------------------


def zipped(random: Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """Damage of a file inside a zip file, whose checksums fit; sometimes of the zip file."""
    if random.random() < 0.25:
        return text_or_bytes(random, data, others)
    try:
        with ZipFile(io.BytesIO(data)) as given:
            files = {name: given.read(name) for name in given.namelist()}
    except (BadZipFile, NotImplementedError, zlib.error, EOFError):
        return text_or_bytes(random, data, others)
    name = "schema.json" if "schema.json" in files and random.random() < 0.7 else random.choice(sorted(files))
    files[name] = (json_text if name.endswith(".json") else text_or_bytes)(random, files[name], [files[name]])
    if random.random() < 0.1:
        del files[random.choice(sorted(files))]
    written = io.BytesIO()
    with ZipFile(written, "w") as target:
        for each, content in files.items():
            target.writestr(each, content)
    return written.getvalue()
