// Control of a run besides its pace: breakpoints, signal, set, fault; of a recording: branch, label. Absent where
// read-only.

/** @import {App} from "./main.js" */
import { h, icon, renew, messageOf } from "./dom.js";
import { ask } from "./form.js";

/**
 * An option that is called what it is.
 *
 * @param {string} text
 * @returns {[value: string, text: string]}
 */
const same = (text) => [text, text];

export class Control {
  /** @param {HTMLElement} root @param {App} app */
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
      this.app.toast(messageOf(error), true);
      return null;
    }
  }

  update() {
    const { can, status } = this;
    const key = JSON.stringify([[...can], status, this.app.player.time === this.app.store.end]);
    if (key === this.key) return;
    this.key = key;
    if (status?.failure || (status && status.repeats !== null && status.repeats !== undefined)) {
      renew(
        this.root,
        status.failure ? h("span", { cls: "failure", role: "alert" }, status.failure) : this.progress(status),
      );
      return;
    }
    if (!can.size || status?.over) {
      renew(this.root, can.has("branch") ? this.branchButton() : null);
      return;
    }
    const parts = [];
    if (can.has("signal"))
      parts.push(h("button", { cls: "text", onclick: () => this.signal() }, icon("send"), "Signal"));
    if (can.has("set")) parts.push(h("button", { cls: "text", onclick: () => this.set() }, "Set"));
    if (can.has("fault")) parts.push(h("button", { cls: "text", onclick: () => this.fault() }, icon("bolt"), "Fault"));
    if (can.has("branch")) parts.push(this.branchButton());
    if (can.has("label")) parts.push(this.labelButton());
    if (can.has("change")) parts.push(this.app.change.button());
    renew(this.root, parts);
  }

  /** How far the repetition of a recorded run has come. */
  progress({ time, repeats }) {
    return [
      h("progress", { max: repeats, value: time, "aria-label": "Repeated so far" }),
      h("span", { cls: "quiet" }, `Repeating the run: ${(time / 1e9).toFixed(1)} of ${(repeats / 1e9).toFixed(1)} s`),
    ];
  }

  branchButton() {
    return h(
      "button",
      {
        cls: "text",
        title: "Repeat the run up to the cursor, and continue it differently from there",
        onclick: () => this.branch(),
      },
      icon("branch"),
      "Branch here",
    );
  }

  labelButton() {
    const title = "Say that the run was benign: the next training of the model uses that";
    return h("button", { cls: "text", title, onclick: () => this.label() }, "Alarm was false …");
  }

  /** Say that a run was benign which a model alarmed about. */
  async label() {
    const { alarms, model } = this.app.mission.monitor;
    const runs = [...new Set(alarms.map(({ run }) => String(run)))];
    const choice = { key: "run", label: "Run", kind: "select", options: runs.map(same), value: runs[0] };
    const found = await ask("Was the alarm false?", runs.length > 1 ? [choice] : [], "The run was benign", [
      h("p", null, `The next training of ${model} then takes it as undisturbed.`),
      h(
        "ul",
        null,
        alarms.map(({ run, text }) => h("li", null, `${runs.length > 1 ? `run ${run}: ` : ""}${text.join("; ")}`)),
      ),
    ]);
    if (found) await this.send({ do: "label", run: Number(found.run ?? runs[0]) });
  }

  /** Ask whether to run what the recording names; its tab opens at once, and shows how far it has come. */
  async branch() {
    const command = { do: "branch", time: this.app.player.time };
    const found = await this.send(command);
    if (!found) return;
    const files = h(
      "ul",
      { cls: "files" },
      found.files.map(([path, state]) => h("li", null, path, h("br"), h("small", { cls: "quiet" }, state))),
    );
    const agreed = await ask("Run these files?", [], found.changed ? "Run although they differ" : "Run", [
      h("p", null, "The recording names: ", h("code", null, found.command)),
      files,
    ]);
    if (agreed) await this.openTab({ ...command, yes: true, changed: found.changed });
  }

  /** Open a tab now, as browsers allow it only at a click, and show there the page that a command makes. */
  async openTab(command) {
    const tab = window.open("", "_blank");
    if (tab) {
      tab.opener = null;
      tab.document.title = tab.document.body.textContent = "The page begins …";
    }
    const answer = await this.send(command);
    if (answer && tab) tab.location = answer.address;
    else if (answer) this.app.toast(`The browser has blocked the tab of ${answer.address}`, true);
    else tab?.close();
  }

  // ---- asking ------------------------------------------------------------------------------------

  robots() {
    return this.app.mission.robots.map(({ name }) => same(name));
  }

  chosenRobot() {
    return this.app.mission.robots[this.app.selected.robot]?.name;
  }

  /** A signal: its topic, then the fields of its type. */
  async signal() {
    const { mission } = this.app;
    const catchers = mission.elements.flatMap((element) => (element.topics ?? []).map(([topic]) => topic));
    const options = [...new Set(catchers)].sort().map(same);
    const choice = { key: "topic", label: "Topic", kind: "select", options, value: options[0]?.[0] };
    const found = await ask("Send a signal", [choice], "Next");
    if (!found) return;
    const chosen = this.chosenRobot() ?? mission.robots[0]?.name;
    const robot = { key: "/robot", label: "Robot", kind: "select", options: this.robots(), value: chosen };
    const typed = mission.types?.[found.topic] ?? [];
    const fields = found.topic.startsWith("~/") ? [robot, ...typed] : typed;
    const values = fields.length ? await ask(found.topic, fields, "Send") : {};
    if (!values) return;
    const { "": { robot: name } = {}, ...message } = values;
    this.send({ do: "signal", topic: found.topic, robot: name, value: typed.length ? JSON.stringify(message) : "" });
  }

  async set() {
    const found = await ask(
      "Set a variable",
      [
        {
          key: "robot",
          label: "Robot",
          kind: "select",
          options: this.robots(),
          value: this.chosenRobot() ?? this.app.mission.robots[0]?.name,
        },
        { key: "name", label: "Name", required: true, pattern: "[^\\W\\d]\\w*" },
        { key: "value", label: "Value", kind: "value", required: true, hint: "12.5, true, a text, [1, 2]" },
      ],
      "Set",
    );
    if (found) this.send({ do: "set", robot: found.robot, name: found.name, value: JSON.stringify(found.value) });
  }

  async fault() {
    const faults = this.app.mission.faults ?? [];
    const found = await ask(
      "Inject a fault",
      [
        {
          key: "fault",
          label: "Robot and part",
          kind: "select",
          options: faults.map((fault) => [fault, fault.join(": ")]),
          value: faults[0],
        },
      ],
      "Inject",
    );
    if (found) this.send({ do: "fault", robot: found.fault[0], kind: found.fault[1] });
  }

  /** Buttons of a chosen element. */
  forElement(number) {
    if (!this.can.has("breakpoint") || this.status?.over) return null;
    const on = this.app.breakpoints.has(number);
    return h(
      "button",
      {
        cls: "text",
        "aria-pressed": String(on),
        onclick: () => this.send({ do: "breakpoint", element: number, on: !on }),
      },
      on ? "Remove breakpoint" : "Breakpoint",
    );
  }
}
