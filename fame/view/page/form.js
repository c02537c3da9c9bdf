// Forms: fields with their kind and limits become inputs, which the browser validates; a dialog gives the values.

/**
 * @import {Field} from "./types.js"
 *
 * @typedef {[shown: HTMLElement, read: () => any, focus: HTMLElement]} Input what is shown for a field, what reads its
 *   value, and what takes the focus
 */
import { h } from "./dom.js";

/** The type of the input for a kind of field. */
const INPUTS = {
  text: "text",
  number: "number",
  integer: "number",
  date: "date",
  time: "time",
  datetime: "datetime-local",
  value: "text",
};

let fresh = 0;

/** A value as somebody types it where no type is known: a number, true, false, a list, or else text. */
export function guessed(text) {
  try {
    return JSON.parse(text);
  } catch {
    return text;
  }
}

/**
 * The inputs of a field {key, label, kind, required, min, max, minLength, maxLength, pattern, options, value, unit,
 * help}.
 *
 * @param {Field} field
 * @returns {Input}
 */
function made(field) {
  const { kind = "text" } = field;
  if (kind === "select") return select(field);
  if (kind === "radio") return radio(field);
  if (kind === "checkbox") {
    const box = h("input", { type: "checkbox", checked: field.value === true, required: Boolean(field.required) });
    return [box, () => box.checked, box];
  }
  if (kind === "textarea") {
    const { required, minLength, maxLength } = field;
    const area = h("textarea", { required, rows: 3, minlength: minLength, maxlength: maxLength });
    area.value = field.value ?? "";
    return [area, () => (area.value === "" ? undefined : area.value), area];
  }
  return line(field);
}

/**
 * @param {Field} field
 * @returns {Input}
 */
function select({ options = [], required, value }) {
  const pick = h(
    "select",
    { required },
    required && value === undefined ? h("option", { value: "" }, "") : null,
    options.map(([of, text]) => h("option", { value: JSON.stringify(of) }, text)),
  );
  if (value !== undefined) pick.value = JSON.stringify(value);
  return [pick, () => (pick.value === "" ? undefined : JSON.parse(pick.value)), pick];
}

/**
 * @param {Field} field
 * @returns {Input}
 */
function radio({ label, options = [], required, value }) {
  const name = `radio-${(fresh += 1)}`;
  const inputs = options.map(([of]) =>
    h("input", { type: "radio", name, value: JSON.stringify(of), checked: of === value, required }),
  );
  const group = h(
    "div",
    { cls: "choices", role: "radiogroup", "aria-label": label },
    inputs.map((input, at) => h("label", { cls: "choice" }, input, options[at][1])),
  );
  const read = () => {
    const on = inputs.find((input) => input.checked);
    return on ? JSON.parse(on.value) : undefined;
  };
  return [group, read, inputs[0]];
}

/**
 * The input of one line: a text, a number, a date, or a value of no known type.
 *
 * @param {Field} field
 * @returns {Input}
 */
function line(field) {
  const { kind = "text", value } = field;
  const integer = kind === "integer";
  const numeric = kind === "number" || integer;
  const input = h("input", {
    required: field.required,
    type: INPUTS[kind] ?? "text",
    autocomplete: "off",
    spellcheck: "false",
    placeholder: field.hint,
    min: field.min,
    max: field.max,
    step: numeric ? (field.step ?? (integer ? 1 : "any")) : null,
    minlength: field.minLength,
    maxlength: field.maxLength,
    pattern: numeric ? null : field.pattern,
    inputmode: integer ? "numeric" : numeric ? "decimal" : null,
  });
  if (value !== undefined && value !== null)
    input.value = kind === "value" && typeof value !== "string" ? JSON.stringify(value) : String(value);
  const read = () => (numeric ? input.valueAsNumber : kind === "value" ? guessed(input.value) : input.value);
  return [input, () => (input.value === "" ? undefined : read()), input];
}

/**
 * The parts of a form for some fields, and what reads their values: by key, of dotted keys as objects inside objects.
 *
 * @param {Field[]} fields
 */
export function formOf(fields) {
  const parts = [];
  const readers = [];
  /** @type {HTMLElement | null} */
  let first = null;
  for (const field of fields) {
    if (field.kind === "note" || field.kind === "other") {
      parts.push(h("p", { cls: field.kind === "other" ? "found warning" : "quiet" }, field.label));
      continue;
    }
    const [shown, read, focus] = made(field);
    parts.push(labelled(field, shown), field.help ? h("small", { cls: "quiet" }, field.help) : null);
    readers.push([field.key, read]);
    first ??= focus;
  }
  return { parts, values: () => nested(readers.map(([key, read]) => [key, read()])), first };
}

function labelled(field, shown) {
  const label = [
    field.label,
    field.unit ? ` (${field.unit})` : "",
    field.required ? h("span", { cls: "required", title: "required" }, " *") : null,
  ];
  return field.kind === "radio"
    ? h("div", { cls: "field" }, h("span", null, label), shown)
    : h("label", { cls: `field ${field.kind}` }, h("span", null, label), shown);
}

/** An object of [key, value]: dotted keys are objects inside objects, undefined values are left out. */
function nested(pairs) {
  const found = {};
  for (const [key, value] of pairs) {
    if (value === undefined) continue;
    const path = key.split(/[./]/); // "/x" is beside the values: no name of a variable
    let at = found;
    for (const name of path.slice(0, -1)) at = at[name] ??= {};
    at[path.at(-1)] = value;
  }
  return found;
}

/**
 * Ask for the values of fields in a dialog. Gives them, or null if somebody cancels.
 *
 * @param {string} title @param {Field[]} fields @param {string} action
 * @param {import("./dom.js").Child} [text]
 * @returns {Promise<Object<string, any> | null>}
 */
export function ask(title, fields, action, text = []) {
  const { parts, values, first } = formOf(fields);
  /** @type {Object<string, any> | null} */
  let answer = null;
  const take = () => {
    answer = values();
  };
  const buttons = h(
    "div",
    { cls: "row end" },
    h("button", { type: "button", cls: "text", onclick: () => dialog.close() }, "Cancel"),
    h("button", { type: "submit", cls: "text strong" }, action),
  );
  const form = h("form", { method: "dialog", onsubmit: take }, h("h2", null, title), text, parts, buttons);
  const dialog = h("dialog", { cls: "ask", "aria-label": title }, form);
  document.body.append(dialog);
  dialog.showModal();
  first?.focus();
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => {
      resolve(answer);
      dialog.remove();
    });
  });
}
