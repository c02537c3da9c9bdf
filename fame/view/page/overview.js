// The whole collaboration, small: pools, what was done in them, tokens, and the part that the diagram shows. Of robots
// that have models of their own, all of these.

/** @import {Diagram} from "./diagram.js" */
/** @import {Box} from "./types.js" */
import { css, h, isDark, robotColour, sharp } from "./dom.js";
import { counted } from "./store.js";

const TALL = 84; // px at most
const GAP = 40; // between two drawings, in units of theirs
const TOKEN = 3.5; // px

/** The tokens on a plane, by element, of those that are `wanted` (robot, scope). */
export function tokensIn(plane, state, wanted) {
  const tokens = new Map();
  for (const token of state.tokens.values()) {
    if (!plane.shapes.has(token.e) || !wanted(token.r, token.s)) continue;
    if (!tokens.has(token.e)) tokens.set(token.e, []);
    tokens.get(token.e).push(token);
  }
  return tokens;
}

/** What was done on a plane, by element: [completed, failed, cancelled], of a robot or, if that is -1, of all. */
export function countsIn(plane, state, robot) {
  const counts = new Map();
  for (const [key, [done, failed, cancelled]] of state.counts) {
    const [r, e] = counted(key);
    if ((robot >= 0 && r !== robot) || !plane.groups.has(e)) continue;
    const sum = counts.get(e) ?? [0, 0, 0];
    counts.set(e, [sum[0] + done, sum[1] + failed, sum[2] + cancelled]);
  }
  return counts;
}

export class Overview {
  /** @param {Diagram} diagram */
  constructor(diagram) {
    this.diagram = diagram;
    this.sheets = []; // {number, plane, top}: drawings, one below the other
    this.scale = 1;
    this.canvas = h("canvas", {
      cls: "whole",
      role: "img",
      "aria-label": "The whole diagram, and the part that is shown",
      onpointerdown: (event) => {
        this.canvas.setPointerCapture(event.pointerId);
        this.goTo(event);
      },
      onpointermove: (event) => this.canvas.hasPointerCapture(event.pointerId) && this.goTo(event),
    });
  }

  /** The planes of what the robots run, if the one that is shown is among them: else that alone. */
  numbers() {
    const { diagram } = this;
    const roots = new Set(diagram.app.mission.order.map((r) => diagram.planeOf(r)));
    return roots.has(diagram.plane) ? [...roots].filter((number) => number >= 0) : [diagram.plane];
  }

  update(state) {
    const { diagram } = this;
    const numbers = this.numbers();
    if (numbers.some((number) => !diagram.planes.has(number))) {
      Promise.all(numbers.map((number) => diagram.load(number))).then(
        () => diagram.app.redraw(),
        () => {}, // the server has ended
      );
      return;
    }
    let top = 0;
    this.sheets = numbers.map((number) => {
      const plane = diagram.planes.get(number);
      const sheet = { number, plane, top };
      top += plane.height + GAP;
      return sheet;
    });
    const needed = this.isNeeded();
    if (this.canvas.hidden === needed) this.canvas.hidden = !needed;
    if (needed && state !== null) this.draw(state, top - GAP);
  }

  /** Whether some of it is out of sight. */
  isNeeded() {
    const { view, app } = this.diagram;
    const [x, y, width, height] = view.sight();
    const whole = x <= 0 && y <= 0 && x + width >= view.width && y + height >= view.height;
    return app.mission.kind !== "model" && (this.sheets.length > 1 || !whole);
  }

  draw(state, tall) {
    const sheets = this.sheets.map((sheet) => ({
      ...sheet,
      tokens: tokensIn(sheet.plane, state, () => true),
      counts: countsIn(sheet.plane, state, -1),
    }));
    const room = this.diagram.paper.clientWidth - 16;
    const said = sheets.map(({ tokens, counts }) => [
      [...tokens].map(([e, held]) => [e, ...held.map((one) => one.r)]),
      [...counts],
    ]);
    const key = JSON.stringify([
      said,
      room,
      tall,
      isDark(),
      this.diagram.plane,
      this.diagram.view.sight().map(Math.round),
    ]);
    if (key === this.key) return;
    this.key = key;
    const widest = Math.max(...sheets.map(({ plane }) => plane.width));
    this.scale = Math.min(TALL / tall, room / widest);
    const pen = sharp(this.canvas, widest * this.scale, tall * this.scale);
    pen.clearRect(0, 0, room, TALL);
    for (const sheet of sheets) this.drawSheet(pen, sheet);
  }

  drawSheet(pen, { number, plane, top, tokens, counts }) {
    const { scale } = this;
    const placed = ([x, y, width, height]) =>
      /** @type {Box} */ ([x * scale, (y + top) * scale, width * scale, height * scale]);
    for (const [element, box] of plane.shapes) {
      const frame = plane.groups.get(element)?.classList.contains("frame");
      const [done, failed] = counts.get(element) ?? [0, 0];
      pen.fillStyle = css(tokens.has(element) ? "--active" : failed ? "--failed" : done ? "--completed" : "--band");
      pen.strokeStyle = css("--muted");
      pen.lineWidth = 0.75;
      if (frame) pen.strokeRect(...placed(box));
      else pen.fillRect(...placed(box));
    }
    for (const [element, held] of tokens) {
      const [x, y, width, height] = placed(plane.shapes.get(element));
      pen.fillStyle = robotColour(held[0].r);
      pen.beginPath();
      pen.arc(x + width / 2, y + height / 2, TOKEN, 0, 2 * Math.PI);
      pen.fill();
    }
    if (number !== this.diagram.plane) return;
    pen.strokeStyle = css("--accent");
    pen.lineWidth = 2;
    const [left, upper, wide, high] = this.diagram.view.sight();
    const [x, y] = [Math.max(0, left), Math.max(0, upper)];
    const size = [Math.min(plane.width, left + wide) - x, Math.min(plane.height, upper + high) - y];
    pen.strokeRect(...placed([x, y, size[0], size[1]]));
  }

  /** Show the place of the overview that the pointer is at. */
  async goTo(event) {
    const { left, top } = this.canvas.getBoundingClientRect();
    const [x, y] = [(event.clientX - left) / this.scale, (event.clientY - top) / this.scale];
    const sheet = this.sheets.findLast((one) => one.top <= y) ?? this.sheets[0];
    if (sheet.number !== this.diagram.plane) {
      this.diagram.trail = [];
      await this.diagram.open(sheet.number);
    }
    this.diagram.opening = false;
    this.diagram.view.centre([x, y - sheet.top]);
    this.diagram.app.redraw();
  }
}
