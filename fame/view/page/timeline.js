// The timeline: a lane per robot with its elements as bars, signals as arrows between lanes, plots, and the cursor.

/** @import {App} from "./main.js" */
import { h, clock, duration, isDark, sharp, show, swatch } from "./dom.js";
import { CANCEL, FAIL, LEAVE } from "./store.js";
import { Axis } from "./axis.js";
import { Bars } from "./bars.js";
import { Lanes } from "./lanes.js";
import { Transport } from "./transport.js";
import { signalsAreNew, signalsOf } from "./signals.js";
import { Plots } from "./plots.js";
import { doing, startOf } from "./roster.js";
import { Properties } from "./properties.js";

const GUTTER = 148;
const SLICE = 8; // ms of a frame
const GROWTH = 8; // px by which bars of what is under way grow at once
const HOW = new Map([
  [-1, "under way"],
  [LEAVE, "completed"],
  [CANCEL, "cancelled"],
  [FAIL, "failed"],
]);

const lines = (title, ...texts) => [h("b", null, title), texts.map((text) => h("span", null, text))];

export class Timeline {
  layerKey = ""; // what the picture was painted for
  layerVersion = "";
  layerPause = 0; // until when it is not painted anew only because more is loaded (ms)
  paintCost = 0; // ms
  /** @type {Generator<unknown, void> | null} */
  painting = null; // what has been painted of it
  /** @type {any[]} */
  captions = [];
  pressed = [0, 0]; // where the pointer was, px

  /** @param {HTMLElement} root @param {App} app */
  constructor(root, app) {
    this.app = app;
    this.from = 0;
    this.until = 1e9;
    this.shown = -1; // the instant that was shown last
    this.width = 10; // of the lanes, when they were drawn last
    // of the box and the lanes: to ask the browser would make it lay out the page
    this.size = { width: 0, height: 0, scroll: 0 };
    this.whole = true;
    this.levels = 2;
    this.rows = new Lanes();
    this.plots = new Plots(app, this);
    this.transport = new Transport(root, this);
    this.axis = new Axis(this);
    this.bars = new Bars(this);
    /** @type {import("./bars.js").Hit[]} */
    this.hits = []; // of the picture that is shown
    this.build(root);
    this.properties = new Properties(app, this);
    this.layer = document.createElement("canvas");
    this.listen();
    new ResizeObserver(() => {
      Object.assign(this.size, { width: this.box.clientWidth, height: this.scroller.clientHeight });
      app.redraw();
    }).observe(this.box);
  }

  build(root) {
    const scroller = { cls: "scroller", tabindex: 0, "aria-label": "Lanes" };
    this.canvas = h("canvas", { cls: "lanes", role: "img", "aria-label": "Lanes of the robots" });
    this.labels = h("div", { cls: "labels" });
    this.spacer = h("div", { cls: "spacer" });
    this.scroller = h("div", scroller, this.labels, this.canvas, this.spacer);
    this.cursor = h("div", { cls: "cursor" }, h("i"));
    this.tip = h("div", { cls: "tip", hidden: true });
    const { overview, ruler } = this.axis;
    const corner = h("div", { cls: "corner" });
    this.box = h("div", { cls: "chart" }, corner, overview, ruler, this.scroller, this.cursor, this.tip);
    root.append(this.box);
  }

  // ---- where things are --------------------------------------------------------------------------

  /** The end of the axis; it begins where the run does. */
  get last() {
    return Math.max(this.app.store.end, this.app.store.start + 1e9);
  }

  /** The end of what the strip of the whole run shows. */
  get reach() {
    return this.whole ? this.until : this.last;
  }

  x(time) {
    return ((time - this.from) / (this.until - this.from)) * this.width;
  }

  timeAt(x) {
    return this.from + (x / this.width) * (this.until - this.from);
  }

  all() {
    this.whole = true;
    this.app.redraw();
  }

  zoom(by, about = this.app.player.time) {
    const span = Math.min(Math.max((this.until - this.from) * by, 2e6), this.last - this.app.store.start);
    const part = Math.min(1, Math.max(0, (about - this.from) / (this.until - this.from)));
    this.window(about - part * span, span);
  }

  window(from, span) {
    const { start } = this.app.store;
    this.whole = span >= (this.last - start) * 0.999;
    this.from = Math.max(start, Math.min(from, this.last - span));
    this.until = this.from + span;
    this.app.redraw();
  }

  // ---- drawing -----------------------------------------------------------------------------------

  /** `begun`: when the frame began (ms). */
  update(time, begun) {
    const { store, mission } = this.app;
    this.width = Math.max(10, this.size.width - GUTTER);
    this.move(time);
    this.transport.total.textContent = clock(store.end);
    const reading = this.reading();
    if (this.transport.reading.textContent !== reading) this.transport.reading.textContent = reading;
    this.properties.read();
    if (!this.size.width) {
      // on another tab
      this.shown = time;
      this.point(time);
      return;
    }
    for (const block of store.within(this.from, this.until)) if (block.data) this.rows.settle(block.data);
    const lanes = this.rows.of(mission.order, this.levels);
    const under = lanes.reduce((sum, lane) => sum + lane.height, 0);
    const plotsTop = under + this.properties.height;
    this.spacer.style.height = `${plotsTop + this.plots.height}px`;
    this.label(lanes, plotsTop);
    this.axis.drawRuler();
    this.axis.measure();
    this.follow(time);
    this.draw(lanes, plotsTop, begun);
  }

  /** Show a span that has the instant of the cursor in it. */
  move(time) {
    const { store, player } = this.app;
    if (this.whole) {
      this.from = store.start;
      this.until = this.app.isLive() ? this.roomy(store.end) : this.last;
    } else if ((time > this.until || time < this.from) && time !== this.shown) {
      const span = this.until - this.from;
      const before = player.following ? 0.95 : player.playing ? 0 : 0.5;
      this.from = Math.max(store.start, Math.min(time - span * before, this.last - span));
      this.until = this.from + span;
    }
  }

  /** How much of the run is there, as long as that is not all of it. */
  reading() {
    const { store, mission } = this.app;
    const percent = (part) => `${Math.round(part * 100)} %`;
    if (mission.reading < 1) return `reading ${percent(mission.reading)}`;
    const missing = store.blocks.filter((block) => block.data === null).length;
    return missing > 1 && !store.full ? `loading ${percent(1 - missing / store.blocks.length)}` : "";
  }

  /** Whether an instant is in the span that is shown. */
  has(time) {
    return this.whole ? this.until >= time : this.from <= time && time <= this.until;
  }

  /** Show the instant of the cursor: what the robots do then, and the values of the plots. Bars do not depend on it. */
  follow(time) {
    const { state } = this.app;
    this.shown = time;
    if (state !== null)
      this.captions.forEach((caption, r) => {
        const text = doing(this.app, state, r) || startOf(this.app, r);
        if (caption.textContent !== text) caption.textContent = text;
      });
    this.plots.values(time);
    this.point(time);
    this.axis.drawOverview(time);
  }

  /** Show where the cursor is. */
  point(time) {
    const text = clock(time);
    if (this.transport.now.value !== text) this.transport.now.value = text;
    const x = this.x(time);
    const visible = x >= -1 && x <= this.width + 1;
    this.cursor.hidden = !visible;
    this.cursor.style.transform = `translateX(${GUTTER + x}px)`;
  }

  /** The span of a run that lasts: it grows in steps, so that the axis does not creep. */
  roomy(end) {
    const { start } = this.app.store;
    let span = 10e9;
    while (start + span < end) span *= 1.5;
    return start + span;
  }

  label(lanes, plotsTop) {
    const { mission, selected } = this.app;
    const key = [
      lanes.map(({ top, height }) => `${top}+${height}`),
      selected.robot,
      isDark(),
      mission.robots.length,
      this.plots.key,
      this.properties.key,
      this.properties.lanes.map((lane) => lane.word),
    ].join("|");
    if (key === this.labelKey) return;
    this.labelKey = key;
    this.captions = lanes.map(() => h("small"));
    show(
      this.labels,
      mission.order.map((r) => this.laneLabel(lanes[r], this.captions[r])),
      this.properties.labels(plotsTop - this.properties.height),
      this.plots.labels(plotsTop),
    );
  }

  laneLabel({ r, top, height }, caption) {
    const { name } = this.app.mission.robots[r];
    const chosen = this.app.selected.robot === r;
    const lane = h(
      "button",
      {
        cls: `lane${chosen ? " on" : ""}`,
        title: `Choose ${name}`,
        "aria-pressed": String(chosen),
        onclick: () => this.app.select({ robot: chosen ? -1 : r }),
      },
      swatch(r),
      h("span", null, h("b", null, name), caption),
    );
    lane.style.top = `${top}px`;
    lane.style.height = `${height}px`;
    return lane;
  }

  /** Bars, arrows, marks and plots, in a picture that is kept until something other than the cursor changes. */
  draw(lanes, plotsTop, frame) {
    const { store } = this.app;
    if (this.size.height < 2) return;
    const key = this.keyOf();
    const begun = performance.now();
    const same = key === this.layerKey;
    const version = `${store.version}/${store.blocks.length}/${Math.floor(this.x(store.end) / GROWTH)}`;
    if (!same || (this.painting === null && version !== this.layerVersion)) {
      if (same && begun < this.layerPause) {
        // a long run is being loaded: not for each of its blocks
        this.app.soon();
        return;
      }
      this.layerKey = key;
      this.layerVersion = version;
      this.paintCost = 0;
      this.painting = this.paint(lanes, plotsTop);
    }
    if (this.painting === null) return;
    // What only has more in it is painted in slices, so that no jump waits for it; what was asked for, at once.
    let done;
    do ({ done } = this.painting.next());
    while (!done && (!same || performance.now() < frame + SLICE));
    this.paintCost += performance.now() - begun;
    if (!done) {
      this.app.redraw();
      return;
    }
    this.painting = null;
    this.layerPause = begun + (this.paintCost > 8 ? Math.min(2000, 10 * this.paintCost) : 0);
  }

  /** What the picture depends on besides what is known of the run. */
  keyOf() {
    const { selected } = this.app;
    const { height, scroll } = this.size;
    const { from, until, width, levels, plots, properties } = this;
    const view = [from, until, width, height, scroll, window.devicePixelRatio];
    return [view, selected.robot, selected.element, levels, isDark(), plots.key, properties.key].join();
  }

  /** Paint on a canvas that is not shown, with a pause after each block; then show all of it. */
  *paint(lanes, plotsTop) {
    const { store } = this.app;
    const { width, bars } = this;
    const { height, scroll } = this.size;
    const context = sharp(this.layer, width, height);
    bars.begin();
    context.clearRect(0, 0, width, height);
    context.save();
    context.translate(0, -scroll);
    bars.drawLanes(context, lanes, scroll, height);
    for (const block of store.within(this.from, this.until)) {
      if (block.data) bars.drawSpans(context, block, block.data, lanes);
      else bars.drawMissing(context, block, plotsTop);
      yield;
    }
    for (const { data } of store.blocks) {
      if (data && signalsAreNew(data)) yield signalsOf(data, this.app.mission);
    }
    bars.drawArrows(context, lanes);
    yield;
    bars.drawMarks(context, lanes);
    this.properties.draw(context, plotsTop - this.properties.height, bars.hits);
    this.plots.draw(context, plotsTop, bars.hits);
    context.restore();
    const shown = sharp(this.canvas, width, height);
    shown.clearRect(0, 0, width, height);
    shown.drawImage(this.layer, 0, 0, width, height);
    this.hits = bars.hits;
  }

  // ---- what people do ----------------------------------------------------------------------------

  listen() {
    const { ruler, overview } = this.axis;
    const { store } = this.app;
    this.scrub(ruler, (x) => this.timeAt(x));
    this.scrub(this.canvas, (x) => this.timeAt(x));
    this.scrub(overview, (x) => store.start + (x / this.width) * (this.reach - store.start));
    for (const element of [this.canvas, ruler, overview])
      element.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    this.canvas.addEventListener("click", (event) => this.clicked(event));
    this.canvas.addEventListener("pointermove", (event) => this.hover(event));
    this.canvas.addEventListener("pointerleave", () => {
      this.tip.hidden = true;
    });
    this.scroller.addEventListener("scroll", () => {
      this.size.scroll = this.scroller.scrollTop;
      this.app.redraw();
    });
  }

  /** Let the cursor follow a pointer that is pressed on an element; `timeOf`: the instant of a place in it (px). */
  scrub(element, timeOf) {
    let held = false;
    const move = (event) => this.app.player.seek(timeOf(event.clientX - element.getBoundingClientRect().left));
    const release = () => {
      held = false;
    };
    element.addEventListener("pointerdown", (event) => {
      if (event.button > 0) return;
      held = true;
      element.setPointerCapture(event.pointerId);
      this.pressed = [event.clientX, event.clientY];
      move(event);
    });
    element.addEventListener("pointermove", (event) => held && move(event));
    for (const name of ["pointerup", "pointercancel"]) element.addEventListener(name, release);
  }

  clicked(event) {
    if (Math.hypot(event.clientX - this.pressed[0], event.clientY - this.pressed[1]) > 4) return;
    const { span, arrow, property } = this.hit(event) ?? {};
    if (span) this.app.select({ robot: span.r, element: span.e }, { reveal: true, scope: span.s });
    if (arrow) this.app.player.seek(arrow.until);
    if (property) this.properties.choose(...property);
  }

  wheel(event) {
    if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) {
      event.preventDefault();
      const shift = ((event.deltaX || event.deltaY) / this.width) * (this.until - this.from);
      if (!this.whole) this.window(this.from + shift, this.until - this.from);
      return;
    }
    const overflows = this.scroller.scrollHeight > this.scroller.clientHeight + 1;
    // it scrolls the lanes
    if (overflows && !event.ctrlKey && event.currentTarget === this.canvas && !event.altKey) return;
    event.preventDefault();
    this.zoom(Math.exp(event.deltaY * 0.0018), this.timeAt(event.clientX - this.canvas.getBoundingClientRect().left));
  }

  hit(event) {
    const box = this.canvas.getBoundingClientRect();
    const x = event.clientX - box.left;
    const y = event.clientY - box.top + this.scroller.scrollTop;
    const isIn = ([left, top, wide, high]) => x >= left && x <= left + wide && y >= top && y <= top + high;
    return this.hits.findLast((hit) => isIn(hit.box)) ?? null;
  }

  hover(event) {
    const hit = this.hit(event);
    this.tip.hidden = hit === null || event.buttons > 0;
    if (hit === null || this.tip.hidden) return;
    show(this.tip, this.describe(hit));
    const box = this.box.getBoundingClientRect();
    const wide = this.tip.offsetWidth;
    this.tip.style.left = `${Math.min(Math.max(event.clientX - box.left + 12, 4), box.width - wide - 4)}px`;
    this.tip.style.top = `${event.clientY - box.top - this.tip.offsetHeight - 10}px`;
  }

  /**
   * What the tooltip says: a title and lines.
   *
   * @param {import("./bars.js").Hit} hit
   */
  describe({ span, arrow, mark, property, alarm }) {
    const { elements, robots } = this.app.mission;
    if (property) return this.properties.tip(...property);
    if (alarm) return this.plots.tip(alarm);
    if (span) {
      const { name, id } = elements[span.e] ?? {};
      const until = span.until === Infinity ? this.app.store.end : span.until;
      const times = `${clock(span.from)} – ${clock(until)} · ${duration(until - span.from)}`;
      return lines(name || id, `${robots[span.r].name} · ${HOW.get(span.how)}`, times);
    }
    if (arrow) {
      const later = arrow.until > arrow.from ? ` · ${duration(arrow.until - arrow.from)} later` : "";
      const who = `${robots[arrow.sender].name} → ${robots[arrow.receiver].name}`;
      return lines(arrow.topic, who, `${clock(arrow.from)}${later}`);
    }
    if (!mark) return [];
    const [data, at] = mark;
    const { name, id } = elements[data.columns.e[at]] ?? {};
    return lines(name || id || "Report", String(data.details.get(at) ?? "failed"), clock(data.columns.t[at]));
  }
}
