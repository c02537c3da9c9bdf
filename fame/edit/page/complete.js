// Completes what is typed into the properties panel: a list below the field, with what the server knows to fit.

import { byId, h } from "./dom.js";
import { source } from "./source.js";

const PANEL = "bio-properties-panel-";
/** @type {{[id: string]: string}} */
const FIELDS = {
  scriptValue: "script",
  conditionScriptValue: "script",
  conditionExpression: "condition",
  completionCondition: "condition",
  signalName: "signal",
  messageName: "signal",
  calledElement: "called",
  targetProcessId: "called",
};

/** @typedef {HTMLInputElement | HTMLTextAreaElement | HTMLElement} Field an input, or an editor of FEEL */

/** @param {Field} field @returns {field is HTMLInputElement | HTMLTextAreaElement} */
const isInput = (field) => "selectionStart" in field;

/** The `EditorView` of CodeMirror in an editor of FEEL. @param {HTMLElement} field */
const viewOf = (field) => /** @type {any} */ (field).cmTile?.root.view;

/** The text before the caret, in an editor that of its line; null if that is not known. @param {Field} field */
function textBefore(field) {
  if (isInput(field)) return field.selectionStart === null ? null : field.value.slice(0, field.selectionStart);
  const { state } = viewOf(field) ?? {};
  const { head, empty } = state?.selection.main ?? {};
  const line = empty && state.doc.lineAt(head);
  return line ? line.text.slice(0, head - line.from) : null;
}

/** Write a word in place of the last characters before the caret. @param {Field} field */
function replace(field, length, word) {
  if (isInput(field)) {
    const end = field.selectionStart ?? 0;
    field.setRangeText(word, end - length, end, "end");
    field.dispatchEvent(new Event("input", { bubbles: true }));
    return;
  }
  const view = viewOf(field);
  const { head } = view.state.selection.main;
  const from = head - length;
  view.dispatch({ changes: { from, to: head, insert: word }, selection: { anchor: from + word.length } });
}

/**
 * What a field of the panel is for: one of `FIELDS`, or the name of an extension property, which stands beside it or is
 * that of an entry of a template.
 *
 * @param {Field} field @param {(entry: string) => string} template the property of a template's entry
 */
function purpose(field, template) {
  const id = field.id.replace(PANEL, "");
  if (!isInput(field)) return id === "exampleJson" ? "" : "feel";
  if (FIELDS[id]) return FIELDS[id];
  const name = /^(.*-extensionProperty-\d+-)value$/.exec(id);
  if (name) return /** @type {any} */ (document.getElementById(`${PANEL}${name[1]}name`))?.value ?? "";
  return id.startsWith("custom-entry-") ? template(field.labels?.[0]?.textContent ?? "") : "";
}

export class Completion {
  /** @type {Field | null} */
  field = null;
  /** @type {[string, string][]} */
  words = [];
  length = 0; // characters that a word replaces
  chosen = 0;
  asked = 0;

  /** @param {any} edit */
  constructor(edit) {
    this.edit = edit;
    const panel = byId("properties");
    panel.addEventListener("input", ({ target }) => this.ask(/** @type {Field} */ (target)));
    addEventListener("beforeinput", (event) => this.over(event), true);
    panel.addEventListener("keydown", (event) => this.key(event), true);
    panel.addEventListener("focusout", () => this.close());
    panel.addEventListener("scroll", () => this.close());
  }

  close() {
    this.asked += 1;
    this.field = null;
    byId("words").hidden = true;
    document.body.classList.remove("completes");
  }

  get element() {
    return this.edit.modeler.get("selection").get()[0]?.businessObject;
  }

  /** The property that an entry of the element's template sets. */
  template(label) {
    const { modeler } = this.edit;
    const found = modeler.get("elementTemplates").get(modeler.get("selection").get()[0]);
    const binding = found?.properties.find((one) => one.label === label)?.binding;
    return binding?.type.startsWith("bpmn:") ? "signal" : (binding?.name ?? "");
  }

  /** @param {Field} field */
  async ask(field) {
    this.close();
    const { asked, element } = this;
    await null; // until an editor of FEEL knows what its element has
    const before = textBefore(field);
    const name = element && before !== null && purpose(field, (label) => this.template(label));
    if (!name) return;
    const command = { do: "complete", window: this.edit.exploring.window, element: element.id, field: name, before };
    const { words, length } = await source.post(command).catch(() => ({ words: [], length: 0 }));
    if (asked !== this.asked || !words.length) return;
    Object.assign(this, { field, words, length, chosen: 0 });
    this.show();
  }

  /** What is typed over a selection: Chromium would give it a style inline, which the policy forbids. */
  over(/** @type {InputEvent} */ event) {
    const view = viewOf(/** @type {any} */ (event.target));
    if (!view || event.inputType !== "insertText" || view.state.selection.main.empty) return;
    event.preventDefault();
    event.stopPropagation();
    view.dispatch(view.state.replaceSelection(event.data));
    this.ask(/** @type {HTMLElement} */ (event.target));
  }

  show() {
    if (!this.field) return;
    const row = ([word, about], number) =>
      h(
        "button",
        { role: "option", tabindex: "-1", "aria-selected": String(number === this.chosen) },
        h("b", null, word),
        h("small", null, about),
      );
    const list = byId("words");
    list.replaceChildren(...this.words.map(row));
    [...list.children].forEach((one, number) =>
      one.addEventListener("pointerdown", (event) => {
        event.preventDefault(); // the field keeps the focus
        this.take(number);
      }),
    );
    const { left, bottom, top, width } = this.field.getBoundingClientRect();
    list.hidden = false;
    document.body.classList.add("completes"); // instead of the list of the editor of FEEL
    list.style.left = `${left}px`;
    list.style.width = `${width}px`;
    const below = bottom + list.offsetHeight < innerHeight;
    list.style.top = `${below ? bottom : top - list.offsetHeight}px`;
    list.children[this.chosen].scrollIntoView({ block: "nearest" });
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (!this.field) return;
    const by = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (by) {
      this.chosen = (this.chosen + by + this.words.length) % this.words.length;
      this.show();
    } else if (event.key === "Enter" || event.key === "Tab") this.take(this.chosen);
    else if (event.key === "Escape") this.close();
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  take(number) {
    const { field, length, words } = this;
    this.close();
    if (field) replace(field, length, words[number][0]);
  }
}
