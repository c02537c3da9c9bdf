// The page that edits a model: the library that draws, what is found in the model while it is drawn, and its file.

import { Completion } from "./complete.js";
import { Commits } from "./commits.js";
import { byId, h, icon, messageOf, show } from "./dom.js";
import { Exploring } from "./explore.js";
import { mend } from "./fixes.js";
import { keepOrder } from "./order.js";
import { Running } from "./run.js";
import { source } from "./source.js";

const REST = 80; // ms without a change, after which the model is checked
const SAID = 6000; // ms that a message stays
const LEVELS = ["error", "warning", "note"];
const COUNTS = { error: "failed", warning: "warning", note: "" };

/**
 * @typedef {import("./explore.js").Finding} Finding
 * @typedef {{title: string, text: string, hash: string, there: boolean}} File
 * @typedef {File & {modeler: string, templates: object[], team?: boolean}} Model
 */

/** @param {string} address */
const script = (address) =>
  new Promise((done, failed) => {
    document.head.append(h("script", { src: address, onload: done, onerror: () => failed(new Error(address)) }));
  });

/** What the library cannot read of a file, and so does not draw. @param {{message: string}[]} warnings */
const unread = (warnings) =>
  warnings.map(({ message }) => message.replace(/\s+/g, " ")).filter((text) => text.startsWith("unparsable"));

class Edit {
  /** @type {any} */
  modeler = null;
  /** @type {Model} */
  mission = { title: "", text: "", hash: "", there: true, modeler: "", templates: [] };
  base = ""; // what the library writes of the text that the file has
  begun = ""; // its name at the server, which keeps it with the hash of the file
  drawn = ""; // what it writes now
  hash = ""; // of the file that the page has, to know news
  ready = false; // a model is open
  checked = 0; // changes that the findings know
  changes = 0;
  /** @type {Finding[]} */
  findings = [];
  /** @type {string[]} */
  unread = [];
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  timer = undefined;
  exploring = new Exploring(this);
  commits = new Commits(this);
  gone = "";
  /** @type {any} a `Running`, once there is a library that draws */
  running = null;

  async start() {
    this.mission = await source.fetch("mission.json");
    document.title = `${this.mission.title} – fame edit`;
    byId("title").textContent = this.mission.title;
    await script(`page/modeler/dist/${this.mission.modeler}-modeler.production.min.js`);
    const { BpmnModeler } = /** @type {any} */ (window);
    this.modeler = new BpmnModeler({
      container: "#canvas",
      propertiesPanel: { parent: "#properties" },
      alignToOrigin: { alignOnSave: false }, // which would be a step on the stack, that Undo never gets behind
    });
    keepOrder(this.modeler);
    if (this.mission.templates.length) this.modeler.get("elementTemplatesLoader").setTemplates(this.mission.templates);
    this.modeler.on("commandStack.changed", () => this.changed());
    new ResizeObserver(() => this.ready && this.modeler.get("canvas").resized()).observe(byId("canvas"));
    this.tools();
    this.completion = new Completion(this);
    this.running = new Running(this);
    await this.open(this.mission.text, this.mission.hash);
    source.listen(this);
  }

  /** Show the text of the file (`hash`), or `drawn`, which is not yet in it. */
  async open(text, hash, drawn = "") {
    this.ready = false;
    try {
      const { warnings } = await this.modeler.importXML(text);
      this.unread = unread(warnings);
      await this.written(); // which puts shapes in order once
      this.base = await this.written();
      this.begun = (await source.post({ do: "open", base: this.base, hash })).base;
      if (drawn) await this.modeler.importXML(drawn);
    } catch (error) {
      const why = [messageOf(error), ...unread(/** @type {any} */ (error).warnings ?? [])].join("; ");
      byId("findings").replaceChildren(h("p", { cls: "error" }, `It cannot be drawn: ${why}`));
      return;
    }
    Object.assign(this.mission, { text });
    Object.assign(this, { hash, ready: true });
    this.fit();
    await this.look();
  }

  /** What the library writes, without the empty labels that it leaves behind when a change is undone. */
  async written() {
    const { xml } = await this.modeler.saveXML({ format: true });
    return xml.replace(/\n\s*<[\w:]*BPMNLabel \/>/g, "");
  }

  get dirty() {
    return this.drawn !== this.base;
  }

  // ---- while it is drawn -------------------------------------------------------------------------

  changed() {
    this.changes += 1;
    this.exploring.stop();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.look().catch((error) => this.say(messageOf(error))), REST);
  }

  /** Check what is drawn, and show what is found. */
  async look() {
    if (!this.ready) return;
    const seen = this.changes;
    this.drawn = await this.written();
    this.chips();
    const found = await this.ask("check");
    if (seen !== this.changes) return; // it has changed meanwhile: it is checked again
    this.findings = found.findings;
    this.checked = seen;
    this.show();
    this.exploring.begin();
    if (this.commits.open) await this.commits.update();
  }

  /** Send what is drawn. */
  ask(act, more = {}) {
    return source.post({ do: act, base: this.begun, new: this.drawn, window: this.exploring.window, ...more });
  }

  get found() {
    const about = { level: "warning", element: "", name: "" };
    const notDrawn = this.unread.map((line) => /** @type {Finding} */ ({ ...about, text: `not drawn: ${line}` }));
    const found = [...notDrawn, ...this.findings, ...this.exploring.findings];
    return found.sort((one, other) => LEVELS.indexOf(one.level) - LEVELS.indexOf(other.level));
  }

  show() {
    this.chips();
    this.list();
    this.marks();
  }

  chips() {
    const chips = LEVELS.map((level) => {
      const count = this.found.filter((one) => one.level === level).length;
      return count && h("span", { cls: `chip ${COUNTS[level]}` }, `${count} ${level}${count > 1 ? "s" : ""}`);
    }).filter(Boolean);
    if (!chips.length) chips.push(h("span", { cls: "chip completed" }, "no problems found"));
    const isSaved = !this.dirty && this.mission.there;
    const state = this.gone || (isSaved ? "saved" : "not saved");
    const cls = `chip ${this.gone ? "failed" : ""}`;
    byId("chips").replaceChildren(h("span", { cls, id: "state" }, state), ...chips, ...this.exploring.chips());
    /** @type {any} */ (byId("save")).disabled = isSaved;
  }

  list() {
    const rows = this.found.map((one) =>
      h(
        "div",
        { cls: "finding" },
        h(
          "button",
          { onclick: () => this.select(one.element), dataset: { element: one.element } },
          h("span", { cls: one.level }, one.level),
          h("span", null, !one.steps && (one.name || one.element) ? `${one.name || one.element}: ` : "", one.text),
        ),
        one.fix && h("button", { cls: "text fix", onclick: () => mend(this.modeler, one.fix) }, one.fix.text),
        one.steps?.length && h("button", { cls: "text play", onclick: () => this.exploring.play(one) }, "Play it"),
      ),
    );
    byId("findings").replaceChildren(...rows);
  }

  /** Show at each element the strongest of what is found there. */
  marks() {
    const overlays = this.modeler.get("overlays");
    const elements = this.modeler.get("elementRegistry");
    overlays.remove({ type: "finding" });
    for (const id of new Set(this.found.map((one) => one.element))) {
      const these = this.found.filter((one) => one.element === id);
      if (!id || !elements.get(id)) continue;
      const level = LEVELS.find((name) => these.some((one) => one.level === name));
      const title = these.map((one) => one.text).join("\n");
      const html = h("div", { cls: `mark ${level}`, title }, level === "note" ? "i" : "!");
      overlays.add(id, "finding", { position: { top: -10, right: 10 }, html });
    }
  }

  select(id) {
    const element = this.modeler.get("elementRegistry").get(id);
    if (!element) return;
    this.modeler.get("canvas").scrollToElement(element);
    this.modeler.get("selection").select(element);
  }

  // ---- the file ----------------------------------------------------------------------------------

  /** Write what is drawn into the file, and let the run go over to it. Returns whether it is written. */
  async save() {
    if (!this.ready) return false;
    this.drawn = await this.written();
    const { drawn } = this;
    try {
      const { base, hash, text } = await this.ask("save");
      Object.assign(this, { base: drawn, begun: base, hash });
      Object.assign(this.mission, { text, there: true });
      this.chips();
    } catch (error) {
      this.say(messageOf(error));
      await this.compare(); // at once: the news of another file may be on its way
      return false;
    }
    await this.running.change();
    return true;
  }

  /** What the server sends: the hash of the file, which somebody else may have changed. */
  async news({ type, hash, there }) {
    if (type !== "file" || !this.ready) return;
    if (this.mission.there && !there) this.say("The file has been removed: Save writes it again.");
    this.mission.there = there;
    this.chips();
    if (hash === this.hash) return void (byId("outside").hidden = true);
    await this.compare();
  }

  async compare() {
    this.drawn = await this.written();
    try {
      this.outside(await this.ask("compare", { text: this.mission.text }));
    } catch (error) {
      this.outside({ lines: [messageOf(error)], hash: "", text: "", merged: "" });
    }
  }

  outside({ lines, hash, text, merged }) {
    if (hash === this.hash) return;
    const act = (name, words, action) => h("button", { cls: "text", id: name, onclick: action }, words);
    const done = (drawn) => this.open(text, hash, drawn).then(() => (byId("outside").hidden = true));
    const said = lines.length ? lines.join("\n") : "Only comments, spaces or the order of elements differ.";
    byId("outside").replaceChildren(
      h("strong", null, `${this.mission.title} has been changed by somebody else`),
      h("pre", null, said),
      h(
        "span",
        { cls: "acts" },
        text && act("theirs", this.dirty ? "Load it; what I have drawn is lost" : "Load it", () => done("")),
        text && this.dirty && act("both", "Load it, with what I have drawn", () => done(merged)),
      ),
    );
    byId("outside").hidden = false;
  }

  disconnected(text) {
    this.gone = text && "not connected";
    this.chips();
    if (text) this.say("The connection to fame edit has ended: nothing can be saved.");
  }

  // ---- the page ----------------------------------------------------------------------------------

  tools() {
    const tool = (id, name, picture, action) =>
      h("button", { id, title: name, "aria-label": name, onclick: action }, icon(picture));
    const stack = this.modeler.get("commandStack");
    show(
      byId("tools"),
      tool("undo", "Undo (Ctrl Z)", "back", () => stack.undo()),
      tool("redo", "Redo (Ctrl Y)", "forth", () => stack.redo()),
      tool("fit", "Fit the diagram", "fit", () => this.fit()),
      this.commits.button(),
      this.mission.team && h("a", { href: "change/", target: "_blank", rel: "noopener" }, "Team"),
      h("button", { id: "save", cls: "text strong", title: "Ctrl S", onclick: () => this.save() }, "Save"),
    );
    addEventListener("keydown", (event) => {
      if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== "s") return;
      event.preventDefault();
      this.save();
    });
    addEventListener("beforeunload", (event) => this.dirty && event.preventDefault());
  }

  fit() {
    const canvas = this.modeler.get("canvas");
    canvas.resized();
    canvas.zoom(0.9 * canvas.zoom("fit-viewport", "auto"), "auto");
    canvas.scroll({ dx: 45, dy: 0 }); // beside the palette
  }

  say(text) {
    const toast = byId("toast");
    toast.textContent = text;
    toast.hidden = false;
    setTimeout(() => (toast.hidden = true), SAID);
  }
}

const edit = new Edit();
Object.assign(window, { edit });
edit.start().catch((error) => edit.say(messageOf(error)));
