// Where the bars of the timeline are: a lane for each robot, in it rows for each depth of called processes.

/**
 * @import {LoadedBlock, Span} from "./store.js"
 *
 * @typedef {{r: number, top: number, height: number, depths: number[]}} Lane of a robot: `depths` are the first rows
 */
import { spansOf } from "./store.js";

export const ROW = 16; // px
export const PAD = 3;
const LANE = 33;
export const MOST_ROWS = 4;
const DEEPEST = 9;

/** @param {number} r @param {number} depth */
const laneOf = (r, depth) => `${r}/${Math.min(depth, DEEPEST)}`;

export class Lanes {
  /** @type {Map<string, Map<number, number>>} robot and depth -> element -> row */
  rows = new Map();

  /**
   * Give elements that are under way at the same time different rows: each element keeps its row.
   *
   * @param {LoadedBlock} block
   */
  settle(block) {
    if (block.settled === block.columns.t.length) return;
    block.settled = block.columns.t.length;
    /** @type {Map<string, Span[]>} */
    const active = new Map();
    for (const span of spansOf(block)) {
      const lane = laneOf(span.r, span.depth);
      const rows = this.rows.get(lane) ?? new Map();
      this.rows.set(lane, rows);
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

  /**
   * The row of an execution among those of its depth.
   *
   * @param {Span} span
   */
  rowOf({ r, depth, e }) {
    return Math.min(this.rows.get(laneOf(r, depth))?.get(e) ?? 0, MOST_ROWS - 1);
  }

  /**
   * Lanes of robots in an order, by robot, with bars of some levels: {r, top, height, depths: the first row of each}.
   *
   * @param {number[]} order @param {number} levels
   */
  of(order, levels) {
    /** @type {Lane[]} */
    const found = [];
    let top = 0;
    for (const r of order) {
      /** @type {number[]} */
      const depths = [];
      let rows = 0;
      for (let depth = 0; depth < levels; depth += 1) {
        const known = this.rows.get(laneOf(r, depth));
        if (!known) continue;
        depths[depth] = rows;
        rows += Math.min(MOST_ROWS, 1 + Math.max(0, ...known.values()));
      }
      const height = Math.max(Math.max(rows, 1) * ROW + 2 * PAD, LANE);
      found[r] = { r, top, height, depths };
      top += height;
    }
    return found;
  }
}
