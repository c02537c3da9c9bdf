"""Steps of one robot that no other step can influence or notice: they are explored alone.

A robot that takes no message now, nor after any of its own steps, and sends nothing in them, may go first: whatever the
others do, they can do it afterwards as well.
"""

from __future__ import annotations

from fame.check.explore.product import Move, Product


class Reduction:
    """Finds such steps of the robots of one product."""

    def __init__(self, product: Product) -> None:
        self.product = product

    def moves(self, robot: int, state: int) -> tuple[Move, ...]:
        """The moves that may be explored alone in a local state; none if there are no such."""
        moves = self.product.own(robot, state)
        if not moves or not all(map(self._is_silent, moves)):
            return ()
        views = self.product.locals[robot].views
        heard = self._foreign(robot)
        if any(views[one].listens & heard for one in (state, *(move.state for move in moves))):
            return ()
        return moves

    def _is_silent(self, move: Move) -> bool:
        return not (move.sending or move.way.flags or move.mark)

    def _foreign(self, robot: int) -> frozenset[str]:
        """The topics on which another robot may send to it."""
        topics = self.product.locals[robot].topics
        return frozenset(topic for topic in topics if topic[0] == "/") if self.product.count > 1 else frozenset()
