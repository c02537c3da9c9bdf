// Names in a diagram at any zoom.

import assert from "node:assert/strict";
import { test } from "node:test";

import { Node } from "./page.mjs";
import { Names, cut, overlap } from "../../fame/view/page/names.js";

test("boxes that only touch have nothing in common", () => {
  assert.ok(overlap([0, 0, 10, 10], [9, 9, 10, 10]));
  assert.ok(!overlap([0, 0, 10, 10], [10, 0, 10, 10]));
  assert.ok(!overlap([0, 0, 10, 10], [0, 11, 10, 10]));
});

test("a text that is too long is cut, and left out if what remains says nothing", () => {
  assert.equal(cut("Explore", 7 * 6, 10), "Explore");
  assert.equal(cut("Explore the field", 9 * 6, 10), "Explore…");
  assert.equal(cut("Explore", 3 * 6, 10), "");
});

/** A plane with shapes [x, y, width, height], each with its name, of 10 px; a `halo` is a name below its shape. */
function planeOf(...shapes) {
  const texts = shapes.map(({ name, box: [x, y, width, height], halo = false, room = y + height / 2 }) => {
    const line = new Node("tspan", { x: String(x + width / 2), y: String(halo ? y + height + 12 : room) }, [name]);
    return new Node("text", { "font-size": "10", ...(halo ? { "paint-order": "stroke" } : {}) }, [line]);
  });
  const groups = new Map(texts.map((text, number) => [number, new Node("g", {}, [text])]));
  for (const [number, group] of groups) group.dataset.element = String(number);
  const names = new Names({
    drawing: new Node("g", {}, [...groups.values()]),
    groups,
    shapes: new Map(shapes.map(({ box }, number) => [number, box])),
    shift: [0, 0],
    pins: { frames: [] },
  });
  return { names, texts, shown: () => texts.map((text) => (text.hasAttribute("hidden") ? null : text.textContent)) };
}

const TASK = { name: "Explore the field", box: [0, 0, 100, 80] };

test("at the size of the drawing names are as drawn", () => {
  const { names, texts, shown } = planeOf(TASK);
  names.fit(1);
  assert.deepEqual(shown(), ["Explore the field"]);
  assert.equal(texts[0].getAttribute("font-size"), "10");
});

test("a name never has less than 9 px: it grows as the drawing shrinks, and is broken into lines", () => {
  const { names, texts } = planeOf(TASK);
  names.fit(0.5);
  assert.equal(texts[0].getAttribute("font-size"), "18");
  assert.deepEqual(
    texts[0].childNodes.map((line) => line.textContent),
    ["Explore", "the", "field"],
  );
});

test("of a name that has no room as much is shown as says something, then nothing", () => {
  const { names, shown } = planeOf(TASK);
  names.fit(0.3);
  assert.deepEqual(shown(), ["Expl…the …"]);
  names.fit(0.1);
  assert.deepEqual(shown(), [null]);
  names.fit(1);
  assert.deepEqual(shown(), ["Explore the field"]);
});

test("with names cut short no shape is left without letters", () => {
  const { names, texts, shown } = planeOf(TASK);
  names.fit(0.15, true);
  assert.deepEqual(shown(), ["Ex"]);
  assert.equal(texts[0].getAttribute("font-size"), "60");
  names.fit(0.15, false);
  assert.deepEqual(shown(), [null]);
});

test("a name beside its shape is not laid on another one, nor grows without end", () => {
  const event = (x) => ({ name: "found", box: [x, 0, 36, 36], halo: true });
  const { names, texts, shown } = planeOf(event(0), event(20));
  names.fit(1);
  const boxes = names.names.map(({ node, at }) => [Number(node.childNodes[0].getAttribute("x")), at[1]]);
  assert.deepEqual(shown(), ["found", "found"]);
  assert.notDeepEqual(boxes[0][0], boxes[1][0]);
  names.fit(0.3);
  assert.deepEqual(shown(), [null, null]);
  assert.equal(texts.length, 2);
});

test("shapes of a few pixels are dots", () => {
  const { names } = planeOf(TASK);
  const [[group]] = names.shapes;
  names.fit(0.05);
  assert.ok(group.classList.contains("dot"));
  names.fit(1);
  assert.ok(!group.classList.contains("dot"));
});
