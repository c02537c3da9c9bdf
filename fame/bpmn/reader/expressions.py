"""Decides which language a text is written in. `fame.scripting` compiles the text.

JavaScript counts where it is named. Otherwise the form of the text decides (``=...`` is FEEL, ``${...}`` is Camunda 7),
then the language that the element or the file (expressionLanguage) names. The default is Python.
"""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Iterable
from dataclasses import replace
from typing import Literal

from fame.bpmn.model import Expression, Language
from fame.bpmn.reader.context import Context
from fame.bpmn.reader.xml import Node, line_of, local_name, text_of
from fame.text import ros_name

_LANGUAGES: dict[str, Language | None] = {
    **dict.fromkeys(("", "http://www.w3.org/1999/xpath", "http://www.w3.org/tr/xpath"), None),
    "http://www.w3.org/2001/xmlschema": None,
    **dict.fromkeys(("python", "python3", "text/python", "text/x-python", "application/python"), "python"),
    **dict.fromkeys(("javascript", "js", "javascript()", "ecmascript"), "javascript"),
    **dict.fromkeys(("text/javascript", "application/javascript"), "javascript"),
    "http://www.javascript.com/javascript": "javascript",
    "feel": "feel",
    "juel": "juel",
}
"""Language names in files. XPath is the default of the standard, so it counts as unspecified (None)."""
_FEEL = re.compile(r"https?://(www\.)?omg\.org/spec/(dmn/[0-9]+/feel|feel/[0-9]+)/?")
"""The namespaces of FEEL and of the versions of DMN."""
_ACCEPTED = "expected python (the default), javascript, ${...} or =..."
_NAME = re.compile(r"[^\W\d]\w*")


def language_of(context: Context, element: Node, language: str) -> Language | Literal["unknown"] | None:
    """Return the language with that name, None if unspecified. An unknown language is a fault."""
    name = language.strip().lower()
    if _FEEL.fullmatch(name):
        return "feel"
    if name not in _LANGUAGES:
        context.fault(element, f"language {language!r}: {_ACCEPTED}")
        return "unknown"
    return _LANGUAGES[name]


def is_single_expression(text: str) -> bool:
    """Return whether a text is a single ``${...}`` or ``#{...}``.

    >>> is_single_expression("${a + 1}"), is_single_expression("${a}-${b}"), is_single_expression("${ {'}': 1} }")
    (True, False, True)
    """
    if text[:2] not in ("${", "#{") or text[-1] != "}":
        return False
    depth, quote, escaped = 0, "", False
    for place, letter in enumerate(text):
        if escaped or (quote and letter == "\\"):
            escaped = not escaped
        elif quote:
            quote = "" if letter == quote else quote
        elif letter in "'\"":
            quote = letter
        elif letter == "{":
            depth += 1
        elif letter == "}":
            depth -= 1
            if not depth:
                return place == len(text) - 1
    return False


def is_name(text: str) -> bool:
    """Return whether a text is a valid variable name."""
    return _NAME.fullmatch(text) is not None


def variable_name(element: Node) -> str:
    """Return the variable of a data element: its name if that is a valid variable name, else its id.

    An id such as ``_12`` cannot be read in expressions: then its name with one ``_`` for each run of other characters.
    """
    name = element.get("name", "").strip()
    own = re.sub(r"\W|^(?=\d)", "_", element.get("id", ""))
    return name if is_name(name) else ros_name(name) if own.startswith("_") and is_name(ros_name(name)) else own


def has_placeholders(text: str) -> bool:
    """Return whether a text contains ``${...}`` or ``#{...}``."""
    return "${" in text or "#{" in text


def by_form(text: str, line: int) -> Expression | None:
    """Return the expression, if the form of the text decides its language; else None."""
    if text.startswith("="):
        return Expression(text[1:].strip(), "feel", line)
    if is_single_expression(text):
        return Expression(text, "juel", line)
    return None


def code_expression(context: Context, element: Node, text: str, language: str | None, line: int) -> Expression | None:
    """Return a condition, script or other code. None for a text in no known language, which is a fault."""
    language_name = language_of(context, element, language or context.language)
    if language_name == "unknown":
        return None
    if language_name == "javascript":
        return Expression(text, language_name, line)
    recognised = by_form(text, line)
    if recognised is not None:
        return recognised
    if language_name is None and has_placeholders(text) and local_name(element) != "script":
        context.fault(element, f"{text!r} mixes text and ${{...}}: put all of it into one ${{...}}")
        return None
    if language_name == "juel":
        return Expression(f"${{{text}}}", language_name, line)
    return Expression(text, language_name or "python", line)


def code_of(context: Context, element: Node, language: str | None = None) -> Expression | None:
    """Return the text of an element as code, with the line of its first line; None if it is empty, or after a fault."""
    text, line = _block(element)
    return code_expression(context, element, text, language or element.get("language"), line) if text else None


def condition_of(context: Context, element: Node) -> Expression | None:
    """Return the text of an element as a condition; None as for `code_of`."""
    expression = code_of(context, element)
    return None if expression is None else replace(expression, condition=True)


def timer_text(context: Context, element: Node) -> Expression | None:
    """Return the text of an element that is usually a literal (a timer): an expression by its form, else a template."""
    text, line = _block(element)
    if not text:
        return None
    language_name = element.get("language")
    if language_name and language_of(context, element, language_name) is not None:
        return code_expression(context, element, text, language_name, line)
    return by_form(text, line) or Expression(text, "template", line)


def mapping_source(text: str, line: int) -> Expression:
    """Return the source of a mapping: an expression by its form, a template if it contains
    ``${...}``, else a YAML scalar."""
    text = text.strip()
    return by_form(text, line) or Expression(text, "template" if has_placeholders(text) else "value", line)


def variable_or_expression(context: Context, element: Node, text: str) -> Expression | None:
    """Return an attribute with a variable name or an expression. None for another text, which is a fault."""
    text, line = text.strip(), line_of(element)
    recognised = by_form(text, line)
    if recognised is not None:
        return recognised
    if not _NAME.fullmatch(text):
        right = f"; the constant is ${{{text}}}" if text.lstrip("+-").replace(".", "", 1).isdecimal() else ""
        context.fault(element, f"{text!r}: expected the name of a variable, ${{...}} or =...{right}")
        return None
    return Expression(text, "python", line)


def _block(element: Node) -> tuple[str, int]:
    text, line = text_of(element), line_of(element)
    if "\n" not in text:
        return text.strip(), line
    lines = text.split("\n")
    first = next((number for number, content in enumerate(lines) if content.strip()), 0)
    return textwrap.dedent("\n".join(lines[first:])).rstrip(), line + first


_PLAIN = re.compile(r"[\w.+-]*")


def scalar(text: str) -> str:
    """Return a text as an item of flow-style YAML, quoted if necessary.

    >>> scalar("${x}"), scalar("1.5"), scalar("[1, 2]"), scalar("left, then right")
    ('${x}', '1.5', '[1, 2]', '"left, then right"')
    """
    text = text.strip()
    if _PLAIN.fullmatch(text) and text:
        return text
    if text[:1] + text[-1:] in ("{}", "[]", '""', "''") and len(text) > 1:
        return text
    return text if is_single_expression(text) else json.dumps(text, ensure_ascii=False)


def flow_sequence(items: Iterable[str]) -> str:
    """Texts as a flow-style list: ``[a, b]``."""
    return f"[{', '.join(map(scalar, items))}]"


def flow_mapping(entries: Iterable[tuple[str, str]]) -> str:
    """Names and texts as a flow-style map: ``{a: 1, b: 2}``."""
    return f"{{{', '.join(f'{scalar(name)}: {scalar(text)}' for name, text in entries)}}}"
