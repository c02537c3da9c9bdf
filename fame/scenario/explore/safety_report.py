"""The page of ``fame check --explore --report``: what was checked, how, with which result; for who signs.

It is one static page. The same files, versions and options give the same page but for the seconds.
"""

from __future__ import annotations

import platform
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path

from fame.bpmn.library import comes_with_fame
from fame.bpmn.model import Definitions, Element
from fame.check.explore import Exploration
from fame.deploy.envelope import model_hash
from fame.errors import display_name
from fame.scenario.explore.coverage_file import CoverageReport
from fame.scenario.scenario import Scenario

REQUIREMENT = "requirement"
"""The extension property of an element that names what it is for, and the marker of tests."""
_STYLE = """body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:1000px;margin:2em auto;padding:0 1em}
h1{font-size:1.5em}h2{font-size:1.15em;margin-top:2em;border-bottom:1px solid #ddd}
table{border-collapse:collapse;width:100%;font-size:14px}code{overflow-wrap:anywhere}
th,td{text-align:left;vertical-align:top;padding:.25em .6em;border-bottom:1px solid #eee}
.bad{color:#b3261e;font-weight:600}.good{color:#256029}.open{color:#8a5a00;font-weight:600}
.sign td{height:3em;border-bottom:1px solid #222}
@media print{body{margin:0}h2{break-after:avoid}tr{break-inside:avoid}}"""
_CLASSES = {"completed": "good", "proved": "good", "holds": "good", "covered": "good", "failed": "bad",
            "refuted": "bad", "error": "bad"}  # fmt: skip
_WORDS = {
    "completed": "No error was found, and all states were explored.",
    "failed": "An error was found, or a property is refuted.",
    "partial": "No error was found, but not everything is known: see below.",
}


def safety_report(
    result: Exploration,
    scenario: Scenario,
    *,
    command: str,
    version: str,
    faults: bool,
    coverage: CoverageReport | None = None,
) -> str:
    """Return the page about an exploration of a scenario, perhaps with single `faults`.

    `command` repeats it, with this `version` of FAME; `coverage` is that of tests.
    """
    files = scenario.closures()
    parts = [
        f"<h1>{escape(Path(result.file).name)}: what was checked</h1>",
        f'<p class="{_CLASSES.get(result.status, "open")}">{_WORDS[result.status]}</p>',
        f"<p>{escape(result.summary())}</p>",
        *_section("Files and versions", ("file", "SHA-256"), _hashes(files, scenario, result)),
        f"<p>FAME {escape(version)}, {escape(_platform())}<br>Command: <code>{escape(command)}</code></p>",
        *_section("What the exploration leaves out", ("", ""), _abstractions(result, files)),
        *_section("Properties", ("id", "sentence", "verdict", "why"), _properties(result)),
        *_section("Findings", ("level", "finding", "accepted, because"), _findings(result)),
        *_section("Single faults", ("fault", "delivery", "outcome"), _faults(result, explored=faults)),
        *_section(
            "Requirements", ("id", "elements", "properties", "tests", ""), _requirements(result, files, coverage)
        ),
        *_section(
            "Coverage by tests",
            ("process", "elements", "flows", "not entered", "excused"),
            _covered(coverage) if coverage is not None else [("not given", "", "", "", "")],
        ),
        "<p>A test covers an element when a token comes to it, also if the test does not pass.</p>",
        *_section("Not covered", ("what", ""), _left(result, files, coverage, faults=faults)),
        '<h2>Signed</h2><table class="sign"><tr><th>name</th><th>role</th><th>date</th><th>signature</th></tr>',
        f"{'<tr><td></td><td></td><td></td><td></td></tr>' * 2}</table>",
    ]
    head = f'<meta charset="utf-8"><title>{escape(Path(result.file).name)}</title><style>{_STYLE}</style>'
    return f"<!doctype html><html lang=en><head>{head}</head><body>{''.join(parts)}</body></html>\n"


def _section(title: str, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """A table; where it has no rows, it says so."""
    yield f"<h2>{title}</h2>"
    lines = [
        "".join(f'<td class="{_CLASSES.get(cell, "open" if cell.startswith("not ") else "")}">{escape(cell)}</td>'
                for cell in row)
        for row in rows
    ]  # fmt: skip
    head = "".join(f"<th>{escape(one)}</th>" for one in heads)
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    yield f"<table><tr>{head}</tr>{body}</table>" if lines else "<p>None.</p>"


def _hashes(files: Sequence[Definitions], scenario: Scenario, result: Exploration) -> Iterator[tuple[str, str]]:
    given = {one.place.file for one in scenario.properties} | {scenario.file}
    for file in sorted({name for name in given if Path(name).is_file()} - {one.file for one in files}):
        yield file, model_hash(Path(file).read_bytes())
    for one in files:
        yield one.file, model_hash(one.source)


def _platform() -> str:
    return f"Python {platform.python_version()}, {platform.system()} {platform.machine()}"


def _abstractions(result: Exploration, files: Sequence[Definitions]) -> Iterator[tuple[str, str]]:
    elements = {(file.file, one.id): one for file in files for one in file.elements()}
    yield "robots", ", ".join(result.robots)
    yield "delivery of messages", ", ".join(one.delivery for one in result.searches)
    yield "time", "stands still: timers fire in any order that their kind allows, bounds are not judged"
    for file, id in result.steps:
        one = elements.get((file, id))
        yield "taken for one step", display_name(id, one.name if one is not None else "")
    for topic in result.outside:
        yield "from outside, at any time", topic
    for robot, element in result.shortened:
        yield "unknown list or number of items, with few of them", f"{element} of {robot}"
    for robot, element in result.midway:
        yield "taken to publish when it ends, though it does so before", f"{element} of {robot}"
    for robot, name in result.widened:
        yield "unknown after a while", f"{name} of {robot}"
    for cut in result.cuts:
        yield "not explored", cut
    for name in result.sampled:
        yield "explored besides, in part", name


def _properties(result: Exploration) -> Iterator[tuple[str, ...]]:
    for one in result.properties:
        steps = f" ({len(one.run)} steps: {'; '.join(map(str, one.run))})" if one.run else ""
        yield one.name, one.sentence, one.verdict, one.text + steps


def _findings(result: Exploration) -> Iterator[tuple[str, ...]]:
    return ((one.level, one.text, one.accepted) for one in result.findings)


def _faults(result: Exploration, *, explored: bool) -> Iterator[tuple[str, ...]]:
    if not explored:
        yield "not explored", "", ""
    for search in result.searches:
        yield from search.faults


def _requirements(
    result: Exploration, files: Sequence[Definitions], coverage: CoverageReport | None
) -> Iterator[tuple[str, ...]]:
    """A requirement is the id of a property, or what elements and tests name."""
    elements: dict[str, list[tuple[str, Element]]] = {}
    for file in files:
        for element in file.elements():
            if id := element.properties.get(REQUIREMENT, "").strip():
                elements.setdefault(id, []).append((file.file, element))
    marked: Mapping[str, Sequence[str]] = coverage.requirements if coverage is not None else {}
    entered = {
        (one.file, id): tests
        for one in (coverage.processes if coverage is not None else ())
        for id, tests in one.tests.items()
    }
    for id in sorted({*elements, *marked}):
        named = elements.get(id, [])
        told = [one for one in result.properties if one.name in (id, *(f"deadline_{one.id}" for _, one in named))]
        tests = dict.fromkeys(marked.get(id, ()))
        for name, element in named:
            tests |= dict.fromkeys(entered.get((Path(name).resolve(), element.id), ()))
        shown = ", ".join(one.display_name for _, one in named)
        words = ", ".join(f"{one.name}: {one.verdict}" for one in told)
        verdicts = {one.verdict for one in told}
        outcomes = coverage.not_passed if coverage is not None else {}
        passed = bool(tests.keys() - outcomes.keys()) and not outcomes.keys() & {*marked.get(id, ())}
        covered = "covered" if passed or "proved" in verdicts else "not covered"
        texts = (f"{test} ({outcomes[test]})" if test in outcomes else test for test in tests)
        yield id, shown, words, ", ".join(texts), "refuted" if "refuted" in verdicts else covered


def _covered(coverage: CoverageReport | None) -> Iterator[tuple[str, ...]]:
    for one in coverage.processes if coverage is not None else ():
        excused = "; ".join(f"{id}: {why}" for id, why in one.excused.items())
        yield f"{one.name} ({one.file.name})", one.elements, one.flows, ", ".join(one.missing), excused


def _left(
    result: Exploration, files: Sequence[Definitions], coverage: CoverageReport | None, *, faults: bool
) -> Iterator[tuple[str, str]]:
    for one in result.properties:
        if one.verdict in ("not known", "not triggered"):
            yield f"property {one.name}", f"{one.verdict}: {one.text}" if one.text else one.verdict
    for id, _, _, tests, status in _requirements(result, files, coverage):
        if status == "not covered":
            tests_of_it = "a test of it has not passed" if tests else "no test names it or enters its elements"
            yield f"requirement {id}", f"no property proves it, and {tests_of_it}"
    for cut in result.cuts:
        yield "states", cut
    if not faults:
        yield "single faults", "were not explored: --faults"
    if coverage is None:
        yield "tests", "no coverage was given: fame test --cov-json FILE, then --coverage FILE"
        return
    for name, _, _, missing, _ in _covered(coverage):
        if missing:
            yield f"by tests of {name}", missing
    yield from ((f"test {test}", f"it was {outcome}") for test, outcome in coverage.not_passed.items())
    digests = {one.file: one.digest for one in coverage.processes}
    for file in files:
        found = digests.get(Path(file.file).resolve())
        if found is None and any(one.body.nodes for one in file.processes) and not comes_with_fame(file.file):
            yield f"by tests of {file.file}", "the coverage does not have this file"
        elif found not in (None, model_hash(file.source)):
            yield f"by tests of {file.file}", "the coverage is that of another version of this file"
