"""Literals as people write them: YAML's core schema, scalars and flow collections.

Of YAML 1.2, not 1.1: ``on``, ``yes``, ``1:30``, ``010`` and dates are what they look like, and ``1e3`` is a number.
Anchors and tags are refused.
"""

from __future__ import annotations

import re
from functools import cache, lru_cache
from typing import Any

_INTEGER = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_BASED = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
_WORDS: dict[str, Any] = {"": None, "~": None, "null": None, "Null": None, "NULL": None}
_WORDS |= {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_WORDS |= {f"{sign}.{word}": float(f"{sign}inf") for sign in ("", "+", "-") for word in ("inf", "Inf", "INF")}
_WORDS |= {f".{word}": float("nan") for word in ("nan", "NaN", "NAN")}


def scalar(text: str) -> Any:
    """The value of a plain scalar (YAML 1.2.2, section 10.3.2).

    >>> scalar("2"), scalar("1e3"), scalar("true"), scalar("on"), scalar("~")
    (2, 1000.0, True, 'on', None)
    """
    if text in _WORDS:
        return _WORDS[text]
    if _INTEGER.fullmatch(text):
        return int(text) if len(text) < 4000 else float(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    return int(text, 0) if _BASED.fullmatch(text) else text


@lru_cache(maxsize=1024)
def flow(text: str) -> Any:
    """The value of a flow collection or quoted scalar: flow-style YAML, of which JSON is a part. Not to be changed.

    Raises ValueError that says where.
    """
    import yaml

    try:
        return yaml.load(text.expandtabs(), _loader())
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f" at letter {mark.index + 1}" if mark is not None else ""
        raise ValueError(f"{error.problem or error.context}{place}") from None
    except (yaml.YAMLError, RecursionError) as error:
        raise ValueError(str(error)) from None


@cache
def _loader() -> Any:
    import yaml

    class Core(yaml.SafeLoader):
        """Plain scalars by `scalar`, quoted ones as texts, and no aliases."""

        yaml_implicit_resolvers = {}  # noqa: RUF012 - the loader's way to have resolvers of its own

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                event = self.peek_event()  # type: ignore[no-untyped-call]
                raise yaml.composer.ComposerError(None, None, f"an alias (*{event.anchor})", event.start_mark)
            return super().compose_node(parent, index)

    Core.add_implicit_resolver("tag:fame:plain", re.compile(""), None)
    Core.add_constructor("tag:fame:plain", lambda loader, node: scalar(node.value))
    return Core
