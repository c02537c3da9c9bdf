"""What a property says, as data: a pattern over events or a condition, and the scope in which it counts."""

from __future__ import annotations

from typing import Literal, NamedTuple

from fame.dataclasses import dataclass
from fame.errors import ConfigError

Pattern = Literal["always", "never", "exists", "only after", "each time only after", "at most"]
Verb = Literal["starts", "completes", "fails", "is cancelled", "ends", "throws", "catches", "reports"]


class Location(NamedTuple):
    """Where a sentence begins: file, line and column (1-based, 0 if unknown)."""

    file: str = ""
    line: int = 0
    column: int = 0

    def error(self, text: str, offset: int = 0, name: str = "") -> ConfigError:
        """Return an error at the character `offset` of the sentence of property `name`."""
        column = self.column + offset if self.column else 0
        element = f"properties.{name}" if name else ""
        return ConfigError(text, file=self.file, line=self.line, column=column, element=element)


NOWHERE = Location()


class Word(NamedTuple):
    """A name in a sentence, and its offset there."""

    text: str
    offset: int = 0


@dataclass(frozen=True, slots=True)
class Value:
    """A value of a team. A path has names and list indices.

    kind     ``constant``, ``variable`` (of a robot), ``battery``, ``topic`` (its last message), ``distance``
    subject  the robot or pool, the full name of the topic, or the constant
    other    the second robot of a distance; empty: `subject` is a pool, and any two of its robots are meant
    """

    kind: Literal["constant", "variable", "battery", "topic", "distance"]
    subject: Word
    path: tuple[str | int, ...] = ()
    constant: float | str | bool = 0.0
    other: Word | None = None


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two values and one of ``< <= > >= == !=``."""

    left: Value
    operator: str
    right: Value


@dataclass(frozen=True, slots=True)
class FieldTest:
    """A condition on a field of a message."""

    path: tuple[str | int, ...]
    operator: str
    constant: float | str | bool
    offset: int


@dataclass(frozen=True, slots=True)
class Occurrence:
    """Events that a sentence means. `some`: any robot of the pool; else each of them.

    `target` is an element (label or id), a topic, a part of a report, or empty: the instance. `code` is that of an
    error.
    """

    robot: Word
    verb: Verb
    target: Word
    some: bool = False
    code: str | None = None
    where: tuple[FieldTest, ...] = ()
    text: str = ""


@dataclass(frozen=True, slots=True)
class PoseTopic:
    """The topic with the positions of a robot, or of each robot of a pool: one that begins with ``~/`` is its own."""

    robot: str
    topic: str
    place: Location

    def error(self, text: str, offset: int = 0) -> ConfigError:
        """Return an error at its line."""
        return ConfigError(text, file=self.place.file, line=self.place.line, element=f"poses.{self.robot}")


@dataclass(frozen=True, slots=True)
class Property:
    """A sentence that was read.

    main, other  the events of the pattern; `other`: those after which it may occur
                 (of ``never F before E`` in a scope that ends at another event: E)
    condition    of ``always`` and ``never``
    opens        the scope begins after this; None: at the start
    closes       the scope ends at this; None: at the end
    bound        ns within which the event has to occur; `count`: how often it may; `same`: the field that both have
    poses        where the positions of robots come from, if not from the simulated world
    about        ids of the elements that a text annotation is associated with
    """

    name: str
    sentence: str
    place: Location
    pattern: Pattern
    main: Occurrence | None = None
    other: Occurrence | None = None
    condition: tuple[Comparison, ...] = ()
    opens: Occurrence | None = None
    closes: Occurrence | None = None
    bound: int | None = None
    count: int = 0
    same: tuple[str | int, ...] = ()
    poses: tuple[PoseTopic, ...] = ()
    about: tuple[str, ...] = ()

    def error(self, text: str, offset: int = 0) -> ConfigError:
        """Return an error at a character of the sentence."""
        return self.place.error(text, offset, self.name)

    @property
    def occurrences(self) -> list[Occurrence]:
        """All events that it names."""
        return [each for each in (self.opens, self.closes, self.main, self.other) if each is not None]
