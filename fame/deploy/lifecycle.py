"""An engine as a managed node of ROS 2: its services and topic of lifecycle_msgs, beside the node's name.

``configure`` succeeds once a process is loaded. A deployment stays ``ready`` until all its robots are activated, or its
sender aborts it. ``deactivate`` suspends what runs, as a person does (`fame.robot.suspension`), ``activate`` lets it go
on, and ``shutdown`` ends it in the safe state. ``cleanup`` keeps the process: another deployment replaces it. There is
no bond: a manager of Nav2 needs ``bond_timeout: 0.0``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

from fame.deploy.machine import unexpected
from fame.errors import FameError
from fame.middleware import messages
from fame.middleware.interface import AnyMessage, Node

_STATES = {
    1: "unconfigured", 2: "inactive", 3: "active", 4: "finalized", 10: "configuring", 11: "cleaningup",
    12: "shuttingdown", 13: "activating", 14: "deactivating", 15: "errorprocessing",
}  # fmt: skip
"""Of lifecycle_msgs/msg/State."""
_ACTIVE = 3


class _Transition(NamedTuple):
    """From a state by another one (`during`) to its goal; `ended` is the transition by which it succeeds, the next
    number the one by which it fails."""

    label: str
    start: int
    during: int
    goal: int
    ended: int


_TRANSITIONS = {
    1: _Transition("configure", 1, 10, 2, 10), 2: _Transition("cleanup", 2, 11, 1, 20),
    3: _Transition("activate", 2, 13, 3, 30), 4: _Transition("deactivate", 3, 14, 2, 40),
    5: _Transition("shutdown", 1, 12, 4, 50), 6: _Transition("shutdown", 2, 12, 4, 50),
    7: _Transition("shutdown", 3, 12, 4, 50),
}  # fmt: skip
"""Of lifecycle_msgs/msg/Transition, by number."""


class Lifecycle:
    """The lifecycle of a node. `acts` has what some transitions do, by label: a FameError is why one fails.

    `now` gives ns, `note` gets a line for people.
    """

    def __init__(
        self,
        node: Node,
        acts: Mapping[str, Callable[[], object]],
        *,
        now: Callable[[], int],
        note: Callable[[str], object],
    ) -> None:
        self._state, self._acts, self._now, self._note = 1, acts, now, note
        self._events = node.publisher(f"{node.name}/transition_event", "lifecycle_msgs/msg/TransitionEvent")
        states = {"available_states": list(map(_state, _STATES))}
        for name, type, handler in (
            ("change_state", "ChangeState", self._change),
            ("get_state", "GetState", lambda request: {"current_state": _state(self._state)}),
            ("get_available_states", "GetAvailableStates", lambda request: states),
            ("get_available_transitions", "GetAvailableTransitions", lambda request: _described(self._possible())),
            ("get_transition_graph", "GetAvailableTransitions", lambda request: _described(_TRANSITIONS)),
        ):
            node.service(f"{node.name}/{name}", f"lifecycle_msgs/srv/{type}", handler)

    @property
    def is_active(self) -> bool:
        """Whether missions may run."""
        return self._state == _ACTIVE

    @property
    def state(self) -> str:
        return _STATES[self._state]

    def _possible(self) -> list[int]:
        return [number for number, transition in _TRANSITIONS.items() if transition.start == self._state]

    def _change(self, request: AnyMessage) -> dict[str, bool]:
        """Do a transition, given by its label, else by its number, if it begins in the state."""
        asked = request.transition
        fits = [one for one in self._possible() if (_label(one) == asked.label if asked.label else one == asked.id)]
        number = next(iter(fits), None)
        if number is None:
            name = asked.label or _label(asked.id)
            self._note(f"cannot {name}: it is {self.state}, and can {', '.join(map(_label, self._possible()))}")
            return {"success": False}
        transition, reason = _TRANSITIONS[number], ""
        self._publish(number, transition.label, transition.start, transition.during)
        self._state = transition.goal  # acts ask for it
        try:
            self._acts.get(transition.label, lambda: None)()
        except Exception as error:  # no request ends an engine, or leaves it in a state that it is not in
            reason = str(error) if isinstance(error, FameError) else unexpected(error)
            self._state = transition.start
        result = "failure" if reason else "success"
        self._publish(transition.ended + bool(reason), f"transition_{result}", transition.during, self._state)
        self._note(f"cannot {transition.label}: {reason}" if reason else f"is {self.state}")
        return {"success": not reason}

    def _publish(self, number: int, label: str, start: int, goal: int) -> None:
        event = {
            "timestamp": self._now(),
            "transition": {"id": number, "label": label},
            "start_state": _state(start),
            "goal_state": _state(goal),
        }
        self._events.publish(messages.create("lifecycle_msgs/msg/TransitionEvent", event))


def _label(number: int) -> str:
    return _TRANSITIONS[number].label if number in _TRANSITIONS else f"transition {number}"


def _state(number: int) -> dict[str, Any]:
    return {"id": number, "label": _STATES[number]}


def _described(numbers: Iterable[int]) -> dict[str, Any]:
    descriptions = [
        {
            "transition": {"id": number, "label": _label(number)},
            "start_state": _state(_TRANSITIONS[number].start),
            "goal_state": _state(_TRANSITIONS[number].during),
        }
        for number in numbers
    ]
    return {"available_transitions": descriptions}
