"""Text that came from elsewhere, made fit to be printed."""

from __future__ import annotations


def printable(text: str) -> str:
    r"""A text on one line: what is not printable (escape sequences, line ends, marks of direction) as in ``\x1b``.

    Nobody can fake a row of a table or colour a terminal with it. Done twice it is the same as done once.
    """
    if text.isprintable():
        return text
    return "".join(sign if sign.isprintable() else sign.encode("unicode_escape").decode("ascii") for sign in text)
