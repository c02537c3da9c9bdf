"""How long an answer may take: the round trip to a receiver, measured as TCP does (RFC 6298)."""

from __future__ import annotations

from fame.clock import SECOND
from fame.dataclasses import dataclass

_LEAST, _MOST = SECOND // 2, 8 * SECOND
"""Bounds of how long is waited (ns). An engine writes to its disk before it answers, and a script may keep it busy."""


@dataclass(slots=True)
class RoundTrip:
    """What is known of the way to one receiver and back; times in ns.

    began     when the signal `number` left, whose answer is measured; none is after something was sent again, since
              its answer may be that of the first time (Karn's algorithm)
    patience  for how long a receiver may make no progress before it is asked what it has
    moved     when it last made progress, or was asked
    has       the number in its last answer
    """

    patience: int = _LEAST
    moved: int = 0
    has: int = 0
    number: int = 0
    began: int = 0
    mean: float = 0.0
    deviation: float = 0.0

    def sent(self, number: int, now: int) -> None:
        """A signal leaves for the first time."""
        if not self.number:
            self.number, self.began = number, now

    def answered(self, number: int, now: int) -> None:
        """The receiver says that it has all signals up to this number."""
        if number == self.has:
            return
        self.has, self.moved = number, now
        if self.number and number >= self.number:
            self._measure(now - self.began)
            self.number = 0
        elif self.mean:
            self.patience = self._timeout()

    def asked(self, now: int) -> None:
        """The receiver made no progress: what it answers to is not known, and it is given more time."""
        self.moved, self.number = now, 0
        self.patience = min(2 * self.patience, _MOST)

    def found(self) -> None:
        """The receiver is there again: ask it at once. At fixed intervals it might be asked only while a link that
        goes down periodically is down."""
        self.patience, self.moved, self.number = self._timeout(), -_MOST, 0

    def _measure(self, took: int) -> None:
        if self.mean:
            self.deviation += (abs(self.mean - took) - self.deviation) / 4
            self.mean += (took - self.mean) / 8
        else:
            self.mean, self.deviation = took, took / 2
        self.patience = self._timeout()

    def _timeout(self) -> int:
        return round(min(max(self.mean + 4 * self.deviation, _LEAST), _MOST))
