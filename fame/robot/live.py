"""The topics of a robot's engine for live views and recorders in other processes.

On ``/<robot>/bpmn_events`` (std_msgs/msg/String, reliable) are numbered batches of changes as JSON, at most 20 a
second, while there is a subscriber; on ``/<robot>/bpmn_model`` (transient local) is the running model. A new
subscriber gets the whole state first, with the next batch; all get it every few seconds, in case a batch was lost.
docs/recording_format.md describes the JSON.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from itertools import chain, count
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, Protocol
from weakref import WeakSet

from fame.clock import EPOCH, SECOND, Entry, Kind, Scheduler, date_text
from fame.engine.state import Trail
from fame.fast_json import json_bytes
from fame.middleware import messages
from fame.middleware.interface import Node, Publisher
from fame.robot.changes import ChangeTracker
from fame.robot.events import Event, Observer
from fame.robot.robot_state import COUNTED, RobotState
from fame.version import PROTOCOL

if TYPE_CHECKING:
    from fame.robot.node import RobotNode

STRING, ELEMENT_TOPIC = "std_msgs/msg/String", "/fame_dt"
_PERIOD = SECOND // 20
"""Least time between two batches (ns)."""
_KEY_PERIOD = 5 * SECOND
"""Longest time between two batches with the whole state, while there is a subscriber (ns)."""
_POLL = SECOND // 4
"""Interval of the checks for subscribers (ns)."""


class FeedLog(Protocol):
    """A log that receives everything, with and without subscribers (`fame.fleet.engine_log`)."""

    def on_batch(self, batch: Mapping[str, Any]) -> None:
        """Take a batch."""

    def on_model(self, model: Mapping[str, Any]) -> None:
        """Take the model that the robot runs from now on."""


class LiveFeed:
    """Publishes the changes of one robot while there are subscribers.

    `publisher` and `models` are those of the two topics, made before the first process is loaded, so that who watches
    from the beginning misses nothing. `scheduler` is that of the wall clock; `epoch` is the date of time 0 of the
    mission's clock; `seed` is that of its random numbers; `session` distinguishes this engine's batches from those of
    an earlier one of the same robot. Each process that the robot loads has an `observer`; `begin` says which of them
    runs.
    """

    def __init__(
        self,
        publisher: Publisher,
        models: Publisher,
        scheduler: Scheduler,
        *,
        session: int,
        epoch: datetime = EPOCH,
        seed: int = 0,
        log: FeedLog | None = None,
    ) -> None:
        self._publisher, self._models, self._log = publisher, models, log
        self._scheduler, self._session, self._epoch = scheduler, session, date_text(epoch)
        self._seed = seed
        self._current: ProcessFeed | None = None
        self._loaded: WeakSet[ProcessFeed] = WeakSet()  # until their process is gone: one may wait while another begins
        self._subscribers = self._batch = 0
        self._changes: list[tuple[str, int, Mapping[str, Any]]] = []  # channel, time, content
        self._begins = False  # whether the next batch is the first one of a process, from its first step on
        self._key_due = 0  # when everything is sent again; 0: with the next batch
        self._sent = -_PERIOD
        self._next: Entry | None = None
        self._poll: Entry = scheduler.after(_POLL, self._count_subscribers)

    @property
    def watched(self) -> bool:
        """Whether there is a subscriber or a log."""
        return self._subscribers > 0 or self._log is not None

    def observer(self) -> ProcessFeed:
        """Return the observer of a process that is being loaded."""
        feed = ProcessFeed(self)
        self._loaded.add(feed)
        return feed

    def begin(self, node: RobotNode, *, resumed: bool = False) -> None:
        """From now on this process, which has one of the observers, is what the robot runs.

        One that is not `resumed` begins with its first step. What is left of the process before is sent first: how it
        ended.
        """
        if self._current is not None:
            self._current.flush()
            self._send_rest()
        self._current = next(feed for feed in self._loaded if feed.node is node)
        self._changes.clear()
        self._subscribers = self._publisher.subscriber_count()
        self._begins = self.watched and not resumed
        self._key_due = self._scheduler.now + _KEY_PERIOD if self._begins else 0
        self._current.resume(active=self.watched)
        self._send_soon()
        model = _model_data(node, self._epoch, self._seed)
        self._models.publish(messages.create(STRING, json_bytes(model).decode()))
        if self._log is not None:
            self._log.on_model(model)

    def is_current(self, observer: ProcessFeed) -> bool:
        """Return whether the robot runs its process."""
        return observer is self._current

    def put(self, time: int, topic: str, data: Mapping[str, Any]) -> None:
        """Send a change with the next batch."""
        self._changes.append((topic.rpartition("/")[2], time, data))
        self._send_soon()

    def _count_subscribers(self) -> None:
        """Check whether there are subscribers, and new ones."""
        self._poll = self._scheduler.after(_POLL, self._count_subscribers)
        before, self._subscribers = self._subscribers, self._publisher.subscriber_count()
        if self._current is None or (self._subscribers == before == 0 and self._log is None):
            return
        self._current.resume(active=self.watched)
        if not self.watched:
            self._changes.clear()
            self._batch += 1  # who comes back has missed something, and sees it by the number
        elif self._subscribers > before or self._scheduler.now >= self._key_due:
            self._key_due = 0
            self._current.look()  # who publishes may have changed, if nothing else
            self._send_soon()
        elif self._current.awaits_server:
            self._current.look()  # it falls silent and leaves without any step of the mission

    def _send_soon(self) -> None:
        if self._next is None and self.watched:
            self._next = self._scheduler.at(max(self._scheduler.now, self._sent + _PERIOD), self._send)

    def _send(self) -> None:
        self._next = None
        if self._current is None or self._current.node is None or not self.watched:
            return
        self._sent, node = self._scheduler.now, self._current.node
        more: dict[str, Any] = {}
        if self._begins:
            more, self._begins = {"begins": node.mission.process.id}, False
        elif not self._key_due:  # everything as of the last flush has all changes in it
            more, self._key_due = {"key": self._current.state.to_key()}, self._sent + _KEY_PERIOD
        self._batch += 1
        changes, self._changes = self._changes, []
        batch = {
            "protocol": PROTOCOL,
            "robot": node.name,
            "session": self._session,
            "batch": self._batch,
            "epoch": self._epoch,
            "time": node.scheduler.now,
            **more,
            "changes": changes,
        }
        if self._subscribers:
            self._publisher.publish(messages.create(STRING, json_bytes(batch).decode()))
        if self._log is not None:
            self._log.on_batch(batch)

    def _send_rest(self) -> None:
        """Send the changes that are known since the last batch."""
        if self._changes:
            if self._next is not None:
                self._next.cancel()
            self._send()

    def close(self) -> None:
        """Publish the remaining changes, and stop."""
        self._send_rest()
        self._poll.cancel()
        if self._next is not None:
            self._next.cancel()
        self._current = None


class ProcessFeed(Observer):
    """The observer of one process of the robot, and its `state`: without subscribers, of events alone."""

    node: RobotNode | None

    def __init__(self, feed: LiveFeed) -> None:
        self._feed = feed
        self.node = None
        self._tracker: ChangeTracker | None = None
        self.state: RobotState = RobotState()
        self._dirty = False

    def watch(self, node: RobotNode) -> Callable[[], object]:
        """Follow this process from its first step on."""
        self.node, self._tracker = node, ChangeTracker(node, self._take, [*node.mission.files])
        self.state = self._tracker.begin()
        self._tracker.active = False
        return self._mark

    def __call__(self, event: Event) -> None:
        assert self._tracker is not None
        self._tracker.event(event)
        self._mark()

    def trail(self, time: int, robot: str, trail: Trail) -> None:
        """Collect the events of one instant."""
        assert self._tracker is not None
        self._tracker.trail(trail)
        self._mark()

    def resume(self, *, active: bool) -> None:
        """Start or stop looking for changes."""
        assert self._tracker is not None
        if active and not self._tracker.active:
            self._tracker.give_events(0)
            self._tracker.active = True
            self._mark()
        self._tracker.active = active

    def _take(self, time: int, topic: str, data: Mapping[str, Any]) -> None:
        assert self._tracker is not None
        self.state.apply(topic, data, time)
        if self._tracker.active:
            self._feed.put(time, topic, data)

    @property
    def awaits_server(self) -> bool:
        """Whether a token waits for a service or an action."""
        return self.node is not None and self.node.host.runner.awaits_server

    def look(self) -> None:
        """Look for changes at the end of this instant."""
        self._mark()

    def _mark(self) -> None:
        """Look for changes at the end of the current instant."""
        if self._dirty or self.node is None or self._tracker is None or not self._tracker.active:
            return
        self._dirty = True
        self.node.scheduler.soon(self.flush, Kind.WORLD)

    def flush(self) -> None:
        """Look for changes now, if anything has happened."""
        if not self._dirty:
            return
        self._dirty = False
        if self.node is not None and self._tracker is not None and self._feed.is_current(self):
            try:
                self._tracker.flush(self.node.scheduler.now)
            except Exception as error:  # what cannot be shown still runs
                self._tracker.active = False  # until the feed looks again for subscribers
                self.node.host.report("", f"changes cannot be published: {type(error).__name__}: {error}")


class ElementFeed(Observer):
    """An observer that publishes every step on ``/fame_dt``, as the viewer of the original FaMe's modeler shows it.

    Each std_msgs/msg/String is ``element/status/instance``: the id of the element; ``enter``, ``leave``, ``take``,
    ``cancel`` or ``fail``; robot and number of the instance (``REX-1``).
    """

    def __init__(self, node: Node) -> None:
        self._publisher = node.publisher(ELEMENT_TOPIC, STRING)

    def __call__(self, event: Event) -> None:
        if event.what in COUNTED:
            text = f"{event.element}/{event.what}/{event.robot}-{event.instance}"
            self._publisher.publish(messages.create(STRING, text))


def distinct_names(paths: Iterable[str]) -> list[str]:
    """Return the name of each file, with a number where an earlier one has the same name."""
    names: dict[str, None] = {}
    for path in map(PurePath, paths):
        numbered = (f"{path.stem}-{number}{path.suffix}" for number in count(2))
        names[next(name for name in chain((path.name or "model.bpmn",), numbered) if name not in names)] = None
    return [*names]


def _model_data(node: RobotNode, epoch: str, seed: int) -> Mapping[str, Any]:
    """The content of ``bpmn_model``: the running process, its file and those of all processes that it calls."""
    files = node.mission.files
    return {
        "protocol": PROTOCOL,
        "robot": node.name,
        "process": node.mission.process.id,
        "epoch": epoch,
        "seed": seed,
        "models": [
            {"name": name, "xml": home.source.decode("utf-8", "replace")}
            for name, home in zip(distinct_names(files), files.values(), strict=True)
        ],
    }
