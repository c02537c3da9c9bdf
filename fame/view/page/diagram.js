// The diagrams: FAME's SVG, with tokens, outcomes and findings on it. Zoom, pan, and a breadcrumb into called
// processes.

/** @import {App} from "./main.js" */
import { arrange, h, s, icon, keep, kept, robotColour, show } from "./dom.js";
import { Names, Pins } from "./names.js";
import { Overview, countsIn, tokensIn } from "./overview.js";
import { TAKE, after } from "./store.js";
import { Viewport } from "./viewport.js";

const TAGS = new Set([
  "svg",
  "g",
  "rect",
  "circle",
  "ellipse",
  "path",
  "polygon",
  "polyline",
  "line",
  "text",
  "tspan",
  "title",
]);
const ATTRIBUTES = new Set([
  "x",
  "y",
  "width",
  "height",
  "rx",
  "ry",
  "cx",
  "cy",
  "r",
  "d",
  "points",
  "transform",
  "fill",
  "stroke",
  "stroke-width",
  "stroke-dasharray",
  "stroke-linecap",
  "stroke-linejoin",
  "font-size",
  "font-family",
  "text-anchor",
  "paint-order",
  "viewBox",
]);
const THEMED = { "#22242a": "var(--ink)", "#ffffff": "var(--sheet)", white: "var(--sheet)", "#d9d9dd": "var(--band)" };
const SIGNS = {
  completed: "M-3.200 .2L-.9 2.600L3.200-2.600",
  failed: "M-2.700-2.700L2.700 2.700M-2.700 2.700L2.700-2.700",
  cancelled: "M-2.100 2.100L2.100-2.100M3 0A3 3 0 1 1-3 0A3 3 0 1 1 3 0",
  waiting: "M-1.700-3V3M1.700-3V3",
  error: "M0-3.500V.6M0 3.100V3.200",
  warning: "M0-3.500V.6M0 3.100V3.200",
  note: "M0-.8V3.200M0-3.400V-3.300",
};
const OUTCOMES = ["completed", "failed", "cancelled"];
const READABLE = 0.92; // a scale at which everything can be read
const LEGIBLE = 0.6; // at which most can
const LABELS = "fame-labels";
const FLIGHT = 0.45; // seconds on the wall that a token takes along flows

/** A copy of a drawing from known tags and attributes alone: whatever else a file holds is left out. */
function imported(node) {
  if (node.nodeType === Node.TEXT_NODE) return document.createTextNode(node.data);
  if (node.nodeType !== Node.ELEMENT_NODE || !TAGS.has(node.localName)) return null;
  const copy = s(node.localName);
  for (const { name, value } of node.attributes) {
    if (name === "id") copy.dataset.id = value;
    else if (ATTRIBUTES.has(name) && !/url\s*\(/i.test(value)) copy.setAttribute(name, THEMED[value] ?? value);
  }
  for (const child of node.childNodes) {
    const made = imported(child);
    if (made !== null) copy.append(made);
  }
  return copy;
}

function length(points) {
  let sum = 0;
  for (let at = 1; at < points.length; at += 1)
    sum += Math.hypot(points[at][0] - points[at - 1][0], points[at][1] - points[at - 1][1]);
  return sum;
}

/** The point at a part (0 to 1) of the way along a line. */
function along(points, part) {
  let left = part * length(points);
  for (let at = 1; at < points.length; at += 1) {
    const [ax, ay] = points[at - 1];
    const [bx, by] = points[at];
    const far = Math.hypot(bx - ax, by - ay);
    if (far >= left && far > 0) return [ax + ((bx - ax) * left) / far, ay + ((by - ay) * left) / far];
    left -= far;
  }
  return points[points.length - 1];
}

/** Text on a disc for a robot: its number, or nothing where a pool has one robot. */
const numeral = (name) => /_(\d+)$/.exec(name)?.[1] ?? "";

/** The parts of a drawing, without its background. */
function drawingOf(svg) {
  const drawing = s("g", { cls: "drawing" });
  for (const child of new DOMParser().parseFromString(svg, "image/svg+xml").documentElement.childNodes) {
    const made = imported(child);
    if (made !== null && !(made.localName === "rect" && made.getAttribute("width") === "100%")) drawing.append(made);
  }
  return drawing;
}

/** The flows on a plane that were taken after an instant: places in the columns of events, for each token in order. */
function legsOf(plane, state, from, wanted) {
  const { t, r, s: scopes, e, w } = state.block.columns;
  const legs = new Map();
  for (let at = Math.max(after(t, from), state.position - MOST_FLIGHTS); at < state.position; at += 1) {
    if (w[at] !== TAKE || !plane.edges.has(e[at]) || !wanted(r[at], scopes[at])) continue;
    const key = `${r[at]}/${t[at]}`;
    if (!legs.has(key)) legs.set(key, []);
    legs.get(key).push(at);
  }
  return legs.values();
}

/**
 * How to get from places on a plane to those in its drawing, which is moved.
 *
 * @param {Element} drawing
 * @returns {[dx: number, dy: number]}
 */
function shiftOf(drawing) {
  const moved = /translate\(([-\d.]+)[ ,]([-\d.]+)/.exec(drawing.firstElementChild?.getAttribute("transform") ?? "");
  return moved === null ? [0, 0] : [-Number(moved[1]), -Number(moved[2])];
}

const MOST_FLIGHTS = 400; // of the last events, those that are looked at for tokens on their way

export class Diagram {
  /** @param {HTMLElement} root @param {App} app */
  constructor(root, app) {
    this.app = app;
    this.planes = new Map();
    this.coming = new Map(); // promises of these
    this.trail = []; // [plane, opener]: how one came here
    this.plane = -1;
    /** @type {any} */
    this.drawn = undefined; // on the sheet: `current`, until the diagram of another mission is there
    this.lit = new Set(); // flows that are taken at the instant shown
    this.shown = undefined; // that instant
    this.opening = false; // whether the part that is shown first has to be found
    this.cuts = kept("localStorage", LABELS) !== "off";
    this.crumbs = h("nav", { cls: "crumbs", "aria-label": "Breadcrumb" });
    this.tools = this.toolbar();
    this.paper = s("svg", { cls: "paper", tabindex: 0, role: "img", "aria-label": "Diagram" });
    this.sheet = s("g");
    this.paper.append(this.sheet);
    this.legend = h("div", { cls: "legend" });
    this.empty = h("div", { cls: "empty", hidden: true });
    this.overview = new Overview(this);
    const foot = h("div", { cls: "foot" }, this.legend, this.overview.canvas);
    root.append(h("div", { cls: "bar" }, this.crumbs, this.tools), this.paper, this.empty, foot);
    this.view = new Viewport(this.paper, (x, y, scale) => this.placed(x, y, scale), { below: 18, beside: 14 });
    // elements of another mission have other numbers
    this.paper.addEventListener("click", (event) => this.current && !this.view.moved && this.clicked(event));
    this.paper.addEventListener("dblclick", (event) => this.current && this.opened(event));
    new ResizeObserver(() => this.view.resized()).observe(this.paper);
    this.cutLabels(this.cuts);
    this.explain();
  }

  toolbar() {
    this.labels = h(
      "button",
      { title: "Names at small zoom, cut short", onclick: () => this.cutLabels(!this.cuts) },
      icon("text"),
    );
    return h(
      "div",
      { cls: "tools" },
      this.labels,
      h("button", { title: "Zoom in", onclick: () => this.view.zoom(1.3) }, icon("plus")),
      h("button", { title: "Zoom out", onclick: () => this.view.zoom(1 / 1.3) }, icon("minus")),
      h("button", { title: "Fit the diagram (F)", onclick: () => this.fit() }, icon("fit")),
    );
  }

  /** Show all of the diagram. */
  fit() {
    this.opening = false;
    this.view.fit();
  }

  /** Cut names short where a shape has no room for them, or leave them out. */
  cutLabels(cuts) {
    this.cuts = cuts;
    keep("localStorage", LABELS, cuts ? "on" : "off");
    this.labels.setAttribute("aria-pressed", String(cuts));
    if (this.drawn === undefined) return;
    this.drawn.level = Infinity;
    this.view.apply();
  }

  explain() {
    const mark = (name, text) =>
      h(
        "span",
        null,
        s(
          "svg",
          { viewBox: "-9 -9 18 18", cls: `sign ${name}`, "aria-hidden": "true" },
          s("circle", { r: 8 }),
          s("path", { d: SIGNS[name] }),
        ),
        text,
      );
    show(
      this.legend,
      h(
        "span",
        null,
        s("svg", { viewBox: "-9 -9 18 18", cls: "sign token", "aria-hidden": "true" }, s("circle", { r: 6.5 })),
        "token",
      ),
      mark("completed", "completed"),
      mark("failed", "failed"),
      mark("cancelled", "cancelled"),
    );
  }

  /** The content is at a place and scale: names, badges and pins are those that can be read there. */
  placed(x, y, scale) {
    this.sheet.setAttribute("transform", `translate(${x} ${y}) scale(${scale})`);
    const { drawn } = this;
    if (drawn === undefined) return;
    if (drawn === this.current) {
      this.overview.update(this.app.state);
      drawn.chosen = this.app.mission.robots[this.app.selected.robot]?.pool;
    }
    const { width, height } = this.view.box();
    drawn.pins.place([x, y], scale, [width, height], drawn.chosen);
    const level = 2 ** (Math.floor(Math.log2(scale) * 8) / 8);
    if (level === drawn.level) return;
    drawn.level = level;
    drawn.names.fit(level, this.cuts);
    this.app.redraw();
  }

  /** How much larger what lies on the drawing has to be, so that it can be read. */
  get grow() {
    return Math.max(1, 0.9 / this.current.level);
  }

  /**
   * Zoom to the pool of the chosen robot, around what it does; without one, to all. `first`: nothing was chosen yet, so
   * where all would be too small, to the first robot that does something.
   */
  focus(glides = true, first = false) {
    const { element } = this.app.selected;
    const robot = first ? this.firstActive() : this.app.selected.robot;
    const { current } = this;
    const part = current?.shapes.get(this.app.mission.robots[robot]?.pool);
    const held = [
      element,
      ...[...(this.app.state?.tokens.values() ?? [])].filter((token) => token.r === robot).map((token) => token.e),
    ];
    const box = held.map((one) => current?.shapes.get(one)).find((one) => one && one !== part);
    this.view.focus(
      part || (first && box)
        ? {
            part,
            least: READABLE,
            about: box && [box[0] + box[2] / 2, box[1] + box[3] / 2],
            unless: first ? LEGIBLE : undefined,
          }
        : {},
      glides,
    );
  }

  /** The chosen robot, or the first that does something on the plane that is shown. */
  firstActive() {
    const { selected, mission, state } = this.app;
    const held = [...(state?.tokens.values() ?? [])].filter((token) => this.current?.shapes.has(token.e));
    const active = mission.order.find((r) => held.some((token) => token.r === r));
    return selected.robot >= 0 ? selected.robot : (active ?? mission.order[0] ?? -1);
  }

  /** Show a plane; `opener` is the call activity or sub-process that leads there. */
  async open(plane, opener = -1) {
    const known = this.trail.findIndex(([number, by]) => number === plane && by === opener);
    this.trail = known >= 0 ? this.trail.slice(0, known + 1) : [...this.trail, [plane, opener]];
    await this.draw(plane);
  }

  /** Show the plane that an element is on, as inside `openers`. */
  async reveal(element, openers = []) {
    const { elements } = this.app.mission;
    const plane = elements[element]?.plane ?? -1;
    if (plane < 0) return;
    /** @type {[plane: number, opener: number][]} */
    const trail = [[this.home(), -1]];
    for (const opener of openers) {
      const inside = elements[opener].inside;
      if (inside !== undefined && inside !== trail.at(-1)?.[0]) trail.push([inside, opener]);
    }
    if (trail.at(-1)?.[0] !== plane) trail.push([plane, -1]);
    this.trail = trail[0][0] === trail[1]?.[0] ? trail.slice(1) : trail;
    await this.draw(plane);
  }

  home() {
    return Math.max(0, this.planeOf(Math.max(0, this.app.selected.robot)));
  }

  /** The plane of what a robot runs at the time that is shown. */
  planeOf(robot) {
    const { plane = -1, planes = [] } = this.app.mission.robots[robot] ?? { plane: 0 };
    return planes.findLast(([after], place) => !place || after < this.shown)?.[1] ?? plane;
  }

  /** Where a robot ran other models before or afterwards: show the one of this time. */
  follow() {
    const root = this.trail[0]?.[0];
    const { robots } = this.app.mission;
    const robot = robots.findIndex(
      ({ planes = [] }) => planes.length > 1 && planes.some(([, plane]) => plane === root),
    );
    if (robot >= 0 && !robots.some((one, r) => this.planeOf(r) === root)) this.ofRobot(robot);
  }

  /** Where each robot has a model of its own: show that of a robot. */
  async ofRobot(robot) {
    const plane = this.planeOf(robot);
    if (plane < 0 || plane === this.trail[0]?.[0]) return;
    this.trail = [];
    await this.open(plane);
  }

  async up() {
    if (this.trail.length < 2) return;
    this.trail.pop();
    await this.draw(this.trail.at(-1)[0]);
  }

  async draw(number) {
    const { planes } = this.app.mission;
    if (number < 0 || planes[number] === undefined) {
      this.nothing(
        "This model has no diagram",
        "Draw it in Camunda Modeler or another BPMN tool: the file has the process, but no shapes.",
      );
      return;
    }
    const plane = await this.load(number);
    if (plane === undefined || this.trail.at(-1)?.[0] !== number) return; // another one is to be shown since
    this.empty.hidden = true;
    this.paper.removeAttribute("hidden");
    const changed = this.plane !== number;
    this.plane = number;
    this.current = this.drawn = plane;
    show(this.sheet, plane.drawing, plane.under, plane.over);
    show(this.paper, this.sheet, plane.pins.node);
    if (changed) {
      this.view.content(plane.width, plane.height);
      this.opening = true;
      this.focus(false, true);
    } else this.view.apply(); // the same place, drawn anew
    this.path();
    this.app.redraw();
  }

  /** A plane, with what is drawn on it; undefined if that is of a mission which was forgotten meanwhile. */
  load(number) {
    const { planes, coming } = this;
    if (!coming.has(number)) {
      const come = async () => {
        const data = await this.app.fetch(`plane/${number}.json`);
        if (planes === this.planes) planes.set(number, this.built(data));
        return planes.get(number);
      };
      coming.set(
        number,
        come().catch((error) => {
          coming.delete(number);
          throw error;
        }),
      );
    }
    return coming.get(number);
  }

  /** Another mission is to be drawn: what is shown stays until its diagram is there. */
  forget() {
    this.planes = new Map();
    this.coming = new Map();
    this.current = undefined;
  }

  nothing(title, advice) {
    this.current = this.drawn = undefined;
    this.paper.setAttribute("hidden", "");
    this.empty.hidden = false;
    show(this.empty, h("strong", null, title), h("p", null, advice));
  }

  built(data) {
    const drawing = drawingOf(data.svg);
    const groups = this.grouped(drawing, data);
    const numbered = (values) => new Map(Object.entries(values).map(([number, value]) => [Number(number), value]));
    const shapes = numbered(data.shapes);
    const pins = new Pins({ groups, shapes });
    return {
      drawing,
      groups,
      shapes,
      pins,
      names: new Names({ drawing, groups, shapes, pins, shift: shiftOf(drawing) }),
      level: Infinity,
      under: s("g", { cls: "under" }),
      over: s("g", { cls: "over" }),
      width: data.width,
      height: data.height,
      edges: numbered(data.edges),
      classes: new Map(),
      marks: new Map(),
      shown: "",
    };
  }

  /** The groups of a drawing by the numbers of their elements; each has its title, and what it is as classes. */
  grouped(drawing, { shapes, edges, frames }) {
    const { elements } = this.app.mission;
    const byId = new Map();
    for (const group of drawing.querySelectorAll("[data-id]"))
      if (!byId.has(group.dataset.id)) byId.set(group.dataset.id, group);
    const groups = new Map();
    for (const number of [...Object.keys(shapes), ...Object.keys(edges)]) {
      const group = byId.get(elements[number]?.id);
      if (group === undefined) continue;
      group.dataset.element = number;
      groups.set(Number(number), group);
    }
    for (const number of frames) groups.get(number)?.classList.add("frame");
    for (const number of Object.keys(edges)) groups.get(Number(number))?.classList.add("edge");
    for (const number of Object.keys(shapes))
      if (elements[number]?.inside >= 0) groups.get(Number(number))?.classList.add("opens");
    for (const [number, group] of groups)
      if (!group.classList.contains("frame"))
        group.append(s("title", null, elements[number]?.name || elements[number]?.id || ""));
    return groups;
  }

  path() {
    const { planes, elements } = this.app.mission;
    show(
      this.crumbs,
      this.trail.flatMap(([number, opener], place) => {
        const text = opener >= 0 ? elements[opener].name || elements[opener].id : (planes[number]?.title ?? "");
        const here = place === this.trail.length - 1;
        const link = here
          ? h("strong", null, text)
          : h(
              "button",
              {
                onclick: () => {
                  this.trail.length = place + 1;
                  this.draw(number);
                },
              },
              text,
            );
        return place > 0 ? [h("span", { "aria-hidden": "true" }, "›"), link] : [link];
      }),
    );
  }

  clicked(event) {
    const group = event.target.closest?.("[data-element]");
    const element = group === null ? -1 : Number(group.dataset.element);
    this.app.select({
      element:
        group !== null && !/^(participant|element)$/.test(this.app.mission.elements[element]?.tag) ? element : -1,
      robot: this.robotOf(element) ?? this.app.selected.robot,
    });
  }

  /** The robot of a pool that was clicked, if it has one. */
  robotOf(element) {
    const { elements, robots } = this.app.mission;
    if (elements[element]?.tag !== "participant") return undefined;
    const played = robots.filter((robot) => robot.pool === element);
    return played.length === 1 ? robots.indexOf(played[0]) : undefined;
  }

  opened(event) {
    const group = event.target.closest?.("[data-element]");
    if (group === null) return;
    const element = Number(group.dataset.element);
    const inside = this.app.mission.elements[element]?.inside;
    if (inside !== undefined && inside >= 0) this.open(inside, element);
  }

  // ---- what happens ------------------------------------------------------------------------------

  /** Show the state of the run. `flows`: whether tokens are seen to move. */
  update(state, flows) {
    this.shown = state?.time;
    this.follow();
    const plane = this.current;
    if (plane === undefined) return;
    if (this.opening && state !== null && this.view.box().width) {
      this.opening = false;
      if (this.view.target) this.focus(false, true);
    }
    this.overview.update(state);
    plane.drawing.classList.toggle("flows", flows);
    const { robot } = this.app.selected;
    const opener = this.trail.at(-1)?.[1] ?? -1;
    const wanted = (r, s) => (robot < 0 || r === robot) && (opener < 0 || state.openers(r, s).includes(opener));
    const tokens = state === null ? new Map() : tokensIn(plane, state, wanted);
    const counts = state === null ? new Map() : countsIn(plane, state, robot);
    this.mark(plane, tokens, counts);
    if (this.app.mission.heat) {
      this.app.heat.paint(plane);
      return;
    }
    this.badges(plane, tokens, counts);
    if (this.app.mission.change) this.app.change.paint(plane);
    else this.flights(plane, state, flows, wanted);
  }

  mark(plane, tokens, counts) {
    const { element } = this.app.selected;
    const { named } = this.app.timeline.properties;
    for (const [number, group] of plane.groups) {
      const [done, failed, cancelled] = counts.get(number) ?? [0, 0, 0];
      const classes = {
        "is-failed": failed > 0,
        "is-completed": !failed && done > 0,
        "is-cancelled": !failed && !done && cancelled > 0,
        "is-active": tokens.has(number),
        "is-chosen": number === element,
        "has-breakpoint": this.app.breakpoints.has(number),
        "is-named": named.has(number),
      };
      const key = Object.values(classes).map(Number).join("");
      if (plane.classes.get(number) === key) continue;
      plane.classes.set(number, key);
      for (const [name, on] of Object.entries(classes)) group.classList.toggle(name, on);
    }
  }

  badges(plane, tokens, counts) {
    const { theme } = document.documentElement.dataset;
    const look = `${theme}|${plane.level}`;
    const shown = [];
    for (const [number, box] of plane.shapes) {
      const sum = counts.get(number);
      const held = tokens.get(number);
      const findings = this.app.findingsOf(number);
      if (plane.groups.get(number)?.classList.contains("frame") && !held && !findings) continue;
      if (sum === undefined && held === undefined && findings === undefined) continue;
      const tokensAt = held?.map((token) => `${token.r}x${token.n}`) ?? "";
      const key = `${number}:${sum ?? ""}:${tokensAt}:${findings?.length ?? ""}|${look}`;
      shown.push({ number, box, sum, held, findings, key });
    }
    const key = `${shown.map((one) => one.key).join(";")}|${look}`;
    if (plane.shown === key) return;
    plane.shown = key;
    const known = plane.marks;
    plane.marks = new Map(
      shown.map((one) => {
        const kept = known.get(one.number);
        return [one.number, kept?.key === one.key ? kept : this.badge(one)];
      }),
    );
    arrange(
      plane.under,
      [...plane.marks.values()].flatMap((mark) => mark.nodes),
    );
  }

  /** What is drawn at a shape: {key: of what it shows, nodes}. */
  badge({ box, sum, held, findings, key }) {
    const nodes = [
      ...(sum !== undefined ? this.outcomes(box, sum) : []),
      ...(held !== undefined ? this.discs(box, held) : []),
      ...(findings !== undefined ? [this.finding(box, findings)] : []),
    ];
    return { key, nodes };
  }

  outcomes([x, y, width], sum) {
    const found = [];
    const { grow } = this;
    if (grow > 1 && 50 * grow > width) return found; // the name needs the room; the colour says it too
    let right = x + width + 9;
    for (const outcome of [1, 2, 0]) {
      if (sum[outcome] <= 0) continue;
      const name = OUTCOMES[outcome];
      const text = String(sum[outcome]);
      const wide = 19 + 6 * text.length;
      found.push(
        s(
          "g",
          { cls: `badge ${name}`, transform: `translate(${right - wide * grow} ${y}) scale(${grow})` },
          s("title", null, `${name}: ${text}`),
          s("rect", { x: 0, y: -8, width: wide, height: 16, rx: 8 }),
          s("path", { d: SIGNS[name], transform: "translate(8.500 0)" }),
          s("text", { x: 15, y: 3.6 }, text),
        ),
      );
      right -= (wide + 2) * grow;
    }
    return found;
  }

  discs([x, y, width, height], held) {
    const byRobot = new Map();
    for (const token of held) byRobot.set(token.r, (byRobot.get(token.r) ?? 0) + token.n);
    const small = width <= 40;
    const robots = [...byRobot];
    const most = Math.max(3, Math.floor(5 / this.grow));
    const shown = robots.slice(0, most);
    return shown.map(([r, n], place) => {
      // above an event, left of its badge: its name is below
      const cx = small ? x + 4 - (shown.length - 1 - place) * 15 * this.grow : x + 3 + place * 17 * this.grow;
      return this.disc(
        r,
        n,
        cx,
        small ? y + 1 : y + height - 2,
        place === most - 1 && robots.length > most ? `+${robots.length - most + 1}` : "",
      );
    });
  }

  disc(r, n, x, y, text = "") {
    const { robots } = this.app.mission;
    const label = text || (n > 1 ? `×${n}` : numeral(robots[r]?.name ?? ""));
    return s(
      "g",
      { cls: "disc", transform: `translate(${x} ${y}) scale(${this.grow})`, "data-robot": r },
      s("title", null, `${robots[r]?.name}: ${n} token${n > 1 ? "s" : ""}`),
      s("circle", { r: 8, fill: robotColour(r) }),
      label ? s("text", { y: 3.6 }, label) : s("circle", { cls: "core", r: 2.6 }),
    );
  }

  finding([x, y], findings) {
    const worst = ["error", "warning", "note"].find((severity) => findings.some((one) => one.severity === severity));
    return s(
      "g",
      { cls: `badge ${worst}`, transform: `translate(${x} ${y}) scale(${this.grow})` },
      s("title", null, findings.map((one) => one.text).join("\n")),
      worst === "warning" ? s("path", { cls: "plate", d: "M0-9L9 7H-9Z" }) : s("circle", { r: 8 }),
      s("path", { d: SIGNS[worst] }),
    );
  }

  /** Tokens on their way: flows that were taken within the last moments, one after the other. */
  flights(plane, state, flows, wanted) {
    const found = [];
    const lit = new Set();
    if (state !== null) {
      const { t, r, e } = state.block.columns;
      const span = FLIGHT * 1e9 * this.app.player.speed;
      for (const chain of legsOf(plane, state, flows ? state.time - span : state.time - 1, wanted)) {
        chain.forEach((at, place) => {
          const group = plane.groups.get(e[at]);
          if (group !== undefined) lit.add(group);
          const part = ((state.time - t[at]) / span) * chain.length - place;
          if (!flows || part < 0 || part > 1) return;
          const [x, y] = along(plane.edges.get(e[at]), part * part * (3 - 2 * part));
          found.push(this.disc(r[at], 1, x, y));
        });
      }
    }
    for (const group of this.lit) if (!lit.has(group)) group.classList.remove("is-taken");
    for (const group of lit) if (!this.lit.has(group)) group.classList.add("is-taken");
    this.lit = lit;
    if (found.length || plane.over.firstChild !== null) show(plane.over, found);
  }
}
