"""The exceptions of FAME.

::

    FameError
    ├── ModelError        the file is wrong: file, line, element, what was expected and what was found
    ├── MissionError      the run went wrong: robot, element, cause (uncaught error, livelock, script)
    ├── MessageError      a type, field or value that does not fit a topic
    │   └── MissingTypeError  a message type that the sourced ROS does not have
    ├── DeploymentError   a robot refused or did not answer
    ├── ConfigError       a scenario, pipeline or learning file is wrong
    └── UnavailableError  a backend or language that is not installed, and the command that installs it

``str(error)`` is always one line, fit for a terminal: where it is, what was expected, what was found.
"""

from __future__ import annotations

import reprlib
from typing import Protocol

LONGEST = 10_000
"""Most characters of a message that is not cut."""
MODULE_NOT_FOUND = "install it, or name its folder in PYTHONPATH"
"""What to do about a Python module of a script."""
NOT_KNOWN = 3
"""The exit code of a command that found nothing wrong, but could not judge all that it was asked about."""


def display_name(id: str, name: str = "") -> str:
    """Return an element as messages show it: ``"Go To" (Activity_14nkpvd)``, or the id alone if it has no name."""
    name = " ".join(name.split())
    return f'"{name}" ({id})' if name and name != id else id


class NamedElement(Protocol):
    """The fields of `fame.bpmn.model.Element` that an error shows."""

    @property
    def id(self) -> str:
        """Unique in its file."""

    @property
    def name(self) -> str:
        """The label, or empty."""

    @property
    def line(self) -> int:
        """1-based, 0 if unknown."""


class FameError(Exception):
    """Base class: a one-line message, and the exit code of a command that fails with it."""

    exit_code: int = 2

    def __init__(self, text: str) -> None:
        line = " ".join(text.split())
        if len(line) > LONGEST:  # a name of megabytes, in somebody's file
            line = f"{line[: LONGEST // 2]} ... {line[-LONGEST // 4 :]}"
        super().__init__(line)


class _Located(FameError):
    """An error that points into a file."""

    text: str
    file: str
    line: int
    column: int
    element: str
    name: str

    def __init__(
        self, text: str, *, file: str = "", line: int = 0, column: int = 0, element: str = "", name: str = ""
    ) -> None:
        self.text, self.file, self.line, self.column = " ".join(text.split()), file, line, column
        self.element, self.name = element, name
        place = file or ""
        if line:
            place += f":{line}" if place else f"line {line}"
            place += f":{column}" if column and file else ""
        parts = [place, display_name(element, name), self.text]
        super().__init__(": ".join(part for part in parts if part))


class ModelError(_Located):
    """The model is wrong.

    ``file``, ``line`` (1-based, 0 if unknown) and ``element`` (id) say where; ``name`` is what people call the element.
    """

    @classmethod
    def at(cls, element: NamedElement, text: str, *, file: str) -> ModelError:
        """Return the error of an element of a file."""
        return cls(text, file=file, line=element.line, element=element.id, name=element.name)


class ConfigError(_Located):
    """A scenario, world, pipeline or learning file is wrong. ``element`` is the path of the key in it."""


class MissionError(FameError):
    """The run went wrong.

    ``code`` is that of the BPMN error (``script`` for any other exception of a script, ``livelock`` for a loop without
    waiting); ``robot``, ``element``, ``file`` and ``line`` (of the .bpmn file, 0 unknown) say where; ``name`` is what
    people call the element.
    """

    text: str
    robot: str
    element: str
    file: str
    line: int
    code: str
    name: str

    exit_code = 1

    def __init__(
        self,
        text: str,
        *,
        robot: str = "",
        element: str = "",
        file: str = "",
        line: int = 0,
        code: str = "",
        name: str = "",
    ) -> None:
        self.text, self.robot, self.element = " ".join(text.split()), robot, element
        self.file, self.line, self.code, self.name = file, line, code, name
        place = f"{file}:{line}" if file and line else f"line {line}" if line else file
        if element and place:
            where = display_name(f"{element}, {place}", name) if name else f"{element} ({place})"
        else:
            where = display_name(element, name) or place
        super().__init__(": ".join(part for part in (robot, where, self.text) if part))

    def to_json(self) -> dict[str, str | int]:
        """Return all but the robot, fit for JSON."""
        return {key: getattr(self, key) for key in ("code", "element", "file", "line", "text")}


class MessageError(FameError):
    """A type, field or value that does not fit a topic. ``type`` is the message type, ``field`` the path in it."""

    type: str
    field: str

    def __init__(self, text: str, *, type: str = "", field: str = "") -> None:
        self.type, self.field = type, field
        super().__init__(": ".join(part for part in (type, field, text) if part))


class MissingTypeError(MessageError):
    """A message, service or action type that the sourced ROS does not have."""


class DeploymentError(FameError):
    """A robot refused its process, or did not answer.

    ``cause`` is what refusals of different text have in common: ``size``, ``syntax``, ``protocol``, ``robot``,
    ``clock``, ``hash``, ``signature``, ``replay``, ``rival``, or empty. ``about`` is the id that a message which cannot
    be read gives itself.
    """

    exit_code = 1
    cause: str
    about: str

    def __init__(self, text: str, *, cause: str = "", about: str = "") -> None:
        super().__init__(text)
        self.cause, self.about = cause, about


class UnavailableError(FameError):
    """A backend or language that is not installed. The text names the command that installs it."""


def expect(holds: bool, name: str, found: object, right: str) -> None:
    """Raise ConfigError for the argument `name` of a Python call unless the condition holds."""
    if not holds:
        raise ConfigError(f"expected {right}, got {reprlib.repr(found)}", element=name)


class ValueChanged(FutureWarning):
    """A warning: a value means something else than in earlier releases."""
