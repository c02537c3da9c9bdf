"""How soon the findings of `fame edit` follow a change, and how smooth the page stays meanwhile.

    python benchmarks/editing.py                 # 200 elements, 40 changes
    python benchmarks/editing.py --elements 800

Draws a model of two robots in chromium (playwright), with the library that ``fame edit --fetch`` has installed. Each
change renames an activity or moves it; in between the diagram is dragged by the mouse. Prints the time from a change
until its findings are shown (median, p95, max; 80 ms of it the page waits for further changes), what of it the server
needs, and the frames per second of the page while it happens (mean, and p5 of all half seconds). On a busy machine
these say little: two lines have the processor time of a change, in the page's main thread and in the server.

Measured 2026-11-29 with 200 elements on two quiet processors (load 2): findings after 155 ms (median; p95 257 ms), 60
frames per second (p5 56). By processor time a change needs 26 ms in the page (p95 32), 36 ms in the server (p95 122).
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from fame.bpmn import read_text
from fame.edit.modeler import installed
from fame.edit.session import ModelEdit
from fame.layout import add_diagram
from fame.view import Server

HEAD = """<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" id="D" targetNamespace="t"
  xmlns:camunda="http://camunda.org/schema/1.0/bpmn">"""
BEGIN = """() => {
    window.frames_ = []; window.late = []; let before = performance.now(), since = null;
    const frame = (now) => {
        frames_.push(now - before); before = now;
        if (since !== null && edit.checked === edit.changes) { late.push(now - since); since = null; }
        requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
    edit.modeler.on('commandStack.changed', () => (since = performance.now()));
}"""
CHANGE = """([id, number]) => {
    const modeling = edit.modeler.get('modeling'), element = edit.modeler.get('elementRegistry').get(id);
    if (number % 2) modeling.updateProperties(element, {name: `Count ${number}`});
    else modeling.moveElements([element], {x: number % 4 ? 10 : -10, y: 0});
}"""


def model(elements: int) -> bytes:
    """Two robots: a signal between them, then tasks and gateways one behind the other, `elements` with flows."""
    pools, bodies = "", ""
    for pool in ("A", "B"):
        nodes, flows = [f'<startEvent id="{pool}0"/>'], []
        for number in range(1, elements // 4):
            id = f"{pool}{number}"
            signal = '<signalEventDefinition signalRef="S"/>'
            nodes.append(
                (f'<intermediateThrowEvent id="{id}">{signal}</intermediateThrowEvent>' if pool == "A" else
                 f'<intermediateCatchEvent id="{id}">{signal}</intermediateCatchEvent>') if number == 2 else
                f'<scriptTask id="{id}" name="Count {id}"><script>a{number} = a{number - 1} + 1</script></scriptTask>'
                if number > 1 else f'<scriptTask id="{id}"><script>a1 = a2 = 0</script></scriptTask>'
            )  # fmt: skip
            flows.append(f'<sequenceFlow id="{id}f" sourceRef="{pool}{number - 1}" targetRef="{id}"/>')
        bodies += f'<process id="P{pool}" isExecutable="true">{"".join(nodes + flows)}</process>'
        pools += f'<participant id="X{pool}" name="R{pool}" processRef="P{pool}"/>'
    text = f'{HEAD}<signal id="S" name="s"/><collaboration id="C">{pools}</collaboration>{bodies}</definitions>'
    return bytes(add_diagram(read_text(text, file="m.bpmn")))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--elements", type=int, default=200)
    parser.add_argument("--changes", type=int, default=40)
    arguments = parser.parse_args()
    from playwright.sync_api import sync_playwright

    served, worked, painted = list[float](), list[float](), list[float]()

    class Timed(ModelEdit):
        def control(self, command: Any) -> Any:
            begun, spent = time.perf_counter(), time.thread_time()
            try:
                return super().control(command)
            finally:
                if command.get("do") == "check":
                    served.append((time.perf_counter() - begun) * 1000)
                    worked.append((time.thread_time() - spent) * 1000)

    program = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as play:
        path = Path(folder, "m.bpmn")
        path.write_bytes(model(arguments.elements))
        browser = play.chromium.launch(executable_path=program, args=["--no-sandbox"])
        with Timed(path, installed()) as source, Server(source) as server:
            page = browser.new_page(viewport={"width": 1440, "height": 900})
            page.goto(server.address)
            while not page.evaluate("window.edit?.ready && edit.checked === edit.changes && edit.drawn !== ''"):
                page.wait_for_timeout(50)
            page.evaluate(BEGIN)
            page.mouse.move(500, 640)
            for number in range(arguments.changes):
                page.evaluate(CHANGE, [f"A{3 + number % 20}", number])
                page.mouse.down()
                for step in range(25):
                    page.mouse.move(500 + 8 * (step if number % 2 else -step), 640)
                    page.wait_for_timeout(16)
                page.mouse.up()
            page.wait_for_timeout(1000)
            frames, late = page.evaluate("[frames_, late]")
            metrics = page.context.new_cdp_session(page)
            metrics.send("Performance.enable", {"timeDomain": "threadTicks"})
            for number in range(arguments.changes):
                before = _busy(metrics)
                page.evaluate(CHANGE, [f"A{3 + number % 20}", number])
                while not page.evaluate("edit.checked === edit.changes"):
                    page.wait_for_timeout(50)
                painted.append((_busy(metrics) - before) * 1000)
        browser.close()
    report(arguments.elements, frames, {
        "findings are shown after": late, "of which the server": served[1:],
        "processor time of the page": painted, "processor time of the server": worked[1:],
    })  # fmt: skip


def _busy(metrics: Any) -> float:
    """The processor time of the page's main thread (s)."""
    found = metrics.send("Performance.getMetrics")["metrics"]
    return float(next(one["value"] for one in found if one["name"] == "TaskDuration"))


def report(elements: int, frames: list[float], times: dict[str, list[float]]) -> None:
    """Print what was measured (ms)."""
    rates, count, spent = list[float](), 0, 0.0
    for frame in frames:
        count, spent = count + 1, spent + frame
        if spent >= 500:
            rates.append(1000 * count / spent)
            count, spent = 0, 0.0
    print(f"{elements} elements")
    for what, values in times.items():
        cuts = statistics.quantiles(values, n=20)
        print(f"{what}: median {statistics.median(values):.0f} ms, p95 {cuts[18]:.0f} ms, max {max(values):.0f} ms")
    print(
        f"frames per second: mean {1000 * len(frames) / sum(frames):.0f}, p5 {statistics.quantiles(rates, n=20)[0]:.0f}"
    )


if __name__ == "__main__":
    main()
