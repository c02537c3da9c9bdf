// Heat maps: what each element did in many recorded runs, as colours and numbers on the diagram. A click lists the
// runs.

/** @import {App} from "./main.js" */
import { h, s, show } from "./dom.js";

/** @type {Object<string, [name: string, meaning: string, text: (value: any) => string]>} */
const MEASURES = {
  times: ["Frequency", "how often it began, or a flow was taken", (n) => `${n}×`],
  p50: ["Duration p50", "half of its completed executions took at most this long", (value) => seconds(value)],
  p95: ["Duration p95", "95 % of its completed executions took at most this long", (value) => seconds(value)],
  failures: ["Failures", "how often it failed", (n) => `${n} failed`],
  waiting: [
    "Waiting",
    "how long it, or something inside it, waited for a message, a person, a time or a condition, in all runs",
    (value) => seconds(value),
  ],
};
const HOTTEST = 8;

/** Seconds in three digits: 12 ms, 3.4 s, 25 min, 3 h. */
const seconds = (value) =>
  value < 1
    ? `${Math.round(value * 1000)} ms`
    : value < 120
      ? `${Number(value.toPrecision(3))} s`
      : value < 7200
        ? `${Math.round(value / 60)} min`
        : `${Math.round(value / 3600)} h`;

export class Heat {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    this.measure = "times";
    /** @type {{element: number, rows: any, version?: number | string}} */
    this.runs = { element: -1, rows: null }; // of the chosen element
  }

  get data() {
    return this.app.mission.heat;
  }

  value(number) {
    return this.data.elements[number]?.[this.measure] ?? 0;
  }

  changed() {
    this.app.inspector.key = "";
    this.app.inspector.hurry();
    this.app.redraw();
  }

  /** Colour the elements of a plane by their value, on a logarithmic scale up to the largest one there. */
  paint(plane) {
    const found = [...plane.groups.keys()].filter((number) => this.value(number) > 0);
    const most = Math.max(0, ...found.map((number) => this.value(number)));
    const key = `${this.measure}|${this.app.mission.version}|${this.app.diagram.plane}|${plane.level}`;
    if (plane.heat === key) return;
    plane.heat = key;
    for (const [number, group] of plane.groups) {
      const hot = found.includes(number);
      group.classList.toggle("is-hot", hot);
      if (hot) group.style.setProperty("--heat", String(Math.log1p(this.value(number)) / Math.log1p(most)));
    }
    const text = MEASURES[this.measure][2];
    show(
      plane.under,
      found
        .filter((number) => plane.shapes.has(number))
        .map((number) => this.badge(plane.shapes.get(number), text(this.value(number)))),
    );
  }

  badge([x, y, width], text) {
    const wide = 10 + 6 * text.length;
    const { grow } = this.app.diagram;
    return s(
      "g",
      { cls: "badge heat", transform: `translate(${x + width + 9 - wide * grow} ${y}) scale(${grow})` },
      s("rect", { x: 0, y: -8, width: wide, height: 16, rx: 8 }),
      s("text", { x: 5, y: 3.6 }, text),
    );
  }

  // ---- beside the diagram ------------------------------------------------------------------------

  view() {
    const { app, data } = this;
    const number = app.selected.element;
    const [name, what] = MEASURES[this.measure];
    const measures = h(
      "div",
      { cls: "row", role: "group", "aria-label": "Measure" },
      Object.entries(MEASURES).map(([key, [text]]) =>
        h(
          "button",
          {
            cls: "text",
            dataset: { key },
            "aria-pressed": String(key === this.measure),
            onclick: () => {
              this.measure = key;
              this.changed();
            },
          },
          text,
        ),
      ),
    );
    return [
      this.models(),
      measures,
      h("p", { cls: "quiet" }, `${name}: ${what}. Colours are logarithmic.`),
      data.elements[number] ? this.card(number) : this.hottest(),
    ];
  }

  models() {
    const { models } = this.data;
    const here = this.app.diagram.trail[0]?.[0];
    return h(
      "div",
      { cls: "row" },
      models.map(({ hash, name, runs, plane }) =>
        h(
          "button",
          {
            cls: "text",
            title: `Model ${hash}`,
            dataset: { key: hash },
            "aria-pressed": String(plane === here),
            onclick: () => this.open(plane),
          },
          name,
          h("code", null, hash.slice(0, 8)),
          h("span", { cls: "quiet" }, `${runs} run${runs > 1 ? "s" : ""}`),
        ),
      ),
    );
  }

  async open(plane) {
    this.app.diagram.trail = [];
    this.app.select({ element: -1 });
    await this.app.diagram.open(plane);
    this.changed();
  }

  /** The elements with the largest values, of those that are drawn here. */
  hottest() {
    const plane = this.app.diagram.current;
    const text = MEASURES[this.measure][2];
    const found = [...(plane?.shapes.keys() ?? [])]
      .filter((number) => this.value(number) > 0)
      .sort((a, b) => this.value(b) - this.value(a))
      .slice(0, HOTTEST);
    return found.length
      ? [
          h("h2", null, "Most in this diagram"),
          this.table(found.map((number) => [this.app.inspector.element(number), text(this.value(number)), number])),
        ]
      : h("p", { cls: "quiet" }, "Nothing in this diagram.");
  }

  table(rows) {
    return h(
      "table",
      { cls: "variables values" },
      h(
        "tbody",
        null,
        rows.map(([head, text, key]) =>
          h("tr", { dataset: { key } }, h("th", { scope: "row" }, head), h("td", null, text)),
        ),
      ),
    );
  }

  card(number) {
    const { elements } = this.app.mission;
    const element = elements[number];
    const found = this.data.elements[number];
    if (this.runs.element !== number || this.runs.version !== this.app.mission.version) this.ask(number);
    const facts = Object.entries(MEASURES)
      .filter(([key]) => found[key] !== null)
      .map(([key, [name, , text]]) => [name, text(found[key]), key]);
    return [
      h(
        "div",
        { cls: "card" },
        h(
          "div",
          { cls: "head" },
          h("b", null, element.name || element.id),
          h("span", { cls: "quiet" }, element.tag.replace(/([A-Z])/g, " $1").toLowerCase()),
        ),
        this.table(facts),
        element.inside !== undefined
          ? h("button", { cls: "text", onclick: () => this.app.diagram.open(element.inside, number) }, "Open")
          : null,
      ),
      h("h2", null, "Runs"),
      this.runs.rows === null ? h("p", { cls: "quiet" }, "…") : this.list(),
    ];
  }

  /** Ask for the runs of an element. */
  async ask(number) {
    const asked = (this.runs = { element: number, version: this.app.mission.version, rows: null });
    const answer = await this.app.control.send({ do: "runs", element: number });
    asked.rows = answer?.runs ?? [];
    if (this.runs === asked) this.changed();
  }

  /** The runs of the chosen element, those with the largest value first. */
  list() {
    const [, , text] = MEASURES[this.measure];
    const of = (row) => row[this.measure] ?? 0;
    return this.table(
      [...this.runs.rows]
        .sort((a, b) => of(b) - of(a) || a.run - b.run)
        .map((row) => [
          this.app.control.can.has("show")
            ? h(
                "button",
                {
                  cls: "link",
                  title: "Show this run in a page of its own",
                  onclick: () => this.app.control.openTab({ do: "show", run: row.run }),
                },
                row.name,
              )
            : row.name,
          text(of(row)),
          row.run,
        ]),
    );
  }
}
