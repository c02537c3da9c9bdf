"""Make the pictures of `fame view` for README and docs: record examples, open their pages, look at an instant.

    python docs/screenshots.py [NAME ...]

Needs chromium and the package playwright.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from playwright.sync_api import sync_playwright

from fame.log import About, logging_to
from fame.scenario import Scenario
from fame.view import Replay, Server

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROOT = Path(__file__).parent.parent
READY = "!!(window.fame && fame.mission.kind && fame.mission.reading >= 1 && fame.store.blocks.every(one => one.data))"


class Shot(NamedTuple):
    """A picture: of which example, when (s), and what is done on the page before."""

    example: str
    time: float
    script: str = ""
    theme: str = "light"


SHOTS = {
    "view_agriculture": Shot("agriculture", 134.0, "fame.timeline.window(80e9, 70e9)"),
    "view_ground_vehicles": Shot(
        "ground_vehicles",
        85.0,
        "fame.select({robot: 1}); fame.timeline.window(55e9, 42e9); fame.plots.toggle({r: 0, name: 'x_target'})",
        "dark",
    ),
    "view_reassembly": Shot("reassembly", 11.2, "fame.select({robot: 0})"),
}


def main(names: list[str]) -> int:
    """Make the pictures with these names, or all."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        print("docs/screenshots.py: needs chromium", file=sys.stderr)
        return 2
    with sync_playwright() as play, tempfile.TemporaryDirectory() as folder:
        browser = play.chromium.launch(executable_path=program, args=["--no-sandbox"])
        for name, shot in SHOTS.items():
            if not names or name in names:
                print(take(browser, shot, ROOT / "docs" / "images" / f"{name}.png", Path(folder)))
        browser.close()
    return 0


def take(browser: Browser, shot: Shot, path: Path, folder: Path) -> Path:
    """Take a picture of a recorded example."""
    recording = folder / f"{shot.example}.mcap"
    scenario = Scenario.load(ROOT / "examples" / f"{shot.example}.yaml")
    about = About(metadata={"scenario": f"{shot.example}.yaml", "seed": str(scenario.seed)})
    with logging_to(recording, scenario.closures(), about) as log:
        scenario.run(observer=log)
    with Replay(recording) as source, Server(source) as server:
        page: Any = browser.new_page(viewport={"width": 1440, "height": 900}, color_scheme=shot.theme)
        page.goto(server.address)
        while not page.evaluate(READY):
            time.sleep(0.1)
        page.evaluate(f"fame.player.seek({shot.time}e9); {shot.script}")
        page.wait_for_timeout(600)
        page.screenshot(path=path)
        page.close()
    return path


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
