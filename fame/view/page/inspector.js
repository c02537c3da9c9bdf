// The inspector: of the chosen robot (or all) at the cursor, what its tokens wait for, its variables, its messages
// and log.

/** @import {App} from "./main.js" */
/** @import {Element, MessageRow} from "./types.js" */
import { brief, h, icon, clock, isDark, renew, swatch } from "./dom.js";
import { Search } from "./search.js";
import { Waits } from "./waits.js";
import { startOf } from "./roster.js";
import { FAIL, REPORT, END, LOGGED, after, counted } from "./store.js";

const TABS = [
  ["state", "State"],
  ["topics", "Messages"],
  ["log", "Log"],
  ["search", "Search"],
];
const RECENT = 2e9; // ns for which what is new is marked
const LINES = 200;
const PAUSE = 90; // ms until it is shown again: a few times a second is as much as anybody reads
const SLICE = 4; // ms of a frame for what is out of sight

/** The numbers inside a value: paths that can be plotted. */
function numbers(value, path = [], found = [], depth = 3) {
  if (typeof value === "number" || typeof value === "boolean") found.push(path);
  else if (depth > 0 && value !== null && typeof value === "object" && !("$cut" in value)) {
    for (const [key, inner] of Object.entries(value))
      if (found.length < 12) numbers(inner, [...path, key], found, depth - 1);
  }
  return found;
}

export class Inspector {
  /** @param {HTMLElement} root @param {App} app */
  constructor(root, app) {
    this.app = app;
    this.root = root;
    this.tab = "state";
    this.waits = new Waits(this);
    this.search = new Search(app);
    this.robots = h("div", { cls: "robots", role: "group", "aria-label": "Robots" });
    this.tabs = h(
      "div",
      { cls: "tabs", role: "tablist" },
      TABS.map(([name, text]) => this.tabButton(name, text)),
    );
    this.body = h("div", { cls: "body", tabindex: 0 });
    root.append(h("h2", { cls: "unseen" }, "Inspector"), h("div", { cls: "bar" }, this.tabs, this.robots), this.body);
    this.opened = new Set();
    this.pause = PAUSE;
    this.last = -Infinity; // when it was shown (ms)
    this.shown = undefined; // the instant that can be seen
    this.parts = new Map(); // robot -> its section, where all are shown
    this.stale = new Set(); // robots whose section shows another instant
    this.hidden = new Set(); // sections out of sight
    this.sight = new IntersectionObserver(
      (changes) => {
        for (const { target, isIntersecting } of changes) this.hidden[isIntersecting ? "delete" : "add"](target);
        if (this.stale.size) app.redraw();
      },
      { root: this.body },
    );
  }

  tabButton(name, text) {
    const selected = String(name === this.tab);
    const action = () => this.choose(name);
    return h("button", { role: "tab", dataset: { tab: name }, "aria-selected": selected, onclick: action }, text);
  }

  /**
   * Lay out a variable that nobody sees: the browser looks for fonts when it first needs them, and the first jump would
   * wait.
   */
  warm() {
    const sample = h(
      "div",
      { cls: "sample", "aria-hidden": "true" },
      h("h4", null, "Variables"),
      h("table", { cls: "variables" }, h("tbody", null, this.variable(-1, 0, "x", 0, 1, 2))),
    );
    this.root.append(sample);
    sample.getBoundingClientRect();
    sample.remove();
  }

  /** Show what is next without a pause. */
  hurry() {
    this.last = -Infinity;
  }

  choose(tab) {
    this.tab = tab;
    for (const button of this.tabs.children) button.setAttribute("aria-selected", String(button.dataset.tab === tab));
    this.key = "";
    this.app.redraw();
  }

  /** Show the search, and write there. */
  openSearch() {
    if (!this.app.tabs.shows("log")) this.app.tabs.choose("log");
    this.choose("search");
    renew(this.body, this.search.view());
    this.search.input.focus();
  }

  picker() {
    const { robots, order } = this.app.mission;
    const { robot } = this.app.selected;
    const key = `${robots.length}|${robot}|${isDark()}`;
    if (key === this.pickerKey) return;
    this.pickerKey = key;
    const pick = h(
      "select",
      {
        "aria-label": "Robot",
        onchange: ({ currentTarget }) => this.app.select({ robot: Number(currentTarget.value) }),
      },
      h("option", { value: -1 }, "All robots"),
      order.map((r) => h("option", { value: r }, robots[r].name)),
    );
    pick.value = String(robot);
    renew(this.robots, pick);
  }

  update(state, time) {
    this.picker();
    const key = this.keyOf(state, time);
    if (key === this.key) {
      this.finish(state, time);
      return;
    }
    const now = performance.now();
    if (now - this.last < this.pause) {
      this.app.soon(this.pause);
      return;
    }
    this.key = key;
    this.last = now;
    this.shown = time;
    this.stale.clear();
    renew(this.body, this.content(state, time));
    this.pause = Math.min(400, Math.max(PAUSE, 6 * (performance.now() - now))); // of a large team it takes longer
  }

  /** What the content depends on. */
  keyOf(state, time) {
    const { selected, store, plots, mission, tabs } = this.app;
    return [
      this.tab,
      selected.robot,
      selected.element,
      time,
      this.tab === "log" ? store.version : store.said,
      plots.key,
      state === null,
      this.app.controlKey(),
      mission.version,
      isDark(),
      tabs.key,
      this.tab === "search" ? this.search.version : "",
    ].join();
  }

  content(state, time) {
    const { mission, store } = this.app;
    if (mission.kind === "model")
      return mission.heat ? this.app.heat.view() : [mission.change ? this.app.change.view() : null, this.found()];
    if (this.tab === "search") return this.search.view();
    if (state === null)
      return h(
        "p",
        { cls: "quiet" },
        store.blocks.length ? "Loading this part of the run …" : "No robot has started yet.",
      );
    if (this.tab === "topics") return this.topics(time);
    return this.tab === "log" ? this.log(time) : this.state(state, time);
  }

  /** Find which of these robots are still in sight: the sections above them may have grown. */
  findSight(robots) {
    const { bottom } = this.body.getBoundingClientRect();
    for (const r of robots) {
      const part = this.parts.get(r);
      if (part.isConnected && part.getBoundingClientRect().top > bottom) this.hidden.add(part);
    }
  }

  /** Renew the sections of robots that are stale: those in sight, and of the others as many as a frame has time for. */
  finish(state, time) {
    const begun = performance.now();
    const inSight = (r) => !this.hidden.has(this.parts.get(r));
    const order = [...this.stale].sort((a, b) => Number(inSight(b)) - Number(inSight(a)));
    for (const [place, r] of order.entries()) {
      if (place > 0 && place % 6 === 0 && inSight(r)) this.findSight(order.slice(place));
      if (!inSight(r) && performance.now() - begun > SLICE) break;
      renew(
        this.parts.get(r),
        h("h3", null, this.robot(r), h("span", { cls: "quiet" }, this.idle(state, r))),
        this.waits.of(state, r, time),
        this.variables(state, r, time),
      );
      this.stale.delete(r);
    }
    if (this.stale.size) this.app.soon(SLICE);
  }

  /** The findings of a model, those of the chosen element first. */
  found() {
    const { mission, selected } = this.app;
    const all = mission.findings ?? [];
    const rank = { error: 0, warning: 1, note: 2 };
    const card = selected.element >= 0 ? this.chosenElement({ counts: [], tokens: new Map(), waits: [] }, 0) : null;
    const rows = [...all]
      .sort((a, b) => rank[a.severity] - rank[b.severity])
      .map((one) =>
        h(
          "li",
          { cls: `found ${one.severity}` },
          h(
            "div",
            null,
            h("b", null, one.severity),
            " ",
            one.element >= 0 ? this.element(one.element) : null,
            h("span", { cls: "quiet" }, ` ${one.where}${one.line ? `:${one.line}` : ""}`),
          ),
          h("div", null, one.text),
        ),
      );
    return [
      card,
      h("h3", null, "Findings"),
      rows.length
        ? h("ul", { cls: "findings" }, rows)
        : h("p", { cls: "quiet" }, "fame check has no finding. Save the file in your modeler: this page follows."),
    ];
  }

  chosen(r) {
    const { robot } = this.app.selected;
    return robot < 0 || robot === r;
  }

  robot(r) {
    return h(
      "button",
      { cls: "who", onclick: () => this.app.select({ robot: r }) },
      swatch(r),
      this.app.mission.robots[r]?.name ?? "",
    );
  }

  element(number, path = []) {
    const { elements } = this.app.mission;
    const element = elements[number];
    return h(
      "button",
      {
        cls: "link",
        title: element?.id,
        onclick: () => this.app.select({ element: number }, { reveal: true, openers: path }),
      },
      element?.name || element?.id || "?",
    );
  }

  instant(time) {
    return h("button", { cls: "when", title: "Go there", onclick: () => this.app.player.seek(time) }, clock(time));
  }

  // ---- state -------------------------------------------------------------------------------------

  state(state, time) {
    const { selected, mission } = this.app;
    const parts = [];
    const r = selected.robot;
    if (selected.element >= 0) parts.push(this.chosenElement(state, time));
    if (r < 0) parts.push(...this.all(state, time));
    else {
      parts.push(
        h("h3", null, this.robot(r), h("span", { cls: "quiet" }, this.idle(state, r))),
        ...this.waits.of(state, r, time),
        ...this.variables(state, r, time),
      );
    }
    return parts.length > (r < 0 ? 0 : 1)
      ? parts
      : [
          ...parts,
          h(
            "p",
            { cls: "quiet" },
            r < 0 ? "No robot has started yet." : `${mission.robots[r].name} runs no process at this time.`,
          ),
        ];
  }

  /** A section for each robot. Those out of sight follow in the next frames. */
  all(state, time) {
    const { order } = this.app.mission;
    for (const r of order) {
      if (!this.parts.has(r)) {
        const part = h("section", { dataset: { key: r } });
        this.parts.set(r, part);
        this.sight.observe(part);
      }
      this.stale.add(r);
    }
    this.finish(state, time);
    return order.map((r) => this.parts.get(r));
  }

  status(state, r) {
    const { columns, details } = state.block;
    for (let at = state.position - 1; at >= 0; at -= 1)
      if (columns.r[at] === r && columns.w[at] === END) {
        const alive = [...state.tokens.values()].some((token) => token.r === r);
        return alive ? "" : String(details.get(at) ?? "ended");
      }
    return "";
  }

  /** How a robot without tokens ended, and what it waits for to begin. */
  idle(state, r) {
    const rests = ![...state.tokens.values()].some((token) => token.r === r);
    return [this.status(state, r), rests && startOf(this.app, r)].filter(Boolean).join(", ");
  }

  valueOf(state, r, scope, name) {
    const value = state.valueOf(r, scope, name);
    return value === undefined ? h("em", null, "not set") : h("code", null, brief(value));
  }

  variables(state, r, time) {
    const scopes = [...state.variables.values()]
      .filter((one) => one.r === r && one.values.size > 0)
      .sort((a, b) => a.s - b.s);
    return scopes.flatMap(({ s, values }) => {
      const openers = state.openers(r, s);
      const where = openers.length ? this.app.mission.elements[openers.at(-1)]?.name : "";
      const rows = [...values]
        .sort(([a], [b]) => a.localeCompare(b))
        .map(([name, [value, since]]) => this.variable(r, s, name, value, since, time));
      return [
        h("h4", null, where ? `Variables in ${where}` : "Variables"),
        h("table", { cls: "variables", dataset: { key: `${r}/${s}` } }, h("tbody", null, rows)),
      ];
    });
  }

  variable(r, s, name, value, since, time) {
    const fresh = time - since < RECENT && since > 0;
    const mark = fresh ? h("span", { cls: "mark", title: `changed ${clock(since)}` }, "●") : null;
    return h(
      "tr",
      { cls: fresh ? "fresh" : "", dataset: { key: name } },
      h("th", { scope: "row", title: `set ${clock(since)}` }, mark, name),
      h("td", null, this.value(`${r}/${s}/${name}`, value)),
      h("td", { cls: "act" }, this.plot(r, name, value)),
    );
  }

  /** A value; a long one is a button that shows all of it, or less. */
  value(id, value) {
    const open = this.opened.has(id);
    const text = open ? h("pre", null, JSON.stringify(value, null, 2)) : h("code", null, brief(value));
    const long = typeof value === "string" ? value.length > 100 : value !== null && typeof value === "object";
    if (!long) return text;
    const toggle = () => {
      if (open) this.opened.delete(id);
      else this.opened.add(id);
      this.key = "";
      this.app.redraw();
    };
    return h("button", { cls: "value", title: open ? "Show less" : "Show all", onclick: toggle }, text);
  }

  plot(r, name, value) {
    const paths = numbers(value);
    if (paths.length > 1) return this.plotMenu(r, name, paths);
    return paths.length ? this.plotButton({ r, name, path: paths[0] }) : null;
  }

  plotButton(plot, text = null) {
    const on = this.app.plots.has(plot);
    return h(
      "button",
      {
        cls: text ? "text" : "",
        title: on ? "Remove the plot" : "Plot it over time",
        "aria-pressed": String(on),
        onclick: () => this.app.plots.toggle(plot),
      },
      text ?? icon("plot"),
    );
  }

  plotMenu(r, name, paths, topic = "") {
    return h(
      "select",
      {
        cls: "plots",
        title: "Plot a field over time",
        "aria-label": `Plot a field of ${name}`,
        onchange: ({ currentTarget: pick }) => {
          if (pick.value !== "") this.app.plots.toggle({ r, name, topic, path: paths[Number(pick.value)] });
          pick.value = "";
        },
      },
      h("option", { value: "" }, "plot"),
      paths.map((path, at) =>
        h("option", { value: at }, `${this.app.plots.has({ r, name, topic, path }) ? "✓ " : ""}${path.join(".")}`),
      ),
    );
  }

  // ---- one element -------------------------------------------------------------------------------

  chosenElement(state, time) {
    const { selected, mission, control } = this.app;
    const number = selected.element;
    const element = mission.elements[number];
    if (element === undefined) return null;
    const findings = this.app.findingsOf(number) ?? [];
    const isModel = mission.kind === "model";
    const open = () => this.app.diagram.open(element.inside, number);
    return h(
      "div",
      { cls: "card" },
      this.cardHead(element),
      this.facts(element),
      this.app.acts.atElement(state, number, selected.robot),
      findings.map((one) => h("div", { cls: `found ${one.severity}` }, h("b", null, one.severity), ` ${one.text}`)),
      element.doc ? h("p", null, element.doc) : null,
      element.script ? h("details", null, h("summary", null, "Script"), h("pre", null, element.script)) : null,
      isModel ? null : h("div", { cls: "row" }, h("span", null, this.counts(state, number))),
      h(
        "div",
        { cls: "row" },
        isModel ? null : this.visits(number, time),
        element.inside !== undefined ? h("button", { cls: "text", onclick: open }, "Open") : null,
        control.forElement(number),
      ),
    );
  }

  /** @param {Element} element */
  cardHead({ name, id }) {
    const close = h("button", { title: "Close", onclick: () => this.app.select({ element: -1 }) }, icon("close"));
    return h("div", { cls: "head" }, h("b", null, name || id), close);
  }

  /**
   * What the model says of an element.
   *
   * @param {Element} element
   */
  facts({ id, tag, source, topics, condition }) {
    /** @param {[topic: string, way: string, name?: string]} topic */
    const row = ([topic, way, name]) => {
      const verb = way === "throw" ? "publishes " : "receives ";
      return h("div", null, verb, h("code", null, topic), name ? ` (${name})` : "");
    };
    return [
      h("div", { cls: "quiet" }, `${tag.replace(/([A-Z])/g, " $1").toLowerCase()} · ${id}`),
      source ? h("div", null, source) : null,
      topics ? h("div", null, topics.map(row)) : null,
      condition ? h("div", null, "condition ", h("code", null, condition)) : null,
    ];
  }

  /** How often an element was completed, failed and cancelled so far, and how many tokens it holds. */
  counts(state, number) {
    let sum = [0, 0, 0];
    let tokens = 0;
    for (const [key, counts] of state.counts) {
      const [r, e] = counted(key);
      if (e === number && this.chosen(r)) sum = sum.map((value, at) => value + counts[at]);
    }
    for (const token of state.tokens.values()) if (token.e === number && this.chosen(token.r)) tokens += token.n;
    const texts = [
      `${sum[0]} completed`,
      sum[1] ? `${sum[1]} failed` : "",
      sum[2] ? `${sum[2]} cancelled` : "",
      tokens ? `${tokens} token${tokens > 1 ? "s" : ""} here` : "",
    ];
    return texts.filter(Boolean).join(" · ");
  }

  /** Buttons that move the cursor to the previous and the next event of an element. */
  visits(number, time) {
    const { store, player } = this.app;
    const isVisit = ({ columns: { e, w, r } }, at) => e[at] === number && w[at] <= FAIL && this.chosen(r[at]);
    const go = async (step) => {
      const found = await store.find(time, step, isVisit);
      if (found !== null) player.seek(found);
    };
    return [
      h("button", { cls: "text", onclick: () => go(-1) }, "Previous visit"),
      h("button", { cls: "text", onclick: () => go(1) }, "Next visit"),
    ];
  }

  // ---- messages and log --------------------------------------------------------------------------

  topics(time) {
    const { store, mission } = this.app;
    const last = new Map();
    for (const { data } of store.blocks) {
      if (!data || data.start > time) continue;
      for (const row of data.messages) {
        if (row[0] > time) break;
        last.set(row[1], row);
      }
    }
    if (!last.size)
      return h("p", { cls: "quiet" }, mission.messages ? "No message so far." : "This run has no recorded messages.");
    const rows = [...last.values()].sort((a, b) => a[1].localeCompare(b[1])).map((row) => this.message(row, time));
    return h("table", { cls: "variables" }, h("tbody", null, rows));
  }

  /** @param {MessageRow} row @param {number} time */
  message([t, topic, sender, content], time) {
    const paths = numbers(content);
    return h(
      "tr",
      { cls: time - t < RECENT ? "fresh" : "", dataset: { key: topic } },
      h("th", { scope: "row" }, topic, h("small", null, this.instant(t), sender ? ` ${sender}` : "")),
      h("td", null, h("code", null, brief(content, 200))),
      h("td", { cls: "act" }, paths.length ? this.plotMenu(-1, "", paths, topic) : null),
    );
  }

  /** Log lines, reports and errors until the cursor, the last first. */
  log(time) {
    const { store, mission } = this.app;
    const found = [];
    for (let number = store.numberAt(time); number >= 0 && found.length < LINES; number -= 1) {
      const { data } = store.blocks[number] ?? {};
      if (!data) continue;
      const { t, r, w } = data.columns;
      for (let at = after(t, time) - 1; at >= 0 && found.length < LINES; at -= 1)
        if (LOGGED.has(w[at]) && this.chosen(r[at])) found.push(this.line(data, at));
    }
    const robot = mission.robots[this.app.selected.robot]?.name ?? "any robot";
    return found.length ? h("ol", { cls: "log" }, found) : h("p", { cls: "quiet" }, `No log lines of ${robot} so far.`);
  }

  /** The line of an event of a block. */
  line({ number, columns: { t, r, e, w }, details }, at) {
    const what = w[at];
    const word = LOGGED.get(what);
    return h(
      "li",
      { cls: what === FAIL ? "failed" : what === REPORT ? "report" : "", dataset: { key: `${number}/${at}` } },
      this.instant(t[at]),
      this.robot(r[at]),
      h(
        "span",
        { cls: "line" },
        word ? h("b", null, word) : null,
        e[at] >= 0 && what !== END ? [" ", this.element(e[at])] : null,
        ` ${details.get(at) ?? ""}`,
      ),
    );
  }
}
