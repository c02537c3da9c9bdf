"""FEEL beside feelin, another implementation: the values of 793 expressions, and why some differ.

Most expressions are made from tables: each operator with each pair of operands, each construct with each list.
"""

from __future__ import annotations

import json
import re
import subprocess
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from fame.bpmn.model import Expression
from fame.scripting import compile_expression

DIFFERENT = {  # what differs, by the form of the expression: why ours is right
    r'[\d.]+ (<|>=) "\w"|"\w" (<|>=) [\d.]+': "a number and a text have no order (DMN 1.5, table 55)",
    r"(some|every) i in \[(1, )?null\] satisfies i > \d|(some|every) .* satisfies (null|unset > 1)": (
        "conditions are combined by three-valued or and and (table 54)"
    ),
    r"\d in \[3\.\.1\]": "nothing lies between the ends of a range that begins above its end",
    r"\d in null|null in null": "`in` with one value is `=`",
    r'@"-?P\w+" [<=] @"-?P\w+"': "durations of months and of days are different types",
    r'@"[\dT:.-]+(Z|\+01:00)" - @"[\dT:.-]+(Z|\+01:00)"': "moments are subtracted, not what clocks say in two zones",
    r"robots\[ready\]": "a condition may be the name of a field",
    r'if "a" .*': "what is not true takes the way of else",
    r"is defined\(x\)": "a function of Camunda",
    r"function\(.*": "a function is not data",
    r'@"PT1H" [*/] 2': "a duration can be multiplied (table 61)",
    r"years and months duration\(.*": "14 months less a day are 13 whole months",
    r'.* d in @".*"\.\.@".*': "a range of dates is iterated by days (section 10.3.2.14)",
    r"date and time\(.*\[Europe/Berlin\].*": "the offset says which of two times in autumn",
    r"during\(5, .*": "a point may be during a range (table 78)",
}

VARIABLES: dict[str, Any] = {
    "x": 3,
    "label": "drone",
    "xs": [1, 2, 3, 4],
    "none": [],
    "robots": [{"name": "REX", "battery": 0.2, "ready": True}, {"name": "DINGO", "battery": 0.7, "ready": False}],
    "det": {"class": "person", "from": 1, "in": 2, "is": True, "not": False, "score": 0.5},
}

_OPERANDS = ("2", "0", "-1.5", '"a"', "true", "null", "[1, 2]", "{a: 1}", "unset")
_COMPARED = ("1", "2.5", '"a"', '"b"', "null")
_OPERATORS = ("+", "-", "*", "/")
_LOGICAL = ("true", "false", "null", "1", "unset")
_LISTS = ("[]", "[1]", "[1, 2, 3]", "[null]", "[1, null]", "[3, 3]", "unset", "xs", "1..3", "3..1", "[1..3]")
_TESTS = ("i > 1", "i > 0", "i > 5", "null", "unset > 1")
_DATES = ('@"2026-01-01"', '@"2026-01-03"', '@"2025-12-31"')
_MOMENTS = ('@"2026-03-01T12:00:00Z"', '@"2026-03-01T13:00:00+01:00"', '@"2026-03-01T12:00:01Z"')
_DURATIONS = ('@"P1D"', '@"PT24H"', '@"PT1H30M"', '@"P1Y"', '@"P12M"', '@"-PT1H"')
_INTERVALS = ("[1..3]", "(1..3]", "[1..3)", "(1..3)", "[3..1]", "< 2", ">= 2", "2", "[1, 2]", "null")

_SINGLE = r"""
x + 1
-x
x ** 2
2 ** 3 ** 2
-2 ** 2
(1 + 2) * 3
7 / 2
1 - 2 - 3
10 / 2 / 5
label
label = "drone"
xs[1]
xs[-1]
xs[0]
xs[9]
xs[item > 2]
xs[item > 9]
robots[ready]
robots[battery < 0.5].name
robots[name = "REX"].battery
robots[1].name
robots.name
robots.unset
robots[battery > 0.9]
robots[item.battery > 0.5].name
det.class
det.from
det.in
det.is
det.not
det.class = "person"
det.score >= 0.5 and det.class = "person"
det.nothing
[det][class = "person"].score
unset.field
x.field
if x > 2 then "far" else "near"
if null then 1 else 2
if unset then 1 else 2
if "a" then 1 else 2
if x > 2 then if x > 5 then 1 else 2 else 3
for i in xs return i * 2
for i in xs, j in [10, 20] return i + j
for i in 1..3 return i
for i in 3..1 return i
for i in [] return i
for i in 1..4 return if i < 3 then 1 else partial[-1] + partial[-2]
for i in robots return i.name
some r in robots satisfies r.ready
every r in robots satisfies r.ready
some i in xs, j in xs satisfies i + j = 8
every i in xs, j in xs satisfies i + j < 9
x between 1 and 5
x between 4 and 5
x between null and 5
{a: 1, b: a + 1}
{a: 1, b: a + 1}.b
{"a b": 1}
{a: {b: 2}}.a.b
{}
[1, [2, 3]]
[x, label]
"a" + "b"
"a\tb"
"a\"b"
"a\\b"
"\u00e9"
matches("axb", "a\.b")
matches("a.b", "a\.b")
matches("a1", "a\d")
matches("a[b", "a\[b")
matches("a+b", "a\+b")
matches("abc", "^b")
matches("aBc", "abc", "i")
split("a.b.c", "\.")
split("a;b;c", ";")
split("a  b", "\s+")
replace("a.b.c", "\.", "-")
replace("abcd", "(b)(c)", "$2$1")
replace("aaa", "a", "b")
string length("")
string length("robot")
upper case("aB1")
lower case("aB1")
substring("foobar", 3)
substring("foobar", 3, 3)
substring("foobar", -2, 1)
substring before("foobar", "bar")
substring before("foobar", "xyz")
substring after("foobar", "ob")
substring after("foobar", "xyz")
contains("foobar", "of")
contains("foobar", "ob")
starts with("foobar", "fo")
ends with("foobar", "r")
string join(["a", "b", "c"], ",")
string join(["a", null, "c"], ",")
string join([], ",")
string(1.5)
string(true)
string("a")
number("1.5")
number("abc")
abs(-10)
abs(10)
floor(1.5)
floor(-1.5)
ceiling(1.5)
ceiling(-1.5)
round up(5.5, 0)
round up(-5.5, 0)
round down(5.5, 0)
round down(-5.5, 0)
round half up(2.5, 0)
round half down(2.5, 0)
decimal(1.5, 0)
decimal(2.5, 0)
decimal(0.333, 2)
modulo(12, 5)
modulo(-12, 5)
modulo(12, -5)
modulo(5, 0)
sqrt(16)
sqrt(-3)
odd(5)
odd(2)
even(5)
even(-2)
log(1)
exp(0)
count([])
count([1, 2])
min([3, 1, 2])
min(3, 1, 2)
max([3, 1, 2])
max([])
sum([1, 2, 3])
sum([])
mean([1, 2, 3])
mean([])
median([8, 2, 5, 3, 4])
median([6, 1, 2, 3])
mode([6, 3, 9, 6, 6])
mode([6, 1, 9, 6, 1])
mode([])
stddev([2, 4, 7, 5])
product([2, 3, 4])
all([true, false])
all([true, null])
all([false, null])
all([])
any([false, true])
any([false, null])
any([true, null])
any([])
list contains([1, 2, 3], 2)
list contains([1, null], null)
sublist([1, 2, 3], 2)
sublist([4, 5, 6], 1, 2)
sublist([4, 5, 6], -2)
append([1], 2, 3)
concatenate([1, 2], [3])
insert before([1, 3], 1, 2)
remove([1, 2, 3], 2)
reverse([1, 2, 3])
index of([1, 2, 3, 2], 2)
index of([1], 9)
union([1, 2], [2, 3])
distinct values([1, 2, 3, 2, 1])
flatten([[1, 2], [[3]], 4])
sort([3, 1, 2], function(a, b) a < b)
sort(robots, function(a, b) a.battery > b.battery).name
get value({foo: 123}, "foo")
get value({foo: 123}, "bar")
get entries({foo: 123})
context([{key: "a", value: 1}])
context put({x: 1}, "y", 2)
context merge([{x: 1}, {y: 2}])
is defined(x)
not(true)
not(null)
not(x > 5)
function(a, b) a + b
date("2026-01-31")
date("2026-02-30")
date(2026, 1, 31)
time("08:00:00")
time("24:00:00")
time("08:00:00Z")
date and time("2026-01-31T08:00:00Z")
date and time("2026-01-31")
duration("P1D")
duration("P1Y6M")
duration("PT90M")
duration("bad")
@"2026-01-31".year
@"2026-01-31".month
@"2026-01-31".day
@"2026-01-31".weekday
@"2026-01-31T08:30:15Z".hour
@"2026-01-31T08:30:15Z".minute
@"2026-01-31T08:30:15Z".second
@"P1DT2H".days
@"P1DT2H".hours
@"P1Y6M".years
@"P1Y6M".months
@"2026-01-31" + @"P1M"
@"2026-01-31" + @"P1D"
@"2026-01-31" - @"P1D"
@"2026-01-31" - @"2026-01-01"
@"2026-01-31T12:00:00Z" - @"2026-01-31T10:00:00Z"
@"2026-01-31T23:00:00Z" + @"PT2H"
@"PT1H" + @"PT30M"
@"PT1H" * 2
@"PT1H" / 2
@"P1Y" + @"P6M"
@"P1Y" + @"P3D"
years and months duration(date("2025-01-31"), date("2026-03-30"))
for d in @"2026-01-01"..@"2026-01-03" return d
for d in @"2026-01-03"..@"2026-01-01" return d
every d in @"2026-01-01"..@"2026-01-03" satisfies false
some d in @"2026-01-01"..@"2026-01-03" satisfies d.day = 2
day of week(date("2026-01-31"))
day of year(date("2026-01-31"))
week of year(date("2026-01-31"))
month of year(date("2026-01-31"))
@"2026-10-25T02:30:00@Europe/Berlin" = @"2026-10-25T00:30:00Z"
date and time("2026-10-25T02:30:00+01:00[Europe/Berlin]") = @"2026-10-25T01:30:00Z"
x instance of number
label instance of string
xs instance of list
true instance of boolean
@"2026-01-31" instance of date
null instance of number
before(1, 10)
after(10, 1)
overlaps([1..5], [3..8])
includes([1..10], 5)
during(5, [1..10])
"""


def expressions() -> list[str]:
    """Each expression once, in a fixed order."""
    made = [f"{a} {sign} {b}" for sign in _OPERATORS for a, b in product(_OPERANDS[:6], repeat=2)]
    made += [f"{a} {sign} {b}" for sign in ("=", "!=") for a, b in product(_OPERANDS[:8], repeat=2) if a <= b]
    made += [f"{a} {sign} {b}" for sign in ("<", ">=") for a, b in product(_COMPARED, repeat=2)]
    made += [f"{a} {word} {b}" for word in ("and", "or") for a, b in product(_LOGICAL, repeat=2)]
    made += [
        f"{word} i in {some} satisfies {test}" for word, some, test in product(("some", "every"), _LISTS, _TESTS[:3])
    ]
    made += [f"{word} i in [1, 2] satisfies {test}" for word, test in product(("some", "every"), _TESTS[3:])]
    made += [f"for i in {some} return i + 1" for some in _LISTS]
    made += [f"{value} in {test}" for value, test in product(("1", "2", "3", "null"), _INTERVALS)]
    made += [f"{a} {sign} {b}" for sign in ("<", "=") for a, b in product(_DATES, repeat=2)]
    made += [f"{a} {sign} {b}" for sign in ("<", "=", "-") for a, b in product(_MOMENTS, repeat=2)]
    made += [f"{a} {sign} {b}" for sign in ("<", "=") for a, b in product(_DURATIONS, repeat=2)]
    return list(dict.fromkeys([*made, *_SINGLE.strip().splitlines()]))


SCRIPT = """
import { readFileSync } from "node:fs"
const { evaluate } = await import(process.argv[2])
const { expressions, variables } = JSON.parse(readFileSync(0, "utf8"))
const shown = (value) => {
  if (value === null || value === undefined) return null
  if (typeof value !== "object") return typeof value === "function" ? "a function" : value
  if (Array.isArray(value)) return value.map(shown)
  if (Object.getPrototypeOf(value) !== Object.prototype) return String(value)
  return Object.fromEntries(Object.entries(value).map(([key, inner]) => [key, shown(inner)]))
}
const result = (text) => {
  try {
    return shown(evaluate(text, variables).value)
  } catch (error) {
    return `error: ${error.message}`
  }
}
console.log(JSON.stringify(expressions.map(result)))
"""


def alike(ours: Any, theirs: Any) -> bool:
    """Whether two values are the same; the numbers of JavaScript are floats."""
    if isinstance(ours, float | int) and isinstance(theirs, float | int) and bool not in (type(ours), type(theirs)):
        return ours == pytest.approx(theirs)
    return json.dumps(ours) == json.dumps(theirs)


def test_expressions_have_the_values_that_feelin_gives_but_where_we_say_why_not(
    node_modules: Path, tmp_path: Path
) -> None:
    script, texts = tmp_path / "compare.mjs", expressions()
    script.write_text(SCRIPT)
    done = subprocess.run(
        ["node", str(script), (node_modules / "feelin" / "dist" / "index.js").as_uri()],
        input=json.dumps({"expressions": texts, "variables": VARIABLES}),
        capture_output=True,
        text=True,
        check=True,
    )
    ours = [compile_expression(Expression(text, "feel"))(dict(VARIABLES)) for text in texts]
    pairs = dict(zip(texts, zip(ours, json.loads(done.stdout), strict=True), strict=True))
    different = {text: pair for text, pair in pairs.items() if not alike(*pair)}
    known = {text for text in different for form in DIFFERENT if re.fullmatch(form, text)}
    assert {text: pair for text, pair in different.items() if text not in known} == {}
    assert [form for form in DIFFERENT if not any(re.fullmatch(form, text) for text in different)] == []
    assert len(texts) >= 500
