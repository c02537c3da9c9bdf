"""Silent topics, and reports that do not repeat themselves: what every monitoring node needs."""

from __future__ import annotations

from collections.abc import Callable

from fame.clock import SECOND, Entry, Kind, Scheduler


class ThrottledReport:
    """Reports each kind of event once, and again when it has happened 10, 100, 1000, 2000 ... times."""

    def __init__(self, report: Callable[[str], object]) -> None:
        """`report` gets a line of text; it stays at hand as `always`, for what is never throttled."""
        self.always = report
        self.counts: dict[str, int] = {}

    def __call__(self, key: str, text: str) -> None:
        """Report an event; events with the same `key` are of the same kind."""
        count = self.counts[key] = self.counts.get(key, 0) + 1
        if count in (1, 10, 100) or count % 1000 == 0:
            self.always(text if count == 1 else f"{text} ({count} times)")

    def over(self, key: str, text: str) -> None:
        """Report that events of this kind are over, if there were any, and count anew."""
        if self.counts.pop(key, 0):
            self.always(text)


class SilenceWatch:
    """Reports when no message of a topic has come for `silence` (s), and when messages come again.

    `reason` gives the end of the report; it gets whether there ever was a message. A message costs one assignment: the
    timer is moved on only when it is due.
    """

    def __init__(
        self,
        scheduler: Scheduler,
        topic: str,
        silence: float,
        report: Callable[[str], object],
        reason: Callable[[bool], str],
    ) -> None:
        self._scheduler, self._topic, self._silence = scheduler, topic, silence
        self._report, self._reason = report, reason
        self._received = False
        self._last = scheduler.now
        self._timer: Entry | None = self._expect()

    def on_message(self) -> None:
        """Expect the next message in time."""
        self._last, self._received = self._scheduler.now, True
        if self._timer is None:
            self._report(f"{self._topic} goes on")
            self._timer = self._expect()

    def close(self) -> None:
        """Expect no more messages."""
        if self._timer is not None:
            self._timer.cancel()

    def _expect(self) -> Entry:
        return self._scheduler.at(self._last + round(self._silence * SECOND), self._check, Kind.TIMER)

    def _check(self) -> None:
        if self._scheduler.now < self._last + round(self._silence * SECOND):
            self._timer = self._expect()
            return
        self._timer = None
        self._report(f"{self._topic}: no message for {self._silence:g} s{self._reason(self._received)}")
