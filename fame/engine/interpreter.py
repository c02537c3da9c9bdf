"""The interpreter: how tokens move.

One first-in-first-out queue `ready` holds (node, scope) for each token that may move, and (None, (topic, message)) for
each message thrown by this robot. A stimulus (`start`, `deliver`, `timer_fired` ...) changes the state and then runs
the queue empty: `run` is the loop, all else hangs on step functions (`fame.engine.steps`).

Invariants between two stimuli:

- `ready` is empty. A scope's `tokens` is the number of its resting tokens, child scopes and arrivals at joins.
- What is dead is in no table: `listeners`, `conditions`, `rests` hold the living alone.
- Whoever cancels (`kill`, `withdraw`) says what goes on afterwards through `proceed`, which waits for scripts that
  are still leaving. Entries of a dead scope are skipped when they come up, never searched for.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from fame.engine import steps
from fame.engine.host import BpmnError, Host
from fame.engine.state import DEAD, Instance, Listener, Mailbox, Node, Program, Rest, Scope
from fame.engine.variables import Variables
from fame.errors import MissionError

MOVES = 10_000_000
"""Moves of tokens within one stimulus, after which it is taken for a livelock."""

DEPTH = 1000
"""How deep calls and sub-processes may nest."""


class Engine:
    """All instances of one robot's program. `observed`: whether the program tells the host what happens."""

    def __init__(
        self, program: Program, host: Host, new_variables: Callable[[], dict[str, Any]] = dict, *, moves: int = MOVES
    ) -> None:
        self.program, self.host, self.new_variables, self.limit = program, host, new_variables, moves
        self.ready: deque[tuple[Node | None, Any]] = deque()
        self.listeners: dict[str, dict[Listener, None]] = {}
        self.conditions: dict[Rest, None] = {}
        self.rests: dict[int, Rest] = {}  # those that the host names by key: timers, scripts
        self.inclusive: dict[Scope, None] = {}  # scopes in which an inclusive join has an arrival
        self.leaving: dict[int, Departure] = {}
        self.departing: list[int] = []
        self.instances: dict[int, Instance] = {}
        self.waiting_starts: dict[Node, deque[Any]] = {}  # triggers that a full process keeps
        self.armed_starts: dict[int, Node] = {}
        self.counter = 0
        self.tell = host.observe

    # ---- stimuli -------------------------------------------------------------------------------------

    def begin(self, variables: dict[str, Any] | None = None) -> None:
        """Once, when the program is loaded: arm the timers of start events, and start at the none start event."""
        for node in self.program.timed:
            key = self.new_key()
            self.armed_starts[key] = node
            self.host.set_timer(key, node.timer, str(node.run(self.new_variables())))
        if self.program.begin is not None:
            self.start(variables)

    def start(self, variables: dict[str, Any] | None = None) -> Instance:
        """Start an instance at the none start event. Raises MissionError if the process has none."""
        if self.program.begin is None:
            text = "has no none start event, so it starts by its events alone"
            raise MissionError(text, element=self.program.process)
        instance = self.open_instance(self.program.begin, variables)
        self.run()
        return instance

    def deliver(self, topic: str, message: Any) -> None:
        """A signal, or a message for this process, came from outside."""
        if topic in self.program.messages:
            self.hand_over(topic, message)
        else:
            self.broadcast(topic, message)
        self.run()

    def post(self, topic: str, message: Any) -> None:
        """A script published: own catchers get it in its turn. `run` follows when the script's step is over."""
        self.ready.append((None, (topic, message)))

    def timer_fired(self, key: int, last: bool = True) -> None:
        """A timer is due; `last`: it will not be again."""
        start = self.armed_starts.get(key)
        if start is not None:
            if last:
                del self.armed_starts[key]
            self.trigger(start, None)
        else:
            rest = self.rests.get(key)
            if rest is not None:
                self.wake(rest, None)
        self.run()

    def script_ended(self, key: int, error: BaseException | None = None) -> None:
        """A suspended script is out: done, failed, or (it was cancelled) gone."""
        departure = self.leaving.pop(key, None)
        if departure is not None:
            departure.scope.leaving.pop(key, None)
            departure.pending -= 1
            if departure.pending == 0:
                self.ready.append((departure.node, departure.scope))
        else:
            rest = self.rests.get(key)
            if rest is not None:
                self.withdraw(rest)
                if error is None:
                    self.complete(rest.scope, rest.node)
                else:
                    self.fail(rest.scope, rest.node, error)
                if self.conditions:
                    self.check_conditions()
        self.run()

    def complete_task(self, element: str, values: dict[str, Any] | None = None, instance: int | None = None) -> None:
        """Somebody did what a user, manual or receive task waits for. Raises MissionError if none waits there."""
        for candidate in self.instances.values():
            if instance not in (None, candidate.key):
                continue
            for rest in candidate.rests():
                if rest.node.id == element and rest.node.kind in ("user", "message"):
                    for name, value in (values or {}).items():
                        rest.scope.variables[name] = value
                    self.wake(rest, None)
                    if self.conditions:
                        self.check_conditions()
                    self.run()
                    return
        waits = sorted({rest.node.id for item in self.instances.values() for rest in item.rests()})
        raise MissionError(f"waits for nobody; what waits: {', '.join(waits) or 'nothing'}", element=element)

    def stop(self) -> None:
        """Cancel all instances. They end at once; their scripts may still be leaving."""
        for key in self.armed_starts:
            self.host.cancel_timer(key)
        self.armed_starts.clear()
        self.waiting_starts.clear()
        for instance in tuple(self.instances.values()):
            self.kill(instance.root)
            self.departing.clear()
            self.conclude(instance, "cancelled")
        self.host.make_safe("terminated")

    # ---- the loop ------------------------------------------------------------------------------------

    def run(self) -> None:
        """Move every token until it rests."""
        ready, moves = self.ready, self.limit
        pop = ready.popleft
        while True:
            while ready:
                node, scope = pop()
                if node is None:
                    self.broadcast(*scope)
                    continue
                if scope.state:
                    if scope.state > 0:
                        scope.held.append(node)
                    continue
                counts = scope.counts
                while node is not None:
                    moves -= 1
                    if moves < 0:
                        self.livelock(node, scope)
                        moves = self.limit
                        break
                    counts[node.index] += 1
                    node = node.step(self, scope, node)
            if not (self.inclusive and steps.decide_inclusive(self)):
                return

    def livelock(self, node: Node, scope: Scope) -> None:
        """Tokens of an instance never rest: find the elements of the loop, and fail the instance."""
        ids: dict[str, None] = {node.id: None}
        ready = self.ready
        ready.append((node, scope))
        for _ in range(10_000):
            follower, place = ready.popleft()
            if follower is None:
                self.broadcast(*place)
            elif not place.state:
                ids.setdefault(follower.id)
                follower = follower.step(self, place, follower)
                if follower is not None:
                    ready.append((follower, place))
            if not ready:
                break
        text = f"{self.limit} moves without rest, in a loop over {', '.join(key for key in ids if key)}"
        self.abandon(scope.instance, node, text, "livelock")

    # ---- instances -----------------------------------------------------------------------------------

    def open_instance(self, entry: Node, values: dict[str, Any] | None) -> Instance:
        """Make an instance and put its first token at `entry`."""
        variables = self.new_variables()
        variables.update(values or {})
        instance = Instance(self.new_key(), self.program, variables)
        root = Scope(self.new_key(), None, None, self.program.body, variables)
        root.instance, root.counts, instance.root = instance, instance.counts, root
        self.instances[instance.key] = instance
        self.tell(instance.key, root.key, self.program.process, "start")
        self.open_scope(root)
        self.ready.append((entry, root))
        return instance

    def trigger(self, node: Node, message: Any) -> None:
        """A start event of the process was triggered."""
        limit = self.program.instances
        if limit is not None and len(self.instances) >= limit:
            if node.queue:
                self.waiting_starts.setdefault(node, deque(maxlen=node.queue)).append(message)
            else:
                self.host.report(node.id, f"trigger dropped: {limit} instance(s) of {self.program.process} run already")
            return
        instance = self.open_instance(node, None)
        if node.take is not None:
            self.take(node, instance.root, message)

    def conclude(self, instance: Instance, status: Any) -> None:
        """An instance is over."""
        instance.status = status
        self.instances.pop(instance.key, None)
        self.tell(instance.key, instance.root.key, self.program.process, "end", status)
        self.host.ended(instance)
        for node, kept in tuple(self.waiting_starts.items()):
            if kept:
                self.trigger(node, kept.popleft())
                break

    def abandon(self, instance: Instance, node: Node, text: str, code: str, cause: BaseException | None = None) -> None:
        """An instance failed: nothing caught its error."""
        instance.error = MissionError(text, element=node.id, line=node.line, code=code)
        instance.error.__cause__ = cause
        last = self.replace(instance.root, None)
        self.host.make_safe("failed")
        self.proceed(steps.FAILED, last)

    # ---- scopes --------------------------------------------------------------------------------------

    def new_key(self) -> int:
        """Identities come from one counter."""
        self.counter += 1
        return self.counter

    def child(self, parent: Scope, node: Node, body: Any, variables: dict[str, Any]) -> Scope:
        """A new scope inside another."""
        scope = Scope(self.new_key(), parent, node, body, variables)
        parent.children[scope] = None
        return scope

    def open_scope(self, scope: Scope) -> None:
        """Arm what listens as long as the scope lives: event sub-processes, and queues of catching events."""
        body = scope.body
        if body is None:
            return
        for node in body.queued:
            self.mailbox(node, scope)
        for node in body.armed:
            rest = Rest(self.new_key(), node, scope, False, scope)
            scope.children[rest] = None
            self.arm(rest)

    def close_scope(self, scope: Scope) -> None:
        """The opposite, with all that guards it."""
        scope.state = DEAD
        self.inclusive.pop(scope, None)
        for arm in scope.arms:
            self.disarm(arm)
        for child in scope.children:
            if isinstance(child, Rest):
                self.disarm(child)
        for box in (scope.mail or {}).values():
            self.unlisten(box.node.topic, box)
            box.alive = False
        scope.children, scope.arms, scope.mail, scope.joins = {}, [], None, None

    def finish(self, scope: Scope) -> None:
        """The last token of a scope is gone: the scope ends, and so may those around it."""
        while True:
            node, parent, handles = scope.node, scope.parent, scope.handles
            self.close_scope(scope)
            if handles is not None:
                self.count(scope, handles)
            if parent is None:
                self.conclude(scope.instance, "completed")
                return
            parent.children.pop(scope, None)
            assert node is not None
            if node.kind == "handler":
                self.count(scope, node)
                parent.tokens -= 1
                if parent.suspender is scope:
                    parent.suspender = None
                    self.resume(parent)
                if parent.tokens:
                    return
                scope = parent
            else:
                steps.leave(self, parent, node, scope)
                return

    def count(self, scope: Scope, node: Node) -> None:
        """An element has completed."""
        scope.counts[node.slot] += 1
        if node.act is not None:
            self.tell(scope.instance.key, scope.key, node.id, "leave")

    def complete(self, scope: Scope, node: Node) -> None:
        """An element at which a token rested has completed: the token goes on."""
        scope.counts[node.slot] += 1
        if node.act is not None:
            self.tell(scope.instance.key, scope.key, node.id, "leave")
        self.ready.append((node.next, scope))

    def replace(self, scope: Scope, handles: Node | None) -> Scope:
        """Cancel a scope; a new one takes its place, with one token, under the same guards."""
        heir = Scope(self.new_key(), scope.parent, scope.node, None, scope.variables)
        heir.instance, heir.counts, heir.depth = scope.instance, scope.counts, scope.depth
        heir.handles, heir.items, heir.state = handles, scope.items, 0
        heir.arms, scope.arms = scope.arms, []
        for arm in heir.arms:
            arm.owner = heir
        self.kill(scope)
        if scope.parent is None:
            scope.instance.root = heir
        else:
            scope.parent.children[heir] = None
            if scope.parent.suspender is scope:
                scope.parent.suspender = heir
        return heir

    # ---- cancellation --------------------------------------------------------------------------------

    def kill(self, scope: Scope) -> None:
        """Mark a subtree dead at once. What leaves is in `departing`: `proceed` follows."""
        if scope.parent is not None:
            scope.parent.children.pop(scope, None)
        doomed, reached = [scope], 0
        while reached < len(doomed):
            doomed.extend(child for child in doomed[reached].children if isinstance(child, Scope))
            reached += 1
        for victim in doomed:
            self.departing.extend(victim.leaving)
            for child in victim.children:
                if isinstance(child, Rest):
                    self.cancel_rest(child)
            if victim.node is not None and victim.node.act is not None:
                self.tell(victim.instance.key, victim.key, victim.node.id, "cancel")
            self.close_scope(victim)

    def cancel_rest(self, rest: Rest) -> None:
        """A token at rest is cancelled."""
        if rest.started and not rest.paused and not self.host.cancel(rest.key):
            self.departing.append(rest.key)
        if rest.token and rest.node.act is not None:
            self.tell(rest.scope.instance.key, rest.scope.key, rest.node.id, "cancel")
        self.disarm(rest)

    def withdraw(self, rest: Rest) -> None:
        """A token leaves its rest, or what was armed fires for the last time."""
        rest.scope.children.pop(rest, None)
        self.disarm(rest)

    def proceed(self, node: Node, scope: Scope) -> None:
        """A token goes to `node` when all that was just cancelled is out."""
        if self.departing:
            departure = Departure(len(self.departing), node, scope)
            for key in self.departing:
                self.leaving[key] = departure
                scope.leaving[key] = None
            self.departing = []
        else:
            self.ready.append((node, scope))

    # ---- what is armed -------------------------------------------------------------------------------

    def rest(self, node: Node, scope: Scope) -> Rest:
        """A token comes to rest, and the boundary events of its activity are armed."""
        rest = Rest(self.new_key(), node, scope, True)
        scope.children[rest] = None
        for boundary in node.armed:
            self.guard(boundary, scope, rest)
        return rest

    def guard(self, node: Node, scope: Scope, owner: Scope | Rest) -> None:
        """Arm a boundary event, or an alternative."""
        rest = Rest(self.new_key(), node, scope, False, owner)
        owner.arms.append(rest)
        self.arm(rest)

    def arm(self, rest: Rest) -> None:
        """Make a rest hear what it waits for."""
        kind = rest.node.kind
        if kind in ("signal", "message"):
            self.listen(rest)
        elif kind == "timer":
            self.rests[rest.key] = rest
            try:
                self.host.set_timer(rest.key, rest.node.timer, str(rest.node.run(rest.scope.variables)))
            except Exception as error:
                self.withdraw(rest)
                self.fail(rest.scope, rest.node, error)
        elif kind == "condition":
            self.conditions[rest] = None
            self.check_condition(rest)

    def listen(self, rest: Rest) -> None:
        """Arm it for its topic; a message that its queue kept is there at once."""
        node, mail = rest.node, rest.scope.mail
        box = mail.get(node) if mail is not None else None
        if box is None and node.queue:  # of a boundary event: it keeps messages as long as its activity
            box = self.mailbox(node, rest.scope)
        if box is None:
            listeners = self.listeners.get(node.topic)
            if listeners is None:
                listeners = self.listeners[node.topic] = {}
            listeners[rest] = None
        else:
            box.rests[rest] = None
            while box.messages and rest in box.rests:
                self.wake(rest, box.messages.popleft()[1])

    def mailbox(self, node: Node, scope: Scope) -> Mailbox:
        """Keep messages for an event as long as the scope lives."""
        box = Mailbox(self.new_key(), node, scope)
        if scope.mail is None:
            scope.mail = {}
        scope.mail[node] = box
        self.listeners.setdefault(node.topic, {})[box] = None
        return box

    def unlisten(self, topic: str, listener: Listener) -> None:
        """The opposite of listening; a topic that nobody listens to is forgotten."""
        listeners = self.listeners.get(topic)
        if listeners is not None:
            listeners.pop(listener, None)
            if not listeners:
                del self.listeners[topic]

    def disarm(self, rest: Rest) -> None:
        """Whatever could wake it, and whatever is armed because of it, is forgotten."""
        rest.alive = False
        self.deafen(rest)
        kind = rest.node.kind
        if kind == "timer":
            if self.rests.pop(rest.key, None) is not None:
                self.host.cancel_timer(rest.key)
        elif kind == "script":
            self.rests.pop(rest.key, None)
        for arm in rest.arms:
            self.disarm(arm)
        rest.arms = []

    def deafen(self, rest: Rest) -> None:
        """It hears no topic and no condition any more."""
        node = rest.node
        if node.kind == "condition":
            self.conditions.pop(rest, None)
        elif node.topic:
            mail = rest.scope.mail
            box = mail.get(node) if mail is not None else None
            if box is None:
                self.unlisten(node.topic, rest)
                return
            box.rests.pop(rest, None)
            if not rest.alive and node.fire is steps.fire_boundary:  # the queue ends with the activity
                self.unlisten(node.topic, box)
                box.alive = False
                del mail[node]  # type: ignore[union-attr]

    # ---- deliveries ----------------------------------------------------------------------------------

    def broadcast(self, topic: str, message: Any) -> None:
        """One delivery reaches every catcher armed at its beginning once, in the order of arming; start events last."""
        listeners = self.listeners.get(topic)
        if listeners:
            for listener in tuple(listeners):
                if listener.alive:
                    if listener.__class__ is Mailbox:
                        self.post_to(listener, message)
                    else:
                        self.wake(listener, message)  # type: ignore[arg-type]
        for node in self.program.starts.get(topic, ()):
            self.trigger(node, message)

    def hand_over(self, topic: str, message: Any) -> None:
        """A message goes to one catcher: the first whose turn it is, else to a start event."""
        for listener in self.listeners.get(topic, ()):
            if listener.__class__ is Mailbox:
                self.post_to(listener, message)
            else:
                self.wake(listener, message)  # type: ignore[arg-type]
            return
        for node in self.program.starts.get(topic, ()):
            self.trigger(node, message)
            return

    def post_to(self, box: Any, message: Any) -> None:
        """To those who wait at a queue, else into it."""
        if box.rests:
            for rest in tuple(box.rests):
                if rest.alive:
                    self.wake(rest, message)
        else:
            self.counter += 1
            box.messages.append((self.counter, message))

    def wake(self, rest: Rest, message: Any) -> None:
        """What a rest waits for is there."""
        if rest.paused:
            self.counter += 1
            rest.due = rest.due or self.counter
            return
        node = rest.node
        if node.take is not None and not self.take(node, rest.scope, message):
            return
        assert node.fire is not None
        node.fire(self, rest, message)

    def take(self, node: Node, scope: Scope, message: Any) -> bool:
        """Set the variables that a caught message sets; False if that went wrong (the element has failed then)."""
        assert node.take is not None
        try:
            node.take(scope.variables, message)
        except Exception as error:
            self.fail(scope, node, error)
            return False
        if self.conditions:
            self.check_conditions()
        return True

    def check_conditions(self) -> None:
        """Variables changed: armed conditional events, in the order of arming."""
        for rest in tuple(self.conditions):
            if rest.alive:
                self.check_condition(rest)

    def check_condition(self, rest: Rest) -> None:
        """A conditional event fires when its condition becomes true; a name that is not set yet is not true."""
        try:
            value = bool(rest.node.run(rest.scope.variables))
        except (NameError, LookupError, AttributeError):
            value = False
        except Exception as error:
            self.host.report(rest.node.id, f"condition failed: {error}")
            value = False
        rises = value and not rest.true
        rest.true = value
        if rises:
            self.wake(rest, None)

    # ---- errors --------------------------------------------------------------------------------------

    def fail(self, scope: Scope, node: Node, error: BaseException) -> None:
        """An error climbs from the failing activity outwards until something catches it (DESIGN section 3, Errors)."""
        code = error.code if isinstance(error, BpmnError) else "script"
        text = str(error) or type(error).__name__
        failing: Node | None = node.guard
        place: Scope | None = scope
        inner: Scope | None = None  # the scope that the failing activity is, if it is one
        if node.act is not None:
            self.tell(scope.instance.key, scope.key, node.id, "fail", code)
        while place is not None and failing is not None:
            catcher = matching(failing.errors, code)
            if catcher is not None:
                if inner is not None:
                    self.kill(inner)
                self.note_error(catcher, place, code, text)
                self.count(place, catcher)
                assert catcher.next is not None
                self.proceed(catcher.next, place)
                return
            handler = matching(place.body.errors, code) if place.body is not None else None
            if handler is not None:
                heir = self.replace(place, handler.guard)
                self.note_error(handler, heir, code, text)
                steps.open_handler(self, heir, handler)
                return
            if place.node is not None and place.node.kind == "handler" and place.parent is not None:
                place = place.parent  # a handler's error starts outside the scope that it handles
            inner, failing, place = place, place.node, place.parent
        self.abandon(scope.instance, node, describe(error, code), code, error)

    def note_error(self, catcher: Node, scope: Scope, code: str, text: str) -> None:
        """Set the variables in which a catching event wants code and text."""
        if catcher.code_variable:
            scope.variables[catcher.code_variable] = code
        if catcher.message_variable:
            scope.variables[catcher.message_variable] = text

    # ---- suspension ----------------------------------------------------------------------------------

    def suspend(self, scope: Scope) -> None:
        """Hold all that goes on in a scope, but for its handlers and its other event sub-processes."""
        scope.state += 1
        for child in tuple(scope.children):
            if isinstance(child, Scope):
                if child.node is None or child.node.kind != "handler":
                    for inner in tuple(subtree(child)):
                        self.hold(inner)
            elif child.token or child.node.resume:
                self.pause(child)
        self.host.make_safe("suspended")

    def hold(self, scope: Scope) -> None:
        """A scope inside a suspended one: everything in it and every guard of it."""
        scope.state += 1
        for arm in scope.arms:
            self.pause(arm)
        for child in tuple(scope.children):
            if isinstance(child, Rest):
                self.pause(child)

    def pause(self, rest: Rest) -> None:
        """It stops listening (its queue does not); a running task is cancelled, to be started again."""
        rest.paused += 1
        if rest.paused == 1:
            if rest.started and not self.host.cancel(rest.key):
                self.departing.append(rest.key)
            self.deafen(rest)
        for arm in rest.arms:
            self.pause(arm)

    def resume(self, scope: Scope) -> None:
        """The handler has ended normally: all goes on, timers that came due meanwhile in their order."""
        scope.state -= 1
        awake: list[Rest] = []
        released = [scope]
        for child in tuple(scope.children):
            if isinstance(child, Scope):
                if child.node is None or child.node.kind != "handler":
                    released.extend(subtree(child))
            elif child.token or child.node.resume:
                awake.append(child)
        for inner in released[1:]:
            inner.state -= 1
            awake.extend(inner.arms)
            awake.extend(child for child in inner.children if isinstance(child, Rest))
        for inner in released:
            if not inner.state and inner.held:
                self.ready.extend((node, inner) for node in inner.held)
                inner.held = []
        self.unpause(awake)

    def unpause(self, rests: list[Rest]) -> None:
        """Make them hear again, then let those fire that came due while they could not."""
        due: list[Rest] = []
        for rest in rests:
            rests_here = [rest, *rest.arms]
            for item in rests_here:
                item.paused -= 1
                if item.due and not item.paused:
                    due.append(item)
        for rest in rests:
            for item in [rest, *rest.arms]:
                if item.alive and not item.paused and not item.due:
                    self.revive(item)
        for rest in sorted(due, key=lambda rest: rest.due):
            rest.due = 0
            if rest.alive:
                self.wake(rest, None)

    def revive(self, rest: Rest) -> None:
        """A rest that was paused listens again; a task starts again."""
        kind = rest.node.kind
        if kind in ("signal", "message"):
            self.listen(rest)
        elif kind == "condition":
            rest.true = False
            self.conditions[rest] = None
            self.check_condition(rest)
        elif kind == "script":
            steps.restart(self, rest)


class Departure:
    """What goes on when scripts that were cancelled are out: a token at `node`."""

    __slots__ = ("node", "pending", "scope")

    def __init__(self, pending: int, node: Node, scope: Scope) -> None:
        self.pending, self.node, self.scope = pending, node, scope


def subtree(scope: Scope) -> list[Scope]:
    """A scope and all scopes in it; those that a suspension of their own holds are held once more."""
    found, reached = [scope], 0
    while reached < len(found):
        found.extend(child for child in found[reached].children if isinstance(child, Scope))
        reached += 1
    return found


def matching(catchers: tuple[Node, ...], code: str | None) -> Node | None:
    """The catcher of a code: an exact one beats one that catches all."""
    for catcher in catchers:
        if catcher.code == code and code is not None:
            return catcher
    for catcher in catchers:
        if catcher.code is None:
            return catcher
    return None


def describe(error: BaseException, code: str) -> str:
    """An uncaught error, in words."""
    if isinstance(error, BpmnError):
        said = f": {error.message}" if error.message != code else ""
        return f"error {code} was not caught{said}"
    return f"{type(error).__name__}: {error}"


__all__ = ["DEPTH", "MOVES", "Departure", "Engine", "Variables", "describe", "matching", "subtree"]
