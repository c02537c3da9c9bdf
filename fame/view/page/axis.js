// The time axis: the ruler of the span that is shown, and the strip of the whole run with how much happened when.

import { clock, css, h, isDark, sharp } from "./dom.js";

const RULER = 22, OVERVIEW = 12;

/** Marks of the ruler: round steps that leave room for their text. */
export function step(span, width) {
  const least = (span / Math.max(width, 1)) * 86, power = 10 ** Math.floor(Math.log10(least));
  const found = [1, 2, 5, 10].map((times) => times * power).find((value) => value >= least);
  return Math.max(found, 1e6);
}

export class Axis {
  constructor(timeline) {
    this.timeline = timeline;
    this.overview = h("canvas", { cls: "overview", "aria-hidden": "true" });
    this.ruler = h("canvas", { cls: "ruler", "aria-hidden": "true" });
  }

  draw(time) {
    this.drawRuler();
    this.drawOverview(time);
  }

  drawRuler() {
    const key = [this.timeline.from, this.timeline.until, this.timeline.width, isDark(), window.devicePixelRatio].join();
    if (key === this.rulerKey) return;
    this.rulerKey = key;
    const context = sharp(this.ruler, this.timeline.width, RULER), each = step(this.timeline.until - this.timeline.from, this.timeline.width);
    context.clearRect(0, 0, this.timeline.width, RULER);
    context.font = "11px system-ui, sans-serif";
    context.textBaseline = "middle";
    const digits = Math.max(0, Math.min(3, -Math.floor(Math.log10(each / 1e9))));
    for (let at = Math.ceil(this.timeline.from / each) * each; at <= this.timeline.until; at += each) {
      const x = Math.round(this.timeline.x(at));
      context.fillStyle = css("--line");
      context.fillRect(x, RULER - 6, 1, 6);
      context.fillStyle = css("--muted");
      const seconds = at / 1e9, text = this.timeline.until < 120e9 ? `${seconds.toFixed(digits)} s` : clock(at).replace(/\.\d+$/, digits ? "$&" : "");
      const wide = context.measureText(text).width, place = Math.min(Math.max(x - wide / 2, 0), this.timeline.width - wide);
      context.fillText(text, place, 8);
    }
  }

  drawOverview(time) {
    const { store } = this.timeline.app, { width } = this.timeline, { start } = store, end = this.timeline.reach, x = (at) => ((at - start) / (end - start)) * width;
    const key = [store.version, width, isDark(), this.timeline.from, this.timeline.until, Math.round(x(time)), this.density?.version].join();
    if (key === this.overviewKey) return;
    this.overviewKey = key;
    const context = sharp(this.overview, width, OVERVIEW);
    context.clearRect(0, 0, width, OVERVIEW);
    const stale = this.density?.version !== store.version && performance.now() > (this.density?.until ?? 0);
    if (stale || this.density?.width !== width || this.density.dark !== isDark()) {
      this.density = this.densities(start, end, width);
      this.density.dark = isDark();
      this.strip ??= document.createElement("canvas");
      const pen = sharp(this.strip, width, OVERVIEW);
      pen.clearRect(0, 0, width, OVERVIEW);
      pen.fillStyle = css("--soft");
      pen.fillRect(0, 3, width, OVERVIEW - 6);
      pen.fillStyle = css("--muted");
      this.density.values.forEach((value, x) => {
        if (value > 0) pen.fillRect(x, OVERVIEW / 2 - value * 4, 1, value * 8);
      });
    }
    context.drawImage(this.strip, 0, 0, x(this.density.end), OVERVIEW); // a run that lasts may have grown since
    const left = x(this.timeline.from), right = x(this.timeline.until);
    context.strokeStyle = css("--accent");
    context.lineWidth = 1.5;
    if (!this.timeline.whole) context.strokeRect(left + 0.75, 1, Math.max(3, right - left) - 1.5, OVERVIEW - 2);
    context.fillStyle = css("--accent");
    context.fillRect(x(time) - 1, 0, 2, OVERVIEW);
  }

  densities(start, end, width) {
    const begun = performance.now(), values = new Float32Array(Math.ceil(width));
    for (const block of this.timeline.app.store.blocks) {
      const times = block.data?.columns.t;
      if (!times) continue;
      for (let at = 0; at < times.length; at += 1) values[Math.min(values.length - 1, Math.floor(((times[at] - start) / (end - start)) * width))] += 1;
    }
    const most = Math.log1p(Math.max(...values, 1));
    const shown = values.map((value) => Math.log1p(value) / most), cost = performance.now() - begun;
    return { version: this.timeline.app.store.version, width, end, values: shown, until: begun + (cost > 8 ? Math.min(2000, 10 * cost) : 0) };
  }
}
