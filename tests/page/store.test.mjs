// Blocks, and the state of a run at any instant.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import * as store from "../../fame/view/page/store.js";

const { Store, after, spansOf, CANCEL, FAIL, LEAVE } = store;
const LISTS = ["scopes", "variables", "waits", "circles", "messages", "poses", "world", "properties"];
const NOTHING = Object.fromEntries([...LISTS.slice(0, 6), "tokens", "counts", "ends"].map((name) => [name, []]));
const EMPTY = { ...NOTHING, world: {} };
const { kinds, cases } = JSON.parse(readFileSync(new URL("state_cases.json", import.meta.url), "utf-8"));

/** A block as the server sends it: events are [time, robot, instance, scope, element, kind, detail]. */
function blockOf(events = [], { key = {}, number = 0, start = 0, end, ...lists } = {}) {
  const data = { number, start, first: 0, at: Object.fromEntries(LISTS.map((name) => [name, 0])), d: {} };
  ["t", "r", "i", "s", "e"].forEach((name, column) => (data[name] = events.map((event) => event[column])));
  data.w = events.map((event) => kinds.indexOf(event[5]));
  events.forEach((event, at) => event[6] !== undefined && (data.d[at] = event[6]));
  for (const name of LISTS) data[name] = lists[name] ?? [];
  return { ...data, key: { ...EMPTY, ...key }, end: end ?? Math.max(start, ...data.t) };
}

/** A store that has these blocks. */
function storeOf(...blocks) {
  const made = new Store((number) => Promise.resolve(blocks[number]));
  made.index(
    blocks.map(({ number, start, end, t }) => [number, start, end, t.length]),
    blocks.at(-1).end,
  );
  for (const block of blocks) made.add(block);
  return made;
}

/** A state as the rows of the cases, without what is empty. */
function rowsOf(state) {
  const rows = {
    tokens: [...state.tokens.values()].map(({ r, i, s, e, n, since }) => [r, i, s, e, n, since]),
    counts: [...state.counts].map(([key, counts]) => [...store.counted(key), ...counts]),
    ends: [...state.ends].map(([r, ends]) => [r, ...ends]),
    variables: [...state.variables.values()].map(({ r, s, values }) => [r, s, Object.fromEntries(values)]),
    waits: [...state.waits].map(([r, tokens]) => [r, [...tokens.values()]]),
  };
  rows.counts = rows.counts.filter(([, , ...counts]) => counts.some(Boolean));
  return Object.fromEntries(Object.entries(rows).filter(([, found]) => found.length));
}

for (const { says, events, key, variables, waits, state } of cases)
  test(says, () => {
    const known = storeOf(blockOf(events, { key, variables, waits, end: 10 }));
    assert.deepEqual(rowsOf(known.stateAt(10)), state);
  });

test("kinds of events have the numbers that the server sends", () => {
  assert.deepEqual(
    kinds.map((kind) => store[kind.toUpperCase()]),
    [...kinds.keys()],
  );
});

test("after: the first place above a time", () => {
  assert.equal(after([], 3), 0);
  assert.equal(after([1, 3, 3, 5], 3), 3);
  assert.equal(
    after([{ at: 1 }, { at: 4 }], 0, ({ at }) => at),
    0,
  );
});

test("a state moves forward within its block, and is made again to move backward", () => {
  const known = storeOf(
    blockOf([
      [1, 0, 1, 1, 5, "enter"],
      [4, 0, 1, 1, 5, "leave"],
    ]),
  );
  const early = known.stateAt(2);
  assert.equal(early.tokens.size, 1);
  assert.equal(known.stateAt(5), early);
  assert.equal(early.tokens.size, 0);
  const again = known.stateAt(3);
  assert.notEqual(again, early);
  assert.equal(again.tokens.size, 1);
});

test("what is new in a block is added once, also if some of it is known", () => {
  const events = [
    [1, 0, 1, 1, 5, "enter"],
    [2, 0, 1, 1, 5, "leave"],
    [3, 0, 1, 1, 6, "enter"],
  ];
  const known = storeOf(blockOf(events.slice(0, 2)));
  const { key, ...rest } = blockOf(events);
  assert.ok(key);
  known.add({
    ...rest,
    first: 1,
    ...Object.fromEntries("trisew".split("").map((name) => [name, rest[name].slice(1)])),
  });
  assert.deepEqual(known.blocks[0].data.columns.t, [1, 2, 3]);
  assert.equal(known.end, 3);
  assert.equal(known.stateAt(3).tokens.size, 1);
});

test("a block is loaded again if something between is missing", async () => {
  const whole = blockOf([
    [1, 0, 1, 1, 5, "enter"],
    [2, 0, 1, 1, 5, "leave"],
  ]);
  const known = storeOf(blockOf([[1, 0, 1, 1, 5, "enter"]]));
  known.load = () => Promise.resolve(whole);
  const { key, ...news } = { ...blockOf([[9, 0, 1, 1, 5, "enter"]]), first: 7 };
  assert.ok(key);
  known.add(news);
  assert.equal(known.blocks[0].data, null);
  await known.want(0);
  assert.deepEqual(known.blocks[0].data.columns.t, [1, 2]);
});

test("a state is null until its block has come, which is asked for once", async () => {
  const asked = [];
  const known = new Store((number) => (asked.push(number), Promise.resolve(blockOf([[1, 0, 1, 1, 5, "enter"]]))));
  const changed = new Promise((done) => known.onchange(done));
  known.index([[0, 0, 1, 1]], 1);
  assert.equal(known.stateAt(1), null);
  assert.equal(known.stateAt(1), null);
  assert.equal(await changed, 0);
  assert.deepEqual(asked, [0]);
  assert.equal(known.stateAt(1).tokens.size, 1);
});

test("an instant that the server has not read yet has a block of its own", async () => {
  const known = new Store(
    () => assert.fail("there is no such block"),
    () => Promise.resolve({ ...blockOf([[50, 0, 1, 1, 5, "enter"]], { number: -1, start: 50 }), until: 60 }),
  );
  known.complete = false;
  const changed = new Promise((done) => known.onchange(done));
  assert.equal(known.stateAt(55), null);
  assert.equal(await changed, -1);
  assert.equal(known.stateAt(55).tokens.size, 1);
  assert.equal(known.stateAt(70), null);
});

test("an event is found forward and backward, over blocks", async () => {
  const known = storeOf(
    blockOf([
      [1, 0, 1, 1, 5, "enter"],
      [2, 0, 1, 1, 5, "leave"],
    ]),
    blockOf([[8, 0, 1, 1, 6, "enter"]], { number: 1, start: 8 }),
  );
  const isEnter = ({ columns }, at) => columns.w[at] === store.ENTER;
  assert.equal(await known.find(1, 1, isEnter), 8);
  assert.equal(await known.find(8, -1, isEnter), 1);
  assert.equal(await known.find(8, 1, isEnter), null);
});

test("the last message on a topic is that until an instant, in any block before", () => {
  const known = storeOf(
    blockOf([], {
      end: 5,
      messages: [
        [1, "/a", "REX", 1],
        [3, "/a", "REX", 2],
        [3, "/b", "REX", 3],
      ],
    }),
    blockOf([], { number: 1, start: 8, messages: [[9, "/b", "REX", 4]], end: 9 }),
  );
  assert.deepEqual(known.lastMessage("/a", 9), [3, "/a", "REX", 2]);
  assert.deepEqual(known.lastMessage("/b", 8), [3, "/b", "REX", 3]);
  assert.equal(known.lastMessage("/a", 0), null);
  assert.equal(known.lastMessage("/c", 9), null);
});

test("a scope sees its own variables, then those around it; its openers are outermost first", () => {
  const scopes = [
    [0, 1, 1, -1, [], 0],
    [0, 2, 1, 1, [30], 1],
    [0, 3, 1, 2, [40, 50], 3],
  ];
  const variables = [
    [1, 0, 1, { x: "outer", y: 1 }, []],
    [1, 0, 3, { x: "inner" }, []],
  ];
  const state = storeOf(blockOf([], { key: { scopes }, variables, end: 2 })).stateAt(2);
  assert.deepEqual(
    [...state.visible(0, 3)],
    [
      ["x", "inner"],
      ["x", "outer"],
      ["y", 1],
    ],
  );
  assert.equal(state.valueOf(0, 3, "x"), "inner");
  assert.equal(state.valueOf(0, 2, "x"), "outer");
  assert.equal(state.valueOf(0, 2, "z"), undefined);
  assert.deepEqual(state.openers(0, 3), [30, 40, 50]);
  assert.deepEqual(state.openers(0, 1), []);
});

test("bars are executions: of one place the oldest ends first, what runs at the end is open", () => {
  const { data } = storeOf(
    blockOf(
      [
        [1, 0, 1, 2, 5, "enter"],
        [2, 0, 1, 2, 5, "enter"],
        [3, 0, 1, 2, 5, "leave"],
        [4, 0, 1, 2, 6, "enter"],
        [5, 0, 1, 2, 6, "fail"],
      ],
      { scopes: [[0, 2, 1, 1, [30], 3]] },
    ),
  ).blocks[0];
  const bars = spansOf(data).map(({ e, from, until, how, depth }) => [e, from, until, how, depth]);
  assert.deepEqual(bars, [
    [5, 1, 3, LEAVE, 3],
    [5, 2, Infinity, -1, 3],
    [6, 4, 5, FAIL, 3],
  ]);
});

test("bars of what a key tells begin before the block; the end of their instance cancels them", () => {
  const key = {
    tokens: [
      [0, 1, 1, 5, 2, 3],
      [0, 2, 1, 5, 1, 4],
    ],
  };
  const { data } = storeOf(blockOf([[9, 0, 1, 0, 0, "end", "completed"]], { key, start: 8 })).blocks[0];
  const bars = spansOf(data).map(({ i, from, until, how }) => [i, from, until, how]);
  assert.deepEqual(bars, [
    [1, 3, 9, CANCEL],
    [1, 3, 9, CANCEL],
    [2, 4, Infinity, -1],
  ]);
});

test("robots wait for each other from one change of a circle to the next", () => {
  const circles = [
    [4, 0, "A and B wait for each other"],
    [6, 1, ""],
  ];
  const made = storeOf(blockOf([], { key: { circles: [[1, "B and C wait for each other"]] }, circles, end: 9 }));
  const at = (time) => [0, 1].map((r) => made.stateAt(time).circles.get(r) ?? "");
  assert.deepEqual(at(3), ["", "B and C wait for each other"]);
  assert.deepEqual(at(5), ["A and B wait for each other", "B and C wait for each other"]);
  assert.deepEqual(at(7), ["A and B wait for each other", ""]);
});
