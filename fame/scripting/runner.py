"""Run the waiting scripts of one robot from request to request.

A script is a coroutine that yields requests (`fame.scripting.requests`). Each step, from one ``await`` to the next, is
an entry of the scheduler and runs to completion. The runner never calls the engine from inside a call of the engine:
the end of a script is always reported by a separate entry.

Cancellation is raised at the ``await``. A script that awaits during cancellation (``finally: await ...``) is *leaving*:
it continues to run until the grace period is over, then it is closed. Closing also drains its budget, so that even
``while True: try ... except BaseException: continue`` ends at its next iteration.

Invariant: a waiting script has exactly one armed source of wake-ups (and a timeout, if it has one), and waking disarms
both.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.engine.host import BpmnError, Cancelled, is_from_outside
from fame.middleware.actions import ActionClient, Goal
from fame.middleware.interface import Client, Node
from fame.scripting.budget import BUDGET, Budget
from fame.scripting.cancelled_goals import BOUND, CancelledGoals
from fame.scripting.python import error_text
from fame.scripting.requests import (
    MOMENT,
    SERVICE_TIMEOUT,
    STILL_RUNNING,
    Act,
    Call,
    GoalError,
    Inbox,
    Next,
    Receive,
    ScriptRequest,
    Sleep,
    TopicTypes,
    Until,
)

GRACE = 2.0
"""Grace period: how long a cancelled script may take to end (s)."""

_MOST_AWAITS = 100_000
"""Awaits of one script at one moment before it counts as a livelock."""

_MOST_HANDLERS = 100
_POLL = SECOND // 20
"""Interval in which it is checked whether a service or action is available (ns)."""
_AGAIN = (SECOND, 4 * SECOND)
"""Times after which the result of a goal is requested once more whose server was replaced (ns): see `MOMENT`."""
_SILENT = 3 * SECOND
"""Time without feedback or response after which a server is called silent (ns)."""
_APART = SECOND
"""Time after which a server that is there and not connected does not match (ns): before, it may be on the way."""

_Ended = Callable[[int, BaseException | None], object]
_Report = Callable[[int, str], object]


class _Task:
    """A running script. `disarm` removes its source of wake-ups; `due` is its timeout or its next step.

    Of a request to a server: `heard` is when it was sent, or its last feedback came; `gone` since when it has none;
    `goal` is the id of its goal.
    """

    __slots__ = ("awaits", "budget", "cancelling", "disarm", "due", "error", "goal", "gone", "grace", "heard",
                 "instant", "key", "leaving", "names", "request", "running", "script")  # fmt: skip

    def __init__(self, key: int, script: Any) -> None:
        self.key, self.script = key, script
        frame = getattr(script, "cr_frame", None)
        self.names: dict[str, Any] = frame.f_builtins if frame is not None else {}
        self.budget: Budget | None = self.names.get(BUDGET)
        self.request: ScriptRequest | None = None
        self.heard: int | None = None
        self.gone: int | None = None
        self.goal = b""
        self.disarm: Callable[[], object] | None = None
        self.due: Entry | None = None
        self.grace: Entry | None = None
        self.error: BaseException | None = None
        self.running = self.leaving = self.cancelling = False
        self.instant, self.awaits = -1, 0


class Outward(Protocol):
    """Decides when requests of scripts leave the robot (`fame.robot.durable`)."""

    def request(
        self,
        key: int,
        request: Act | Call,
        begin: Callable[[bytes | None], object],
        attach: Callable[[bytes], object] | None,
        lost: Callable[[str], object],
    ) -> None:
        """The script `key` makes a request. Call one of the functions, now or later.

        begin   makes the request; of an action under this goal id (None: a new one)
        attach  of an action: takes up a goal that was sent before
        lost    says that it was made before, and why its fate is unknown
        """

    def repeat(self, key: int, request: Act | Call, begin: Callable[[bytes | None], object]) -> None:
        """The script makes its last request again: call `begin`, now or later."""


class OnLost(Protocol):
    """Decides on a request of a script whose fate is unknown, and why; by its key, else by its element."""

    def __call__(
        self, key: int, element: str, text: str, again: Callable[[], object], fail: Callable[[BaseException], object], /
    ) -> None:
        """Call `again` to make it again, or `fail` to throw an error in the script."""


class Runner:
    """The waiting scripts of one robot.

    ended      (key, error or None): a script is over; never called from inside `start` or `cancel`
    stepped    (key): a script has run a step and waits again, so its variables may have changed
    report     (key, text): an error of a cancelled script that is leaving
    types      type of a topic by its full name, None if unknown

    `outward`, if set, is asked before a request leaves the robot. `on_lost`, if set, decides on requests whose fate is
    unknown; else they are made again. `doubtful` (key, request) says why one may have been made before; empty if it has
    not, or may be made again; of a goal also its id: it is sent again if it has ended as canceled.
    """

    def __init__(
        self,
        scheduler: Scheduler,
        node: Node,
        ended: _Ended,
        *,
        stepped: Callable[[int], object] = lambda key: None,
        report: _Report = lambda key, text: None,
        types: TopicTypes = lambda topic: None,
    ) -> None:
        self._scheduler, self._ended, self._stepped, self._report = scheduler, ended, stepped, report
        self.inbox: Inbox = Inbox(node, types, self.poll)
        self.cancelled: CancelledGoals = CancelledGoals(scheduler, partial(report, 0))
        self.outward: Outward | None = None
        self.on_lost: OnLost | None = None
        self.doubtful: Callable[[int, str], tuple[str, bytes]] = lambda key, request: ("", b"")
        self._tasks: dict[int, _Task] = {}
        self._untils: dict[int, _Task] = {}

    # ---- called by the engine ----------------------------------------------------------------------------------------

    def start(self, key: int, script: Any) -> None:
        """Run a script to its first request."""
        task = self._tasks[key] = _Task(key, script)
        if self._advance(task, script.send, None):
            task.due = self._scheduler.soon(partial(self._end, task), Kind.RESUMPTION)

    def cancel(self, key: int) -> bool:
        """Cancel a script at its ``await``.

        Returns True if it is over (or unknown), False if it is leaving: `ended` is called later.
        """
        task = self._tasks.get(key)
        if task is None:
            return True
        if task.leaving:
            return False
        if isinstance(task.request, Act) and task.gone is not None and task.heard is not None:
            text = (
                f"cancelled while its server was away: {task.request} may still run, until it is cancelled there, too"
            )
            self._report(key, text)
        self._wake(task)
        task.leaving = task.cancelling = True
        if not task.running and (task.request is None or self._advance(task, task.script.throw, self._cancelled(task))):
            self._forget(task)
            return True
        task.grace = self._scheduler.after(round(GRACE * SECOND), partial(self._close, task))
        return False

    def key_of(self, script: Any) -> int:
        """Return the key of a script that runs; 0 for another one."""
        return next((key for key, task in self._tasks.items() if task.script is script), 0)

    def request(self, key: int) -> ScriptRequest | None:
        """Return the request that a script awaits, None for an unknown script."""
        task = self._tasks.get(key)
        return task.request if task is not None else None

    def waits(self, key: int) -> str:
        """Return the request that a script awaits, as text; empty for an unknown script."""
        task = self._tasks.get(key)
        return str(task.request) if task is not None and task.request is not None else ""

    def follows_goal(self, key: int) -> bool:
        """Return whether a script waits for the end of a goal that was sent."""
        task = self._tasks.get(key)
        return task is not None and isinstance(task.request, Act) and task.heard is not None

    def unanswered(self, key: int) -> tuple[str, bytes]:
        """Return the call or goal that a script has made and awaits, as text, and the goal's id; empty without one."""
        task = self._tasks.get(key)
        if task is None or task.heard is None:
            return "", b""
        return str(task.request), task.goal if isinstance(task.request, Act) else b""

    def server_silence(self, key: int) -> tuple[str, int] | None:
        """Return what is to be known of the server of an awaited request, and since when (ns); None if it is at work.

        ``gone``: it has left, or none was there; ``silent``: neither feedback nor response came for some seconds.
        """
        task = self._tasks.get(key)
        if task is None or not isinstance(task.request, Act | Call):
            return None
        if task.gone is not None:
            return "gone", task.gone
        silent = task.heard is not None and self._scheduler.now - task.heard >= _SILENT
        return ("silent", task.heard) if silent and task.heard is not None else None

    def server_mismatch(self, key: int) -> str:
        """Return why the server of an awaited request, which has been out of reach for a while, is
        not connected, as text."""
        task = self._tasks.get(key)
        request = task.request if task is not None else None
        if task is None or task.gone is None or self._scheduler.now - task.gone < _APART:
            return ""
        if isinstance(request, Act):
            return self.inbox.action(request.action, request.type).mismatch
        return self.inbox.client(request.service, request.type).mismatch if isinstance(request, Call) else ""

    def awaited_topic(self, key: int) -> str | None:
        """Return the topic that a script awaits with `receive`, None if it awaits something else."""
        task = self._tasks.get(key)
        return task.request.topic if task is not None and isinstance(task.request, Receive) else None

    @property
    def at_work(self) -> bool:
        """Whether any script is running, waiting or leaving."""
        return bool(self._tasks)

    @property
    def awaits_server(self) -> bool:
        """Whether any script awaits a service or an action."""
        return any(isinstance(task.request, Act | Call) for task in self._tasks.values())

    def poll(self) -> None:
        """Evaluate the conditions awaited by `until`, in the order of arming, since something may have changed."""
        if self._untils:
            for task in tuple(self._untils.values()):
                if task.key in self._untils:
                    self._try_condition(task)

    def close(self) -> None:
        """Close all scripts without a grace period and without calling `ended`, and all subscriptions."""
        for task in tuple(self._tasks.values()):
            if task.running:
                self.cancel(task.key)  # this script is closing the runner: it ends at its next await
                continue
            self._wake(task)
            task.leaving = True
            self._kill(task)
            self._forget(task)
        self.cancelled.close()
        self.inbox.close()

    # ---- one step of a script ----------------------------------------------------------------------------------------

    def _advance(self, task: _Task, step: Callable[[Any], Any], value: Any) -> bool:
        """Run a script to its next request and arm that. Returns True if the script is over, with `task.error`."""
        if task.budget is not None:
            task.budget.refill(task.names)
        while True:
            task.request, task.running = None, True
            try:
                request = step(value)
            except StopIteration:
                return True
            except BaseException as error:
                if isinstance(error, KeyboardInterrupt) and not task.leaving and is_from_outside(error):
                    raise
                task.error = error
                return True
            finally:
                task.running = False
            step = task.script.throw
            if task.cancelling:
                value = self._cancelled(task)
                continue
            try:
                self._arm(task, request)
            except Exception as error:
                value = error
                continue
            return False

    def _resume(self, task: _Task, step: Callable[[Any], Any], value: Any) -> None:
        """Resume a script whose request is fulfilled; an entry of the scheduler."""
        self._wake(task)
        if self._scheduler.now != task.instant:
            task.instant, task.awaits = self._scheduler.now, 0
        task.awaits += 1
        if task.awaits > _MOST_AWAITS:
            text = f"awaited {_MOST_AWAITS} times at one moment: {task.request}"
            step, value = task.script.throw, RuntimeError(text)
        if self._advance(task, step, value):
            self._end(task)
        else:
            self._stepped(task.key)
            self.poll()

    def _end(self, task: _Task) -> None:
        left, error = task.leaving, task.error
        self._forget(task)
        self._ended(task.key, None if left else error)
        self.poll()

    def _forget(self, task: _Task) -> None:
        """Remove a script that is over."""
        del self._tasks[task.key]
        if task.grace is not None:
            task.grace.cancel()
        if task.leaving and task.error is not None and not isinstance(task.error, Cancelled):
            self._report(task.key, f"while it was cancelled: {error_text(task.error)}")

    def _cancelled(self, task: _Task) -> Cancelled:
        task.cancelling = False
        return Cancelled()

    def _close(self, task: _Task) -> None:
        """Close a script whose grace period is over."""
        self._wake(task)
        self._report(task.key, f"cancelled, but still running after {GRACE:g} s: closed at {task.request}")
        self._kill(task)
        self._end(task)

    def _kill(self, task: _Task) -> None:
        """End the coroutine. Each attempt gets past one handler that catches it; the drained budget ends loops."""
        if task.budget is not None:
            task.budget.drain(task.names)
        for _ in range(_MOST_HANDLERS):
            try:
                task.script.throw(
                    GeneratorExit()
                )  # not close(): that of 3.13.0 loses errors of a script without handlers
            except BaseException:
                break
        if task.budget is not None:
            task.budget.refill(task.names)

    # ---- waiting -----------------------------------------------------------------------------------------------------

    def _arm(self, task: _Task, request: Any) -> None:
        """Arm the source of wake-ups. Raises the error of an invalid request."""
        arm = _ARM.get(type(request))
        if arm is None:
            raise TypeError(f"cannot await {type(request).__name__}: only sleep, receive, until, robot.call, robot.act "
                            "and messages of robot.subscribe can be awaited")  # fmt: skip
        task.request, task.heard, task.gone, task.goal = request, None, None, b""
        arm(self, task, request)

    def _wake(self, task: _Task) -> None:
        """Disarm the source of wake-ups and the timeout."""
        if task.disarm is not None:
            task.disarm()
        if task.due is not None:
            task.due.cancel()
        task.disarm = task.due = None

    def _soon(self, task: _Task, step: Callable[[Any], Any], value: Any) -> None:
        self._wake(task)
        task.due = self._scheduler.soon(partial(self._resume, task, step, value), Kind.RESUMPTION)

    def _limit(self, task: _Task, timeout: float | None) -> None:
        if timeout is not None:
            late = TimeoutError(f"{task.request}: nothing within {timeout:g} s")
            task.due = self._scheduler.after(
                round(timeout * SECOND), partial(self._resume, task, task.script.throw, late), Kind.RESUMPTION
            )

    def _sleep(self, task: _Task, request: Sleep) -> None:
        resume = partial(self._resume, task, task.script.send, None)
        task.due = self._scheduler.after(round(request.seconds * SECOND), resume, Kind.RESUMPTION)

    def _receive(self, task: _Task, request: Receive) -> None:
        listener = self.inbox.listen(request.topic, request.type)
        wake = partial(self._soon, task, task.script.send)
        listener.waiting[wake] = None
        task.disarm = lambda: listener.waiting.pop(wake, None)
        self._limit(task, request.timeout)

    def _next(self, task: _Task, request: Next) -> None:
        queue = request.queue

        def wake() -> None:
            if queue.messages:
                self._soon(task, task.script.send, queue.messages.popleft())

        queue.waiting[wake] = None
        task.disarm = lambda: queue.waiting.pop(wake, None)
        wake()

    def _until(self, task: _Task, request: Until) -> None:
        self._untils[task.key] = task
        task.disarm = lambda: self._untils.pop(task.key, None)
        self._limit(task, request.timeout)
        self._try_condition(task)

    def _try_condition(self, task: _Task) -> None:
        request = task.request
        assert isinstance(request, Until)
        try:
            value = request.condition()
            if value:
                self._soon(task, task.script.send, value)
        except BaseException as error:
            self._soon(task, task.script.throw, error)

    def _call(self, task: _Task, request: Call) -> None:
        client = self.inbox.client(request.service, request.type)

        def on_response(response: Any) -> None:
            if task.request is request:
                self._soon(task, task.script.send, response)

        def lost() -> None:
            if task.request is request:
                self._lose(task, client, begin, "its server left before it answered")

        def begin(id: bytes | None) -> None:
            client.call(request.fields, on_response, lost)
            self._hear(task)

        if doubt := self.doubtful(task.key, str(request))[0]:
            self._lose(task, client, begin, doubt)
        else:
            self._when_available(task, client, lambda: self._send(task, client, begin))

    def _act(self, task: _Task, request: Act) -> None:
        client = self.inbox.action(request.action, request.type)

        def ended(goal: bytes, outcome: str, result: Any) -> None:
            if outcome == "succeeded":
                self._soon(task, task.script.send, result)
            elif outcome == "gone":
                self._once_more(task, client, partial(attach_again, goal))
            elif outcome == "unknown":
                self.cancelled.take_up({goal.hex(): (client.name, client.type, False)}, lambda *_: client)
                self._stepped(task.key)  # which records it: should the robot crash now, it is cancelled once more
                self._lose(task, client, begin, "its server does not know the goal")
            else:
                self._soon(task, task.script.throw, GoalError(outcome, f"{request}: the goal was {outcome}", result))

        def on_feedback(feedback: Any) -> None:
            self._hear(task)
            if request.feedback is not None:
                request.feedback(feedback)
                self._stepped(task.key)
                self.poll()

        def follow(goal: Goal) -> None:
            task.disarm, task.goal = partial(self.cancelled.cancel, client, goal), goal.id
            self._hear(task)

        def begin(id: bytes | None) -> None:
            from uuid import uuid4

            id = id or uuid4().bytes
            follow(client.send(request.fields, partial(ended, id), on_feedback, id=id))

        def attach(id: bytes) -> None:
            follow(client.attach(id, partial(ended, id), on_feedback))

        def attach_again(id: bytes) -> None:
            goal = client.attach(id, partial(ended, id), on_feedback)
            follow(goal)
            for delay in _AGAIN:
                self._scheduler.after(delay, goal.ask_again, Kind.RESUMPTION)

        def send() -> None:
            self._when_available(task, client, lambda: self._send(task, client, begin, attach))

        alone = partial(self._when_alone, task, client, send, self._scheduler.now + round(request.wait * SECOND))
        doubt, goal = self.doubtful(task.key, str(request))
        if doubt:
            lost = partial(self._lose, task, client, begin, doubt)
            self._when_ended(task, goal, alone, lost, self._scheduler.now + round(BOUND * SECOND))
        else:
            alone()

    def _when_ended(
        self, task: _Task, goal: bytes, canceled: Callable[[], object], lost: Callable[[], object], until: int
    ) -> None:
        """Call one of the functions as soon as a cancelled goal has ended, or at `until` (ns)."""
        outcome = self.cancelled.outcome(goal)
        if outcome is None and self._scheduler.now < until:
            again = partial(self._when_ended, task, goal, canceled, lost, until)
            task.due = self._scheduler.after(_POLL, again, Kind.RESUMPTION)
        else:
            (canceled if outcome in ("canceled", "rejected") else lost)()

    def _when_alone(self, task: _Task, client: ActionClient, send: Callable[[], object], until: int) -> None:
        """Call `send` as soon as no cancelled goal of the action may run; at `until` (ns) that is an error, if the
        request waits for it at all."""
        request = task.request
        assert isinstance(request, Act)
        if not request.wait or client.name not in self.cancelled.actions():
            send()
        elif self._scheduler.now < until:
            again = partial(self._when_alone, task, client, send, until)
            task.due = self._scheduler.after(_POLL, again, Kind.RESUMPTION)
        else:
            text = f"{request}: a cancelled goal has not ended within {request.wait:g} s"
            self._soon(task, task.script.throw, BpmnError(STILL_RUNNING, text))

    def _hear(self, task: _Task) -> None:
        task.heard, task.gone = self._scheduler.now, None

    def _send(
        self,
        task: _Task,
        client: Client | ActionClient,
        begin: Callable[[bytes | None], object],
        attach: Callable[[bytes], object] | None = None,
        *,
        again: bool = False,
    ) -> None:
        """Send a request: now, or when `outward` calls it, unless the script has been cancelled."""
        request = task.request
        assert isinstance(request, Act | Call)
        if self.outward is None:
            begin(None)
            return

        def begin_later(id: bytes | None) -> None:
            if task.request is request:
                try:
                    begin(id)
                except Exception as error:
                    self._soon(task, task.script.throw, error)

        if again:
            self.outward.repeat(task.key, request, begin_later)
        else:
            self.outward.request(task.key, request, begin_later, attach, partial(self._lose, task, client, begin))

    def _lose(
        self, task: _Task, client: Client | ActionClient, begin: Callable[[bytes | None], object], reason: str
    ) -> None:
        """The fate of a request is unknown: make it again, unless `on_lost` decides otherwise."""
        request = task.request

        def again() -> None:
            if task.request is request:
                self._once_more(task, client, lambda: self._send(task, client, begin, again=True))

        def fail(error: BaseException) -> None:
            if task.request is request:
                self._soon(task, task.script.throw, error)

        if self.on_lost is None:
            again()
        else:
            self.on_lost(task.key, "", f"{request}: {reason}, and its fate is unknown", again, fail)

    def _once_more(self, task: _Task, client: Client | ActionClient, begin: Callable[[], object]) -> None:
        """Call `begin` as `_when_available` does, a moment later: the server may have to find this client again."""
        now = self._scheduler.now
        task.gone = now if task.gone is None and not client.available else task.gone
        again = partial(self._when_available, task, client, begin, now + SERVICE_TIMEOUT)
        task.due = self._scheduler.after(MOMENT, again, Kind.RESUMPTION)

    def _when_available(
        self, task: _Task, client: Client | ActionClient, begin: Callable[[], object], until: int = 0
    ) -> None:
        """Call `begin` as soon as the service is available, or after the timeout: then it raises an error."""
        until = until or self._scheduler.now + SERVICE_TIMEOUT
        if not client.available and self._scheduler.now < until:
            if task.gone is None:
                task.gone = self._scheduler.now
            again = partial(self._when_available, task, client, begin, until)
            task.due = self._scheduler.after(_POLL, again, Kind.RESUMPTION)
            return
        try:
            begin()
        except Exception as error:
            self._soon(task, task.script.throw, error)


_ARM: dict[type, Callable[[Runner, _Task, Any], None]] = {
    Sleep: Runner._sleep,
    Receive: Runner._receive,
    Next: Runner._next,
    Until: Runner._until,
    Call: Runner._call,
    Act: Runner._act,
}
