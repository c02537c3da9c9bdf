"""Conditions of properties: the values that a host gives, and how far a comparison is from being broken."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import eq, ge, gt, le, lt, ne
from typing import Any, Literal, NamedTuple

from fame.properties.sentence import FieldTest, Property, Value, Word
from fame.properties.vocabulary import Path, Vocabulary

SECOND = 1_000_000_000
STALE = SECOND
"""Age (ns) of a position that came in a message, after which it is not known."""


class ValueSource(NamedTuple):
    """What a host has to sample: its value is given to `fame.properties.judge.Judge.sample`.

    ``variable``  a process variable of robot `subject`: that of the process itself, not of what it calls
    ``battery``   its charge, 0 to 1
    ``topic``     the last message on the topic with this full name
    ``pose``      a `RobotPosition` of the robot: from the topic `name`, or without one that in the simulated world
    """

    kind: Literal["variable", "battery", "topic", "pose"]
    subject: str
    name: str = ""


class RobotPosition(NamedTuple):
    """A position (m) in a frame."""

    x: float
    y: float
    z: float = 0.0
    frame: str = "world"


LastValues = Mapping[ValueSource, Any]
Get = Callable[[LastValues, int], Any]
"""Takes the last values and the time (ns), and gives a value; None if it is not known."""
Reading = tuple[bool | None, float | None] | None
"""Whether a condition holds and its slack in the unit of its values (None where nothing can be measured); whether it
holds is None where that depends on NaN, or on an order of what is no number. None: it has no value."""

_OPERATORS: Mapping[str, Callable[[Any, Any], Any]] = {"<": lt, "<=": le, ">": gt, ">=": ge, "==": eq, "!=": ne}


class Condition:
    """A condition for certain robots: its sources and `read`."""

    sources: frozenset[ValueSource]
    read: Callable[[LastValues, int], Reading]

    def __init__(
        self,
        comparisons: Sequence[tuple[Get, str, Get]],
        sources: frozenset[ValueSource],
        negated: bool,
        names: Sequence[tuple[str, Get]],
    ) -> None:
        self.sources, self._names = sources, names
        self._parts = [(left, _OPERATORS[operator], operator, right) for left, operator, right in comparisons]
        self.read = self._read_negated if negated else self._read

    def shown(self, values: LastValues, time: int) -> list[str]:
        """Return its values in words."""
        known = ((name, get(values, time)) for name, get in self._names)
        return [f"{name} is {_short(value)}" for name, value in known if measured(value) is not None]

    def unknown(self, values: LastValues, time: int) -> list[str]:
        """Return the names of its values that are not known although all were sampled."""
        names = self._names if self.sources <= values.keys() else ()
        return [name for name, get in names if measured(get(values, time)) is None]

    def _read(self, values: LastValues, time: int) -> Reading:
        holds, slack, unknown, lost = True, None, False, False
        for get_left, compare, operator, get_right in self._parts:
            left, right = get_left(values, time), get_right(values, time)
            missing = measured(left) is None or measured(right) is None
            own = None if missing else _slack(left, operator, right)
            if missing or (own is None and operator not in ("==", "!=")):
                unknown = True  # lost: not measured, or an order of what is no number; else there is no value
                lost = lost or not missing or _is_nan(left) or _is_nan(right)
                continue
            holds = bool(compare(left, right)) and holds
            if own is not None and (slack is None or own < slack):
                slack = own
        if unknown:  # what else is false decides
            return (False, None) if not holds else (None, None) if lost else None
        return holds, slack

    def _read_negated(self, values: LastValues, time: int) -> Reading:
        reading = self._read(values, time)
        if reading is None or reading[0] is None:
            return reading
        return not reading[0], None if reading[1] is None else -reading[1]


def _short(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else repr(value)


def _slack(left: Any, operator: str, right: Any) -> float | None:
    """How far a comparison of numbers is from being broken; negative if it is."""
    if operator in ("==", "!=") or not all(isinstance(each, int | float) for each in (left, right)):
        return None
    less, more = (left, right) if operator in ("<", "<=") else (right, left)
    try:
        return float(more - less)
    except OverflowError:  # of whole numbers that no float can be
        return math.inf if more > less else -math.inf


def field_of(value: Any, path: Path) -> Any:
    """Return the part of a message or variable at a path; None if it has none."""
    for step in path:
        try:
            value = value[step] if isinstance(step, int) or hasattr(value, "keys") else getattr(value, step)
        except (LookupError, AttributeError, TypeError):
            return None
    return value


def measured(value: Any) -> Any:
    """Return a value; None for NaN: it was not measured, so a comparison with it is neither true nor false."""
    return None if _is_nan(value) else value


def _is_nan(value: Any) -> bool:
    return isinstance(value, float) and math.isnan(value)


def meets(message: Any, tests: Sequence[FieldTest]) -> bool | None:
    """Return whether a message meets all tests; None if that depends on a field that is not there or not measured."""
    met: bool | None = True
    for test in tests:
        value = measured(field_of(message, test.path))
        try:
            if value is None:
                met = None
            elif not _OPERATORS[test.operator](value, test.constant):
                return False
        except TypeError:
            met = None
    return met


def distance(one: RobotPosition | None, other: RobotPosition | None) -> float | None:
    """Return the distance (m) of two positions; None in different frames."""
    if one is None or other is None or one.frame != other.frame:
        return None
    return math.dist(one[:3], other[:3])


def _distance(values: LastValues, one: ValueSource, other: ValueSource) -> float | None:
    """The distance (m) of two positions; None before both are there, NaN while one is lost or in another frame."""
    if one not in values or other not in values:
        return None
    found = distance(values[one], values[other])
    return math.nan if found is None else found


def pose_of(message: Any) -> RobotPosition | None:
    """Return the position in a PoseStamped, PoseWithCovarianceStamped or Odometry; None if it has none."""
    inner = field_of(message, ("pose", "pose")) or field_of(message, ("pose",))
    x, y, z = (field_of(inner, ("position", axis)) for axis in "xyz")
    frame = field_of(message, ("header", "frame_id"))
    if frame is None or not all(isinstance(each, int | float) and math.isfinite(each) for each in (x, y, z)):
        return None
    return RobotPosition(x, y, z, frame)


# ---- compile ---------------------------------------------------------------------------------------------------------


def conditions_of(made: Property, vocabulary: Vocabulary, binding: Mapping[str, str]) -> list[Condition]:
    """Return the conditions of a property for the robots of a binding: one, or one for any two robots of a pool.

    Raises ConfigError for values that the vocabulary does not have.
    """
    pairs = [dict[int, tuple[str, str]]()]
    for value in (value for part in made.condition for value in (part.left, part.right)):
        if value.kind == "distance" and value.other is None:
            robots = vocabulary.robots_of(value.subject, made)
            pairs = [{**pair, id(value): (a, b)} for pair in pairs for a in robots for b in robots if a < b]
    return [_condition(made, vocabulary, binding, pair) for pair in pairs]


def _condition(
    made: Property, vocabulary: Vocabulary, binding: Mapping[str, str], pair: Mapping[int, Sequence[str]]
) -> Condition:
    sources: set[ValueSource] = set()
    names: dict[str, Get] = {}

    def get(value: Value) -> Get:
        robots = pair.get(id(value))
        if value.kind == "distance" and robots is None:
            robots = tuple(binding.get(name.text, name.text) for name in (value.subject, value.other) if name)
        elif robots is None:
            robots = (binding.get(value.subject.text, value.subject.text),)
        found, getter = _getter(value, robots, made, vocabulary)
        sources.update(found)
        if found:
            names[_name(value, robots)] = getter
        return getter

    parts = [(get(part.left), part.operator, get(part.right)) for part in made.condition]
    return Condition(parts, frozenset(sources), made.pattern == "never", list(names.items()))


def _name(value: Value, robots: Sequence[str]) -> str:
    """A value in words, with the robots that it belongs to."""
    if value.kind == "distance":
        return f"distance({', '.join(robots)})"
    path = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in value.path)
    return f"{robots[0]}{'.battery' if value.kind == 'battery' else path}"


def _getter(
    value: Value, robots: Sequence[str], made: Property, vocabulary: Vocabulary
) -> tuple[Sequence[ValueSource], Get]:
    """Sources and getter of a value. Raises ConfigError."""
    if value.kind == "constant":
        constant = value.constant
        return (), lambda values, time: constant
    if value.kind == "distance":
        one, other = (_pose_source(robot, made, vocabulary) for robot in robots)
        return (one, other), lambda values, time: _distance(values, one, other)
    if value.kind == "topic":
        vocabulary.check_topic_field(value.subject.text, value.path, made, value.subject.offset)
        topic, path = ValueSource("topic", value.subject.text), value.path
        return (topic,), lambda values, time: field_of(values.get(topic), path)
    if value.kind == "battery":
        battery = ValueSource("battery", robots[0])
        return (battery,), lambda values, time: values.get(battery)
    vocabulary.check_variable(robots[0], value.path, made, value.subject.offset)
    variable, rest = ValueSource("variable", robots[0], str(value.path[0])), value.path[1:]
    return (variable,), lambda values, time: field_of(values.get(variable), rest)


def _pose_source(robot: str, made: Property, vocabulary: Vocabulary) -> ValueSource:
    """Where the position of a robot comes from. Raises ConfigError for a wrong entry of `poses`."""
    named = {name: each for each in made.poses for name in vocabulary.robots_of(Word(each.robot), each)}
    if robot not in named:
        return ValueSource("pose", robot)
    at = named[robot]
    topic = f"/{robot}{at.topic[1:]}" if at.topic.startswith("~") else at.topic
    vocabulary.check_topic_field(topic, ("header", "frame_id"), at, 0)
    # the poses of some types are inside of another one
    wrong = [vocabulary.check_field(topic, (*outer, "position")) for outer in (("pose",), ("pose", "pose"))]
    if all(wrong):
        raise at.error(wrong[0])
    return ValueSource("pose", robot, topic)


def subjects(made: Property) -> Iterator[Value]:
    """Yield the values in the condition of a property that belong to robots."""
    for value in (value for part in made.condition for value in (part.left, part.right)):
        if value.kind in ("variable", "battery", "distance"):
            yield value
