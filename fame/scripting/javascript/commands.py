"""Commands of scripts to their robot, and the host API that executes them, in order, after the step that gave them.

Each command is a function of the realm, the run and the values that the script gave. What it raises becomes an error of
the script, at the line where the command was given.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from random import Random
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND, Kind, Scheduler
from fame.dataclasses import dataclass, field
from fame.engine.host import BpmnError
from fame.errors import MessageError
from fame.scripting.javascript.environment import ScriptRun
from fame.scripting.javascript.source import located
from fame.scripting.javascript.values import Encoded, encode
from fame.scripting.requests import MOMENT, SERVICE_TIMEOUT, Inbox, MessageQueue

if TYPE_CHECKING:
    from fame.scripting.javascript.realm import Realm

REALM = "__realm__"
"""The name under which the script interface holds the realm of its scripts, once there is one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HostApi:
    """One for each robot. `inbox` has its topics and clients; callbacks are entries of its `scheduler`.

    name       of the robot, as the team knows it
    namespace  of the robot, without slashes
    epoch      date of simulated second 0 (ms since 1970)
    advertise  (topic, type): create a publisher; raises MessageError
    publish    (topic, type, value): publish a message; raises MessageError
    log        (level, text): write a line of log
    report     (element, text): a warning that stops nothing
    altered    (): where a state is kept, what is called with a variable that is other data in it, and why
    stepped    (): a callback has ended, so variables may have changed
    lost       (script, element, text, again, fail): the fate of a request of a script is unknown
    failed     (variables, element, error): a callback of a script that is over has failed
    alive      (variables): whether their scope is still open
    random     the random numbers of the robot, which seed those of each realm
    realms     the open realms
    encoded    the JSON text of a message, shared by all its subscriptions
    """

    name: str
    namespace: str
    epoch: float
    random: Random
    scheduler: Scheduler
    inbox: Inbox
    advertise: Callable[[str, str], object]
    publish: Callable[[str, str, Any], object]
    log: Callable[[str, str], object]
    report: Callable[[str, str], object]
    altered: Callable[[], Callable[[str, str], object] | None]
    stepped: Callable[[], object]
    lost: Callable[[Any, str, str, Callable[[], object], Callable[[BaseException], object]], object]
    failed: Callable[[dict[str, Any], str, BaseException], object]
    alive: Callable[[dict[str, Any]], bool]
    realms: list[Realm] = field(default_factory=list)
    encoded: Encoded = field(default_factory=Encoded)

    def sweep(self) -> None:
        """Close the realms whose variables are no longer in use, after a process instance has ended."""
        for realm in list(self.realms):
            if not self.alive(realm.variables):
                realm.close()

    def close(self) -> None:
        for realm in list(self.realms):
            realm.close()


QUEUE = 100
"""Messages that wait for one subscription."""

_MILLISECOND = SECOND // 1000
_POLL = 50 * _MILLISECOND
"""Interval in which waitForService checks whether the service is available (ns)."""


def execute(realm: Realm, run: ScriptRun, command: list[Any]) -> BaseException | None:
    """Execute a command. Returns the error, None if there was none."""
    name, *values = command
    try:
        if name in LOCATED:
            LOCATED[name](realm, run, *values[1:])
        else:
            UNLOCATED[name](realm, run, *values)
    except Exception as error:
        return located(error, run.script, str(values[0]) if name in LOCATED else "")
    return None


# ---- topics ----------------------------------------------------------------------------------------------------------


def advertise(realm: Realm, run: ScriptRun, type: str, topic: str) -> None:
    """createPublisher: create the endpoint before the first message."""
    realm.robot.advertise(topic, type)


def publish(realm: Realm, run: ScriptRun, type: str, topic: str, message: Any) -> None:
    realm.robot.publish(topic, type, message)


def subscribe(realm: Realm, run: ScriptRun, number: int, type: str, topic: str) -> None:
    """createSubscription: deliver messages one by one, each in an entry of the scheduler."""
    queue = realm.robot.inbox.queue(topic, type, QUEUE)

    def deliver() -> None:
        if queue.messages:
            realm.call_back(number, realm.robot.encoded(queue.messages.popleft()), again=True)

    queue.waiting[partial(realm.robot.scheduler.soon, deliver, Kind.MESSAGE)] = None
    realm.expect(number, run, lambda: _unsubscribe(queue))


def _unsubscribe(queue: MessageQueue) -> None:
    queue.waiting.clear()
    queue.messages.clear()


# ---- services --------------------------------------------------------------------------------------------------------


def client(realm: Realm, run: ScriptRun, type: str, service: str) -> None:
    """createClient."""
    realm.robot.inbox.client(service, type)


def wait_for_service(realm: Realm, run: ScriptRun, number: int, type: str, service: str, ms: float | None) -> None:
    """waitForService: true as soon as the service is available, false after the timeout."""
    called, scheduler = realm.robot.inbox.client(service, type), realm.robot.scheduler
    end = None if ms is None else scheduler.now + max(0, round(ms * _MILLISECOND))

    def poll() -> None:
        late = end is not None and scheduler.now >= end
        if called.available or late:
            realm.call_back(number, encode(called.available))
        else:
            due = scheduler.now + _POLL if end is None else min(scheduler.now + _POLL, end)
            realm.expect(number, run, scheduler.at(due, poll, Kind.RESUMPTION).cancel)

    realm.expect(number, run, scheduler.soon(poll, Kind.RESUMPTION).cancel)


def request(realm: Realm, run: ScriptRun, number: int, type: str, service: str, fields: Any, stack: str) -> None:
    """sendRequest: the response is a callback. The service is waited for as that of a task, and its loss treated so."""
    robot, client = realm.robot, realm.robot.inbox.client(service, type)
    scheduler, timers = robot.scheduler, list[Callable[[], object]]()

    def fail(error: BaseException) -> None:
        realm.fail(number, located(error, run.script, stack))

    def on_response(response: Any) -> None:
        scheduler.soon(partial(realm.call_back, number, encode(response)), Kind.MESSAGE)

    def after(delay: int, until: int) -> None:
        timers[:] = [scheduler.after(delay, partial(attempt, until), Kind.RESUMPTION).cancel]

    def again() -> None:
        if realm.expects(number):
            after(MOMENT, scheduler.now + SERVICE_TIMEOUT)

    def lost() -> None:
        if realm.expects(number):
            text = f"call({service!r}): its server left before it answered, and its fate is unknown"
            robot.lost(run.suspended, run.script.element, text, again, fail)

    def attempt(until: int) -> None:
        if not client.available and scheduler.now < until:
            after(_POLL, until)
            return
        try:
            client.call(fields, on_response, lost)
        except MessageError as error:
            fail(BpmnError("service", str(error)))

    if client.available:
        client.call(fields, on_response, lost)
    else:
        after(_POLL, scheduler.now + SERVICE_TIMEOUT)
    realm.expect(number, run, lambda: [cancel() for cancel in timers])


# ---- timers, log, other runs -----------------------------------------------------------------------------------------


def timer(realm: Realm, run: ScriptRun, number: int, ms: float) -> None:
    """setTimeout."""
    scheduler, on_time = realm.robot.scheduler, partial(realm.call_back, number, "null")
    realm.expect(number, run, scheduler.after(round(ms * _MILLISECOND), on_time, Kind.RESUMPTION).cancel)


def drop(realm: Realm, run: ScriptRun, number: int) -> None:
    """destroySubscription, clearTimeout."""
    realm.drop(number)


def log(realm: Realm, run: ScriptRun, level: str, text: str) -> None:
    """The console and the logger."""
    if realm.host is not None:
        realm.host.log(level, text)


def late(realm: Realm, run: ScriptRun, element: str) -> None:
    """next() in a later step than its first call: the token has moved on, so nothing can fail any more."""
    realm.robot.report(element, "next() was called again, after the script was over")


def end(realm: Realm, run: ScriptRun, number: int, error: dict[str, str] | None) -> None:
    """End another run: this step called its next() or destroyed its last callback."""
    realm.end_other(number, error)


_Command = Callable[..., None]
LOCATED: dict[str, _Command] = {
    "advertise": advertise,
    "publish": publish,
    "subscribe": subscribe,
    "client": client,
    "wait": wait_for_service,
    "request": request,
    "late": late,
}
"""Commands whose first value is the stack where the script gave them."""
UNLOCATED: dict[str, _Command] = {"timer": timer, "drop": drop, "log": log, "end": end}
