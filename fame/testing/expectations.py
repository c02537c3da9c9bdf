"""Expectations of a robot. Each one returns an object on which further expectations can be stated."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND
from fame.errors import ConfigError
from fame.testing.failure import ExpectationError, failure
from fame.testing.trace import TraceStep

if TYPE_CHECKING:
    from fame.properties.judgement import Judgement
    from fame.testing.mission import MissionUnderTest


class Expectation:
    """Expectations of a robot. Methods raise ExpectationError, and ConfigError for an unknown element."""

    def __init__(self, mission: MissionUnderTest, robot: str) -> None:
        self._mission, self._robot = mission, robot

    def passed(self, element: str, *, times: int | None = None) -> Passage:
        """Expect that the element has completed, `times` times (0 is never) if given; a sequence flow has been taken.

        Raises ConfigError if `times` is no such number, or is 0 and nothing has run.
        """
        __tracebackhide__ = True
        if times is not None and not (isinstance(times, int) and times >= 0):
            raise ConfigError(f"passed({element!r}): expected times to be a whole number from 0 on, got {times!r}")
        if times == 0:
            self._check_has_run(f"passed({element!r}, times=0)")
        ids, shown = self._find(element)
        steps = self._steps(ids, "leave") or self._steps(ids, "take")
        if len(steps) != times if times is not None else not steps:
            often = f" {times} times" if times is not None else ""
            entered = len(self._steps(ids, "enter"))
            got = f"it has completed {len(steps)} times" if steps else "it has not completed" if entered else _NEVER
            raise self._error(f"expected to have passed {shown}{often}, but {got}")
        return Passage(self, shown, steps)

    def entered(self, element: str) -> Passage:
        """Expect that a token has come to the element."""
        __tracebackhide__ = True
        ids, shown = self._find(element)
        steps = self._mission.trace.arrivals(self._robot, ids)
        if not steps:
            raise self._error(f"expected to have entered {shown}, but {_NEVER}")
        return Passage(self, shown, steps)

    def never_entered(self, element: str) -> Expectation:
        """Expect that no token has come to the element.

        Raises ConfigError if nothing has run, and nothing is to happen at once.
        """
        __tracebackhide__ = True
        self._check_has_run(f"never_entered({element!r})")
        ids, shown = self._find(element)
        steps = self._mission.trace.arrivals(self._robot, ids)
        if steps:
            raise self._error(f"expected never to enter {shown}, but it was entered at {_moment(steps[0])}")
        return self

    def waits_at(self, element: str) -> Expectation:
        """Expect that a token is at the element now."""
        __tracebackhide__ = True
        ids, shown = self._find(element)
        if not self._mission.is_at(self._robot, ids):
            steps = self._steps(ids, "enter")
            got = f"it was left at {_moment(steps[-1])} or later" if steps else _NEVER
            raise self._error(f"expected to wait at {shown}, but {got}")
        return self

    def completed(self, within: float | None = None) -> Expectation:
        """Expect that the process has completed, and nothing of it runs, `within` that time from now (s)."""
        __tracebackhide__ = True
        mission = self._mission
        if within is not None:
            check_seconds("completed", within)
            mission.go_on(lambda: mission.has_completed(self._robot), within)
        if not mission.has_completed(self._robot) or mission.node(self._robot).failed:
            often = f" within {within:g} s" if within is not None else ""
            raise self._error(f"expected to have completed{often}")
        return self

    def failed(self, code: str | None = None, *, at: str | None = None, within: float | None = None) -> Expectation:
        """Expect that an instance of the process has failed, with the error code and at the element, if given,
        `within` that time from now (s)."""
        __tracebackhide__ = True
        mission, (ids, shown) = self._mission, self._find(at) if at is not None else (None, "")
        if within is not None:
            check_seconds("failed", within)
            mission.go_on(lambda: mission.node(self._robot).failed, within)
        errors = [one.error for one in mission.node(self._robot).instances if one.error is not None]
        matching = [
            error
            for error in errors
            if code in (None, error.code) and (ids is None or error.element in ids or self._climbed(error.element, ids))
        ]
        if not matching:
            wanted = (f" with code {code!r}" if code is not None else "") + (f" at {shown}" if shown else "")
            got = "it has not failed"
            if errors:
                place = mission.elements.shown(self._robot, errors[-1].element)
                got = f"it failed with code {errors[-1].code!r} at {place}"
            raise self._error(f"expected to have failed{wanted}, but {got}")
        return self

    def has(self, **variables: Any) -> Expectation:
        """Expect these values of process variables of the last instance.

        Numbers of which one is a float are compared to a millionth, also in lists and mappings; arrays count as lists;
        True is not 1.
        """
        __tracebackhide__ = True
        now = self._mission.variables(self._robot)
        for name, value in variables.items():
            if name not in now:
                raise self._error(f"expected the variable {name} = {value!r}, but it is not set")
            if not _equal(now[name], value):
                raise self._error(f"expected the variable {name} = {value!r}, but it is {now[name]!r}")
        return self

    def _check_has_run(self, asked: str) -> None:
        if self._mission.untouched:
            raise ConfigError(f"{asked}: nothing has run yet: advance the mission before")

    def _climbed(self, origin: str, ids: frozenset[str]) -> bool:
        """Whether elements failed, or were cancelled, after an error at `origin`, inside them, in the same instant."""
        if not self._mission.elements.may_contain(self._robot, ids, origin):
            return False
        began = {step.time: step.order for step in self._steps(frozenset([origin]), "fail")[::-1]}
        ended = [*self._steps(ids, "fail"), *self._steps(ids, "cancel")]
        return any(step.order > began.get(step.time, step.order) for step in ended)

    def _find(self, element: str) -> tuple[frozenset[str], str]:
        self._mission.node(self._robot)  # begins
        ids = self._mission.elements.find(self._robot, element)
        return ids, " or ".join(self._mission.elements.shown(self._robot, id) for id in sorted(ids))

    def _steps(self, ids: frozenset[str], what: str) -> list[TraceStep]:
        return self._mission.trace.of(self._robot, ids, what)

    def _error(self, text: str) -> ExpectationError:
        return failure(self._mission, f"{self._robot}: {text}")


class Passage(Expectation):
    """An element that was passed or entered: expectations of when, and further ones of the robot.

    Those of when raise ConfigError after `times=0`.
    """

    steps: list[TraceStep]

    def __init__(self, expectation: Expectation, shown: str, steps: list[TraceStep]) -> None:
        super().__init__(expectation._mission, expectation._robot)
        self._shown, self.steps = shown, steps

    @property
    def times(self) -> list[float]:
        """When, in simulated s."""
        return [step.time / SECOND for step in self.steps]

    @property
    def _first(self) -> TraceStep:
        if not self.steps:
            raise ConfigError(f"{self._shown} has not been passed: there is no time to compare")
        return self.steps[0]

    def before(self, element: str) -> Passage:
        """Expect that the first time was before a token first came to another element, which it has."""
        __tracebackhide__ = True
        return self._compare(element, "before", lambda own, other: own.order < other.order)

    def after(self, element: str) -> Passage:
        """Expect that the first time was after a token first came to another element, which it has."""
        __tracebackhide__ = True
        return self._compare(element, "after", lambda own, other: own.order > other.order)

    def within(self, seconds: float) -> Passage:
        """Expect that the first time was at most this long after the start (simulated s)."""
        __tracebackhide__ = True
        check_seconds("within", seconds)
        if self._first.time > seconds * SECOND:
            text = f"expected {self._shown} within {seconds:g} s, but it was at {_moment(self._first)}"
            raise self._error(text)
        return self

    def _compare(self, element: str, word: str, holds: Callable[[TraceStep, TraceStep], bool]) -> Passage:
        __tracebackhide__ = True
        ids, shown = self._find(element)
        others = self._mission.trace.arrivals(self._robot, ids)
        if not others:
            raise self._error(f"expected {self._shown} {word} {shown}, but {shown} was never entered")
        if not holds(self._first, others[0]):
            text = f"{self._shown} was at {_moment(self._first)}, and {shown} was entered at {_moment(others[0])}"
            raise self._error(f"expected {self._shown} {word} {shown}, but {text}")
        return self


class PropertyExpectation:
    """Expectations of a property, as it is judged when they are stated (docs/properties.md). Methods raise
    ExpectationError."""

    def __init__(self, mission: MissionUnderTest, name: str) -> None:
        self._mission, self._name = mission, name

    @property
    def judgement(self) -> Judgement:
        """How it is judged now."""
        return next(one for one in self._mission.judgements() if one.name == self._name)

    def holds(self, *, vacuous: bool = False) -> PropertyExpectation:
        """Expect that it holds; `vacuous`: or there was nothing to judge. If it is violated later, the test fails."""
        __tracebackhide__ = True
        self._mission.expected_properties.discard(self._name)
        return self._is("hold", ("holds", *["not triggered"] * vacuous))

    def is_violated(self) -> PropertyExpectation:
        """Expect that it is violated, which then does not fail the test."""
        __tracebackhide__ = True
        self._mission.expected_properties.add(self._name)
        return self._is("be violated", ("violated",))

    def _is(self, wanted: str, words: Collection[str]) -> PropertyExpectation:
        __tracebackhide__ = True
        judgement = self.judgement
        if judgement.verdict not in words:
            raise failure(self._mission, f"expected property {self._name} to {wanted}: {judgement}")
        return self


_NEVER = "it was never entered"


def _moment(step: TraceStep) -> str:
    return f"{step.time / SECOND:g} s"


def check_seconds(asked: str, seconds: float) -> None:
    """Raise ConfigError if `seconds` is no time that something may last."""
    if not (isinstance(seconds, int | float) and 0 <= seconds < math.inf):
        raise ConfigError(f"{asked}: expected a number of seconds from 0 on, got {seconds!r}")


def _equal(found: Any, wanted: Any) -> bool:
    found, wanted = (value.tolist() if hasattr(value, "tolist") else value for value in (found, wanted))
    if isinstance(found, bool) != isinstance(wanted, bool):
        return False
    if isinstance(found, int | float) and isinstance(wanted, int | float) and float in (type(found), type(wanted)):
        return math.isclose(found, wanted, rel_tol=1e-6, abs_tol=1e-6)
    if isinstance(found, list | tuple) and type(found) is type(wanted):
        return len(found) == len(wanted) and all(map(_equal, found, wanted))
    if isinstance(found, dict) and isinstance(wanted, dict):
        return found.keys() == wanted.keys() and all(_equal(found[key], wanted[key]) for key in wanted)
    return bool(found == wanted)
