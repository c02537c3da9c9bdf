// The panes of a desk: splitters between them, moved by pointer or keys and collapsed by Enter; one of them takes the
// whole page.

/** @import {App} from "./main.js" */
import { byId, h, icon, keep, kept } from "./dom.js";

const SPLITS = [
  ["side", "work", false, "Width of the panes on the right"],
  ["row", "work", true, "Height of the lower pane"],
  ["low", "body", true, "Height of the timeline"],
];
const STEP = 2;
const LEAST = 6; // % of the room: by which a key moves, and what is too little for a pane
const KEPT = "fame-panes";

export class Panes {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    // % of what is after a splitter, by its name and the tab
    this.sizes = JSON.parse(kept("localStorage", KEPT) ?? "{}");
    this.splitters = SPLITS.map((split) => this.splitter(...split));
    byId("work").append(...this.splitters.slice(0, 2));
    byId("work").after(h("section", { cls: "between", "aria-label": "Splitter" }, this.splitters[2]));
    for (const panel of document.querySelectorAll("#work > .panel, #time"))
      panel.querySelector(".bar")?.append(this.maximiser(panel));
    for (const [name, size] of Object.entries(this.sizes)) this.apply(name, size);
    new ResizeObserver(() =>
      this.splitters.forEach((one) => one.setAttribute("aria-valuenow", Math.round(this.now(one)))),
    ).observe(byId("work"));
  }

  splitter(name, where, lies, label) {
    const found = h("div", {
      cls: "splitter",
      id: `split-${name}`,
      role: "separator",
      tabindex: 0,
      "aria-label": label,
      "aria-orientation": lies ? "horizontal" : "vertical",
      "aria-valuenow": 50,
      title: `${label}: drag, or arrow keys; Enter or a double-click collapses`,
      onpointerdown: (event) => found.setPointerCapture(event.pointerId),
      ondblclick: () => this.collapse(found),
      onkeydown: (event) => this.key(event, found),
      onpointermove: (event) => found.hasPointerCapture(event.pointerId) && this.drag(event, found),
    });
    return Object.assign(found, { name, where, lies });
  }

  /** What a splitter divides, along its way: [begin, end] (px). */
  room({ where, lies }) {
    const box = byId("work").getBoundingClientRect();
    if (where === "body") return [box.top, byId("time").getBoundingClientRect().bottom];
    return lies ? [box.top, box.bottom] : [box.left, box.right];
  }

  /** The part of the room that is after a splitter (%). */
  now(splitter) {
    const [begin, end] = this.room(splitter);
    const box = splitter.getBoundingClientRect();
    return end > begin
      ? Math.min(100, Math.max(0, (100 * (end - (splitter.lies ? box.bottom : box.right))) / (end - begin)))
      : 50;
  }

  drag(event, splitter) {
    const [begin, end] = this.room(splitter);
    this.set(splitter, (100 * (end - (splitter.lies ? event.clientY : event.clientX))) / (end - begin));
  }

  key(event, splitter) {
    const less = splitter.lies ? "ArrowDown" : "ArrowRight";
    const more = splitter.lies ? "ArrowUp" : "ArrowLeft";
    const size = {
      [less]: () => this.now(splitter) - STEP,
      [more]: () => Math.max(LEAST, this.now(splitter)) + STEP,
      Home: () => 0,
      End: () => 100,
    }[event.key];
    if (event.key !== "Enter" && size === undefined) return;
    event.preventDefault();
    event.stopPropagation();
    if (size === undefined) this.collapse(splitter);
    else this.set(splitter, size());
  }

  /** Collapse what is after a splitter, or bring it back. */
  collapse(splitter) {
    const now = this.now(splitter);
    if (now > LEAST) splitter.before = now;
    this.set(splitter, now > LEAST ? 0 : (splitter.before ?? 36));
  }

  set(splitter, wanted) {
    const name = splitter.where === "body" ? splitter.name : `${splitter.name}-${document.body.dataset.group}`;
    this.sizes[name] = wanted < LEAST ? 0 : wanted > 100 - LEAST ? 100 : wanted;
    this.apply(name, this.sizes[name]);
    splitter.setAttribute("aria-valuenow", Math.round(this.sizes[name]));
    keep("localStorage", KEPT, JSON.stringify(this.sizes));
  }

  apply(name, size) {
    document.body.style.setProperty(`--${name}`, `minmax(0, ${100 - size}fr) 6px minmax(0, ${size}fr)`);
  }

  maximiser(panel) {
    return h(
      "button",
      {
        cls: "maximise",
        title: "The whole page for this part (M)",
        "aria-label": "Maximise",
        "aria-pressed": "false",
        onclick: () => this.maximise(panel),
      },
      icon("maximise"),
    );
  }

  /**
   * Give a panel the whole page, or its place again; without one, the panel that has the focus, or was clicked last.
   */
  maximise(
    panel = document.activeElement?.closest(".panel") ??
      document.querySelector(".panel.max, .panel:hover") ??
      byId("diagram"),
  ) {
    for (const one of document.querySelectorAll("#work > .panel, #time")) {
      const on = one === panel && !one.classList.contains("max");
      one.classList.toggle("max", on);
      one.querySelector(".maximise")?.setAttribute("aria-pressed", String(on));
    }
    this.app.redraw();
  }

  /** Put a maximised panel in its place; whether there was one. */
  restore() {
    const found = document.querySelector(".panel.max");
    if (found) this.maximise(found);
    return found !== null;
  }
}
