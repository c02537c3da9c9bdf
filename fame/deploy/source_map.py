"""Where in the sender's own files is what a robot tells of the one file that it was sent.

A robot gets its process with all that this calls as one file, which it names after itself. Both sides have the same
processes with the same elements and texts in the same order, so a line of one is found in the other: that of an
element, or any line of a text.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

from fame.bpmn.library import Library
from fame.bpmn.model import Body, Definitions, Process, SubProcess
from fame.bpmn.reader import read_text
from fame.check.expressions import texts_of

Place = tuple[str, int]
"""A file, and a line of it."""


def relocated(
    robot: str, definitions: Definitions, process: Process, library: Library, sent: str
) -> Callable[[str], str]:
    """What replaces the places of a robot's file in a text by those of the files of `definitions`, as far as known.

    `process` is the robot's, `sent` the file that was made of it.
    """
    known = _places(definitions, process, library, sent)
    mention = re.compile(rf"(?<![\w./-]){re.escape(robot)}\.bpmn(?::(\d+))?")

    def own(found: re.Match[str]) -> str:
        if found[1] is None:
            return definitions.file
        place = known.get(int(found[1]))
        return f"{place[0]}:{place[1]}" if place is not None else found[0]

    return lambda text: mention.sub(own, text)


def _places(definitions: Definitions, process: Process, library: Library, sent: str) -> dict[int, Place]:
    """The place of each line that is known."""
    places: dict[int, Place] = {}
    there = read_text(sent).processes
    for other, (home, one) in zip(there, _by_file(library.closure(definitions, process)), strict=False):
        own, theirs = list(_parts(one)), list(_parts(other))
        if [text for _, text in own] == [text for _, text in theirs]:
            for (line, text), (sent_line, _) in zip(own, theirs, strict=True):
                places.update({sent_line + more: (home.file, line + more) for more in range(text.count("\n") + 1)})
    return places


def _by_file(closure: list[tuple[Definitions, Process]]) -> list[tuple[Definitions, Process]]:
    """File by file, in the order of meeting: so are they put together."""
    files = list(dict.fromkeys(home.file for home, _ in closure))
    return sorted(closure, key=lambda found: files.index(found[0].file))


def _parts(process: Process) -> Iterator[tuple[int, str]]:
    """The line of a process, of its elements, and of their texts, each of these with the text.

    A text counts where an element begins on the same line.
    """
    yield process.line, ""
    bodies: list[Body] = [process.body, *(node.body for node in process.body.walk() if isinstance(node, SubProcess))]
    for body in bodies:
        yield from ((element.line, "") for element in (*body.nodes, *body.flows, *body.data_objects))
        yield from ((text.expression.line, text.expression.text) for text in texts_of(body))
