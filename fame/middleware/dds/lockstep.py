"""What makes a run over DDS repeatable: messages wait until all that belong to a step are there, and come in order.

A held node gets no message as it comes in: `release` hands over all that wait, sorted by topic, sender and receiver,
those of one sender in its order. `flush` sees to it that what held nodes have sent waits where it belongs when the next
step begins. On loopback it does by itself: when `publish` returns, a message is in the socket of its receiver, ahead of
the word that will begin the next step. On a network it takes acknowledgements, which come late at times (200 ms).
Services and actions are not held.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING

from fame.clock import SECOND

if TYPE_CHECKING:
    from fame.middleware.dds.middleware import DdsMiddleware
    from fame.middleware.dds.nodes import DdsNode

_PATIENCE = 4 * SECOND
"""How long a subscriber may take; one that died is gone before (ns)."""


class Lockstep:
    """Holds the nodes of a middleware whose names are so: those that are there, and those to come."""

    def __init__(self, middleware: DdsMiddleware, holds: Callable[[str], bool]) -> None:
        self._middleware = middleware
        middleware.holds = holds
        for node in middleware.nodes:
            node.held = holds(node.name)

    def release(self, enter: Callable[[Callable[[], object]], object]) -> None:
        """Take all that waits; `enter` gets what hands each message over, in order."""
        found = [
            (subscription.topic, sender, node.full_name, number, partial(subscription.hand_over, data))
            for node in self._nodes()
            for subscription in list(node.subscriptions)
            for number, (sender, data) in enumerate(subscription.drain())
        ]
        found.sort(key=lambda entry: entry[:4])
        for *_, hand_over in found:
            enter(hand_over)

    def flush(self) -> None:
        """Wait until others have what was sent."""
        for node in self._nodes() if self._middleware.network is not None else ():
            for publisher in node.publishers:
                publisher.flush(_PATIENCE)

    def _nodes(self) -> Iterator[DdsNode]:
        return (node for node in list(self._middleware.nodes) if node.held)
