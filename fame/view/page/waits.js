// What tokens wait for, and why that does not come: who could send it, and what those wait for, to the end. The words
// are those of `fame status --why`: the server sends its sentences.

/**
 * @import {Inspector} from "./inspector.js"
 * @import {State} from "./store.js"
 * @import {Wait} from "./types.js"
 */
import { duration, h } from "./dom.js";

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
      this.chain(state, r, wait, time),
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

  /** What the robots do that publish what a token of `r` waits for, to the end. */
  chain(state, r, wait, time) {
    const rows = this.senders(state, wait, time, new Set([r]));
    const circle = wait.senders ? state.circles.get(r) : "";
    const last = circle ? h("li", null, h("b", null, circle)) : null;
    return rows.length || last ? h("ul", { cls: "chain" }, rows, last) : null;
  }

  /** A row for each robot that publishes what a token waits for; `told` are those that have one. */
  senders(state, { senders = {} }, time, told) {
    const { robots } = this.app.mission;
    return Object.entries(senders)
      .map(([name, topic]) => [robots.findIndex((robot) => robot.name === name), topic])
      .flatMap(([r, topic]) => (r < 0 || told.has(r) ? [] : this.sender(state, r, topic, time, told.add(r))));
  }

  sender(state, r, topic, time, told) {
    const waits = [...(state.waits.get(r)?.values() ?? [])];
    const idle = this.inspector.status(state, r) ? this.sentence("ended", { topic }) : this.sentence("at_work");
    if (!waits.length) return [h("li", null, this.inspector.robot(r), ` ${idle}`)];
    return waits.map((wait) => {
      const rows = this.senders(state, wait, time, told);
      return h(
        "li",
        null,
        this.inspector.robot(r),
        " waits at ",
        wait.e >= 0 ? this.inspector.element(wait.e, state.openers(r, wait.scope)) : wait.element,
        `, ${duration(Math.max(0, time - wait.since))}, `,
        wait.suspended
          ? this.sentence("suspended", { by: wait.by })
          : [`for ${wait.text}`, ...this.troubles(wait, time)].join("; "),
        rows.length ? h("ul", { cls: "chain" }, rows) : null,
      );
    });
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
        at < wait.since ? this.sentence("early") : "",
      ),
    );
  }
}
