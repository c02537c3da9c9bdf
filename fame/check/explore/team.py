"""The robots of a collaboration, ready to be explored."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType

from fame.bpmn.library import Library
from fame.bpmn.model import CallActivity, Definitions
from fame.bpmn.pools import Pool, shared_topics
from fame.check.explore.abstraction import Abstraction, abstraction
from fame.check.explore.host import ExplorationHost
from fame.check.explore.kinds import kinds_of
from fame.check.explore.local import Local
from fame.check.explore.mismatches import given_values
from fame.check.explore.places import places_of
from fame.check.explore.properties import Monitors, Watch, is_judged
from fame.check.explore.request import Request
from fame.check.explore.running_states import as_explored, real_program
from fame.check.explore.trace import Place
from fame.check.explore.values import Values
from fame.check.expressions import expressions_in
from fame.engine.encoding import Data
from fame.properties import Location, Monitor, Property, compile, parse, vocabulary_of
from fame.rooms import WATCH

_NAMES_ITSELF = re.compile(r"\brobot\b(?!\s*\.\s*(?:publish|subscribe|latest|call|act|now|date)\b)")
"""Texts by which a robot may know its own name."""


class Team:
    """The robots of a team; local transitions are shared by all searches.

    cast      robot -> its pool
    kinds     robot -> its pool, by another name if others of the pool do not start alike (`kinds_of`)
    model     their processes as they are explored
    locals    the transitions of each robot; robots that nothing tells apart share them
    alike     kind -> whether nothing in their processes tells its robots apart
    monitors  of the properties that are judged or watched, or None
    given     place of a robot -> the state from which it goes on
    received  (process, topic) of what robots have received in any search so far
    """

    def __init__(
        self,
        definitions: Definitions,
        library: Library,
        cast: Mapping[str, Pool],
        request: Request,
        snapshots: Mapping[str, Data] = MappingProxyType({}),
    ) -> None:
        self.definitions: Definitions = definitions
        self.library: Library = library
        self.cast: dict[str, Pool] = dict(cast)
        self.request: Request = request
        self.robots: tuple[str, ...] = tuple(cast)
        self.pools: list[Pool] = _distinct(cast)
        self.kinds: dict[str, Pool] = kinds_of(cast, request.variables)
        self.places: dict[str, Place] = places_of(definitions, self.pools, library)
        self.received: set[tuple[str, str]] = set()
        compiled = [compile(spec, vocabulary_of(definitions, library, cast)) for spec in request.properties]
        judged, watches = [monitor for monitor in compiled if is_judged(monitor)], [*self._watches()]
        reads = self._reads(judged)
        self.model: Abstraction = self._abstraction(reads, judged, watches, given=bool(snapshots))
        self.alike: dict[str, bool] = {kind.name: not self._knows_itself(kind) for kind in _distinct(self.kinds)}
        events = frozenset((element, what) for monitor in judged for _, element, what in monitor.events)
        events = events.union(*(watch.events for watch in watches))
        # A snapshot of an observed program has tokens on its flows, which the explored program then has, too.
        observed = bool(events) or any(data["observed"] for data in snapshots.values())
        self.values: Values = Values()
        self.locals: list[Local] = self._locals(reads, events, observed=observed, judged=bool(judged))
        several = {robot for robot, pool in cast.items() if pool.multi_instance}
        team = dict(zip(self.robots, self.locals, strict=True))
        self.monitors: Monitors | None = Monitors(compiled, team, several, watches) if compiled or watches else None
        self.given: dict[int, Data] = {
            place: self._as_explored(place, snapshots[robot], observed)
            for place, robot in enumerate(self.robots) if robot in snapshots
        }  # fmt: skip

    @property
    def watched(self) -> frozenset[str]:
        """The signals of properties that robots watch."""
        return self.monitors.thrown if self.monitors is not None else frozenset()

    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Return the places of robots that nothing tells apart."""
        apart = self.monitors.apart if self.monitors is not None else frozenset()
        kinds = (kind for kind, alike in self.alike.items() if alike)
        groups = (self._places_of(kind, self.kinds) for kind in kinds)
        return tuple(places for places in groups
                     if len(places) > 1 and not any(self.robots[place] in apart for place in places))  # fmt: skip

    def required(self) -> tuple[tuple[int, ...], ...]:
        """Return the places of the robots of each pool of which one has to start, and none does by itself."""
        pools = ((pool, self._places_of(pool.name, self.cast)) for pool in self.pools if not pool.process.optional)
        return tuple(places for _, places in pools if self.locals[places[0]].program.begin is None)

    def _places_of(self, name: str, pools: Mapping[str, Pool]) -> tuple[int, ...]:
        """The places of the robots of a pool or kind."""
        return tuple(place for place, robot in enumerate(self.robots) if pools[robot].name == name)

    # ---- how it is made ----------------------------------------------------------------------------------------------

    def _watches(self) -> Iterator[Watch]:
        """The calls of ``watch_property``. Raises ConfigError for a wrong sentence."""
        for robot, pool in self.cast.items():
            for home, process in self.library.closure(self.definitions, pool.process):
                objects = {item.id: item for body in process.body.bodies() for item in body.data_objects}
                for node in process.body.walk():
                    if isinstance(node, CallActivity) and node.called == WATCH:
                        inputs = {name: value for id in node.data_inputs for name, value in objects[id].values}
                        if {"property", "sentence"} <= inputs.keys():
                            name, sentence = inputs["property"].text, inputs["sentence"]
                            spec = parse(sentence.text, Location(home.file, sentence.line), name)
                            vocabulary = vocabulary_of(self.definitions, self.library, self.cast)
                            yield Watch(compile(spec, vocabulary), robot, node.id)

    def _reads(self, judged: Sequence[Monitor]) -> dict[str, set[str]]:
        """Kind -> the variables of its robots that properties read."""
        reads = {kind.name: set[str]() for kind in self.kinds.values()}
        for source in (source for monitor in judged for source in monitor.sources):
            reads[self.kinds[source.subject].name].add(source.name)
        return reads

    def _abstraction(
        self, reads: Mapping[str, set[str]], judged: Sequence[Monitor], watches: Sequence[Watch], *, given: bool
    ) -> Abstraction:
        return abstraction(
            self.definitions,
            _distinct(self.kinds),
            self.library,
            dict(shared_topics(self.definitions, self.pools, self.library)),
            given=given,
            read=frozenset[str]().union(*reads.values()),
            parameters=given_values(self.request.variables.values()),
            named=codes_named(monitor.spec for monitor in (*judged, *(watch.monitor for watch in watches))),
        )

    def _knows_itself(self, pool: Pool) -> bool:
        """Whether a script or expression may read the name of its robot, or somebody addresses a robot by name."""
        bodies = self.model.bodies(self.definitions, pool.process)
        texts = (use.expression.text for body in bodies for use in expressions_in(body))
        return any(_NAMES_ITSELF.search(text) for text in texts) or any(
            use.addresses and use.catches for use in self.model.facts.types.values()
        )

    def _locals(
        self, reads: Mapping[str, set[str]], events: frozenset[tuple[str, str]], *, observed: bool, judged: bool
    ) -> list[Local]:
        """The transitions of each robot: of those that are alike, they are computed once."""
        shared, every = dict[str, Local](), list[Local]()
        for robot, kind in self.kinds.items():
            local = shared.get(kind.name) if self.alike[kind.name] else None
            if local is None:
                host = ExplorationHost(
                    robot, self.model, self.values, self.robots, self.request.ordered, events, judged=judged
                )
                variables = self.request.variables.get(robot, {})
                local = shared[kind.name] = Local(
                    self.definitions, kind, self.model, host,
                    observed=observed, reads=sorted(reads[kind.name]), parameters=variables,
                )  # fmt: skip
            every.append(local)
        return every

    def _as_explored(self, place: int, snapshot: Data, observed: bool) -> Data:
        """The snapshot of a robot's whole program, behaviours included, as one of the explored program."""
        local, process = self.locals[place], self.cast[self.robots[place]].process
        real = real_program(self.definitions, process, self.library, local.host, observed=observed)
        return as_explored(snapshot, real, local.program)


def _distinct(cast: Mapping[str, Pool]) -> list[Pool]:
    """The pools of a cast, each name once."""
    return list({pool.name: pool for pool in cast.values()}.values())


def codes_named(properties: Iterable[Property]) -> frozenset[str]:
    """Return the error codes that properties name."""
    return frozenset(event.code for spec in properties for event in spec.occurrences if event.code)
