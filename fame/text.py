"""Text from elsewhere: read it as JSON, make it printable, set it in tables, and suggest similar names."""

from __future__ import annotations

import errno
import json
import math
import os
import re
import stat
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from io import BufferedReader
from pathlib import Path
from typing import Any
from unicodedata import combining, normalize

from fame.errors import ConfigError

_ROS_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_STRING = re.compile(r'"[^"\\]*+(?:\\.[^"\\]*+)*+"?', re.DOTALL)  # possessive: linear in the text
_NO_BRACKETS = re.compile(r"[^\[\]{}]+")
NOT_XML = re.compile("[\0-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")
"""Characters that are not allowed in XML."""
DEPTH = 32
"""How deep lists and objects may be nested in JSON from elsewhere."""
NAMES = "ASCII letters, digits and _, not starting with a digit"
"""The parts of a name that ROS 2 allows between slashes."""


def open_file(path: Path) -> BufferedReader:
    """Open a file to read it. Raises OSError, also for a named pipe, at which nobody may ever write.

    What a shell gives for ``<(command)`` is a pipe without such a name.
    """
    if stat.S_ISFIFO(path.stat().st_mode) and path.parent not in (Path("/dev"), Path("/dev/fd"), Path("/proc/self/fd")):
        raise OSError(errno.ESPIPE, "expected a file, got a named pipe")
    return path.open("rb")


def read_json(text: str, longest: int = 1_000_000, load: Callable[[str], Any] = json.loads) -> Any:
    """Return the value of a text from elsewhere, whose size (characters) and depth are checked before `load` makes it.

    Raises ValueError; never RecursionError, here or where the value is walked.
    """
    if len(text) > longest:
        raise ValueError(f"{len(text)} characters; at most {longest} are accepted")
    if is_deep(text):
        raise ValueError(f"brackets do not match, or are nested more than {DEPTH} deep")
    return load(text)


def table(heads: Sequence[str], rows: Sequence[Sequence[str | int]]) -> str:
    """Columns as wide as their longest cell, numbers to the right. A row is a line, whatever its cells say."""
    rows = [[printable(cell) if isinstance(cell, str) else cell for cell in row] for row in rows]
    widths = [max(len(str(row[column])) for row in (heads, *rows)) for column in range(len(heads))]
    right = [bool(rows) and isinstance(cell, int) for cell in (rows[0] if rows else heads)]
    lines = (
        "  ".join(
            str(cell).rjust(width) if number else str(cell).ljust(width)
            for cell, width, number in zip(row, widths, right, strict=True)
        )
        for row in (heads, *rows)
    )
    return "\n".join(line.rstrip() for line in lines)


def is_deep(text: str, depth: int = DEPTH) -> bool:
    """Return whether lists and objects of a JSON text are nested deeper than this, or its brackets do not match.

    A text with fewer brackets cannot be; whoever reads it finds out whether they match.
    """
    if text.count("[") + text.count("{") <= depth:
        return False
    left = _NO_BRACKETS.sub("", _STRING.sub("", text)).replace("{", "[").replace("}", "]")
    for _ in range(depth):
        if not left:
            return False
        left = left.replace("[]", "")  # what has nothing in it
    return bool(left)


def sorted_set(items: Collection[Any]) -> list[Any]:
    """Return what is in a set in an order that no hash decides: numbers by value before others by their texts.

    >>> sorted_set({"b", 10, "a", 9})
    [9, 10, 'a', 'b']
    """

    def place(item: Any) -> tuple[bool, Any]:
        is_number = isinstance(item, int | float) and item == item
        return not is_number, item if is_number else repr(sorted_set(item) if isinstance(item, frozenset) else item)

    return sorted(items, key=place)


def printable(text: str) -> str:
    r"""Return a text on one line: what is not printable (escape sequences, line ends, marks of direction) as in
    ``\x1b``.

    So it cannot fake a row of a table or colour a terminal. The function is idempotent.
    """
    if text.isprintable():
        return text
    return "".join(sign if sign.isprintable() else sign.encode("unicode_escape").decode("ascii") for sign in text)


_LISTED = 20
"""Known words of which a hint lists all."""


def percent(share: float, places: int = 0) -> str:
    """Return a share (0 to 1) in percent. Only 1 is 100, and only 0 is 0: what is nearly all is not all.

    >>> percent(0.9996), percent(0.9996, 1), percent(1.0, 1), percent(0.0001)
    ('99', '99.9', '100.0', '1')
    """
    least, rounded = 10.0**-places, round(100 * share, places)
    if 0 < share < 1:
        rounded = min(max(rounded, least), 100 - least)
    return f"{rounded:.{places}f}"


def as_number(text: str) -> float:
    """Return the number in a text; NaN if the text is not a number."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return a hint at the closest known word for `word`, else at all of them, or at the first 20 of more."""
    from difflib import get_close_matches

    words = list(known)
    folded = {one.casefold(): one for one in reversed(words)}
    if close := get_close_matches(word.casefold(), folded, n=1):
        return f"did you mean {folded[close[0]]!r}?"
    more = f" and {len(words) - _LISTED} more" if len(words) > _LISTED else ""
    return f"known are: {', '.join(words[:_LISTED]) or 'none'}{more}"


def wrong_ending(name: str, known: Iterable[str]) -> str:
    """Return what is wrong with the name of a file that ends in none of these."""
    return f"expected a file name that ends in one of {', '.join(known)}, got {os.path.splitext(name)[1] or name!r}"


def unreadable(error: OSError) -> str:
    """Return why a file cannot be read."""
    missing = isinstance(error, FileNotFoundError) and error.filename
    return f"cannot be read: {error.strerror}{similar_file(error.filename) if missing else ''}"


@contextmanager
def writing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield the name of a file beside another one, whose place it takes if the block ends without an error: nobody sees
    a part of it, and what was there stays until then. Folders are made. A device is written itself.

    A file that exists keeps its mode, access control list and, where the system allows it, its owner. Raises
    ConfigError, with the name of the file, for OSError, and before the block for a file that is write-protected.
    """
    from tempfile import TemporaryDirectory

    whole = Path(path)
    direct = whole.is_relative_to("/dev") or (whole.exists() and not whole.is_file())
    whole = whole if direct else Path(os.path.realpath(path))  # a link stays one
    try:
        whole.parent.mkdir(parents=True, exist_ok=True)
        if direct:
            yield whole
            return
        if whole.exists() and not (whole.stat().st_mode & 0o222 and os.access(whole, os.W_OK)):  # root may write any
            raise PermissionError(errno.EACCES, "it is write-protected")
        with TemporaryDirectory(prefix=".part.", dir=whole.parent, ignore_cleanup_errors=True) as private:
            part = Path(private, whole.name)
            yield part
            if part.exists():
                if whole.exists():
                    _take_rights(part, whole)
                part.replace(whole)
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.strerror or error}", file=str(path)) from None


def _take_rights(part: Path, whole: Path) -> None:
    """Give a new file the mode, access control list and owner of the one that it replaces."""
    from shutil import copystat

    old, new = whole.stat(), part.stat()
    for owner, group in ((-1, old.st_gid), (old.st_uid, -1)):
        with suppress(AttributeError, PermissionError):  # Windows has no owners
            os.chown(part, owner, group)
    copystat(whole, part)
    os.utime(part, ns=(new.st_atime_ns, new.st_mtime_ns))


def writable(path: Path, *read: str | os.PathLike[str]) -> None:
    """Make the folder that a result will be written to, and try whether it can be, before hours are spent on it.

    Files that are `read` for it stay: they are no place for a result. Raises ConfigError.
    """
    if os.path.realpath(path) in {os.path.realpath(each) for each in read}:
        raise ConfigError("expected a new file, got one that is read", file=str(path))
    if path.is_dir():
        raise ConfigError("expected a file, got a folder", file=str(path))
    with writing(path):  # makes a folder beside it
        pass


def write_file(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a whole file, as `writing` does."""
    with writing(path) as part:
        part.write_bytes(content.encode() if isinstance(content, str) else content)


def similar_file(path: str | os.PathLike[str]) -> str:
    """Return a hint at a file with a similar name, for one that does not exist; else empty."""
    from difflib import get_close_matches

    folder, name = os.path.split(path)
    try:
        beside = os.listdir(folder or ".")
    except (OSError, ValueError):
        beside = []
    return "".join(f"; did you mean {each!r}?" for each in get_close_matches(name, beside, n=1))


def is_ros_name(name: str) -> bool:
    """Return whether ROS 2 accepts the full name of a topic or service."""
    return _ROS_NAME.fullmatch(name) is not None


def ros_name(text: str) -> str:
    """Return a name that people write, of a signal, message or label, as the name of a topic.

    A name that ROS 2 allows, or that begins with ``/`` or ``~/``, stays as it is, and so does one without any Latin
    letter, of which no topic can be made (see `wrong_topic`). In any other, accents are dropped, each run of other
    characters becomes one ``_``, none at the ends, and a leading digit gets an ``n``.

    >>> ros_name("Order received"), ros_name("Fl\u00e4che 2!"), ros_name("3 done"), ros_name("a__b"), ros_name("~/odom")
    ('Order_received', 'Flache_2', 'n3_done', 'a__b', '~/odom')
    """
    if not label_of(text) or is_ros_name(f"/{text}"):
        return text
    plain = "".join(each for each in normalize("NFKD", text) if not combining(each))
    name = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_")
    if not re.search(r"[A-Za-z]", name):
        return text
    return f"n{name}" if name[0].isdigit() else name


@lru_cache(maxsize=1024)
def topic_of(name: str) -> str:
    """Return the topic of a name that people write: ``/Order_received``, or ``~/odom`` in the robot's namespace."""
    name = ros_name(name)
    return f"/{name}" if label_of(name) else name


def label_of(name: str) -> str:
    """Return a name from which a topic is made; empty for a topic that is written literally."""
    return "" if name.startswith(("/", "~/")) else name


def wrong_topic(topic: str, label: str) -> str:
    """Return what is wrong with a topic, empty if ROS 2 allows it. `label`: as `label_of` gives."""
    if is_ros_name(topic.removeprefix("~")):
        return ""
    if label:
        return f"{label!r} has no Latin letter to make a topic of: write a topic as its name, such as /order_received"
    return f"{topic} is not a valid ROS 2 topic name: expected {NAMES}"
