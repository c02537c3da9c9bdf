"""What is refused in masses is told once a second, with how much of it there was."""

from __future__ import annotations

import re
from collections.abc import Callable

from fame.clock import SECOND, Entry, Kind, Scheduler

_CAUSES = 20
"""How many causes are told apart within a second; what is of others counts as one."""


class Digest:
    """Passes a text on to `say` at once, and more of the same cause at the end of each second, as one with a count.

    The cause is how a text begins, up to the first number or quotation: what follows is of whoever sent it.
    """

    def __init__(self, scheduler: Scheduler, say: Callable[[str], object]) -> None:
        self._scheduler, self._say = scheduler, say
        self._held: dict[str, tuple[int, str]] = {}  # cause -> how many were held back, and the last of them
        self._turn: Entry | None = None

    def __call__(self, text: str) -> None:
        """Tell it, now or with others."""
        cause = re.split(r"[\d'\"]", text, maxsplit=1)[0]
        if cause not in self._held and len(self._held) >= _CAUSES:
            cause = ""
        if cause in self._held:
            self._held[cause] = self._held[cause][0] + 1, text
            return
        self._held[cause] = 0, ""
        if self._turn is None:
            self._turn = self._scheduler.after(SECOND, self._tell, Kind.TIMER)
        self._say(text)

    def _tell(self) -> None:
        """A second is over. Causes of which there was more are held back for another one."""
        held = {cause: found for cause, found in self._held.items() if found[0]}
        self._held = dict.fromkeys(held, (0, ""))
        self._turn = self._scheduler.after(SECOND, self._tell, Kind.TIMER) if held else None
        for count, text in held.values():
            self._say(f"{text} ({count} like this within a second)" if count > 1 else text)

    def close(self) -> None:
        """Tell no more."""
        if self._turn is not None:
            self._turn.cancel()
