"""Text from elsewhere: make it printable, and suggest similar names."""

from __future__ import annotations

import re
from collections.abc import Iterable

_ROS_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
NAMES = "letters, digits and _, not starting with a digit"
"""The parts of a name that ROS 2 allows between slashes."""


def printable(text: str) -> str:
    r"""A text on one line: what is not printable (escape sequences, line ends, marks of direction) as in ``\x1b``.

    So it cannot fake a row of a table or colour a terminal. The function is idempotent.
    """
    if text.isprintable():
        return text
    return "".join(sign if sign.isprintable() else sign.encode("unicode_escape").decode("ascii") for sign in text)


def suggestion(word: str, known: Iterable[str]) -> str:
    """A hint at the closest known word for `word`, else at all of them."""
    from difflib import get_close_matches

    words = list(known)
    close = get_close_matches(word, words, n=1)
    return f"did you mean {close[0]!r}?" if close else f"known are: {', '.join(words) or 'none'}"


def is_ros_name(name: str) -> bool:
    """Whether ROS 2 accepts the full name of a topic or service."""
    return _ROS_NAME.fullmatch(name) is not None
