"""Actions of ROS 2, on any backend: a goal runs for some time, gives feedback, and can be cancelled.

An action is three services and a topic below its name, all hidden from ``ros2 topic list`` (ROS 2 design, article
Actions): ``_action/send_goal``, ``_action/get_result``, ``_action/cancel_goal``, ``_action/feedback``. A second topic,
``_action/status``, tells observers the status of the unfinished goals, and of one that has just ended.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal

from fame.errors import MessageError
from fame.middleware import messages
from fame.middleware.interface import LATCHED, AnyMessage, Client, DeferredResponse, Node, QoS, resolve

GoalOutcome = Literal["succeeded", "canceled", "aborted", "rejected"]
GoalEnd = GoalOutcome | Literal["unknown", "gone"]
"""How following a goal ends: its outcome; ``unknown``: its server does not know it; ``gone``: its server has left, or
another has come, and the goal may still run (`ActionClient.attach` finds out)."""
OnEnd = Callable[[GoalEnd, AnyMessage], object]

CANCEL = "action_msgs/srv/CancelGoal"
FEEDBACK = QoS(depth=10)
STATUS = "action_msgs/msg/GoalStatusArray"
OUTCOMES: dict[int, GoalOutcome] = {4: "succeeded", 5: "canceled", 6: "aborted"}
"""The status of a goal that has ended (action_msgs/msg/GoalStatus)."""
UNKNOWN = 0
"""The status of a goal that the server does not know."""
_STATUSES: dict[GoalOutcome, int] = {outcome: status for status, outcome in OUTCOMES.items()}
_EXECUTING = 2
_REJECTED, _UNKNOWN_GOAL, _ENDED_GOAL = 1, 2, 3
"""Return codes of action_msgs/srv/CancelGoal: it refuses, or the goal does not exist, or has ended."""
_KEPT = 100
"""Number of ended goals whose results are kept for late requests."""


class ActionClient:
    """A client of the action `name`, of type ``pkg/action/Name``. Raises MessageError for an unknown type.

    `cancelled` are the goals that were cancelled and have not ended, as far as is known; `on_cancelled` is called with
    one that its server refuses to cancel, or that has ended.
    """

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
        self.cancelled: dict[bytes, Goal] = {}
        self.on_cancelled: Callable[[Goal], object] = lambda goal: None

    @property
    def available(self) -> bool:
        """Whether a node offers the action now."""
        return self._send_goal.available and self.get_result.available and self.cancel_goal.available

    @property
    def mismatch(self) -> str:
        """Why it is not connected to an action server of its name; empty if it is connected or no server exists."""
        ends = self._send_goal, self.get_result, self.cancel_goal
        return next((end.mismatch for end in ends if end.mismatch), "")

    def send(
        self,
        goal: Any,
        on_end: OnEnd,
        feedback: Callable[[AnyMessage], object] = lambda message: None,
        *,
        id: bytes | None = None,
    ) -> Goal:
        """Send a goal (a mapping, or a message of ``pkg/action/Name_Goal``).

        `feedback` gets the feedback; `on_end` is called once, with the outcome and the result (None without one). `id`
        are the 16 bytes of its id, by default random. Raises MessageError if the goal does not fit, or if no node
        offers the action.
        """
        sent = Goal(self, on_end, feedback, id)
        request = {"goal_id": {"uuid": sent.id}, "goal": goal}
        self._send_goal.call(request, sent.on_accepted, sent.on_gone, or_new=True)
        self.goals[sent.id] = sent
        return sent

    def attach(self, id: bytes, on_end: OnEnd, feedback: Callable[[AnyMessage], object]) -> Goal:
        """Follow a goal that was sent before, perhaps by a process that has ended. Callbacks as of `send`.

        Raises MessageError if no node offers the action.
        """
        known = Goal(self, on_end, feedback, id, accepted=True)
        known.request_result()
        self.goals[id] = known
        return known

    def cancel(self, id: bytes) -> Goal:
        """Cancel a goal that another client has sent."""
        goal = self.goals[id] = Goal(self, lambda outcome, result: None, lambda feedback: None, id, accepted=True)
        goal.cancel()
        return goal

    def close(self) -> None:
        """Close all endpoints. Goals continue: cancel them first to end them."""
        self.goals.clear()
        self.cancelled.clear()
        for end in (self._send_goal, self.get_result, self.cancel_goal, self._feedback):
            end.close()

    def _on_feedback(self, message: AnyMessage) -> None:
        goal = self.goals.get(bytes(message.goal_id.uuid))
        if goal is not None:
            goal.feedback(message.feedback)


class Goal:
    """A goal that was sent. `refused`: its server refuses to cancel it. `outcome`: how one that was cancelled ended."""

    outcome: GoalEnd | None
    feedback: Callable[[AnyMessage], object]
    id: bytes
    refused: bool

    def __init__(
        self,
        client: ActionClient,
        on_end: OnEnd,
        feedback: Callable[[AnyMessage], object],
        id: bytes | None = None,
        *,
        accepted: bool = False,
    ) -> None:
        from uuid import uuid4

        self.id, self.feedback = id or uuid4().bytes, feedback
        self._client, self._on_end = client, on_end
        self._accepted, self._awaits_result, self.refused = accepted, False, False
        self.outcome = None

    @property
    def _cancelled(self) -> bool:
        return self._client.cancelled.get(self.id) is self

    def cancel(self) -> None:
        """Request cancelling, once its server is there; neither feedback nor outcome follow.

        Does nothing if the goal has ended.
        """
        if self._client.goals.get(self.id) is self:
            self._client.cancelled[self.id] = self._client.goals.pop(self.id)
            if self._accepted:
                self._request_cancel()

    def on_accepted(self, response: AnyMessage) -> None:
        """Handle that the server has accepted or rejected the goal."""
        if not response.accepted:
            self._end("rejected", None)
        elif self._cancelled:
            self._request_cancel()
        else:
            self._accepted = True
            try:
                self.request_result()
            except MessageError:  # the server has left meanwhile
                self.on_gone()

    def request_result(self) -> None:
        """Request the result, which comes when the goal has ended. Raises MessageError."""
        self._awaits_result = True
        self._client.get_result.call({"goal_id": {"uuid": self.id}}, self.on_result, self.on_gone, or_new=True)

    def ask_again(self) -> None:
        """Request the result once more, in case the request before was lost. Does nothing if the goal has ended."""
        if self._client.goals.get(self.id) is self and self._client.available:
            self.request_result()

    def on_result(self, response: AnyMessage) -> None:
        """Handle that the goal has ended, or is unknown."""
        if response.status == UNKNOWN:
            self._end("unknown", None)
        else:
            self._end(OUTCOMES.get(response.status, "aborted"), response.result)

    def on_gone(self) -> None:
        """Handle that the server has left, or another has come. The goal can be cancelled until it is attached to."""
        if self._cancelled:
            self._awaits_result = False
            self._request_cancel()  # it may have accepted the goal
        elif self._client.goals.get(self.id) is self:
            self._accepted = True
            self._on_end("gone", None)

    def _end(self, outcome: GoalEnd, result: AnyMessage) -> None:
        if self._cancelled:
            del self._client.cancelled[self.id]
            self.outcome = outcome
            self._client.on_cancelled(self)
        elif self._client.goals.get(self.id) is self:
            del self._client.goals[self.id]
            self._on_end(outcome, result)

    def _request_cancel(self) -> None:
        self._client.cancel_goal.insist({"goal_info": {"goal_id": {"uuid": self.id}}}, self._on_cancel_response)

    def _on_cancel_response(self, response: AnyMessage) -> None:
        """Handle that the server ends the goal, refuses that, or does not run it. Its result says when it has ended."""
        if not self._cancelled:
            return
        ended = response.return_code == _ENDED_GOAL
        if response.return_code == _UNKNOWN_GOAL or (ended and not self._client.available):
            self._end("unknown", None)
            return
        if response.return_code == _REJECTED or not (ended or response.goals_canceling):
            self.refused = True
            self._client.on_cancelled(self)
        if (ended or not self._awaits_result) and self._client.available:
            self.request_result()


class ActionServer:
    """A server of the action `name`, of type ``pkg/action/Name``. Raises MessageError for an unknown type.

    `accept` decides on each goal message; `on_goal` is called with each accepted goal and must end it later.
    `on_cancel` is called when a client asks to cancel a goal, and should end it as ``canceled``, or return False: it
    refuses.
    """

    name: str
    type: str

    def __init__(
        self,
        node: Node,
        name: str,
        type: str,
        on_goal: Callable[[ServerGoal], object],
        on_cancel: Callable[[ServerGoal], object],
        accept: Callable[[AnyMessage], bool] = lambda goal: True,
    ) -> None:
        self.name, self.type = resolve(name, node.namespace), messages.action(type)
        self._on_goal, self._on_cancel, self._accept = on_goal, on_cancel, accept
        self.goals: dict[bytes, ServerGoal] = {}
        self._results: dict[bytes, DeferredResponse] = {}
        below = f"{self.name}/_action"
        self._feedback = node.publisher(f"{below}/feedback", f"{self.type}_FeedbackMessage", FEEDBACK)
        self._status = node.publisher(f"{below}/status", STATUS, LATCHED)
        self._ends = (
            node.service(f"{below}/send_goal", f"{self.type}_SendGoal", self._send_goal),
            node.service(f"{below}/get_result", f"{self.type}_GetResult", self._get_result),
            node.service(f"{below}/cancel_goal", CANCEL, self._cancel_goal),
        )

    def close(self) -> None:
        """Close all endpoints. Clients of unfinished goals get no result."""
        for end in (*self._ends, self._feedback, self._status):
            end.close()

    def publish_feedback(self, goal: ServerGoal, feedback: Mapping[str, Any]) -> None:
        """Send feedback to the client of a goal."""
        fields = {"goal_id": {"uuid": goal.id}, "feedback": feedback}
        self._feedback.publish(messages.create(f"{self.type}_FeedbackMessage", fields))

    def end(self, goal: ServerGoal, outcome: GoalOutcome, result: Mapping[str, Any]) -> None:
        """End a goal with its result. Does nothing if it has ended already."""
        if self.goals.pop(goal.id, None) is None:
            return
        self._result(goal.id).respond({"status": _STATUSES[outcome], "result": result})
        self._publish_status(goal.id, _STATUSES[outcome])
        for ended in [id for id in self._results if id not in self.goals][:-_KEPT]:
            del self._results[ended]

    def _send_goal(self, request: AnyMessage) -> Mapping[str, Any]:
        id = bytes(request.goal_id.uuid)
        if id in self._results or not self._accept(request.goal):
            return {"accepted": False}
        goal = self.goals[id] = ServerGoal(self, id, request.goal)
        self._result(id)
        self._publish_status(id, _EXECUTING)
        self._on_goal(goal)
        return {"accepted": True}

    def _get_result(self, request: AnyMessage) -> DeferredResponse | Mapping[str, Any]:
        id = bytes(request.goal_id.uuid)
        return self._results.get(id, {"status": UNKNOWN})

    def _cancel_goal(self, request: AnyMessage) -> Mapping[str, Any]:
        id = bytes(request.goal_info.goal_id.uuid)
        wanted = [goal for goal in self.goals.values() if goal.id == id or not any(id)]
        ids = [{"goal_id": {"uuid": goal.id}} for goal in wanted if self._on_cancel(goal) is not False]
        return {"return_code": 0 if ids else _REJECTED if wanted else _UNKNOWN_GOAL, "goals_canceling": ids}

    def _result(self, id: bytes) -> DeferredResponse:
        return self._results.setdefault(id, DeferredResponse())

    def _publish_status(self, changed: bytes, status: int) -> None:
        statuses = {**dict.fromkeys(self.goals, _EXECUTING), changed: status}
        rows = [{"goal_info": {"goal_id": {"uuid": id}}, "status": each} for id, each in statuses.items()]
        self._status.publish(messages.create(STATUS, {"status_list": rows}))


class ServerGoal:
    """A goal that a server has accepted; `message` is of type ``pkg/action/Name_Goal``."""

    id: bytes
    message: AnyMessage

    def __init__(self, server: ActionServer, id: bytes, message: AnyMessage) -> None:
        self.id, self.message, self._server = id, message, server

    def feedback(self, fields: Mapping[str, Any]) -> None:
        """Send feedback to the client."""
        self._server.publish_feedback(self, fields)

    def end(self, outcome: GoalOutcome, result: Mapping[str, Any]) -> None:
        """End the goal with its result. Does nothing if it has ended already."""
        self._server.end(self, outcome, result)
