"""The JavaScript engine, and what scripts may spend: memory, stack and time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from fame.errors import UnavailableError

MEMORY = 64 * 2**20
"""Bytes that the scripts of one process instance may hold."""

STACK = 2 * 2**20
"""Bytes of stack, over a thousand calls within calls: endless recursion ends in an error of the script."""

SECONDS = 5.0
"""Processor time of one step (s), as the whole process spends it; built-in functions and regular expressions count."""

REACTIONS = 1_000_000
"""Reactions of promises in one step."""

AT_ONE_INSTANT = 100_000
"""Callbacks of one process instance without time going on."""


def new_context() -> Any:
    """A context with those limits: no file, no network, no module, no function of Python. Raises UnavailableError."""
    try:
        import quickjs
    except ImportError:
        raise UnavailableError("JavaScript needs the engine quickjs-ng: pip install 'fame-robots[js]'") from None
    context = quickjs.Context()
    context.set_memory_limit(MEMORY)
    context.set_max_stack_size(STACK)
    context.set_time_limit(SECONDS)
    return context


@contextmanager
def spare_memory(context: Any) -> Iterator[None]:
    """A little more of it, for saying what happened."""
    context.set_memory_limit(MEMORY + 2**20)
    try:
        yield
    finally:
        context.set_memory_limit(MEMORY)


@cache
def failure() -> type[Exception]:
    """What a context raises."""
    import quickjs

    raised: type[Exception] = quickjs.JSException
    return raised


def explain(text: str) -> str:
    """What the engine says, in words that name the limit. Without memory for an error it throws null."""
    if text == "InternalError: interrupted":
        return f"one step of the script took more than {SECONDS:g} s"
    if text in ("InternalError: out of memory", "[uninitialized]"):
        return f"out of memory: the scripts of one process may hold {MEMORY // 2**20} MB"
    if text == "null":
        return f"null: thrown by the script, or because the {MEMORY // 2**20} MB of its process are used up"
    return text
