"""Boundary events and starts of event sub-processes that are armed in a state, in another program.

Such an event keeps its state (whether it has happened, when its timer is due, what it has received) where the activity
or scope that it belongs to is at the same place in both programs: the same one, one around it, or one in it. Where that
could be several, or the event is of another kind, it is armed anew: `ArmedEvents.changes` says so.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator

from fame.engine.encoding import Data
from fame.engine.places import Places
from fame.engine.program import Program


class ArmedEvents:
    """The armed events of a state whose tokens are placed.

    kept  for the key of an event in the new program, and that of its owner there: the wait that is armed for it
    """

    def __init__(self, places: Places, old: Program, new: Program, node: Callable[[str | None], str | None]) -> None:
        self._places, self._old, self._new, self._node = places, old, new, node
        self._kept: dict[tuple[str, int], int] = {}
        self._owners: dict[str, list[int]] = defaultdict(list)
        for item in (*places.scopes.values(), *places.waits.values()):
            if item["key"] not in places.gone and item.get("token", True):
                for event in places.arming(item):
                    self._owners[event.key].append(item["key"])
        self._events = [wait for wait in places.waits.values() if self._is_event(wait)]

    def _is_event(self, wait: Data) -> bool:
        """Return whether a wait is armed beside tokens: no alternative of a gateway, no part of a parallel event."""
        owner = self._places.waits.get(wait["owner"])
        if wait["token"] or (owner is not None and not owner["token"]):
            return False
        return self._places.before[self._element(wait)].place in ("boundary", "start")

    def _element(self, wait: Data) -> str:
        return self._old.by_key[wait["node"]].id

    def move(self, anew: Collection[str]) -> None:
        """Move each event to its owner in the new program; drop those of the elements that are to be armed anew."""
        places, moving = self._places, defaultdict[str, list[Data]](list)
        for wait in self._events:
            key, owner = self._node(wait["node"]), wait["owner"]
            if self._element(wait) in anew:
                places.drop(wait)
            elif key is not None and owner in self._owners[key]:
                self._kept[key, owner] = wait["key"]
            elif key is not None:
                moving[key].append(wait)
        for key, waits in moving.items():
            found = self._possible_owners(key, waits)
            claims = Counter(owner for _, owners in found for owner in owners)
            for wait, owners in found:
                if len(owners) == claims[owners[0]] == 1 and places.take_over(wait, owners[0]):
                    self._kept[key, owners[0]] = wait["key"]

    def _possible_owners(self, key: str, waits: list[Data]) -> list[tuple[Data, list[int]]]:
        """Return the waits of an event with the tokens that lack it and are around that of its old owner, or in it."""
        free = {owner for owner in self._owners[key] if (key, owner) not in self._kept}
        inside, found = defaultdict[int, list[int]](list), list[tuple[Data, list[int]]]()
        for owner in free:
            for outer in self._places.around(owner):
                inside[outer].append(owner)
        for wait in waits:
            there = self._places.successor(wait["owner"])
            if there is not None:
                around = [each for each in self._places.around(there) if each in free and each != there]
                found += [(wait, owners)] if (owners := [*inside[there], *around]) else []
        return found

    def changes(self, target: Callable[[str], str], now: Collection[str]) -> Iterator[tuple[int, str, str]]:
        """Yield the key of a token, and the new id of an event there that loses its state, with a text for it."""
        before, anew = {target(node.id) for node in self._old.nodes}, set[tuple[int, str]]()
        for key, owners in self._owners.items():
            element = self._new.by_key[key].id
            for owner in owners if element in before else ():
                if (key, owner) not in self._kept:
                    anew.add((owner, element))
        yield from ((owner, element, "arms {} anew") for owner, element in sorted(anew))
        named, kept = {(self._root(owner), element) for owner, element in anew}, set(self._kept.values())
        for wait in self._events:
            element, there = target(self._element(wait)), self._places.successor(wait["owner"])
            if wait["key"] in kept or there is None or element not in now:
                continue
            if (self._root(there), element) not in named:
                yield there, element, "closes {}"

    def _root(self, key: int) -> int:
        *_, root = self._places.around(key)
        return root
