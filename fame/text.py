"""Text from elsewhere: make it printable, and suggest similar names."""

from __future__ import annotations

import re
from collections.abc import Iterable

_ROS_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
NAMES = "letters, digits and _, not starting with a digit"
"""What ROS 2 allows between the slashes of a name."""


def printable(text: str) -> str:
    r"""A text on one line: what is not printable (escape sequences, line ends, marks of direction) as in ``\x1b``.

    Nobody can fake a row of a table or colour a terminal with it. Done twice it is the same as done once.
    """
    if text.isprintable():
        return text
    return "".join(sign if sign.isprintable() else sign.encode("unicode_escape").decode("ascii") for sign in text)


def suggestion(word: str, known: Iterable[str]) -> str:
    """What to use instead of `word`: the closest of the known words, else all of them."""
    from difflib import get_close_matches

    words = list(known)
    close = get_close_matches(word, words, n=1)
    return f"did you mean {close[0]!r}?" if close else f"known are: {', '.join(words) or 'none'}"


def is_ros_name(name: str) -> bool:
    """Whether ROS 2 accepts the full name of a topic or service."""
    return _ROS_NAME.fullmatch(name) is not None
