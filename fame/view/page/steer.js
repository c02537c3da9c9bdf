// Taking a robot over: its mission is suspended, keys and a pad steer the robot, then the mission continues. The dead
// man is in the robot.

/** @import {App} from "./main.js" */
import { byId, h, icon, renew, messageOf } from "./dom.js";
import { drawn, nameOf } from "./roster.js";

const PERIOD = 100; // ms between two commands
const RENEWAL = 1000; // ms between two prolongations of the lease
const TURN = 1; // rad/s
const KEYS = {
  arrowup: [1, 0],
  w: [1, 0],
  arrowdown: [-1, 0],
  s: [-1, 0],
  arrowleft: [0, 1],
  a: [0, 1],
  arrowright: [0, -1],
  d: [0, -1],
};
const NARROW = matchMedia("(max-width: 1100px)");
const clamp = (value) => Math.max(-1, Math.min(1, value));

export class Steer {
  /** @param {HTMLElement} root @param {App} app */
  constructor(root, app) {
    this.root = root;
    this.app = app;
    /** @type {{r: number, lease: string, steers: boolean} | null} */
    this.held = null; // {r, lease, steers}
    this.pressed = new Set();
    this.pad = [0, 0]; // ahead, to the left
    this.flights = new Set(); // commands without an answer yet
    for (const type of ["keydown", "keyup"]) addEventListener(type, (event) => this.key(event), true);
    addEventListener("blur", () => this.rest());
    document.addEventListener("visibilitychange", () => this.rest());
    setInterval(() => this.command(), PERIOD);
  }

  async takeOver(r) {
    if (this.held) return;
    const lease = [...crypto.getRandomValues(new Uint32Array(4))].join("-");
    const answer = await this.app.acts.send(r, "take_over", { lease });
    if (!answer) return;
    this.held = { r, lease, steers: answer.steers };
    this.rest();
    if (NARROW.matches && !byId("world").classList.contains("absent")) this.app.tabs.choose("map");
    this.app.select({ robot: r });
    this.open();
    this.keep(this.held);
  }

  /**
   * Prolong the lease each second; once that is not possible the robot has stopped, and somebody may take it over
   * again.
   */
  async keep(held) {
    for (;;) {
      await new Promise((done) => setTimeout(done, RENEWAL));
      if (this.held !== held) return;
      if (!this.ends) await this.post("take_over");
    }
  }

  async post(act, more) {
    const { held } = this;
    if (held === null) return;
    const { r, lease } = held;
    const flight = this.app.post({ do: act, robot: this.app.mission.robots[r].name, lease, ...more });
    this.flights.add(flight);
    try {
      await flight;
    } catch (error) {
      if (this.held !== held) return;
      this.close();
      this.app.toast(
        `${this.app.mission.robots[r].name} has stopped, its mission is suspended: ${messageOf(error)}`,
        true,
      );
    } finally {
      this.flights.delete(flight);
    }
  }

  // ---- commands ----------------------------------------------------------------------------------

  key(event) {
    const name = event.key.toLowerCase();
    if (
      !this.held?.steers ||
      !(name in KEYS) ||
      event.ctrlKey ||
      event.metaKey ||
      event.altKey ||
      document.querySelector("dialog[open]") ||
      /^(select|textarea)$/i.test(event.target.localName)
    )
      return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (event.type === "keydown") this.pressed.add(name);
    else this.pressed.delete(name);
  }

  rest() {
    this.pressed.clear();
    this.push([0, 0]);
  }

  /** Where the pad is pushed: [ahead, to the left], each -1 to 1. */
  push(to) {
    this.pad = to.map(clamp);
    if (this.knob) this.knob.style.transform = `translate(${-44 * this.pad[1]}px, ${-44 * this.pad[0]}px)`;
  }

  pushAt(event) {
    const { left, top, width, height } = event.currentTarget.getBoundingClientRect();
    this.push([1 - (2 * (event.clientY - top)) / height, 1 - (2 * (event.clientX - left)) / width]);
  }

  /** Send what the person wants now; a last time when they want nothing more. One command is under way at a time. */
  async command() {
    if (!this.held?.steers || this.busy || this.ends) return;
    const wanted = [...this.pressed]
      .map((name) => KEYS[name])
      .concat([this.pad])
      .reduce((sum, one) => sum.map((value, at) => clamp(value + one[at])));
    const moves = wanted.some(Boolean);
    if (!moves && !this.moved) return;
    this.moved = moves;
    this.busy = true;
    await this.post("steer", { speed: wanted[0] * Number(this.speed.value), turn: wanted[1] * TURN });
    this.busy = false;
  }

  // ---- the panel ---------------------------------------------------------------------------------

  open() {
    if (this.held === null) return;
    const { steers, r } = this.held;
    const { name } = this.app.mission.robots[r];
    const pad = this.drive();
    const drive = steers ? pad : h("p", { cls: "quiet" }, "It cannot be steered: it only holds.");
    this.place = h("select", { "aria-label": "Activity" });
    const leave = this.ending("Let go", "suspend", "Its mission stays suspended, for somebody else");
    this.root.replaceChildren(
      h("div", { cls: "bar" }, h("h2", null, `You hold ${name}`), h("span", { cls: "space" }), leave),
      h(
        "div",
        { cls: "hand" },
        drive,
        h(
          "div",
          { cls: "acts" },
          this.ending("Resume", "continue", "Activities begin again with their variables", "strong"),
          this.place,
          this.ending("Restart", "restart", "The activity begins anew, with all that it called"),
          this.ending("Skip", "skip", "The activity is left without its results"),
          this.ending("Fail", "fail", "The activity raises the error taken_over"),
        ),
      ),
    );
    this.root.hidden = false;
    this.shown();
    this.update(this.app.state);
  }

  /** A button that ends the taking over. */
  ending(text, how, title, cls = "") {
    return h("button", { cls: `text ${cls}`, title, onclick: () => this.end(how) }, text);
  }

  /** The pad, and the speed that its rim stands for. */
  drive() {
    const rest = () => this.push([0, 0]);
    const range = { type: "range", min: 0.1, max: 1, step: 0.1, value: 0.3 };
    this.knob = h("i");
    this.speed = h("input", { ...range, "aria-label": "Speed", oninput: () => this.shown() });
    this.value = h("output");
    const pad = h(
      "div",
      {
        cls: "pad",
        role: "img",
        "aria-label": "Pad to steer: keys W A S D or the arrows do the same",
        onpointerdown: (event) => {
          event.currentTarget.setPointerCapture(event.pointerId);
          this.pushAt(event);
        },
        onpointermove: (event) => event.currentTarget.hasPointerCapture(event.pointerId) && this.pushAt(event),
        onpointerup: rest,
        onpointercancel: rest,
        onlostpointercapture: rest,
      },
      icon("plus"),
      this.knob,
    );
    return h("div", { cls: "drive" }, pad, h("label", null, "Speed ", this.speed, this.value));
  }

  shown() {
    this.value.textContent = ` ${this.speed.value} m/s`;
  }

  /** The activities that can be restarted, skipped or failed: those that the diagram shows. */
  update(state) {
    if (this.held === null || !state) return;
    const { r } = this.held;
    const waits = [...(state.waits.get(r)?.values() ?? [])];
    const places = [...new Set(waits.map((wait) => drawn(this.app, state.openers(r, wait.scope), wait.e)))].filter(
      (e) => this.app.mission.elements[e],
    );
    renew(
      this.place,
      places.map((e) => h("option", { value: this.app.mission.elements[e].id }, nameOf(this.app, e))),
    );
  }

  /** Let the mission continue, or let go of the robot. */
  async end(act) {
    if (this.held === null) return;
    const { r, lease } = this.held;
    const element = this.place.value;
    const send = (name, more) => this.app.acts.send(r, name, { lease, ...more });
    this.rest();
    this.ends = true;
    await Promise.allSettled([...this.flights]); // none of them may come later
    const done =
      (!["restart", "skip", "fail"].includes(act) || (await send(act, { element }))) &&
      (act === "fail" || (await send(act === "suspend" ? act : "continue")));
    this.ends = false;
    if (done) this.close();
  }

  close() {
    this.held = null;
    this.moved = false;
    this.root.hidden = true;
    this.app.redraw();
  }
}
