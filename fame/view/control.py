"""Control of a simulated run from a page: pause, step, breakpoints, speed, tasks, signals, variables, faults.

The run itself carries out the commands of the page, between two steps of its scheduler: a `Pace` is called instead of
the scheduler's `run`, and lets simulated time follow the wall clock at some speed.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from typing import Any, TypeVar

from fame.clock import SECOND
from fame.errors import FameError, MessageError
from fame.middleware import messages
from fame.middleware.interface import Publisher, resolve
from fame.robot import RobotNode
from fame.scenario import Fault
from fame.scenario.run import Run
from fame.text import read_json, suggestion
from fame.view.steering import MANUAL, TWIST, twist_of

COMMANDS = (
    "pause", "resume", "step", "speed", "breakpoint", "run_to", "complete", "retry", "skip", "move", "signal", "set",
    "fault", "take_over", "steer", "suspend", "continue", "restart", "fail", "note",
)  # fmt: skip
AT_ONCE = 0.0
"""The speed of a run that does not follow the wall clock."""
_SLICE = 0.02
"""Seconds on the wall clock after which a run looks for commands."""
_BUSY = SECOND // 5
"""Simulated ns after which a run that does not follow the wall clock looks for them."""
_PATIENCE = 10.0
"""Seconds on the wall clock that a page waits for the run."""

_Command = Mapping[str, Any]
_Result = TypeVar("_Result")


def speed_of(given: Any) -> float:
    """Give the speed that a command asks for, in simulated s a second. Raises FameError."""
    with suppress(TypeError, ValueError, OverflowError):
        if not isinstance(given, bool) and 0 <= (speed := float(given)) <= 1e6:
            return speed
    raise FameError(f"expected a speed from 0 (at once) to 1e6, got {given!r:.60}")


class RunControl:
    """A `fame.scenario.run.Pace` that carries out the commands of pages. Commands come from any thread.

    pause_at     pause at this time (ns), which is reached as fast as possible, without commands; None once it is
    breakpoints  numbers of elements: the run pauses when a token comes to one
    goal         the same, once; None without one
    """

    speed: float
    over: bool
    paused: bool
    stopped: str
    pause_at: int | None

    def __init__(self, *, speed: float = 1.0, pause_at: int | None = None) -> None:
        self.speed, self.paused = speed, False
        self.breakpoints: set[int] = set()
        self.goal: int | None = None
        self.stopped = ""
        self.over = False
        self.pause_at = pause_at
        self._stepping = False
        self._commands: list[tuple[Callable[[Run], Any], Future[Any]]] = []
        self._changed = threading.Condition()
        self._origin: tuple[float, int] | None = None
        self._run: Run | None = None
        self._publishers: dict[str, Publisher] = {}  # of people, by topic

    # ---- the run -----------------------------------------------------------------------------------------------------

    def advance(self, run: Run, until: int) -> None:
        """Continue the run as far as allowed, and carry out commands."""
        self._run = run
        self._carry_out(run)
        now = run.scheduler.now
        if self.paused and not self._stepping:
            self._origin = None
            with self._changed:
                if not self._commands:
                    self._changed.wait(_SLICE * 5)
        elif self.pause_at is not None:
            self._run_to_pause(run, until)
        elif self._stepping:
            self._step(run, until)
        elif self.speed == AT_ONCE:
            run.scheduler.run(min(until, now + _BUSY))
        else:
            self._follow_the_wall(run, until)

    def _run_to_pause(self, run: Run, until: int) -> None:
        assert self.pause_at is not None
        run.scheduler.run(min(until, self.pause_at, run.scheduler.now + _BUSY))
        if run.scheduler.now >= self.pause_at:
            self.pause_at = None
            self.pause(f"Stopped at {run.scheduler.now / SECOND:g} s: continue from here.")

    def _step(self, run: Run, until: int) -> None:
        """Go on to the next instant; `on_events` ends the step when a token has moved."""
        due = run.scheduler.next_time()
        run.scheduler.run(until if due is None else min(until, due))

    def _follow_the_wall(self, run: Run, until: int) -> None:
        wall, now = time.monotonic(), run.scheduler.now
        if self._origin is None:
            self._origin = wall, now
        target = self._origin[1] + round((wall - self._origin[0]) * self.speed * SECOND)
        if target > now + SECOND * max(self.speed, 1.0):  # the machine is too slow: do not catch up
            self._origin, target = (wall, now), now + round(_SLICE * self.speed * SECOND)
        run.scheduler.run(max(now, min(until, target)))
        with self._changed:
            if not self._commands:
                self._changed.wait(_SLICE)

    def finish(self) -> None:
        """Refuse further commands: the run has ended."""
        self.over = True
        with self._changed:
            waiting, self._commands = self._commands, []
        for _, future in waiting:
            if future.set_running_or_notify_cancel():
                future.set_exception(FameError("the run is over"))

    # ---- what the run says -------------------------------------------------------------------------------------------

    def on_events(self, entered: set[int], moved: bool) -> None:
        """Tokens came to elements (by number), or moved in another way: a step ends, a breakpoint may be reached."""
        reached = self.goal in entered
        if self._stepping and moved:
            self._stepping = False
        if (reached or entered & self.breakpoints) and self.pause_at is None:
            self.pause("A token has come there." if reached else "Breakpoint reached.")
            self.goal = None if reached else self.goal
            if self._run is not None:
                self._run.scheduler.stop()

    def pause(self, why: str = "") -> None:
        """Stop simulated time."""
        self.paused, self.stopped = True, why

    # ---- what pages ask ----------------------------------------------------------------------------------------------

    def ask(self, command: _Command) -> str:
        """Carry out a command; gives what was done, in words. Raises FameError."""
        if command.get("do") not in COMMANDS:
            raise FameError(f"unknown command {command.get('do')!r}; commands are: {', '.join(COMMANDS)}")
        if (reached := self.pause_at) is not None and not self.over:
            raise FameError(f"the run is being repeated: it takes commands from {reached / SECOND:g} s on")
        return self.call(partial(_carried_out, self, command))

    def call(self, action: Callable[[Run], _Result]) -> _Result:
        """Do something in the thread of the run, between two steps. Raises FameError, also if the run is over, or does
        not answer in time; then it is not done later."""
        future: Future[_Result] = Future()
        with self._changed:
            if self.over:
                raise FameError("the run is over")
            self._commands.append((action, future))
            self._changed.notify()
        try:
            return future.result(timeout=_PATIENCE)
        except TimeoutError:
            done = "nothing is done" if future.cancel() else "what was asked for is being done"
            raise FameError(f"the run has not answered within 10 s ({done}): a script may be running") from None

    def _carry_out(self, run: Run) -> None:
        with self._changed:
            waiting, self._commands = self._commands, []
        for action, future in waiting:
            if not future.set_running_or_notify_cancel():
                continue
            try:
                answer = action(run)
            except Exception as error:  # whatever is wrong with a command, the run goes on
                future.set_exception(error)
            else:
                run.scheduler.run(run.scheduler.now)  # what follows at this instant, also while time stands still
                future.set_result(answer)

    def _do_pause(self, run: Run, command: _Command) -> str:
        self.paused, self.stopped = True, ""
        return ""

    def _do_resume(self, run: Run, command: _Command) -> str:
        self.paused = self._stepping = False
        self.stopped, self._origin = "", None
        return ""

    def _do_step(self, run: Run, command: _Command) -> str:
        self.paused, self._stepping, self.stopped = True, True, ""
        return ""

    def _do_speed(self, run: Run, command: _Command) -> str:
        self.speed, self._origin = speed_of(command["speed"]), None
        return ""

    def _do_breakpoint(self, run: Run, command: _Command) -> str:
        number = int(command["element"])
        if command["on"]:
            self.breakpoints.add(number)
        else:
            self.breakpoints.discard(number)
        return ""

    def _do_run_to(self, run: Run, command: _Command) -> str:
        self.goal = int(command["element"])
        return self._do_resume(run, command)

    def _do_take_over(self, run: Run, command: _Command) -> str:
        node = _node(run, command["robot"])
        begins = not node.suspension.holder
        node.suspension.take_over(_who(command), str(command["lease"]))
        if begins:
            self.speed, self._origin = 1.0, None  # a person steers by the wall clock
        return f"{node.name} is taken over."

    def _do_steer(self, run: Run, command: _Command) -> str:
        node = _node(run, command["robot"])
        node.suspension.check_steers(_who(command), str(command["lease"]))
        self._publisher(run, resolve(MANUAL, node.namespace), TWIST).publish(twist_of(command))
        return ""

    def _publisher(self, run: Run, topic: str, type: str) -> Publisher:
        if topic not in self._publishers:
            self._publishers[topic] = run.middleware.node("outside").publisher(topic, type)
        return self._publishers[topic]

    def _do_signal(self, run: Run, command: _Command) -> str:
        topic = str(command["topic"])
        node = _node(run, command["robot"]) if topic.startswith("~") else run.nodes[0]
        full, known = resolve(topic, node.namespace), run.middleware.topics
        if full not in known:
            raise FameError(f"no process uses the topic {full}; {suggestion(full, sorted(known))}")
        text = str(command.get("value", "")).strip()
        message = messages.create(known[full].type, _json(text) if text else None)
        self._publisher(run, full, known[full].type).publish(message)
        return f"{full} is sent."

    def _do_set(self, run: Run, command: _Command) -> str:
        node, name, value = _node(run, command["robot"]), str(command["name"]), _json(str(command["value"]))
        if not name.isidentifier():
            raise FameError(f"expected the name of a variable, got {name!r}")
        new = node.set_variables({name: value}, who=_who(command))
        return f"{name} is set; it was not a variable before." if new else f"{name} is set."

    def _do_complete(self, run: Run, command: _Command) -> str:
        node, element, values = _node(run, command["robot"]), str(command["element"]), _values(command)
        without = node.left_out(element, values)
        goes_on = node.complete(element, values)
        node.note("", f"completed by {_who(command)}: {element}")
        more = (without, "" if goes_on else "it goes on when what suspends it ends")
        return "; ".join([f"{element} is completed", *filter(None, more)]) + "."

    def _do_fault(self, run: Run, command: _Command) -> str:
        robot, kind = _node(run, command["robot"]).name, str(command["kind"])
        run.inject(Fault(robot, run.scheduler.now / SECOND, kind))
        return f"{kind} of {robot} is broken."


_Act = Callable[[RobotNode, _Command, str], object]
"""What a person (the text) asks of a robot."""


_ACTS: Mapping[str, tuple[_Act, str]] = {
    "retry": (lambda node, of, who: node.retry(str(of["element"]), _values(of), who=who), "{element} is tried again."),
    "skip": (lambda node, of, who: node.skip(str(of["element"]), who=who), "{element} is skipped."),
    "move": (lambda node, of, who: node.move(str(of["element"]), str(of["to"]), who=who), "The token goes on at {to}."),
    "suspend": (lambda node, of, who: node.suspension.suspend(who), "The mission of {robot} is suspended."),
    "continue": (
        lambda node, of, who: node.suspension.go_on(who, str(of.get("lease", ""))), "The mission of {robot} continues."
    ),
    "restart": (lambda node, of, who: node.restart(str(of["element"]), who=who), "{element} begins again."),
    "fail": (
        lambda node, of, who: node.fail(str(of["element"]), str(of.get("lease", "")), who=who), "{element} has failed."
    ),
    "note": (lambda node, of, who: node.note(str(of.get("element", "")), f"{of['text']} by {who}"), ""),
}  # fmt: skip
"""What a command makes the node of a robot do, and what the page says of it afterwards."""


def _carried_out(control: RunControl, command: _Command, run: Run) -> str:
    """Carry out a command of a page; gives what was done, in words. Raises FameError."""
    try:
        if command["do"] not in _ACTS:
            return str(getattr(control, f"_do_{command['do']}")(run, command))
        act, said = _ACTS[command["do"]]
        act(_node(run, command["robot"]), command, _who(command))
        return said.format_map(command)
    except FameError:
        raise
    except Exception:
        text = f"expected the parts of the command {command['do']!r}, got {dict(command)!r}"
        raise FameError(text) from None


def faults_of(run: Run) -> list[tuple[str, str]]:
    """Return the faults that can be injected: robot and kind."""
    return [(node.name, kind) for node in run.nodes for kind in run.fault_kinds(node.name)]


def can_be_steered(run: Run, robot: str) -> bool:
    """Return whether a simulated robot drives or flies by velocity commands."""
    body = run.world.robots.get(robot) if run.world is not None else None
    return body is not None and any(command.topic == "cmd_vel" for command in body.SAFE_STATE)


def _node(run: Run, robot: str) -> RobotNode:
    found = next((node for node in run.nodes if node.name == robot), None)
    if found is None or robot in run.dead:
        known = ", ".join(node.name for node in run.nodes if node.name not in run.dead)
        raise FameError(f"unknown robot {robot!r}; robots are: {known}")
    return found


def _who(command: _Command) -> str:
    return str(command.get("who") or "a person")


def _values(command: _Command) -> dict[str, Any]:
    """The variables that a command sets. Raises FameError."""
    values = _json(command.get("value", "") or "{}")
    if not isinstance(values, dict):
        raise FameError('expected results as a JSON object, as {"approved": true}')
    return values


def _json(text: str) -> Any:
    try:
        return read_json(text)
    except ValueError as error:
        raise MessageError(f"expected a value as JSON, got {text!r}: {error}") from None
