"""What scripts want of their robot: carried out after the step that said so, in order.

Each order is a function of the realm, the run, and what the script gave. Whatever it raises is an error of the script,
at the place where it gave the order.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND, Kind
from fame.scripting.javascript.errors import located
from fame.scripting.javascript.run import Run
from fame.scripting.javascript.values import encode
from fame.scripting.requests import MessageQueue

if TYPE_CHECKING:
    from fame.scripting.javascript.realm import Realm

QUEUE = 100
"""Messages that wait for one subscription."""

_MILLISECOND = SECOND // 1000
_LOOK = 50 * _MILLISECOND
"""How often it is looked whether a service is there."""


def carry_out(realm: Realm, run: Run, order: list[Any]) -> BaseException | None:
    """Do it. Gives what went wrong."""
    name, *values = order
    try:
        if name in PLACED:
            PLACED[name](realm, run, *values[1:])
        else:
            UNPLACED[name](realm, run, *values)
    except Exception as error:
        return located(error, run.script, str(values[0]) if name in PLACED else "")
    return None


# ---- topics ----------------------------------------------------------------------------------------------------------


def advertise(realm: Realm, run: Run, type: str, topic: str) -> None:
    """createPublisher: its endpoint is there before the first message."""
    realm.robot.advertise(topic, type)


def publish(realm: Realm, run: Run, type: str, topic: str, message: Any) -> None:
    """publish."""
    realm.robot.publish(topic, type, message)


def subscribe(realm: Realm, run: Run, number: int, type: str, topic: str) -> None:
    """createSubscription: messages come one by one, each in an entry of the scheduler."""
    queue = realm.robot.inbox.queue(topic, type, QUEUE)

    def hand_over() -> None:
        if queue.messages:
            realm.call_back(number, realm.robot.encoded(queue.messages.popleft()), again=True)

    queue.waiting[partial(realm.robot.scheduler.soon, hand_over, Kind.MESSAGE)] = None
    realm.expect(number, run, lambda: _silence(queue))


def _silence(queue: MessageQueue) -> None:
    queue.waiting.clear()
    queue.messages.clear()


# ---- services --------------------------------------------------------------------------------------------------------


def client(realm: Realm, run: Run, type: str, service: str) -> None:
    """createClient."""
    realm.robot.inbox.client(service, type)


def wait_for_service(realm: Realm, run: Run, number: int, type: str, service: str, ms: float | None) -> None:
    """waitForService: true as soon as somebody offers the service, false when the time is over."""
    asked, scheduler = realm.robot.inbox.client(service, type), realm.robot.scheduler
    end = None if ms is None else scheduler.now + max(0, round(ms * _MILLISECOND))

    def look() -> None:
        late = end is not None and scheduler.now >= end
        if asked.available or late:
            realm.call_back(number, encode(asked.available))
        else:
            due = scheduler.now + _LOOK if end is None else min(scheduler.now + _LOOK, end)
            realm.expect(number, run, scheduler.at(due, look, Kind.RESUMPTION).cancel)

    realm.expect(number, run, scheduler.soon(look, Kind.RESUMPTION).cancel)


def request(realm: Realm, run: Run, number: int, type: str, service: str, fields: Any) -> None:
    """sendRequest: the response is a callback."""

    def answered(response: Any) -> None:
        realm.robot.scheduler.soon(partial(realm.call_back, number, encode(response)), Kind.MESSAGE)

    realm.robot.inbox.client(service, type).call(fields, answered)
    realm.expect(number, run, lambda: None)


# ---- the rest --------------------------------------------------------------------------------------------------------


def timer(realm: Realm, run: Run, number: int, ms: float) -> None:
    """setTimeout."""
    scheduler, ring = realm.robot.scheduler, partial(realm.call_back, number, "null")
    realm.expect(number, run, scheduler.after(round(ms * _MILLISECOND), ring, Kind.RESUMPTION).cancel)


def drop(realm: Realm, run: Run, number: int) -> None:
    """destroySubscription, clearTimeout."""
    realm.drop(number)


def log(realm: Realm, run: Run, level: str, text: str) -> None:
    """The console and the logger."""
    if realm.surroundings is not None:
        realm.surroundings.log(level, text)


def late(realm: Realm, run: Run, element: str) -> None:
    """next() in a later step than the one that called it first: the token has gone on, so that nothing can fail."""
    realm.robot.report(element, "next() was called again, after the script was over")


def end(realm: Realm, run: Run, number: int, error: dict[str, str] | None) -> None:
    """The step of this run has ended another one: called its next(), or destroyed its last callback."""
    realm.end_other(number, error)


Order = Callable[..., None]
PLACED: dict[str, Order] = {
    "advertise": advertise,
    "publish": publish,
    "subscribe": subscribe,
    "client": client,
    "wait": wait_for_service,
    "request": request,
    "late": late,
}
"""Those that come with the place where the script gave them."""
UNPLACED: dict[str, Order] = {"timer": timer, "drop": drop, "log": log, "end": end}
