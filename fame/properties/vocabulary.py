"""What sentences can name: the robots of a collaboration, their elements, topics and variables."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path as FilePath
from types import MappingProxyType

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions, Process
from fame.bpmn.pools import Pool
from fame.dataclasses import dataclass, field
from fame.errors import display_name
from fame.properties.sentence import Occurrence, PoseTopic, Property, Word
from fame.text import suggestion

Path = tuple[str | int, ...]
Closure = Sequence[tuple[Definitions, Process]]
"""A process and all that it calls, with their files."""
CheckField = Callable[[str, Path], str]
"""Takes the full name of a topic and a path in its messages, and gives what is wrong with it, or an empty text."""


@dataclass(frozen=True, slots=True)
class RobotTerms:
    """What one robot can do.

    process    the id of its process
    own        label of each element of its process by id; `called` those of the processes that it calls
    throws     the elements that throw on each topic; `catches` those that catch on it
    ambiguous  catching elements with several triggers: no mark says which one came
    repeated   the files of each id that elements of several processes have: no mark says at which one it was
    variables  names of its process variables; None: not known
    """

    process: str
    own: Mapping[str, str]
    called: Mapping[str, str]
    throws: Mapping[str, tuple[str, ...]]
    catches: Mapping[str, tuple[str, ...]]
    ambiguous: frozenset[str] = frozenset()
    variables: Collection[str] | None = None
    repeated: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """The robots of a collaboration, and the robots of its multi-instance pools.

    check_field  what is wrong with a field of a topic's messages
    """

    robots: Mapping[str, RobotTerms]
    pools: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    check_field: CheckField = lambda topic, path: ""

    def part(self, names: Collection[tuple[str, str]]) -> Vocabulary:
        """Return what monitors need of it whose events are at these (robot, element)."""
        robots = dict[str, RobotTerms]()
        for robot, terms in self.robots.items():
            own, called = ({id: each[id] for id in each if (robot, id) in names} for each in (terms.own, terms.called))
            throws, catches = (
                {topic: tuple(id for id in ids if (robot, id) in names) for topic, ids in each.items()}
                for each in (terms.throws, terms.catches)
            )
            robots[robot] = RobotTerms(terms.process, own, called, throws, catches)
        return Vocabulary(robots, self.pools)

    def robots_of(self, name: Word, at: Property | PoseTopic) -> tuple[str, ...]:
        """Return the robots that a name means: one, those of a pool, or none: one of a pool that is not there.

        Raises ConfigError for an unknown name.
        """
        if name.text in self.robots:
            return (name.text,)
        if name.text in self.pools:
            return self.pools[name.text]
        known = next((robot for robot in self.robots if robot.lower() == name.text.lower()), None)
        if known is None and any(is_of_pool(name.text, pool) for pool in self.pools):
            return ()
        text = f"unknown robot or pool {name.text!r}; {suggestion(name.text, [*self.robots, *self.pools])}"
        raise at.error(text, name.offset)

    def elements(self, robot: str, event: Occurrence, at: Property) -> tuple[str, ...]:
        """Return the ids of the elements of a robot where this event can occur. Raises ConfigError
        for an empty result."""
        terms = self.robots[robot]
        if event.verb in ("throws", "catches"):
            return self._topic_ends(robot, event, at)
        if event.verb == "reports":
            return ("",)
        if not event.target.text:
            return (terms.process,)
        return (self._element(robot, event.target, at),)

    def _element(self, robot: str, target: Word, at: Property) -> str:
        terms, name = self.robots[robot], target.text
        for labels in (terms.own, terms.called):
            found = [name] if name in labels else [id for id, label in labels.items() if label == name]
            if len(found) > 1:
                text = f"{robot} has {len(found)} elements labelled {name!r}; expected an id: {', '.join(found)}"
                raise at.error(text, target.offset)
            if found:
                self._expect_one(robot, found[0], target, at)
                return found[0]
        known = [label or id for labels in (terms.own, terms.called) for id, label in labels.items()]
        raise at.error(f"{robot} has no element {name!r}; {suggestion(name, dict.fromkeys(known))}", target.offset)

    def _expect_one(self, robot: str, id: str, target: Word, at: Property) -> None:
        """Raise ConfigError for an id that elements of several processes have."""
        files = self.robots[robot].repeated.get(id)
        if files is not None:
            shown = display_name(id, {**self.robots[robot].called, **self.robots[robot].own}[id])
            names = [FilePath(file).name for file in files]
            places = " and ".join(names if len({*names}) == len(names) else files)
            text = f"{shown}: elements of {places} have the id {id!r}, and no event says which it was: rename one"
            raise at.error(text, target.offset)

    def _topic_ends(self, robot: str, event: Occurrence, at: Property) -> tuple[str, ...]:
        terms = self.robots[robot]
        ends = terms.throws if event.verb == "throws" else terms.catches
        topic = qualified(event.target.text, robot)
        if topic not in ends:
            text = f"no event of {robot} {event.verb} {event.target.text}; {suggestion(event.target.text, ends)}"
            raise at.error(text, event.target.offset)
        unclear = [id for id in ends[topic] if id in terms.ambiguous and event.verb == "catches"]
        if unclear:
            label = display_name(unclear[0], {**terms.called, **terms.own}[unclear[0]])
            text = (
                f"{label} has several triggers, and no event says which came: expected its element instead of a topic"
            )
            raise at.error(text, event.target.offset)
        for id in ends[topic]:
            if ends[topic].count(id) < len(terms.repeated.get(id, ())):  # else each of them is such an end
                self._expect_one(robot, id, event.target, at)
        return tuple(dict.fromkeys(ends[topic]))

    def check_variable(self, robot: str, path: Path, at: Property, offset: int) -> None:
        """Raise ConfigError for a variable that the process of a robot does not have."""
        known = self.robots[robot].variables
        if known is not None and path[0] not in known:
            hint = suggestion(str(path[0]), [*sorted(known), "battery"])
            raise at.error(f"{robot} has no variable {path[0]!r}; {hint}", offset)

    def check_topic_field(self, topic: str, path: Path, at: Property | PoseTopic, offset: int) -> None:
        """Raise ConfigError for a topic without a known type, and for a field that its messages do not have."""
        wrong = self.check_field(topic, path)
        if wrong:
            raise at.error(wrong, offset)


def qualified(topic: str, robot: str) -> str:
    """Return the name of a topic in the model: that of a robot's own topic begins with ``~``."""
    return f"~/{topic.removeprefix(f'/{robot}/')}" if topic.startswith(f"/{robot}/") else topic


def vocabulary_of(
    definitions: Definitions,
    library: Library,
    cast: Mapping[str, Pool],
    *,
    variables: Mapping[str, Collection[str]] = MappingProxyType({}),
    check_field: CheckField = lambda topic, path: "",
) -> Vocabulary:
    """Return the vocabulary of a collaboration with these robots. `variables`: names of process variables by robot.

    Raises ModelError for a called process that is not found.
    """
    closures = {pool.process.id: library.closure(definitions, pool.process) for pool in cast.values()}
    played = {robot: closures[pool.process.id] for robot, pool in cast.items()}
    return vocabulary(played, [definitions], variables=variables, check_field=check_field)


def vocabulary(
    closures: Mapping[str, Closure],
    models: Iterable[Definitions],
    *,
    variables: Mapping[str, Collection[str]] = MappingProxyType({}),
    check_field: CheckField = lambda topic, path: "",
) -> Vocabulary:
    """Return the vocabulary of robots whose process, and what it calls, is given. `models` have
    the multi-instance pools."""
    terms: dict[str, RobotTerms] = {}
    made: dict[tuple[str, str], RobotTerms] = {}
    for robot, closure in closures.items():
        key = closure[0][0].file, closure[0][1].id
        if key not in made:
            made[key] = _terms(closure, variables.get(robot))
        terms[robot] = made[key]
    several = {one.label for model in models for one in model.participants if one.multi_instance}
    pools = {name: tuple(robot for robot in terms if is_of_pool(robot, name)) for name in sorted(several)}
    return Vocabulary(terms, pools, check_field)


def is_of_pool(robot: str, pool: str) -> bool:
    """Return whether a name is that of a robot of a multi-instance pool."""
    return re.fullmatch(re.escape(pool) + r"_\d+", robot, re.IGNORECASE) is not None


def _terms(closure: Closure, variables: Collection[str] | None) -> RobotTerms:
    process, *called = (one for _, one in closure)
    places: dict[str, tuple[str, ...]] = {}
    for home, one in closure:
        for node in one.body.walk():
            places[node.id] = (*places.get(node.id, ()), home.file)
    repeated = {id: files for id, files in places.items() if len(files) > 1}
    own = {node.id: node.label for node in process.body.walk()}
    throws: dict[str, tuple[str, ...]] = {}
    catches: dict[str, tuple[str, ...]] = {}
    ambiguous: set[str] = set()
    for node in (node for one in (process, *called) for node in one.body.walk()):
        for topic, thrown in dict.fromkeys((topic.qualified, thrown) for topic, thrown in node.topics()):
            ends = throws if thrown else catches
            ends[topic] = (*ends.get(topic, ()), node.id)
        if node.place not in ("throw", "end") and len(node.definitions) > 1:
            ambiguous.add(node.id)
    others = {node.id: node.label for one in called for node in one.body.walk()}
    return RobotTerms(process.id, own, others, throws, catches, frozenset(ambiguous), variables, repeated)
