"""Settings of a scenario beside its world: the network between its robots, and mission parameters."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from fame.bpmn.library import Library
from fame.bpmn.model import DataObject, Definitions, Expression, FlowNode, Process, SubProcess
from fame.bpmn.pools import Pool
from fame.check.variables import parameters
from fame.config.values import Source
from fame.errors import ConfigError
from fame.middleware.network import Delay, Link, NetworkConfig, Partition, names
from fame.text import suggestion, topic_of

if TYPE_CHECKING:
    from fame.config.values import ConfigValue

_DELAYS = ("uniform", "normal", "exponential")
_LINK = {
    "delay": "s, or one of `{uniform: [0.02, 0.1]}`, `{normal: [0.05, 0.01]}`, `{exponential: 0.05}` (0)",
    "loss": "probability that a message is lost, up to 0.99 (0)",
    "reorder": "probability that a best effort message is overtaken by the next ones (0)",
}
NETWORK_KEYS = {
    **_LINK,
    "links": "what differs between two robots, or on a topic: the keys above with `between: [REX, DINGO]`, `topic`",
    "partitions": "cuts: `{between: [REX, DINGO], from: 30, to: 60}`, simulated s",
    "lease": "seconds of a partition after which endpoints are no longer matched (10, as in DDS)",
}
"""Of the network in a scenario, with their meanings."""
ALL = ""
"""In the place of a robot: all of them."""


# ---- the network -----------------------------------------------------------------------------------------------------


def read_network(value: ConfigValue) -> NetworkConfig:
    """Read the key ``network`` of a scenario. Raises ConfigError."""
    keys = value.mapping(NETWORK_KEYS)
    links = [_link(value, keys)] if any(key in keys for key in _LINK) else []
    links += [_own_link(item) for item in keys["links"].items()] if "links" in keys else []
    cuts = [_partition(item) for item in keys["partitions"].items()] if "partitions" in keys else []
    lease = {"lease": keys["lease"].number(above=0)} if "lease" in keys else {}
    return NetworkConfig(tuple(links), tuple(cuts), **lease)


def _own_link(value: ConfigValue) -> Link:
    keys = value.mapping((*_LINK, "between", "topic"))
    link = _link(value, keys)
    if "between" in keys:
        link = replace(link, between=_pair(keys["between"]))
    if "topic" in keys:
        link = replace(link, topic=topic_of(keys["topic"].text()))
    return link


def _link(value: ConfigValue, keys: Mapping[str, ConfigValue]) -> Link:
    return Link(
        delay=_delay(keys["delay"]) if "delay" in keys else Delay(),
        loss=keys["loss"].number(minimum=0, maximum=0.99) if "loss" in keys else 0.0,
        reorder=keys["reorder"].number(minimum=0, maximum=1) if "reorder" in keys else 0.0,
    )


def _delay(value: ConfigValue) -> Delay:
    if not isinstance(value.data, Mapping):
        return Delay("fixed", value.number(minimum=0))
    keys = value.mapping(_DELAYS)
    if len(keys) != 1:
        raise value.expected("a number of seconds, or one of uniform, normal and exponential")
    (kind, numbers), *_ = keys.items()
    if kind == "exponential":
        return Delay("exponential", numbers.number(above=0))
    first, second = numbers.numbers(2, "[0.02, 0.1]")
    if first < 0 or second < 0 or (kind == "uniform" and second < first):
        raise numbers.expected("two numbers of seconds from 0 on, the smaller one first")
    return Delay("uniform" if kind == "uniform" else "normal", first, second)


def _partition(value: ConfigValue) -> Partition:
    keys = value.mapping(("between", "from", "to"))
    for key in ("between", "from", "to"):
        if key not in keys:
            raise value.error(f"expected the key {key}, as in {{between: [REX, DINGO], from: 30, to: 60}}")
    start, end = keys["from"].number(minimum=0), keys["to"].number(minimum=0)
    if end <= start:
        raise keys["to"].expected("a second after that of from")
    return Partition(_pair(keys["between"]), start, end)


def _pair(value: ConfigValue) -> tuple[str, str]:
    robots = [item.text() for item in value.items()]
    if len(robots) != 2 or robots[0] == robots[1]:
        raise value.expected("two robots, as in [REX, DINGO]")
    return robots[0], robots[1]


def check_network(network: NetworkConfig | None, robots: Sequence[str], source: Source) -> None:
    """Raise ConfigError if a network names a robot that is not there."""
    for name in names(network) if network is not None else ():
        if name not in robots:
            raise _error(source, "network", f"unknown robot {name!r} in the network; {suggestion(name, robots)}")


def _error(source: Source, path: str, text: str) -> ConfigError:
    """An error of a key, or of a value that the caller has given in its place."""
    return source.error(path, text) if path in source.lines else ConfigError(text, file=source.file)


# ---- mission parameters ----------------------------------------------------------------------------------------------


def read_variables(value: ConfigValue) -> dict[str, dict[str, Any]]:
    """Read the key ``variables``: by robot, and for all robots those that are no mapping. Raises ConfigError."""
    given = value.mapping().items()
    return by_robot(
        {
            name: {variable: one.data for variable, one in item.mapping().items()}
            if isinstance(item.data, Mapping)
            else item.data
            for name, item in given
        }
    )


def by_robot(variables: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return mission parameters by robot; those that are no mapping are for all robots."""
    found: dict[str, dict[str, Any]] = {}
    for name, item in variables.items():
        if isinstance(item, Mapping):
            found.setdefault(name, {}).update(item)
        else:
            found.setdefault(ALL, {})[name] = item
    return found


def with_parameters(
    cast: Mapping[str, Pool],
    definitions: Definitions,
    library: Library,
    variables: Mapping[str, Mapping[str, Any]],
    source: Source,
) -> tuple[dict[str, Pool], dict[str, dict[str, Any]]]:
    """Return the pools of the robots with values set, and the variables that their processes start with.

    A parameter replaces the value that data objects give the variable. `variables` by robot, `ALL` for all whose model
    has them. Raises ConfigError for unknown robots, and for variables that the model does not have.
    """
    if not any(variables.values()) and cast.keys() >= variables.keys() - {ALL}:
        return dict(cast), {}  # to look for what a model reads takes as long as to read the model
    known = {robot: parameters(definitions, pool.process, library) for robot, pool in cast.items()}
    for robot in variables:
        if robot != ALL and robot not in cast:
            text = f"unknown robot {robot!r} in variables; {suggestion(robot, cast)}"
            raise _error(source, f"variables.{robot}", text)
    chosen: dict[str, dict[str, Any]] = {}
    for robot, values in variables.items():
        for name, value in values.items():
            having = [one for one in (cast if robot == ALL else [robot]) if name in known[one]]
            if not having:
                everyone = sorted({each for one in (known if robot == ALL else [robot]) for each in known[one]})
                place = robot or "the mission"
                text = f"{place} has no variable {name!r}; {suggestion(name, everyone)}"
                raise _error(source, f"variables.{robot}.{name}" if robot != ALL else f"variables.{name}", text)
            for one in having:
                if robot != ALL or name not in variables.get(one, {}):
                    chosen.setdefault(one, {})[name] = value
    pools = {
        robot: replace(pool, process=_with_values(pool.process, chosen[robot])) if robot in chosen else pool
        for robot, pool in cast.items()
    }
    return pools, chosen


def _with_values(process: Process, values: Mapping[str, Any]) -> Process:
    """A process whose data objects give these values."""
    return replace(process, body=_body(process.body, values))


def _body(body: Any, values: Mapping[str, Any]) -> Any:
    return replace(
        body,
        data_objects=tuple(_object(item, values) for item in body.data_objects),
        nodes=tuple(_node(node, values) for node in body.nodes),
    )


def _node(node: FlowNode, values: Mapping[str, Any]) -> FlowNode:
    return replace(node, body=_body(node.body, values)) if isinstance(node, SubProcess) else node


def _object(item: DataObject, values: Mapping[str, Any]) -> DataObject:
    return replace(
        item,
        values=tuple(
            (name, Expression(json.dumps(values[name]), "payload", source.line) if name in values else source)
            for name, source in item.values
        ),
    )
