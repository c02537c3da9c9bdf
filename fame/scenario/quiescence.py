"""Finds out from the reports of a team, each of which comes late, whether nothing runs in it any more."""

from __future__ import annotations

from collections.abc import Mapping


class QuiescenceDetector:
    """Confirms that a team is quiescent once all its robots have said so for a time `long` (ns).

    A report tells of the time before it: that of a robot that is frozen or out of reach says nothing of what has
    reached it since. The first report after such a gap may be older than a message on its way, too. So each robot has
    to report twice, `long` apart, since nothing runs any more and nothing has been done.
    """

    def __init__(self, long: int) -> None:
        self._long = long
        self._since: tuple[int, int] | None = None  # what had been done, and when
        self._first: dict[str, int] = {}  # robot -> when its first report since then came

    def look(self, arrivals: Mapping[str, int], done: int | None, now: int) -> bool:
        """Take when the last report of each robot came (ns), and how much has been done by these reports.

        `done` is None while something runs. Returns whether nothing does for sure. Call it at each report, or more
        often.
        """
        if done is None or self._since is None or self._since[0] != done:
            self._since = (done, now) if done is not None else None
            self._first.clear()
        if self._since is None:
            return False
        for robot, arrival in arrivals.items():
            if arrival >= self._since[1]:
                self._first.setdefault(robot, arrival)
        return not any(self._is_open(robot, arrival) for robot, arrival in arrivals.items())

    def _is_open(self, robot: str, arrival: int) -> bool:
        return robot not in self._first or arrival - self._first[robot] < self._long
