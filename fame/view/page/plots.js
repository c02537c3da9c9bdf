// Plots: a numeric variable, or a field of a message, over the time of the timeline.

/** @import {App} from "./main.js" */
/** @import {Timeline} from "./timeline.js" */
import { h, icon, clock, robotColour, css } from "./dom.js";
import { after } from "./store.js";

const HEIGHT = 58;

/** The value at a path in plain data, as a number, or NaN. */
export function numeric(value, path) {
  let found = value;
  for (const key of path) found = found?.[key];
  if (typeof found === "boolean") return Number(found);
  return typeof found === "number" ? found : NaN;
}

/** The lowest and highest of some values and of the band around them; Infinity and -Infinity without numbers. */
function rangeOf(values, band, first, last) {
  let low = Infinity;
  let high = -Infinity;
  for (let at = first; at <= last; at += 1) {
    if (values[at] < low) low = values[at];
    if (values[at] > high) high = values[at];
    if (band && band.low[at] !== null) [low, high] = [Math.min(low, band.low[at]), Math.max(high, band.high[at])];
  }
  return [low, high];
}

export class Plots {
  /** @param {App} app @param {Timeline} timeline */
  constructor(app, timeline) {
    this.app = app;
    this.timeline = timeline;
    this.shown = []; // {r, name, path, topic}
    this.count = 0;
  }

  get key() {
    return this.shown.map((plot) => plot.id).join("|");
  }

  get height() {
    return this.shown.length * HEIGHT;
  }

  static id({ r, name, path = [], topic = "" }) {
    return JSON.stringify([topic ? -1 : r, topic || name, ...path]);
  }

  has(plot) {
    const id = Plots.id(plot);
    return this.shown.some((other) => other.id === id);
  }

  toggle(plot) {
    const id = Plots.id(plot);
    if (this.has(plot)) this.shown = this.shown.filter((other) => other.id !== id);
    else this.shown.push({ path: [], ...plot, id });
    this.app.changedPlots();
  }

  /** Show what a model of monitoring tells of a recording: channels in the band of its training runs, and alarms. */
  judge({ begin, model, alarms, channels }) {
    const moved = (time) => time - begin;
    const spans = alarms.map(({ from, until, text }) => ({ from: moved(from), until: moved(until), text }));
    channels.forEach(({ name, times, values, low, high }, number) =>
      this.toggle({
        r: -1,
        name,
        topic: `${model} ${number}`,
        band: { low, high, model },
        alarms: spans,
        data: [times.map(moved), values],
      }),
    );
  }

  title({ name, path, topic, band }) {
    if (band) return name;
    return topic ? [topic, ...path].join(".") : `${[name, ...path].join(".")}`;
  }

  labels(top) {
    return this.shown.map((plot, place) => {
      plot.value = h("small");
      const label = h(
        "div",
        { cls: "lane plot" },
        h(
          "span",
          null,
          h("b", { title: this.title(plot) }, plot.band ? plot.name.split(".").at(-1) : this.title(plot)),
          plot.band
            ? h("em", null, `in the band of ${plot.band.model}`)
            : plot.topic
              ? null
              : h("em", null, this.app.mission.robots[plot.r]?.name ?? ""),
          plot.value,
        ),
        h("button", { title: "Remove the plot", onclick: () => this.toggle(plot) }, icon("close")),
      );
      label.style.top = `${top + place * HEIGHT}px`;
      label.style.height = `${HEIGHT}px`;
      return label;
    });
  }

  /** [times, values] in all loaded blocks. */
  series(plot) {
    const { store } = this.app;
    if (plot.band) return plot.data;
    if (plot.version === store.version) return plot.data;
    plot.version = store.version;
    const times = [];
    const values = [];
    const add = (time, value) => {
      if (Number.isNaN(value) && Number.isNaN(values.at(-1) ?? NaN)) return;
      times.push(time);
      values.push(value);
    };
    for (const { data } of store.blocks) {
      if (!data) continue;
      if (plot.topic)
        for (const [time, topic, , content] of data.messages)
          if (topic === plot.topic) add(time, numeric(content, plot.path));
      if (plot.topic) continue;
      for (const [r, , held] of data.key.variables)
        if (r === plot.r && plot.name in held) add(data.start, numeric(held[plot.name][0], plot.path));
      for (const [time, r, , changed] of data.variables)
        if (r === plot.r && changed !== null && plot.name in changed) add(time, numeric(changed[plot.name], plot.path));
    }
    plot.data = [times, values];
    return plot.data;
  }

  values(time) {
    for (const plot of this.shown) {
      const [times, values] = this.series(plot);
      const at = after(times, time) - 1;
      const value = values[at];
      const text = at < 0 || Number.isNaN(value) ? "–" : String(Number(value.toPrecision(6)));
      if (plot.value && plot.value.textContent !== text) plot.value.textContent = text;
    }
  }

  draw(context, top, hits) {
    this.shown.forEach((plot, place) => this.drawOne(context, plot, top + place * HEIGHT, hits));
  }

  /** The band of the training runs, and the alarms. */
  drawBand(context, { band, alarms, data: [times] }, [first, last], y, top, hits) {
    const { timeline } = this;
    context.globalAlpha = 0.25;
    context.fillStyle = css("--accent");
    for (let at = first; at < last; at += 1) {
      if (band.low[at] === null) continue;
      const x = timeline.x(times[at]);
      const high = y(band.high[at]);
      context.fillRect(x, high, Math.max(1, timeline.x(times[at + 1]) - x), Math.max(1, y(band.low[at]) - high));
    }
    context.fillStyle = css("--failed");
    for (const { from, until, text } of alarms) {
      const left = Math.max(-2, timeline.x(from));
      const wide = Math.max(2, Math.min(timeline.width + 2, timeline.x(until)) - left);
      if (left > timeline.width || wide < 2) continue;
      context.fillRect(left, top + 2, wide, HEIGHT - 4);
      hits.push({ box: [left, top, wide, HEIGHT], alarm: { from, until, text } });
    }
    context.globalAlpha = 1;
  }

  tip({ from, until, text }) {
    return [
      h("b", null, "Alarm"),
      ...text.map((line) => h("span", null, line)),
      h("span", null, `${clock(from)} – ${clock(until)}`),
    ];
  }

  drawOne(context, plot, top, hits) {
    const { timeline } = this;
    const [times, values] = this.series(plot);
    const first = Math.max(0, after(times, timeline.from) - 1);
    const last = Math.min(times.length - 1, after(times, timeline.until));
    let [low, high] = rangeOf(values, plot.band, first, last);
    context.fillStyle = css("--line");
    context.fillRect(0, top + HEIGHT - 1, timeline.width, 1);
    context.font = "10px system-ui, sans-serif";
    context.textBaseline = "middle";
    if (low > high) {
      context.fillStyle = css("--muted");
      context.textAlign = "left";
      context.fillText("no numbers in this span of time", 6, top + HEIGHT / 2);
      return;
    }
    if (low === high) [low, high] = [low - 1, high + 1];
    const y = (value) => top + HEIGHT - 9 - ((value - low) / (high - low)) * (HEIGHT - 18);
    if (plot.band) this.drawBand(context, plot, [first, last], y, top, hits);
    context.strokeStyle = this.colour(plot);
    context.lineWidth = 1.5;
    context.lineJoin = "round";
    this.drawSteps(context, times, values, [first, last], y);
    context.fillStyle = css("--muted");
    context.textAlign = "right";
    for (const value of [high, low])
      context.fillText(String(Number(value.toPrecision(4))), timeline.width - 4, y(value));
    context.textAlign = "left";
  }

  /** That of the robot whose variable it is, or in whose namespace the topic is. */
  colour({ r, topic, band }) {
    const { robots } = this.app.mission;
    const robot = topic && !band ? robots.findIndex(({ name }) => topic.startsWith(`/${name}/`)) : r;
    return robot < 0 ? css("--ink") : robotColour(robot);
  }

  /** Draw values that hold until the next one; where there is none (NaN) there is a gap. */
  drawSteps(context, times, values, [first, last], y) {
    const { timeline } = this;
    let before = NaN;
    let px = -9;
    let lowest = NaN;
    let highest = NaN;
    context.beginPath();
    for (let at = first; at <= last; at += 1) {
      const value = values[at];
      const x = timeline.x(times[at]);
      if (!Number.isNaN(value) && Math.round(x) === px) {
        // many in one pixel: a vertical line from the lowest to the highest
        lowest = Math.min(lowest, value);
        highest = Math.max(highest, value);
        if (value === lowest || value === highest) context.lineTo(x, y(value));
      } else if (!Number.isNaN(value)) {
        if (Number.isNaN(before)) context.moveTo(x, y(value));
        else for (const level of [before, value]) context.lineTo(x, y(level));
        px = Math.round(x);
        lowest = highest = value;
      }
      before = value;
    }
    if (!Number.isNaN(before)) context.lineTo(Math.min(timeline.x(this.app.store.end), timeline.width), y(before));
    context.stroke();
  }
}
