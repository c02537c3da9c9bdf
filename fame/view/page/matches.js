// What of a run has a text in it: names and values of variables, messages, log lines, errors and elements.

/**
 * @import {Element} from "./types.js"
 * @import {LoadedBlock} from "./store.js"
 *
 * @typedef {"element" | "variable" | "message" | "log"} Kind
 *
 * @typedef {object} Match what was found, once for all its times
 * @property {Kind} kind
 * @property {number} r robot, -1 for none
 * @property {string} name of the variable, topic or element; the line of a log
 * @property {any} value the first one, of a variable or message
 * @property {number} e element, -1 for none
 * @property {number[]} times in order
 */
import { ENTER, FAIL, TAKE, LOGGED, after } from "./store.js";

const FLOW = /flow|association/i;
const ORDER = ["element", "variable", "message", "log"];

/** @param {any} value */
const textOf = (value) => (typeof value === "string" ? value : (JSON.stringify(value) ?? ""));

/** Looks through blocks, in their order, for a text in which case does not matter. */
export class Matches {
  /** @param {string} text @param {Element[]} elements */
  constructor(text, elements) {
    this.text = text.toLowerCase();
    /** @type {Element[]} */
    this.elements = elements;
    /** @type {Map<string, Match>} by kind, robot and name */
    this.found = new Map();
    /** @type {Map<number, boolean>} whether an element has the text */
    this.known = new Map();
    for (const e of elements.keys()) if (this.isElement(e)) this.add("element", -1, this.nameOf(e), null, e);
  }

  /** @param {string} text */
  has(text) {
    return text.toLowerCase().includes(this.text);
  }

  /** @param {number} e */
  nameOf(e) {
    return this.elements[e]?.name || this.elements[e]?.id || "";
  }

  /** @param {number} e */
  isElement(e) {
    const known = this.known.get(e);
    if (known !== undefined) return known;
    const { id = "", name = "", doc = "", tag = "" } = this.elements[e] ?? {};
    const texts = FLOW.test(tag) ? [name] : [id, name, doc]; // ids of flows say what their ends are called
    const has = texts.some((text) => this.has(text));
    this.known.set(e, has);
    return has;
  }

  /**
   * @param {Kind} kind @param {number} r @param {string} name @param {any} value @param {number} e
   * @param {number} [time]
   */
  add(kind, r, name, value, e, time) {
    const key = kind === "element" ? `element/${e}` : `${kind}/${r}/${name}`;
    const match = this.found.get(key) ?? { kind, r, name, value, e, times: [] };
    this.found.set(key, match);
    if (time !== undefined && match.times.at(-1) !== time) match.times.push(time);
  }

  /** @param {LoadedBlock} block */
  look(block) {
    if (block.number === 0)
      for (const [r, , values] of block.key.variables)
        for (const [name, [value, since]] of Object.entries(values)) this.variable(since, r, name, value);
    for (const [time, r, , values] of block.variables)
      for (const name in values) this.variable(time, r, name, values[name]);
    for (const [time, topic, , content] of block.messages)
      if (this.has(topic) || this.has(textOf(content))) this.add("message", -1, topic, content, -1, time);
    for (let at = 0; at < block.columns.t.length; at += 1) this.event(block, at);
  }

  /** @param {number} time @param {number} r @param {string} name @param {any} value */
  variable(time, r, name, value) {
    if (this.has(name) || this.has(textOf(value))) this.add("variable", r, name, value, -1, time);
  }

  /** @param {LoadedBlock} block @param {number} at */
  event({ columns: { t, r, e, w }, details }, at) {
    if ((w[at] === ENTER || w[at] === TAKE) && this.isElement(e[at]))
      this.add("element", -1, this.nameOf(e[at]), null, e[at], t[at]);
    const word = LOGGED.get(w[at]);
    if (word === undefined) return;
    const where = w[at] === FAIL ? `${this.nameOf(e[at])}: ` : "";
    const line = [word, `${where}${details.get(at) ?? ""}`].filter(Boolean).join(" ");
    if (this.has(line)) this.add("log", r[at], line, null, e[at], t[at]);
  }

  /** What was found: elements, variables, messages, lines; each kind in the order of time, without times last. */
  get all() {
    const first = (/** @type {Match} */ { times }) => times[0] ?? Infinity;
    return [...this.found.values()].sort(
      (a, b) => ORDER.indexOf(a.kind) - ORDER.indexOf(b.kind) || first(a) - first(b) || 0,
    );
  }
}

/**
 * The time before or after an instant (`step` -1 or 1) of the nearest of some times, which are in order.
 *
 * @param {number[]} times @param {number} time @param {1 | -1} step
 * @returns {number | undefined}
 */
export function nearest(times, time, step) {
  return times[step > 0 ? after(times, time) : after(times, time - 1) - 1];
}
