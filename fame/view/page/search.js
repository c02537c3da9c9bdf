// The search of the inspector: a text in the whole run, and ways to each instant and element that has it.

/** @import {App} from "./main.js" */
/** @import {Match} from "./matches.js" */
import { brief, clock, h, icon, swatch } from "./dom.js";
import { Matches, nearest } from "./matches.js";

const WAIT = 200; // ms after the last letter
const MOST = 200; // matches that are listed
const AGAIN = 2000; // ms until what has come since is searched, too
const HEADINGS = { element: "Elements", variable: "Variables", message: "Messages", log: "Log" };
const NODE = /event|task|gateway|subProcess|callActivity|transaction/i;
const FREE = "A part of a name, a value, a message or a line of the log; upper and lower case are the same.";

export class Search {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    this.text = "";
    /** @type {Match[]} */
    this.all = [];
    this.turn = 0; // of the search that counts
    this.part = 1; // of the blocks that were searched
    this.state = ""; // of the run, when it was searched
    this.last = -Infinity;
    this.input = h("input", {
      type: "search",
      cls: "query",
      placeholder: "Search the run",
      "aria-label": "Search the run",
      autocomplete: "off",
      spellcheck: "false",
      oninput: () => this.typed(),
      onkeydown: (event) => this.key(event),
    });
    // stays in its place: what is moved loses the focus
    const steps = this.steps(() => this.times());
    this.head = h("div", { cls: "row searching", dataset: { key: "query" } }, this.input, ...steps);
  }

  typed() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.find(this.input.value.trim()), WAIT);
  }

  async key(event) {
    if (event.key === "Escape") this.input.blur();
    if (event.key !== "Enter") return;
    event.preventDefault();
    const text = this.input.value.trim();
    if (text !== this.text) await this.find(text);
    this.go(this.times(), event.shiftKey ? -1 : 1);
  }

  /** What of the run there is to search. */
  stateOf() {
    const { blocks, end } = this.app.store;
    return `${end} ${blocks.reduce((sum, block) => sum + block.events, 0)}`;
  }

  /** Search all blocks for a text; what was found for another one is forgotten. */
  async find(text) {
    clearTimeout(this.timer);
    this.turn += 1;
    const mine = this.turn;
    const again = text === this.text;
    const { store, mission } = this.app;
    const matches = text ? new Matches(text, mission.elements) : null;
    Object.assign(this, { text, part: again ? 1 : 0, state: this.stateOf() });
    if (!again) this.all = matches?.all ?? [];
    for (let number = 0; matches && number < store.blocks.length; number += 1) {
      const { data } = (await store.want(number).catch(() => null)) ?? {};
      if (mine !== this.turn) return;
      if (data) matches.look(data);
      if (!again) Object.assign(this, { all: matches.all, part: (number + 1) / store.blocks.length });
      this.app.soon();
    }
    Object.assign(this, { all: matches?.all ?? [], part: 1, last: performance.now() });
    this.app.redraw();
  }

  /** Search what has come since, a while after the last search. */
  follow() {
    if (!this.text || this.part < 1 || this.state === this.stateOf()) return;
    if (performance.now() - this.last > AGAIN) this.find(this.text);
    else this.app.soon(AGAIN);
  }

  /** What the list depends on. */
  get version() {
    return `${this.turn} ${this.part} ${this.all.length}`;
  }

  /** The times of all that is listed, in order. */
  times() {
    return [...new Set(this.shown().flatMap(({ times }) => times))].sort((a, b) => a - b);
  }

  /** What was found, of the chosen robot. */
  shown() {
    const { robot } = this.app.selected;
    return this.all.filter(({ r }) => r < 0 || robot < 0 || r === robot);
  }

  /** Move the cursor to the nearest of some times before or after it. */
  go(times, step) {
    const found = nearest(times, this.app.player.time, step);
    if (found !== undefined) this.app.player.seek(found);
  }

  view() {
    this.follow();
    const shown = this.shown();
    return [
      this.head,
      h("h3", { cls: "unseen" }, "Found"),
      h("p", { cls: "quiet", role: "status" }, this.said(shown)),
      Object.entries(HEADINGS).flatMap(([kind, heading]) => {
        const some = shown.slice(0, MOST).filter((match) => match.kind === kind);
        if (!some.length) return [];
        const rows = some.map((match) => this.row(match));
        return [
          h("h4", { dataset: { key: kind } }, heading),
          h("ol", { cls: "log matches", dataset: { key: kind } }, rows),
        ];
      }),
    ];
  }

  said(shown) {
    if (!this.text) return FREE;
    if (this.part < 1) return `${shown.length} found, ${Math.round(100 * this.part)} % of the run searched`;
    const more = shown.length > MOST ? `, the first ${MOST} are listed` : "";
    return shown.length ? `${shown.length} found${more}` : `Nothing in this run has “${this.text}”.`;
  }

  /** Buttons to the match before and the one after the cursor. */
  steps(times, name = "") {
    const button = (picture, title, step) =>
      h("button", { title: `${title} ${name}`.trim(), onclick: () => this.go(times(), step) }, icon(picture));
    return [button("back", "Previous match", -1), button("forth", "Next match", 1)];
  }

  /** @param {Match} match */
  row({ kind, r, name, value, e, times }) {
    const { player } = this.app;
    const [first] = times;
    const go = () => player.seek(first);
    const when = () => h("button", { cls: "when", title: "Go there", onclick: go }, clock(first));
    const link = () => this.app.goTo(this.app.selected.robot, e);
    return h(
      "li",
      { dataset: { key: `${kind}/${r}/${kind === "element" ? e : name}` } },
      first === undefined ? null : when(),
      r >= 0 ? swatch(r) : null,
      h(
        "span",
        { cls: "line" },
        kind === "element" ? h("button", { cls: "link", onclick: link }, name) : h("b", null, name),
        value === null ? null : [" ", h("code", null, brief(value, 60))],
        first === undefined && NODE.test(this.app.mission.elements[e]?.tag) ? " never reached" : null,
      ),
      times.length > 1 ? [h("span", { cls: "quiet" }, `×${times.length}`), ...this.steps(() => times, name)] : null,
    );
  }
}
