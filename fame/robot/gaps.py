"""Publishers that left and came back while a token waited for what they publish: a message may be lost for good.

A robot that is healthy may so wait for ever, after a network was parted or an engine was started again. Whoever asks
now and then what the robot waits for compares who publishes now with who did before.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import NamedTuple

from fame.clock import SECOND
from fame.middleware.interface import UNKNOWN


class Gap(NamedTuple):
    """A node that was gone from a topic between two times (ns)."""

    node: str
    left: int
    back: int


class Gaps:
    """What `look` has found out about the topics that are awaited."""

    def __init__(self) -> None:
        self._there: dict[str, set[str]] = {}  # topic -> who published on it at the last look
        self._left: dict[str, dict[str, int]] = {}  # topic -> who left it, and when
        self._last: dict[str, Gap] = {}

    def look(self, now: int, publishers: Mapping[str, Collection[str]]) -> None:
        """Compare with the last time. `publishers`: awaited topic -> nodes that publish on it, own ones apart."""
        for known in (self._there, self._left, self._last):
            for topic in known.keys() - publishers.keys():
                del known[topic]
        for topic, names in publishers.items():
            there, left = set(names) - {UNKNOWN}, self._left.setdefault(topic, {})
            left.update(dict.fromkeys(self._there.get(topic, there) - there, now))
            for name in sorted(there & left.keys()):
                self._last[topic] = Gap(name, left.pop(name), now)
            self._there[topic] = there

    def since(self, time: int, topics: Iterable[str]) -> Gap | None:
        """The last one that ended after a time, on one of these topics."""
        found = [gap for topic in topics if (gap := self._last.get(topic)) is not None and gap.back > time]
        return max(found, key=lambda gap: gap.back, default=None)


def gap_text(gap: Gap | None, now: int) -> str:
    """In words, behind others; empty for none."""
    if gap is None:
        return ""
    gone, ago = (gap.back - gap.left) / SECOND, (now - gap.back) / SECOND
    return f" ({gap.node} was gone for {gone:.3g} s until {ago:.3g} s ago: what it said then may be lost)"
