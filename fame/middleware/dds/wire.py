"""What stands on the wire: names of topics and types as ROS 2 mangles them, and messages as bytes.

Cyclone gets and gives CDR as it is; `fame.middleware.codec` packs and unpacks. It wants to know the fields of a type
nevertheless, for its own check of what comes in, so each type is declared with its true fields (keyless, final).
"""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from cyclonedds.idl import make_idl_struct, types

from fame.middleware import codec, typesystem
from fame.middleware.dds.type_descriptors import describe
from fame.middleware.definitions import EMPTY_FIELD, Field
from fame.middleware.errors import check_name

idl: Any = types  # for mypy: its types are made by indexing instances
TOPIC, REQUEST, REPLY = "rt", "rq", "rr"
"""What the name of a DDS topic begins with: that of a ROS topic, of requests to a service, of its responses."""

HEADER = 4
"""Length of the encapsulation header of CDR (bytes)."""

_LARGEST_BOUND = 65535
_ROS_TYPE = re.compile(r"(\w+)::(msg|srv|action)::dds_::(\w+)_")


def dds_topic(name: str, kind: str = TOPIC, ending: str = "") -> str:
    """The DDS topic of a full name. Raises MessageError for a name that ROS 2 and DDS refuse.

    >>> dds_topic("/REX/odom"), dds_topic("/grip", REQUEST, "Request")
    ('rt/REX/odom', 'rq/gripRequest')
    """
    check_name(name)
    return f"{kind}{name}{ending}"


def dds_type(name: str) -> str:
    """
    >>> dds_type("std_msgs/msg/String")
    'std_msgs::msg::dds_::String_'
    """
    package, kind, short = name.split("/")
    return f"{package}::{kind}::dds_::{short}_"


def ros_type(name: str) -> str:
    """The inverse of `dds_type`; another name is returned as it is."""
    match = _ROS_TYPE.fullmatch(name)
    return f"{match[1]}/{match[2]}/{match[3]}" if match else name


def type_hash(name: str) -> str:
    """The entry of an end's USER_DATA by which ROS 2 tells whether both ends mean the same type."""
    return f"typehash={codec.type_hash(name)};"


def handle(value: int) -> int:
    """The instance handle of an entity. cyclonedds gives it signed in some places and unsigned in others."""
    return value & 0xFFFF_FFFF_FFFF_FFFF


@cache
def declared(name: str, header: bool) -> Any:
    """The class that Cyclone gets for a type: ``declared(...)(data)`` holds CDR, `data` is what it holds.

    `header` puts the two numbers of a service's request or response before the fields.
    """
    content = typesystem.definition(name)
    fields: dict[str, Any] = {"guid": idl.uint64, "sequence_number": idl.int64} if header else {}
    fields |= {field.name: _member(field) for field in content.fields}
    cls = make_idl_struct(
        content.name.rpartition("/")[2],
        dds_type(content.name),
        fields or {EMPTY_FIELD: idl.uint8},
        dataclassify=False,
    )
    if not header:
        describe(content.name, cls)
    # Not by inheritance, which would become part of the type.
    for method, function in _AS_IT_IS.items():
        setattr(cls, method, function)
    return cls


def _keep(self: Any, data: bytes) -> None:
    self.data = data


def _give(self: Any, *args: Any, **options: Any) -> bytes:
    return self.data  # type: ignore[no-any-return]


def _take(cls: Any, data: bytes, *args: Any, **options: Any) -> Any:
    return cls(data)


_AS_IT_IS = {
    "__init__": _keep,
    "serialize": _give,
    "deserialize": classmethod(_take),
    "deserialize_key": classmethod(_take),
}


def _member(field: Field) -> Any:
    single = declared(field.base, False) if field.is_message else _primitive(field)
    if field.shape == "single":
        return single
    if field.shape == "array":
        return idl.array[single, field.size]
    bounded = 0 < field.size <= _LARGEST_BOUND
    return idl.sequence[single, field.size] if bounded else idl.sequence[single]


def _primitive(field: Field) -> Any:
    if field.base == "string":
        return idl.bounded_str[field.bound] if field.bound else str
    return bool if field.base == "bool" else getattr(idl, field.base)
