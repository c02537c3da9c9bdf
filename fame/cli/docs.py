"""``fame docs``: the documentation as a site, which comes with the package."""

from __future__ import annotations

import threading
from argparse import Namespace
from importlib.resources import files
from pathlib import Path

from fame.cli.arguments import Commands, command
from fame.errors import FameError
from fame.text import suggestion

_SITE = Path(str(files("fame"))) / "site"
"""Where ``make docs`` builds it; a wheel that was built afterwards has it."""


def add(commands: Commands) -> None:
    parser = command(
        commands, "docs", run, examples=("fame docs", "fame docs cookbook", "fame docs --no-open"),
        help="open the documentation in the browser, offline",
    )  # fmt: skip
    parser.add_argument("page", nargs="?", default="index", metavar="PAGE", help="a page, as semantics (the first one)")
    parser.add_argument("--no-open", action="store_true", help="print the address only")


def run(arguments: Namespace) -> int:
    """Print the address of the page, and open it in the browser unless told not to."""
    address = _page(arguments.page).as_uri()
    print(address)
    if not arguments.no_open:
        import webbrowser

        opening = threading.Thread(target=webbrowser.open, args=(address,), daemon=True)
        opening.start()
        opening.join(5)  # a browser without a window may stay in the terminal
    return 0


def _as_text() -> str:
    """Where a checkout has the pages; empty elsewhere."""
    index = _SITE.parent.parent / "docs" / "index.md"
    return f"; its pages are in {index.parent}" if index.is_file() else ""


def _page(name: str) -> Path:
    """The file of a page. Raises FameError if the page or the site does not exist."""
    pages = {path.stem: path for path in sorted((_SITE / "docs").glob("*.html"))}
    if not pages:
        raise FameError(f"{_SITE}: the site is not built; make docs builds it{_as_text()}")
    if name not in pages:
        raise FameError(f"unknown page {name!r}; {suggestion(name, pages)}")
    return pages[name]
