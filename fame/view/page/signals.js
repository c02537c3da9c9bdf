// Which signal of one robot woke which token of another: arrows of the timeline.

/**
 * @import {Block, LoadedBlock} from "./store.js"
 * @import {Mission} from "./types.js"
 *
 * @typedef {{from: number, until: number, sender: number, receiver: number, topic: string}} Arrow
 * @typedef {[time: number, r: number, topic: string, thrown: boolean]} Signal
 */
import { LEAVE } from "./store.js";

const LATEST = 5e9; // ns between a throw and the catch that it is the cause of

/**
 * A topic as one robot means it: `~/x` is its own.
 *
 * @param {string} topic @param {string | undefined} robot
 */
const full = (topic, robot) => (topic.startsWith("~/") ? `/${robot}/${topic.slice(2)}` : topic);

/**
 * Whether a block has events that `signalsOf` has not seen.
 *
 * @param {LoadedBlock} block
 */
export const signalsAreNew = (block) => block.signals?.length !== block.columns.t.length;

/**
 * The throws and catches in a block: [time, robot, topic, thrown].
 *
 * @param {LoadedBlock} block @param {Mission} mission
 * @returns {Signal[]}
 */
export function signalsOf(block, mission) {
  if (!signalsAreNew(block)) return block.signals.found;
  const { t, r, e, w } = block.columns;
  /** @type {Signal[]} */
  const found = [];
  for (let at = 0; at < t.length; at += 1) {
    if (w[at] !== LEAVE) continue;
    const topics = mission.elements[e[at]]?.topics;
    if (topics === undefined) continue;
    for (const [topic, direction] of topics)
      found.push([t[at], r[at], full(topic, mission.robots[r[at]]?.name), direction === "throw"]);
  }
  block.signals = { length: t.length, found };
  return found;
}

/**
 * Arrows from the last throw on a topic to each catch of it by another robot.
 *
 * @param {Block[]} blocks @param {Mission} mission
 */
export function link(blocks, mission) {
  /** @type {Map<string, {time: number, robot: number, received: Set<number>}>} */
  const last = new Map();
  /** @type {Arrow[]} */
  const arrows = [];
  for (const { data } of blocks) {
    if (!data) continue;
    const found = signalsOf(data, mission);
    for (let at = 0; at < found.length; at += 1) {
      const [time, robot, topic, thrown] = found[at];
      if (thrown) {
        last.set(topic, { time, robot, received: new Set() });
        continue;
      }
      // In one instant the catch may be recorded before the throw: robots are recorded one after the other.
      let cause = last.get(topic);
      for (let next = at + 1; next < found.length && found[next][0] === time; next += 1) {
        if (found[next][3] && found[next][2] === topic && found[next][1] !== robot)
          cause = { time, robot: found[next][1], received: new Set() };
      }
      if (cause === undefined || cause.robot === robot || time - cause.time > LATEST || cause.received.has(robot))
        continue;
      cause.received.add(robot);
      arrows.push({ from: cause.time, until: time, sender: cause.robot, receiver: robot, topic });
    }
  }
  return arrows;
}
