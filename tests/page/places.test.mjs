// Where the tokens of a run are in the diagram of the editor.

import assert from "node:assert/strict";
import { test } from "node:test";

import { places } from "../../fame/edit/page/places.js";

const MISSION = {
  models: ["m.bpmn", "library.bpmn", "m.bpmn"],
  elements: [
    { id: "Call", file: 0 },
    { id: "Inside", file: 1 },
    { id: "Gone", file: 0 },
    { id: "Call", file: 2 }, // of the changed model, which robot 2 has
  ],
};
const token = (r, e, s = 1) => [`${r}/${e}/${s}`, { r, e, s }];
const state = (...tokens) => ({ tokens: new Map(tokens), openers: (r, s) => (s > 1 ? [s === 2 ? 0 : 3] : []) });
const found = (...tokens) =>
  [...places(MISSION, state(...tokens), (id) => id !== "Gone")].map(([id, robots]) => [id, ...robots]);

test("what is inside of a called process is at the call, once for each robot", () => {
  assert.deepEqual(found(token(0, 0), token(0, 1, 2), token(1, 1, 2)), [["Call", 0, 1]]);
});

test("an element of a changed model is where the one of before is", () => {
  assert.deepEqual(found(token(0, 0), token(2, 3), token(2, 1, 3)), [["Call", 0, 2]]);
});

test("what is not drawn any more is nowhere, and so is what is not known yet", () => {
  assert.deepEqual(found(token(0, 2), token(0, 9)), []);
});
