"""Lists and maps of texts as one flow-style YAML text, for the payload language."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable

from fame.bpmn.expressions import is_whole

_PLAIN = re.compile(r"[\w.+-]*")


def scalar(text: str) -> str:
    """A text as an item of flow-style YAML: as it is if it can be one, else in quotes.

    >>> scalar("${x}"), scalar("1.5"), scalar("[1, 2]"), scalar("left, then right")
    ('${x}', '1.5', '[1, 2]', '"left, then right"')
    """
    text = text.strip()
    if _PLAIN.fullmatch(text) and text:
        return text
    if text[:1] + text[-1:] in ("{}", "[]", '""', "''") and len(text) > 1:
        return text
    return text if is_whole(text) else json.dumps(text, ensure_ascii=False)


def listed(items: Iterable[str]) -> str:
    """``[a, b]``"""
    return f"[{', '.join(map(scalar, items))}]"


def mapped_entries(entries: Iterable[tuple[str, str]]) -> str:
    """``{a: 1, b: 2}``"""
    return f"{{{', '.join(f'{scalar(name)}: {scalar(text)}' for name, text in entries)}}}"
