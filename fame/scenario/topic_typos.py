"""Topics that a robot publishes to nobody, while somebody listens to one of nearly that name: ``cmd_Vel``."""

from __future__ import annotations

import difflib
from collections import defaultdict
from collections.abc import Iterable, Iterator

from fame.middleware.interface import TopicInfo


def unheard(graph: Iterable[TopicInfo]) -> Iterator[tuple[str, str]]:
    """The full name of a node that publishes, and what to say of it. Names are compared within a namespace."""
    heard: dict[str, dict[str, str]] = defaultdict(dict)
    lonely: list[TopicInfo] = []
    for info in graph:
        namespace, _, name = info.name.rpartition("/")
        if info.subscribers:
            heard[namespace][name.lower()] = name
        else:
            lonely.append(info)
    for info in lonely:
        namespace, _, name = info.name.rpartition("/")
        for similar in difflib.get_close_matches(name.lower(), heard[namespace], 1, 0.85):
            for node in dict.fromkeys(info.publishers):
                right = f"{namespace}/{heard[namespace][similar]}"
                yield node, f"publishes on {info.name}, which nobody hears; did you mean {right}?"
