"""Actions of ROS 2, on any backend: a goal runs for some time, gives feedback, and can be cancelled.

An action is three services and a topic below its name, all hidden from ``ros2 topic list`` (ROS 2 design, article
Actions): ``_action/send_goal``, ``_action/get_result``, ``_action/cancel_goal``, ``_action/feedback``. A fifth, the
status of all goals, is for observers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal
from uuid import uuid4

from fame.middleware import messages
from fame.middleware.interface import Client, Message, Node, QoS, resolve

Outcome = Literal["succeeded", "canceled", "aborted", "rejected"]
OnEnd = Callable[[Outcome, Message], object]

CANCEL = "action_msgs/srv/CancelGoal"
FEEDBACK = QoS(depth=10)
OUTCOMES: dict[int, Outcome] = {4: "succeeded", 5: "canceled", 6: "aborted"}
"""The status of a goal that has ended (action_msgs/msg/GoalStatus)."""
UNKNOWN = 0
"""The status of a goal that the server does not know."""


class ActionClient:
    """A client of the action `name`, of type ``pkg/action/Name``. Raises MessageError for an unknown type."""

    name: str
    type: str
    get_result: Client
    cancel_goal: Client

    def __init__(self, node: Node, name: str, type: str) -> None:
        self.name, self.type = resolve(name, node.namespace), messages.action(type)
        below = f"{self.name}/_action"
        self._send_goal = node.client(f"{below}/send_goal", f"{self.type}_SendGoal")
        self.get_result = node.client(f"{below}/get_result", f"{self.type}_GetResult")
        self.cancel_goal = node.client(f"{below}/cancel_goal", CANCEL)
        self._feedback = node.subscription(
            f"{below}/feedback", f"{self.type}_FeedbackMessage", self._on_feedback, FEEDBACK
        )
        self.goals: dict[bytes, Goal] = {}

    @property
    def available(self) -> bool:
        """Whether a node offers the action now."""
        return self._send_goal.available and self.get_result.available and self.cancel_goal.available

    def send(
        self,
        goal: Any,
        on_end: OnEnd,
        feedback: Callable[[Message], object] = lambda message: None,
        *,
        id: bytes | None = None,
    ) -> Goal:
        """Send a goal (a mapping, or a message of ``pkg/action/Name_Goal``).

        `feedback` gets the feedback; `on_end` is called once, with the outcome and the result, which is None for a
        rejected goal. `id` are the 16 bytes of its id, by default random. Raises MessageError if the goal does not fit,
        or if no node offers the action.
        """
        sent = Goal(self, on_end, feedback, id)
        self._send_goal.call({"goal_id": {"uuid": sent.id}, "goal": goal}, sent.on_accepted)
        self.goals[sent.id] = sent
        return sent

    def attach(
        self, id: bytes, on_end: OnEnd, feedback: Callable[[Message], object], unknown: Callable[[], object]
    ) -> Goal:
        """Take up a goal that was sent before, perhaps by a process that has ended, as `send` does.

        Calls `unknown` if the server does not know the goal (any more). Raises MessageError if no node offers the
        action.
        """
        known = Goal(self, on_end, feedback, id, unknown)
        self.get_result.call({"goal_id": {"uuid": id}}, known.on_result)
        self.goals[id] = known
        return known

    def close(self) -> None:
        """Close all endpoints. Goals go on: cancel them first to end them."""
        self.goals.clear()
        for end in (self._send_goal, self.get_result, self.cancel_goal, self._feedback):
            end.close()

    def _on_feedback(self, message: Message) -> None:
        goal = self.goals.get(bytes(message.goal_id.uuid))
        if goal is not None:
            goal.feedback(message.feedback)


class Goal:
    """A goal that was sent."""

    feedback: Callable[[Message], object]
    id: bytes

    def __init__(
        self,
        client: ActionClient,
        on_end: OnEnd,
        feedback: Callable[[Message], object],
        id: bytes | None = None,
        unknown: Callable[[], object] | None = None,
    ) -> None:
        self.id, self.feedback = id or uuid4().bytes, feedback
        self._client, self._on_end, self._unknown = client, on_end, unknown
        self._accepted, self._cancelled = unknown is not None, False

    def cancel(self) -> None:
        """Request cancelling; neither feedback nor outcome follow. Does nothing if the goal has ended."""
        if self._client.goals.pop(self.id, None) is not None:
            self._cancelled = True
            if self._accepted:
                self._request_cancel()

    def on_accepted(self, response: Message) -> None:
        """The server has accepted or rejected the goal."""
        if not response.accepted:
            self._end("rejected", None)
        elif self._cancelled:
            self._request_cancel()
        else:
            self._accepted = True
            self._client.get_result.call({"goal_id": {"uuid": self.id}}, self.on_result)

    def on_result(self, response: Message) -> None:
        """The goal has ended, or is unknown."""
        if response.status == UNKNOWN and self._unknown is not None:
            if self._client.goals.pop(self.id, None) is not None:
                self._unknown()
            return
        self._end(OUTCOMES.get(response.status, "aborted"), response.result)

    def _end(self, outcome: Outcome, result: Message) -> None:
        if self._client.goals.pop(self.id, None) is not None:
            self._on_end(outcome, result)

    def _request_cancel(self) -> None:
        if self._client.cancel_goal.available:
            self._client.cancel_goal.call({"goal_info": {"goal_id": {"uuid": self.id}}}, lambda response: None)
