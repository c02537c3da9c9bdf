// Where the bars of the timeline are: a lane for each robot, in it rows for each depth of called processes.

import { spansOf } from "./store.js";

export const ROW = 16; // px
export const PAD = 3;
const LANE = 33;
export const MOST_ROWS = 4;
const DEEPEST = 9;

const laneOf = (r, depth) => `${r}/${Math.min(depth, DEEPEST)}`;

export class Lanes {
  rows = new Map(); // robot and depth -> Map element -> row

  /** Give elements that are under way at the same time different rows: each element keeps its row. */
  settle(block) {
    if (block.settled === block.columns.t.length) return;
    block.settled = block.columns.t.length;
    const active = new Map();
    for (const span of spansOf(block)) {
      const lane = laneOf(span.r, span.depth);
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

  /** The row of an execution among those of its depth. */
  rowOf({ r, depth, e }) {
    return Math.min(this.rows.get(laneOf(r, depth))?.get(e) ?? 0, MOST_ROWS - 1);
  }

  /** Lanes of a number of robots, with bars of some levels: {r, top, height, depths: the first row of each depth}. */
  of(robots, levels) {
    const found = [];
    let top = 0;
    for (let r = 0; r < robots; r += 1) {
      const depths = [];
      let rows = 0;
      for (let depth = 0; depth < levels; depth += 1) {
        const known = this.rows.get(laneOf(r, depth));
        if (!known) continue;
        depths[depth] = rows;
        rows += Math.min(MOST_ROWS, 1 + Math.max(0, ...known.values()));
      }
      const height = Math.max(Math.max(rows, 1) * ROW + 2 * PAD, LANE);
      found.push({ r, top, height, depths });
      top += height;
    }
    return found;
  }
}
