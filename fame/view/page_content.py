"""What of a run is in a page that is a file: without what is private, and thinned as far as it has to be small.

Blocks are changed as the page gets them (`fame.view.blocks`). Events and what tokens wait for are never thinned: the
tokens are where they were. Of what changes often, each span of time keeps the last value, at its time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from fame.clock import SECOND
from fame.errors import ConfigError
from fame.view.blocks import COLUMNS
from fame.view.state import WHATS

ContentEntry = tuple[str, str]
"""A kind, and what of it: the name of a variable or property, a topic, the number of a robot."""
SPANS = tuple(round(seconds * SECOND) for seconds in (0, 0.2, 0.5, 1, 2, 5, 10, 30, 60))
"""ns of which one value is kept, until what is left is small enough; 0: of all."""
_LISTS = {
    "variables": ("variables",),
    "messages": ("messages",),
    "world": ("poses", "world"),
    "properties": ("properties",),
}
KINDS = (*_LISTS, "log", "scripts", "command")
"""What can be left out."""
_LOG = WHATS.index("log")


class PageContent(NamedTuple):
    """What is left out, and what is thinned: entries that are `often`, of each span (ns)."""

    without: frozenset[str] = frozenset()
    span: int = 0
    often: frozenset[ContentEntry] = frozenset()

    def block(self, block: dict[str, Any]) -> dict[str, Any]:
        """Return what is left of a block, which is changed."""
        _leave_out(block, self.without)
        if self.span:
            _thin(block, self.span, self.often)
        return block

    def mission(self, mission: Mapping[str, Any], counts: Counter[ContentEntry]) -> dict[str, Any]:
        """Return what is left of what a page receives first: nothing to control, and what is not there is said."""
        left = {"form", *(("script", "condition") if "scripts" in self.without else ())}
        elements = [{key: each[key] for key in each if key not in left} for each in mission["elements"]]
        chips = [[text, cls, "" if self._hides(text) else about] for text, cls, about in mission["chips"]]
        said = [f"Not in this file: {', '.join(sorted(self.without))}."] if self.without else []
        if self.span:
            said.append(f"Thinned to a value each {self.span / SECOND:g} s: {_named(self.often)}.")
        messages = mission["messages"] and any(kind == "messages" for kind, _ in counts)
        changed = {"elements": elements, "chips": chips, "notices": [*mission["notices"], *said], "messages": messages}
        return {**mission, **changed, "types": {}, "control": []}

    def _hides(self, chip: str) -> bool:
        return chip == "recording" and "command" in self.without


def count(blocks: Iterable[Mapping[str, Any]]) -> Counter[ContentEntry]:
    """Count the changes of each entry in some blocks; what was there before is counted 0 times."""
    counts: Counter[ContentEntry] = Counter()
    for block in blocks:
        counts.update({("variables", name): 0 for _, _, values in block["key"]["variables"] for name in values})
        counts.update(("variables", name) for _, _, _, values, _ in block["variables"] for name in values or ())
        counts.update(("messages", topic) for _, topic, _, _ in block["messages"])
        counts.update(("world", str(robot)) for _, robot, _ in block["poses"])
        counts.update(("properties", change["property"]) for _, change in block["properties"])
        counts.update(("log", WHATS[what]) for what in block["w"] if what >= _LOG)
    return counts


def chosen(words: Iterable[str], counts: Counter[ContentEntry]) -> frozenset[str]:
    """Return what `words` leave out. Raises ConfigError for what is neither a kind nor a topic of the recording."""
    topics = [name for kind, name in counts if kind == "messages"]
    for word in words:
        if word not in KINDS and word not in topics:
            known = f"{', '.join(KINDS)}, or a topic with messages: {', '.join(sorted(topics)) or 'it has none'}"
            raise ConfigError(f"--without {word}: expected {known}")
    return frozenset(words)


def is_left_out(entry: ContentEntry, without: Collection[str]) -> bool:
    """Return whether an entry is left out: by its kind, or as a topic by its name."""
    kind, name = entry
    return kind in without or (kind == "messages" and name in without)


def often(counts: Counter[ContentEntry], span: int, length: int) -> frozenset[ContentEntry]:
    """Return the entries that change more often than once in a span of a run (ns)."""
    kinds = ("variables", "messages", "world")
    return frozenset(entry for entry, number in counts.items() if entry[0] in kinds and number * span > length)


def listing(mission: Mapping[str, Any], counts: Counter[ContentEntry], content: PageContent) -> list[str]:
    """Return what is in the file, in lines."""
    names = {
        kind: [f"{name} ({counts[kind, name]})" for each, name in sorted(counts) if each == kind] for kind in KINDS
    }
    scripts = sum("script" in element for element in mission["elements"])
    found = {
        "models": ", ".join(mission["models"]),
        "robots": ", ".join(robot["name"] for robot in mission["robots"]),
        **{kind: ", ".join(names[kind]) for kind in ("variables", "messages", "properties", "log")},
        "world": "positions of robots" if names["world"] else "",
        "scripts": f"of {scripts} elements" if scripts else "",
        "command": "".join(about for text, _, about in mission["chips"] if text == "recording"),
    }
    lines = [f"{kind}: {'left out' if kind in content.without else text or 'none'}" for kind, text in found.items()]
    return [*lines, *content.mission(mission, counts)["notices"]]


def _leave_out(block: dict[str, Any], without: Collection[str]) -> None:
    key = block["key"]
    for name in (name for kind in _LISTS.keys() & without for name in _LISTS[kind]):
        block[name] = []
        if name in key:
            key[name] = type(key[name])()
    block["messages"] = [
        [time, topic, *rest]
        for time, topic, *rest in block["messages"]
        if not is_left_out(("messages", topic), without)
    ]
    if "log" in without:
        kept = [at for at, what in enumerate(block["w"]) if what < _LOG]
        block["d"] = {str(new): block["d"][str(at)] for new, at in enumerate(kept) if str(at) in block["d"]}
        block |= {name: [block[name][at] for at in kept] for name in COLUMNS}
        waits = [*(tokens for _, _, tokens, _ in block["waits"]), *(tokens for _, tokens in key["waits"])]
        for tokens in waits:
            for token in tokens:
                token.pop("error", None)  # of an incident


def _thin(block: dict[str, Any], span: int, often: Collection[ContentEntry]) -> None:
    seen: dict[Hashable, int] = {}

    def is_last(entry: ContentEntry, place: Hashable, time: int) -> bool:
        """Whether nothing later is kept of its span; in reverse order."""
        last = seen.get((entry, place)) != time // span
        seen[entry, place] = time // span
        return entry not in often or last

    def kept(rows: Sequence[Any], what: Callable[..., tuple[ContentEntry, Hashable, int]]) -> list[Any]:
        return [row for row in reversed(rows) if is_last(*what(*row))][::-1]

    variables = []
    for time, robot, scope, values, gone in reversed(block["variables"]):
        place = robot, scope
        left = values and {name: value for name, value in values.items() if is_last(("variables", name), place, time)}
        if left or values is None or gone:
            variables.append([time, robot, scope, left, gone])
    block["variables"] = variables[::-1]
    block["messages"] = kept(block["messages"], lambda time, topic, sender, _: (("messages", topic), sender, time))
    block["poses"] = kept(block["poses"], lambda time, robot, _: (("world", str(robot)), None, time))


def _named(entries: Iterable[ContentEntry]) -> str:
    names = {kind: sorted(name for each, name in entries if each == kind) for kind in ("variables", "messages")}
    world = ["positions"] if any(kind == "world" for kind, _ in entries) else []
    return ", ".join([*world, *(f"{kind} {' '.join(some)}" for kind, some in names.items() if some)])
