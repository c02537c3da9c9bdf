"""What an engine warns of: what its middleware says, messages that were lost, a clock that jumped."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from fame.middleware.interface import Middleware

_KEPT = 10
"""How many warnings a report has."""


class Warnings:
    """Call it with a text: `tell` gets it, and a report shows the latest ones.

    `look` takes in what the middleware has to say since the last time. What it said before this was made is old.
    """

    def __init__(self, middleware: Middleware, tell: Callable[[str], object]) -> None:
        self._middleware, self._tell = middleware, tell
        self._seen = len(middleware.warnings)
        self._losses: list[str] = []
        self._latest: deque[str] = deque(maxlen=_KEPT)

    def __call__(self, text: str) -> None:
        self._latest.append(text)
        self._tell(text)

    def look(self, apart: str) -> list[str]:
        """Tell what is new. Returned, and not told, is what begins with `apart`."""
        new = list(self._middleware.warnings[self._seen :])
        self._seen += len(new)
        for text in new:
            if not text.startswith(apart):
                self(text)
        before, self._losses = self._losses, self._middleware.losses()
        for text in self._losses:  # they grow: the latest is told, and the report shows each once
            if text not in before:
                self._tell(text)
        return [text for text in new if text.startswith(apart)]

    def lines(self) -> list[str]:
        """For a report."""
        return [*self._losses[:_KEPT], *self._latest]
