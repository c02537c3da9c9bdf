// A model that a running team could change to: dropped on the page of the team; on a page of its own what it would
// do, then Deploy or Migrate.

/** @import {App} from "./main.js" */
import { h, icon, s, show } from "./dom.js";
import { ask } from "./form.js";

const WORDS = { added: "added", removed: "removed", changed: "changed", moved: "moved in the diagram only" };
const SIGNS = { added: "+", changed: "~", moved: "→" };
const FATES = { keep: "stays", restart: "begins again", abandon: "ends", blocked: "has no place" };
const LONGEST = 900_000; // characters

/** An element that was removed, where it was. */
const ghost = ({ name, box: [x, y, width, height] }) =>
  s(
    "g",
    { cls: "ghost" },
    s("title", null, `removed: ${name}`),
    s("rect", { x, y, width, height, rx: 8 }),
    s("text", { x: x + width / 2, y: y + height + 13 }, name),
  );

/** The sign of a change, at the corner of a shape. */
const badge = ([x, y, width], name, grow) =>
  s(
    "g",
    { cls: `badge ${name}`, transform: `translate(${x + width} ${y}) scale(${grow})` },
    s("title", null, WORDS[name]),
    s("circle", { r: 9 }),
    s("text", { cls: "middle", y: 4 }, SIGNS[name]),
  );

export class Change {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    this.input = h("input", {
      type: "file",
      accept: ".bpmn,.xml",
      hidden: true,
      "aria-label": "Model",
      onchange: () => this.take(this.input.files[0]),
    });
    document.body.append(this.input);
    addEventListener("dragover", (event) => this.may && event.preventDefault());
    addEventListener("drop", (event) => {
      if (!this.may) return;
      event.preventDefault();
      this.take(event.dataTransfer?.files[0]);
    });
  }

  get may() {
    return this.app.control.can.has("change");
  }

  get data() {
    return this.app.mission.change;
  }

  button() {
    return h(
      "button",
      {
        cls: "text",
        title: "See what another model would change: choose a file, or drop it on the page",
        onclick: () => this.input.click(),
      },
      icon("flow"),
      "Change …",
    );
  }

  async take(file) {
    if (file === undefined) return;
    if (file.size > LONGEST) this.app.toast(`${file.name} is longer than ${LONGEST} bytes`, true);
    else if (await this.app.control.send({ do: "change", name: file.name, source: await file.text() }))
      location.href = new URL("change/", new URL(".", location.href)).href;
  }

  // ---- the page of a model -----------------------------------------------------------------------

  /** Mark what differs on a plane; what was removed is drawn where it was. */
  paint(plane) {
    const key = `${this.app.mission.version}|${this.app.diagram.plane}|${plane.level}`;
    const { changes, ghosts } = this.data;
    if (plane.change === key) return;
    plane.change = key;
    const how = new Map(changes.map((one) => [one.element, one.how]).reverse()); // the strongest, where versions differ
    for (const [number, group] of plane.groups)
      for (const name of Object.keys(SIGNS)) group.classList.toggle(`is-${name}`, how.get(number) === name);
    const marked = [...how].filter(([number]) => plane.shapes.has(number));
    show(
      plane.over,
      this.app.diagram.plane === 0 ? ghosts.map(ghost) : [],
      marked.map(([number, name]) => badge(plane.shapes.get(number), name, this.app.diagram.grow)),
    );
  }

  view() {
    const { data } = this;
    const back = h("div", { cls: "row" }, h("a", { href: ".." }, "Back to the team"));
    if (!data.hash)
      return [
        back,
        data.error
          ? h("p", { cls: "found error" }, data.error)
          : data.asking
            ? h("p", { cls: "quiet" }, "Reading the model …")
            : null,
      ];
    return [
      back,
      this.actions(),
      h("h2", null, "Robots"),
      data.robots.map((robot) => this.robot(robot)),
      data.others.length
        ? h("p", null, `The model has no pool for ${data.others.join(", ")}: what runs there goes on.`)
        : null,
      data.asking ? h("p", { cls: "quiet" }, "Asking the robots …") : null,
      h("h2", null, "Differs from what they run"),
      this.changes(),
      data.explored ? [h("h2", null, "If they migrate"), h("p", null, data.explored.text), this.explored()] : null,
    ];
  }

  actions() {
    const { data, app } = this;
    const can = (act) => app.control.can.has(act);
    const blocked = data.objection;
    return [
      h(
        "div",
        { cls: "row" },
        h(
          "button",
          { cls: "text strong", disabled: !can("migrate") || !data.robots.length, onclick: () => this.send("migrate") },
          "Migrate …",
        ),
        h(
          "button",
          { cls: "text", disabled: !can("deploy") || !data.robots.length, onclick: () => this.send("deploy") },
          "Deploy …",
        ),
        h(
          "button",
          { cls: "text", disabled: !can("examine"), onclick: () => app.control.send({ do: "examine" }) },
          "Ask again",
        ),
        h("code", { title: data.hash }, data.hash.slice(0, 12)),
      ),
      blocked ? h("p", { cls: "found error" }, blocked) : null,
    ];
  }

  robot({ robot, state, reason, runs, tokens }) {
    const rows = tokens.map((token) => this.fate(token));
    const known = state === "previewed";
    const now = known ? (runs ? `runs ${runs.slice(0, 12)}` : "runs nothing: it begins") : `${state} ${reason}`;
    return h(
      "section",
      { dataset: { key: robot } },
      h("h3", null, robot, h("span", { cls: "quiet" }, now)),
      rows.length ? h("ul", { cls: "waits" }, rows) : h("p", { cls: "quiet" }, known && runs ? "No token." : ""),
    );
  }

  /** What becomes of a token. */
  fate({ element, name, fate, target, reason }) {
    return h(
      "li",
      { cls: fate === "blocked" ? "failed" : "" },
      element >= 0 ? this.app.inspector.element(element) : h("b", null, name),
      ` ${FATES[fate]}${target && fate === "restart" ? " there" : ""}${reason ? `: ${reason}` : ""}`,
    );
  }

  /** What the exploration of the migrated state has found, each with the run that leads to it. */
  explored() {
    return h(
      "ul",
      { cls: "findings" },
      this.data.explored.findings.map(({ level, text, steps }) =>
        h(
          "li",
          { cls: `found ${level}` },
          h("details", null, h("summary", null, text), h("pre", { cls: "code" }, steps.join("\n"))),
        ),
      ),
    );
  }

  changes() {
    const rows = this.data.changes.map((one) =>
      h(
        "li",
        { cls: `found differs ${one.how}`, dataset: { key: `${one.id} ${one.robots.join()}` } },
        h(
          "div",
          null,
          h("b", null, WORDS[one.how]),
          " ",
          one.element >= 0 ? this.app.inspector.element(one.element) : one.name,
          h("span", { cls: "quiet" }, ` ${one.robots.join(", ")}`),
        ),
        one.what.length ? h("div", null, one.what.join(", ")) : null,
        this.code(one),
      ),
    );
    return rows.length
      ? h("ul", { cls: "findings" }, rows)
      : h("p", { cls: "quiet" }, this.data.asking ? "…" : "Nothing.");
  }

  /** The lines that are gone, then the new text: its lines that the old one does not have are marked. */
  code({ code }) {
    const [old, fresh] = code.map((texts) => texts.flatMap((text) => text.split("\n")));
    const lines = [
      ...old.filter((line) => !fresh.includes(line)).map((line) => h("del", null, `${line}\n`)),
      ...fresh.map((line) => (old.includes(line) ? `  ${line}\n` : h("ins", null, `${line}\n`))),
    ];
    return lines.length ? h("pre", { cls: "code" }, lines) : null;
  }

  /** Show the code that would run, and ask; the hash is that of what is shown. */
  async send(act) {
    const { data } = this;
    const hash = data.hash.slice(0, 12);
    const migrates = act === "migrate";
    const fields = [{ key: "agreed", label: `I have read it: ${hash} may run`, kind: "checkbox", required: true }];
    if (migrates && data.objection)
      fields.push({ key: "force", label: "Migrate although this may fail", kind: "checkbox", required: true });
    const title = migrates ? "Migrate what runs?" : "Deploy this model?";
    const found = await ask(title, fields, migrates ? "Migrate" : "Deploy", this.consequences(migrates));
    if (!found) return;
    this.app.toast("Sending …");
    const answer = await this.app.control.send({ do: act, hash: data.hash, force: found.force === true });
    if (answer) this.app.control.send({ do: "examine" });
  }

  /** What happens to what runs, the code that is new, and what is against it. */
  consequences(migrates) {
    const { data } = this;
    const code = data.changes.filter(({ code: [, fresh] }) => fresh.length);
    const hash = data.hash.slice(0, 12);
    const robots = data.robots.map(({ robot }) => robot).join(", ");
    return [
      h(
        "p",
        null,
        migrates
          ? `What runs on ${robots} goes over to ${hash}.`
          : `What runs on ${robots} is cancelled; ${hash} begins.`,
      ),
      code.length
        ? [
            h("p", null, h("b", null, "Code that is new, and will run on the robots:")),
            code.map((one) => [h("p", null, `${one.name} (${one.robots.join(", ")})`), this.code(one)]),
          ]
        : h("p", null, "No script or expression is new."),
      migrates && data.objection ? h("p", { cls: "found error" }, data.objection) : [],
    ];
  }
}
