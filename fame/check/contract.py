"""The contract of a mission with the software of its robots: every topic, service and action that each pool uses.

`contract_of` derives it from the model and all processes that it calls, scripts included as far as they name topics
literally. `compare` makes the same endpoints as an engine would, on nodes of their own that neither publish nor call
anything, waits for discovery, and reports what the running graph lacks: servers, publishers and subscribers of the
robots' own topics, other types, incompatible QoS.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Literal

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions, Process
from fame.bpmn.pools import Pool, pools_of, shared_topics
from fame.bpmn.topics import EMPTY_TYPE, topics_of_processes
from fame.check.scope import CheckedProcess, Finding, find_scope
from fame.check.service_topics import served_topics
from fame.clock import SECOND, Scheduler
from fame.dataclasses import dataclass, replace
from fame.errors import MessageError, ModelError
from fame.middleware import messages, qos
from fame.middleware.actions import ActionClient
from fame.middleware.interface import SIGNAL, Client, Middleware, Node, QoS, resolve
from fame.scripting import script_effects
from fame.scripting.effects import Direction, computed_topics

Relation = Literal["publishes", "subscribes to", "calls the service", "calls the action"]
_DOES: Mapping[str, Relation] = {
    "publish": "publishes", "subscribe": "subscribes to", "call": "calls the service", "act": "calls the action",
}  # fmt: skip
NODE = "fame_check"
_STEP = SECOND // 10


@dataclass(frozen=True, slots=True)
class ContractEndpoint:
    """One endpoint of a pool's robots.

    `name` is absolute (``/weed_found``) or relative to the robot (``~/odom``). `type` is empty if only a script uses
    it and does not give it. `qos` is None for services and actions. `multi_instance`: the pool has numbered robots.
    `own`: the other end may be the mission's own, of a script that computes the name or of a service of FAME.
    """

    robot: str
    direction: Relation
    name: str
    type: str
    qos: QoS | None = None
    multi_instance: bool = False
    file: str = ""
    own: bool = False

    @property
    def full_name(self) -> str:
        """The name with the robot's namespace; ``<n>`` stands for the number of a robot of a multi-instance pool."""
        return resolve(self.name, f"{self.robot}_<n>" if self.multi_instance else self.robot)

    def __str__(self) -> str:
        """One line: ``m.bpmn: contract: REX subscribes to /REX/odom, nav_msgs/msg/Odometry, reliable, keep last 9``."""
        parts = [self.full_name, self.type or "type unknown", *([qos_text(self.qos)] if self.qos is not None else [])]
        return f"{self.file}: contract: {self.robot} {self.direction} {', '.join(parts)}"

    def to_json(self) -> dict[str, object]:
        profile = qos_text(self.qos) if self.qos is not None else None
        text = {"robot": self.robot, "direction": self.direction, "name": self.full_name, "type": self.type}
        return {**text, "qos": profile, "file": self.file}


def qos_text(profile: QoS) -> str:
    """Return a QoS profile in words."""
    depth = f"keep last {profile.depth}" if profile.history == "keep_last" else "keep all"
    durability = ["transient local"] if profile.durability == "transient_local" else []
    return ", ".join([profile.reliability.replace("_", " "), *durability, depth])


def contract_of(definitions: Definitions, library: Library) -> list[ContractEndpoint]:
    """Return the endpoints of all pools, by pool, direction and name. Raises ModelError."""
    pools, scope = pools_of(definitions), find_scope(definitions, library)
    shared = {name: use.declared for name, use in shared_topics(definitions, pools, library).items() if use.declared}
    endpoints: dict[ContractEndpoint, None] = {}
    for pool in pools:
        closure = library.closure(definitions, pool.process)
        root = next(one for one in scope.processes if one.bpmn is pool.process)
        found = _of_pool(pool, closure, shared, definitions.file)
        endpoints.update(dict.fromkeys(replace(one, own=_may_be_own(one, root)) for one in found))
    order = {pool.name: number for number, pool in enumerate(pools)}
    return sorted(endpoints, key=lambda one: (order[one.robot], one.direction, one.name))


def _may_be_own(endpoint: ContractEndpoint, root: CheckedProcess) -> bool:
    other: Direction = "subscribe" if endpoint.direction == "publishes" else "publish"
    nodes = (node for process in root.closure() for node in process.nodes())
    served = served_topics(root)  # None: it is not known which
    of_services = served is None or any(one.name == endpoint.name for one in served)
    return endpoint.qos is not None and (of_services or endpoint.name.startswith(computed_topics(nodes, other)))


def _of_pool(
    pool: Pool, closure: Sequence[tuple[Definitions, Process]], shared: dict[str, str], file: str
) -> Iterator[ContractEndpoint]:
    made = partial(ContractEndpoint, pool.name, multi_instance=pool.multi_instance, file=file)
    public = {name: type for name, type in shared.items() if name.startswith("/")}
    table = topics_of_processes(closure, types=public)
    for use in table.values():
        profile = qos.parse(use.qos) if use.qos else SIGNAL
        if use.throws:
            yield made("publishes", use.name, use.type, profile)
        if use.catches:
            yield made("subscribes to", use.name, use.type, profile)
    for node in (node for _, process in closure for node in process.body.walk()):
        if node.service is not None:
            name, type = node.service.name, node.service.type or ""
            name = name if name.startswith(("/", "~/")) else f"~/{name}"
            yield made(_DOES["act" if messages.is_action(type) else "call"], name, type)
        for topic in script_effects(node).topics:
            known = table.get(topic.qualified)
            if topic.direction in ("call", "act"):
                yield made(_DOES[topic.direction], topic.qualified, topic.type or "")
            elif known is None or not (known.throws if topic.direction == "publish" else known.catches):
                type = topic.full_type or (known.declared if known is not None else None) or ""
                yield made(_DOES[topic.direction], topic.qualified, type, SIGNAL)


# ---- the running graph -----------------------------------------------------------------------------------------------


def compare(
    contract: Sequence[ContractEndpoint], middleware: Middleware, scheduler: Scheduler, patience: float
) -> list[Finding]:
    """Compare a contract with the running graph; wait up to `patience` s until nothing is missing.

    A missing server, publisher or type is an error; a topic of a robot that nobody subscribes to is a warning.
    """
    scheduler.run(scheduler.now + _STEP * 5)  # discovery, before the namespaces are asked for
    nodes: dict[str, Node] = {}
    own = {(one.robot, one.name) for one in contract if one.direction == "publishes"}  # delivered inside the engine
    own &= {(one.robot, one.name) for one in contract if one.direction == "subscribes to"}
    wanted = [one for one in contract if (one.robot, one.name) not in own or one.name.startswith("/")]
    probes = [_Probe(one, robot) for one in wanted for robot in _robots(one, middleware)]
    for probe in probes:
        if probe.robot not in nodes:
            nodes[probe.robot] = middleware.node(NODE, probe.robot)
        probe.open(nodes[probe.robot])
    until = scheduler.now + round(patience * SECOND)
    missing = _missing(probes, middleware)
    while missing and scheduler.now < until:
        scheduler.run(min(until, scheduler.now + _STEP))
        missing = _missing(probes, middleware)
    names = {probe.name for probe in probes}
    warnings = [one for one in middleware.warnings if one.kind == "mismatch" and one.topic in names]
    files = {probe.name: probe.endpoint.file for probe in probes}
    return [*missing, *(Finding("error", str(one), files[one.topic]) for one in warnings)]


def _robots(endpoint: ContractEndpoint, middleware: Middleware) -> list[str]:
    """The robots of the endpoint's pool as the graph writes them, whose case counts only there; of a multi-instance
    pool those that are in the graph, else the first."""
    number = "_1" if endpoint.multi_instance else ""
    pattern = re.compile(re.escape(endpoint.robot) + (r"_\d+" if number else ""), re.IGNORECASE)
    there = [name for name in middleware.namespaces() if pattern.fullmatch(name)]
    return [endpoint.robot] if endpoint.robot in there else there or [f"{endpoint.robot}{number}"]


class _Probe:
    """An endpoint of one robot, as its engine would make it."""

    def __init__(self, endpoint: ContractEndpoint, robot: str) -> None:
        self.endpoint, self.robot, self.name = endpoint, robot, resolve(endpoint.name, robot)
        self.error = ""
        self._client: Client | ActionClient | None = None

    def open(self, node: Node) -> None:
        endpoint = self.endpoint
        if not endpoint.type or (endpoint.type == EMPTY_TYPE and endpoint.name.startswith("~/")):
            return
        try:
            if endpoint.direction == "publishes":
                node.publisher(self.name, endpoint.type, endpoint.qos or SIGNAL)
            elif endpoint.direction == "subscribes to":
                node.subscription(self.name, endpoint.type, lambda message: None, endpoint.qos or SIGNAL)
            elif endpoint.direction == "calls the service":
                self._client = node.client(self.name, endpoint.type)
            else:
                self._client = ActionClient(node, self.name, endpoint.type)
        except (MessageError, ModelError) as error:
            self.error = str(error)

    def finding(self, middleware: Middleware) -> Finding | None:
        """Return what the graph lacks of it now; None: nothing."""
        endpoint = self.endpoint
        if self.error:
            return Finding("error", f"{self.robot} {endpoint.direction} {self.name}: {self.error}", endpoint.file)
        if endpoint.qos is None:
            kind = "service" if endpoint.direction == "calls the service" else "action"
            if self._client is not None and not self._client.available:
                return Finding("error", f"no node offers the {kind} {self.name} ({endpoint.type})", endpoint.file)
            return None
        info = next((info for info in middleware.graph() if info.name == self.name), None)
        others = [type for type in info.types if endpoint.type and type != endpoint.type] if info is not None else []
        if others:
            return Finding(
                "error", f"{self.name} is {', '.join(others)} in the graph; expected {endpoint.type}", endpoint.file
            )
        if endpoint.name.startswith("/") or endpoint.own:
            return None  # between the robots of the mission, or in one
        ends = () if info is None else info.publishers if endpoint.direction == "subscribes to" else info.subscribers
        if any(end.rpartition("/")[2] != NODE for end in ends):
            return None
        if endpoint.direction == "subscribes to":
            return Finding("error", f"no node publishes {self.name} ({endpoint.type or 'type unknown'})", endpoint.file)
        return Finding(
            "warning", f"no node subscribes to {self.name} ({endpoint.type or 'type unknown'})", endpoint.file
        )


def _missing(probes: Sequence[_Probe], middleware: Middleware) -> list[Finding]:
    return [finding for probe in probes if (finding := probe.finding(middleware)) is not None]
