"""Make the pictures of `fame view` for README and docs: record examples, open their pages, look at an instant.

    python docs/screenshots.py [--to FOLDER] [NAME ...]

Each picture is compared with the one in docs/images: what differs is to be looked at. Needs chromium and the packages
playwright and pillow. CI's browser stage makes them into out/screenshots.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from PIL import Image, ImageChops
from playwright.sync_api import sync_playwright

from fame.log import About, logging_to
from fame.scenario import Scenario
from fame.view import Replay, Server

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROOT = Path(__file__).parent.parent
IMAGES = ROOT / "docs" / "images"
READY = """!!(window.fame && fame.mission.kind && fame.drawing && fame.mission.reading >= 1
  && fame.store.blocks.every(one => one.data))"""
DIFFERS = 24
"""Of 255: a smaller difference of a pixel is that of fonts and of smooth edges."""


class Shot(NamedTuple):
    """A picture: of which example, when (s), what is done on the page before, and how large its window is (pixels)."""

    example: str
    time: float
    script: str = "fame.tabs.choose('diagram')"
    theme: str = "light"
    size: tuple[int, int] = (1440, 900)


SHOTS = {
    "view_agriculture": Shot("agriculture", 110.0, "fame.tabs.choose('diagram'); fame.timeline.window(80e9, 70e9)"),
    "view_ground_vehicles": Shot(
        "ground_vehicles",
        85.0,
        "fame.tabs.choose('diagram'); fame.select({robot: 1}); fame.timeline.window(55e9, 42e9);"
        "fame.plots.toggle({r: 0, name: 'x_target'})",
        "dark",
    ),
    "view_reassembly": Shot("reassembly", 11.2, "fame.tabs.choose('diagram'); fame.select({robot: 0})"),
    "view_phone": Shot("agriculture", 110.0, "fame.tabs.choose('team')", size=(390, 700)),
}


def main(arguments: list[str]) -> int:
    """Make the pictures with these names, or all."""
    parser = argparse.ArgumentParser(description="Make the pictures of fame view for README and docs.")
    parser.add_argument("names", nargs="*", choices=[[], *SHOTS], metavar="NAME", help=f"of {', '.join(SHOTS)}")
    parser.add_argument("--to", type=Path, default=IMAGES, metavar="FOLDER", help="(docs/images)")
    options = parser.parse_args(arguments)
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        print("docs/screenshots.py: needs chromium", file=sys.stderr)
        return 2
    options.to.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as play, tempfile.TemporaryDirectory() as folder:
        browser = play.chromium.launch(executable_path=program, args=["--no-sandbox"])
        for name in options.names or SHOTS:
            made = Path(folder) / f"{name}.png"
            take(browser, SHOTS[name], made, Path(folder))
            print(f"{options.to / made.name}: {difference(made, IMAGES / made.name)}")
            shutil.copy(made, options.to)
        browser.close()
    return 0


def difference(made: Path, known: Path) -> str:
    """Say how much of a picture differs from the known one."""
    if not known.exists():
        return "new"
    with Image.open(made) as one, Image.open(known) as other:
        if one.size != other.size:
            return f"has the size {one.size}, that in docs/images {other.size}"
        apart = ImageChops.difference(one.convert("L"), other.convert("L"))
        share = sum(apart.histogram()[DIFFERS:]) / (one.width * one.height)
    return f"{share:.1%} of its pixels differ from docs/images{': look at both' if share > 0.01 else ''}"


def record(example: str, recording: Path) -> None:
    """Record an example, unless that was done."""
    if recording.exists():
        return
    scenario = Scenario.load(ROOT / "examples" / f"{example}.yaml")
    about = About(metadata={"scenario": f"{example}.yaml", "seed": str(scenario.seed)})
    with logging_to(recording, scenario.closures(), about) as log:
        scenario.run(observer=log)


def take(browser: Browser, shot: Shot, path: Path, folder: Path) -> None:
    """Take a picture of a recorded example."""
    recording = folder / f"{shot.example}.mcap"
    record(shot.example, recording)
    with Replay(recording) as source, Server(source) as server:
        page: Any = browser.new_page(viewport={"width": shot.size[0], "height": shot.size[1]}, color_scheme=shot.theme)
        page.goto(server.address)
        while not page.evaluate(READY):
            time.sleep(0.1)
        page.evaluate(f"fame.player.seek({shot.time}e9); {shot.script}")
        page.wait_for_timeout(1000)
        page.screenshot(path=path)
        page.close()
    with Image.open(path) as picture:  # a page has few colours: with a palette it takes a third
        picture.convert("RGB").quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(
            path, optimize=True
        )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
