// What is painted in the lanes of the timeline: bars of executions, arrows of signals, marks of errors and reports.

/**
 * @import {Box, Point} from "./types.js"
 * @import {LoadedBlock, Span} from "./store.js"
 * @import {Timeline} from "./timeline.js"
 *
 * @typedef {object} Hit something that can be pointed at
 * @property {Box} box
 * @property {Span} [span]
 * @property {import("./signals.js").Arrow} [arrow]
 * @property {[block: LoadedBlock, at: number]} [mark]
 * @property {any} [property]
 * @property {any} [alarm]
 */
import { css, cross, isDark, paint, robotColour, trace } from "./dom.js";
import { step } from "./axis.js";
import { PAD, ROW } from "./lanes.js";
import { overlap } from "./names.js";
import { link } from "./signals.js";
import { CANCEL, FAIL, REPORT, spansOf, tokenKey } from "./store.js";

/**
 * What is written on the bar of an element: the ids of gateways say nothing.
 *
 * @param {Partial<import("./types.js").Element>} element
 */
const titleOf = ({ name, id, tag, topics }) =>
  name || topics?.[0]?.[0] || (/Gateway$/.test(tag ?? "") ? "" : (id ?? ""));

export class Bars {
  /** @param {Timeline} timeline */
  constructor(timeline) {
    this.timeline = timeline;
    this.app = timeline.app;
    this.look = { ink: "", open: "", failed: "" };
    /** @type {import("./signals.js").Arrow[]} */
    this.arrows = [];
    this.arrowsVersion = -1;
    /** @type {Hit[]} what is where */
    this.hits = [];
    /** @type {Map<number, Box[]>} the boxes of labels, by the middle of their line */
    this.written = new Map();
    /** @type {Map<number, number>} robot and row -> px of its last bar that is thinner than one */
    this.last = new Map();
  }

  /** Begin a new picture. */
  begin() {
    this.look = { ink: css("--ink"), open: css("--open"), failed: css("--failed") };
    this.hits = [];
    this.written = new Map();
    this.last = new Map();
  }

  drawLanes(context, lanes, scroll, height) {
    const { timeline } = this;
    const { from, until, width } = timeline;
    const each = step(until - from, width);
    context.fillStyle = css("--soft");
    for (let time = Math.ceil(from / each) * each; time <= until; time += each)
      context.fillRect(Math.round(timeline.x(time)), scroll, 1, height);
    for (const { r, top, height: tall } of lanes) {
      if (this.app.selected.robot === r) {
        context.fillStyle = css("--chosen");
        context.fillRect(0, top, width, tall);
      }
      context.fillStyle = css("--line");
      context.fillRect(0, top + tall - 1, width, 1);
    }
  }

  drawMissing(context, block, height) {
    const left = Math.max(0, this.timeline.x(block.start));
    const right = Math.min(this.timeline.width, this.timeline.x(block.end));
    context.fillStyle = css("--soft");
    context.fillRect(left, 0, Math.max(1, right - left), height);
  }

  // ---- executions --------------------------------------------------------------------------------

  drawSpans(context, { end, number }, data, lanes) {
    const { store } = this.app;
    const { from, until: last } = this.timeline;
    const following = store.blocks[number + 1];
    // then the next block draws what is under way
    const heldBy = following?.data && following.start <= last ? following.data.held : null;
    // what is under way goes on, also if nothing is new
    const now = following ? end : Math.max(end, store.end);
    context.font = "11px system-ui, sans-serif";
    context.textBaseline = "middle";
    for (const span of spansOf(data)) {
      const lane = lanes[span.r];
      const open = span.until === Infinity;
      if (lane?.depths[span.depth] === undefined) continue;
      if (open && heldBy?.has(tokenKey(span.r, span.i, span.s, span.e))) continue;
      const until = open ? now : span.until;
      if (until < from || span.from > last) continue;
      this.drawSpan(context, span, lane, until, open && now >= store.end);
    }
    context.globalAlpha = 1;
  }

  /** Draw an execution; `last`: it is under way at the end of the run. */
  drawSpan(context, span, lane, until, last) {
    const { timeline } = this;
    const { width } = timeline;
    const row = lane.depths[span.depth] + timeline.rows.rowOf(span);
    const left = Math.max(-2, timeline.x(span.from));
    const right = Math.min(width + 2, timeline.x(until));
    const wide = right - left;
    const y = lane.top + PAD + row * ROW;
    if (wide < 0.7 && span.how !== FAIL && this.isPainted(span.r, row, left)) return;
    const element = this.app.mission.elements[span.e] ?? { id: "", tag: "" };
    const { element: chosen } = this.app.selected;
    const faded = chosen >= 0 && chosen !== span.e;
    context.globalAlpha = faded ? 0.35 : 1;
    this.bar(context, [left, y + 1, wide, ROW - 3], span, element);
    context.globalAlpha = faded ? 0.5 : 1;
    if (wide > 26) {
      const begin = Math.max(left, 0);
      const room = Math.min(right, width) - begin - 8;
      this.text(context, titleOf(element), begin + 5, y + ROW / 2, room, this.look.ink);
    }
    if (wide > 2) this.hits.push({ box: [left, y, wide, ROW], span });
    if (span.how === -1 && last && wide > 6) {
      context.fillStyle = this.look.open;
      context.fillRect(right - 2, y + 1, 2, ROW - 3);
    }
  }

  /** Whether a bar that is thinner than a pixel has been painted there. */
  isPainted(r, row, left) {
    const place = r * 64 + row;
    if (Math.round(left) <= (this.last.get(place) ?? -9)) return true;
    this.last.set(place, Math.round(left));
    return false;
  }

  /** Activities are filled, what waits is an outline; cancelled is hatched, failed has a thick red edge and a cross. */
  bar(context, [x, y, width, height], { r, how }, { tag }) {
    const { failed } = this.look;
    const colour = robotColour(r);
    const activity = /task|process|callActivity|transaction/i.test(tag);
    if (width < 3) {
      context.fillStyle = how === FAIL ? failed : colour;
      context.globalAlpha *= activity ? 0.85 : 0.5;
      context.fillRect(x, y, Math.max(1, width), height);
      return;
    }
    context.beginPath();
    context.roundRect(x, y, width, height, 3);
    if (!activity) context.setLineDash([3, 2]);
    const fill = activity ? `${colour}${isDark() ? "55" : "38"}` : `${colour}10`;
    paint(context, { fill, stroke: how === FAIL ? failed : colour, width: how === FAIL ? 2 : 1 });
    context.setLineDash([]);
    if (how === CANCEL) hatch(context, x, y, width, height);
    if (how === FAIL) cross(context, x + width - 5.5, y + height / 2, 2.5, failed, 2);
  }

  /**
   * @param {CanvasRenderingContext2D} context @param {string} text @param {number} x @param {number} y
   * @param {number} room px
   * @param {string} colour
   */
  text(context, text, x, y, room, colour) {
    if (room < 14) return;
    context.fillStyle = colour;
    let shown = text;
    if (context.measureText(shown).width > room) {
      const fits = Math.floor((room / context.measureText(shown).width) * shown.length) - 1;
      if (fits < 2) return;
      shown = `${shown.slice(0, fits)}…`;
    }
    /** @type {Box} */
    const box = [x, y - 6, context.measureText(shown).width, 12];
    if (this.written.get(y)?.some((other) => overlap(other, box))) return;
    this.written.set(y, [...(this.written.get(y) ?? []), box]);
    context.textAlign = "left";
    context.fillText(shown, x, y + 0.5);
  }

  /**
   * Whether there is a label in a box.
   *
   * @param {Box} box
   */
  covers(box) {
    return [...this.written].some(
      ([y, boxes]) => Math.abs(y - box[1] - 6) < 12 && boxes.some((other) => overlap(other, box)),
    );
  }

  // ---- signals, errors and reports ---------------------------------------------------------------

  drawArrows(context, lanes) {
    const { store, mission, selected } = this.app;
    const { timeline } = this;
    if (this.arrowsVersion !== store.version) {
      this.arrowsVersion = store.version;
      this.arrows = link(store.blocks, mission);
    }
    context.font = "10.5px system-ui, sans-serif";
    const drawn = new Map();
    const texts = [];
    for (const arrow of this.arrows) {
      const { sender, receiver } = arrow;
      const [a, b] = [lanes[sender], lanes[receiver]];
      if (arrow.until < timeline.from || arrow.from > timeline.until || !a || !b) continue;
      const [x0, x1] = [timeline.x(arrow.from), timeline.x(arrow.until)];
      const key = `${sender}-${receiver}`;
      if (Math.abs(x1 - (drawn.get(key) ?? -99)) < 3) continue;
      drawn.set(key, x1);
      const down = b.top > a.top;
      const y0 = down ? a.top + a.height - 4 : a.top + 4;
      const y1 = down ? b.top + 3 : b.top + b.height - 4;
      context.globalAlpha = selected.robot < 0 || [sender, receiver].includes(selected.robot) ? 1 : 0.25;
      drawArrow(context, [x0, y0], [x1, y1]);
      this.hits.push({ box: [x1 - 4, Math.min(y0, y1), 8, Math.abs(y1 - y0)], arrow });
      texts.push([arrow.topic, x0, y0 + (down ? -9 : 1)]);
    }
    context.globalAlpha = 1;
    for (const [text, x, y] of texts) this.label(context, text, x, y);
  }

  /** Write a topic beside its arrow, if there is room: its tooltip says it. */
  label(context, text, x, y) {
    const wide = context.measureText(text).width;
    /** @type {Box} */
    const box = [x + 5, y, wide + 6, 12];
    if (x + wide > this.timeline.width || this.covers(box)) return;
    context.fillStyle = css("--panel");
    context.globalAlpha = 0.86;
    context.fillRect(box[0] - 2, box[1], box[2], box[3]);
    context.globalAlpha = 1;
    this.text(context, text, box[0] + 1, box[1] + 6, wide + 4, css("--arrow"));
  }

  /** Errors are crosses, reports are triangles, above the bars. */
  drawMarks(context, lanes) {
    const { timeline } = this;
    for (const { data } of this.app.store.within(timeline.from, timeline.until)) {
      if (!data) continue;
      const { t, r, w } = data.columns;
      for (const at of marksOf(data)) {
        const x = timeline.x(t[at]);
        const lane = lanes[r[at]];
        if (x < -5 || x > timeline.width + 5 || !lane) continue;
        const y = lane.top + 5;
        if (w[at] === FAIL) cross(context, x, y, 3.5, this.look.failed, 2.2);
        else triangle(context, x, y, css("--warning"));
        this.hits.push({ box: [x - 5, lane.top, 10, 11], mark: [data, at] });
      }
    }
  }
}

function hatch(context, x, y, width, height) {
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

/** @param {CanvasRenderingContext2D} context @param {Point} from @param {Point} to */
function drawArrow(context, from, to) {
  const [x0, y0] = from;
  const [x1, y1] = to;
  const ink = css("--arrow");
  const angle = Math.atan2(y1 - y0, x1 - x0);
  /** @type {(aside: number) => Point} */
  const barb = (aside) => [x1 - 7 * Math.cos(angle + aside), y1 - 7 * Math.sin(angle + aside)];
  trace(context, [from, to]);
  paint(context, { stroke: ink, width: 1.2 });
  context.beginPath();
  context.arc(x0, y0, 2.6, 0, 7);
  paint(context, { fill: ink });
  trace(context, [to, barb(-0.45), barb(0.45)]);
  paint(context, { fill: ink });
}

function triangle(context, x, y, fill) {
  trace(context, [
    [x, y - 4],
    [x + 4, y + 3],
    [x - 4, y + 3],
  ]);
  paint(context, { fill });
}

/**
 * The places of errors and reports in a block.
 *
 * @param {LoadedBlock} block
 */
function marksOf(block) {
  const { w } = block.columns;
  if (block.marksLength !== w.length) {
    block.marksLength = w.length;
    block.marks = [...w.keys()].filter((at) => w[at] === FAIL || w[at] === REPORT);
  }
  return block.marks ?? [];
}
