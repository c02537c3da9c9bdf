"""What an engine tells people: warnings, and refusals at a rate that can be read."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable

from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.middleware.interface import Middleware

_KEPT = 10
"""How many warnings a report has."""
_CAUSES = 20
"""How many causes are told apart within a second; all others count as one."""


class Warnings:
    """The warnings of an engine: call it with a text, and `tell` gets it; a report shows the latest ones.

    `poll` takes the new warnings of the middleware and its losses. Those from before this object was made are old.
    """

    def __init__(self, middleware: Middleware, tell: Callable[[str], object]) -> None:
        self._middleware, self._tell = middleware, tell
        self._seen = len(middleware.warnings)
        self._losses: list[str] = []
        self._latest: deque[str] = deque(maxlen=_KEPT)

    def __call__(self, text: str) -> None:
        self._latest.append(text)
        self._tell(text)

    def poll(self, except_for: str) -> list[str]:
        """Tell the new warnings; those that begin with `except_for` are returned instead."""
        new = list(self._middleware.warnings[self._seen :])
        self._seen += len(new)
        for text in new:
            if not text.startswith(except_for):
                self(text)
        before, self._losses = self._losses, self._middleware.losses()
        for text in self._losses:  # they grow: the latest is told, and the report shows each once
            if text not in before:
                self._tell(text)
        return [text for text in new if text.startswith(except_for)]

    def lines(self) -> list[str]:
        """For a report."""
        return [*self._losses[:_KEPT], *self._latest]


class RateLimiter:
    """Pass a text on to `tell` at once, and more of the same cause at the end of each second, as one with a count.

    The cause is the beginning of a text, up to the first number or quotation: the rest comes from the sender.
    """

    def __init__(self, scheduler: Scheduler, tell: Callable[[str], object]) -> None:
        self._scheduler, self._pass_on = scheduler, tell
        self._held: dict[str, tuple[int, str]] = {}  # cause -> number held back, and the last of them
        self._timer: Entry | None = None

    def __call__(self, text: str) -> None:
        """Pass it on, now or with others."""
        cause = re.split(r"[\d'\"]", text, maxsplit=1)[0]
        if cause not in self._held and len(self._held) >= _CAUSES:
            cause = ""
        if cause in self._held:
            self._held[cause] = self._held[cause][0] + 1, text
            return
        self._held[cause] = 0, ""
        if self._timer is None:
            self._timer = self._scheduler.after(SECOND, self._end_second, Kind.TIMER)
        self._pass_on(text)

    def _end_second(self) -> None:
        """Pass on what was held back; its causes are held back for another second."""
        held = {cause: found for cause, found in self._held.items() if found[0]}
        self._held = dict.fromkeys(held, (0, ""))
        self._timer = self._scheduler.after(SECOND, self._end_second, Kind.TIMER) if held else None
        for count, text in held.values():
            self._pass_on(f"{text} ({count} like this within a second)" if count > 1 else text)

    def close(self) -> None:
        """Stop."""
        if self._timer is not None:
            self._timer.cancel()
