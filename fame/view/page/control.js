// Control of a simulated run: pause, step, breakpoints, speed, complete, signal, set, fault, branch. Absent where read-only.

import { h, icon, renew } from "./dom.js";

export class Control {
  constructor(root, app) {
    this.root = root;
    this.app = app;
    this.status = null; // what the run says of itself
  }

  get can() {
    return new Set(this.app.mission?.control ?? []);
  }

  async send(command) {
    try {
      const answer = await this.app.post(command);
      if (answer.said) this.app.toast(answer.said);
      return answer;
    } catch (error) {
      this.app.toast(error.message, true);
      return null;
    }
  }

  update() {
    const { can, status } = this, key = JSON.stringify([[...can], status, this.app.player.time === this.app.store.end]);
    if (key === this.key) return;
    this.key = key;
    if (status?.failure || (status && status.repeats !== null && status.repeats !== undefined)) {
      renew(this.root, status.failure ? h("span", { cls: "failure", role: "alert" }, status.failure) : this.progress(status));
      return;
    }
    if (!can.size || status?.over) {
      renew(this.root, can.has("branch") ? this.branchButton() : null);
      return;
    }
    const paused = status?.paused, parts = [];
    if (can.has("pause")) {
      parts.push(h("button", { cls: "text", onclick: () => this.send({ do: paused ? "resume" : "pause" }) }, icon(paused ? "play" : "pause"), paused ? "Resume run" : "Pause run"));
      parts.push(h("button", { cls: "text", disabled: !paused, title: "Run to the next event", onclick: () => this.send({ do: "step" }) }, icon("step"), "Step"));
    }
    if (can.has("speed")) parts.push(this.speed(status?.speed ?? 1));
    if (can.has("signal")) parts.push(h("button", { cls: "text", onclick: () => this.signal() }, icon("send"), "Signal"));
    if (can.has("set")) parts.push(h("button", { cls: "text", onclick: () => this.set() }, "Set"));
    if (can.has("fault")) parts.push(h("button", { cls: "text", onclick: () => this.fault() }, icon("bolt"), "Fault"));
    if (can.has("branch")) parts.push(this.branchButton());
    renew(this.root, parts);
  }

  /** How far the repetition of a recorded run has come. */
  progress({ time, repeats }) {
    return [h("progress", { max: repeats, value: time, "aria-label": "Repeated so far" }),
      h("span", { cls: "quiet" }, `Repeating the run: ${(time / 1e9).toFixed(1)} of ${(repeats / 1e9).toFixed(1)} s`)];
  }

  branchButton() {
    return h("button", { cls: "text", title: "Repeat the run up to the cursor, and continue it differently from there", onclick: () => this.branch() }, icon("branch"), "Branch here");
  }

  /** Ask whether to run what the recording names; its tab opens at once, and shows how far it has come. */
  async branch() {
    const command = { do: "branch", time: this.app.player.time }, found = await this.send(command);
    if (!found) return;
    const files = h("ul", { cls: "files" }, found.files.map(([path, state]) => h("li", null, path, h("br"), h("small", { cls: "quiet" }, state))));
    const agreed = await this.ask("Run these files?", [], found.changed ? "Run although they differ" : "Run", [h("p", null, "The recording names: ", h("code", null, found.command)), files]);
    if (!agreed) return;
    const tab = window.open("", "_blank");
    if (tab) {
      tab.opener = null;
      tab.document.title = "Branch";
      tab.document.body.textContent = "The run begins …";
    }
    const answer = await this.send({ ...command, yes: true, changed: found.changed });
    if (answer && tab) tab.location = answer.address;
    else if (answer) this.app.toast(`The browser has blocked the tab of ${answer.address}`, true);
    else tab?.close();
  }

  speed(now) {
    const pick = h("select", { title: "Speed of the run", "aria-label": "Speed of the run", onchange: ({ currentTarget }) => this.send({ do: "speed", speed: Number(currentTarget.value) }) },
      [...[...new Set([0.1, 0.5, 1, 2, 5, 10, 50, now || 1])].sort((a, b) => a - b), 0].map((speed) => h("option", { value: speed }, speed ? `run ${speed}×` : "run at once")));
    pick.value = String(now);
    return pick;
  }

  // ---- asking ------------------------------------------------------------------------------------

  /** A form in a dialog; gives the values, or null. */
  ask(title, fields, action, text = []) {
    return new Promise((resolve) => {
      const inputs = fields.map(({ label, options, value, hint }) => {
        const input = options ? h("select", null, options.map(([of, text]) => h("option", { value: of }, text))) : h("input", { type: "text", autocomplete: "off", spellcheck: "false", placeholder: hint ?? "" });
        if (value !== undefined) input.value = value;
        return [label, input];
      });
      const form = h("form", { method: "dialog" }, h("h2", null, title), text, inputs.map(([label, input]) => h("label", null, label, input)),
        h("div", { cls: "row end" }, h("button", { value: "", type: "submit", cls: "text" }, "Cancel"), h("button", { value: "ok", type: "submit", cls: "text strong" }, action)));
      const dialog = h("dialog", { cls: "ask", onclose: () => {
        resolve(dialog.returnValue === "ok" ? inputs.map(([, input]) => input.value) : null);
        dialog.remove();
      } }, form);
      document.body.append(dialog);
      dialog.returnValue = "";
      form.addEventListener("keydown", (event) => {
        if (event.key !== "Enter") return;
        event.preventDefault();
        dialog.close("ok");
      });
      dialog.showModal();
      inputs[0]?.[1].focus();
    });
  }

  robots() {
    return this.app.mission.robots.map((robot) => [robot.name, robot.name]);
  }

  chosenRobot() {
    return this.app.mission.robots[this.app.selected.robot]?.name;
  }

  async signal() {
    const topics = [...new Set(this.app.mission.elements.flatMap((element) => (element.topics ?? []).map(([topic]) => topic)))].sort().map((topic) => [topic, topic]);
    const found = await this.ask("Send a signal", [{ label: "Topic", options: topics }, { label: "Robot (for ~/ topics)", options: this.robots(), value: this.chosenRobot() },
      { label: "Message, as JSON", hint: "{\"x\": 1.5, \"y\": 2} or nothing" }], "Send");
    if (found) this.send({ do: "signal", topic: found[0], robot: found[1], value: found[2] });
  }

  async set() {
    const found = await this.ask("Set a variable", [{ label: "Robot", options: this.robots(), value: this.chosenRobot() }, { label: "Name" },
      { label: "Value, as JSON", hint: "12.5, true, \"text\", [1, 2]" }], "Set");
    if (found) this.send({ do: "set", robot: found[0], name: found[1], value: found[2] });
  }

  async fault() {
    const faults = this.app.mission.faults ?? [];
    const found = await this.ask("Inject a fault", [{ label: "Robot and part", options: faults.map(([robot, kind]) => [`${robot}:${kind}`, `${robot}: ${kind}`]) }], "Inject");
    if (found) this.send({ do: "fault", robot: found[0].split(":")[0], kind: found[0].split(":")[1] });
  }

  async complete(r, element) {
    const { robots, elements } = this.app.mission;
    const found = await this.ask(`Complete ${elements[element]?.name || elements[element]?.id}`, [{ label: "Results, as JSON", hint: "{\"approved\": true} or nothing" }], "Complete");
    if (found) this.send({ do: "complete", robot: robots[r].name, element: elements[element].id, value: found[0] });
  }

  async retry(r, element) {
    const { robots, elements } = this.app.mission;
    const found = await this.ask(`Retry ${elements[element]?.name || elements[element]?.id}`, [{ label: "Variables to set first, as JSON", hint: "{\"speed\": 0.2} or nothing" }], "Retry");
    if (found) this.send({ do: "retry", robot: robots[r].name, element: elements[element].id, value: found[0] });
  }

  async move(r, element) {
    const { robots, elements } = this.app.mission, from = elements[element];
    const others = elements.filter((one) => one.body === from.body && (one.file ?? 0) === (from.file ?? 0) && one.id !== from.id && !/Flow|boundary|process/i.test(one.tag));
    const found = await this.ask(`Move the token from ${from.name || from.id}`, [{ label: "To", options: others.map((one) => [one.id, one.name || one.id]) }], "Move");
    if (found) this.send({ do: "move", robot: robots[r].name, element: from.id, to: found[0] });
  }

  /** Buttons beside a waiting token. */
  forWait(r, wait) {
    if (this.status?.over) return null;
    const parts = [this.completeButton(r, wait)];
    if (this.can.has("retry") && wait.kind === "incident") parts.push(h("button", { cls: "text strong", onclick: () => this.retry(r, wait.e) }, "Retry …"));
    if (this.can.has("move") && this.app.mission.elements[wait.e]) parts.push(h("button", { cls: "text", onclick: () => this.move(r, wait.e) }, "Move …"));
    return parts;
  }

  completeButton(r, wait) {
    const user = wait.kind === "user" || /receiveTask/.test(this.app.mission.elements[wait.e]?.tag ?? "");
    if (!this.can.has("complete") || this.status?.over || !user) return null;
    return h("button", { cls: "text strong", onclick: () => this.complete(r, wait.e) }, "Complete …");
  }

  /** Buttons of a chosen element. */
  forElement(number) {
    if (!this.can.has("breakpoint") || this.status?.over) return null;
    const on = this.app.breakpoints.has(number);
    return h("button", { cls: "text", "aria-pressed": String(on), onclick: () => this.send({ do: "breakpoint", element: number, on: !on }) }, on ? "Remove breakpoint" : "Breakpoint");
  }
}
