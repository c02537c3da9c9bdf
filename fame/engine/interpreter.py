"""The interpreter: stimuli, and the loop that moves tokens.

A stimulus (`start`, `deliver`, `timer_fired` ...) changes the state and then processes the ready queue until it is
empty: `run` is the loop; everything else is done by the step functions of the nodes. The invariants between two stimuli
are in `engine_state`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import repeat
from operator import attrgetter
from typing import Any

from fame.engine import adhoc, faults, gateways, handlers, repair, scopes, starts, state, steps, tasks, waiting
from fame.engine.engine_state import EngineState
from fame.engine.host import Host
from fame.engine.program import USER, Node, Program
from fame.engine.state import Instance, Listener, Mailbox, Scope, Wait, scopes_of
from fame.engine.waiting import MESSAGE, catch, take
from fame.errors import MissionError

MOVES = 1_000_000
"""Moves of tokens within one stimulus that count as a livelock."""

SUSPENSIONS = 10_000
"""Suspensions by event sub-processes that count as one, too: each is as much work as many moves."""

PORTION = 300
"""Moves after which observers are informed during a long stimulus."""

TRACE = 100_000
"""Upper bound of the moves that are traced to find the elements of a livelock."""


class Engine(EngineState):
    """All instances of one robot's program.

    new_variables  gives the dict that an instance, or a call with variables of its own, starts with
    moves          bound of the moves within one stimulus
    """

    starts_no_more: bool
    limit: int
    portion: int
    suspensions: int

    def __init__(
        self, program: Program, host: Host, new_variables: Callable[[], dict[str, Any]] = dict, *, moves: int = MOVES
    ) -> None:
        super().__init__(program, host, new_variables)
        self.limit, self.portion = moves, min(PORTION, moves)

    # ---- stimuli -------------------------------------------------------------------------------------

    def begin(self, variables: dict[str, Any] | None = None) -> None:
        """Arm the timers of start events, and start at the none start event. To be called once, after loading.

        Raises MissionError for a timer without a valid time.
        """
        self.arm_starts()
        if self.program.begin is not None:
            self.start(variables)

    def arm_starts(self) -> None:
        """Arm the timers of start events that are not armed. Raises MissionError for a timer without a valid time."""
        armed = set(self.armed_starts.values())
        for node in self.program.timed:
            if node in armed:
                continue
            key = self.new_key()
            self.armed_starts[key] = node
            catch = node.catch
            assert catch is not None
            try:
                self.host.set_timer(key, catch.timer, str(catch.value(self.new_variables())))
            except Exception as error:
                raise MissionError(str(error), element=node.id, file=node.file, line=node.line) from error

    def start(self, variables: dict[str, Any] | None = None) -> Instance:
        """Start an instance at the none start event. Raises MissionError if the process has none."""
        if self.program.begin is None:
            text = "has no none start event; it starts only by its events"
            raise MissionError(text, element=self.program.process)
        instance = starts.open_instance(self, self.program.begin, variables)
        self.run()
        return instance

    def deliver(self, topic: str, message: Any) -> None:
        """Deliver a signal or message from outside; cheap if nothing waits for it."""
        if topic in self.listeners or topic in self.program.starts or topic in self.program.messages:
            deliver(self, topic, message)
            self.run()

    def post(self, topic: str, message: Any) -> None:
        """Queue a message that a script has published: own catchers receive it before the script's token continues."""
        self.ready.append((None, (topic, message)))
        self.unsettled = True

    def stepped(self) -> None:
        """Go on after a step of a script: variables may have changed, messages may have been published."""
        if self.conditions:
            waiting.check_conditions(self)
        self.run()

    def timer_fired(self, key: int, last: bool = True) -> None:
        """Fire a timer that is due. `last`: it does not fire again."""
        start = self.armed_starts.get(key)
        if start is not None:
            if last:
                del self.armed_starts[key]
            starts.trigger(self, start, None)
        elif key in self.waits:
            waiting.fire(self, self.waits.pop(key) if last else self.waits[key])
        self.run()

    def timed(self, key: int) -> Node:
        """Return the node that a timer is set for."""
        start = self.armed_starts.get(key)
        return start if start is not None else self.waits[key].node

    def script_ended(self, key: int, error: BaseException | None = None) -> None:
        """Go on after a suspended script has ended: completed, failed, or cancelled."""
        continuation = self.cancelling.pop(key, None)
        if continuation is not None:
            scope = continuation.scope
            scope.cancelling = tuple(other for other in scope.cancelling if other != key)
            continuation.pending -= 1
            if continuation.pending == 0:
                self.ready.append((continuation.node, scope))
        elif key in self.waits and not self.waits[key].paused:  # a paused script was cancelled and starts again
            tasks.script_ended(self, self.waits[key], error)
        self.run()

    def complete_task(self, element: str, values: dict[str, Any] | None = None) -> bool:
        """Complete a user, manual or receive task. Returns whether its token goes on at once, not after a suspension.

        Raises MissionError if none waits there.
        """
        for wait in self._tasks_at(element):
            for name, value in (values or {}).items():
                wait.scope.variables[name] = value
            waiting.fire(self, wait)
            goes_on = not wait.due
            self.stepped()
            return goes_on
        waiting_now = [wait for item in self.instances.values() for wait in item.waits()]
        if any(wait.node.id == element and wait.due for wait in waiting_now):
            raise MissionError("has been completed; it goes on when what suspends it ends", element=element)
        waits = sorted({wait.node.id for wait in waiting_now if not wait.due})
        raise MissionError(f"is not waiting; currently waiting: {', '.join(waits) or 'nothing'}", element=element)

    def _tasks_at(self, element: str) -> Iterator[Wait]:
        for candidate in self.instances.values():
            for wait in candidate.waits():
                if wait.node.id == element and wait.catch.trigger in (USER, waiting.MESSAGE) and not wait.due:
                    yield wait

    def others_at(self, element: str, act: str) -> int:
        """Return how many tokens a request (``complete``, ``retry`` or another) could mean besides the first."""
        if act == "complete":
            return max(0, sum(1 for _ in self._tasks_at(element)) - 1)
        if act == "retry":
            return max(0, sum(wait.node.id == element for wait in self.incidents) - 1)
        return repair.others_at(self, element)

    def activate(self, element: str) -> None:
        """Start an element of an open ad-hoc sub-process (again). Raises MissionError."""
        adhoc.activate(self, element)
        self.run()

    def offers(self) -> list[str]:
        """Return the ids of the elements that `activate` can start now."""
        return adhoc.offers(self)

    def retry(self, element: str, values: dict[str, Any] | None = None) -> None:
        """Set variables, and execute an element at which there is an incident again. Raises MissionError."""
        repair.retry(self, element, values or {})
        self.stepped()

    def keep_script(self, key: int, text: str, code: str) -> None:
        """Cancel a script that waits, and keep its token as an incident."""
        wait = self.waits.get(key)
        if wait is not None and wait.started:
            repair.keep_script(self, wait, text, code)
            self.run()

    def set_variables(self, values: dict[str, Any], instance: int | None = None) -> None:
        """Set variables of the running instances. Raises MissionError if none runs."""
        repair.set_variables(self, values, instance)
        self.stepped()

    def unset(self, names: Iterable[str]) -> list[str]:
        """Return those of some names that no running instance has as a variable."""
        return repair.unset(self, names)

    def move(self, source: str, target: str) -> None:
        """Move a token from one element to another of the same scope. Raises MissionError."""
        repair.move(self, source, target)
        self.run()

    def skip(self, element: str) -> str:
        """Go on behind an element without its results. Returns the id of what comes next. Raises MissionError."""
        following = repair.skip(self, element)
        self.run()
        return following

    def fail(self, element: str, error: BaseException) -> None:
        """Cancel the work of a token, raise an error in its place, and continue what is held. Raises MissionError."""
        faults.fail_token(self, element, error)
        self.release()

    def restart(self) -> None:
        """Continue after `fame.engine.restore`, once: start scripts again, and tokens that wait for them."""
        for wait in sorted(self.waits.values(), key=attrgetter("key")):
            runs = wait.key > self.restored  # it has begun since, or again when what held it ended
            if wait.started and wait.alive and not (wait.paused or runs):
                tasks.restart(self, wait)
        self.continue_restored()

    def continue_restored(self) -> None:
        """Let the tokens go on that waited, in a restored state, for scripts that were being cancelled."""
        for key in [key for key, continuation in self.cancelling.items() if not continuation.pending]:
            continuation = self.cancelling.pop(key)
            self.ready.append((continuation.node, continuation.scope))
        self.run()

    def hold(self, *, safe: bool = True) -> None:
        """Suspend all instances and bring the robot to its `safe` state; no instance starts before `release`."""
        if self.held is None:
            handlers.hold(self, safe=safe)
            self.run()

    def release(self) -> None:
        """Continue after `hold`, whose scripts must have ended."""
        if self.held is not None:
            handlers.release(self)
            starts.begin_kept(self)
        self.run()

    def stop(self) -> None:
        """Cancel all instances. They end at once; their scripts may still be in ``finally``."""
        for key in self.armed_starts:
            self.host.cancel_timer(key)
        self.forget_starts()
        for instance in tuple(self.instances.values()):
            scopes.kill(self, instance.root)
            scopes.conclude(self, instance, "cancelled")
        self.cancelling.clear()
        self.ready.clear()
        self.host.make_safe("terminated")
        self.observe()

    # ---- the loop ------------------------------------------------------------------------------------

    def run(self) -> None:
        """Move every token until it waits."""
        ready = self.ready
        left, portion = self.limit, self.portion
        self.suspensions = 0
        moves = repeat(None, portion)
        self.unsettled: bool = bool(self.conditions)
        while True:
            while ready:
                node, scope = ready.popleft()
                if node is None:
                    deliver(self, *scope)
                    continue
                if scope.state:
                    if scope.state > 0:
                        scope.held += (node,)
                    continue
                counts = scope.counts
                for _ in moves:
                    counts[node.index] += 1
                    step = node.step  # a call of a local name is faster in CPython
                    node = step(self, scope, node)
                    if node is None:
                        break
                else:
                    price = self.limit // SUSPENSIONS
                    left, moves = left - portion - self.suspensions * price, repeat(None, portion)
                    self.suspensions = 0
                    self.observe()
                    if len(ready) > state.TOKENS:
                        faults.abandon_crowd(self, scope.instance, node)
                    elif left > 0:
                        ready.appendleft((node, scope))
                    else:
                        self._fail_livelock(node, scope)
                        left = self.limit
            if len(self.waits) > state.TOKENS and self._fail_newest():
                continue
            if not (self.inclusive and gateways.decide_inclusive(self)):
                break
        self.starts_no_more = False
        if self._trail:
            self.observe()
        if self.settled is not None:
            self.settled()

    def _fail_newest(self) -> bool:
        """Fail the instance of the newest wait. Returns whether that was possible."""
        before, wait = len(self.waits), next(reversed(self.waits.values()))
        faults.abandon_crowd(self, wait.scope.instance, wait.node)
        return len(self.waits) < before

    def _fail_livelock(self, node: Node, scope: Scope) -> None:
        """Trace the tokens of a livelock for a while to find the elements of the loop, then fail the instance.

        Where each instance starts the next one, the newest fails, and no further one starts in this stimulus.
        """
        instance, ready = scope.instance, self.ready
        passes, of_all = dict[str, int](), dict[str, int]()
        ready.appendleft((node, scope))
        for _ in range(min(TRACE, self.limit)):
            if not ready or self.suspensions > SUSPENSIONS // 100:
                break
            follower, place = ready.popleft()
            if follower is None:
                deliver(self, *place)
            elif place.state > 0:
                place.held += (follower,)
            elif not place.state:
                for counts in (of_all, *([passes] if place.instance is instance else ())):
                    if follower.step is not steps.flow:
                        counts[follower.id] = counts.get(follower.id, 0) + 1
                place.counts[follower.index] += 1
                following = follower.step(self, place, follower)
                if following is not None:
                    ready.appendleft((following, place))
        chain = not any(count > 1 for count in passes.values()) and any(count > 1 for count in of_all.values())
        if chain:
            instance, passes = next(reversed(self.instances.values()), instance), of_all
            self.starts_no_more = True
        loop = ", ".join(id for id, count in passes.items() if id and count > 1)
        counting = f" (a suspension counts as {self.limit // SUSPENSIONS})" if self.suspensions else ""
        among = " of instances that start each other" if chain else ""
        text = f"{self.limit} moves without waiting{counting}, in a loop{among} over {loop}"
        if instance.status == "running":
            faults.abandon(self, instance, node, text, "livelock")
        elif chain:
            self.host.report(node.id, text)

    # ---- callbacks -----------------------------------------------------------------------------------

    def check_conditions(self) -> None:
        """Evaluate the armed conditional events, after variables have changed."""
        waiting.check_conditions(self)

    def fail_callback(self, variables: dict[str, Any], element: str, error: BaseException) -> None:
        """Raise the error of a callback that a script of this element registered before its token continued.

        The error propagates from the scope with these variables outwards. Boundary events of the element itself do not
        catch it, since it holds no token. The host runs the engine afterwards, by `stepped`.
        """
        faults.fail_without_token(self, variables, element, error)

    def is_alive(self, variables: dict[str, Any]) -> bool:
        """Return whether these are the variables of a scope that has not ended."""
        scopes = (scope for instance in self.instances.values() for scope in scopes_of(instance.root))
        return any(scope.variables is variables for scope in scopes)


def deliver(engine: EngineState, topic: str, message: Any) -> None:
    """Deliver a message once to each catcher that is armed now, in the order of arming; start events come last."""
    program = engine.program
    listeners: tuple[Any, ...] = tuple(engine.listeners.get(topic, ()))  # waits alone, unless the topic is selective
    if topic in program.selective:
        _select(engine, topic, listeners, message)
        return
    for wait in listeners:
        if wait.alive and not wait.paused:
            catch(engine, wait, message)
    if topic in program.starts:
        for node in program.starts[topic]:
            if not starts.is_awaited(node, listeners):
                starts.trigger(engine, node, message)


def _select(engine: EngineState, topic: str, listeners: tuple[Listener, ...], message: Any) -> None:
    """Deliver a message of a topic with BPMN messages or queues.

    A queue keeps a signal only if no token waits at its event. A BPMN message goes only to the first catcher that it
    correlates with, else to one queue, else to a start event (standard 8.3.2).
    """
    taken = heard = False
    boxes: list[Mailbox] = []
    served = set[Mailbox | None]()
    for listener in listeners:
        if isinstance(listener, Mailbox):
            boxes.append(listener)
        elif listener.paused:
            continue
        elif listener.catch.trigger is MESSAGE:
            taken = taken or (listener.alive and take(engine, listener, message))
        else:
            if listener.catch.queue:
                served.add(waiting.mailbox_of(listener))
            if listener.alive:
                catch(engine, listener, message)
                heard = True
    for box in boxes:
        if box.catch.trigger is not MESSAGE and box.alive and box not in served:
            box.messages.append((engine.new_key(), message))
    heard = heard or taken
    taken = taken or waiting.keep(engine, [box for box in boxes if box.catch.trigger is MESSAGE], message)
    for node in engine.program.starts.get(topic, ()):
        if not (
            taken if node.catch is not None and node.catch.trigger is MESSAGE else starts.is_awaited(node, listeners)
        ):
            starts.trigger(engine, node, message)
            heard = True
    if not heard and topic in engine.program.messages:
        engine.untaken[topic] += 1
