"""The identifiers in a script, found before it runs: whether it calls next(), and the variables that it names.

The text is not parsed. Comments and string literals are removed, and the rest is searched for the usual ways to access
variables. Any other access makes the names *open*: the script may use further variables.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

_LITERAL = re.compile(
    r"""//[^\n]* | /\*.*?\*/ | '(?:\\.|[^'\\\n])*' | "(?:\\.|[^"\\\n])*" | `(?:\\.|[^`\\])*`""", re.VERBOSE | re.DOTALL
)
_INSIDE = re.compile(r"\$\{([^{}]*)\}")
_NAME = r"[^\W\d][\w$]*"
_BEHIND = r"(?<![\w$])(?:(?:this|\w+)\s*\.\s*)?environment\s*\??\.\s*variables\b"
_ALIAS = re.compile(rf"\b(?:const|let|var)\s+({_NAME})\s*=\s*{_BEHIND}\s*(?=[;,\n}}]|$)")
_TAKEN = re.compile(rf"\{{([^{{}}]*)\}}\s*=\s*(?:{_BEHIND}|({_NAME}))\s*(?=[;,\n}}]|$)")
_SET = re.compile(r"\s*(?:=(?![=>])|[-+*/%&|^]=|\*\*=|\|\|=|&&=|\?\?=|<<=|>>=|\+\+|--)")
_CHANGE = re.compile(r"\s*(?:[-+*/%&|^]=|\*\*=|<<=|>>=|\+\+|--)")
_NODES = ("ros_node", "node")


@dataclass(frozen=True, slots=True)
class Identifiers:
    """The identifiers in one text.

    reads, writes  the variables that it names
    open           whether it may read and set other variables, too
    next           whether it names next
    node           whether it uses node for ros_node
    subscribes     whether it creates a subscription; `destroys`: whether it destroys one
    """

    reads: frozenset[str]
    writes: frozenset[str]
    open: bool
    next: bool
    node: bool
    subscribes: bool
    destroys: bool


def identifiers_of(text: str) -> Identifiers:
    """Find the identifiers of a script or condition.

    >>> found = identifiers_of("const env = this.environment.variables; env.x = env.y + 1; next(); // env.z")
    >>> sorted(found.reads), sorted(found.writes), found.open, found.next
    (['y'], ['x'], False, True)
    """
    code = _LITERAL.sub(_without, text)
    reads, writes = set[str](), set[str]()
    aliases = [found[1] for found in _ALIAS.finditer(code)]
    code = _ALIAS.sub("", code)
    objects = "|".join([_BEHIND, *(rf"(?<![\w$.]){alias}\b" for alias in aliases)])
    for found in _TAKEN.finditer(code):
        if found[2] is None or found[2] in aliases:
            reads |= {name.partition(":")[0].partition("=")[0].strip() for name in found[1].split(",")}
    code = _TAKEN.sub(lambda found: "" if found[2] is None or found[2] in aliases else found[0], code)
    is_open = False
    for found in re.finditer(rf"(?:{objects})(?:\s*\??\.\s*({_NAME}))?", code):
        name, after = found[1], code[found.end() :]
        if name is None:
            is_open = True
        elif _SET.match(after) or code[: found.start()].rstrip().endswith(("++", "--", "delete")):
            writes.add(name)
            reads |= {name} if _CHANGE.match(after) else set()
        else:
            reads.add(name)
    is_open |= "environment" in re.sub(_BEHIND, "", code)
    names_node = "node" in reads
    return Identifiers(
        frozenset(reads - {"", *_NODES}),
        frozenset(writes),
        is_open,
        re.search(r"\bnext\b", code) is not None,
        names_node,
        "createSubscription" in code,
        "destroySubscription" in code,
    )


def _without(found: re.Match[str]) -> str:
    """What remains of a comment or string literal: a blank, or the expressions of a template."""
    if found[0][0] != "`":
        return '""' if found[0][0] in "'\"" else " "
    return " ".join(("", *_INSIDE.findall(found[0]), ""))
