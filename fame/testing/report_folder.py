"""The report of tests as a folder: ``index.html``, and for each mission of a test that failed a page that shows it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING
from zlib import crc32

from fame.errors import FameError
from fame.testing.coverage import PAGE_STYLE
from fame.text import write_file

if TYPE_CHECKING:
    import pytest

    from fame.testing.mission import MissionUnderTest

PAGE = "page of the run"
"""Property of a test that failed: the name of a page, or why it was not written."""
_STYLE = "td{overflow-wrap:anywhere}p{margin:.2em 0}pre{overflow-x:auto;max-width:calc(100vw - 16em)}"
_OUTCOMES = ("failed", "error", "xpassed", "xfailed", "skipped", "passed")
_WORST = {"failed": "missing", "error": "missing", "passed": "covered"}


def write_pages(folder: Path, test: str, missions: Iterable[MissionUnderTest]) -> Iterator[str]:
    """Write recording and page of each mission of a test. Yields the addresses of the pages,
    at the instant of the failure, or why one was not written."""
    from fame.view.page_file import write_recording

    plain = f"{re.sub(r'[^A-Za-z0-9]+', '_', test)[-80:]}_{crc32(test.encode()):08x}"
    for number, mission in enumerate((one for one in missions if one.begun), 1):
        recording = folder / f"{plain}_{number}.mcap"
        try:
            write_file(recording, mission.recorded())
            write_recording(recording.with_suffix(".html"), recording)
        except FameError as error:  # hides no failure
            yield f"no page: {error}"
        else:
            yield f"{recording.stem}.html#t={mission.now:g}"


def write_index(folder: Path, found: Mapping[str, Sequence[pytest.TestReport]]) -> Path:
    """Write the list of tests by outcome, those that failed first, with the pages of their missions."""
    rows = [(outcome, report) for outcome in _OUTCOMES for report in found.get(outcome, ()) if hasattr(report, "when")]
    total = ", ".join(f"{len(found[outcome])} {outcome}" for outcome in _OUTCOMES if found.get(outcome))
    body = [f"<h1>{total or 'no tests'}</h1><table><tr><th>outcome<th>test<th>s</tr>"]
    body += [_row(outcome, report) for outcome, report in rows]
    policy = "default-src 'none'; style-src 'unsafe-inline'"
    head = f'<meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="{policy}">'
    head += (
        f'<meta name="viewport" content="width=device-width"><title>Tests</title><style>{PAGE_STYLE}{_STYLE}</style>'
    )
    page = f"<!doctype html><html lang=en><head>{head}</head><body>{''.join(body)}</table></body></html>\n"
    write_file(folder / "index.html", page)
    return folder / "index.html"


def _row(outcome: str, report: pytest.TestReport) -> str:
    pages = [str(value) for name, value in report.user_properties if name == PAGE]
    links = [
        f'<p><a href="{page}">watch it</a></p>' if ".html#" in page else f"<p>{escape(page)}</p>" for page in pages
    ]
    text = report.longreprtext if outcome in ("failed", "error") else ""
    why = f"<details><summary>why</summary><pre>{escape(text)}</pre></details>" if text else ""
    cells = (outcome, "".join((escape(report.nodeid), *links, why)), f"{report.duration:.2f}")
    return f'<tr class="{_WORST.get(outcome, "excused")}">{"".join(f"<td>{cell}</td>" for cell in cells)}</tr>'
