// What a robot does, in the words of the diagram.

import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";
import { blindness, doing } from "../../fame/view/page/roster.js";

const ELEMENTS = [
  { id: "Gateway_1", tag: "eventBasedGateway" },
  { id: "Gateway_2", tag: "parallelGateway", name: "all there" },
  { id: "Event_1", tag: "intermediateCatchEvent", topics: [["done", "catch"]] },
  { id: "Task_1", tag: "userTask", name: "Load" },
];

/** What a robot does with tokens at these elements, of which some wait: [element, for what]. */
function said(...tokens) {
  const waits = tokens
    .filter(([, text]) => text)
    .map(([e, text]) => ({ key: `${e}`, e, scope: 1, kind: "topic", text }));
  const state = {
    tokens: new Map(tokens.map(([e], at) => [at, { r: 0, i: 1, s: 1, e, n: 1, since: at }])),
    waits: new Map([[0, new Map(waits.map((wait) => [wait.key, wait]))]]),
    poses: new Map(),
    openers: () => [],
    visible: () => [],
  };
  return doing({ mission: { elements: ELEMENTS, robots: [{ name: "Arm" }] } }, state, 0);
}

test("a robot at a gateway without a name says what it waits for, its own topics without its name", () => {
  assert.equal(said([0, "topic /Arm/joint_trajectory or timer"]), "Waits: joint_trajectory or timer");
  assert.equal(said([0, "topic /free or timer"]), "Waits: free or timer");
});

test("the name of a gateway says it better, and an activity or event better still", () => {
  assert.equal(said([1, "2 of 3 tokens"]), "Waits: all there");
  assert.equal(said([1, "2 of 3 tokens"], [2, "topic /done"]), "Waits: done");
  assert.equal(said([1, "2 of 3 tokens"], [3, ""]), "Load");
});

test("a token that passes a gateway is not waited for", () => {
  assert.equal(said([0, ""]), "");
});

test("a robot whose monitor cannot judge says why, as long as the monitor runs", () => {
  const app = { mission: { elements: [{ id: "Unit", tag: "serviceTask" }, ...ELEMENTS] } };
  const of = (values) => ({ valueOf: (r, s, name) => (name === "monitor_blind" ? values[s] : undefined) });
  const tokens = [1, 2].map((s) => ({ r: 0, s, e: 0 }));
  const silent = "/Arm/joint_states: no message for 2 s";
  assert.equal(blindness(app, of({ 1: "", 2: silent }), { r: 0, tokens }), silent);
  assert.equal(blindness(app, of({ 1: "" }), { r: 0, tokens }), "");
  assert.equal(blindness(app, of({ 2: silent }), { r: 0, tokens: [{ r: 0, s: 2, e: 1 }] }), "");
});
