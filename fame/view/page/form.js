// Forms: fields with their kind and limits become inputs, which the browser validates; a dialog gives the values.

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
 */
function made(field) {
  const { kind = "text", options = [], required, value } = field;
  const common = { required: Boolean(required), "aria-describedby": null };
  if (kind === "select") {
    const pick = h(
      "select",
      common,
      required && value === undefined ? h("option", { value: "" }, "") : null,
      options.map(([of, text]) => h("option", { value: JSON.stringify(of) }, text)),
    );
    if (value !== undefined) pick.value = JSON.stringify(value);
    return [pick, () => (pick.value === "" ? undefined : JSON.parse(pick.value)), pick];
  }
  if (kind === "radio") {
    const name = `radio-${(fresh += 1)}`;
    const inputs = options.map(([of]) =>
      h("input", {
        type: "radio",
        name,
        value: JSON.stringify(of),
        checked: of === value,
        required: Boolean(required),
      }),
    );
    const group = h(
      "div",
      { cls: "choices", role: "radiogroup", "aria-label": field.label },
      inputs.map((input, at) => h("label", { cls: "choice" }, input, options[at][1])),
    );
    return [
      group,
      () => {
        const on = inputs.find((input) => input.checked);
        return on ? JSON.parse(on.value) : undefined;
      },
      inputs[0],
    ];
  }
  if (kind === "checkbox") {
    const box = h("input", { type: "checkbox", checked: value === true, required: Boolean(required) });
    return [box, () => box.checked, box];
  }
  if (kind === "textarea") {
    const area = h("textarea", { ...common, rows: 3, minlength: field.minLength, maxlength: field.maxLength });
    area.value = value ?? "";
    return [area, () => (area.value === "" ? undefined : area.value), area];
  }
  const numeric = kind === "number" || kind === "integer";
  const input = h("input", {
    ...common,
    type: INPUTS[kind] ?? "text",
    autocomplete: "off",
    spellcheck: "false",
    placeholder: field.hint,
    min: field.min,
    max: field.max,
    step: numeric ? (field.step ?? (kind === "integer" ? 1 : "any")) : null,
    minlength: field.minLength,
    maxlength: field.maxLength,
    pattern: numeric ? null : field.pattern,
    inputmode: kind === "integer" ? "numeric" : kind === "number" ? "decimal" : null,
  });
  if (value !== undefined && value !== null)
    input.value = kind === "value" && typeof value !== "string" ? JSON.stringify(value) : String(value);
  return [
    input,
    () =>
      input.value === ""
        ? undefined
        : numeric
          ? input.valueAsNumber
          : kind === "value"
            ? guessed(input.value)
            : input.value,
    input,
  ];
}

/**
 * The parts of a form for some fields, and what reads their values: by key, of dotted keys as objects inside objects.
 */
export function formOf(fields) {
  const parts = [];
  const readers = [];
  let first = null;
  for (const field of fields) {
    if (field.kind === "note" || field.kind === "other") {
      parts.push(h("p", { cls: field.kind === "other" ? "found warning" : "quiet" }, field.label));
      continue;
    }
    const [shown, read, focus] = made(field);
    const label = [
      field.label,
      field.unit ? ` (${field.unit})` : "",
      field.required ? h("span", { cls: "required", title: "required" }, " *") : null,
    ];
    parts.push(
      field.kind === "radio"
        ? h("div", { cls: "field" }, h("span", null, label), shown)
        : h("label", { cls: `field ${field.kind}` }, h("span", null, label), shown),
      field.help ? h("small", { cls: "quiet" }, field.help) : null,
    );
    readers.push([field.key, read]);
    first ??= focus;
  }
  const values = () => {
    const found = {};
    for (const [key, read] of readers) {
      const value = read();
      const path = key.split(/[./]/); // "/x" is beside the values: no name of a variable
      if (value === undefined) continue;
      let at = found;
      for (const name of path.slice(0, -1)) at = at[name] ??= {};
      at[path.at(-1)] = value;
    }
    return found;
  };
  return { parts, values, first };
}

/** Ask for the values of fields in a dialog. Gives them, or null if somebody cancels. */
export function ask(title, fields, action, text = []) {
  return new Promise((resolve) => {
    const { parts, values, first } = formOf(fields);
    let answer = null;
    const form = h(
      "form",
      {
        method: "dialog",
        onsubmit: () => {
          answer = values();
        },
      },
      h("h2", null, title),
      text,
      parts,
      h(
        "div",
        { cls: "row end" },
        h("button", { type: "button", cls: "text", onclick: () => dialog.close() }, "Cancel"),
        h("button", { type: "submit", cls: "text strong" }, action),
      ),
    );
    const dialog = h(
      "dialog",
      {
        cls: "ask",
        "aria-label": title,
        onclose: () => {
          resolve(answer);
          dialog.remove();
        },
      },
      form,
    );
    document.body.append(dialog);
    dialog.showModal();
    first?.focus();
  });
}
