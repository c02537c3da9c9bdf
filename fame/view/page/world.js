// The world from above, as in FAME's pictures: ground, obstacles, weeds, chargers, robots with their sensors and
// trails.

/** @import {App} from "./main.js" */
/**
 * @import {Point} from "./types.js"
 *
 * @typedef {[time: number, x: number, y: number]} Place of a robot
 */
import { h, icon, isDark, paint, robotColour, css, sharp, trace } from "./dom.js";
import { Viewport } from "./viewport.js";
import { overlap } from "./names.js";
import { doing } from "./roster.js";
import { after } from "./store.js";

const TAU = 2 * Math.PI;
const SMALLEST = 26;
const MOST_NAMES = 24;
const LOW = 0.2;
const LEDS = {
  red: "#ff1f1f",
  green: "#16d943",
  blue: "#2f6bff",
  yellow: "#ffd400",
  cyan: "#00d5e8",
  magenta: "#f02be0",
  white: "#ffffff",
};
const PARCEL = 0.3; // m
const LEAP = 0.5;
// m and m/s: a robot that moves further and faster is put there, as where its simulation begins again
const FASTEST = 20;
const COLOURS = {
  light: {
    ground: "#f6f4ee",
    lines: "#e4e0d5",
    ink: "#2b2f36",
    faint: "#62676f",
    obstacle: "#8a9099",
    edge: "#5d636c",
    target: "#e0a100",
    targetEdge: "#7a5800",
    weed: "#4f9a2f",
    weedEdge: "#2c5d17",
    charger: "#1b7f8c",
    station: "#7b5ea7",
    parcel: "#c98d4b",
    parcelEdge: "#7a4d1f",
    door: "#b03a2e",
    stubble: "#d9cfae",
    paper: "#ffffff",
    fixture: "#d3d6da",
  },
  dark: {
    ground: "#20242a",
    lines: "#2d333b",
    ink: "#cfd5dc",
    faint: "#9aa3ad",
    obstacle: "#69717c",
    edge: "#8f98a4",
    target: "#d9a520",
    targetEdge: "#f0cb6a",
    weed: "#5fae3d",
    weedEdge: "#a4dd86",
    charger: "#4fc3d2",
    station: "#b49ade",
    parcel: "#c98d4b",
    parcelEdge: "#f0c48e",
    door: "#e0675a",
    stubble: "#5b5540",
    paper: "#14171b",
    fixture: "#4a515b",
  },
};

const box = (x, y, length, width) =>
  [
    [1, 1],
    [-1, 1],
    [-1, -1],
    [1, -1],
  ].map(([a, b]) => [x + (a * length) / 2, y + (b * width) / 2]);
/** @param {number[]} place @param {number} radius */
const disc = ([x, y], radius) =>
  Array.from({ length: 24 }, (_, step) => [
    x + radius * Math.cos((TAU * step) / 24),
    y + radius * Math.sin((TAU * step) / 24),
  ]);
const turned = (corners, angle) =>
  corners.map(([x, y]) => [x * Math.cos(angle) - y * Math.sin(angle), x * Math.sin(angle) + y * Math.cos(angle)]);
const moved = (corners, [dx, dy]) => corners.map(([x, y]) => [x + dx, y + dy]);

function vehicle(outline) {
  const ahead = Math.max(...outline.map(([x]) => x));
  return [
    [outline, "robot"],
    [
      [
        [ahead * 0.85, 0],
        [ahead * 0.25, ahead * 0.42],
        [ahead * 0.25, -ahead * 0.42],
      ],
      "paper",
    ],
  ];
}

function tractor(outline) {
  const ahead = Math.max(...outline.map(([x]) => x));
  const side = Math.max(...outline.map(([, y]) => y));
  const wheels = [];
  for (const [x, long] of [
    [-0.5, 0.85],
    [0.68, 0.5],
  ]) {
    for (const y of [-1.05, 1.05]) wheels.push([box(x * ahead, y * side, long * ahead, 0.5 * side), "ink"]);
  }
  return [...wheels, ...vehicle(outline)];
}

function drone(outline) {
  const far = Math.max(...outline.map(([x]) => x));
  const places = [-1, 1].flatMap((x) => [-1, 1].map((y) => [x * 0.6 * far, y * 0.6 * far]));
  const body = [
    [0.6, 0],
    [0, 0.32],
    [-0.32, 0.22],
    [-0.32, -0.22],
    [0, -0.32],
  ].map(([x, y]) => [x * far, y * far]);
  return [
    ...[Math.PI / 4, -Math.PI / 4].map((turn) => [turned(box(0, 0, 1.7 * far, 0.15 * far), turn), "ink"]),
    ...places.map((place) => [disc(place, 0.4 * far), "robot"]),
    ...places.map((place) => [disc(place, 0.13 * far), "paper"]),
    [body, "ink"],
  ];
}

function arm(outline) {
  const far = Math.max(...outline.map(([x]) => x));
  return [
    [disc([0, 0], far), "robot"],
    [disc([0, 0], 0.75 * far), "paper"],
  ];
}

function limb(outline, { limb: joints = [], jaws = -1 }) {
  if (joints.length < 2) return [];
  const far = Math.max(...outline.map(([x]) => x));
  const last = joints.length - 1;
  const parts = [];
  for (let at = 0; at < last; at += 1) {
    const [a, b] = [joints[at], joints[at + 1]];
    const width = far * (0.6 - (0.3 * at) / last);
    const bar = turned(
      box(0, 0, Math.hypot(b[0] - a[0], b[1] - a[1]) + width * 0.6, width),
      Math.atan2(b[1] - a[1], b[0] - a[0]),
    );
    parts.push([moved(bar, [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2]), "robot"], [disc(b, far * 0.25), "ink"]);
  }
  const [wrist, tool] = joints.slice(-2);
  const ahead = Math.atan2(tool[1] - wrist[1], tool[0] - wrist[0]);
  if (jaws < 0) return [...parts, [disc(tool, 0.1 * far), "paper"]];
  return [
    ...parts,
    ...[-1, 1].map((side) => [moved(turned(box(0, side * (jaws / 2 + 0.01), 0.06, 0.02), ahead), tool), "ink"]),
  ];
}

/** Ranks of labels: names of robots, what they do, names of things. */
const [NAME, TASK, THING] = [0, 1, 2];
const ASIDE = [0, 1.1, -1.1, 2.2, -2.2, 3.3, -3.3];
/** @type {[reach: number, part: string][]} */
const GLOW = [
  [2.2, "3c"],
  [1.4, "6e"],
]; // of a lamp: how far it reaches, and how dense that is
const SYMBOLS = { drone, tractor, mh5: arm, ur5e: arm };

/**
 * Whether a robot was put from one place to the next: [ns, x, y] each.
 *
 * @param {Place} before @param {Place} place
 */
const isPut = ([t0, x0, y0], [t, x, y]) =>
  t < t0 || Math.hypot(x - x0, y - y0) > Math.max(LEAP, (FASTEST * (t - t0)) / 1e9);

function roundLength(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((times) => times * power).find((length) => length >= least * (1 - 1e-9)) ?? least;
}

export class World {
  /** @param {HTMLElement} root @param {App} app */
  constructor(root, app) {
    this.app = app;
    this.root = root;
    this.canvas = h("canvas", { cls: "ground", tabindex: 0, role: "img", "aria-label": "World from above" });
    this.frame = h("div", { cls: "frame" }, this.canvas);
    this.trails = true;
    const fit = h("button", { title: "Fit the ground", onclick: () => this.view.fit() }, icon("fit"));
    const tools = h("div", { cls: "tools" }, this.trailsButton(), fit);
    root.append(h("div", { cls: "bar" }, h("h2", null, "World"), tools), this.frame);
    this.place = { x: 0, y: 0, scale: 1 };
    this.view = new Viewport(this.frame, (x, y, scale) => {
      this.place = { x, y, scale };
      app.redraw();
    });
    this.waysVersion = -1;
    this.unit = 1; // of the view in a metre
    this.size = { width: 0, height: 0 };
    new ResizeObserver(([{ contentRect }]) => {
      this.size = contentRect;
      this.view.resized();
      app.redraw();
    }).observe(this.frame);
    this.frame.addEventListener("click", (event) => this.view.moved || this.clicked(event));
  }

  trailsButton() {
    const toggle = () => {
      this.trails = !this.trails;
      button.setAttribute("aria-pressed", String(this.trails));
      this.app.redraw();
    };
    const attributes = { title: "Show the paths of the robots", "aria-pressed": "true", cls: "text", onclick: toggle };
    const button = h("button", attributes, "Trails");
    return button;
  }

  /** Take no room without a world. The ground may be known from the beginning, or come later. */
  attend(state) {
    const absent = !state.world.has("ground") && !state.poses.size;
    if (absent && this.app.tabs.name === "map") this.app.tabs.choose("diagram", false);
    this.root.classList.toggle("absent", absent);
  }

  update(state, time) {
    this.shown = time;
    const ground = state?.world.get("ground");
    if (!ground) return;
    this.measure(ground);
    const { width, height } = this.size;
    if (width < 2 || height < 2) return;
    const pen = this.penFor(ground);
    this.drawGround(pen, ground);
    for (const weed of ground.weeds) this.drawWeed(pen, weed, time, ground);
    if (this.trails) this.drawTrails(pen, state, time);
    const robots = [...state.poses]
      .map(([r, pose]) => ({ r, pose, robot: this.app.mission.robots[r] }))
      .filter((one) => one.robot);
    for (const one of robots) this.drawSenses(pen, one);
    for (const one of [...robots].sort((a, b) => (a.pose.altitude ?? 0) - (b.pose.altitude ?? 0)))
      this.drawRobot(pen, one);
    if (robots.length <= MOST_NAMES) for (const one of robots) this.drawName(pen, one, robots, width, state);
    this.robots = robots.map(({ r, pose }) => [r, pen.at([pose.x, pose.y])]);
    this.drawScale(pen, width, height);
    this.writeLabels(pen);
  }

  /** Fit the view to a ground of another size. */
  measure(ground) {
    const [x0, y0, x1, y1] = ground.bounds;
    this.ground = ground;
    this.unit = 1000 / Math.max(x1 - x0, y1 - y0);
    if (this.bounds === ground.bounds.join()) return;
    this.bounds = ground.bounds.join();
    this.view.content((x1 - x0) * this.unit, (y1 - y0) * this.unit);
    this.view.fit();
  }

  /** What all draw with: the context of an empty canvas, colours, px of a metre, and where a point [x, y] (m) is. */
  penFor({ bounds: [x0, , , y1] }) {
    const { width, height } = this.size;
    const context = sharp(this.canvas, width, height);
    const look = COLOURS[isDark() ? "dark" : "light"];
    const scale = this.place.scale * this.unit;
    context.clearRect(0, 0, width, height);
    const at = ([x, y]) => [this.place.x + (x - x0) * scale, this.place.y + (y1 - y) * scale];
    return { context, look, labels: [], scale, at };
  }

  polygon({ context, at }, corners, look) {
    trace(context, corners.map(at));
    context.closePath();
    paint(context, look);
  }

  /** A circle about a point (m), of a radius in px. */
  circle({ context, at }, place, radius, look) {
    context.beginPath();
    context.arc(...at(place), radius, 0, TAU);
    paint(context, look);
  }

  shape(pen, thing, look) {
    if (thing.radius === undefined) this.polygon(pen, thing.corners, look);
    else this.circle(pen, thing.at, thing.radius * pen.scale, look);
  }

  drawGround(pen, ground) {
    const { look, at } = pen;
    this.drawGrid(pen, ground);
    for (const thing of ground.obstacles) this.shape(pen, thing, { fill: look.obstacle, stroke: look.edge });
    for (const thing of ground.targets) this.shape(pen, thing, { fill: look.target, stroke: look.targetEdge });
    for (const charger of ground.chargers) {
      this.shape(pen, charger, { stroke: look.charger, width: 2 });
      const [x, y] = at(charger.at);
      this.label(pen, charger.name, x, y + charger.radius * pen.scale + 11, look.charger, 11);
    }
    this.drawWarehouse(pen, ground);
    for (const target of ground.targets) {
      const [x, y] = at(target.at ?? target.corners[0]);
      this.label(pen, target.name, x, y - (target.radius ?? 0.3) * pen.scale - 6, look.targetEdge, 12);
    }
  }

  drawGrid({ context, look, at }, { bounds: [x0, y0, x1, y1], walls }) {
    const [left, top] = at([x0, y1]);
    const [right, bottom] = at([x1, y0]);
    context.fillStyle = look.ground;
    context.fillRect(left, top, right - left, bottom - top);
    const apart = roundLength(Math.max(x1 - x0, y1 - y0) / 20);
    context.fillStyle = look.lines;
    for (let x = Math.ceil(x0 / apart) * apart; x <= x1; x += apart)
      context.fillRect(Math.round(at([x, 0])[0]), top, 1, bottom - top);
    for (let y = Math.ceil(y0 / apart) * apart; y <= y1; y += apart)
      context.fillRect(left, Math.round(at([0, y])[1]), right - left, 1);
    context.strokeStyle = walls ? look.ink : look.lines;
    context.lineWidth = 2;
    context.strokeRect(left, top, right - left, bottom - top);
  }

  /** Stations, doors whose leaves retract as they open, and the parcels that no robot carries. */
  drawWarehouse(pen, ground) {
    const { context, look, at, scale } = pen;
    context.lineWidth = 2;
    for (const { name, at: place, radius } of ground.stations ?? []) {
      const [x, y] = at(place);
      const half = radius * scale;
      context.strokeStyle = look.station;
      context.strokeRect(x - half, y - half, 2 * half, 2 * half);
      this.label(pen, name, x, y - half - 6, look.station, 11);
    }
    for (const { from, to, opening } of ground.doors ?? []) {
      const part = Math.max(0.5 * (1 - opening), 0.05);
      const along = [0, 1].map((axis) => (to[axis] - from[axis]) * part);
      for (const [end, sign] of [
        [from, 1],
        [to, -1],
      ]) {
        trace(context, [end, [end[0] + sign * along[0], end[1] + sign * along[1]]].map(at));
        paint(context, { stroke: look.door, width: Math.max(3, 0.1 * scale) });
      }
    }
    for (const parcel of ground.parcels ?? [])
      if (!parcel.carrier) this.drawParcel(pen, box(...parcel.at, PARCEL, PARCEL));
  }

  drawParcel(pen, corners) {
    this.polygon(pen, corners, { fill: pen.look.parcel, stroke: pen.look.parcelEdge });
  }

  drawWeed(pen, weed, time, ground) {
    const { look, at, scale } = pen;
    const radius = Math.max(weed.radius * scale, 7) / scale;
    const grown = weed.cut === null || weed.cut * 1e9 > time;
    const leaves = Array.from({ length: 12 }, (_, step) => {
      const reach = radius * (step % 2 ? 0.45 : 1);
      const turn = (Math.PI * step) / 6;
      return [weed.at[0] + reach * Math.cos(turn), weed.at[1] + reach * Math.sin(turn)];
    });
    const cutter = this.app.mission.robots.findIndex((robot) => robot.name === weed.by);
    this.polygon(pen, leaves, {
      fill: grown ? look.weed : look.stubble,
      stroke: grown ? look.weedEdge : cutter >= 0 ? robotColour(cutter) : look.faint,
    });
    if (ground.weeds.length <= MOST_NAMES) {
      const [x, y] = at(weed.at);
      this.label(
        pen,
        grown ? weed.name : `${weed.name} ✓`,
        x,
        y + radius * scale + 10,
        grown ? look.weedEdge : look.faint,
        10.5,
      );
    }
  }

  /** A text at a place, to be written when all are known. The `rank` decides which of two that overlap is left out. */
  label(pen, text, x, y, colour, size, rank = THING) {
    pen.labels.push({ text, x, y, colour, size, rank });
  }

  /** Write the labels: those of the highest rank always, others where they cover none of a higher one. */
  writeLabels({ context, look, labels }) {
    const taken = [];
    context.textAlign = "center";
    context.lineJoin = "round";
    context.lineWidth = 3;
    context.strokeStyle = look.ground;
    for (const { text, x, y, colour, size, rank } of labels.sort((a, b) => a.rank - b.rank)) {
      context.font = `${rank === NAME ? "600 " : ""}${size}px system-ui, sans-serif`;
      const wide = context.measureText(text).width;
      const free = (line) =>
        line > size &&
        line < this.size.height - 0.2 * size &&
        !taken.some((box) => overlap(box, [x - wide / 2, line - 0.8 * size, wide, size]));
      // a name is moved before it is left out
      const line = (rank === NAME ? ASIDE : [0]).map((by) => y + by * size).find(free);
      if (line === undefined) continue;
      taken.push([x - wide / 2, line - 0.8 * size, wide, size]);
      context.strokeText(text, x, line);
      context.fillStyle = colour;
      context.fillText(text, x, line);
    }
    this.written = taken;
  }

  /** Ways so far: of all loaded blocks, collected once and extended as blocks come. */
  collect() {
    const { store } = this.app;
    if (this.waysVersion === store.version) return;
    this.waysVersion = store.version;
    for (const block of store.blocks) {
      const rows = block.data?.poses;
      if (!rows) continue;
      let known = block.ways;
      if (!known || known.rows !== rows) known = block.ways = { rows, taken: 0, by: new Map(), last: new Map() };
      for (; known.taken < rows.length; known.taken += 1) {
        const [t, r, pose] = rows[known.taken];
        const before = known.last.get(r);
        /** @type {Place} */
        const place = [t, pose.x, pose.y];
        known.last.set(r, place);
        if (!known.by.has(r)) known.by.set(r, []);
        const way = known.by.get(r);
        const last = way.at(-1);
        const put = before !== undefined && isPut(before, place);
        if (put || last === undefined || Math.hypot(pose.x - last[1], pose.y - last[2]) > 0.01)
          way.push([...place, put]);
      }
    }
  }

  /**
   * Go along the way of a robot until an instant: `begin` is called where it begins, also again after a gap, and `goOn`
   * for the other places.
   */
  along(r, time, begin, goOn) {
    let last = null; // where it was before
    for (const block of this.app.store.blocks) {
      if (block.start > time) break;
      if (block.data === null) last = null; // what is not loaded is not known
      const way = block.ways?.by.get(r);
      if (!way) continue;
      const end = after(way, time, ([t]) => t);
      for (let at = 0; at < end; at += 1) {
        const [, x, y, put] = way[at];
        if (at === 0 ? last === null || isPut(last, way[0]) : put) begin(x, y);
        else goOn(x, y);
      }
      last = block.ways.last.get(r);
    }
  }

  drawTrails(pen, state, time) {
    this.collect();
    const { context, at } = pen;
    const { selected } = this.app;
    context.lineJoin = "round";
    for (const [r] of state.poses) {
      context.strokeStyle = robotColour(r);
      context.globalAlpha = selected.robot >= 0 && selected.robot !== r ? 0.2 : 0.7;
      context.lineWidth = 1.8;
      context.beginPath();
      this.along(
        r,
        time,
        (x, y) => context.moveTo(...at([x, y])),
        (x, y) => context.lineTo(...at([x, y])),
      );
      context.stroke();
    }
    context.globalAlpha = 1;
  }

  drawSenses(pen, { r, pose }) {
    const { context, at, scale } = pen;
    const colour = robotColour(r);
    if (pose.cone) {
      const {
        pose: [x, y, heading],
        angle,
        length,
      } = pose.cone;
      const [cx, cy] = at([x, y]);
      context.beginPath();
      context.moveTo(cx, cy);
      context.arc(cx, cy, length * scale, -heading - angle / 2, -heading + angle / 2);
      paint(context, { fill: `${colour}2c` });
    }
    if (pose.footprint)
      this.circle(pen, [pose.x, pose.y], pose.footprint * scale, { fill: `${colour}22`, stroke: `${colour}77` });
  }

  growth(outline, scale) {
    return Math.max(1, SMALLEST / (2 * Math.max(...outline.map(([x]) => x)) * scale));
  }

  drawRobot(pen, { r, pose }) {
    const { context, look, scale } = pen;
    const outline = pose.outline ?? box(0, 0, 0.5, 0.4);
    const growth = this.growth(outline, scale);
    const colour = robotColour(r);
    const ahead = Math.max(...outline.map(([x]) => x)) * growth;
    const led = LEDS[pose.led];
    /** @type {Point} */
    const here = [pose.x, pose.y];
    const placed = (corners) => {
      const grown = corners.map(([x, y]) => [x * growth, y * growth]);
      return moved(turned(grown, pose.heading), here);
    };
    if (this.app.selected.robot === r) {
      context.setLineDash([5, 4]);
      this.circle(pen, here, ahead * scale * 1.7 + 3, { stroke: colour, width: 2 });
      context.setLineDash([]);
    }
    const [lamp] = placed([[(-ahead * 0.4) / growth, 0]]);
    if (led) for (const [reach, part] of GLOW) this.circle(pen, lamp, ahead * scale * reach, { fill: led + part });
    if (pose.blade)
      this.circle(pen, here, pose.blade * growth * 1.25 * scale, { fill: `${look.ink}40`, stroke: look.ink });
    this.drawPieces(pen, pose, outline, placed, colour);
    if (pose.cargo) this.drawParcel(pen, placed(box(0, 0, PARCEL, PARCEL)));
    if (led) this.circle(pen, lamp, Math.max(ahead * scale * 0.35, 2.5), { fill: led, stroke: look.paper });
    if ((pose.charge ?? 1) < LOW) this.battery(pen, pose);
  }

  /** What a robot works on, its symbol, and its limb: polygons, and lines. */
  drawPieces(pen, pose, outline, placed, colour) {
    const { context, look } = pen;
    const fills = {
      robot: colour,
      paper: look.paper,
      ink: look.ink,
      fixture: look.fixture,
      part: look.target,
      cut: look.targetEdge,
    };
    const strokes = { robot: look.ink, ink: look.ink, fixture: look.edge, part: look.targetEdge, cut: look.targetEdge };
    const work = (pose.workpieces ?? []).map((piece) => [piece.corners, piece.kind, piece.closed]);
    const symbol = (SYMBOLS[pose.type] ?? vehicle)(outline);
    for (const [corners, kind, closed = true] of [...work, ...symbol, ...limb(outline, pose)]) {
      if (closed) this.polygon(pen, placed(corners), { fill: fills[kind], stroke: strokes[kind], width: 1.2 });
      else {
        trace(context, placed(corners).map(pen.at));
        paint(context, { stroke: fills[kind], width: 2.5 });
      }
    }
  }

  battery({ context, look, at }, pose) {
    const [x, y] = at([pose.x, pose.y]);
    context.fillStyle = look.ink;
    context.fillRect(x + 10, y - 4, 2, 8);
    context.fillStyle = look.paper;
    context.strokeStyle = look.ink;
    context.lineWidth = 2;
    context.fillRect(x - 12, y - 7, 22, 14);
    context.strokeRect(x - 12, y - 7, 22, 14);
    context.fillStyle = css("--failed");
    if (pose.charge > 0) context.fillRect(x - 9, y - 4, 16 * pose.charge, 8);
    else {
      trace(context, [
        [x - 15, y + 10],
        [x + 14, y - 10],
      ]);
      paint(context, { stroke: css("--failed"), width: 2 });
    }
  }

  drawName(pen, { r, pose, robot }, robots, width, state) {
    const [x, y] = pen.at([pose.x, pose.y]);
    const outline = pose.outline ?? box(0, 0, 0.5, 0.4);
    const far = Math.max(...outline.map(([ahead]) => ahead)) * this.growth(outline, pen.scale) * pen.scale;
    const near = robots
      .filter((other) => other.r !== r)
      .map((other) => pen.at([other.pose.x, other.pose.y]))
      .filter(([ox, oy]) => Math.abs(ox - x) < 90 && Math.abs(oy - y) < 56);
    const above = y > 60 && near.every(([, oy]) => oy >= y);
    const aside = !above && (y + far + 28 > this.size.height || near.some(([, oy]) => oy >= y));
    const name = pose.altitude >= 0.05 ? `${robot.name}  ${pose.altitude.toFixed(1)} m` : robot.name;
    const task = doing(this.app, state, r);
    const base = above ? y - far - (task ? 19 : 7) : aside ? y + (task ? -2 : 4) : y + far + 15;
    const inside = (text, size) => {
      pen.context.font = `600 ${size}px system-ui, sans-serif`;
      const half = pen.context.measureText(text).width / 2;
      return Math.min(Math.max(aside ? x + far + half + 8 : x, half + 4), width - half - 4);
    };
    this.label(pen, name, inside(name, 12.5), base, robotColour(r), 12.5, NAME);
    const note = [task, pose.note, (pose.charge ?? 1) <= 0 ? "battery empty" : ""].filter(Boolean).join(" · ");
    const shown = note.length > 44 ? `${note.slice(0, 43)}…` : note;
    if (note) this.label(pen, shown, inside(shown, 11), base + 13, pen.look.faint, 11, TASK);
  }

  drawScale(pen, width, height) {
    const { context, look, scale } = pen;
    const length = roundLength(40 / scale);
    const x = width - 14;
    const y = height - 12;
    trace(context, [
      [x - length * scale, y],
      [x, y],
    ]);
    paint(context, { stroke: look.ink, width: 2 });
    this.label(pen, `${Number(length.toPrecision(2))} m`, x - (length * scale) / 2, y - 5, look.ink, 11, TASK);
  }

  clicked(event) {
    const { left, top } = this.frame.getBoundingClientRect();
    const x = event.clientX - left;
    const y = event.clientY - top;
    let best = [22, -1];
    for (const [r, [rx, ry]] of this.robots ?? [])
      best = Math.hypot(rx - x, ry - y) < best[0] ? [Math.hypot(rx - x, ry - y), r] : best;
    this.app.select({ robot: best[1] });
  }
}
