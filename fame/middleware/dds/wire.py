"""Names of topics and types as ROS 2 mangles them in DDS, and the types that Cyclone gets.

Cyclone takes and gives CDR as it is; `fame.middleware.codec` packs and unpacks. It needs the fields of a type
nevertheless, to check what comes in, so each type is declared with its true fields (keyless, final).

Each endpoint carries a descriptor of its type (DDS XTypes 1.3, section 7.3.4: TypeInformation and TypeMapping). To
compute it, cyclonedds needs 30 ms for the first type, a fifth of the start of an engine; so those of the types in
`fame.middleware.builtin_types` are stored here.
"""

from __future__ import annotations

import base64
import re
import zlib
from functools import cache
from typing import Any

from cyclonedds.idl import make_idl_struct, types

from fame.middleware import codec, typesystem
from fame.middleware.builtin_types import PARTICIPANT, STRING
from fame.middleware.definitions import EMPTY_FIELD, Field
from fame.middleware.errors import check_name

idl: Any = types  # for mypy: its types are made by indexing instances
TOPIC, REQUEST, REPLY = "rt", "rq", "rr"
"""Prefixes of DDS topics: of a ROS topic, of the requests to a service, of its responses."""

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
    """The entry of the USER_DATA of an endpoint by which ROS 2 compares the types of two endpoints."""
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
        _set_descriptor(content.name, cls)
    # Not by inheritance, which would become part of the type.
    for method, function in _CDR_METHODS.items():
        setattr(cls, method, function)
    return cls


def _set_data(self: Any, data: bytes) -> None:
    self.data = data


def _get_data(self: Any, *args: Any, **options: Any) -> bytes:
    return self.data  # type: ignore[no-any-return]


def _from_data(cls: Any, data: bytes, *args: Any, **options: Any) -> Any:
    return cls(data)


_CDR_METHODS = {
    "__init__": _set_data,
    "serialize": _get_data,
    "deserialize": classmethod(_from_data),
    "deserialize_key": classmethod(_from_data),
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


def _set_descriptor(name: str, declared: Any) -> None:
    """Give a declared type its stored descriptor, if there is one; cyclonedds computes the others."""
    if name in _DESCRIPTORS:
        length, packed = _DESCRIPTORS[name]
        data = zlib.decompress(base64.b64decode(packed))
        declared.__idl__._xt_data = name, name  # only says that they exist
        declared.__idl__._xt_bytedata = data[:length], data[length:]


_DESCRIPTORS = {
    STRING: (
        100,
        "eNpLYGBgYBRgcNAA0ipALALEHyNTczm4dqotNl42V23ORgaQHAiwQGkmNPWfDt9quGbxUnr+Wq7ssphDDMFo6m1AdmAxF6T/YyAjWI4BahaI"
        "zQPlMzIUMPSW11ukQ8XR7fEHiQH1q0LVywJxcUlKfG5xerGVFZC0skpJKY63sgouKcrMS48HqZGGmiWMZAcrkE5JLEkE8ZWw24XmdACXeEJ8",
    ),
    PARTICIPANT: (
        196,
        "eNo7wMDAwCjA4BABpEOAWASIP15dtORafJXn5qrNz5OamBiigGJMQGwCpcFqOJul50/kyktbod34M+QHgxFMvKoqtqz8xJzuf55e8ifmM7SB"
        "9KCZ/0mv6SsP3+HE74tWP+7/ep5hKxbzPy27F5Zh1elvekzl9dSOpQzxMHHjyjcOG/O4LrvOOWxir8LAyMjA4AXEzFjcHQYSC2RkAEqDgRvU"
        "fEkonxHdF7rBK34DxeXAciDc8JERw0tTjZR90X3JwNCEZlcRELMAsQDcrkKwoZ6BPy0E4OZDxB65hCrKQd0GsxPVYRJp169D3MWMU03Otgmn"
        "0WOFgUEPzV0wv4nB3TXhMyNUTIC3t7zegoHBnQliD3o8bQSJAc2ygeoFxVdRbnl8SkpxfHJ+bm5+npVVbnG6lRVIwMoqILGoJDM5syAxr8Q1"
        "rySzJDO12DMvLT+eIRPqVyW4G9BjGxJ26ZkpYHlLRHx8YsRMAgziQLm8/JTU+FSoNfGZIHuKUwsxE8xfqB9MoXbr4veDH9BYVMcDwU6o+xTR"
        "4pYf5o68xNzU4oLE5FSIvAxafHMhqwOyDRFxD/YfemCAzC1KTUxJLYoHBgnUX1B9zAT0lRdllqDoQ1MVDQ0PDahfFPCHhzvQHAZ1qH/ksaYh"
        "BgZWIJ2SWJIIkotjwJqW0LIqWiShZS80J6MlcgA2lFF3",
    ),
}
"""Type -> length of the TypeInformation, and it with the TypeMapping, compressed."""
