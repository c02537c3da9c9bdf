"""Views of local states: what can happen in one, and what others may notice of it."""

from __future__ import annotations

from collections.abc import Sequence

from fame.check.explore.canonical import Keys, Stimuli
from fame.check.explore.host import ExplorationHost, step_under_way
from fame.check.explore.stimuli import Stimulus
from fame.check.explore.timers import next_timers
from fame.dataclasses import dataclass
from fame.engine import Engine
from fame.engine.state import Mailbox

Interned = dict[frozenset[str], frozenset[str]]
"""Sets of topics, each once."""


@dataclass(frozen=True, slots=True)
class View:
    """What the product needs to know of a local state.

    own        stimuli that may come at any time, and the `elements` that they are for ("": for a topic)
    listens    topics that it takes now
    hears      those of them on which a message may have an effect: it is not just dropped as a start trigger
    listeners  how many tokens and handlers listen to each topic
    stored     topics of messages that are kept for an event with a queue
    instances  how many instances run
    waiting    (element, topic or "") of each token
    """

    own: tuple[Stimulus, ...]
    elements: tuple[str, ...]
    listens: frozenset[str]
    hears: frozenset[str]
    listeners: tuple[tuple[str, int], ...]
    stored: frozenset[str]
    instances: int
    waiting: tuple[tuple[str, str], ...]


def view_of(
    engine: Engine, keys: Keys, accepted: Stimuli, host: ExplorationHost, outside: Sequence[str], topics: Interned
) -> View:
    """Return what can happen in the state that an engine is in; stimuli have the keys of an engine
    revived from the state.

    accepted  the stimuli that the engine accepts
    outside   topics on which anything may come from outside of the team
    """
    own: dict[Stimulus, str] = {}
    for key in sorted(accepted.scripts, key=keys.__getitem__):
        wait, number = accepted.scripts[key], keys[key]
        own["end", number, None] = wait.node.id
        for code in step_under_way(wait).codes:
            own["end", number, code] = wait.node.id
    if accepted.timers:
        for key in sorted(next_timers(host.timers, accepted.timers), key=keys.__getitem__):
            own["timer", keys[key], None] = accepted.timers[key].id
    for wait in accepted.people:
        own["person", wait.node.id, None] = wait.node.id
    for element in accepted.offers:
        own["offer", element, None] = element
    for topic in outside:
        if topic in accepted.topics:
            own["outside", topic, host.blank(topic)] = ""
    listens = topics.setdefault(accepted.topics, accepted.topics)
    dropped = frozenset(topic for topic in listens if _is_dropped(engine, topic))
    hears = topics.setdefault(listens - dropped, listens - dropped)
    listeners = tuple(sorted((topic, len(listening)) for topic, listening in engine.listeners.items()))
    boxes = (one for listening in engine.listeners.values() for one in listening if isinstance(one, Mailbox))
    stored = {box.catch.topic for box in boxes if box.messages}
    stored |= {start.catch.topic for start in engine.waiting_starts if start.catch is not None}
    kept = topics.setdefault(frozenset(stored), frozenset(stored))
    instances = len(engine.instances)
    return View(tuple(own), tuple(own.values()), listens, hears, listeners, kept, instances, accepted.waiting)


def _is_dropped(engine: Engine, topic: str) -> bool:
    """Whether a message on a topic has no effect now: it would start an instance, but as many as may run do."""
    limit = engine.program.instances
    if limit is None or len(engine.instances) < limit or topic in engine.listeners:
        return False
    starts = engine.program.starts[topic]
    return all(one.catch is not None and not one.catch.queue and one.spec.whole is None for one in starts)


def element_of(view: View, stimulus: Stimulus) -> str:
    """Return the id of the element that an own stimulus is for; "" for one of a topic."""
    kind = "end" if stimulus[0] == "block" else stimulus[0]
    return next(one for own, one in zip(view.own, view.elements, strict=True) if own[:2] == (kind, stimulus[1]))
