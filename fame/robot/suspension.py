"""A person's suspension of a robot's mission, and the lease of the person who steers the robot meanwhile.

The mission is held as after an incident (`RobotNode.hold`): running activities are cancelled and begin again, timers
run on, the robot is in its safe state. One person at a time steers, under a lease that ends unless it is prolonged.
While it lasts ``taken_over`` (std_msgs/msg/Bool) of the robot is true with each prolongation, so that the robot obeys
``cmd_vel_manual`` alone. A suspension survives a restart of the engine, a lease does not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fame.clock import SECOND, Entry, Kind
from fame.engine import BpmnError
from fame.errors import MissionError
from fame.middleware import messages
from fame.middleware.interface import resolve

if TYPE_CHECKING:
    from fame.robot.node import RobotNode

LIFECYCLE = "the lifecycle"
"""The author of a suspension by the manager of a node's lifecycle; a person's takes its place."""
SUSPENDED = "a person"
"""Why a robot holds while a person has suspended its mission."""
TAKEN_OVER = "taken_over"
"""The code of an error that a person raises in place of what a robot did; also the topic."""
LEASE = 3 * SECOND
"""For how long a person steers a robot after each request (ns)."""
_HOLDS = {
    "incident": "an incident",
    "deployment": "a deployment that is about to start",
    "disk": "its state, which cannot be written (free space on its disk)",
    "memory": "a step that may be half done, since no memory was left (deploy again)",
    "promise": "what it had promised to start, which is lost (deploy again)",
}
"""Other reasons, in words."""
_BOOL = "std_msgs/msg/Bool"


class Suspension:
    """A person's suspension of the mission of `node`.

    by      who suspended it, empty if it is not suspended; `since` when (ns)
    holder  who steers the robot, or empty
    """

    by: str
    holder: str
    since: int

    def __init__(self, node: RobotNode) -> None:
        self._node = node
        self.by = self.holder = self._lease = self._ended = ""
        self.since = 0
        self._expiry: Entry | None = None

    def suspend(self, who: str) -> None:
        """Suspend the mission and stop the robot, whoever steers it."""
        self._end_lease()
        self._begin(who, f"suspended by {who}")

    def take_over(self, who: str, lease: str) -> None:
        """Suspend the mission, and let a person steer for `LEASE`; the same `lease` again prolongs that.

        Raises MissionError while another person steers, and for a lease that has ended.
        """
        self._check_holder(who, lease)
        if lease and lease == self._ended:
            raise MissionError(f"{who} steers no longer: take over again", robot=self._node.name)
        if not self.holder:
            self.holder, self._lease = who, lease
            self._begin(who, f"taken over by {who}")
        if self._expiry is not None:
            self._expiry.cancel()
        self._expiry = self._node.scheduler.after(LEASE, self._expire, Kind.TIMER)
        self._publish_lock(True)

    def check_steers(self, who: str, lease: str) -> None:
        """Raise MissionError unless a person steers, by this lease."""
        self._check_holder(who, lease)
        if not self.holder:
            raise MissionError(f"{who} does not steer it: take over first", robot=self._node.name)

    def go_on(self, who: str, lease: str = "") -> None:
        """Let the mission continue. Raises MissionError if no person has suspended it, or another one steers."""
        self._check_continues(who, lease)
        self._end(f"continued by {who}")
        self._node.release(SUSPENDED)
        self._node.engine.run()  # the record of it, also if something else holds the robot

    def other_holds(self) -> str:
        """Return what else holds the robot, and what ends that; empty if nothing does."""
        node = self._node
        places = list(dict.fromkeys(wait.node.id for wait in node.engine.incidents))
        repairs = f"fame retry {node.name} {places[0]}, or fame skip" if places else ""
        texts = {"incident": f"an incident at {', '.join(places)} ({repairs})"} if places else {}
        return ", and ".join(
            texts.get(reason, _HOLDS.get(reason, reason)) for reason in sorted(node.holds - {SUSPENDED})
        )

    def deactivate(self) -> None:
        """Suspend the mission for the manager of a node's lifecycle."""
        self.suspend(LIFECYCLE)

    def activate(self) -> str:
        """Continue what `deactivate` suspended. Returns who still suspends the mission; empty if nobody does."""
        if self.by == LIFECYCLE:
            self.go_on(LIFECYCLE)
        return self.by

    def fail(self, element: str, who: str, lease: str = "") -> None:
        """Raise the error `TAKEN_OVER` at an element, and let the mission continue.

        Raises MissionError if no token is there, something else holds the robot, or as `go_on` does.
        """
        self._check_continues(who, lease)
        node = self._node
        if others := [*sorted(node.holds - {SUSPENDED}), *(["the end of a script"] if node.leaving else ())]:
            raise MissionError(f"cannot fail yet: the robot also holds for {', '.join(others)}", element=element)
        node.engine.fail(element, BpmnError(TAKEN_OVER, f"taken over by {who}"))
        node.holds.discard(SUSPENDED)
        self._end(f"continued by {who}")

    def close(self) -> None:
        """Forget the lease: the process ends."""
        if self._expiry is not None:
            self._expiry.cancel()

    # ---- its beginning and its end -----------------------------------------------------------------------------------

    def _check_holder(self, who: str, lease: str) -> None:
        if self.holder and (who, lease) != (self.holder, self._lease):
            raise MissionError(f"{self.holder} steers it; fame suspend stops it", robot=self._node.name)

    def _check_continues(self, who: str, lease: str) -> None:
        if not self.by:
            raise MissionError("no person has suspended its mission", robot=self._node.name)
        self._check_holder(who, lease)

    def _begin(self, who: str, text: str) -> None:
        """Hold the mission, and report it; the person who suspended it first stays its author."""
        node = self._node
        if self.by in ("", LIFECYCLE):
            self.by, self.since = who, node.scheduler.now
        self._label()
        node.note("", text)
        node.hold(SUSPENDED)
        node.host.make_safe("suspended")
        node.engine.run()  # the record of it

    def _end(self, text: str) -> None:
        self._end_lease()
        self.by = ""
        self._label()
        self._node.note("", text)

    def _expire(self) -> None:
        """The one who steered is gone: the robot stops, and its mission stays suspended."""
        text = f"{self.holder} steers no longer: lost"
        self._end_lease()
        self._label()
        self._node.host.make_safe("suspended")
        self._node.note("", text)

    def _end_lease(self) -> None:
        self.close()
        if self.holder:
            self._ended, self.holder, self._lease = self._lease, "", ""
            self._publish_lock(False)

    def _label(self) -> None:
        """Say at the tokens who holds them."""
        steers = f"{self.holder}, who steers it" if self.holder else ""
        self._node.waiting.person = (steers or self.by, self.since)

    def _publish_lock(self, locked: bool) -> None:
        node = self._node
        publisher = node.endpoints.publisher(resolve(TAKEN_OVER, node.namespace), _BOOL)
        publisher.publish(messages.create(_BOOL, locked))

    def to_json(self) -> dict[str, Any]:
        """Return what a status says of it (`fame.deploy.Report.suspended`)."""
        return {"by": self.by, "since": self.since / SECOND, "holder": self.holder} if self.by else {}

    # ---- across engines ----------------------------------------------------------------------------------------------

    def table(self, epoch: int) -> dict[str, Any]:
        """Return the state of it as a table (`fame.robot.state_tables`); `epoch` is the date of
        time 0 (ns since 1970)."""
        return {"": [self.by, self.since + epoch]} if self.by else {}

    def restore(self, table: dict[str, Any], epoch: int) -> None:
        """Take the state from a table."""
        if table:
            self.by, since = table[""]
            self.since = since - epoch
            self._label()
