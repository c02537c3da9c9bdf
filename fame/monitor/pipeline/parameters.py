"""Parameters of nodes: those of their processors, as parameters of ROS 2; server and client.

Nodes offer parameter services (`fame.middleware.parameters`), on every backend; within rclpy, the parameters are
declared to it, which offers these. So `fame param` and `ros2 param` work on both. A parameter is named as its
processor names it; where several of a chain have the same, ``2.cutoff`` is that of the second.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from fame.clock import SECOND, Scheduler
from fame.errors import ConfigError, MissionError
from fame.middleware import messages
from fame.middleware.interface import Node
from fame.middleware.parameters import (
    FIELDS,
    NodeParameter,
    ParameterTable,
    from_value,
    plain,
    service_name,
    service_type,
)
from fame.monitor.pipeline.input_node import ThrottledReport
from fame.monitor.pipeline.processor import Parameter, declared_parameters, set_value


def owners(processors: Sequence[Any]) -> dict[str, tuple[Any, Parameter]]:
    """Return the parameters by name, each with its processor."""
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
        offers = {
            name: NodeParameter(
                parameter.type, partial(self._value, name), partial(self.set, name), _description(parameter),
                {"read_only": parameter.fixed, **bounds(parameter)},
            )
            for name, (_, parameter) in self.owners.items()
        }  # fmt: skip
        if hasattr(node, "ros"):
            self._declare(node, offers)
            return
        table, offered = getattr(node, "parameters", None), True
        if table is None:  # within one process
            table, offered = ParameterTable(), False
        table.update(offers)
        if not offered:
            table.offer(node)

    def set(self, name: str, value: Any) -> Any:
        """Set a parameter. Raises ConfigError for an unknown one, or a value that does not fit."""
        if name not in self.owners:
            raise ConfigError(f"unknown parameter; known are {', '.join(self.owners) or 'none'}", element=name)
        processor, parameter = self.owners[name]
        kept = set_value(processor, parameter.name, value)
        self._report(f"set {name} {kept}", f"{name} is {_shown(kept)} now")
        return kept

    def _value(self, name: str) -> Any:
        processor, parameter = self.owners[name]
        return getattr(processor, parameter.name)

    def _declare(self, node: Any, offers: Mapping[str, NodeParameter]) -> None:
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
        for name, offer in offers.items():
            value = plain(offer.get())
            fields = offer.descriptor(name) | {"dynamic_typing": value == []}  # without a type in ROS
            message = to_ros(messages.create("rcl_interfaces/msg/ParameterDescriptor", fields), ParameterDescriptor)
            try:
                node.ros.declare_parameter(name, value, message)
            except Exception as error:  # rclpy's own: what was said of it is not of its type, or was refused above
                raise ConfigError(" ".join(str(error).split()), element=name, file=node.full_name) from None

    def _apply(self, name: str, value: Any) -> None:
        """Set a parameter that was changed in ROS; report a refusal of its processor."""
        try:
            self.set(name, value)
        except ConfigError as error:
            self._report(f"refused {name}", f"{name} stays as it is: {error}")

    def _changed(self, parameters: Any) -> Iterator[tuple[str, Any]]:
        """Yield names and values of the offered parameters that change."""
        for item in parameters:
            if item.name in self.owners:
                processor, parameter = self.owners[item.name]
                value = plain(item.value)
                if value != plain(getattr(processor, parameter.name)):
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
        """Return the names of its parameters. Raises MissionError if the node does not answer."""
        return list(self._call("ListParameters", {}).result.names)

    def get(self, names: Sequence[str]) -> list[Any]:
        """Return the values; None for a parameter that the node does not have."""
        return [from_value(value) for value in self._call("GetParameters", {"names": list(names)}).values]

    def describe(self, names: Sequence[str]) -> list[Any]:
        """Return messages of rcl_interfaces/msg/ParameterDescriptor."""
        return list(self._call("DescribeParameters", {"names": list(names)}).descriptors)

    def set(self, name: str, value: Any) -> None:
        """Set a parameter. Raises ConfigError if the node refuses, with its reason."""
        (now,) = self.get([name])
        if isinstance(now, float) and type(value) is int:
            value = float(value)
        if isinstance(now, list) and not isinstance(value, list):
            value = [value]
        kind = type_of(value)
        field = {"name": name, "value": {"type": FIELDS[kind][0], FIELDS[kind][1]: value}}
        (result,) = self._call("SetParameters", {"parameters": [field]}).results
        if not result.successful:
            raise ConfigError(result.reason or f"{name} was refused", file=self.other)

    def _call(self, kind: str, request: dict[str, Any]) -> Any:
        client = self._node.client(f"{self.other}/{service_name(kind)}", service_type(kind))
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


def type_of(value: Any) -> str:
    """Return the type of a parameter that takes a value as it was typed. Raises ConfigError."""
    if isinstance(value, list) and value and all(isinstance(item, str) for item in value):
        return "strs"
    if isinstance(value, list) and all(type(item) in (int, float) for item in value):
        return "floats"
    for kind, cls in (("bool", bool), ("int", int), ("float", float), ("str", str)):
        if isinstance(value, cls):
            return kind
    raise ConfigError(f"expected a number, a text, true, false or a list of these, got {value!r}")


def bounds(parameter: Parameter) -> dict[str, Any]:
    """Return what rcl_interfaces/msg/ParameterDescriptor says of the values that a parameter may have."""
    low, high = (parameter.range or (None, None))[:2] if parameter.type in ("int", "float") else (None, None)
    if parameter.type == "str" and parameter.range:
        return {"additional_constraints": f"one of {', '.join(map(str, parameter.range))}"}
    if low is None and high is None:
        return {}
    if parameter.type == "int":
        least, most = -(2**62) if low is None else low, 2**62 if high is None else high
        return {"integer_range": [{"from_value": least, "to_value": most}]}
    lowest, highest = -1e300 if low is None else low, 1e300 if high is None else high
    return {"floating_point_range": [{"from_value": lowest, "to_value": highest}]}


def _description(parameter: Parameter) -> str:
    return parameter.description + (f" ({parameter.unit})" if parameter.unit else "")


def _shown(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)
