// The run beside the diagram: the world, the tokens at what is drawn, and who stops the time. When the model has been
// saved, the run goes over to it; where a token cannot, the page says so, and offers to begin again.

import { byId, colourRobots, h, icon, messageOf, renew, robotColour } from "./dom.js";
import { places } from "./places.js";
import { Server } from "./source.js";
import { Store } from "./store.js";
import { World } from "./world.js";

/** @typedef {{robot: string, element: string, text: string}} Blocked a token that cannot go over */

const SPEEDS = [1, 5, 20, 100, 0];
const MARKER = "has-token";
const FLOW_NODE = "bpmn:FlowNode";

/** @param {number} time ns */
const seconds = (time) => `${(time / 1e9).toFixed(1)} s`;

/** What `World` draws, as `App` is for the page of fame view. */
export class Running {
  source = new Server("run/");
  /** @type {any} */
  mission = { robots: [], elements: [], models: [], number: 0 };
  /** @type {any} */
  store = null;
  selected = { robot: -1, element: -1 };
  tabs = { name: "", choose() {} };
  /** @type {any} what the run says of itself; null without one */
  status = null;
  hash = ""; // of the file that it runs
  key = ""; // of the tokens that are shown
  waiting = false;
  loads = false;
  listens = false;
  gone = "";
  speed = h(
    "select",
    { id: "speed", title: "Simulated seconds in a second", onchange: () => this.pace() },
    SPEEDS.map((speed) => h("option", { value: speed, selected: speed === 5 }, speed ? `${speed}×` : "at once")),
  );

  /** @param {any} edit */
  constructor(edit) {
    this.edit = edit;
    this.world = new World(byId("world"), /** @type {any} */ (this));
    this.begun();
    this.bar();
    edit.modeler.on("import.done", () => {
      this.key = "";
      this.redraw();
    });
    edit.modeler.on("element.contextmenu", (event) => this.menu(event));
    for (const type of ["pointerdown", "keydown", "wheel"])
      addEventListener(
        type,
        ({ target }) => (byId("menu").hidden ||= !byId("menu").contains(/** @type {any} */ (target))),
        true,
      );
  }

  get runs() {
    return this.status !== null && !this.status.over;
  }

  // ---- what it does ------------------------------------------------------------------------------

  async send(command) {
    try {
      return await this.source.post(command);
    } catch (error) {
      this.edit.say(messageOf(error));
      return null;
    }
  }

  async begin(command) {
    this.hash = this.edit.hash;
    if (!this.listens) this.source.listen(this);
    this.listens = true;
    if (await this.send({ ...command, speed: Number(this.speed.value) })) this.refused([]);
  }

  /** Run, or go on, with what is drawn; or stop. */
  async play() {
    if (this.runs && !this.status.paused) await this.send({ do: "pause" });
    else if (await this.saved()) await (this.runs ? this.send({ do: "resume" }) : this.begin({ do: "begin" }));
  }

  /** Whether the file has what is drawn, also a model that is new. */
  async saved() {
    return (this.runs && !this.edit.dirty) || (await this.edit.save());
  }

  async runTo(id) {
    if (await this.saved())
      await (this.runs ? this.send({ do: "run_to", to: id }) : this.begin({ do: "begin", to: id }));
  }

  /** Let the run go over to the model as it is in the file now. */
  async change() {
    const { hash } = this.edit;
    if (!this.runs || this.hash === hash) return;
    let blocked;
    try {
      ({ blocked } = await this.source.post({ do: "change" }));
    } catch (error) {
      blocked = [{ robot: "", element: "", text: messageOf(error) }];
    }
    this.refused(blocked);
    if (!blocked.length) {
      this.hash = hash;
      this.edit.say("The run goes on in the changed model.");
    }
  }

  async pace() {
    if (this.runs) await this.send({ do: "speed", speed: Number(this.speed.value) });
  }

  /** @param {Blocked[]} blocked */
  refused(blocked) {
    const row = ({ robot, element, text }) =>
      h("button", { onclick: () => this.edit.select(element) }, robot ? `${robot}: ${text}` : text);
    const act = (id, text, action) => h("button", { cls: "text", id, onclick: action }, text);
    renew(
      byId("blocked"),
      h("strong", null, "The run goes on in the model of before: it cannot go over to this one"),
      blocked.map(row),
      h(
        "span",
        { cls: "acts" },
        act("again", "Start again at this instant, in this model", () => this.begin({ do: "again" })),
        act("stay", "Leave it", () => this.refused([])),
      ),
    );
    byId("blocked").hidden = !blocked.length;
  }

  // ---- what comes --------------------------------------------------------------------------------

  begun() {
    this.store = new Store((number) => this.source.fetch(`block/${number}.json`));
    this.store.onchange(() => this.redraw());
    this.status = null;
    this.world.waysVersion = -1;
    this.redraw();
  }

  news(news) {
    if (news.type === "begin") this.begun();
    else if (news.type === "reload") this.reload();
    else if (news.type === "run") this.run(news);
    this.store.take(news, this.mission);
    this.redraw();
  }

  async reload() {
    this.loads = true; // elements that come meanwhile are of files that are not known yet
    this.mission = await this.source.fetch("mission.json");
    this.loads = false;
    colourRobots(this.mission.order);
    this.bar();
    this.redraw();
  }

  run(status) {
    const { failure, stopped } = status;
    if (failure && failure !== this.status?.failure) this.edit.say(failure);
    if (stopped && stopped !== this.status?.stopped) this.edit.say(stopped);
    this.status = status;
    this.bar();
  }

  disconnected(text) {
    this.gone = text;
    if (text) this.status = null;
    this.bar();
  }

  // ---- what is shown -----------------------------------------------------------------------------

  redraw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      const state = this.store.blocks.length ? this.store.stateAt(this.store.end) : null;
      document.body.classList.toggle("runs", this.status !== null);
      if (state !== null) {
        this.world.attend(state);
        this.world.update(state, this.store.end);
      }
      if (!this.loads) this.tokens(state === null || this.status === null ? new Map() : this.found(state));
    });
  }

  found(state) {
    const registry = this.edit.modeler.get("elementRegistry");
    return places(this.mission, state, (id) => registry.get(id)?.businessObject.$instanceOf(FLOW_NODE));
  }

  /** @param {Map<string, Set<number>>} found */
  tokens(found) {
    const key = JSON.stringify([...found].map(([id, robots]) => [id, ...robots]));
    if (key === this.key) return;
    this.key = key;
    const [overlays, canvas] = ["overlays", "canvas"].map((name) => this.edit.modeler.get(name));
    for (const one of this.edit.modeler.get("elementRegistry").getAll()) canvas.removeMarker(one, MARKER);
    overlays.remove({ type: "token" });
    for (const [id, robots] of found) {
      const html = h(
        "div",
        { cls: "discs" },
        [...robots].sort((a, b) => a - b).map((r) => this.disc(r)),
      );
      overlays.add(id, "token", { position: { bottom: 12, left: -8 }, html, scale: { min: 1 } });
      canvas.addMarker(id, MARKER);
    }
  }

  disc(r) {
    const disc = h("i", { cls: "disc", title: this.mission.robots[r]?.name }, String(r + 1));
    disc.style.background = robotColour(r);
    return disc;
  }

  select(chosen) {
    Object.assign(this.selected, chosen);
    this.redraw();
  }

  bar() {
    const { status, runs } = this;
    const stops = runs && !status.paused;
    const button = (id, title, picture, action, disabled = false) =>
      h("button", { id, title, "aria-label": title, disabled, onclick: action }, icon(picture));
    const title = stops ? "Pause" : runs ? "Go on, in the saved model" : "Save, and run";
    renew(
      byId("running"),
      button("play", title, stops ? "pause" : "play", () => this.play()),
      button("step", "To the next event", "step", () => this.send({ do: "step" }), !runs || stops),
      this.speed,
      status && h("span", { cls: `chip ${status.failure ? "failed" : runs ? "live" : ""}`, id: "clock" }, this.words()),
      status && button("stop", "End the run", "close", () => this.send({ do: "end" })),
      status && h("a", { href: "run/", target: "_blank", rel: "noopener" }, "Details"),
    );
  }

  words() {
    const { time, over, paused, repeats } = this.status;
    if (!over && repeats !== null) return `repeats ${seconds(time)} of ${seconds(repeats)}`;
    const state = over ? (this.mission.chips?.[0]?.[0] ?? "over") : paused ? "paused" : "";
    return `${seconds(time)} ${state}`.trim();
  }

  /** The menu of an element, at a right click. */
  menu({ element, originalEvent }) {
    if (!element.businessObject?.$instanceOf(FLOW_NODE)) return;
    originalEvent.preventDefault();
    const menu = byId("menu");
    const act = () => {
      menu.hidden = true;
      this.runTo(element.businessObject.id);
    };
    menu.replaceChildren(h("button", { role: "menuitem", id: "here", onclick: act }, icon("play"), "Run to here"));
    menu.hidden = false;
    menu.style.left = `${Math.min(originalEvent.clientX, innerWidth - 160)}px`;
    menu.style.top = `${Math.min(originalEvent.clientY, innerHeight - 50)}px`;
    menu.querySelector("button")?.focus();
  }
}
