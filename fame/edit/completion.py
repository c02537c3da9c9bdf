"""What can be written in a field of the page: names from the tables of the checks, and of the robots of a scenario."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import suppress
from functools import cached_property
from types import MappingProxyType

from fame.bpmn.difference import elements_of
from fame.bpmn.library import Library
from fame.bpmn.model import Definitions
from fame.bpmn.pools import Pool, matches, pools_of
from fame.check.endpoints import by_topic, declared_type
from fame.check.scope import CheckedProcess, find_scope
from fame.check.variables import sharing, uses_of
from fame.dataclasses import dataclass
from fame.engine.data import variable_name
from fame.errors import MessageError, ModelError, UnavailableError
from fame.middleware import messages
from fame.middleware.interface import TopicInfo
from fame.rooms import FEEL_FUNCTIONS, load
from fame.scripting.interface import NAMES, Robot

MOST = 40
"""Words that are offered at once."""
Words = Mapping[str, str]
"""What can be written, and a few words about each."""
RobotTopics = Mapping[str, Mapping[str, tuple[str, bool]]]
"""Robot -> its topics, relative to it, with their types, and whether it publishes them; "" has those of nobody."""


@dataclass(frozen=True, slots=True)
class Suggestions:
    """Words, each with a few about it, that can stand in place of the last `length` characters before the caret."""

    length: int
    words: list[tuple[str, str]]


def robot_topics(found: Iterable[TopicInfo], robots: Iterable[str]) -> RobotTopics:
    """Return the topics of each robot of a world."""
    by_robot, known = dict[str, dict[str, tuple[str, bool]]](), {*robots}
    for one in found:
        robot, _, name = one.name.removeprefix("/").partition("/")
        robot, name = (robot, name) if robot in known else ("", one.name)
        by_robot.setdefault(robot, {})[name] = one.types[0] if one.types else "", bool(one.publishers)
    return by_robot


class Completer:
    """Completes fields of a model, whose called processes are in `library`.

    `robots` gives the topics of those of a world, `given` has the variables that a scenario gives to processes (id).
    """

    def __init__(
        self,
        model: Definitions,
        library: Library,
        robots: Callable[[], RobotTopics] = dict,
        given: Mapping[str, Iterable[str]] = MappingProxyType({}),
    ) -> None:
        self._model, self._library, self._robots, self._given = model, library, robots, given

    def complete(self, element: str, field: str, before: str) -> Suggestions:
        """Return what fits behind the text `before` the caret in a field of an element.

        Fields are ``script``, ``condition``, ``feel``, ``signal``, ``called``, and the names of extension properties.
        """
        opened = before.rpartition("${")
        if opened[1] and "}" not in opened[2]:
            before, field = opened[2], "condition"
        elif before.startswith("=") and field != "script":
            field = "feel"
        for fields, pattern, words in _RULES:
            if field in fields and (found := pattern.search(before)) is not None:
                part, known = found["part"], words(self, element, found)
                fit = [one for one in known.items() if one[0].casefold().startswith(part.casefold()) and one[0] != part]
                return Suggestions(len(part), fit[:MOST])
        return Suggestions(0, [])

    # ---- tables ------------------------------------------------------------------------------------------------------

    @cached_property
    def _processes(self) -> dict[str, CheckedProcess]:
        """The process of each element."""
        scope = find_scope(self._model, self._library)
        own = [one for one in scope.processes if one.definitions is self._model]
        return {id: one for one in own for id in (one.bpmn.id, *(inner.id for _, inner in elements_of(one.bpmn)))}

    def _closure(self, element: str) -> list[CheckedProcess]:
        """The process of an element, or the first one, and all that it calls."""
        first = next(iter(self._processes.values()), None)
        process = self._processes.get(element, first)
        return process.closure() if process is not None else []

    def topics(self, element: str) -> Words:
        """Return the topics that the robot of an element has, and their types: public ones, its own, its body's."""
        closure = self._closure(element)
        pools = list[Pool]()
        with suppress(ModelError):  # of a model that is not complete yet
            pools += [one for one in pools_of(self._model) if closure and one.process.id == closure[0].bpmn.id]
        found = {
            name: type
            for robot, its in self._robots().items()
            if not robot or any(matches(robot, pool) for pool in pools)
            for name, (type, _) in its.items()
        }
        everyone = dict.fromkeys(inner for one in self._processes.values() for inner in one.closure())
        declared = {name: declared_type(ends) or "" for name, ends in by_topic(closure).items()}
        public = {name: declared_type(ends) or "" for name, ends in by_topic(everyone).items() if name[0] == "/"}
        for name, type in (declared | public).items():
            name = name.removeprefix("~/")
            found[name] = type or found.get(name, "")
        return found

    def variables(self, element: str) -> Words:
        """Return the variables of the process of an element, and the names of the script interface."""
        closure, found = self._closure(element), dict[str, str]()
        types = {name: type for name, type in self.topics(element).items() if type}
        for process in sharing(closure[0]) if closure else ():
            uses = uses_of(process, types | {f"~/{name}": type for name, type in types.items()})
            found |= dict.fromkeys((*uses.declared, *uses.code), "")
            found |= {name: f"set by {by.display_name}" for name, by in uses.sets.items()}
        found |= {name: "given by the scenario" for one in closure[:1] for name in self._given.get(one.bpmn.id, ())}
        return dict(sorted(found.items())) | dict.fromkeys(NAMES, "script interface")

    def type_of(self, element: str, name: str = "msg") -> str:
        """Return the message type of a variable: of the signal of this name, or ``msg`` of the element itself."""
        topics = self.topics(element)
        if name != "msg":
            return next((type for topic, type in topics.items() if variable_name(topic.lstrip("/")) == name), "")
        nodes = (node for one in self._closure(element)[:1] for node in one.nodes() if node.id == element)
        own = (topic.qualified.removeprefix("~/") for node in nodes for topic, _ in node.topics())
        return next((topics.get(topic, "") for topic in own), "")

    def called(self) -> Words:
        """Return what a call activity can call."""
        return dict.fromkeys(sorted(self._library.names(self._model)), "")


def feel(completer: Completer, element: str) -> Words:
    """Return the variables of an element's process, and the functions of FEEL."""
    functions = dict[str, str]()
    with suppress(UnavailableError):  # without the room
        functions = dict.fromkeys(sorted(load(FEEL_FUNCTIONS)), "FEEL function")
    return {name: about for name, about in completer.variables(element).items() if name not in NAMES} | functions


def fields(type: str, path: Iterable[str] = ()) -> Words:
    """Return the fields of a message type, or of what `path` leads to in it, with their types."""
    try:
        for name in path:
            type = messages.fields(type).get(name, "")
        return messages.fields(type)
    except MessageError:
        return {}


def types(first: str) -> Words:
    """Return all types, that of the topic first, and those of services and actions by their own names."""
    names = (re.sub(r"(?<=/srv/)(\w+)_Request$|(?<=/action/)(\w+)_Goal$", r"\1\2", one) for one in messages.types())
    others = dict.fromkeys(one for one in names if "_" not in one.rpartition("/")[2] and one != first)
    return ({first: "as its other ends"} if first else {}) | dict.fromkeys(others, "")


def interface() -> Words:
    """Return what scripts find of their robot."""
    names = (name for name in sorted({*Robot.__annotations__, *vars(Robot)}) if name[0] != "_")
    docs = ((name, inspect.getdoc(getattr(Robot, name)) or "") for name in names)
    return {name: doc.partition("\n")[0] if "member" not in doc.split() else "" for name, doc in docs}


def _path(completer: Completer, element: str, found: re.Match[str]) -> Words:
    name, *path = found["path"].split(".")
    type = completer.type_of(element, name)
    return {} if name != "msg" and type and messages.is_wrapper(type) else fields(type, path)


def _rule(fields: str, behind: str, words: Callable[[Completer, str, re.Match[str]], Words]) -> _Rule:
    return fields.split(), re.compile(behind + ("" if "<part>" in behind else r"(?P<part>\w*)") + "$"), words


_Rule = tuple[Collection[str], re.Pattern[str], Callable[["Completer", str, "re.Match[str]"], Words]]
_CALL, _STRING, _TEXT, _ALL = (
    r"robot\.\w+\(\s*",
    r"[\"']([^\"']*)[\"']\s*,\s*",
    r"[\"'](?P<part>[^\"']*)",
    r"^(?P<part>\S*)",
)
_RULES = (
    _rule("script condition", r"\brobot\.", lambda it, at, found: interface()),
    _rule("script", _CALL + _TEXT, lambda it, at, found: it.topics(at)),
    _rule("script", _CALL + _STRING + _TEXT, lambda it, at, found: types(it.topics(at).get(found[1], ""))),
    _rule("script", _CALL + _STRING * 2 + r"(?:[^()]*\W)?", lambda it, at, found: fields(found[2])),
    _rule("script condition feel", r"(?P<path>[^\W\d]\w*(?:\.\w+)*)\.", _path),
    _rule("feel", r"(?P<part>[^\W\d]\w*)", lambda it, at, found: feel(it, at)),
    _rule("script condition", r"(?P<part>[^\W\d]\w*)", lambda it, at, found: it.variables(at)),
    _rule("signal", _ALL, lambda it, at, found: {one.removeprefix("/"): type for one, type in it.topics(at).items()}),
    _rule("called", _ALL, lambda it, at, found: it.called()),
    _rule("type", _ALL, lambda it, at, found: types(it.type_of(at))),
    _rule("payload", r"(?:^|[{,]\s*)", lambda it, at, found: fields(it.type_of(at))),
)
"""In which fields, behind what, what can be written in place of the ``part``: the first one counts."""
