"""What is computed once, since the teams of thousands of seeds compute it again and again: all of it is pure.

The few models are read, checked and split once per text. What several processes of a team receive is read once.
Signatures are digests, of which it is remembered who made them: what nobody in the team has signed is verified.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import lru_cache
from hashlib import sha512
from typing import Any
from unittest.mock import patch

from fame.bpmn import reader, split
from fame.bpmn.reader import document
from fame.check import gate
from fame.deploy import engine_node, envelope, late_joiners, loading, sender, signing, splitter_node

_results: dict[tuple[Any, ...], Any] = {}


@contextmanager
def computed_once() -> Iterator[None]:
    """What is computed of a model alone is kept meanwhile, and for the next time; what is said, meanwhile."""
    with ExitStack() as patches:
        for module, name, key in _FUNCTIONS:
            patches.enter_context(patch.object(module, name, _kept(getattr(module, name), key)))
        patches.enter_context(patch.object(envelope.Report, "from_json", lru_cache(100)(envelope.Report.from_json)))
        patches.enter_context(patch.object(engine_node, "_RESERVE", 1))  # of memory, which costs a tenth of a seed
        # that parts do what the whole does is seen: the reference runs the whole
        patches.enter_context(patch.object(split, "assert_same_reading", lambda part, original: None))
        for name, function in _signing().items():
            patches.enter_context(patch.object(signing, name, function))
        yield


def _signing() -> dict[str, Callable[..., Any]]:
    """The functions that sign and verify."""
    verify, made = signing._has_signed, set[tuple[bytes, bytes, bytes]]()
    public = lru_cache(lambda key: key.public_key().public_bytes_raw())

    def signature(key: Any, part: bytes) -> bytes:
        found = sha512(public(key) + part).digest()
        made.add((public(key), found, part))
        return found

    def has_signed(key: Any, signature: bytes, part: bytes) -> bool:
        return (key.public_bytes_raw(), signature, part) in made or verify(key, signature, part)

    return {"_signature": signature, "_has_signed": has_signed}


def _kept(function: Callable[..., Any], key: Callable[..., tuple[Any, ...]]) -> Callable[..., Any]:
    def once(*arguments: Any, **named: Any) -> Any:
        sought = (function.__name__, *key(*arguments, **named))
        if sought not in _results:
            if len(_results) > 400:  # each seed may draw a mission of its own
                del _results[next(iter(_results))]
            _results[sought] = function(*arguments, **named)
        return _results[sought]

    return once


_FUNCTIONS: tuple[tuple[Any, str, Callable[..., tuple[Any, ...]]], ...] = (
    (reader, "read_text", lambda text, file="", **_: (text, file)),
    (document, "read_bytes", lambda source, **_: (source,)),  # also by another name
    (split, "read_bytes", lambda source, **_: (source,)),
    (sender, "split", lambda definitions, library: (definitions.source,)),
    (splitter_node, "split", lambda definitions, library: (definitions.source,)),
    (late_joiners, "split", lambda definitions, library: (definitions.source,)),
    (sender, "promises", lambda definitions, pools, library: (definitions.source, *sorted(pools))),
    (
        gate,
        "refuse_errors",
        lambda definitions, processes, *_, **__: (definitions.source, *(process.id for process in processes)),
    ),
    (loading, "_read", lambda model, robot, options: (model, robot, options.state is not None)),
)
"""What depends on nothing but a model, and what it depends on."""
