"""Messages in transit: contents of the network, by number.

It holds messages by channel (sender, topic, receiver), first in first out.
"""

from __future__ import annotations

from collections.abc import Callable

MOST_MESSAGES = 6
"""Messages in a channel beyond which it counts as growing without bound."""
BEYOND = 1
"""The number of all contents with more messages than that."""

Channel = tuple[int, str, int]
"""Places of sender and receiver, with the topic between them."""
Content = tuple[tuple[Channel, tuple[int, ...]], ...]
"""What the network holds: message numbers by channel, sorted."""
Sent = tuple[tuple[str, int, str], ...]
"""Messages that a robot sends in one step: (topic, message number, only receiver or "")."""
Receivers = Callable[[int, str, str], tuple[int, ...]]


class NetworkContents:
    """The contents of a network, by number; 0 is empty. `piles`: the channels in which too many messages were.

    All differences are of the number alone.
    """

    piles: set[Channel]

    def __init__(self, receivers: Receivers) -> None:
        self.piles = set()
        self._receivers = receivers
        self._contents: list[Content] = [(), ()]
        self._numbers: dict[Content, int] = {(): 0}
        self._pushed: dict[tuple[int, int], int] = {}
        self._heads: dict[int, list[tuple[int, str, int, int]]] = {}
        self._sendings: dict[tuple[int, Sent], int] = {}
        self.sent: list[tuple[int, Sent]] = [(0, ())]

    def sending(self, sender: int, sent: Sent) -> int:
        """Return the number of what a robot sends in a step; 0 if nobody receives it."""
        sent = tuple(one for one in sent if self._receivers(sender, one[0], one[2]))
        if not sent:
            return 0
        number = self._sendings.get((sender, sent))
        if number is None:
            number = self._sendings[sender, sent] = len(self.sent)
            self.sent.append((sender, sent))
        return number

    def content(self, number: int) -> Content:
        return self._contents[number]

    def number(self, content: dict[Channel, tuple[int, ...]]) -> int:
        key = tuple(sorted(content.items()))
        number = self._numbers.get(key)
        if number is None:
            number = self._numbers[key] = len(self._contents)
            self._contents.append(key)
        return number

    def push(self, number: int, sending: int) -> int:
        """Return the difference when a robot has sent something."""
        if number == BEYOND:
            return 0
        difference = self._pushed.get((number, sending))
        if difference is None:
            sender, sent = self.sent[sending]
            content = dict(self._contents[number])
            for topic, message, only in sent:
                for receiver in self._receivers(sender, topic, only):
                    channel = (sender, topic, receiver)
                    waiting = (*content.get(channel, ()), message)
                    if len(waiting) > MOST_MESSAGES:
                        self.piles.add(channel)
                    content[channel] = waiting
            beyond = any(len(waiting) > MOST_MESSAGES for waiting in content.values())
            difference = self._pushed[number, sending] = (BEYOND if beyond else self.number(content)) - number
        return difference

    def heads(self, number: int) -> list[tuple[int, str, int, int]]:
        """Return the messages that may arrive next: (receiver, topic, message, difference when it has)."""
        heads = self._heads.get(number)
        if heads is None:
            heads = self._heads[number] = []
            for channel, waiting in self._contents[number]:
                content = dict(self._contents[number])
                content[channel] = waiting[1:]
                if not content[channel]:
                    del content[channel]
                heads.append((channel[2], channel[1], waiting[0], self.number(content) - number))
        return heads

    def renamed(self, number: int, places: dict[int, int]) -> int:
        """Return the number when robots change places."""
        content = {
            (places.get(sender, sender), topic, places.get(receiver, receiver)): messages
            for (sender, topic, receiver), messages in self._contents[number]
        }
        return self.number(content)
