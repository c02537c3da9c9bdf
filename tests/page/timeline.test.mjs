// The timeline: rows of bars, the span that is shown, the marks of its ruler, arrows of signals.

import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";
import { step } from "../../fame/view/page/axis.js";
import { Lanes, MOST_ROWS, PAD, ROW } from "../../fame/view/page/lanes.js";
import { link } from "../../fame/view/page/signals.js";
import { ENTER, LEAVE } from "../../fame/view/page/store.js";
import { Timeline } from "../../fame/view/page/timeline.js";

/** A loaded block with these bars: [element, from, until, depth]. */
const blockOf = (...bars) => ({
  columns: { t: bars },
  spans: bars.map(([e, from, until, depth = 0]) => ({ r: 0, i: 1, s: 1, e, from, until, how: LEAVE, depth })),
});

const rowsOf = (lanes, ...elements) => elements.map((e) => lanes.rowOf({ r: 0, depth: 0, e }));

test("elements that follow each other share a row, those at the same time have rows of their own", () => {
  const lanes = new Lanes();
  lanes.settle(blockOf([1, 0, 5], [2, 5, 9], [3, 6, 8]));
  assert.deepEqual(rowsOf(lanes, 1, 2, 3), [0, 0, 1]);
});

test("an element keeps its row for the whole run", () => {
  const lanes = new Lanes();
  lanes.settle(blockOf([1, 0, 5], [2, 1, 5], [2, 7, 9]));
  assert.deepEqual(rowsOf(lanes, 1, 2), [0, 1]);
});

test("rows are few: the last one takes all others", () => {
  const lanes = new Lanes();
  lanes.settle(blockOf(...[1, 2, 3, 4, 5, 6].map((e) => [e, 0, 9])));
  assert.deepEqual(rowsOf(lanes, 4, 5, 6), [MOST_ROWS - 1, MOST_ROWS - 1, MOST_ROWS - 1]);
  assert.equal(lanes.of([0], 1)[0].height, MOST_ROWS * ROW + 2 * PAD);
});

test("lanes lie below each other; a depth begins where the one before ends, and has no rows if it is not shown", () => {
  const lanes = new Lanes();
  lanes.settle(blockOf([1, 0, 9], [2, 0, 9], [3, 0, 9, 1]));
  const [first, second] = lanes.of([0, 1], 2);
  assert.deepEqual(first.depths, [0, 2]);
  assert.equal(first.height, 3 * ROW + 2 * PAD);
  assert.deepEqual([second.r, second.top, second.depths], [1, first.height, []]);
  assert.deepEqual(lanes.of([0], 1)[0].depths, [0]);
});

test("lanes are found by robot, whatever their order is", () => {
  const [first, second] = new Lanes().of([1, 0], 1);
  assert.deepEqual([first.r, second.r, second.top, first.top], [0, 1, 0, second.height]);
});

test("a block that has grown is settled again, another one is not", () => {
  const lanes = new Lanes();
  const block = blockOf([1, 0, 9]);
  lanes.settle(block);
  block.spans = [];
  lanes.settle(block);
  assert.deepEqual(rowsOf(lanes, 1), [0]);
  Object.assign(block, blockOf([1, 0, 9], [2, 0, 9]));
  lanes.settle(block);
  assert.deepEqual(rowsOf(lanes, 1, 2), [0, 1]);
});

/** A timeline without a page, of a run of 100 s, 200 px wide. */
function timeline() {
  const app = { store: { start: 0, end: 100e9 }, player: { time: 50e9 }, redraw: () => {} };
  return Object.assign(Object.create(Timeline.prototype), { app, from: 0, until: 100e9, width: 200, whole: true });
}

test("a place on the timeline is an instant, and back", () => {
  const shown = timeline();
  assert.equal(shown.x(25e9), 50);
  assert.equal(shown.timeAt(50), 25e9);
});

test("zooming keeps the instant under the cursor where it is", () => {
  const shown = timeline();
  shown.zoom(0.5);
  assert.deepEqual([shown.from, shown.until, shown.whole], [25e9, 75e9, false]);
  shown.zoom(0.5, 25e9);
  assert.deepEqual([shown.from, shown.until], [25e9, 50e9]);
});

test("zooming out ends with the whole run, and stays inside it", () => {
  const shown = timeline();
  shown.window(90e9, 20e9);
  assert.deepEqual([shown.from, shown.until], [80e9, 100e9]);
  shown.zoom(100);
  assert.deepEqual([shown.from, shown.until, shown.whole], [0, 100e9, true]);
});

test("marks of the ruler are round, and far enough apart for their text", () => {
  assert.equal(step(100e9, 860), 10e9);
  assert.equal(step(100e9, 400), 50e9);
  assert.equal(step(10, 1000), 1e6);
});

const MISSION = {
  robots: [{ name: "Drone" }, { name: "REX" }],
  elements: [
    { topics: [["/found", "throw"]] },
    { topics: [["/found", "catch"]] },
    { topics: [["~/own", "catch"]] },
    { topics: [["/REX/own", "throw"]] },
  ],
};

/** Blocks in which elements were left: [time, robot, element]. */
const left = (...events) => [
  {
    data: {
      columns: {
        t: events.map(([t]) => t),
        r: events.map(([, r]) => r),
        e: events.map(([, , e]) => e),
        w: events.map(() => LEAVE),
      },
    },
  },
];

test("an arrow goes from the last throw to each robot that caught it, once", () => {
  const arrows = link(left([1, 0, 0], [2, 0, 0], [3, 1, 1], [4, 1, 1]), MISSION);
  assert.deepEqual(arrows, [{ from: 2, until: 3, sender: 0, receiver: 1, topic: "/found" }]);
});

test("in one instant the catch may be recorded before the throw", () => {
  assert.equal(link(left([3, 1, 1], [3, 0, 0]), MISSION).length, 1);
});

test("no arrow comes from a robot itself, long after the throw, or from what only began", () => {
  assert.deepEqual(link(left([1, 0, 0], [2, 0, 1]), MISSION), []);
  assert.deepEqual(link(left([1, 0, 0], [6e9, 1, 1]), MISSION), []);
  const [block] = left([1, 0, 0], [2, 1, 1]);
  block.data.columns.w[0] = ENTER;
  assert.deepEqual(link([block], MISSION), []);
});

test("a topic in the namespace of a robot is its own", () => {
  assert.equal(link(left([1, 0, 3], [2, 1, 2]), MISSION)[0].topic, "/REX/own");
});
