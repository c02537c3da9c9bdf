"""Coverage of models: the elements and flows that tests have entered, per pool and called process.

An element counts as covered when a token came to it, a sequence flow when it was taken. Behaviours that come with FAME
do not count, and neither do stubs. What tests need not cover is named with its reason in ``uncovered.yaml``::

    ground_vehicles.bpmn:
      Event_Timeout: the planner of the simulation always answers
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.bpmn.library import comes_with_fame
from fame.bpmn.model import Definitions, Element, Process, SequenceFlow
from fame.dataclasses import dataclass, field
from fame.errors import ConfigError
from fame.testing.elements import parts
from fame.text import percent

if TYPE_CHECKING:
    from fame.testing.mission import MissionUnderTest

REASONS = "uncovered.yaml"


@dataclass(frozen=True, slots=True)
class ProcessCoverage:
    """What tests have covered of one process. `tests` has the tests of each covered id, `excused` the reasons."""

    file: str
    name: str
    elements: Sequence[Element]
    tests: Mapping[str, Sequence[str]]
    excused: Mapping[str, str]

    def missing(self) -> list[Element]:
        """Return what no test has entered and nothing excuses."""
        return [one for one in self.elements if one.id not in self.tests and one.id not in self.excused]

    def counts(self, *, flows: bool) -> tuple[int, int]:
        """Return how many of its elements, or of its flows, are covered, and how many there are
        without excused ones."""
        chosen = [one for one in self.elements if isinstance(one, SequenceFlow) == flows]
        counted = [one for one in chosen if one.id in self.tests or one.id not in self.excused]
        return sum(one.id in self.tests for one in counted), len(counted)


@dataclass(slots=True)
class Coverage:
    """Collects what tests cover. `reasons`: name of a file -> id -> why no test needs to cover it.

    `requirements`: id -> the tests whose marker ``requirement`` names it. `not_passed`: test -> ``failed`` or
    ``skipped``.
    """

    reasons: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    requirements: defaultdict[str, dict[str, None]] = field(default_factory=lambda: defaultdict(dict))
    not_passed: dict[str, str] = field(default_factory=dict)
    _files: dict[str, Definitions] = field(default_factory=dict)
    _processes: dict[tuple[str, str], None] = field(default_factory=dict)
    _tests: defaultdict[tuple[str, str], dict[str, None]] = field(default_factory=lambda: defaultdict(dict))

    def add(self, mission: MissionUnderTest, test: str) -> None:
        definitions = mission.scenario.definitions
        closures = [
            mission.scenario.library.closure(definitions, pool.process) for pool in mission.scenario.cast.values()
        ]
        used = [(definitions, process) for process in definitions.processes]
        for home, process in (*used, *(one for closure in closures for one in closure)):
            if not comes_with_fame(home.file):
                self._add_process(home, process)
        for file, element in mission.trace.covered:
            place = _resolved(file)
            if place in self._files:
                self._tests[place, element][test] = None

    def _add_process(self, home: Definitions, process: Process) -> None:
        if process.body.nodes:
            self._files.setdefault(_resolved(home.file), home)
            self._processes[_resolved(home.file), process.id] = None

    def processes(self) -> list[ProcessCoverage]:
        """Return the coverage of each process, in the order in which tests met them."""
        return [self._process(file, id) for file, id in self._processes]

    def _process(self, file: str, id: str) -> ProcessCoverage:
        home = self._files[file]
        process = next(process for process in home.processes if process.id == id)
        pool = next((pool.label for pool in home.participants if pool.process == id), "")
        elements = list(parts(process))
        tests = {one.id: list(self._tests[file, one.id]) for one in elements if (file, one.id) in self._tests}
        named = self.reasons.get(Path(home.file).name, {})
        excused = {one.id: named[one.id] for one in elements if one.id in named and one.id not in tests}
        return ProcessCoverage(file, pool or process.name or process.id, elements, tests, excused)

    def percent(self) -> float:
        """Of all elements and flows that count, how many are covered (0 to 100); 0 if tests have loaded no model."""
        if not self._processes:
            return 0.0
        counts = [one.counts(flows=flows) for one in self.processes() for flows in (False, True)]
        total = sum(total for _, total in counts)
        return 100.0 * sum(covered for covered, _ in counts) / total if total else 100.0

    def doubtful(self) -> dict[str, str]:
        """Return the tests that cover something and did not pass, with their outcomes."""
        marked = self.requirements.values()
        tests = {test for found in (*self._tests.values(), *marked) for test in found}
        return {test: outcome for test, outcome in self.not_passed.items() if test in tests}

    def digest(self, file: str) -> str:
        """Return the SHA-256 of a file as the tests have read it."""
        return hashlib.sha256(self._files[file].source).hexdigest()

    def stale(self) -> list[str]:
        """Reasons that name what tests cover, or what no model has; a line each."""
        known = {
            (Path(one.file).name, part.id): part.id in one.tests for one in self.processes() for part in one.elements
        }
        files = {Path(file).name for file in self._files}
        return [
            f"{REASONS}: {file}: {id}: "
            + ("tests cover it" if known.get((file, id)) else "the model has no such element")
            for file, named in self.reasons.items()
            if file in files
            for id in named
            if known.get((file, id), True)
        ]

    # ---- between processes -----------------------------------------------------------------------------------------

    def to_plain(self) -> dict[str, Any]:
        """As data that JSON can hold, for another process."""
        return {
            "processes": [list(key) for key in self._processes],
            "tests": [[file, element, list(tests)] for (file, element), tests in self._tests.items()],
            "requirements": {id: list(tests) for id, tests in self.requirements.items()},
            "not_passed": self.not_passed,
        }

    def merge(self, plain: Mapping[str, Any]) -> None:
        """Add what another process has collected."""
        from fame.bpmn.reader import read

        for file, process in plain["processes"]:
            if file not in self._files:
                self._files[file] = read(file)
            self._processes[file, process] = None
        for file, element, tests in plain["tests"]:
            self._tests[file, element].update(dict.fromkeys(tests))
        for id, tests in plain["requirements"].items():
            self.requirements[id].update(dict.fromkeys(tests))
        self.not_passed.update(plain["not_passed"])


def read_reasons(folders: Iterable[Path]) -> dict[str, dict[str, str]]:
    """Return the reasons of the files ``uncovered.yaml`` in some folders. Raises ConfigError."""
    from fame.config.loader import read_document

    by_file: dict[str, dict[str, str]] = {}
    for path in dict.fromkeys(folder / REASONS for folder in folders):
        if path.is_file():
            for file, value in read_document(path).mapping().items():
                reasons = {id: reason.text() for id, reason in value.mapping().items()}
                if not all(reasons.values()):
                    raise ConfigError("expected a reason for each element", file=str(path), line=value.line)
                by_file.setdefault(file, {}).update(reasons)
    return by_file


def _resolved(file: str) -> str:
    return str(Path(file).resolve())


# ---- reports ---------------------------------------------------------------------------------------------------------


def text_report(coverage: Coverage) -> Iterator[str]:
    """Yield a table of processes, then what is missing and what is excused."""
    rows = [("process", "elements", "flows", "covered")]
    for process in coverage.processes():
        (elements, all_elements), (flows, all_flows) = process.counts(flows=False), process.counts(flows=True)
        total = all_elements + all_flows
        share = f"{percent((elements + flows) / total)} %" if total else "-"
        rows.append(
            (f"{_short(process.file)}: {process.name}", f"{elements}/{all_elements}", f"{flows}/{all_flows}", share)
        )
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    for row in rows:
        yield row[0].ljust(widths[0]) + "".join(
            cell.rjust(width + 2) for cell, width in zip(row[1:], widths[1:], strict=True)
        )
    for process in coverage.processes():
        for element in process.missing():
            yield f"not covered: {_short(process.file)}:{element.line}: {process.name}: {_shown(element)}"
        for id, reason in process.excused.items():
            yield f"excused: {_short(process.file)}: {process.name}: {id}: {reason}"
    for test, outcome in coverage.doubtful().items():
        yield f"covers, but has not passed: {test} ({outcome})"
    yield from coverage.stale()
    yield f"total: {percent(coverage.percent() / 100, 1)} %" + ("" if len(rows) > 1 else ": no test has loaded a model")


def json_report(coverage: Coverage) -> dict[str, Any]:
    """Return the coverage as data: total, tests that have not passed, and of each process what is
    covered by which tests."""
    return {
        "percent": round(coverage.percent(), 2),
        "requirements": {id: list(tests) for id, tests in coverage.requirements.items()},
        "not_passed": coverage.doubtful(),
        "processes": [
            {
                "file": process.file,
                "sha256": coverage.digest(process.file),
                "name": process.name,
                "elements": dict(zip(("covered", "total"), process.counts(flows=False), strict=True)),
                "flows": dict(zip(("covered", "total"), process.counts(flows=True), strict=True)),
                "tests": {id: list(tests) for id, tests in process.tests.items()},
                "missing": [
                    {"id": element.id, "name": element.name, "line": element.line} for element in process.missing()
                ],
                "excused": dict(process.excused),
            }
            for process in coverage.processes()
        ],
    }


def junit_report(coverage: Coverage) -> str:
    """JUnit XML: a suite for each process, a case for each element and flow; what is not covered has failed."""
    from xml.etree import ElementTree

    root = ElementTree.Element("testsuites", name="model coverage")
    for process in coverage.processes():
        missing = {element.id for element in process.missing()}
        name = f"{_short(process.file)}: {process.name}"
        attributes = {
            "name": name,
            "tests": str(len(process.elements)),
            "failures": str(len(missing)),
            "skipped": str(len(process.excused)),
        }
        suite = ElementTree.SubElement(root, "testsuite", attributes)
        for element in process.elements:
            case = ElementTree.SubElement(suite, "testcase", classname=name, name=_shown(element))
            if element.id in missing:
                ElementTree.SubElement(case, "failure", message="no test has entered it")
            elif element.id in process.excused:
                ElementTree.SubElement(case, "skipped", message=process.excused[element.id])
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def html_report(coverage: Coverage) -> str:
    """Return one page: the table, each diagram coloured by what is covered, and the tests of each element."""
    from html import escape

    body = [
        f"<h1>Model coverage: {percent(coverage.percent() / 100, 1)} %</h1>",
        f"<pre>{escape(chr(10).join(text_report(coverage)))}</pre>",
    ]
    by_file: defaultdict[str, list[ProcessCoverage]] = defaultdict(list)
    for process in coverage.processes():
        by_file[process.file].append(process)
    for file, processes in by_file.items():
        body.append(f"<h2>{escape(_short(file))}</h2>")
        body.append(f'<div class="diagram">{_drawing(coverage._files[file], processes)}</div>')
        for process in processes:
            body.append(f"<h3>{escape(process.name)}</h3><table><tr><th>element</th><th>tests</th></tr>")
            for element in process.elements:
                tests = "<br>".join(map(escape, process.tests.get(element.id, ())))
                what = tests or f"<em>{escape(process.excused.get(element.id, 'not covered'))}</em>"
                kind = "covered" if tests else "excused" if element.id in process.excused else "missing"
                body.append(f'<tr class="{kind}"><td>{escape(_shown(element))}</td><td>{what}</td></tr>')
            body.append("</table>")
    head = f'<meta charset="utf-8"><title>Model coverage</title><style>{PAGE_STYLE}</style>'
    return f"<!doctype html><html lang=en><head>{head}</head><body>{''.join(body)}</body></html>\n"


PAGE_STYLE = """body{font-family:Arial,Helvetica,sans-serif;margin:2em;color:#1f2328}.diagram{overflow-x:auto}
table{border-collapse:collapse}td,th{border:1px solid #d0d7de;padding:.2em .6em;text-align:left;vertical-align:top}
.missing td{background:#ffebe9}.excused td{background:#eaeef2}.covered td{background:#e3f4e6}"""


def _drawing(definitions: Definitions, processes: Sequence[ProcessCoverage]) -> str:
    from fame.bpmn.draw.diagram import draw, is_drawable

    if not is_drawable(definitions):
        return "<p>The file has no diagram.</p>"
    marks: dict[str, dict[Any, int]] = {}
    for process in processes:
        for element in process.elements:
            tests = len(process.tests.get(element.id, ()))
            marks[element.id] = (
                {"completed": tests} if tests else {"cancelled": 1} if element.id in process.excused else {"failed": 1}
            )
    return draw(definitions, marks, words={"completed": "tests", "failed": "not covered", "cancelled": "excused"})


def _shown(element: Element) -> str:
    if isinstance(element, SequenceFlow):
        return f"flow {element.display_name}: {element.source} -> {element.target}"
    return element.display_name


def _short(file: str) -> str:
    path = Path(file).resolve()
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else file)
