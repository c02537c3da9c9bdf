"""The effects of a text in JavaScript, which is not parsed.

Comments and string literals are removed, and the rest is searched for the usual ways to access variables
(``this.environment.variables``). Any other access makes the names *open*: the text may use further variables.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

from fame.scripting.effects import NONE, Direction, Effects, JavaScriptCalls, ScriptTopic

_MAKES: dict[str, Direction] = {"Publisher": "publish", "Subscription": "subscribe", "Client": "call"}
_MADE = re.compile(
    r"""\bcreate(?P<kind>Publisher|Subscription|Client)\s*\(
    \s*(?P<q>["'`])(?P<type>[\w/]+)(?P=q)\s*,\s*(?P<r>["'`])(?P<name>[\w/~]+)(?P=r)\s*[,)]""",
    re.VERBOSE,
)
_MAKER = re.compile(r"\bcreate(Publisher|Subscription|Client)\b")
_LITERAL = re.compile(
    r"""(?P<comment>//[^\n]* | /\*.*?\*/) | '(?:\\.|[^'\\\n])*' | "(?:\\.|[^"\\\n])*" | `(?:\\.|[^`\\])*`
    | (?P<before>(?:^|[(,=:\[!&|?{};~^%*<>]|(?<!\+)\+|(?<!-)-|\b(?:return|typeof|case|in|of|do|else|void|throw))\s*)
      /(?![/*]) (?:\\.|\[(?:\\.|[^\]\\\n])*\]|[^/\\\[\n])+ /\w*""",
    re.VERBOSE | re.DOTALL,
)
"""A comment, a string, a template, or a regular expression, which stands `before` what no operand ends."""
_INSIDE = re.compile(r"\$\{([^{}]*)\}")
_UNKNOWN = " environment "
"""In place of what is not understood: it makes the names open."""
_NAME = r"[^\W\d][\w$]*"
_BEHIND = r"(?<![\w$])(?:(?:this|\w+)\s*\.\s*)?environment\s*\??\.\s*variables\b"
_OF_THIS = r"\bthis\s*\.\s*(?:clearTimeout|console|content|fields|id|logger|next|properties|setTimeout|type)\b"
_REACHES_ALL = re.compile(r"\b(?:constructor|environment|eval|Function|globalThis|import|this)\b|\\")
"""How a text gets at all variables by other ways than `_BEHIND`; a backslash hides a word."""
_OVER = r"\s*(?=[;,}]|\n(?!\s*[.?\[(])|$)"
_ALIAS = re.compile(rf"\b(?:const|let|var)\s+({_NAME})\s*=\s*{_BEHIND}{_OVER}")
_THIS = re.compile(rf"\b(?:const|let|var)\s+({_NAME})\s*=\s*this{_OVER}")
_FIELD = rf"\s*{_NAME}\s*(?::\s*{_NAME}\s*)?(?:=\s*(?:\"\"|-?[\d.]+|true|false|null)\s*)?"
_TAKEN = re.compile(rf"\{{({_FIELD}(?:,{_FIELD})*,?\s*)\}}\s*=\s*(?:{_BEHIND}|({_NAME})){_OVER}")
_CHANGES = r"[-+*/%&|^]=|\*\*=|\|\|=|&&=|\?\?=|<<=|>>>?="
_COUNTS = r"\s*(?:\+\+|--)|[\s)]+(?:\+\+|--)(?![ \t]*[\w$(\[])"
"""What counts the member before it: ``(x.n)++``, but not ``if (x.n) ++m``."""
_CHANGE = re.compile(rf"[\s)]*(?:{_CHANGES})|{_COUNTS}")
_SET = re.compile(rf"[\s)]*=(?![=>])|{_CHANGE.pattern}")
_FOR = re.compile(r"\bfor(?:\s+await)?$")
_BRACKET = re.compile(r"[(\[{}\])]")
_PATTERN = re.compile(r"(?:^|[^\w$\]\s]|\b(?:else|return|yield|await|throw|case|do|typeof|void))\s*([\[{])")
"""Where a pattern may begin that an assignment or a loop takes apart: behind what no operand ends, or ``if (...)``."""
_NODES = ("ros_node", "node")
_FUNCTION = re.compile(
    r"\bfunction\b|=>|\bclass\b|\]\s*\("
    r"|(?:\"|\b(?!(?:if|for|while|switch|catch|with)\b)[\w$]+)\s*\((?:[^()]|\([^()]*\))*\)\s*\{"
)
_HARMLESS = re.compile(
    r"(?<![\w$.])(?:(?:Math|Number|console)\s*\.\s*\w+|Date\s*\.\s*now|next|Number|String|Boolean|parseInt|parseFloat|isNaN"
    r"|isFinite|if|for|while|switch|return|typeof|else|do|case|in|of)\s*(?=\()"
)
_IN_PLACE = re.compile(
    rf"""[\w$\])]\s*(?:\?\.\s*)?\( | (?:\.\s*{_NAME}|[\]}}])(?:{_SET.pattern}|[\s)]+(?:of|in)\b) | \bdelete\b
    | (?:\+\+|--)[\s(]*[\w$]+\s*[.\[]""",
    re.VERBOSE,
)
"""A call, or what sets, counts or deletes a member."""
_UNSEEN = re.compile(
    r"""\b(Function|with|Proxy|Reflect|Symbol|prototype|defineProperty|defineProperties)\b|\b[gs]et\s+[\w$[\"']"""
    r"""|\b(valueOf|toString|toJSON)\s*([:=](?!=)|\([^()]*\)\s*\{)"""
)
"""How a text may set variables unseen, or change what a comparison means."""
_STEADY_NAMES = ("Infinity", "NaN", "environment", "this", "undefined")
_STEADY_WORDS = {"Infinity", "NaN", "undefined", "true", "false", "null", "typeof"}
_STRING = re.compile(r"""'[^'\\]*'|"[^"\\]*\"""")
_VARIABLE = re.compile(r"\bthis\.environment\.variables(\??\.(?!ros_node\b|node\b)[\w$]+)+")
_NEXT = re.compile(
    r"""(?<![\w$.])next\b | \bthis\s*\??\.\s*next\b | (?<=\.)\s*next\b(?=\s*(?:\?\.\s*)?\((?!\s*\)))""", re.VERBOSE
)
"""The callback of a script; of another object, a method of this name with an argument."""
_WITHOUT_ERROR = re.compile(r"\s*(?:\?\.\s*)?\(\s*(?:null|undefined|false)?\s*[,)]")
_ENDS_LATER = re.compile(rf"\bsetTimeout\s*\(\s*(?:{_NEXT.pattern})\s*(?:,\s*[\w.$]+\s*)?\)", re.VERBOSE)
_SURE_CALL = re.compile(
    r"(?<![\w$.])(?:(?:this\s*\.\s*)?next|Math\s*\.\s*(?!random)\w+|console\s*\.\s*(?:log|info|debug|warn|error)|Number|String"
    r"|Boolean|parseInt|parseFloat|isNaN|isFinite)\s*(?=\()|\b(?:Math\s*\.\s*(?:PI|E))\b"
)
_DECLARED = re.compile(rf"\b(?:const|let|var)\s+({_NAME})\s*=(?!=)")
_SURE_WORD = re.compile(r"\b(?:if|else|true|false|null|undefined|NaN|Infinity|typeof|return)\b")
_MAY_MISMATCH = re.compile(r"[\[\]`?.]|=>|[A-Za-z_$]|[\w)]\s*\(")
"""A member, a call, a name that is not declared: what it is of may be undefined."""
_EFFECT = re.compile(r"[\w$\])]\s*(\?\.)?\(|[`/]|\+\+|--|=>|>>=|<<=|(?<![=!<>])=(?!=)")
"""A call, an assignment, or what hides one."""


class _Found(NamedTuple):
    """What the search of a text finds.

    functions  whether it makes functions, which may run later
    changes    whether it may change lists or objects: by calls, or by setting members
    """

    reads: frozenset[str]
    sets: frozenset[str]
    open: bool
    functions: bool
    changes: bool
    calls: JavaScriptCalls


class JavaScriptEffects(Effects):
    """The effects of a text in JavaScript.

    >>> from fame.bpmn.model import Expression
    >>> text = "const env = this.environment.variables; env.x = env.y + 1; // env.z"
    >>> found = JavaScriptEffects(Expression(text, "javascript"), True)
    >>> sorted(found.reads), sorted(found.sets), found.open
    (['y'], ['x'], False)
    """

    @cached_property
    def _found(self) -> _Found:
        return _search(self.expression.text)

    @property
    def reads(self) -> frozenset[str]:
        return self._found.reads

    @property
    def sets(self) -> frozenset[str]:
        return self._found.sets

    @property
    def open(self) -> bool:
        return self._found.open

    @property
    def may_change(self) -> frozenset[str]:
        return self.reads if self._found.changes else NONE

    @property
    def later(self) -> frozenset[str]:
        if self._found.functions:
            return self.sets | self.reads | ({""} if self.open else NONE)
        return NONE if self.script else self.sets  # a condition is asked at any time

    @cached_property
    def unseen(self) -> bool:
        text = self.expression.text
        return super().unseen or self.open or _UNSEEN.search(text) is not None

    @property
    def calls(self) -> JavaScriptCalls:
        return self._found.calls

    @cached_property
    def topics(self) -> tuple[ScriptTopic, ...]:
        return tuple(dict.fromkeys(self._endpoints()))

    def _endpoints(self) -> Iterator[ScriptTopic]:
        """The endpoints that it creates with literal type and topic."""
        text = self._uncommented
        for made in _MADE.finditer(text):
            line = self.expression.line + text.count("\n", 0, made.start())
            yield ScriptTopic(made["name"], _MAKES[made["kind"]], made["type"], line)

    @property
    def _uncommented(self) -> str:
        code = self.expression.text
        return _LITERAL.sub(lambda found: "\n" * found[0].count("\n") if found["comment"] else found[0], code)

    @cached_property
    def computed(self) -> frozenset[tuple[Direction, str]]:
        return frozenset((_MAKES[kind], "") for kind in _MAKER.findall(_MADE.sub("", self._uncommented)))

    @property
    def codes(self) -> None:
        return None

    @cached_property
    def fails(self) -> bool:
        if super().fails:
            return True
        code = _ENDS_LATER.sub("", _LITERAL.sub(_without, self.expression.text))
        return any(not _WITHOUT_ERROR.match(code, found.end()) for found in _NEXT.finditer(code))

    @cached_property
    def may_mismatch(self) -> bool:
        """Whether it does more than compute with variables and literals, and set them: of these nothing is refused."""
        code = _LITERAL.sub(_without, self.expression.text)
        aliases, code = _ALIAS.findall(code), _ALIAS.sub("", code)
        for alias in aliases:
            code = re.sub(rf"(?<![\w$.]){re.escape(alias)}(?![\w$])", "this.environment.variables", code)
        code = _SURE_CALL.sub(" ", re.sub(rf"{_BEHIND}\s*\.\s*{_NAME}", "0", code))
        for name in _DECLARED.findall(code):
            once = re.search(rf"\bconst\s+{re.escape(name)}(?![\w$])", code) is not None
            if once and len(re.findall(rf"(?<![\w$.]){re.escape(name)}(?![\w$])(?:{_SET.pattern})", code)) > 1:
                return True  # it is set again
            code = re.sub(rf"(?<![\w$.]){re.escape(name)}(?![\w$])", "0", code)
        code = re.sub(r"\b(?:const|let|var)\b|\d+\.\d*|\?(?![.?])", " ", _SURE_WORD.sub(";", code))
        return _MAY_MISMATCH.search(code) is not None

    @property
    def waits(self) -> bool:
        return "await" in self.expression.text

    @cached_property
    def steady(self) -> bool:
        if self.condition is not None:
            return all(map(_is_steady, ast.walk(self.condition)))
        left = _VARIABLE.sub("0", _STRING.sub("0", self.expression.text))  # a form that Python does not have
        return not _EFFECT.search(left) and {*re.findall(r"[A-Za-z_$][\w$]*", left)} <= _STEADY_WORDS


def _is_steady(node: ast.AST) -> bool:
    """Whether a part of a condition, read as Python, only reads variables, by ``environment.variables``."""
    if isinstance(node, ast.Attribute):
        of_this = isinstance(node.value, ast.Name) and node.value.id == "this"
        return node.attr == "environment" if of_this else node.attr not in ("node", "ros_node")
    return not isinstance(node, ast.Call | ast.NamedExpr | ast.Lambda | ast.Await) and (
        not isinstance(node, ast.Name) or node.id in _STEADY_NAMES
    )


def _search(text: str) -> _Found:
    code = _LITERAL.sub(_without, text)
    reads = set[str]()
    for name in _THIS.findall(code):  # whatever else becomes of the name makes the names open, as `this` does
        code = re.sub(rf"(?<![\w$.]){re.escape(name)}(?![\w$])", "this", _THIS.sub("", code))
    aliases = [found[1] for found in _ALIAS.finditer(code)]
    code = _ALIAS.sub("", code)
    objects = "|".join([_BEHIND, *(rf"(?<![\w$.]){re.escape(alias)}(?![\w$])" for alias in aliases)])
    for found in _TAKEN.finditer(code):
        if found[2] is None or found[2] in aliases:
            reads |= {name.partition(":")[0].partition("=")[0].strip() for name in found[1].split(",")}
    code = _TAKEN.sub(lambda found: "" if found[2] is None or found[2] in aliases else found[0], code)
    accessed, sets, is_open = _accesses(code, objects)
    reads |= accessed
    is_open |= _REACHES_ALL.search(re.sub(rf"{_BEHIND}|{_OF_THIS}", "", code)) is not None
    functions = _FUNCTION.search(code) is not None
    members = re.sub(rf"(?:{objects})\s*\??\.\s*", "$", code)
    in_place = _IN_PLACE.search(_HARMLESS.sub("", members)) is not None or re.search(r"[\w$\])]\s*`", text) is not None
    next_called = re.search(r"(?<![\w$])next\b", members) is not None
    calls = JavaScriptCalls(next_called, "node" in reads, "createSubscription" in code, "destroySubscription" in code)
    reads -= {"", *_NODES}
    return _Found(frozenset(reads), frozenset(sets), is_open, functions, functions or in_place, calls)


def _accesses(code: str, objects: str) -> tuple[set[str], set[str], bool]:
    """The members of `objects` (a pattern) that are read and that are set, and whether others may be."""
    reads, sets, is_open = set[str](), set[str](), False
    patterns = _patterns(code)
    for found in re.finditer(rf"(?:{objects})(?:\s*\??\.\s*({_NAME}))?", code):
        name, after = found[1], code[found.end() :]
        before = code[: found.start()].rstrip("( \t\r\n")
        counted = before.endswith(("++", "--"))
        if name is None:
            is_open = True
        elif counted or _SET.match(after) or before.endswith("delete"):
            sets.add(name)
            reads |= {name} if counted or _CHANGE.match(after) else set()
        else:
            reads.add(name)
            in_loop = _FOR.search(before[-30:]) is not None
            taken_apart = in_loop or any(found.start() in pattern for pattern in patterns)
            sets |= {name} if taken_apart else set()
    return reads, sets, is_open


def _without(found: re.Match[str]) -> str:
    """The replacement of a comment or literal: a blank, or the expressions of a template."""
    if found["comment"]:
        return " "
    if found[0][0] != "`":
        return (found["before"] or "") + '""'
    if "${" not in _INSIDE.sub("", found[0]):
        return " ".join(("", *_INSIDE.findall(found[0]), ""))
    inside = found[0].partition("${")[2]  # nested braces: keep the text between two expressions, too
    return f" {inside[:-1]} " if inside.count("{") + 1 == inside.count("}") else _UNKNOWN


def _patterns(code: str) -> list[range]:
    """Where ``[a, b]`` or ``{x: a}`` stands that is assigned to."""
    spans = []
    for begun in _PATTERN.finditer(code):
        depth = 0
        for bracket in _BRACKET.finditer(code, begun.start(1)):
            depth += 1 if bracket[0] in "([{" else -1
            if not depth:
                if re.match(r"\s*(?:=(?![=>])|\b(?:of|in)\b)", code[bracket.end() :]):
                    spans.append(range(begun.start(1), bracket.end()))
                break
    return spans
