// The timeline: a lane per robot with its elements as bars, signals as arrows between lanes, plots, and the cursor.

import { h, clock, cross, css, duration, isDark, paint, robotColour, sharp, show, swatch, trace } from "./dom.js";
import { CANCEL, FAIL, LEAVE, REPORT, spansOf } from "./store.js";
import { Axis, step } from "./axis.js";
import { overlap } from "./names.js";
import { Transport } from "./transport.js";
import { link, signalsAreNew, signalsOf } from "./signals.js";
import { Plots } from "./plots.js";
import { doing } from "./roster.js";
import { Properties } from "./properties.js";

const GUTTER = 148;
const ROW = 16;
const PAD = 3;
const LANE = 33;
const MOST_ROWS = 4;
const SLICE = 8; // ms of a frame
const GROWTH = 8; // px by which bars of what is under way grow at once

export class Timeline {
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
    this.rows = new Map(); // "robot/depth" -> Map element -> row
    this.seen = new Set();
    this.plots = new Plots(app, this);
    this.transport = new Transport(root, this);
    this.axis = new Axis(this);
    this.canvas = h("canvas", { cls: "lanes", role: "img", "aria-label": "Lanes of the robots" });
    this.labels = h("div", { cls: "labels" });
    this.spacer = h("div", { cls: "spacer" });
    this.scroller = h(
      "div",
      { cls: "scroller", tabindex: 0, "aria-label": "Lanes" },
      this.labels,
      this.canvas,
      this.spacer,
    );
    this.cursor = h("div", { cls: "cursor" }, h("i"));
    this.tip = h("div", { cls: "tip", hidden: true });
    this.box = h(
      "div",
      { cls: "chart" },
      h("div", { cls: "corner" }),
      this.axis.overview,
      this.axis.ruler,
      this.scroller,
      this.cursor,
      this.tip,
    );
    root.append(this.box);
    this.properties = new Properties(app, this);
    this.layer = document.createElement("canvas");
    this.layerKey = "";
    this.layerPause = 0;
    this.painting = null; // what has been painted of it
    this.hits = [];
    this.listen();
    new ResizeObserver(() => {
      Object.assign(this.size, { width: this.box.clientWidth, height: this.scroller.clientHeight });
      app.redraw();
    }).observe(this.box);
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

  /** Lanes: {robot, top, height, depths: rows of each depth}. */
  lanes() {
    const { robots } = this.app.mission;
    const found = [];
    let top = 0;
    robots.forEach((_, r) => {
      const depths = [];
      let rows = 0;
      for (let depth = 0; depth < this.levels; depth += 1) {
        const known = this.rows.get(`${r}/${depth}`);
        if (!known) continue;
        depths[depth] = rows;
        rows += Math.min(MOST_ROWS, 1 + Math.max(0, ...known.values()));
      }
      const height = Math.max(Math.max(rows, 1) * ROW + 2 * PAD, LANE);
      found.push({ r, top, height, depths });
      top += height;
    });
    return found;
  }

  /** Rows for elements that are under way at the same time: each element keeps its row. */
  settle(block) {
    const known = block.settled === block.columns.t.length;
    if (known) return;
    block.settled = block.columns.t.length;
    const active = new Map();
    for (const span of spansOf(block)) {
      const lane = `${span.r}/${Math.min(span.depth, 9)}`;
      if (!this.rows.has(lane)) this.rows.set(lane, new Map());
      const rows = this.rows.get(lane);
      if (span.until === span.from) {
        if (!rows.has(span.e)) rows.set(span.e, 0);
        continue;
      }
      const others = (active.get(lane) ?? []).filter((other) => other.until > span.from);
      const taken = new Set(others.filter((other) => other.e !== span.e).map((other) => rows.get(other.e)));
      let row = rows.get(span.e) ?? 0;
      if (taken.has(row)) for (row = 0; taken.has(row) && row < MOST_ROWS - 1;) row += 1;
      rows.set(span.e, row);
      others.push(span);
      active.set(lane, others);
    }
  }

  // ---- drawing -----------------------------------------------------------------------------------

  /** `begun`: when the frame began (ms). */
  update(time, begun) {
    const { store, mission, player } = this.app;
    this.width = Math.max(10, this.size.width - GUTTER);
    if (this.whole) {
      this.from = store.start;
      this.until = this.app.isLive() ? this.roomy(store.end) : this.last;
    } else if ((time > this.until || time < this.from) && time !== this.shown) {
      const span = this.until - this.from;
      const before = player.following ? 0.95 : player.playing ? 0 : 0.5;
      this.from = Math.max(store.start, Math.min(time - span * before, this.last - span));
      this.until = this.from + span;
    }
    this.transport.total.textContent = clock(store.end);
    const missing = store.blocks.filter((block) => block.data === null).length;
    const reading =
      mission.reading < 1
        ? `reading ${Math.round(mission.reading * 100)} %`
        : missing > 1
          ? `loading ${Math.round((1 - missing / store.blocks.length) * 100)} %`
          : "";
    if (this.transport.reading.textContent !== reading) this.transport.reading.textContent = reading;
    this.properties.read();
    if (!this.size.width) {
      // on another tab
      this.shown = time;
      this.point(time);
      return;
    }
    for (const block of store.within(this.from, this.until)) if (block.data) this.settle(block.data);
    const lanes = this.lanes();
    const under = lanes.length ? lanes.at(-1).top + lanes.at(-1).height : 0;
    const plotsTop = under + this.properties.height;
    const total = plotsTop + this.plots.height;
    this.spacer.style.height = `${total}px`;
    this.label(lanes, plotsTop);
    this.axis.drawRuler();
    this.axis.measure();
    this.follow(time);
    this.bars(lanes, plotsTop, begun);
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
      (this.captions ?? []).forEach((caption, r) => {
        const text = doing(this.app, state, r);
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
    if (key !== this.labelKey) {
      this.labelKey = key;
      this.captions = [];
      show(
        this.labels,
        lanes.map(({ r, top, height }) => {
          const caption = h("small");
          this.captions[r] = caption;
          const lane = h(
            "button",
            {
              cls: `lane${selected.robot === r ? " on" : ""}`,
              title: `Choose ${mission.robots[r].name}`,
              "aria-pressed": String(selected.robot === r),
              onclick: () => this.app.select({ robot: selected.robot === r ? -1 : r }),
            },
            swatch(r),
            h("span", null, h("b", null, mission.robots[r].name), caption),
          );
          lane.style.top = `${top}px`;
          lane.style.height = `${height}px`;
          return lane;
        }),
        this.properties.labels(plotsTop - this.properties.height),
        this.plots.labels(plotsTop),
      );
    }
  }

  /** Bars, arrows, marks and plots, in a picture that is kept until something other than the cursor changes. */
  bars(lanes, plotsTop, frame) {
    const { store, selected } = this.app;
    const { height, scroll } = this.size;
    const key = [
      this.from,
      this.until,
      this.width,
      height,
      scroll,
      selected.robot,
      selected.element,
      this.levels,
      isDark(),
      this.plots.key,
      this.properties.key,
      window.devicePixelRatio,
    ].join();
    if (height < 2) return;
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
      this.painting = this.paint(lanes, plotsTop, height, scroll);
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

  /** Paint on a canvas that is not shown, with a pause after each block; then show all of it. */
  *paint(lanes, plotsTop, height, scroll) {
    const { store } = this.app;
    const { width } = this;
    const context = sharp(this.layer, width, height);
    const hits = [];
    context.clearRect(0, 0, width, height);
    context.save();
    context.translate(0, -scroll);
    this.drawLanes(context, lanes, scroll, height);
    const last = new Map();
    this.written = new Map(); // the boxes of labels, by the middle of their line
    for (const block of store.within(this.from, this.until)) {
      if (block.data) this.drawSpans(context, block, lanes, last, hits);
      else this.drawMissing(context, block, plotsTop);
      yield;
    }
    for (const block of store.blocks) {
      if (block.data && signalsAreNew(block.data)) {
        signalsOf(block.data, this.app.mission);
        yield;
      }
    }
    this.drawArrows(context, lanes, hits);
    yield;
    this.drawMarks(context, lanes, hits);
    this.properties.draw(context, plotsTop - this.properties.height, hits);
    this.plots.draw(context, plotsTop, hits);
    context.restore();
    const shown = sharp(this.canvas, width, height);
    shown.clearRect(0, 0, width, height);
    shown.drawImage(this.layer, 0, 0, width, height);
    this.hits = hits;
  }

  drawLanes(context, lanes, scroll, height) {
    const line = css("--line");
    const soft = css("--soft");
    const each = step(this.until - this.from, this.width);
    context.fillStyle = soft;
    for (let time = Math.ceil(this.from / each) * each; time <= this.until; time += each)
      context.fillRect(Math.round(this.x(time)), scroll, 1, height);
    for (const { r, top, height: tall } of lanes) {
      if (this.app.selected.robot === r) {
        context.fillStyle = css("--chosen");
        context.fillRect(0, top, this.width, tall);
      }
      context.fillStyle = line;
      context.fillRect(0, top + tall - 1, this.width, 1);
    }
  }

  drawMissing(context, block, height) {
    const left = Math.max(0, this.x(block.start));
    const right = Math.min(this.width, this.x(block.end));
    context.fillStyle = css("--soft");
    context.fillRect(left, 0, Math.max(1, right - left), height);
  }

  drawSpans(context, { data, end, number }, lanes, last, hits) {
    const following = this.app.store.blocks[number + 1];
    // then the next block draws what is under way
    const goesOn = Boolean(following?.data) && following.start <= this.until;
    // what is under way goes on, also if nothing is new
    const now = following ? end : Math.max(end, this.app.store.end);
    const { elements } = this.app.mission;
    const { element: chosen } = this.app.selected;
    const width = this.width;
    const open = css("--open");
    const failed = css("--failed");
    const ink = css("--ink");
    context.font = "11px system-ui, sans-serif";
    context.textBaseline = "middle";
    for (const span of spansOf(data)) {
      const lane = lanes[span.r];
      const row0 = lane?.depths[span.depth];
      if (
        row0 === undefined ||
        (span.until === Infinity && goesOn && following.data.held.has(`${span.r}/${span.i}/${span.s}/${span.e}`))
      )
        continue;
      const until = span.until === Infinity ? now : span.until;
      if (until < this.from || span.from > this.until) continue;
      const left = Math.max(-2, this.x(span.from));
      const right = Math.min(width + 2, this.x(until));
      const row =
        row0 + Math.min(this.rows.get(`${span.r}/${Math.min(span.depth, 9)}`)?.get(span.e) ?? 0, MOST_ROWS - 1);
      const y = lane.top + PAD + row * ROW;
      const place = span.r * 64 + row;
      const wide = right - left;
      if (wide < 0.7 && span.how !== FAIL) {
        if (Math.round(left) <= (last.get(place) ?? -9)) continue;
        last.set(place, Math.round(left));
      }
      const element = elements[span.e] ?? { id: "", tag: "" };
      const colour = robotColour(span.r);
      const activity = /task|process|callActivity|transaction/i.test(element.tag);
      context.globalAlpha = chosen >= 0 && chosen !== span.e ? 0.35 : 1;
      if (wide < 3) {
        context.fillStyle = span.how === FAIL ? failed : colour;
        context.globalAlpha *= activity ? 0.85 : 0.5;
        context.fillRect(left, y + 1, Math.max(1, wide), ROW - 3);
      } else this.bar(context, left, y + 1, wide, ROW - 3, { colour, activity, how: span.how, failed });
      context.globalAlpha = chosen >= 0 && chosen !== span.e ? 0.5 : 1;
      if (wide > 26)
        this.text(
          context,
          element.name || element.id,
          Math.max(left, 0) + 5,
          y + ROW / 2,
          Math.min(right, width) - Math.max(left, 0) - 8,
          ink,
        );
      if (wide > 2) hits.push([left, y, wide, ROW, span]);
      if (span.how === -1 && span.until === Infinity && now >= this.app.store.end && wide > 6) {
        context.fillStyle = open;
        context.fillRect(right - 2, y + 1, 2, ROW - 3);
      }
    }
    context.globalAlpha = 1;
  }

  /** Activities are filled, what waits is an outline; cancelled is hatched, failed has a thick red edge and a cross. */
  bar(context, x, y, width, height, { colour, activity, how, failed }) {
    context.beginPath();
    context.roundRect(x, y, width, height, 3);
    if (!activity) context.setLineDash([3, 2]);
    paint(context, {
      fill: activity ? `${colour}${isDark() ? "55" : "38"}` : `${colour}10`,
      stroke: how === FAIL ? failed : colour,
      width: how === FAIL ? 2 : 1,
    });
    context.setLineDash([]);
    if (how === CANCEL) {
      context.save();
      context.clip();
      context.globalAlpha *= 0.5;
      context.beginPath();
      for (let at = x - height; at < x + width; at += 5) {
        context.moveTo(at, y + height);
        context.lineTo(at + height, y);
      }
      context.stroke();
      context.restore();
    }
    if (how === FAIL) cross(context, x + width - 5.5, y + height / 2, 2.5, failed, 2);
  }

  text(context, text, x, y, room, colour) {
    if (room < 14) return;
    context.fillStyle = colour;
    let shown = text;
    if (context.measureText(shown).width > room) {
      const fits = Math.floor((room / context.measureText(shown).width) * shown.length) - 1;
      if (fits < 2) return;
      shown = `${shown.slice(0, fits)}…`;
    }
    const box = [x, y - 6, context.measureText(shown).width, 12];
    if (this.written.get(y)?.some((other) => overlap(other, box))) return;
    this.written.set(y, [...(this.written.get(y) ?? []), box]);
    context.textAlign = "left";
    context.fillText(shown, x, y + 0.5);
  }

  /** Whether there is a label in a box. */
  covers(box) {
    return [...this.written].some(
      ([y, boxes]) => Math.abs(y - box[1] - 6) < 12 && boxes.some((other) => overlap(other, box)),
    );
  }

  drawArrows(context, lanes, hits) {
    const ink = css("--arrow");
    const { store, mission, selected } = this.app;
    if (this.arrowsVersion !== store.version) {
      this.arrowsVersion = store.version;
      this.arrows = link(store.blocks, mission);
    }
    context.font = "10.5px system-ui, sans-serif";
    const drawn = new Map();
    const texts = [];
    for (const arrow of this.arrows) {
      if (arrow.until < this.from || arrow.from > this.until) continue;
      const a = lanes[arrow.sender];
      const b = lanes[arrow.receiver];
      if (!a || !b) continue;
      const x0 = this.x(arrow.from);
      const x1 = this.x(arrow.until);
      const down = b.top > a.top;
      const key = `${arrow.sender}-${arrow.receiver}`;
      if (Math.abs(x1 - (drawn.get(key) ?? -99)) < 3) continue;
      drawn.set(key, x1);
      const y0 = down ? a.top + a.height - 4 : a.top + 4;
      const y1 = down ? b.top + 3 : b.top + b.height - 4;
      context.globalAlpha =
        selected.robot >= 0 && selected.robot !== arrow.sender && selected.robot !== arrow.receiver ? 0.25 : 1;
      trace(context, [
        [x0, y0],
        [x1, y1],
      ]);
      paint(context, { stroke: ink, width: 1.2 });
      context.beginPath();
      context.arc(x0, y0, 2.6, 0, 7);
      paint(context, { fill: ink });
      const angle = Math.atan2(y1 - y0, x1 - x0);
      const barb = (aside) => [x1 - 7 * Math.cos(angle + aside), y1 - 7 * Math.sin(angle + aside)];
      trace(context, [[x1, y1], barb(-0.45), barb(0.45)]);
      paint(context, { fill: ink });
      hits.push([x1 - 4, Math.min(y0, y1), 8, Math.abs(y1 - y0), null, arrow]);
      texts.push([arrow, x0, y0, down]);
    }
    context.globalAlpha = 1;
    for (const [arrow, x, y, down] of texts) {
      const text = arrow.topic;
      const wide = context.measureText(text).width;
      const box = [x + 5, y + (down ? -9 : 1), wide + 6, 12];
      if (x + wide > this.width || this.covers(box)) continue; // its tooltip says it
      context.fillStyle = css("--panel");
      context.globalAlpha = 0.86;
      context.fillRect(box[0] - 2, box[1], box[2], box[3]);
      context.globalAlpha = 1;
      this.text(context, text, box[0] + 1, box[1] + 6, wide + 4, ink);
    }
  }

  /** Errors are crosses, reports are triangles, above the bars. */
  drawMarks(context, lanes, hits) {
    const { store } = this.app;
    const failed = css("--failed");
    const warning = css("--warning");
    for (const { data } of store.within(this.from, this.until)) {
      if (!data) continue;
      data.marks = data.marksLength === data.columns.t.length ? data.marks : marksOf(data);
      data.marksLength = data.columns.t.length;
      for (const at of data.marks) {
        const { t, r, w } = data.columns;
        const x = this.x(t[at]);
        const lane = lanes[r[at]];
        if (x < -5 || x > this.width + 5 || !lane) continue;
        const y = lane.top + 5;
        if (w[at] === FAIL) cross(context, x, y, 3.5, failed, 2.2);
        else {
          trace(context, [
            [x, y - 4],
            [x + 4, y + 3],
            [x - 4, y + 3],
          ]);
          paint(context, { fill: warning });
        }
        hits.push([x - 5, lane.top, 10, 11, null, null, [data, at]]);
      }
    }
  }

  // ---- what people do ----------------------------------------------------------------------------

  listen() {
    const scrub = (element, timeOf) => {
      let held = false;
      const move = (event) => this.app.player.seek(timeOf(event.clientX - element.getBoundingClientRect().left));
      element.addEventListener("pointerdown", (event) => {
        if (event.button > 0) return;
        held = true;
        element.setPointerCapture(event.pointerId);
        this.pressed = [event.clientX, event.clientY];
        move(event);
      });
      element.addEventListener("pointermove", (event) => held && move(event));
      for (const name of ["pointerup", "pointercancel"])
        element.addEventListener(name, () => {
          held = false;
        });
    };
    scrub(this.axis.ruler, (x) => this.timeAt(x));
    scrub(this.canvas, (x) => this.timeAt(x));
    scrub(this.axis.overview, (x) => this.app.store.start + (x / this.width) * (this.reach - this.app.store.start));
    for (const element of [this.canvas, this.axis.ruler, this.axis.overview])
      element.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    this.canvas.addEventListener("click", (event) => {
      if (Math.hypot(event.clientX - this.pressed[0], event.clientY - this.pressed[1]) > 4) return;
      const hit = this.hit(event);
      if (hit?.[4]) this.app.select({ robot: hit[4].r, element: hit[4].e }, { reveal: true, scope: hit[4].s });
      if (hit?.[5]) this.app.player.seek(hit[5].until);
      if (hit?.[7]) this.properties.choose(...hit[7]);
    });
    this.canvas.addEventListener("pointermove", (event) => this.hover(event));
    this.canvas.addEventListener("pointerleave", () => {
      this.tip.hidden = true;
    });
    this.scroller.addEventListener("scroll", () => {
      this.size.scroll = this.scroller.scrollTop;
      this.app.redraw();
    });
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
    let found = null;
    for (const hit of this.hits ?? [])
      if (x >= hit[0] && x <= hit[0] + hit[2] && y >= hit[1] && y <= hit[1] + hit[3]) found = hit;
    return found;
  }

  hover(event) {
    const hit = this.hit(event);
    const { elements, robots } = this.app.mission;
    this.tip.hidden = hit === null || event.buttons > 0;
    if (this.tip.hidden) return;
    const [, , , , span, arrow, mark, property, alarm] = hit;
    if (property) show(this.tip, this.properties.tip(...property));
    else if (alarm) show(this.tip, this.plots.tip(alarm));
    else if (span) {
      const element = elements[span.e];
      const until = span.until === Infinity ? this.app.store.end : span.until;
      const how = { [-1]: "under way", [LEAVE]: "completed", [CANCEL]: "cancelled", [FAIL]: "failed" }[span.how];
      show(
        this.tip,
        h("b", null, element?.name || element?.id),
        h("span", null, `${robots[span.r].name} · ${how}`),
        h("span", null, `${clock(span.from)} – ${clock(until)} · ${duration(until - span.from)}`),
      );
    } else if (arrow) {
      show(
        this.tip,
        h("b", null, arrow.topic),
        h("span", null, `${robots[arrow.sender].name} → ${robots[arrow.receiver].name}`),
        h(
          "span",
          null,
          `${clock(arrow.from)}${arrow.until > arrow.from ? ` · ${duration(arrow.until - arrow.from)} later` : ""}`,
        ),
      );
    } else {
      const [data, at] = mark;
      const { t, e } = data.columns;
      show(
        this.tip,
        h("b", null, elements[e[at]]?.name || elements[e[at]]?.id || "Report"),
        h("span", null, String(data.details.get(at) ?? "failed")),
        h("span", null, clock(t[at])),
      );
    }
    const box = this.box.getBoundingClientRect();
    const wide = this.tip.offsetWidth;
    this.tip.style.left = `${Math.min(Math.max(event.clientX - box.left + 12, 4), box.width - wide - 4)}px`;
    this.tip.style.top = `${event.clientY - box.top - this.tip.offsetHeight - 10}px`;
  }
}

function marksOf(block) {
  const { w } = block.columns;
  const found = [];
  for (let at = 0; at < w.length; at += 1) if (w[at] === FAIL || w[at] === REPORT) found.push(at);
  return found;
}
