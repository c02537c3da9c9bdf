"""Why a token waits, in words: the sentences of commands, logs and the page, which gets them with its mission."""

from __future__ import annotations

from collections.abc import Mapping

SENTENCES: Mapping[str, str] = {
    "service": "the service {name} to answer",
    "action": "the action {name} to end",
    "gone": "it has had no server for {time}",
    "silent": "its server has said nothing for {time}",
    "published": "is published by {nodes}",
    "unpublished": "has no publisher",
    "no_message": "no message has come since the token waits",
    "missed": "did not count: {why}",
    "at_work": "is at work: no token of it waits",
    "circle": "{robots} wait for each other",
    "ways_out": "what can end that: {ways}",
    "no_way_out": "nothing that is drawn and no other publisher can end that, unless a message is still on its way",
}
"""A name, and the sentence; what is in braces is filled in."""


def sentence(name: str, /, **values: object) -> str:
    """Return a sentence of `SENTENCES` with its values."""
    return SENTENCES[name].format(**values)
