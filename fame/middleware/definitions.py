"""The definition of a message type, read from the type store of rosbags or from a `.msg`, `.srv` or `.action` text.

Two things are corrected on the way: `char` is `uint8` in ROS 2, and the defaults that a `.msg` file gives its fields,
which rosbags drops, are kept.
"""

from __future__ import annotations

import keyword
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from types import MappingProxyType
from typing import Any, Literal, TypeAlias

from fame.config.scalars import earlier, note_change
from fame.dataclasses import dataclass, replace
from fame.errors import MessageError
from fame.text import DEPTH, is_deep

FieldShape = Literal["single", "array", "sequence"]
LONGEST, MOST_LINES, DEEPEST, MOST_FIELDS, LARGEST = 1_000_000, 5_000, 32, 100_000, 100_000_000
"""Of types: characters and lines of a text; how deep messages contain messages, the fields and the bytes in all of a
message of defaults."""
EMPTY_FIELD = "structure_needs_at_least_one_member"
"""The one field that ROS gives an empty message. It is on the wire, and nowhere else."""


@dataclass(frozen=True, slots=True)
class Field:
    """One field. `base` is a primitive (``float64``, ``string``) or a message type (``std_msgs/msg/Header``).

    `attribute` is its name in Python (``from_`` for ``from``). `size` is the length of an array, or the bound of a
    sequence (0: none); `bound` is that of a string in bytes (0: none).
    """

    name: str
    attribute: str
    base: str
    shape: FieldShape
    size: int = 0
    bound: int = 0

    @property
    def is_message(self) -> bool:
        """Whether it holds messages, not primitives."""
        return "/" in self.base

    def __str__(self) -> str:
        """Its type as a `.msg` file writes it: ``float64[36]``, ``string<=10``, ``geometry_msgs/msg/Point[]``."""
        base = f"{self.base}<={self.bound}" if self.bound else self.base
        if self.shape == "single":
            return base
        return (
            f"{base}[{self.size}]" if self.shape == "array" else f"{base}[<={self.size}]" if self.size else f"{base}[]"
        )


@dataclass(frozen=True, slots=True)
class Definition:
    """A message type. An empty one has no `fields`. `defaults`: field -> its default as written, where it has one."""

    name: str
    fields: tuple[Field, ...]
    constants: Mapping[str, Any]
    defaults: Mapping[str, Any]

    @property
    def is_wrapper(self) -> bool:
        """Whether its only field is `data`, as of ``std_msgs/msg/String``: such a message wraps a single value."""
        return len(self.fields) == 1 and self.fields[0].name == "data"


def check_text(text: str, name: str) -> None:
    """Raise MessageError for the text of a type that is too long to be parsed."""
    lines = text.count("\n") + 1
    if len(text) > LONGEST or lines > MOST_LINES:
        got = f"{len(text):,} characters in {lines:,} lines"
        raise MessageError(f"has {got}; at most {LONGEST:,} in {MOST_LINES:,} are read", type=name)


Sizes: TypeAlias = dict[str, tuple[int, int, int]]
"""By type: how deep its messages contain others, their fields in all, and about how many bytes they take."""


def check_size(
    name: str, find: Callable[[str], Definition | None], known: Sizes, inside: tuple[str, ...] = ()
) -> Sizes:
    """Add a type, and those that it contains, which `find` defines, to the `known` ones. Returns these.

    Raises MessageError if a field is of an unknown type, a type contains itself, or its messages would be too large.
    """
    content = find(name)
    if content is None:
        raise MessageError("its definition is not known", type=name)
    depth, fields, bytes = 0, 0, 200
    for field in content.fields:
        one = (0, 1, 64 if field.base == "string" else int(re.sub(r"\D", "", field.base) or 8) // 8)
        if field.is_message:
            if field.base in (name, *inside):
                raise MessageError("a type cannot contain itself", type=name, field=field.name)
            if find(field.base) is None:
                raise MessageError(f"its type {field.base} is not known: register it", type=name, field=field.name)
            if field.base not in known and len(inside) < DEEPEST:
                check_size(field.base, find, known, (*inside, name))
            one = known.get(field.base, (DEEPEST, 0, 0))
        times = {"single": 1, "array": field.size, "sequence": 0}[field.shape]
        depth, fields, bytes = max(depth, one[0] + 1), fields + max(1, one[1] * min(times, 1)), bytes + one[2] * times
    for got, most, what in ((depth, DEEPEST, "levels"), (fields, MOST_FIELDS, "fields"), (bytes, LARGEST, "bytes")):
        if got > most:
            raise MessageError(f"its messages have {got:,} {what}; at most {most:,} are accepted", type=name)
    known[name] = depth, fields, bytes
    return known


def from_rosbags(name: str, constants: Any, fields: Any, defaults: Mapping[str, Any]) -> Definition:
    """Return the definition of a type from rosbags' (name, type, value) of constants and (name,
    description) of fields."""
    return Definition(
        name,
        tuple(_field(*entry) for entry in fields if entry[0] != EMPTY_FIELD),
        MappingProxyType({constant: value for constant, _, value in constants}),
        MappingProxyType(dict(defaults)),
    )


def from_text(text: str, name: str) -> list[Definition]:
    """Return the types of the text of a `.msg`, `.srv` or `.action` file.

    They are the message ``pkg/msg/Type``, the two of the service ``pkg/srv/Name``, or all that travels for the action
    ``pkg/action/Name``. Raises MessageError for a name of another form and for a text that cannot be read.
    """
    match = re.fullmatch(r"[a-z][a-z0-9_]*/(msg|srv|action)/[A-Z][A-Za-z0-9]*(?:_Request|_Response)?", name)
    if match is None:
        text = "a type is named like my_robot_msgs/msg/Wheel, my_robot_msgs/srv/Reset or my_robot_msgs/action/Drive"
        raise MessageError(text, type=name)
    check_text(text, name)
    lines = text.splitlines()
    if match[1] == "msg":
        return [_message(lines, name)]
    parts = [f"{name}_{part}" for part in _PARTS[match[1]]]
    separators = [number for number, line in enumerate(lines) if line.strip() == "---"]
    if len(separators) != len(parts) - 1:
        raise MessageError(_SEPARATED[match[1]], type=name)
    begins, ends = [0, *(number + 1 for number in separators)], [*separators, len(lines)]
    found = [_message(lines[begin:end], part) for begin, end, part in zip(begins, ends, parts, strict=True)]
    return found if match[1] == "srv" else [*found, *_transport(name)]


_PARTS = {"srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}
_SEPARATED = {
    "srv": "a service is a request and a response, with a line of --- between them",
    "action": "an action is a goal, a result and a feedback, with lines of --- between them",
}


def _transport(name: str) -> list[Definition]:
    """The messages in which goals, results and feedback of an action travel (ROS 2 design, article Actions)."""
    id, time = ("goal_id", "unique_identifier_msgs/msg/UUID"), ("stamp", "builtin_interfaces/msg/Time")
    travelling = {
        "SendGoal_Request": (id, ("goal", f"{name}_Goal")),
        "SendGoal_Response": (("accepted", "bool"), time),
        "GetResult_Request": (id,),
        "GetResult_Response": (("status", "int8"), ("result", f"{name}_Result")),
        "FeedbackMessage": (id, ("feedback", f"{name}_Feedback")),
    }
    nothing: Mapping[str, Any] = MappingProxyType({})
    return [
        Definition(
            f"{name}_{part}", tuple(Field(field, field, base, "single") for field, base in fields), nothing, nothing
        )
        for part, fields in travelling.items()
    ]


def _field(name: str, description: Any) -> Field:
    """A field from its description, which is (kind, content), or (kind, ((kind, content), size)) for several values."""
    from rosbags.interfaces import Nodetype

    kind, content = description
    size = 0
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        (_, content), size = content
    base, bound = (content, 0) if isinstance(content, str) else content
    shapes: dict[Any, FieldShape] = {Nodetype.ARRAY: "array", Nodetype.SEQUENCE: "sequence"}
    attribute = f"{name}_" if keyword.iskeyword(name) else name
    return Field(name, attribute, "uint8" if base == "char" else base, shapes.get(kind, "single"), size, bound)


def _message(lines: list[str], name: str) -> Definition:
    from rosbags.typesys import TypesysError, get_types_from_msg

    defaults = [_default(line) for line in lines]
    fixed = [_CONSTANT.fullmatch(line.partition("#")[0].rstrip()) for line in lines]
    bare = [
        f"{found[0]} {found[1]}" if found else f"{constant[1]} {constant[2]}=0" if constant else line
        for found, constant, line in zip(defaults, fixed, lines, strict=True)
    ]
    place = re.sub("/(srv|action)/", "/msg/", name)  # where a type without package is looked for
    constants = dict[str, Any]()
    for line, without_default in zip(lines, bare, strict=True):
        if is_deep(line):
            raise MessageError(f"brackets are nested more than {DEPTH} deep in {line.strip()[:80]!r}", type=name)
        try:
            if constant := _CONSTANT.fullmatch(line.partition("#")[0].rstrip()):
                constants[constant[2]] = _constant(*constant.groups())
            elif _EQUAL.match(line):
                raise ValueError(line)
            get_types_from_msg(without_default, place)
        except (TypesysError, ValueError, RecursionError):  # the latter two: numbers and depth without end
            text = f"cannot read {line.strip()[:200]!r}: a line is like float64[3] position, or uint8 RED=1"
            raise MessageError(text, type=name) from None
    ((_, fields),) = get_types_from_msg("\n".join(bare), place).values()
    result = replace(from_rosbags(name, (), fields, {}), constants=MappingProxyType(constants))
    written = {field: text for _, field, text in filter(None, defaults)}
    seen = set[str]()
    for entry in result.fields:
        base = entry.base.rpartition("/")[2]
        if base == "wstring":
            raise MessageError("wstring is not supported: use string, which is UTF-8", type=name, field=entry.name)
        if entry.is_message and base[0].islower():  # what the parser makes of a primitive that it does not know
            text = f"there is no primitive type {base!r}; a message type begins with a capital letter"
            raise MessageError(text, type=name, field=entry.name)
        if entry.name in seen:
            raise MessageError("there are two fields of this name", type=name, field=entry.name)
        if entry.is_message and entry.name in written:
            raise MessageError("expected no default: only primitives have one", type=name, field=entry.name)
        seen.add(entry.name)
    own = {each.name: _default_of(each, written[each.name], name) for each in result.fields if each.name in written}
    return replace(result, defaults=MappingProxyType(own))


def _default(line: str) -> tuple[str, str, str] | None:
    """The type and name of a field in a line of a `.msg` file, and its default: ``float64 w 1.0``. None without one."""
    match = re.fullmatch(r"\s*(\S+)\s+(\w+)\s+([^=\s][^=]*)", line.partition("#")[0].rstrip())
    return None if match is None else (match[1], match[2], match[3])


_CONSTANT = re.compile(r"\s*(\S+)\s+(\w+)\s*=\s*(.*)")
_EQUAL = re.compile(r"\s*[^\s#]+\s+[^#]*=")


def _constant(base: str, name: str, text: str) -> Any:
    """A constant as rosidl_adapter reads it, as a default. Raises ValueError for one of another type."""
    from fame.middleware.primitives import Misfit, converter

    try:
        base = "uint8" if base == "char" else base.partition("<")[0]
        return converter(Field(name, name, base, "single"))(_default_item(base, text))
    except (Misfit, LookupError):
        raise ValueError(text) from None


_ITEM = re.compile(r"""\s*("(?:\\"|[^"])*"|'(?:\\'|[^'])*'|[^,]+)\s*,?""")


def _default_of(field: Field, text: str, type: str) -> Any:
    """A default as rosidl_adapter reads it (its parser.py): a text is taken as it is, only its outer quotes go."""
    from fame.middleware.primitives import Misfit, converter

    if field.shape != "single" and text[0] + text[-1] == "[]":
        items = _ITEM.findall(text[1:-1]) if field.base == "string" else text[1:-1].split(",")
        default: Any = [_default_item(field.base, item.strip()) for item in items if item]
    else:
        default = _default_item(field.base, text) if field.shape == "single" else text
    with suppress(Misfit):  # a default that does not fit is refused with the class of the message
        old, new = (converter(field)(value) for value in (earlier(text), default))
        note_change(text, f"{type}: {field.name}", new, old)
    return default


def _default_item(base: str, text: str) -> Any:
    """One value; a text of another type is refused later, with the class of the message."""
    if base == "string":
        quote = text[:1] if text[:1] in ("'", '"') and text[-1:] == text[:1] else ""
        return text[1:-1].replace(f"\\{quote}", quote) if quote else text
    if base == "bool":
        return text.lower() in ("true", "1") if text.lower() in ("true", "1", "false", "0") else text
    for read in (float,) if base.startswith("float") else (int, lambda number: int(number, 0)):
        try:
            return read(text)
        except ValueError:  # not written in this way
            pass
    return text
