"""Why a token waits, in words: the sentences of commands, logs and the page, which gets them with its mission."""

from __future__ import annotations

from collections.abc import Callable, Mapping

SENTENCES: Mapping[str, str] = {
    # what a token waits for
    "complete": "a person to complete it",
    "repair": "a person to repair it",
    "timer": "{kind} timer",
    "topic": "topic {topic}",
    "nobody": "topic {topic}, which no other node publishes",
    "receive": "receive on {topic}",
    "condition": "condition {text}",
    "join": "tokens on its other flows",
    "flows": "a token on {open} of its {all} flows",
    "activation": "another token: its activation condition is false",
    "service": "the service {name} to answer",
    "action": "the action {name} to end",
    "due": "the end of its suspension: it {why}",
    "start": "its start on {topic}",
    "start_at": "its start, due at {moment}",
    # who suspends it
    "suspended": "suspended by {by}",
    "goes_on": "{why}; goes on when {end}",
    "completed": "has been completed",
    "came_due": "has come due",
    "handler_ends": "{handler} has ended",
    "continues": "the robot continues",
    "hold": "a hold of the robot",
    "event_subprocess": "an event sub-process",
    # why that does not come
    "gone": "it has had no server for {time}",
    "silent": "its server has said nothing for {time}",
    "published": "is published by {nodes}",
    "unpublished": "has no publisher",
    "was_gone": "{node} was gone for {time} until {ago} ago: its messages of that time may be lost",
    "no_message": "no message has come since the token waits",
    "last": "its last message came {ago} ago",
    "missed": "did not count: {why}",
    "mismatch": "its correlation keys do not match",
    "unawaited": "nothing waited for it then",
    "before": "before anything waited for it",
    "early": ", before this token waited: it does not count",
    "not_true": "condition {text} is not true:",
    "value": "{name} = {value}",
    "unset": "{name} is not set",
    # who could send it
    "at_work": "is at work: no token of it waits",
    "ended": "has ended: its process publishes {topic} no more",
    "not_started": "has not started its process",
    "stranger": "{node} runs no process that is known: it may publish {topic} at any time",
    "circle": "{robots} wait for each other",
    "ways_out": "what can end that: {ways}",
    "no_way_out": "nothing that is drawn and no other publisher can end that, unless a message is still on its way",
}
"""A name, and the sentence; what is in braces is filled in."""


def sentence(name: str, /, **values: object) -> str:
    """Return a sentence of `SENTENCES` with its values."""
    return SENTENCES[name].format(**values)


def value_text(name: str, values: Mapping[str, object], text: Callable[[object], str]) -> str:
    """Return the value of a variable that a condition reads, as `text` says it, or that it is not set."""
    return sentence("value", name=name, value=text(values[name])) if name in values else sentence("unset", name=name)
