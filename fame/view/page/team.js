// The first look: a table of the robots, those who need somebody first, and what people have to do, the oldest first.

import { arrange, h, icon, isDark, renew, swatch } from "./dom.js";
import { STATES, STATE_WORDS, drawn, nameOf, roster } from "./roster.js";
import { FAIL, REPORT } from "./store.js";

const PAUSE = 50; // ms between two pictures of the table
const SIGNS = {
  incident: "alert",
  lost: "off",
  failed: "alert",
  waiting: "person",
  suspended: "pause",
  running: "play",
  ready: "clock",
  idle: "minus",
  completed: "check",
  cancelled: "close",
};
const HEADS = ["Robot", "State", "Doing", "Since", "Battery", "Open task", "Last message lost", ""];
const COLUMNS = ["name", "state", "doing", "since", "battery", "open", "missed", "hand"]; // their classes
const HELD = new Set(["incident", "waiting", "suspended", "running"]);

/** A duration in whole seconds, minutes or hours, as people read it. */
export function ago(time) {
  const seconds = Math.max(0, Math.floor(time / 1e9));
  if (seconds < 60) return `${seconds} s`;
  if (seconds < 3600) return `${Math.floor(seconds / 60)} min ${seconds % 60 ? `${seconds % 60} s` : ""}`.trim();
  return `${Math.floor(seconds / 3600)} h ${Math.floor((seconds % 3600) / 60)} min`;
}

const small = (text) => (text ? h("small", null, text) : null);

export class Team {
  constructor(team, needs, app) {
    this.app = app;
    this.table = h("div", { cls: "roster", role: "table", "aria-label": "Robots" });
    this.list = h("div", { cls: "asks", tabindex: 0 });
    this.summary = h("span", { cls: "quiet" });
    team.append(h("div", { cls: "bar" }, h("h2", null, "Team"), this.summary), h("div", { cls: "body" }, this.table));
    needs.append(
      h("div", { cls: "bar" }, h("h2", null, "Needs you"), (this.count = h("span", { cls: "quiet" }))),
      this.list,
    );
    this.heads = h(
      "div",
      { role: "row", cls: "heads" },
      HEADS.map((text) => h("div", { role: "columnheader" }, text || h("span", { cls: "unseen" }, "Actions"))),
    );
    this.drawn = new Map(); // robot -> {row, cells, keys: what they show}
    this.rows = [];
    this.asks = [];
    this.last = -Infinity;
    this.shown = undefined;
  }

  update(state, time) {
    const now = performance.now();
    const { app } = this;
    const key = [
      time,
      app.store.version,
      app.controlKey(),
      document.documentElement.dataset.theme,
      app.mission.robots.length,
      app.tabs.key,
      app.steer.held?.lease,
    ].join();
    if (key === this.key || state === null) return;
    if (now - this.last < (this.pause ?? PAUSE)) {
      app.soon(PAUSE);
      return;
    }
    this.key = key;
    this.last = now;
    this.shown = time;
    this.rows = roster(app, state, time);
    this.asks = this.rows
      .flatMap((row) => row.open.filter((wait) => app.acts.isMine(wait)).map((wait) => this.ask(state, row, wait)))
      .sort((a, b) => a.wait.since - b.wait.since);
    app.tabs.badge("needs", this.asks.length);
    this.draw(state, time);
    this.pause = Math.max(PAUSE, 4 * (performance.now() - now));
  }

  draw(state, time) {
    const count = new Map();
    for (const { state: of } of this.rows) count.set(of, (count.get(of) ?? 0) + 1);
    this.summary.textContent = STATES.filter((of) => count.has(of))
      .map((of) => `${count.get(of)} ${STATE_WORDS[of]}`)
      .join(" · ");
    if (this.app.tabs.shows("team")) {
      arrange(this.table, [this.heads, ...this.rows.map((row) => this.row(row, time))]);
    }
    if (this.app.tabs.shows("needs")) {
      this.count.textContent = this.asks.length ? `${this.asks.length} open, the oldest first` : "";
      renew(
        this.list,
        this.asks.length
          ? this.asks.map((ask) => this.card(ask, time))
          : h("p", { cls: "nothing" }, icon("check"), "Nobody waits for you."),
      );
    }
  }

  // ---- the table ---------------------------------------------------------------------------------

  /** The row of a robot: of its cells only those are made again that differ from before. */
  row(row, time) {
    if (!this.drawn.has(row.r)) {
      const cells = COLUMNS.map((cls) => h("div", { role: "cell", cls }));
      this.drawn.set(row.r, { cells, keys: [], row: h("div", { role: "row", dataset: { key: row.r } }, cells) });
    }
    const known = this.drawn.get(row.r);
    const cls = `robot ${row.state} ${this.app.selected.robot === row.r ? "on" : ""}`;
    if (known.row.className !== cls) known.row.className = cls;
    this.cells(row, time).forEach(([key, content], at) => {
      if (known.keys[at] === key) return;
      known.keys[at] = key;
      renew(known.cells[at], content());
    });
    return known.row;
  }

  /**
   * The cells of a row, each as a text that says whether it differs, and what makes its content.
   *
   * @returns {[differs: string, content: () => any][]}
   */
  cells(row, time) {
    const { app } = this;
    const [open] = row.open;
    const { missed } = row;
    const since = !/idle|ready/.test(row.state) && row.since >= 0 ? ago(time - row.since) : "";
    const by = row.state === "suspended" && row.by ? `by ${row.by}` : row.state === "ready" ? "" : row.start;
    const word = row.state === "ready" ? row.start : STATE_WORDS[row.state];
    const lost = missed ? `${ago(time - missed.time)} ago` : "";
    const hand = app.acts.can("take_over") && HELD.has(row.state) && app.steer.held?.r !== row.r;
    const unseen = row.blind && `monitor blind: ${row.blind}`;
    const sign = () => h("span", { cls: "glyph" }, icon(SIGNS[row.state]));
    return [
      [`${row.name} ${row.element} ${isDark()}`, () => this.who(row)],
      [
        word + by + row.failed + row.blind,
        () => [sign(), h("span", null, word), ...[by, row.failed, unseen].map(small)],
      ],
      [
        `${row.doing} ${row.more} ${row.progress}`,
        () => [row.doing, small(row.more ? `and ${row.more} more` : ""), small(row.progress)],
      ],
      [since, () => [since]],
      [String(row.battery), () => [this.battery(row.battery)]],
      [String(open?.e), () => [open ? nameOf(app, open.e) : ""]],
      [`${missed?.e} ${lost}`, () => (missed ? [nameOf(app, missed.e), small(lost)] : [])],
      [String(hand), () => [hand ? this.takeOver(row) : null]],
    ];
  }

  who({ r, name, element }) {
    const action = () => this.app.goTo(r, element);
    return h("button", { cls: "who", title: `Show ${name} in its diagram`, onclick: action }, swatch(r), name);
  }

  takeOver({ r, name }) {
    const title = `Suspend the mission of ${name}, and steer it`;
    return h("button", { cls: "text", title, onclick: () => this.app.steer.takeOver(r) }, "Take over");
  }

  battery(charge) {
    if (charge === null) return "";
    const percent = Math.round(100 * charge);
    return h(
      "span",
      { cls: percent < 20 ? "low" : "" },
      h("meter", { min: 0, max: 100, low: 20, value: percent, "aria-label": "Battery" }),
      ` ${percent} %`,
    );
  }

  // ---- what people have to do --------------------------------------------------------------------

  /** Something that a person has to do: {row, wait, element: its JSON, place, text: what is wrong, due}. */
  ask(state, row, wait) {
    const { elements } = this.app.mission;
    const element = elements[wait.e] ?? { id: wait.element, tag: "" };
    const place = drawn(this.app, state.openers(row.r, wait.scope), wait.e);
    const due = element.due ? wait.since + element.due * 1e9 : null;
    const whose = [...(element.users ?? []), ...(element.groups ?? [])].join(", ");
    return {
      row,
      wait,
      element,
      whose,
      place: place === wait.e ? "" : nameOf(this.app, place),
      text: wait.error ?? (wait.kind === "incident" ? this.failure(row.r, wait) : (element.doc ?? "")),
      due,
    };
  }

  /** Why an element failed, as the log says. */
  failure(r, wait) {
    const { store } = this.app;
    for (let number = store.numberAt(wait.since); number >= Math.max(0, store.numberAt(wait.since) - 2); number -= 1) {
      const { columns, details } = store.blocks[number]?.data ?? {};
      for (let at = (columns?.t.length ?? 0) - 1; at >= 0; at -= 1) {
        if (
          columns.r[at] === r &&
          columns.e[at] === wait.e &&
          (columns.w[at] === FAIL || columns.w[at] === REPORT) &&
          columns.t[at] <= wait.since
        )
          return String(details.get(at) ?? "");
      }
    }
    return "";
  }

  card(ask, time) {
    const { row, wait, place, text, due } = ask;
    const left = due === null ? null : due - time;
    return h(
      "section",
      { cls: `ask ${wait.kind}`, dataset: { key: `${row.r}/${wait.key}` } },
      h(
        "h3",
        null,
        h("span", { cls: "glyph" }, icon(wait.kind === "incident" ? "alert" : "person")),
        h(
          "button",
          { cls: "link", title: "Show it in the diagram", onclick: () => this.app.goTo(row.r, wait.e) },
          nameOf(this.app, wait.e),
        ),
      ),
      h(
        "p",
        { cls: "quiet" },
        swatch(row.r),
        ` ${row.name}${place ? `, in ${place}` : ""}`,
        `${ask.whose ? ` · for ${ask.whose}` : ""} · since ${ago(time - wait.since)}`,
        left === null
          ? null
          : h("b", { cls: left < 0 ? "late" : "due" }, left < 0 ? ` · ${ago(-left)} late` : ` · due in ${ago(left)}`),
      ),
      text ? h("p", { cls: "said" }, text) : null,
      this.app.acts.buttons(row.r, wait),
    );
  }
}
