// What a person does at a token: completes a task with a form, retries, skips, sets, moves. Buttons wherever the
// token is shown.

/** @import {App} from "./main.js" */
import { h } from "./dom.js";
import { ask, guessed } from "./form.js";
import { nameOf, needsSomebody } from "./roster.js";

const RESULTS = [
  {
    key: "lines",
    label: "Results",
    kind: "textarea",
    help: "One a line, as approved = true. The model does not say which ones it needs.",
  },
];
const OTHERS = { key: "/lines", label: "Other variables", kind: "textarea", help: "One a line, as speed = 0.5." };

/** Results as somebody types them: a name and a value in each line. */
const results = (text) =>
  Object.fromEntries(
    text
      .split("\n")
      .map((line) => line.split(/=(.*)/s, 2).map((part) => part.trim()))
      .filter(([name, value]) => name && value !== undefined)
      .map(([name, value]) => [name, guessed(value)]),
  );

export class Acts {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
  }

  /** Whether an open task or incident is for whom this page is. */
  isMine(wait) {
    const { person } = this.app.mission;
    const { users = [], groups = [] } = this.app.mission.elements[wait.e] ?? {};
    return (
      !person ||
      (wait.kind === "user" &&
        (!(users.length + groups.length) || users.includes(person.user) || groups.includes(person.role)))
    );
  }

  can(act) {
    return this.app.control.can.has(act) && !this.app.control.status?.over;
  }

  send(r, act, more) {
    return this.app.control.send({ do: act, robot: this.app.mission.robots[r].name, ...more });
  }

  /** The buttons for a token of a robot; those for repair stand behind the one that is most often right. */
  buttons(r, wait) {
    const element = this.app.mission.elements[wait.e];
    const parts = [];
    const button = (text, action, cls = "") => h("button", { cls: `text ${cls}`, onclick: action }, text);
    if (element === undefined || !this.isMine(wait)) return null;
    const incident = wait.kind === "incident";
    const task = wait.kind === "user" || /receiveTask/.test(element.tag);
    if (incident && this.can("retry"))
      parts.push(
        button("Retry", () => this.send(r, "retry", { element: element.id }), "strong"),
        button("Set and retry …", () => this.retry(r, wait)),
      );
    else if (task && !incident && this.can("complete")) {
      const asks = this.fields(r, wait).length > 0;
      parts.push(
        button(asks ? "Complete …" : "Complete", () => this.complete(r, wait, asks), "strong"),
        asks ? null : button("With results …", () => this.complete(r, wait, true)),
      );
    }
    if ((incident || task) && this.can("skip"))
      parts.push(button("Skip", () => this.send(r, "skip", { element: element.id })));
    if (incident && this.can("take_over")) parts.push(button("Take over", () => this.app.steer.takeOver(r)));
    if (this.can("move")) parts.push(button("Move …", () => this.move(r, wait)));
    return parts.length ? h("div", { cls: "row acts" }, parts) : null;
  }

  /** The buttons of the tokens at an element of a robot, or of all. */
  atElement(state, number, robot) {
    return [...state.waits].flatMap(([r, waits]) =>
      robot >= 0 && robot !== r
        ? []
        : [...waits.values()]
            .filter((wait) => wait.e === number && needsSomebody(wait))
            .map((wait) => this.buttons(r, wait)),
    );
  }

  /** The fields of a task's form, with the values that its variables have now. */
  fields(r, wait) {
    const { form = [] } = this.app.mission.elements[wait.e] ?? {};
    return form.map((field) => {
      const now = field.key === undefined ? undefined : this.app.state?.valueOf(r, wait.scope, field.key);
      return now === undefined ? field : { ...field, value: now };
    });
  }

  async complete(r, wait, asks) {
    const element = this.app.mission.elements[wait.e];
    const fields = this.fields(r, wait);
    const given = fields.length ? fields : RESULTS;
    const found = asks
      ? await ask(nameOf(this.app, wait.e), given, "Complete", element.doc ? h("p", null, element.doc) : [])
      : {};
    if (found && given === RESULTS && asks)
      return this.send(r, "complete", { element: element.id, value: JSON.stringify(results(found.lines ?? "")) });
    return found ? this.send(r, "complete", { element: element.id, value: JSON.stringify(found) }) : null;
  }

  async retry(r, wait) {
    const { elements } = this.app.mission;
    const fields = [...this.variables(r, wait), OTHERS];
    const found = await ask(
      `Retry ${nameOf(this.app, wait.e)}`,
      fields,
      "Retry",
      h("p", { cls: "quiet" }, "Set what should be different this time."),
    );
    if (!found) return;
    const { "": { lines = "" } = {}, ...given } = found;
    const before = (name) => JSON.stringify(this.app.state?.valueOf(r, wait.scope, name));
    const changed = Object.fromEntries(
      Object.entries(given).filter(([name, value]) => JSON.stringify(value) !== before(name)),
    );
    this.send(r, "retry", { element: elements[wait.e].id, value: JSON.stringify({ ...changed, ...results(lines) }) });
  }

  /** A field for each simple variable that an element sees, with its value; those that it names come first. */
  variables(r, wait) {
    const { script = "", condition = "" } = this.app.mission.elements[wait.e] ?? {};
    const known = new Map();
    for (const [name, value] of this.app.state?.visible(r, wait.scope) ?? [])
      if (!known.has(name) && (value === null || typeof value !== "object")) known.set(name, value);
    const words = new Set(`${script} ${condition}`.split(/[^\w]+/));
    const rank = (name) => (words.has(name) ? 0 : 1);
    return [...known]
      .sort(([a], [b]) => rank(a) - rank(b) || a.localeCompare(b))
      .map(([name, value]) => ({
        key: name,
        label: name,
        value,
        kind: typeof value === "boolean" ? "checkbox" : typeof value === "number" ? "number" : "value",
      }));
  }

  async move(r, wait) {
    const { elements } = this.app.mission;
    const from = elements[wait.e];
    /** @type {[value: string, text: string][]} */
    const others = elements.flatMap((one, number) =>
      one.body === from.body &&
      (one.file ?? 0) === (from.file ?? 0) &&
      one.id !== from.id &&
      !/Flow|boundary|process/i.test(one.tag)
        ? [[one.id, nameOf(this.app, number)]]
        : [],
    );
    const found = await ask(
      `Move the token from ${nameOf(this.app, wait.e)}`,
      [{ key: "to", label: "To", kind: "select", options: others, required: true }],
      "Move",
    );
    if (found) this.send(r, "move", { element: from.id, to: found.to });
  }
}
