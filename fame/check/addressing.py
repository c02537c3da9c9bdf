"""Messages to a pool of many robots: without the property ``to`` each of them gets each message."""

from __future__ import annotations

from collections.abc import Iterator

from fame.bpmn.topics import TopicEnd, topic_table
from fame.check.findings import Finding
from fame.check.scope import Subject, Unit
from fame.errors import ModelError


def addressing_findings(subject: Subject) -> Iterator[Finding]:
    """Of the messages that are thrown."""
    pools = {pool.process: pool.name for pool in subject.definitions.participants if pool.multi_instance}
    units = [unit for unit in subject.units if subject.has_pool(unit)] if pools else []
    many = {
        topic: pools[unit.process.id]
        for unit in units
        if unit.process.id in pools
        for topic, ends in _messages(unit, throws=False).items()
        if ends
    }
    for unit in units:
        for topic, ends in _messages(unit, throws=True).items():
            for end in ends if topic in many else ():
                if end.topic.to is None:
                    text = f"its message {topic} reaches every robot of the pool {many[topic]}"
                    yield unit.finding("warning", f"{text}: property to says which one it is for", end.node)


def _messages(unit: Unit, *, throws: bool) -> dict[str, list[TopicEnd]]:
    """What throws or catches messages in a process and all that it calls, by topic."""
    found: dict[str, list[TopicEnd]] = {}
    for one in unit.closure():
        try:
            table = topic_table(one.home, [one.process.id])
        except ModelError:  # which is told as an error
            continue
        for topic, use in table.items():
            ends = use.throws if throws else use.catches
            found.setdefault(topic, []).extend(end for end in ends if end.is_message)
    return found
