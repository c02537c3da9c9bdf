"""Parameters of nodes: those of their processors, as parameters of ROS 2; server and client.

A node offers the services by which every node of ROS 2 gives its parameters (``<node>/list_parameters``,
``get_parameters``, ``describe_parameters``, ``set_parameters``: rcl_interfaces), on every backend; within rclpy, they
are declared to it, which offers these. So `fame param` and `ros2 param` work on both. A parameter is named as its
processor names it; where several of a chain have the same, ``2.cutoff`` is that of the second.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

from fame.clock import SECOND, Scheduler
from fame.errors import ConfigError, MissionError
from fame.middleware import messages
from fame.middleware.interface import Node
from fame.monitor.pipeline.processor import Parameter, declared_parameters, set_value
from fame.monitor.pipeline.subscriptions import ThrottledReport

_SERVICES = {
    "ListParameters": "string[] prefixes\nuint64 depth\n---\nListParametersResult result",
    "GetParameters": "string[] names\n---\nParameterValue[] values",
    "DescribeParameters": "string[] names\n---\nParameterDescriptor[] descriptors",
    "GetParameterTypes": "string[] names\n---\nuint8[] types",
    "SetParameters": "Parameter[] parameters\n---\nSetParametersResult[] results",
    "SetParametersAtomically": "Parameter[] parameters\n---\nSetParametersResult result",
}
_FIELDS = {
    "bool": (1, "bool_value"),
    "int": (2, "integer_value"),
    "float": (3, "double_value"),
    "str": (4, "string_value"),
    "file": (4, "string_value"),
    "floats": (8, "double_array_value"),
    "strs": (9, "string_array_value"),
}
"""Type of a parameter -> its number in rcl_interfaces/msg/ParameterType, and the field of its value."""

_BY_NUMBER = {**dict(_FIELDS.values()), 6: "bool_array_value", 7: "integer_array_value", 5: "byte_array_value"}


def service_type(kind: str) -> str:
    """The full name of a service type of rcl_interfaces, registered now if need be."""
    full = f"rcl_interfaces/srv/{kind}"
    text = _SERVICES[kind]
    for used in ("ListParametersResult", "ParameterValue", "ParameterDescriptor", "SetParametersResult"):
        text = "\n".join(_whole(line, used) for line in text.splitlines())
    messages.register("\n".join(_whole(line, "Parameter") for line in text.splitlines()), full)
    return full


def _whole(line: str, used: str) -> str:
    kind, space, name = line.partition(" ")
    return f"rcl_interfaces/{kind}{space}{name}" if kind.removesuffix("[]") == used else line


def owners(processors: Sequence[Any]) -> dict[str, tuple[Any, Parameter]]:
    """Name of a parameter -> whose it is."""
    known: dict[str, tuple[Any, Parameter]] = {}
    for number, processor in enumerate(processors):
        for parameter in declared_parameters(processor):
            name = parameter.name if parameter.name not in known else f"{number + 1}.{parameter.name}"
            known[name] = (processor, parameter)
    return known


class ParameterServer:
    """Offers the parameters of some processors on a node."""

    owners: dict[str, tuple[Any, Parameter]]

    def __init__(self, node: Node, processors: Sequence[Any], report: ThrottledReport) -> None:
        self.owners, self._report = owners(processors), report
        if hasattr(node, "ros"):
            self._declare(node)
            return
        for kind, answer in (
            ("ListParameters", self._list),
            ("GetParameters", self._get),
            ("DescribeParameters", self._describe),
            ("GetParameterTypes", self._types),
            ("SetParameters", self._set),
            ("SetParametersAtomically", self._set_all),
        ):
            node.service(f"{node.name}/{_snake(kind)}", service_type(kind), answer)

    def set(self, name: str, value: Any) -> Any:
        """Raises ConfigError for an unknown one, or a value that does not fit."""
        if name not in self.owners:
            raise ConfigError(f"unknown parameter; known are {', '.join(self.owners) or 'none'}", element=name)
        processor, parameter = self.owners[name]
        kept = set_value(processor, parameter.name, value)
        self._report(f"set {name} {kept}", f"{name} is {_shown(kept)} now")
        return kept

    def _value(self, name: str) -> dict[str, Any]:
        if name not in self.owners:
            return {}
        processor, parameter = self.owners[name]
        return to_value(parameter, getattr(processor, parameter.name))

    def _list(self, request: Any) -> Any:
        return {"result": {"names": list(self.owners)}}

    def _get(self, request: Any) -> Any:
        return {"values": [self._value(name) for name in request.names]}

    def _types(self, request: Any) -> Any:
        return {"types": [self._value(name).get("type", 0) for name in request.names]}

    def _describe(self, request: Any) -> Any:
        return {
            "descriptors": [descriptor(name, self.owners[name][1]) for name in request.names if name in self.owners]
        }

    def _set(self, request: Any) -> Any:
        return {"results": [self._try(item.name, from_value(item.value)) for item in request.parameters]}

    def _set_all(self, request: Any) -> Any:
        before = {item.name: self._value(item.name) for item in request.parameters}
        results = self._set(request)["results"]
        failed = next((result for result in results if not result["successful"]), None)
        if failed is not None:
            for item, result in zip(request.parameters, results, strict=True):
                if result["successful"]:
                    value = messages.create("rcl_interfaces/msg/ParameterValue", before[item.name])
                    self._try(item.name, from_value(value))
        return {"result": failed or {"successful": True}}

    def _try(self, name: str, value: Any) -> dict[str, Any]:
        try:
            self.set(name, value)
        except ConfigError as error:
            return {"successful": False, "reason": str(error)}
        return {"successful": True}

    def _declare(self, node: Any) -> None:
        """Declare the parameters to rclpy, whose command line or parameter file may set them at the start."""
        from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult

        from fame.middleware.ros.endpoints import to_ros

        def check(parameters: Any) -> Any:
            try:
                for name, value in self._changed(parameters):
                    self._convert(name, value)
            except ConfigError as error:
                return SetParametersResult(successful=False, reason=str(error))
            return SetParametersResult(successful=True)

        def apply(parameters: Any) -> None:  # in the thread of rclpy's executor, if somebody else sets them
            for name, value in self._changed(parameters):
                node.middleware.scheduler.soon(partial(self._apply, name, value))

        node.ros.add_on_set_parameters_callback(check)
        node.ros.add_post_set_parameters_callback(apply)
        for name, (processor, parameter) in self.owners.items():
            value = _plain(getattr(processor, parameter.name))
            fields = descriptor(name, parameter) | {"dynamic_typing": value == []}  # which has no type in ROS
            message = to_ros(messages.create("rcl_interfaces/msg/ParameterDescriptor", fields), ParameterDescriptor)
            try:
                node.ros.declare_parameter(name, value, message)
            except Exception as error:  # rclpy's own: what was said of it is not of its type, or was refused above
                raise ConfigError(" ".join(str(error).split()), element=name, file=node.full_name) from None

    def _apply(self, name: str, value: Any) -> None:
        """Set a parameter that was changed in ROS; report a refusal of its processor."""
        result = self._try(name, value)
        if not result["successful"]:
            self._report(f"refused {name}", f"{name} stays as it is: {result['reason']}")

    def _changed(self, parameters: Any) -> Iterator[tuple[str, Any]]:
        """Names and values of those that are ours and new."""
        for item in parameters:
            if item.name in self.owners:
                processor, parameter = self.owners[item.name]
                value = _plain(item.value)
                if value != _plain(getattr(processor, parameter.name)):
                    yield item.name, value

    def _convert(self, name: str, value: Any) -> Any:
        parameter = self.owners[name][1]
        if parameter.fixed:
            raise ConfigError("is given in the configuration, and cannot be changed", element=name)
        return parameter.convert(value)


class ParameterClient:
    """Asks a node for its parameters, and waits for the answers on the scheduler."""

    other: str

    def __init__(self, node: Node, scheduler: Scheduler, other: str, timeout: float = 3.0) -> None:
        """`other` is the full name of the node: ``/low_pass``."""
        self._node, self._scheduler, self.other, self._timeout = node, scheduler, other.rstrip("/"), timeout

    def names(self) -> list[str]:
        """Raises MissionError if the node does not answer."""
        return list(self._call("ListParameters", {}).result.names)

    def get(self, names: Sequence[str]) -> list[Any]:
        """Values; None for a parameter that the node does not have."""
        return [from_value(value) for value in self._call("GetParameters", {"names": list(names)}).values]

    def describe(self, names: Sequence[str]) -> list[Any]:
        """Messages of rcl_interfaces/msg/ParameterDescriptor."""
        return list(self._call("DescribeParameters", {"names": list(names)}).descriptors)

    def set(self, name: str, value: Any) -> None:
        """Raises ConfigError if the node refuses, with its reason."""
        (now,) = self.get([name])
        if isinstance(now, float) and type(value) is int:
            value = float(value)
        if isinstance(now, list) and not isinstance(value, list):
            value = [value]
        kind = type_of(value)
        field = {"name": name, "value": {"type": _FIELDS[kind][0], _FIELDS[kind][1]: value}}
        (result,) = self._call("SetParameters", {"parameters": [field]}).results
        if not result.successful:
            raise ConfigError(result.reason or f"{name} was refused", file=self.other)

    def _call(self, kind: str, request: dict[str, Any]) -> Any:
        client = self._node.client(f"{self.other}/{_snake(kind)}", service_type(kind))
        answers: list[Any] = []
        end = self._scheduler.now + round(self._timeout * SECOND)
        while not client.available and self._scheduler.now < end:
            self._scheduler.run(self._scheduler.now + SECOND // 20)
        if client.available:
            client.call(request, answers.append)
        while client.available and not answers and self._scheduler.now < end:
            self._scheduler.run(self._scheduler.now + SECOND // 100)
        client.close()
        if not answers:
            raise MissionError(f"{self.other}: no node of that name offers parameters")
        return answers[0]


def to_value(parameter: Parameter, value: Any) -> dict[str, Any]:
    """As rcl_interfaces/msg/ParameterValue."""
    number, field = _FIELDS[parameter.type]
    return {"type": number, field: _plain(value)}


def from_value(value: Any) -> Any:
    """What a ParameterValue holds; None if it is not set."""
    field = _BY_NUMBER.get(value.type)
    return _plain(getattr(value, field)) if field else None


def type_of(value: Any) -> str:
    """The type of a parameter that takes a value as it was typed. Raises ConfigError."""
    if isinstance(value, list) and value and all(isinstance(item, str) for item in value):
        return "strs"
    if isinstance(value, list) and all(type(item) in (int, float) for item in value):
        return "floats"
    for kind, cls in (("bool", bool), ("int", int), ("float", float), ("str", str)):
        if isinstance(value, cls):
            return kind
    raise ConfigError(f"expected a number, a text, true, false or a list of these, got {value!r}")


def descriptor(name: str, parameter: Parameter) -> dict[str, Any]:
    """As rcl_interfaces/msg/ParameterDescriptor."""
    message: dict[str, Any] = {
        "name": name,
        "type": _FIELDS[parameter.type][0],
        "description": _description(parameter),
        "read_only": parameter.fixed,
    }
    low, high = (parameter.range or (None, None))[:2] if parameter.type in ("int", "float") else (None, None)
    if low is not None or high is not None:
        bounds: dict[str, Any]
        if parameter.type == "int":
            bounds = {"from_value": -(2**62) if low is None else low, "to_value": 2**62 if high is None else high}
            message["integer_range"] = [bounds]
        else:
            message["floating_point_range"] = [
                {"from_value": -1e300 if low is None else low, "to_value": 1e300 if high is None else high}
            ]
    elif parameter.type == "str" and parameter.range:
        message["additional_constraints"] = f"one of {', '.join(map(str, parameter.range))}"
    return message


def _description(parameter: Parameter) -> str:
    return parameter.description + (f" ({parameter.unit})" if parameter.unit else "")


def _plain(value: Any) -> Any:
    """A list for what holds several values: a tuple, an array."""
    if isinstance(value, tuple):
        return list(value)
    return value.tolist() if hasattr(value, "tolist") else value


def _shown(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _snake(kind: str) -> str:
    return "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in kind).lstrip("_")
