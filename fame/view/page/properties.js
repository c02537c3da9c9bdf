// Properties: a lane for each in the timeline, with what is pending, how much is left, and where it was violated.

/** @import {App} from "./main.js" */
/** @import {Timeline} from "./timeline.js" */
import { h, clock, cross, css, paint, show, trace } from "./dom.js";

const HEIGHT = 26;

export class Properties {
  /** @param {App} app @param {Timeline} timeline */
  constructor(app, timeline) {
    this.app = app;
    this.timeline = timeline;
    this.lanes = [];
    this.chosen = ""; // the lane whose elements are outlined
    this.card = h("div", { cls: "verdict", hidden: true });
    timeline.box.append(this.card);
  }

  get key() {
    return `${this.lanes.map((lane) => lane.id).join("|")}|${this.chosen}`;
  }

  get height() {
    return this.lanes.length * HEIGHT;
  }

  /** The elements that the chosen property names. */
  get named() {
    return this.lanes.find((lane) => lane.id === this.chosen)?.named ?? new Set();
  }

  /** Read what all loaded blocks have of them. */
  read() {
    const { store } = this.app;
    if (this.version === store.version) return;
    this.version = store.version;
    const lanes = new Map();
    const named = new Map();
    for (const { properties } of store.blocks) {
      for (const [time, change] of properties ?? []) {
        const { property: name, robots } = change;
        const id = [name, ...robots].join(" ");
        if (change.names)
          named.set(name, new Set([...(named.get(name) ?? []), ...change.names.map(([, element]) => element)]));
        if (change.names && [...lanes.values()].some((lane) => lane.name === name)) continue;
        if (robots.length && lanes.get(name)?.spans.length === 0) lanes.delete(name); // of its robots apart
        if (!lanes.has(id))
          lanes.set(id, { id, name, robots, sentence: change.sentence, spans: [], curve: [], open: null, word: "" });
        if (!change.names) this.take(lanes.get(id), time, change);
      }
    }
    this.lanes = [...lanes.values()];
    for (const lane of this.lanes) lane.named = named.get(lane.name) ?? new Set();
  }

  take(lane, time, change) {
    const { verdict, slack } = change;
    lane.word = verdict;
    if (lane.open !== null && verdict !== "pending") {
      Object.assign(lane.open, { until: verdict === "violated" ? change.time * 1e9 : time, verdict, slack });
      if (verdict === "violated") Object.assign(lane.open, { change });
      lane.open = null;
    } else if (verdict === "violated")
      lane.spans.push({ from: (change.began ?? change.time) * 1e9, until: change.time * 1e9, verdict, change });
    if (verdict === "pending") {
      lane.open = {
        from: (change.began ?? time / 1e9) * 1e9,
        until: Infinity,
        due: change.time === null ? Infinity : change.time * 1e9,
        verdict,
        change,
      };
      lane.spans.push(lane.open);
    } else if (slack !== null && !lane.spans.some((span) => Number.isFinite(span.due))) lane.curve.push([time, slack]);
  }

  labels(top) {
    return this.lanes.map((lane, place) => {
      const label = h(
        "button",
        {
          cls: `lane property${lane.id === this.chosen ? " on" : ""}`,
          title: lane.sentence,
          "aria-pressed": String(lane.id === this.chosen),
          onclick: () => this.choose(lane, null),
        },
        h("i", { cls: lane.word.replace(" ", "-") }),
        h("span", null, h("b", null, lane.name), lane.robots.length ? h("em", null, lane.robots.join(", ")) : null),
      );
      label.style.top = `${top + place * HEIGHT}px`;
      label.style.height = `${HEIGHT}px`;
      return label;
    });
  }

  draw(context, top, hits) {
    this.lanes.forEach((lane, place) => this.drawOne(context, lane, top + place * HEIGHT, hits));
  }

  drawOne(context, lane, top, hits) {
    const { timeline } = this;
    const bottom = top + HEIGHT - 4;
    context.fillStyle = css("--line");
    context.fillRect(0, top + HEIGHT - 1, timeline.width, 1);
    for (const span of lane.spans) {
      const until = Math.min(span.until, this.app.store.end);
      const left = Math.max(-2, timeline.x(span.from));
      const right = Math.min(timeline.width + 2, timeline.x(until));
      if (right < 0 || left > timeline.width) continue;
      const wide = Math.max(2, right - left);
      this.drawSpan(context, span, until, top, [left, wide]);
      hits.push({ box: [left - 5, top, wide + 10, HEIGHT], property: [lane, span] });
    }
    if (lane.curve.length > 1) {
      const most = Math.max(...lane.curve.map(([, slack]) => slack), 1e-9);
      const y = (slack) => bottom - (Math.max(0, slack) / most) * (HEIGHT - 8);
      const points = lane.curve.map(([time, slack]) => [timeline.x(time), y(slack)]);
      this.line(context, [...points, [timeline.x(this.app.store.end), points.at(-1)[1]]], css("--accent"));
    }
  }

  /** Draw a span in which a property was pending or violated, and how much of its time is left: that falls steadily. */
  drawSpan(context, span, until, top, [left, wide]) {
    const { timeline } = this;
    const bad = span.verdict === "violated";
    const colour = css(bad ? "--failed" : "--accent");
    context.globalAlpha = 0.22;
    context.fillStyle = colour;
    context.fillRect(left, top + 4, wide, HEIGHT - 8);
    context.globalAlpha = 1;
    if (Number.isFinite(span.due)) {
      const rest = Math.max(0, (span.due - until) / (span.due - span.from));
      const end = [timeline.x(until), top + HEIGHT - 4 - rest * (HEIGHT - 8)];
      this.line(context, [[timeline.x(span.from), top + 4], end], colour);
    }
    if (bad) {
      const x = timeline.x(span.until);
      context.fillStyle = colour;
      context.fillRect(x - 1.5, top + 2, 3, HEIGHT - 4);
      cross(context, x, top + 13, 5, colour, 1.2);
    }
  }

  line(context, points, colour) {
    trace(context, points);
    paint(context, { stroke: colour, width: 1.2 });
  }

  tip(lane, span) {
    const left = Number.isFinite(span.due)
      ? ` · ${((span.due - Math.min(span.until, this.app.store.end)) / 1e9).toPrecision(3)} s left`
      : "";
    return [
      h("b", null, lane.name),
      h("span", null, lane.sentence),
      h("span", null, `${clock(span.from)} – ${clock(Math.min(span.until, this.app.store.end))}${left}`),
    ];
  }

  /** Outline the elements of a property, and show its sentence and the events of a span; again: neither. */
  choose(lane, span) {
    const close = span === null && this.chosen === lane.id;
    this.chosen = close ? "" : lane.id;
    const broken = span ?? lane.spans.find((one) => one.verdict === "violated") ?? null;
    this.card.hidden = close;
    show(
      this.card,
      h("button", { cls: "close", title: "Close", onclick: () => this.choose(lane, null) }, "×"),
      h("b", null, `${lane.name}: ${broken?.verdict ?? lane.word}`),
      h("span", { cls: "sentence" }, lane.sentence),
      broken?.change.text ? h("span", null, broken.change.text) : null,
      broken ? h("div", null, this.jumps(broken)) : null,
    );
    this.app.redraw();
  }

  /** Buttons that show the events, and the instant, at which a span began and ended. */
  jumps({ from, until, verdict, change }) {
    const { elements, robots } = this.app.mission;
    const found = [];
    const end = Number.isFinite(until) ? until : null;
    const jump = (time, event, text) =>
      h(
        "button",
        {
          onclick: () => {
            this.app.player.seek(time);
            if (event) this.app.select({ robot: event[0], element: event[1] }, { reveal: true });
          },
        },
        `${clock(time)} ${text}`,
      );
    const named = ([r, e]) => `${robots[r]?.name ?? ""} ${elements[e]?.name || elements[e]?.id || ""}`;
    const [first, last = null] = change.elements;
    const one = change.began === null;
    if (first && !one) found.push(jump(from, first, named(first)));
    const closing = one ? first : last;
    if (end !== null && verdict === "violated")
      found.push(jump(end, closing ?? null, closing ? named(closing) : "violated"));
    return found;
  }
}
