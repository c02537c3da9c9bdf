"""Runs through states that a search has not reached: the schedule of `fame run`, and random ones.

The schedule is that of simulated time: what begins first ends first, by the durations that the model names (timers,
``await sleep(2)``); what has no known duration takes one second, a person waits until nothing else is left. Where
something is unknown, every way is followed. Messages arrive at once.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from itertools import accumulate, chain
from random import Random

from fame.bpmn.model import Element, Task
from fame.check.explore.graph import Errors, Explored
from fame.check.explore.host import seconds_of
from fame.check.explore.product import Product
from fame.check.explore.search import add_state, report
from fame.check.explore.transitions import BITS, CUT, MASK, Transition
from fame.dataclasses import dataclass, field

STEPS = 10_000
"""Steps of the schedule, and of all random runs together; a high limit of states allows more."""
LEAST = 100
"""Steps that have to be left to follow what comes after a further error."""
LONGEST = 1_000
"""Steps of one random run."""
_ORDER = {"end": 1, "timer": 2, "outside": 3, "offer": 4, "person": 5}
"""Of what is due at one instant: as in `fame.clock.Kind`."""
_WITHOUT = {"outside": 0.1, "offer": 1e6, "person": 1e6}
"""When something happens that has no duration, s."""
_SLEEP = re.compile(r"\bsleep\(\s*(\d+(?:\.\d*)?)\s*\)")

Due = tuple[float, int, int, int, str, str]
"""What is going to happen: in how many seconds, order at one instant, order of arming, robot, kind, element."""


def durations(elements: Iterable[Iterable[Element]]) -> dict[str, float]:
    """Return the times that timers and scripts take (s), as far as the model names them."""
    times = dict[str, float]()
    for element in chain.from_iterable(elements):
        for expression, use in element.texts():
            if use == "timer":
                times[element.id] = seconds_of(expression.text) or 1.0
            elif isinstance(element, Task) and expression is element.script:
                times[element.id] = sum(map(float, _SLEEP.findall(expression.text))) or 1.0
    return times


@dataclass(slots=True)
class Sampler:
    """Follows runs of a product that is not reduced. `durations`: of elements that take time, s.

    After an error that nothing catches the other robots go on: such runs are followed after those without it.
    """

    product: Product
    durations: dict[str, float]
    stop: Callable[[], bool]
    steps: int = STEPS
    explored: Explored = field(default_factory=Explored)
    bound: bool = False
    """Whether more could be followed: the steps or the time are over."""
    _armed: int = 0
    _ended: set[int] = field(default_factory=set)
    _edges: set[tuple[int, int]] = field(default_factory=set)
    _failing: list[tuple[int, Errors, int, tuple[Due, ...]]] = field(default_factory=list)

    def schedule(self) -> Explored:
        """Follow the schedule of `fame run`, with all decisions."""
        seen = set[tuple[int, tuple[tuple[float, int, str, str], ...]]]()
        for pending, steps in self._layers():
            for _ in range(steps):
                if not pending or self.stop():
                    break
                at, due = pending.pop()
                key = at, tuple((one[0], *one[3:]) for one in due)
                transitions = self._ways(at)
                if key in seen or not transitions or not due:
                    continue
                seen.add(key)
                now, _, _, robot, kind, element = due[0]
                left = tuple((round(one[0] - now, 6), *one[1:]) for one in due[1:])
                state = self.explored.states[at]
                for transition in self._of(transitions, state, robot, kind, element):
                    after = self._due(state, transition[0], left, robot if kind != "outside" else -1)
                    new = self._add(at, transition, after)
                    if new is not None:
                        pending.append((new, after))
                    elif kind == "outside":
                        pending.append((at, left))
            self.bound |= bool(pending)
        return self.close()

    def wander(self) -> Explored:
        """Follow random runs, the same each time."""
        random = Random(0)
        for pending, left in self._layers():
            while left > 0 and not self.stop():
                at, _ = random.choice(pending)
                for _ in range(LONGEST):
                    left -= 1
                    ahead = [one for one in self._ways(at) if one[0] != self.explored.states[at]]
                    new = self._add(at, random.choice(ahead)) if ahead else None
                    if new is None or (not left & 255 and self.stop()):
                        break
                    at = new
        return self.close()

    def close(self) -> Explored:
        """Note which states follow, as far as they were followed."""
        explored, edges = self.explored, sorted(self._edges)
        explored.begun = 0
        explored.targets.extend(target for _, target in edges)
        after = Counter(source for source, _ in edges)
        explored.offsets.extend(accumulate(after[at] for at in range(len(explored.states))))
        explored.open = list(range(len(explored.states)))
        explored.layers.append(len(explored.states))
        return explored

    def _layers(self) -> Iterator[tuple[list[tuple[int, tuple[Due, ...]]], int]]:
        """Where runs begin without an uncaught error, then after one, after two ..., each with its number of steps."""
        left, explored = self.steps, self.explored
        starts = [self._add(-1, transition, self._due(0, transition[0], ())) for transition in self.product.initial()]
        pending = [(at, self._due(0, explored.states[at], ())) for at in dict.fromkeys(starts) if at is not None]
        while left > LEAST:
            if pending:
                left //= 2  # so that there are steps for what follows after one error more
                yield pending, left
            explored.layers.append(len(explored.states))
            failing, self._failing = self._failing, []
            if not failing:
                return
            pending = []
            for source, errors, state, due in failing:
                at = add_state(self.product, self.explored, source, state)
                explored.failures.append((source, errors, (at,)))
                pending.append((at, due))
        self.bound = True

    def _ways(self, at: int) -> list[Transition]:
        """The transitions of a state; how it ends is noted."""
        state = self.explored.states[at]
        transitions = self.product.transitions(state)
        if at not in self._ended:
            self._ended.add(at)
            if self.product.is_final(state):
                self.explored.final.append(at)
            elif not transitions:
                self.explored.stuck.append(at)
        return transitions

    def _add(self, at: int, transition: Transition, due: tuple[Due, ...] = ()) -> int | None:
        """The number of the state to which a transition leads; None if it needs one more error, or is not explored."""
        errors, state = report(self.product, at, transition), transition[0]
        if self.product.is_cut(state):
            return None
        if errors:
            self._failing.append((at, errors, state, due))
            return None
        new = add_state(self.product, self.explored, at, state)
        if at >= 0:
            self._edges.add((at, new))
        self.explored.transitions += 1
        return new

    def _of(self, transitions: list[Transition], state: int, robot: int, kind: str, element: str) -> list[Transition]:
        """The transitions in which something happens to one token at an element of a robot."""
        view = self.product.locals[robot].views[state >> (robot * BITS) & MASK]
        elements = dict(zip(view.own, view.elements, strict=True))
        own = [one for one in transitions if one[1] == robot and one[2].stimulus[0] == kind
               and elements.get(one[2].stimulus) == element]  # fmt: skip
        first = min((one[2].stimulus[1] for one in own), default=None)
        return [one for one in own if one[2].stimulus[1] == first]

    def _due(self, old: int, new: int, left: tuple[Due, ...], moved: int = -1) -> tuple[Due, ...]:
        """What is due once the team has gone from one state to another; `moved`: the robot that did it."""
        due = list(left)
        for robot, local in enumerate(self.product.locals):
            before, after = (state >> (robot * BITS) & MASK for state in (old, new))
            if (left and before == after and robot != moved) or after >= CUT:
                continue
            view = local.views[after]
            keys = dict(zip((stimulus[:2] for stimulus in view.own), view.elements, strict=True))
            wanted = Counter((kind, element) for (kind, _), element in keys.items())
            for event in [one for one in due if one[3] == robot]:
                if wanted[event[4:]] > 0:
                    wanted[event[4:]] -= 1
                else:
                    due.remove(event)
            for (kind, element), count in wanted.items():
                for _ in range(count):
                    self._armed += 1
                    seconds = _WITHOUT.get(kind) or self.durations.get(element, 1.0)
                    due.append((seconds, _ORDER.get(kind, 6), self._armed, robot, kind, element))
        return tuple(sorted(due))
