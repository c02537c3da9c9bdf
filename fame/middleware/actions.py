"""Actions of ROS 2, on any backend: a goal that takes its time, tells how far it is, and can be cancelled.

An action is three services and a topic below its name, all hidden from ``ros2 topic list`` (ROS 2 design, article
Actions): ``_action/send_goal``, ``_action/get_result``, ``_action/cancel_goal``, ``_action/feedback``. A fifth, the
status of all goals, is for onlookers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal
from uuid import uuid4

from fame.middleware import messages
from fame.middleware.interface import Message, Node, QoS, resolve

Outcome = Literal["succeeded", "canceled", "aborted", "rejected"]
Ended = Callable[[Outcome, Message], object]

CANCEL = "action_msgs/srv/CancelGoal"
FEEDBACK = QoS(depth=10)
OUTCOMES: dict[int, Outcome] = {4: "succeeded", 5: "canceled", 6: "aborted"}
"""What the status of a goal says when it is over (action_msgs/msg/GoalStatus)."""


class ActionClient:
    """Who sends goals to the action `name`, of type ``pkg/action/Name``. Raises MessageError for an unknown type."""

    def __init__(self, node: Node, name: str, type: str) -> None:
        self.name, self.type = resolve(name, node.namespace), messages.action(type)
        below = f"{self.name}/_action"
        self.sending = node.client(f"{below}/send_goal", f"{self.type}_SendGoal")
        self.results = node.client(f"{below}/get_result", f"{self.type}_GetResult")
        self.cancelling = node.client(f"{below}/cancel_goal", CANCEL)
        self._feedback = node.subscription(f"{below}/feedback", f"{self.type}_FeedbackMessage", self._heard, FEEDBACK)
        self.goals: dict[bytes, Goal] = {}

    @property
    def available(self) -> bool:
        """Whether somebody offers the action now."""
        return self.sending.available and self.results.available and self.cancelling.available

    def send(self, goal: Any, ended: Ended, feedback: Callable[[Message], object] = lambda message: None) -> Goal:
        """Send a goal (a mapping, or a message of ``pkg/action/Name_Goal``).

        `feedback` gets what is told meanwhile; `ended` is called once, with the result, which is None of a rejected
        goal. Raises MessageError if the goal does not fit, or nobody offers the action.
        """
        sent = Goal(self, ended, feedback)
        self.sending.call({"goal_id": {"uuid": sent.id}, "goal": goal}, sent.answered)
        self.goals[sent.id] = sent
        return sent

    def close(self) -> None:
        """Leave. Goals go on unheard; who wants them to end cancels them first."""
        self.goals.clear()
        for end in (self.sending, self.results, self.cancelling, self._feedback):
            end.close()

    def _heard(self, message: Message) -> None:
        goal = self.goals.get(bytes(message.goal_id.uuid))
        if goal is not None:
            goal.feedback(message.feedback)


class Goal:
    """A goal under way."""

    def __init__(self, client: ActionClient, ended: Ended, feedback: Callable[[Message], object]) -> None:
        self.id, self.feedback = uuid4().bytes, feedback
        self._client, self._ended = client, ended
        self._accepted = self._unwanted = False

    def cancel(self) -> None:
        """Ask for its end; nothing more is heard of it. Does nothing if it is over."""
        if self._client.goals.pop(self.id, None) is not None:
            self._unwanted = True
            if self._accepted:
                self._ask_to_end()

    def answered(self, response: Message) -> None:
        """The server has taken it, or not."""
        if not response.accepted:
            self._end("rejected", None)
        elif self._unwanted:
            self._ask_to_end()
        else:
            self._accepted = True
            self._client.results.call({"goal_id": {"uuid": self.id}}, self._over)

    def _over(self, response: Message) -> None:
        self._end(OUTCOMES.get(response.status, "aborted"), response.result)

    def _end(self, outcome: Outcome, result: Message) -> None:
        if self._client.goals.pop(self.id, None) is not None:
            self._ended(outcome, result)

    def _ask_to_end(self) -> None:
        if self._client.cancelling.available:
            self._client.cancelling.call({"goal_info": {"goal_id": {"uuid": self.id}}}, lambda response: None)
