"""``fame docs``: the documentation, which comes with the package, as a site or in the terminal."""

from __future__ import annotations

import threading
from argparse import Namespace
from importlib.resources import files
from pathlib import Path

from fame.cli.arguments import Commands, command
from fame.cli.output import note
from fame.errors import FameError
from fame.text import suggestion

_FAME = Path(str(files("fame")))
_SITE = _FAME / "site"
"""Where ``make docs`` builds it; a wheel that was built afterwards has it."""
_PAGES = (_FAME / "docs", _FAME.parent / "docs")
"""Where a wheel and a checkout have the pages as text."""


def add(commands: Commands) -> None:
    parser = command(
        commands, "docs", run, examples=("fame docs", "fame docs cookbook", "fame docs --text yaml_keys"),
        help="open the documentation in the browser, offline, or print a page of it",
    )  # fmt: skip
    parser.add_argument("page", nargs="?", default="index", metavar="PAGE", help="a page, as semantics (the first one)")
    parser.add_argument("--no-open", action="store_true", help="print the address only")
    parser.add_argument("--text", action="store_true", help="print the page, as a FAME without the site does")


def run(arguments: Namespace) -> int:
    """Print the address of the page, and open it in the browser unless told not to; or print its text."""
    page = _page(arguments.page, text=arguments.text)
    if page.suffix == ".md":
        if not arguments.text:
            note("fame: note: this FAME was built without the site (make docs, in a checkout): the page as text")
        print(page.read_text(encoding="utf-8"))
        return 0
    print(page.as_uri())
    if not arguments.no_open:
        import webbrowser

        opening = threading.Thread(target=webbrowser.open, args=(page.as_uri(),), daemon=True)
        opening.start()
        opening.join(5)  # a browser without a window may stay in the terminal
    return 0


def _page(name: str, *, text: bool) -> Path:
    """The file of a page: of the site, or as text. Raises FameError for an unknown one."""
    shown = {path.stem: path for path in sorted((_SITE / "docs").glob("*.html"))}
    if text or not shown:
        shown = {path.stem: path for folder in reversed(_PAGES) for path in sorted(folder.glob("*.md"))}
    if not shown:
        raise FameError(f"{_FAME}: has no documentation: install FAME again")
    if name not in shown:
        raise FameError(f"unknown page {name!r}; {suggestion(name, shown)}")
    return shown[name]
