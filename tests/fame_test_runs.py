"""`fame test` on folders of tests, within the process of a test: a process of its own takes two seconds to start."""

from __future__ import annotations

import io
import sys
import warnings
from contextlib import chdir, redirect_stdout
from pathlib import Path

from fame.cli import main


def fame_test(*words: str, folder: Path | None = None) -> tuple[int, str]:
    """Run `fame test` in a folder (the current one): its exit code, and what it printed.

    Modules of tests are hidden from it, and its own are gone afterwards: they may have the same names.
    """
    path, output = sys.path[:], io.StringIO()
    hidden = _test_modules()
    try:
        with chdir(folder or Path.cwd()), redirect_stdout(output), warnings.catch_warnings():
            warnings.simplefilter("default")
            code = main(["test", *words])
    finally:
        _test_modules()
        sys.modules.update(hidden)
        sys.path[:] = path
    return code, output.getvalue()


def _test_modules() -> dict[str, object]:
    """Take the modules of tests out of those that are imported."""
    names = [name for name in sys.modules if name.startswith(("test_", "conftest"))]
    return {name: sys.modules.pop(name) for name in names}
