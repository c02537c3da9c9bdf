// Why tokens wait: what can end a circle of robots that wait for each other.

import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";
import { waysOut } from "../../fame/view/page/waits.js";

const MISSION = {
  robots: [{ name: "Carrier" }, { name: "Door" }],
  elements: [
    { id: "c", name: "door opens", tag: "intermediateCatchEvent" },
    { id: "d", name: "carrier comes", tag: "intermediateCatchEvent" },
    { id: "e", name: "Wait", tag: "subProcess", exits: ["late, a timer event"] },
  ],
};
const CARRIER = {
  e: 0,
  scope: 1,
  kind: "topic",
  text: "topic /open",
  topics: ["/open"],
  publishers: { "/open": ["/Door/fame_engine"] },
};
const DOOR = {
  e: 1,
  scope: 1,
  kind: "topic",
  text: "topic /come",
  topics: ["/come"],
  publishers: { "/come": ["/Carrier/fame_engine"] },
};

/** The ways out of the circle of both robots, whose tokens wait so. */
function ways(carrier, door = DOOR, openers = []) {
  const waits = new Map([carrier, door].map((wait, r) => [r, new Map([["1", wait]])]));
  return waysOut({ mission: MISSION }, { waits, openers: () => openers }, [0, 1]);
}

test("robots that only wait for each other have no way out", () => {
  assert.deepEqual(ways(CARRIER), []);
});

test("another publisher, and what is no message, is a way out", () => {
  assert.deepEqual(ways({ ...CARRIER, publishers: { "/open": ["/Door/fame_engine", "/operator"] } }), [
    "Carrier, door opens, for topic /open",
  ]);
  assert.deepEqual(ways(CARRIER, { ...DOOR, kind: "timer", text: "duration timer", topics: undefined }), [
    "Door, carrier comes, for duration timer",
  ]);
});

test("who is suspended may be resumed", () => {
  assert.deepEqual(ways({ ...CARRIER, suspended: true }), ["Carrier, door opens, for topic /open"]);
});

test("an event that listens around what waits is a way out, told once", () => {
  assert.deepEqual(ways(CARRIER, DOOR, [2, 2]), ["Carrier, late, a timer event", "Door, late, a timer event"]);
});
