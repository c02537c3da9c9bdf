"""What each robot's process is at, in words: captions of progress lines and films."""

from __future__ import annotations

from collections.abc import Sequence

from fame.bpmn.model import Activity, Definitions, FlowNode, Gateway
from fame.clock import SECOND
from fame.node import Event


class Captions:
    """What each robot's process is at, told from events: its outermost activity, and the one entered last.

    An event-based gateway that has a name counts as one: there is where a process waits for others.
    """

    def __init__(self, files: Sequence[Definitions]) -> None:
        self.names = {
            node.id: node.label
            for file in reversed(files)
            for process in file.processes
            for node in process.body.walk()
            if isinstance(node, Activity) or _is_named_wait(node)
        }
        self.active: dict[str, dict[tuple[int, int, str], None]] = {}
        self.now: dict[str, str] = {}
        self.labels: list[tuple[float, str, str]] = []

    def add(self, event: Event) -> None:
        """Take note of an event."""
        if event.what in ("enter", "leave", "cancel", "fail") and event.element not in self.names:
            return
        active = self.active.setdefault(event.robot, {})
        key = (event.instance, event.scope, event.element)
        if event.what == "enter":
            active[key] = None
        elif event.what in ("leave", "cancel", "fail"):
            active.pop(key, None)
        elif event.what == "end":
            for other in [other for other in active if other[0] == event.instance]:
                del active[other]
            self._say(event, f"({event.detail})")
            return
        else:
            return
        names = [self.names[element] for _, _, element in active]
        if names:
            self._say(event, names[0] if len(names) == 1 else f"{names[0]}: {names[-1]}")

    def _say(self, event: Event, text: str) -> None:
        if self.now.get(event.robot) != text:
            self.now[event.robot] = text
            self.labels.append((event.time / SECOND, event.robot, text))


def _is_named_wait(node: FlowNode) -> bool:
    return isinstance(node, Gateway) and node.kind == "event" and bool(node.name)
