// What has changed since the last commit, in words and on the diagram.

import { byId, h, icon, messageOf, renew } from "./dom.js";

const HOWS = ["added", "changed", "moved"];

export class Commits {
  open = false;

  /** @param {any} edit */
  constructor(edit) {
    this.edit = edit;
  }

  button() {
    const title = "What has changed since the last commit";
    return h("button", { id: "commits", cls: "text", title, onclick: () => this.toggle(!this.open) }, "Changes");
  }

  async toggle(open) {
    this.open = open;
    await this.update();
  }

  /** Compare again, if it is shown. */
  async update() {
    let found = { lines: [], how: {} };
    try {
      if (this.open) found = await this.edit.ask("commit");
    } catch (error) {
      this.open = false;
      this.edit.say(messageOf(error));
    }
    this.mark(found.how);
    const close = h(
      "button",
      { title: "Close", "aria-label": "Close", onclick: () => this.toggle(false) },
      icon("close"),
    );
    const words = found.lines.join("\n") || "Nothing differs.";
    renew(byId("since"), h("strong", null, "Since the last commit"), h("pre", null, words), close);
    byId("since").hidden = !this.open;
    byId("commits").setAttribute("aria-pressed", String(this.open));
  }

  /** @param {{[id: string]: string}} how */
  mark(how) {
    const [canvas, elements] = ["canvas", "elementRegistry"].map((name) => this.edit.modeler.get(name));
    for (const element of elements.getAll())
      for (const each of HOWS)
        canvas[how[element.id] === each ? "addMarker" : "removeMarker"](element, `since-${each}`);
  }
}
