"""``fame test``: tests of missions, which pytest runs, with coverage of their models."""

from __future__ import annotations

import os
from argparse import Namespace
from errno import ENOENT
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, add_library, command, number
from fame.cli.output import note
from fame.errors import ConfigError, FameError
from fame.text import unreadable

if TYPE_CHECKING:
    import pytest

_EXAMPLES = (
    "fame test examples/tests",
    "fame test examples/tests -k vehicles --cov-model --cov-fail-under 100 --cov-html out/coverage.html",
    "fame test --report out/report",
    "fame test --pytest=--pdb --pytest=--durations=5",
)
_EXIT = {0: 0, 2: 130, 4: 2}
"""By exit code of pytest: Ctrl-C is 130, a wrong request is 2, everything else is 1. If all are skipped,
it is 3."""


def add(commands: Commands) -> None:
    parser = command(commands, "test", run, examples=_EXAMPLES)
    parser.add_argument(
        "paths", nargs="*", metavar="PATH",
        help="files and folders of tests; without any, those of the project (fame.yaml), whose coverage is demanded",
    )  # fmt: skip
    parser.add_argument("-k", metavar="EXPRESSION", help="only tests whose names match, as in pytest")
    parser.add_argument("-x", action="store_true", help="stop at the first failure")
    parser.add_argument("--cov-model", action="store_true", help="show coverage of elements and flows per process")
    parser.add_argument(
        "--cov-fail-under",
        type=number("a number from 0 to 100", 0, 100),
        metavar="PERCENT",
        help="fail if the coverage is lower",
    )
    parser.add_argument("--cov-html", type=Path, metavar="FILE", help="coverage as an HTML page with coloured diagrams")
    parser.add_argument(
        "--cov-json", type=Path, metavar="FILE", help="coverage as JSON, with the tests of each element"
    )
    parser.add_argument("--cov-junit", type=Path, metavar="FILE", help="coverage as JUnit XML: a case for each element")
    parser.add_argument(
        "--pytest", action="append", default=[], metavar="OPTION", help="an option for pytest: --pytest=-v; repeatable"
    )
    parser.add_argument("--junitxml", type=Path, metavar="FILE", help="results of the tests as JUnit XML")
    parser.add_argument(
        "--report", type=Path, metavar="DIR",
        help="write a folder to send: index.html, and for each mission that failed a page that shows its run",
    )  # fmt: skip
    add_library(parser)


_IMPORTED = "ignore:Module already imported so cannot be rewritten:pytest.PytestAssertRewriteWarning"
"""The command itself has imported FAME, whose installed plugin pytest would otherwise prepare for its assertions."""


def run(arguments: Namespace) -> int:
    """Run the tests and return the exit code."""
    from fame.imports import require

    for path in map(str, arguments.paths):
        if path.endswith((".yaml", ".yml", ".bpmn")):
            raise ConfigError("expected tests (.py): fame run and fame check take scenarios and models", file=path)
        if not os.path.exists(path.partition("::")[0]):
            raise ConfigError(unreadable(FileNotFoundError(ENOENT, os.strerror(ENOENT), path)), file=path)
    require("pytest")
    import pytest

    options = ["-p", "fame.testing.plugin", "-W", _IMPORTED, *arguments.paths]
    options += [f"--fame-library={folder}" for folder in arguments.library]
    options += [f"--fame-types={folder}" for folder in arguments.types]
    if arguments.project is not None:
        options += ["--rootdir", str(arguments.project.file.parent)]
        if not (arguments.leaf.given or arguments.cov_model):  # of a part of the tests, nothing is demanded
            arguments.cov_fail_under = arguments.project.coverage
    for name, option in (("k", "-k"), ("junitxml", "--junitxml"), ("report", "--fame-report")):
        if getattr(arguments, name) is not None:
            options += [option, str(getattr(arguments, name))]
    if arguments.x:
        options.append("-x")
    if arguments.cov_model:
        options.append("--cov-model")
    for name in ("fail_under", "html", "json", "junit"):
        value = getattr(arguments, f"cov_{name}")
        if value is not None:
            options.append(f"--cov-model-{name.replace('_', '-')}={value}")
    options += arguments.pytest
    outcomes = _Outcomes()
    ended = int(pytest.main(options, plugins=[outcomes]))
    if ended == pytest.ExitCode.NO_TESTS_COLLECTED:
        without = (
            f"no test matches -k {arguments.k!r}" if arguments.k else "there is no test (def test_... in test_*.py)"
        )
        raise FameError(f"no test has run: {without}")
    code = 1 if ended == pytest.ExitCode.INTERRUPTED and not outcomes.interrupted else _EXIT.get(ended, 1)
    if code == 0 and outcomes.are_skips:
        note("fame: no test has passed: all were skipped")
        return 3
    return code


class _Outcomes:
    """A plugin of pytest that knows whether tests were skipped and none came to a result, and of a Ctrl-C."""

    def __init__(self) -> None:
        self._skipped = self._judged = self.interrupted = False

    def pytest_keyboard_interrupt(self, excinfo: pytest.ExceptionInfo[BaseException]) -> None:
        self.interrupted = excinfo.type is KeyboardInterrupt  # pytest's own ends after errors of collection inherit it

    @property
    def are_skips(self) -> bool:
        return self._skipped and not self._judged

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        skipped = report.skipped and not hasattr(report, "wasxfail")
        self._skipped |= skipped
        self._judged |= report.when == "call" and not skipped
