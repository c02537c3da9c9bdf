// What may go wrong in what is drawn, explored while nothing changes: a run that leads to it plays on the diagram.

import { byId, h, icon, messageOf } from "./dom.js";

const REST = 600; // ms without a change, after which the model is explored
const BEAT = 1200; // ms between two steps that play
const LOOKS = { completed: "completed", partial: "warning", failed: "failed" };
const STEP = "step";

/**
 * @typedef {{text: string, element: string, waits: [string, string][]}} Step
 * @typedef {{level: string, text: string, element: string, name: string, fix?: any, steps?: Step[]}} Finding
 */

export class Exploring {
  window = String(Math.random());
  /** @type {{status: string, text: string} | null} */
  result = null;
  busy = false;
  /** @type {Finding[]} */
  findings = [];
  /** @type {Step[]} of the run that is shown */
  steps = [];
  at = 0;
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  rest = undefined;
  /** @type {ReturnType<typeof setInterval> | undefined} */
  beat = undefined;

  /** @param {any} edit */
  constructor(edit) {
    this.edit = edit;
  }

  /** Forget what was found: the model has changed. */
  stop() {
    clearTimeout(this.rest);
    this.end();
    Object.assign(this, { busy: false, result: null, findings: [] });
  }

  /** Explore soon, unless an error says that the model cannot run. */
  begin() {
    this.stop();
    if (this.edit.findings.some(({ level }) => level === "error")) return;
    this.rest = setTimeout(() => this.explore(), REST);
  }

  async explore() {
    const { edit } = this;
    const { changes } = edit;
    this.busy = true;
    edit.chips();
    let found;
    try {
      found = await edit.ask("explore");
    } catch (error) {
      found = { status: "partial", text: messageOf(error), findings: [] };
    }
    if (changes !== edit.changes || !found.status) return;
    Object.assign(this, { busy: false, result: found, findings: found.findings });
    edit.show();
  }

  chips() {
    if (this.busy) return [h("span", { cls: "chip", id: "explored" }, "exploring …")];
    if (!this.result) return [];
    const { status, text } = this.result;
    const words = { completed: "all states explored", partial: "not known", failed: "errors are reached" }[status];
    return [h("span", { cls: `chip ${LOOKS[status]}`, id: "explored", title: text }, words)];
  }

  // ---- a run that plays --------------------------------------------------------------------------

  /** @param {Finding} finding */
  play({ steps = [] }) {
    this.end();
    this.steps = steps;
    this.go(0);
    this.beat = setInterval(() => this.go(this.at + 1), BEAT);
  }

  end() {
    clearInterval(this.beat);
    this.mark(null);
    this.steps = [];
    byId("steps").hidden = true;
  }

  /** Show the team after a step; the last one stays. */
  go(at) {
    this.at = Math.max(0, Math.min(at, this.steps.length - 1));
    if (this.at === this.steps.length - 1) clearInterval(this.beat);
    this.mark(this.steps[this.at]);
    const act = (id, name, picture, action) =>
      h("button", { id, title: name, "aria-label": name, onclick: action }, icon(picture));
    const by = (count) => () => {
      clearInterval(this.beat);
      this.go(this.at + count);
    };
    byId("steps").replaceChildren(
      act("before", "Step back", "back", by(-1)),
      act("after", "Step on", "forth", by(1)),
      h("span", null, `${this.at + 1} of ${this.steps.length}: ${this.steps[this.at].text}`),
      act("end-run", "Close", "close", () => this.end()),
    );
    byId("steps").hidden = false;
  }

  /** @param {Step | null} step */
  mark(step) {
    if (!this.edit.modeler) return;
    const [canvas, overlays, elements] = ["canvas", "overlays", "elementRegistry"].map((one) =>
      this.edit.modeler.get(one),
    );
    overlays.remove({ type: STEP });
    elements.forEach((element) => canvas.removeMarker(element, STEP));
    if (step && elements.get(step.element)) canvas.addMarker(step.element, STEP);
    /** @type {Map<string, Set<string>>} */
    const waits = new Map();
    for (const [robot, id] of step?.waits ?? []) waits.set(id, (waits.get(id) ?? new Set()).add(robot));
    for (const [id, robots] of waits) {
      const html = h("div", { cls: "waits" }, [...robots].join(", "));
      if (elements.get(id)) overlays.add(id, STEP, { position: { bottom: 8, left: 0 }, html });
    }
  }
}
