"""Models that are read, checked and split once per text: the teams of thousands of seeds run the same few."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest.mock import patch

from fame.bpmn import reader
from fame.check import gate
from fame.deploy import loading, sender, splitter_node

_results: dict[tuple[Any, ...], Any] = {}


@contextmanager
def each_model_once() -> Iterator[None]:
    """What is computed of a model alone is kept meanwhile, and for the next time."""
    with ExitStack() as patches:
        for module, name, key in _FUNCTIONS:
            patches.enter_context(patch.object(module, name, _kept(getattr(module, name), key)))
        yield


def _kept(function: Callable[..., Any], key: Callable[..., tuple[Any, ...]]) -> Callable[..., Any]:
    def once(*arguments: Any, **named: Any) -> Any:
        sought = (function.__name__, *key(*arguments, **named))
        if sought not in _results:
            _results[sought] = function(*arguments, **named)
        return _results[sought]

    return once


_FUNCTIONS: tuple[tuple[Any, str, Callable[..., tuple[Any, ...]]], ...] = (
    (reader, "read_text", lambda text, file="", **_: (text, file)),
    (sender, "split", lambda definitions, library: (definitions.source,)),
    (splitter_node, "split", lambda definitions, library: (definitions.source,)),
    (sender, "promises", lambda definitions, pools, library: (definitions.source, *sorted(pools))),
    (
        gate,
        "refuse_errors",
        lambda definitions, processes, *_, **__: (definitions.source, *(process.id for process in processes)),
    ),
    (loading, "_read", lambda model, robot, options: (model, robot, options.state is not None)),
)
"""What depends on nothing but a model, and what it depends on."""
