// The search: what of a run has a text.

import assert from "node:assert/strict";
import { test } from "node:test";

import { Matches, nearest } from "../../fame/view/page/matches.js";
import * as store from "../../fame/view/page/store.js";

const ELEMENTS = [
  { id: "Activity_1", name: "Find Weed", tag: "task" },
  { id: "Flow_Weed", tag: "sequenceFlow" },
  { id: "Event_weed", tag: "endEvent", doc: "" },
  { id: "Activity_2", name: "Drive", tag: "task", doc: "to the next weed" },
];
const KEY = { variables: [[0, 1, { weeds: [3, 2] }]] };

/** A block of these events: [time, robot, element, kind, detail]. */
function block(events = [], { number = 0, variables = [], messages = [] } = {}) {
  const column = (at) => events.map((event) => event[at]);
  const columns = { t: column(0), r: column(1), i: column(1), s: column(1), e: column(2), w: column(3) };
  const details = new Map(events.flatMap((event, at) => (event[4] === undefined ? [] : [[at, event[4]]])));
  return { number, key: KEY, columns, details, variables, messages };
}

/** What a search finds: [kind, robot, name, times]. */
function found(text, ...blocks) {
  const matches = new Matches(text, ELEMENTS);
  for (const one of blocks) matches.look(one);
  return matches.all.map(({ kind, r, name, times }) => [kind, r, name, times]);
}

test("an element is found by its name, id and documentation, with the times at which it began", () => {
  const events = [
    [5, 0, 0, store.ENTER],
    [6, 0, 0, store.LEAVE],
    [7, 1, 0, store.ENTER],
    [8, 1, 1, store.TAKE],
  ];
  assert.deepEqual(found("WEED", block(events)).slice(0, 3), [
    ["element", -1, "Find Weed", [5, 7]],
    ["element", -1, "Event_weed", []],
    ["element", -1, "Drive", []],
  ]);
});

test("a variable is found by its name and by what is in its value, of each robot by itself", () => {
  const rows = [
    [4, 0, 1, { x: { kind: "dock" }, y: 1 }, []],
    [5, 1, 1, { x: "Dock", dock: null }, []],
    [6, 1, 1, null, []],
  ];
  assert.deepEqual(found("dock", block([], { variables: rows })), [
    ["variable", 0, "x", [4]],
    ["variable", 1, "x", [5]],
    ["variable", 1, "dock", [5]],
  ]);
});

test("what was set before the run has a time, and is not found again in later blocks", () => {
  assert.deepEqual(found("weeds", block(), block([], { number: 1 })), [["variable", 0, "weeds", [2]]]);
});

test("a message is found by its topic and by its content", () => {
  const messages = [
    [1, "/bid", "A", { data: 2 }],
    [2, "/won", "B", { data: "bid" }],
    [3, "/lost", "B", {}],
  ];
  assert.deepEqual(found("bid", block([], { messages })), [
    ["message", -1, "/bid", [1]],
    ["message", -1, "/won", [2]],
  ]);
});

test("a line of the log is found once for all its times, an error with the element where it was raised", () => {
  const events = [
    [1, 0, -1, store.LOG, "no path"],
    [2, 0, -1, store.LOG, "no path"],
    [3, 1, 3, store.FAIL, "no path"],
    [4, 1, -1, store.END, "failed"],
  ];
  assert.deepEqual(found("no PATH", block(events)), [
    ["log", 0, "no path", [1, 2]],
    ["log", 1, "failed Drive: no path", [3]],
  ]);
});

test("the nearest of some times is before or after the cursor, never at it", () => {
  assert.deepEqual(
    [0, 5, 7, 9].map((time) => [nearest([5, 9], time, -1), nearest([5, 9], time, 1)]),
    [
      [undefined, 5],
      [undefined, 9],
      [5, 9],
      [5, undefined],
    ],
  );
});
