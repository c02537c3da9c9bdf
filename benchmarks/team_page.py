"""What the table of a large team costs: 100 robots at work, seen in Chromium.

    python benchmarks/team_page.py [--robots N] [--rate HZ] [--seconds S]

Robots publish batches of events as engines do (`rate` a second each: three events, a variable, a wait), and status and
battery once a second. Each second one of them comes to a user task: measured is the time from the batch, as it is
published, to the first frame in which the table shows that robot as waiting for a person; and the frames meanwhile.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import threading
import time
from typing import Any

from playwright.sync_api import Page, sync_playwright

from fame.clock import SECOND, WallScheduler
from fame.deploy import STATUS_QOS
from fame.middleware import messages
from fame.middleware.interface import LATCHED
from fame.middleware.local import LocalMiddleware
from fame.view import Server, TeamView

STRING, BATTERY = "std_msgs/msg/String", "sensor_msgs/msg/BatteryState"
MODEL = """<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL"
  xmlns:bpmndi="http://www.omg.org/spec/BPMN/20100524/DI" xmlns:dc="http://www.omg.org/spec/DD/20100524/DC"
  targetNamespace="http://fame" id="d"><process id="Porter" isExecutable="true">
  <startEvent id="Start"/><serviceTask id="Carry" name="Carry to ward"/><userTask id="Sign" name="Sign for it"/>
  <sequenceFlow id="f0" sourceRef="Start" targetRef="Carry"/><sequenceFlow id="f1" sourceRef="Carry" targetRef="Sign"/>
  <sequenceFlow id="f2" sourceRef="Sign" targetRef="Carry"/></process>
  <bpmndi:BPMNDiagram id="di"><bpmndi:BPMNPlane id="pl" bpmnElement="Porter">
  <bpmndi:BPMNShape id="a" bpmnElement="Carry"><dc:Bounds x="0" y="0" width="100" height="80"/></bpmndi:BPMNShape>
  <bpmndi:BPMNShape id="b" bpmnElement="Sign"><dc:Bounds x="160" y="0" width="100" height="80"/></bpmndi:BPMNShape>
  </bpmndi:BPMNPlane></bpmndi:BPMNDiagram></definitions>"""
WATCH = """() => {
  window.seen = {}, window.gaps = [];
  let last = performance.now();
  const frame = (now) => {
    gaps.push(now - last);
    last = now;
    for (const row of document.querySelectorAll(".roster .robot.waiting")) {
      const name = row.querySelector(".who").textContent;
      if (!(name in seen)) seen[name] = performance.timeOrigin + performance.now();
    }
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
}"""


class Robot:
    """What the engine of a robot publishes."""

    def __init__(self, name: str, middleware: LocalMiddleware, scheduler: WallScheduler) -> None:
        self.name, self._scheduler, self._batch, self._step, self._epoch = name, scheduler, 0, 0, EPOCH
        node = middleware.node(f"/{name}/fame_engine")
        self._events = node.publisher(f"/{name}/bpmn_events", STRING)
        self._model = node.publisher(f"/{name}/bpmn_model", STRING, LATCHED)
        self._status, self._charge = (
            node.publisher(f"/{name}/bpmn_status", STRING, STATUS_QOS),
            node.publisher(f"/{name}/battery_state", BATTERY),
        )
        self.waits = False

    def begin(self) -> None:
        models = [{"name": "porter.bpmn", "xml": MODEL}]
        text = {"robot": self.name, "process": "Porter", "epoch": self._epoch, "seed": 0, "models": models}
        self._publish(self._model, text)
        self._send([["Porter", "start"], ["Start", "enter"], ["Start", "leave"], ["Carry", "enter"]], begins="Porter")

    def work(self) -> None:
        """One batch: the same task again."""
        if not self.waits:
            self._step += 1
            self._send([["Carry", "leave"], ["f1", "take"], ["Carry", "enter"]], token=("carry", "Carry", "action"))

    def ask(self) -> float:
        """Come to the user task. Gives the time (s since 1970)."""
        self.waits, now = True, time.time()
        self._send([["Carry", "leave"], ["f1", "take"], ["Sign", "enter"]], ["carry"], token=("sign", "Sign", "user"))
        return now

    def signed(self) -> None:
        self.waits = False
        self._send([["Sign", "leave"], ["f2", "take"], ["Carry", "enter"]], gone=["sign"])

    def report(self) -> None:
        self._publish(self._status, {})
        self._charge.publish(messages.create(BATTERY, {"percentage": 1 - self._step % 3000 / 3000}))

    def _send(self, marks: Any, gone: Any = (), token: Any = None, **more: Any) -> None:
        now = self._scheduler.now
        scope = {"instance": 1, "scope": 1, "path": []}
        waits = (
            [dict(scope, key=token[0], element=token[1], kind=token[2], body="Porter", since=now, text=token[2])]
            if token
            else []
        )
        changes = [
            ["events", now, {"robot": self.name, "events": [{"instance": 1, "scope": 1, "marks": marks}]}],
            ["variables", now, {"robot": self.name, "changes": [{**scope, "set": {"x": self._step}, "unset": []}]}],
            ["waiting", now, {"robot": self.name, "tokens": waits, "gone": list(gone)}],
        ]
        self._batch += 1
        about = {"robot": self.name, "session": 1, "batch": self._batch, "epoch": self._epoch, "time": now}
        self._publish(self._events, {**about, **more, "changes": changes})

    def _publish(self, publisher: Any, content: Any) -> None:
        publisher.publish(messages.create(STRING, json.dumps(content)))


EPOCH = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())


def ranks(values: list[float]) -> str:
    ranked = sorted(values)
    median, slow = (ranked[min(len(ranked) - 1, int(share * len(ranked)))] for share in (0.5, 0.95))
    return f"median {median:.0f}, 95 % {slow:.0f}, worst {ranked[-1]:.0f}"


def metrics(session: Any) -> dict[str, float]:
    """Seconds that the page has spent so far."""
    found = {one["name"]: one["value"] for one in session.send("Performance.getMetrics")["metrics"]}
    return {name: found[f"{name}Duration"] for name in ("Task", "Script", "Layout", "RecalcStyle")}


def measure(page: Page, team: list[Robot], scheduler: WallScheduler, seconds: int) -> None:
    page.evaluate(WATCH)
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})  # processor time: others may use the machine, too
    before = metrics(session)
    asked: dict[str, float] = {}
    for step in range(seconds):
        robot = team[step * 37 % len(team)]
        scheduler.soon(lambda robot=robot: asked.update({robot.name: robot.ask()}))
        page.wait_for_timeout(1000)
        scheduler.soon(robot.signed)
    page.wait_for_timeout(500)
    spent = {name: 1000 * (value - before[name]) / (seconds + 0.5) for name, value in metrics(session).items()}
    print("page, ms of processor time a second:", ", ".join(f"{name} {value:.0f}" for name, value in spent.items()))
    seen, gaps = page.evaluate("[seen, gaps]")
    late = [1000 * (seen[name] / 1000 - at) for name, at in asked.items() if name in seen]
    print(f"{len(late)} of {len(asked)} events seen; ms to the table: {ranks(late)}")
    print(f"{1000 * len(gaps) / sum(gaps):.0f} frames/s; ms a frame: {ranks(gaps)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=100)
    parser.add_argument("--rate", type=float, default=1.0)
    parser.add_argument("--seconds", type=int, default=20)
    arguments = parser.parse_args()
    scheduler = WallScheduler()
    middleware = LocalMiddleware(scheduler)
    with TeamView(middleware, scheduler) as view, Server(view) as server, sync_playwright() as play:
        team = [Robot(f"Porter_{number + 1}", middleware, scheduler) for number in range(arguments.robots)]

        def every(seconds: float, action: Any, first: float) -> None:
            def again() -> None:
                action()
                scheduler.after(round(seconds * SECOND), again)

            scheduler.after(round(first * SECOND), again)

        for number, robot in enumerate(team):
            scheduler.after(2 * SECOND, robot.begin)
            every(1, robot.report, 1 + number / len(team))
            every(1 / arguments.rate, robot.work, 3 + number / len(team) / arguments.rate)
        thread = threading.Thread(target=scheduler.run, daemon=True)
        thread.start()
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        page.add_init_script("sessionStorage.setItem('fame-tab', 'team')")
        page.goto(server.address)
        while page.evaluate("document.querySelectorAll('.roster .robot').length") < len(team):
            page.wait_for_timeout(200)
        page.wait_for_timeout(3000)
        print(f"{len(team)} robots, {arguments.rate:g} batches/s each; load {os.getloadavg()[0]:.1f}")
        measure(page, team, scheduler, arguments.seconds)
        scheduler.stop()
        thread.join()


if __name__ == "__main__":
    main()
