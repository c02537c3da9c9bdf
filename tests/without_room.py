"""Take a room of `fame.rooms` away: its modules cannot be imported any more.

``python tests/without_room.py ROOM FILE...`` runs the command lines on stdin (JSON) without it, one after the other in
one process, and then the tests of files; stdout gets the exit code and output of each as JSON.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from importlib.abc import MetaPathFinder
from io import StringIO
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


class Absent(MetaPathFinder):
    """Finds no module of a room."""

    def __init__(self, modules: tuple[str, ...]) -> None:
        self._homes = tuple(f"{module}." for module in modules)

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        if f"{name}.".startswith(self._homes):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


class NeedsTheRoom:
    """A plugin of pytest: a test that ends since it needs the room is skipped."""

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
        report = yield
        error = call.excinfo.value if call.excinfo is not None else None
        if error is not None and "this installation lacks" in f"{error} {error.__cause__}":
            report.outcome, report.longrepr = "skipped", (str(item.path), 0, "needs the room")
        return report


def outcomes(lines: list[list[str]], files: list[str]) -> Iterator[tuple[int, str]]:
    """The exit code and output of each command line, and of the tests."""
    from fame.cli import main

    for line in lines:
        output = StringIO()
        with redirect_stdout(output), redirect_stderr(output):
            try:
                code = main(line)
            except SystemExit as end:
                code = int(end.code or 0)
        yield code, output.getvalue()
    os.chdir(ROOT)
    output = StringIO()
    options = ["-q", "-o", "addopts=", "-p", "no:fame.testing.plugin", "-p", "no:cacheprovider", "-m", "not long"]
    with redirect_stdout(output):
        code = int(pytest.main([*options, *files], plugins=[NeedsTheRoom()]))
    yield code, output.getvalue()


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    from fame.rooms import ROOMS

    sys.meta_path.insert(0, Absent(ROOMS[sys.argv[1]].modules))
    print(json.dumps(list(outcomes(json.load(sys.stdin), sys.argv[2:]))))
