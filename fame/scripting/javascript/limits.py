"""The JavaScript engine and the limits of scripts: memory, stack and time."""

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
"""Processor time of one step (s), measured for the whole process; built-in functions count, too."""

REACTIONS = 1_000_000
"""Reactions of promises in one step."""

AT_ONE_INSTANT = 100_000
"""Callbacks of one process instance at one moment."""


def new_context() -> Any:
    """Create a context with these limits, without files, network, modules or Python. Raises UnavailableError."""
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
    """Allow a little more memory, to report what happened."""
    context.set_memory_limit(MEMORY + 2**20)
    try:
        yield
    finally:
        context.set_memory_limit(MEMORY)


@cache
def failure() -> type[Exception]:
    """The exception that a context raises."""
    import quickjs

    raised: type[Exception] = quickjs.JSException
    return raised


def explain(text: str) -> str:
    """The message of the engine, naming the limit that was reached. Without memory for an error it throws null."""
    if text == "InternalError: interrupted":
        return f"one step of the script took more than {SECONDS:g} s"
    if text in ("InternalError: out of memory", "[uninitialized]"):
        return f"out of memory: the scripts of one process may hold {MEMORY // 2**20} MB"
    if text == "null":
        return f"null: thrown by the script, or because the {MEMORY // 2**20} MB of its process are used up"
    return text
