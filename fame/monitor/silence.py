"""What arrives: subscriptions made from a configuration, and the samples that can be used.

Each topic is subscribed once. A message gives one sample to every input of its topic, or to none: if any of them cannot
be read, is not finite, or the stamp is not later than the last, the whole message is left out, and the reason is
reported. So the inputs of one topic always have the same stamps. The stamp is that of the header, else the time of
arrival (s, of the scheduler).


Watch: says when a topic is silent, and when it goes on."""

from __future__ import annotations

from collections.abc import Callable

from fame.clock import SECOND, Entry, Scheduler


class Reporter:
    """Says each thing once, and again when it has happened 10, 100, 1000 ... times."""

    def __init__(self, report: Callable[[str], object]) -> None:
        self._report = report
        self.counts: dict[str, int] = {}

    def __call__(self, key: str, text: str) -> None:
        """`key` is what counts as the same thing."""
        count = self.counts[key] = self.counts.get(key, 0) + 1
        if count in (1, 10, 100) or count % 1000 == 0:
            self._report(text if count == 1 else f"{text} ({count} times)")

    def over(self, key: str, text: str) -> None:
        """It is over: if it was ever said, say so, and begin anew."""
        if self.counts.pop(key, 0):
            self._report(text)


SILENCE = 1.0
"""A topic without a message for so long (s) has stopped."""


class Watch:
    """Expects a message on `topic` within `silence` (s), again and again; `waits` tells what waits for it meanwhile."""

    def __init__(
        self,
        scheduler: Scheduler,
        topic: str,
        report: Callable[[str], object],
        waits: Callable[[], str],
        silence: float = SILENCE,
    ) -> None:
        self._scheduler, self._topic, self._report, self._waits = scheduler, topic, report, waits
        self._silence, self._stopped, self._heard = silence, False, False
        self._entry: Entry = self._expect()

    def heard(self) -> None:
        """A message has come: the next is expected in time."""
        if self._stopped and self._heard:
            self._report(f"{self._topic} goes on")
        self._stopped, self._heard = False, True
        self._entry.cancel()
        self._entry = self._expect()

    def close(self) -> None:
        """Expect nothing more."""
        self._entry.cancel()

    def _expect(self) -> Entry:
        return self._scheduler.after(round(self._silence * SECOND), self._silent)

    def _silent(self) -> None:
        self._stopped = True
        found = "has stopped: nothing for" if self._heard else "is silent: nothing in the first"
        self._report(f"{self._topic} {found} {self._silence:g} s; {self._waits()} waits for it")
