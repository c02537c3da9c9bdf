"""What a run as a file costs (`fame view RUN.mcap -o run.html`): its size, and the time until its first picture.

    python benchmarks/run_page.py [--times N] [--hour]

Agriculture, warehouse and six robots at an airport; with `--hour` also these six for an hour, whose page is thinned.
Each page is opened from the disk in chromium (playwright) without a network, every time in a new profile. The first
picture is the first frame painted in which all parts that can be seen show the same instant; the time counts from the
start of the navigation.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

from playwright.sync_api import sync_playwright

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from airport import airport
from recorded_runs import record

from fame.scenario import Scenario
from fame.view import Replay
from fame.view.page_file import write_page

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
AIRCRAFT = 90
"""Seconds between two aircraft, in the mission of an hour."""
PICTURE = """window.firstPicture = new Promise((done) => {
  const channel = new MessageChannel();
  channel.port1.onmessage = () => done(performance.now());
  const frame = () => {
    const { fame } = window;
    if (fame?.state && fame.shows(fame.player.time)) channel.port2.postMessage(null); // comes after the frame
    else requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
});"""


def first_picture(browser: Any, path: Path) -> float:
    """Seconds from the navigation to the first picture."""
    context = browser.new_context(offline=True, viewport={"width": 1280, "height": 720})
    context.add_init_script(PICTURE)
    page = context.new_page()
    page.goto(path.as_uri(), wait_until="commit")
    seconds = page.evaluate("firstPicture") / 1e3
    context.close()
    return float(seconds)


def processor_time() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=7, help="how often each page is opened (7)")
    parser.add_argument("--hour", action="store_true", help="also a mission of an hour")
    arguments = parser.parse_args()
    program = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as name, sync_playwright() as play:
        folder = Path(name)
        missions = {each: Scenario.load(EXAMPLES / f"{each}.yaml") for each in ("agriculture", "warehouse")}
        missions["airport"] = airport(folder)
        if arguments.hour:
            missions["airport, an hour"] = airport(folder, every=AIRCRAFT, duration=3600)
        browser = play.chromium.launch(executable_path=program, args=["--no-sandbox"])
        for each, scenario in missions.items():
            recording, path = record(scenario, folder / "run.mcap"), folder / "run.html"
            said: list[str] = []
            before = processor_time()
            with Replay(recording) as replay:
                write_page(path, replay, tell=said.append)
            used = processor_time() - before
            times = sorted(first_picture(browser, path) for _ in range(arguments.times))
            sizes = f"recording {recording.stat().st_size / 1e6:.1f} MB, page {path.stat().st_size / 1e6:.1f} MB"
            print(f"{each}: {sizes}, written in {used:.1f} s of processor time;", end=" ")
            print(f"first picture {median(times):.2f} s ({times[0]:.2f} to {times[-1]:.2f}),", end=" ")
            print(f"load {os.getloadavg()[0]:.1f}", *(line for line in said if "thin" in line), sep="\n  ", flush=True)
        browser.close()


if __name__ == "__main__":
    main()
