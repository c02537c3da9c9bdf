// What tokens wait for, and why that does not come: who could send it, and what those wait for, to the end. The words
// are those of `fame status --why`: the server sends its sentences.

/**
 * @import {App} from "./main.js"
 * @import {Inspector} from "./inspector.js"
 * @import {State} from "./store.js"
 * @import {Wait} from "./types.js"
 */
import { duration, h } from "./dom.js";
import { nameOf } from "./roster.js";

const LIST = new Intl.ListFormat("en-GB");

/**
 * The robots, or other nodes, that publish on the topics that a token waits for.
 *
 * @param {Wait} wait
 */
const sendersOf = ({ topics = [], publishers = {} }) =>
  topics
    .flatMap((topic) => publishers[topic] ?? [])
    .map((node) => node.replace(/^\//, "").replace(/\/fame_engine$/, ""));

/**
 * What may move a robot of a circle although none of the others does.
 *
 * @param {App} app @param {State} state
 * @param {number[]} circle robots that wait for each other
 */
export function waysOut({ mission }, state, circle) {
  const { robots, elements } = mission;
  const names = circle.map((r) => robots[r].name);
  /** @param {Wait} wait */
  const isHeld = (wait) =>
    !wait.suspended && /^(topic|join)$/.test(wait.kind) && sendersOf(wait).every((node) => names.includes(node));
  const ways = circle.flatMap((r) =>
    [...(state.waits.get(r)?.values() ?? [])].flatMap((wait) => {
      const events = [...state.openers(r, wait.scope), wait.e].flatMap((e) => elements[e]?.exits ?? []);
      const own = isHeld(wait) ? [] : [`${nameOf({ mission }, wait.e)}, for ${wait.text}`];
      return [...own, ...events].map((way) => `${robots[r].name}, ${way}`);
    }),
  );
  return [...new Set(ways)];
}

export class Waits {
  /** @param {Inspector} inspector */
  constructor(inspector) {
    this.inspector = inspector;
    this.app = inspector.app;
  }

  /**
   * What the tokens of a robot wait for; empty if none waits.
   *
   * @param {State} state @param {number} r @param {number} time
   */
  of(state, r, time) {
    const rows = [...(state.waits.get(r)?.values() ?? [])];
    if (!rows.length) return [];
    return [
      h("h4", null, "Waits for"),
      h(
        "ul",
        { cls: "waits", dataset: { key: r } },
        rows.map((wait) => this.wait(state, r, wait, time)),
      ),
    ];
  }

  wait(state, r, wait, time) {
    const openers = state.openers(r, wait.scope);
    const since = time - wait.since;
    const topics = (wait.topics ?? []).map((topic) => this.publishers(topic, wait));
    return h(
      "li",
      { dataset: { key: `${r}/${wait.key}` } },
      h(
        "div",
        null,
        wait.e >= 0 ? this.inspector.element(wait.e, openers) : h("b", null, wait.element),
        wait.suspended ? h("em", null, "suspended") : null,
        h("span", { cls: "quiet" }, ` ${duration(Math.max(0, since))}`),
      ),
      h("div", { cls: "reason" }, wait.text),
      this.troubles(wait, time).map((text) => h("div", { cls: "why" }, text)),
      topics,
      this.lastMessages(wait, time),
      this.senders(state, wait, time, [r], new Set([r])),
      (wait.conditions ?? []).map((condition) => this.condition(state, r, wait, condition)),
      this.app.acts.buttons(r, wait),
    );
  }

  /** A condition that a token waits for, with the values of what it reads. */
  condition(state, r, wait, { text, reads = [] }) {
    const values = reads.map((name) => h("div", null, name, " = ", this.inspector.valueOf(state, r, wait.scope, name)));
    return h("div", { cls: "why" }, h("code", null, text), values);
  }

  /**
   * A sentence of the server, filled in.
   *
   * @param {string} name @param {Object<string, string>} [values]
   */
  sentence(name, values = {}) {
    const words = this.app.mission.sentences[name] ?? name;
    return words.replace(/\{(\w+)\}/g, (_, key) => values[key] ?? "");
  }

  /**
   * What is wrong with the server that a token has asked.
   *
   * @param {Wait} wait @param {number} time
   */
  troubles(wait, time) {
    const silences = /** @type {const} */ (["gone", "silent"]).flatMap((name) => {
      const since = wait[name];
      return since === undefined ? [] : [this.sentence(name, { time: duration(Math.max(0, time - since)) })];
    });
    return [...silences, ...(wait.mismatches ?? [])];
  }

  /** Who publishes on a topic that a token waits for. */
  publishers(topic, wait) {
    const nodes = wait.publishers?.[topic] ?? [];
    const by = nodes.length ? this.sentence("published", { nodes: nodes.join(", ") }) : this.sentence("unpublished");
    return h("div", { cls: "why" }, h("code", null, topic), ` ${by}`);
  }

  /**
   * What the robots do that publish what a token waits for, to the end: `path` are those that wait here, `told` all
   * that were told.
   */
  senders(state, wait, time, path, told) {
    const { robots } = this.app.mission;
    const found = [...new Set(sendersOf(wait).map((node) => robots.findIndex(({ name }) => node === name)))].filter(
      (r) => r >= 0,
    );
    const circles = found
      .filter((r) => path.includes(r))
      .map((r) => path.slice(path.indexOf(r)))
      .map((circle) =>
        h(
          "li",
          null,
          h("b", null, this.sentence("circle", { robots: LIST.format(circle.map((one) => robots[one].name)) })),
          `; ${this.endOf(state, circle)}`,
        ),
      );
    const rows = found.filter((r) => !told.has(r)).flatMap((r) => this.sender(state, r, time, path, told.add(r)));
    return circles.length + rows.length ? h("ul", { cls: "chain" }, rows, circles) : null;
  }

  endOf(state, circle) {
    const ways = waysOut(this.app, state, circle);
    return ways.length ? this.sentence("ways_out", { ways: ways.join("; ") }) : this.sentence("no_way_out");
  }

  sender(state, r, time, path, told) {
    const waits = [...(state.waits.get(r)?.values() ?? [])];
    const ended = this.inspector.status(state, r);
    if (!waits.length)
      return [h("li", null, this.inspector.robot(r), ended ? ` has ended: ${ended}` : ` ${this.sentence("at_work")}`)];
    return waits.map((wait) =>
      h(
        "li",
        null,
        this.inspector.robot(r),
        " waits at ",
        wait.e >= 0 ? this.inspector.element(wait.e, state.openers(r, wait.scope)) : wait.element,
        `, ${duration(Math.max(0, time - wait.since))}, `,
        wait.suspended ? `suspended by ${wait.by}` : [`for ${wait.text}`, ...this.troubles(wait, time)].join("; "),
        this.senders(state, wait, time, [...path, r], told),
      ),
    );
  }

  /** When the last message came that a token might have received, and why it did not count. */
  lastMessages(wait, time) {
    if (!wait.topics?.length) return null;
    if (wait.missed)
      return h(
        "div",
        { cls: "why" },
        "last message ",
        this.inspector.instant(wait.missed.time),
        ` ${this.sentence("missed", { why: wait.missed.why })}`,
      );
    const found = wait.topics.map((topic) => this.app.store.lastMessage(topic, time)).filter((one) => one !== null);
    if (!found.length) return h("div", { cls: "why" }, this.sentence("no_message"));
    return found.map(([at, topic, sender]) =>
      h(
        "div",
        { cls: "why" },
        "last message ",
        this.inspector.instant(at),
        wait.topics.length > 1 ? ` on ${topic}` : "",
        sender ? ` from ${sender}` : "",
        at < wait.since ? ", before this token waited: it does not count" : "",
      ),
    );
  }
}
