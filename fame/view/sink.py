"""What would be a recording, given to a page at once: as blocks, without a file."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from typing import Any, NamedTuple

from fame.bpmn.model import Human
from fame.log.recording_file import Sink
from fame.middleware import messages
from fame.middleware.messages import Message
from fame.view.blocks import BlockSize, Packer
from fame.view.catalogue import Catalogue

VERSIONS: Iterator[int] = count()
"""Of missions: no two of a process are the same, also of runs that follow each other on one page."""


class Known(NamedTuple):
    """What a page has: the last block (-1: none) and the part of it, elements, and the status of the run.

    `mission` is another one when what the page got first has changed; its version.
    """

    block: int
    mark: BlockSize | None
    elements: int
    status: str
    mission: int | str


class PageSink(Sink):
    """Takes what a recording would have, in one thread, and gives its blocks to pages in others."""

    def __init__(self, catalogue: Catalogue, robots: Sequence[str] = ()) -> None:
        self.catalogue: Catalogue = catalogue
        self._packer: Packer = Packer(catalogue, robots)
        self._lock: threading.RLock = threading.RLock()
        self._publishers: list[tuple[str, str]] = []  # topic and robot of each channel

    def put(self, topic: str, time: int, data: Mapping[str, Any]) -> None:
        with self._lock:
            self._packer.put(topic, time, data)

    def message_channel(self, topic: str, type: str, node: str) -> int:
        self._publishers.append((topic, node.strip("/").partition("/")[0]))
        return len(self._publishers) - 1

    def message(self, channel: int, time: int, message: Message) -> None:
        with self._lock:
            self._packer.message(time, *self._publishers[channel], messages.to_mapping(message))

    def plane(self, number: int) -> Mapping[str, Any]:
        """Return one drawing. Raises LookupError."""
        with self._lock:
            return self.catalogue.plane_json(number)

    def tasks(self, element: str) -> list[Human]:
        """Return what the tasks with an id say of people."""
        with self._lock:
            return self.catalogue.tasks(element)

    def block(self, number: int) -> Mapping[str, Any]:
        """Return one block. Raises LookupError."""
        with self._lock:
            if not 0 <= number < len(self._packer.blocks):
                raise LookupError(number)
            return self._packer.blocks[number].to_json()

    def growth(
        self, known: Known | None, status: Mapping[str, Any], mission: int | str
    ) -> tuple[Known, list[Mapping[str, Any]]]:
        """Return what is new for a page that has `known`, and what it has afterwards."""
        blocks, elements = self._packer.blocks, len(self.catalogue.elements)
        text = json.dumps(status)
        now = Known(len(blocks) - 1, blocks[-1].mark() if blocks else None, elements, text, mission)
        if known == now:
            return now, []
        news: list[Mapping[str, Any]] = []
        if known is None or known.mission != now.mission:
            news.append({"type": "reload", "version": mission})
        if known is None or known.elements != elements or known.block != now.block:
            first, start = (known.elements, max(0, known.block)) if known is not None else (0, 0)
            index = {"type": "index", "blocks": self._packer.index(start), "end": self._packer.end, "reading": 1}
            news.append(index | {"from": first, "elements": self.catalogue.elements_json(first)})
        for block in blocks[max(0, known.block if known is not None else now.block) :]:
            mark = known.mark if known is not None and block.number == known.block else None
            if mark != block.mark():
                news.append({"type": "data", "block": block.to_json(mark)})
        if known is None or known.status != text:
            news.append(status)
        return now, news
