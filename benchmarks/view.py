"""What the page of a long recording costs: 20 robots and a million events.

    python benchmarks/view.py [--robots N] [--events N]

Makes a recording, serves it, and measures in chromium (playwright): until the page shows the first state, jumps to
instants that the server has not read yet, jumps once everything is loaded, and the frames of scrubbing across the whole
run. Between two jumps there are 0.1 to 0.3 s, as between two clicks: the page goes on to load meanwhile. A jump ends
when the browser has laid out and painted a frame in which all parts of the page that can be seen show the instant.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

from fame.bpmn.reader import read
from fame.log.recording_file import RecordingFile
from fame.view import Replay, Server

MODEL = Path(__file__).parent.parent / "models" / "agriculture.bpmn"
SECOND = 1_000_000_000
PER_VISIT, STEP = 5, SECOND // 10
SCRUB = """async () => {
  const gaps = [], end = fame.store.end;
  let last = performance.now();
  for (let frame = 0; frame < 180; frame += 1) {
    fame.player.seek(end * (0.5 + 0.5 * Math.sin(frame / 18)));
    await new Promise((done) => requestAnimationFrame(done));
    const now = performance.now();
    gaps.push(now - last);
    last = now;
  }
  gaps.sort((a, b) => a - b);
  return {median: gaps[90], slow: gaps[170], worst: gaps[179]};
}"""
JUMPS = """async (places) => {
  const times = [], { end, blocks } = fame.store, from = blocks.at(-1).end / end;
  const painted = (time) => new Promise((done) => {
    const after = new MessageChannel();
    let shown = false;
    const frame = () => {
      shown = fame.shows(time);
      after.port2.postMessage(null); // comes when the frame has been painted
    };
    after.port1.onmessage = () => (shown ? done() : requestAnimationFrame(frame));
    requestAnimationFrame(frame);
  });
  for (const [place, rest] of places) {
    await new Promise((done) => setTimeout(done, rest));
    const time = Math.floor(end * place), begun = performance.now();
    fame.player.seek(time);
    await painted(time);
    times.push(Math.round(performance.now() - begun));
  }
  const of = (part) => [...times].sort((a, b) => a - b)[Math.ceil(part * times.length) - 1];
  return {read: from, median: of(0.5), slow: of(0.95), worst: of(1), times};
}"""
AHEAD = [(0.8 + 0.19 * (jump * 0.618 % 1), 100 + 200 * (jump * 0.382 % 1)) for jump in range(20)]
LOADED = [(jump * 0.618 % 1, 100 + 200 * (jump * 0.382 % 1)) for jump in range(30)]


def record(path: Path, robots: int, events: int) -> None:
    """A recording of tractors that go through their process again and again, with variables and waits."""
    definitions = read(MODEL)
    process = next(one for one in definitions.processes if "Tractor" in one.id)
    nodes, flow = [node.id for node in process.body.nodes][:40], process.body.flows[0].id
    with path.open("wb") as stream:
        file = RecordingFile(stream)
        file.describe({"seed": "0"})
        file.attach("models/agriculture.bpmn", "application/bpmn+xml", definitions.source)
        names = [f"Tractor_{number + 1}" for number in range(robots)]
        for name in names:
            start = {"instance": 1, "scope": 1, "marks": [[process.id, "start"]]}
            file.put("/fame/events", 0, {"robot": name, "events": [start]})
        counts: list[Counter[str]] = [Counter() for _ in names]
        for visit in range(events // PER_VISIT):
            if visit % (robots * SECOND // STEP) == 0:
                file.put("/fame/key", visit // robots * STEP, key_of(names, process.id, counts))
            counts[visit % robots][nodes[visit // robots % len(nodes)]] += 1
            robot, at = visit % robots, visit // robots * STEP + visit % robots * 1000 + 1
            now, following = nodes[visit // robots % len(nodes)], nodes[(visit // robots + 1) % len(nodes)]
            begun = [[now, "enter"]] if visit < robots else []
            marks = [
                *begun,
                [now, "leave"],
                [flow, "take"],
                [following, "enter"],
                ["", "log", "on the way"],
                [flow, "take"],
            ]
            group = {"instance": 1, "scope": 1, "marks": marks}
            file.put("/fame/events", at, {"robot": names[robot], "events": [group]})
            change = {"instance": 1, "scope": 1, "path": [], "set": {"x": visit % 97, "y": visit % 89 / 7}}
            if visit % 4 == 0:
                file.put("/fame/variables", at, {"robot": names[robot], "changes": [change]})
        file.finish()


def key_of(names: list[str], process: str, counts: list[Counter[str]]) -> dict[str, Any]:
    """The state of all robots, as recordings have it once a second."""
    instances = [{"instance": 1, "process": process, "status": "running"}]
    robots = {
        name: {
            "process": process,
            "instances": instances,
            "tokens": [],
            "variables": [],
            "counts": {id: {"enter": times, "leave": times} for id, times in own.items()},
        }
        for name, own in zip(names, counts, strict=True)
    }
    return {"robots": robots}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--events", type=int, default=1_000_000)
    arguments = parser.parse_args()
    program = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as play, ExitStack() as opened:
        path = Path(folder, "long.mcap")
        record(path, arguments.robots, arguments.events)
        print(f"load {os.getloadavg()[0]:.1f}; {path.stat().st_size / 1e6:.1f} MB")
        browser = play.chromium.launch(executable_path=program, args=["--no-sandbox"])
        page: Any = browser.new_page(viewport={"width": 1280, "height": 720})
        page.add_init_script(
            "sessionStorage.setItem('fame-tab', 'diagram')"
        )  # it opens on the team, which has no jumps
        begun = time.monotonic()
        source = opened.enter_context(Replay(path))
        server = opened.enter_context(Server(source))
        page.goto(server.address)
        wait(page, "window.fame && fame.state !== null")
        print(f"opens in {time.monotonic() - begun:.2f} s (command to first state)")
        print("jumps into what is not read yet, ms:", page.evaluate(JUMPS, AHEAD))
        begun = time.monotonic()
        wait(page, "fame.mission.reading >= 1 && fame.store.blocks.every((one) => one.data)")
        blocks = page.evaluate("fame.store.blocks.length")
        print(f"everything loaded after {time.monotonic() - begun:.1f} s: {blocks} blocks")
        print("jumps, ms:", page.evaluate(JUMPS, LOADED))
        scrub = page.evaluate(SCRUB)
        print("scrubbing, ms a frame:", scrub, f"-> {1000 / scrub['slow']:.0f} frames/s or more in 95 %")
        browser.close()


def wait(page: Any, condition: str) -> None:
    """Wait until an expression is true on the page."""
    while not page.evaluate(condition):
        time.sleep(0.01)


if __name__ == "__main__":
    main()
