"""Parameters of nodes, as ROS 2 has them: the services by which `ros2 param` lists, reads, describes and sets them.

Every node between processes offers these services (``<node>/list_parameters`` ...: rcl_interfaces), one set for all of
its parts: `ros2 param list` waits 5 s for each node that does not. Within rclpy, rclpy offers them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Literal

from fame.dataclasses import dataclass, field
from fame.errors import ConfigError, MessageError
from fame.middleware import messages
from fame.middleware.interface import Node

ParameterType = Literal["bool", "int", "float", "str", "file", "floats", "strs"]

FIELDS = {
    "bool": (1, "bool_value"),
    "int": (2, "integer_value"),
    "float": (3, "double_value"),
    "str": (4, "string_value"),
    "file": (4, "string_value"),
    "floats": (8, "double_array_value"),
    "strs": (9, "string_array_value"),
}
"""Type of a parameter -> its number in rcl_interfaces/msg/ParameterType, and the field of its value."""

_BY_NUMBER = {**dict(FIELDS.values()), 6: "bool_array_value", 7: "integer_array_value", 5: "byte_array_value"}
_SERVICES = {
    "ListParameters": "string[] prefixes\nuint64 depth\n---\nListParametersResult result",
    "GetParameters": "string[] names\n---\nParameterValue[] values",
    "DescribeParameters": "string[] names\n---\nParameterDescriptor[] descriptors",
    "GetParameterTypes": "string[] names\n---\nuint8[] types",
    "SetParameters": "Parameter[] parameters\n---\nSetParametersResult[] results",
    "SetParametersAtomically": "Parameter[] parameters\n---\nSetParametersResult result",
}
KINDS = tuple(_SERVICES)
"""The service types, in rcl_interfaces/srv."""
_CONSTANTS = {"ListParameters": "uint64 DEPTH_RECURSIVE=0\n"}
_USED = ("ListParametersResult", "ParameterValue", "ParameterDescriptor", "SetParametersResult", "Parameter")
_SEPARATOR = "."


@dataclass(frozen=True, slots=True)
class NodeParameter:
    """A parameter.

    get     returns its value
    set     sets it; raises ConfigError for a value that does not fit. None: it cannot be set
    more    further fields of its rcl_interfaces/msg/ParameterDescriptor
    """

    type: ParameterType
    get: Callable[[], Any]
    set: Callable[[Any], object] | None = None
    description: str = ""
    more: Mapping[str, Any] = field(default_factory=dict)

    def value(self) -> dict[str, Any]:
        """Return the value as rcl_interfaces/msg/ParameterValue."""
        number, name = FIELDS[self.type]
        return {"type": number, name: plain(self.get())}

    def descriptor(self, name: str) -> dict[str, Any]:
        """Return the rcl_interfaces/msg/ParameterDescriptor."""
        return {
            "name": name,
            "type": FIELDS[self.type][0],
            "description": self.description,
            "read_only": self.set is None,
            **self.more,
        }


class ParameterTable(dict[str, NodeParameter]):
    """The parameters of a node by name, and the handlers of their services."""

    def offer(self, node: Node, kinds: Iterable[str] = KINDS) -> None:
        """Offer the services, or some kinds of them, on a node. Raises MessageError if another node does."""
        handlers = {
            "ListParameters": self._list,
            "GetParameters": self._get,
            "DescribeParameters": self._describe,
            "GetParameterTypes": self._types,
            "SetParameters": self._set,
            "SetParametersAtomically": self._set_atomically,
        }
        for kind in kinds:
            node.service(f"{node.name}/{service_name(kind)}", service_type(kind), handlers[kind])

    def change(self, name: str, value: Any) -> None:
        """Set a parameter. Raises ConfigError for an unknown one, a fixed one, or a value that does not fit."""
        parameter = self.get(name)
        if parameter is None:
            raise ConfigError(f"unknown parameter; known are {', '.join(self) or 'none'}", element=name)
        if parameter.set is None:
            raise ConfigError("cannot be changed", element=name)
        parameter.set(value)

    def _list(self, request: Any) -> Any:
        names = [name for name in self if _is_listed(name, list(request.prefixes), request.depth)]
        prefixes = {name.rpartition(_SEPARATOR)[0] for name in names} - {""}
        return {"result": {"names": names, "prefixes": sorted(prefixes)}}

    def _get(self, request: Any) -> Any:
        return {"values": [self._value(name) for name in request.names]}

    def _types(self, request: Any) -> Any:
        return {"types": [self._value(name).get("type", 0) for name in request.names]}

    def _describe(self, request: Any) -> Any:
        return {"descriptors": [self[name].descriptor(name) for name in request.names if name in self]}

    def _set(self, request: Any) -> Any:
        return {"results": [self._try(item.name, from_value(item.value)) for item in request.parameters]}

    def _set_atomically(self, request: Any) -> Any:
        """Set all or none: those that were set before one is refused get their old values back."""
        before = {item.name: plain(self[item.name].get()) for item in request.parameters if item.name in self}
        results = self._set(request)["results"]
        failed = next((result for result in results if not result["successful"]), None)
        if failed is not None:
            for item, result in zip(request.parameters, results, strict=True):
                if result["successful"] and not self._try(item.name, before[item.name])["successful"]:
                    failed = {**failed, "reason": f"{failed['reason']}; {item.name} keeps its new value"}
        return {"result": failed or {"successful": True}}

    def _value(self, name: str) -> dict[str, Any]:
        return self[name].value() if name in self else {}

    def _try(self, name: str, value: Any) -> dict[str, Any]:
        try:
            self.change(name, value)
        except ConfigError as error:
            return {"successful": False, "reason": str(error)}
        return {"successful": True}


def _is_listed(name: str, prefixes: list[str], depth: int) -> bool:
    """Whether a name has one of the prefixes, and at most `depth` parts after it (0: any number)."""
    if not prefixes:
        return not depth or name.count(_SEPARATOR) < depth
    rests = [name[len(prefix) + 1 :] for prefix in prefixes if name.startswith(prefix + _SEPARATOR)]
    return name in prefixes or any(not depth or rest.count(_SEPARATOR) < depth for rest in rests)


def service_name(kind: str) -> str:
    """Return the last part of the name of a service: ``list_parameters`` for ``ListParameters``."""
    return "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in kind).lstrip("_")


def service_type(kind: str) -> str:
    """Return the full name of a service type of rcl_interfaces, which is registered now if it is not yet."""
    full = f"rcl_interfaces/srv/{kind}"
    try:
        messages.service(full)  # a sourced ROS has it
    except MessageError:
        text = "\n".join(map(_with_package, _SERVICES[kind].splitlines()))
        messages.register(_CONSTANTS.get(kind, "") + text, full)
    return full


def _with_package(line: str) -> str:
    kind, space, name = line.partition(" ")
    return f"rcl_interfaces/{kind}{space}{name}" if kind.removesuffix("[]") in _USED else line


def from_value(value: Any) -> Any:
    """Return the value in a ParameterValue; None if it is not set."""
    field = _BY_NUMBER.get(value.type)
    return plain(getattr(value, field)) if field else None


def plain(value: Any) -> Any:
    """Return the value, as a list if it is a tuple or an array."""
    if isinstance(value, tuple):
        return list(value)
    return value.tolist() if hasattr(value, "tolist") else value
