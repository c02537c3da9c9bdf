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
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

from fame.bpmn.reader import read
from fame.log.recording_file import RecordingFile
from fame.robot.robot_state import EVENTS, VARIABLES, RobotState
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
        states = {name: RobotState() for name in names}

        def put(topic: str, at: int, name: str, data: dict[str, Any]) -> None:
            states[name].apply(topic, data, at)
            file.put(topic, at, {"robot": name, **data})

        for name in names:
            start = {"instance": 1, "scope": 1, "marks": [[process.id, "start"]]}
            put(EVENTS, 0, name, {"opens": [{"scope": 1, "instance": 1}], "events": [start]})
        for visit in range(events // PER_VISIT):
            if visit % (robots * SECOND // STEP) == 0:
                keys = {name: state.to_key() for name, state in states.items()}
                file.put("/fame/key", visit // robots * STEP, {"robots": keys})
            name, at = names[visit % robots], visit // robots * STEP + visit % robots * 1000 + 1
            now, following = nodes[visit // robots % len(nodes)], nodes[(visit // robots + 1) % len(nodes)]
            marks = [
                *([[now, "enter"]] if visit < robots else []),
                [now, "leave"],
                [flow, "take"],
                [following, "enter"],
                ["", "log", "on the way"],
                [flow, "take"],
            ]
            put(EVENTS, at, name, {"events": [{"instance": 1, "scope": 1, "marks": marks}]})
            if visit % 4 == 0:
                put(VARIABLES, at, name, {"changes": [{"scope": 1, "set": {"x": visit % 97, "y": visit % 89 / 7}}]})
        file.finish()


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
        wait(page, "fame.mission.reading >= 1 && (fame.store.full || fame.store.blocks.every((one) => one.data))")
        blocks = page.evaluate("fame.store.blocks.length")
        print(f"all that has room loaded after {time.monotonic() - begun:.1f} s: {blocks} blocks")
        print("jumps, ms:", page.evaluate(JUMPS, LOADED))
        scrub = page.evaluate(SCRUB)
        print("scrubbing, ms a frame:", scrub, f"-> {1000 / scrub['slow']:.0f} frames/s or more in 95 %")
        browser.close()


def wait(page: Any, condition: str) -> None:
    """Wait until an expression is true on the page. Raises TimeoutError after two minutes."""
    end = time.monotonic() + 120
    while not page.evaluate(condition):
        if time.monotonic() > end:
            raise TimeoutError(condition)
        time.sleep(0.01)


if __name__ == "__main__":
    main()
