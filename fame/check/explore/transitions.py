"""Transitions of a team: moves of its robots, as differences of its state.

A state of the team is one integer: a field for each robot's local state, one for a fault, a bit for each pool that has
to start (1 once it has), a field for the monitors of properties, above them the number of what the network holds. So a
move is added to any state in which its robot is where the move begins.
"""

from __future__ import annotations

from fame.check.explore.host import Flag
from fame.check.explore.local import Successor
from fame.check.explore.states import BITS as BITS, CUT as CUT, MASK as MASK
from fame.check.explore.stimuli import Stimulus
from fame.dataclasses import dataclass

DEAD = MASK
"""The local state of a robot whose engine has died."""
FAULT_BITS = 10
FAULTS = (1 << FAULT_BITS) - 1
"""Mask of the number of a fault; as such a number, that of all faults for which no other is left."""
MONITOR_BITS = 32
MONITORED = (1 << MONITOR_BITS) - 1
THROWN = "thrown"
"""What happens where a robot takes the signal of a watched property."""


class Move:
    """A successor of a robot's state, ready to be added to a state of the team.

    difference  of the team's state, without what is sent
    sending     number of what is sent, 0 for nothing
    mark        the bit of its pool, if it starts an instance of one that has to start
    flags       what to report, once; None if that is done
    failed      elements whose errors were not caught in it
    certain     whether that does not depend on anything unknown: all ways of the step fail
    ends        differences to where the robot is after further steps of its own, see `Reduction.ends`; None if unknown
    """

    mark: int
    sending: int
    state: int
    stimulus: Stimulus
    successor: Successor
    certain: bool

    __slots__ = (
        "certain",
        "difference",
        "ends",
        "failed",
        "flags",
        "mark",
        "sending",
        "state",
        "stimulus",
        "successor",
    )

    def __init__(self, robot: int, old: int, way: Successor, sending: int, stimulus: Stimulus, mark: int = 0) -> None:
        self.mark = mark
        self.difference: int = (way.state - old) << (robot * BITS)
        self.sending, self.state, self.stimulus, self.successor = sending, way.state, stimulus, way
        self.flags: tuple[Flag, ...] | None = way.flags or None
        self.failed: tuple[str, ...] = tuple(what.partition("\n")[0] for kind, what in way.flags if kind == "error")
        self.certain = False
        self.ends: tuple[int, ...] | None = None


Reactions = tuple[tuple[int, Move], ...]
"""What the receivers of a message did, at once: (robot, move)."""
Transition = tuple[int, int, Move, Reactions]
"""(new state, robot, its move, moves of others that follow at once)"""


def is_observed(transition: Transition) -> bool:
    """Return whether something happens in a transition that a property names."""
    _, _, move, reactions = transition
    return bool(move.successor.events) or any(done.successor.events for _, done in reactions)


@dataclass(slots=True)
class Seen:
    """The first occurrence of something: the state before, the robot and its move, and what followed."""

    at: int
    transition: Transition | None
