// What the page shows: the team and what people have to do, or the mission in detail. On phones and tablets one panel
// at a time.

/** @import {App} from "./main.js" */
/** @import {Picture} from "./dom.js" */
import { h, icon, keep, kept } from "./dom.js";
import { source } from "./source.js";

/** @type {[name: string, text: string, picture: Picture][]} */
const TABS = [
  ["team", "Team", "team"],
  ["needs", "Needs you", "person"],
  ["map", "Map", "map"],
  ["diagram", "Diagram", "flow"],
  ["log", "Log", "list"],
];
const WIDE = matchMedia("(min-width: 1101px)");
const TOGETHER = { team: ["team", "needs", "map"], diagram: ["diagram", "map", "log"] }; // on a desk
const GROUP = { team: "team", needs: "team", map: "diagram", diagram: "diagram", log: "diagram" };

export class Tabs {
  /** @param {HTMLElement} root @param {App} app */
  constructor(root, app) {
    this.app = app;
    this.root = root;
    this.buttons = new Map(
      TABS.map(([name, text, picture]) => [
        name,
        h(
          "button",
          { role: "tab", dataset: { tab: name }, onclick: () => this.choose(name) },
          icon(picture),
          h("span", null, text),
          h("b", { cls: "count", hidden: true }),
        ),
      ]),
    );
    root.append(...this.buttons.values());
    WIDE.addEventListener("change", () => this.changed());
    this.choose(kept("sessionStorage", "fame-tab") ?? source.tab, false);
  }

  choose(name, stays = true) {
    this.name = name;
    if (stays) keep("sessionStorage", "fame-tab", name);
    this.changed();
  }

  changed() {
    document.body.dataset.tab = this.name;
    document.body.dataset.group = GROUP[this.name];
    for (const [name, button] of this.buttons) {
      if (name === "diagram") button.querySelector("span").textContent = WIDE.matches ? "Mission" : "Diagram";
      const on = WIDE.matches ? name === GROUP[this.name] : name === this.name;
      button.setAttribute("aria-selected", String(on));
    }
    this.app.redraw();
  }

  /** What can be seen depends on it. */
  get key() {
    return `${this.name} ${WIDE.matches}`;
  }

  /** Whether a panel can be seen. */
  shows(name) {
    if (this.app.mission.kind === "model") return name === "diagram" || name === "log";
    return WIDE.matches ? TOGETHER[GROUP[this.name]].includes(name) : this.name === name;
  }

  badge(name, count) {
    for (const of of [name, "team"]) {
      const badge = this.buttons.get(of).querySelector(".count");
      badge.textContent = String(count);
      badge.hidden = !count || (of === "team" && !WIDE.matches);
    }
  }
}
