// The time axis: the ruler of the span that is shown, and the strip of the whole run with how much happened when.

import { clock, css, h, isDark, sharp } from "./dom.js";

const RULER = 22;
const OVERVIEW = 12;

/**
 * Marks of the ruler: round steps that leave room for their text.
 *
 * @param {number} span ns
 * @param {number} width px
 * @returns {number} ns
 */
export function step(span, width) {
  const least = (span / Math.max(width, 1)) * 86;
  const power = 10 ** Math.floor(Math.log10(least));
  const round = [1, 2, 5, 10].map((times) => times * power).find((value) => value >= least);
  return Math.max(round ?? least, 1e6);
}

export class Axis {
  constructor(timeline) {
    this.timeline = timeline;
    this.overview = h("canvas", { cls: "overview", "aria-hidden": "true" });
    this.strip = document.createElement("canvas"); // what the overview shows but for the cursor
    this.ruler = h("canvas", { cls: "ruler", "aria-hidden": "true" });
  }

  drawRuler() {
    const key = [
      this.timeline.from,
      this.timeline.until,
      this.timeline.width,
      isDark(),
      window.devicePixelRatio,
    ].join();
    if (key === this.rulerKey) return;
    this.rulerKey = key;
    const context = sharp(this.ruler, this.timeline.width, RULER);
    const each = step(this.timeline.until - this.timeline.from, this.timeline.width);
    context.clearRect(0, 0, this.timeline.width, RULER);
    context.font = "11px system-ui, sans-serif";
    context.textBaseline = "middle";
    const digits = Math.max(0, Math.min(3, -Math.floor(Math.log10(each / 1e9))));
    for (let at = Math.ceil(this.timeline.from / each) * each; at <= this.timeline.until; at += each) {
      const x = Math.round(this.timeline.x(at));
      context.fillStyle = css("--line");
      context.fillRect(x, RULER - 6, 1, 6);
      context.fillStyle = css("--muted");
      const seconds = at / 1e9;
      const text =
        this.timeline.until < 120e9 ? `${seconds.toFixed(digits)} s` : clock(at).replace(/\.\d+$/, digits ? "$&" : "");
      const wide = context.measureText(text).width;
      const place = Math.min(Math.max(x - wide / 2, 0), this.timeline.width - wide);
      context.fillText(text, place, 8);
    }
  }

  /** Count what happened when, unless that is known. */
  measure() {
    const { timeline } = this;
    const { store } = timeline.app;
    const { start } = store;
    const end = timeline.reach;
    const known = this.density;
    const same = known !== undefined && known.width === timeline.width && known.dark === isDark();
    // a long run is being loaded: not for each of its blocks
    if (same && (known.version === store.version || performance.now() < known.pause)) return;
    const begun = performance.now();
    const values = this.densities(start, end, timeline.width);
    const pen = sharp(this.strip, timeline.width, OVERVIEW);
    pen.clearRect(0, 0, timeline.width, OVERVIEW);
    pen.fillStyle = css("--soft");
    pen.fillRect(0, 3, timeline.width, OVERVIEW - 6);
    pen.fillStyle = css("--muted");
    values.forEach((value, x) => {
      if (value > 0) pen.fillRect(x, OVERVIEW / 2 - value * 4, 1, value * 8);
    });
    this.density = {
      version: store.version,
      width: timeline.width,
      dark: isDark(),
      end,
      pause: begun + Math.min(2000, 20 * (performance.now() - begun)),
    };
  }

  drawOverview(time) {
    const { timeline, density } = this;
    const { width } = timeline;
    const { start } = timeline.app.store;
    const end = timeline.reach;
    const x = (at) => ((at - start) / (end - start)) * width;
    if (density === undefined) return;
    const key = [end, width, isDark(), timeline.from, timeline.until, Math.round(x(time)), density.version].join();
    if (key === this.overviewKey) return;
    this.overviewKey = key;
    const context = sharp(this.overview, width, OVERVIEW);
    context.clearRect(0, 0, width, OVERVIEW);
    context.drawImage(this.strip, 0, 0, x(density.end), OVERVIEW); // a run that lasts may have grown since
    const left = x(timeline.from);
    const right = x(timeline.until);
    context.strokeStyle = css("--accent");
    context.lineWidth = 1.5;
    if (!timeline.whole) context.strokeRect(left + 0.75, 1, Math.max(3, right - left) - 1.5, OVERVIEW - 2);
    context.fillStyle = css("--accent");
    context.fillRect(x(time) - 1, 0, 2, OVERVIEW);
  }

  /** How much happened when, 0 to 1, for each pixel. What a block adds is counted once. */
  densities(start, end, width) {
    const values = new Float32Array(Math.ceil(width));
    const last = values.length - 1;
    const part = width / (end - start);
    const place = [start, end, width].join();
    for (const { data } of this.timeline.app.store.blocks) {
      const times = data?.columns.t ?? [];
      if (!times.length) continue;
      if (data.density?.place !== place || data.density.length !== times.length) {
        const first = Math.min(last, Math.floor((times[0] - start) * part));
        const counts = [];
        for (const time of times) {
          const x = Math.min(last, Math.floor((time - start) * part)) - first;
          counts[x] = (counts[x] ?? 0) + 1;
        }
        data.density = { place, length: times.length, first, counts };
      }
      const { first, counts } = data.density;
      counts.forEach((count, x) => {
        values[first + x] += count;
      });
    }
    const most = Math.log1p(values.reduce((a, b) => Math.max(a, b), 1));
    return values.map((value) => Math.log1p(value) / most);
  }
}
