"""The pytest plugin: the fixture ``mission``, the state of missions in the report of a failed test, model coverage."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from fame.errors import FameError

if TYPE_CHECKING:
    from fame.testing.coverage import Coverage
    from fame.testing.mission import MissionLoader, MissionUnderTest

_LOADER = pytest.StashKey["MissionLoader"]()
_COVERAGE = pytest.StashKey["Coverage"]()
_FROM_WORKER = "fame_model_coverage"
_LEFT_OUT = "steps left out"
"""Property of a test (in JUnit XML, too) whose mission went another way than the test says."""
_UNDECIDED = "properties not decided"
"""Property of a test that ended before all properties of its mission were decided."""

_UNUSED = "stubs and fakes not used"
"""Property of a test that replaces what its mission does not use."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declare the options of reports and of missions."""
    group = parser.getgroup("fame", "missions of FAME")
    group.addoption("--cov-model", action="store_true", help="report which elements and flows of models tests enter")
    group.addoption("--cov-model-fail-under", type=float, metavar="PERCENT", help="fail below this model coverage")
    for form, what in (("html", "a page with the diagrams"), ("json", "data"), ("junit", "JUnit XML")):
        group.addoption(f"--cov-model-{form}", type=Path, metavar="FILE", help=f"write model coverage as {what}")
    group.addoption("--fame-report", type=Path, metavar="DIR", help="write a list of the tests, and pages of failures")
    for kind, what in (("library", "called processes"), ("types", ".msg, .srv and .action files")):
        text = f"folder with {what}, for all missions"
        group.addoption(f"--fame-{kind}", type=Path, action="append", default=[], metavar="DIR", help=text)


def pytest_configure(config: pytest.Config) -> None:
    """Register message types, and begin to collect coverage, if it is wanted."""
    config.addinivalue_line("markers", "requirement(id): the test of a mission is for this requirement")
    if folders := config.getoption("fame_types"):
        from fame.middleware.messages import register_files

        for folder in folders:
            register_files(folder)
    wanted = ("cov_model", "cov_model_fail_under", "cov_model_html", "cov_model_json", "cov_model_junit")
    if any(value is not None and value is not False for value in map(config.getoption, wanted)):  # 0 is a number
        from fame.errors import FameError
        from fame.testing.coverage import Coverage, read_reasons

        given = [Path(word.split("::")[0]) for word in config.args]
        folders = [config.rootpath, *(path if path.is_dir() else path.parent for path in given)]
        try:
            config.stash[_COVERAGE] = Coverage(read_reasons(folders))
        except FameError as error:
            raise pytest.UsageError(str(error)) from None


@pytest.hookimpl(trylast=True)
def pytest_collection_finish(session: pytest.Session) -> None:
    """Load what missions need, if a test that is going to run has one."""
    if not session.config.option.collectonly and any(map(_has_mission, session.items)):
        from fame.testing.preload import preload

        preload()


def _has_mission(item: pytest.Item) -> bool:
    """Whether a test has the fixture, or its module has a strategy or other part of `fame.testing`."""
    module = getattr(item, "module", None)
    homes = (getattr(value, "__module__", None) or "" for value in vars(module).values()) if module is not None else ()
    return "mission" in getattr(item, "fixturenames", ()) or any(str(home).startswith("fame.testing") for home in homes)


@pytest.fixture
def mission(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[MissionLoader]:
    """Load missions and drive them in simulated time: ``m = mission.load("patrol.yaml")``."""
    from fame.testing.mission import MissionLoader

    search = (request.path.parent, request.config.rootpath)
    library = request.config.getoption("fame_library")
    loader = MissionLoader(_folder(tmp_path_factory, request.node.name), search, library)
    request.node.stash[_LOADER] = loader
    yield loader
    try:
        coverage = request.config.stash.get(_COVERAGE, None)
        if coverage is not None:
            for loaded in loader.loaded:
                coverage.add(loaded, request.node.nodeid)
            for mark in request.node.iter_markers("requirement"):
                coverage.requirements[_requirement(mark)][request.node.nodeid] = None
        request.node.user_properties += [(_LEFT_OUT, text) for text in map(_left_out, loader.loaded) if text]
    finally:
        del request.node.stash[_LOADER]
        loader.close()


def _requirement(mark: pytest.Mark) -> str:
    """The id in a marker, given by position or name. Fails the test for another marker."""
    ids = [*mark.args, *mark.kwargs.values()]
    if len(ids) != 1 or mark.kwargs.keys() - {"id"}:
        given = ", ".join([*map(repr, mark.args), *(f"{key}={value!r}" for key, value in mark.kwargs.items())])
        pytest.fail(f"expected the marker requirement(id), got requirement({given})", pytrace=False)
    return str(ids[0])


def _left_out(mission: MissionUnderTest) -> str:
    """The steps that a mission by hand has left out, since they were not possible; for most missions empty."""
    skipped: list[str] = getattr(mission, "skipped", [])
    return f"{len(skipped)} not possible, the first one: {skipped[0]}" if skipped else ""


def _folder(factory: pytest.TempPathFactory, name: str) -> Callable[[], Path]:
    """A function that makes the folder of a test, once."""
    made: list[Path] = []

    def folder() -> Path:
        if not made:
            plain = "".join(sign if sign.isalnum() else "_" for sign in name)[:60]
            made.append(factory.mktemp(plain, numbered=True))
        return made[0]

    return folder


def _end_in_test(error: FameError) -> None:
    """Let the traceback of an error end before FAME's code."""
    last, place = None, error.__traceback__
    while place is not None:
        if str(place.tb_frame.f_globals.get("__name__")).partition(".")[0] != "fame":
            last = place
        place = place.tb_next
    if last is not None:
        last.tb_next = None


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Any:
    """Fail a test whose mission violated a property that it does not mention; note what is not decided or used.

    What FAME refuses is shown at the line of the test, without FAME's own code.
    """
    try:
        result = yield
    except FameError as error:
        if not item.config.getoption("fulltrace"):
            _end_in_test(error)
        raise
    loader = item.stash.get(_LOADER, None)
    for loaded in loader.loaded if loader is not None else ():
        loaded.check_properties()
        item.user_properties += [(_UNDECIDED, str(one)) for one in loaded.undecided()]
        item.user_properties += [(_UNUSED, text) for text in loaded.unused()]
    return result


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[Any]) -> Any:
    """Add the state of the missions to the report of a test that failed for another reason than an expectation.

    Coverage notes the tests that do not pass.
    """
    report = yield
    coverage = item.config.stash.get(_COVERAGE, None)
    if coverage is not None and not report.passed:
        coverage.not_passed[item.nodeid] = report.outcome
    loader = item.stash.get(_LOADER, None)
    if loader is not None and report.when == "call" and report.failed:
        from fame.testing.failure import ExpectationError, state_lines

        if call.excinfo is not None and not call.excinfo.errisinstance(ExpectationError):
            for loaded in loader.loaded:
                lines = [*state_lines(loaded), *loaded.save()]
                report.sections.append((f"mission {Path(loaded.scenario.file).name}", "\n".join(lines)))
        if folder := item.config.getoption("fame_report"):
            from fame.testing.report_folder import PAGE, write_pages

            report.user_properties += [(PAGE, name) for name in write_pages(folder, item.nodeid, loader.loaded)]
    return report


# ---- coverage --------------------------------------------------------------------------------------------------------


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any, error: object) -> None:
    """Take the coverage of a worker of pytest-xdist."""
    plain = getattr(node, "workeroutput", {}).get(_FROM_WORKER)
    if plain is not None:
        node.config.stash[_COVERAGE].merge(json.loads(plain))


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the reports of coverage, and fail if it is too low."""
    coverage = session.config.stash.get(_COVERAGE, None)
    if coverage is None:
        return
    output = getattr(session.config, "workeroutput", None)
    if output is not None:
        output[_FROM_WORKER] = json.dumps(coverage.to_plain())
        return
    _write_reports(session.config, coverage)
    least = session.config.getoption("cov_model_fail_under")
    if least is not None and coverage.percent() < least and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def _write_reports(config: pytest.Config, coverage: Coverage) -> None:
    from fame.testing.coverage import html_report, json_report, junit_report
    from fame.text import write_file

    forms: dict[str, Callable[[], str]] = {
        "html": lambda: html_report(coverage),
        "json": lambda: json.dumps(json_report(coverage), indent=2) + "\n",
        "junit": lambda: junit_report(coverage),
    }
    for form, text in forms.items():
        path = config.getoption(f"cov_model_{form}")
        if path is not None:
            write_file(path, text())


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Name the tests that went another way than they say, decided or used not all, and print the coverage."""
    reports = [one for one in terminalreporter.stats.get("", ()) if isinstance(one, pytest.TestReport)]
    for title in (_LEFT_OUT, _UNDECIDED, _UNUSED):
        found = [(one.nodeid, text) for one in reports for name, text in one.user_properties if name == title]
        if found:
            terminalreporter.section(title)
        for test, text in dict.fromkeys(found):
            terminalreporter.line(f"{test}: {text}")
    if folder := config.getoption("fame_report"):
        from fame.testing.report_folder import write_index

        terminalreporter.section("report")
        terminalreporter.line(str(write_index(folder, terminalreporter.stats)))
    coverage = config.stash.get(_COVERAGE, None)
    if coverage is None:
        return
    from fame.testing.coverage import text_report
    from fame.text import percent

    terminalreporter.section("model coverage")
    for line in text_report(coverage):
        terminalreporter.line(line)
    least = config.getoption("cov_model_fail_under")
    if least is not None and coverage.percent() < least:
        terminalreporter.line(
            f"model coverage of {percent(coverage.percent() / 100, 1)} % is below {least:g} %", red=True
        )
