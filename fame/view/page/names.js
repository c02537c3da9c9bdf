// Names in a diagram at any zoom: at least 9 px, inside their shape or beside it and on nothing else, or left out.
// Those inside a shape are cut to what has room, if that is wanted.

/**
 * @import {Box, Point} from "./types.js"
 *
 * @typedef {object} Name a text of a drawing
 * @property {SVGElement} group what it belongs to
 * @property {SVGElement} node
 * @property {Node[]} kept its lines as drawn
 * @property {number} size of its letters
 * @property {string[]} lines
 * @property {string} text
 * @property {number} x its middle
 * @property {number} corner 1: a pictogram is above it
 * @property {number} foot 1: a marker is below it
 * @property {boolean} halo it is beside what it names
 * @property {Box} [owner] the box of what it names
 * @property {Box} [box] its room in there
 * @property {Box} at its place as drawn
 *
 * @typedef {object} Place
 * @property {string[]} [lines] none: as drawn
 * @property {number} [top]
 * @property {number} [x]
 * @property {boolean} [plain] whether the pictograms have to go
 *
 * @typedef {object} Frame a pool or lane
 * @property {number} number
 * @property {string} text
 * @property {Box} box
 * @property {boolean} turned
 * @property {0 | 1} over the axis, x or y, that its band lies across
 * @property {number} depth how many others it is inside
 */
import { s } from "./dom.js";

const LEAST = 9;
const DOT = 8; // px of a name, and of a shape that is more than a dot
const SIGN = 18;
const BARE = 6;
const MOST = 2.2; // units of a pictogram, px of one that is shown; how many times a name beside a shape may grow
const BAND = 30; // units of the name of a pool or lane
const AROUND = [
  [0, 0],
  [0, 1],
  [0, -1],
  [1, 0],
  [-1, 0],
  [1, 1],
  [-1, 1],
  [1, -1],
  [-1, -1],
  [0, 2],
  [0, -2],
]; // places of a name beside a shape, in its widths and heights
const LEADING = 1.2;
const PAD = 4;
const CORNER = 20;
const FOOT = 18; // of a line; room beside a text, for a pictogram, for a marker
const ruler = /** @type {CanvasRenderingContext2D} */ (document.createElement("canvas").getContext("2d"));
ruler.font = '100px Arial, Helvetica, "Liberation Sans", sans-serif';

/** @param {string} text @param {number} size */
const wide = (text, size) => (ruler.measureText(text).width * size) / 100;

/**
 * Whether two boxes [x, y, width, height] have something in common.
 *
 * @param {Box} a @param {Box} b
 */
export const overlap = (a, b) => a[0] < b[0] + b[2] && b[0] < a[0] + a[2] && a[1] < b[1] + b[3] && b[1] < a[1] + a[3];
/** @param {Box} a @param {Box} b */
const apart = (a, b) => !overlap(a, b);

/**
 * @param {Box} box @param {Point} by
 * @returns {Box}
 */
const moved = ([x, y, width, height], [dx, dy]) => [x + dx, y + dy, width, height];

/**
 * @param {Box} box @param {number} size
 * @returns {Box}
 */
const spaced = ([x, y, width, height], size) => [x - size / 3, y, width + size / 1.5, height];
/** @param {Element} sign */
const heightOf = (sign) => Number(/,? ?([-\d.]+)\)/.exec(sign.getAttribute("transform") ?? "")?.[1] ?? 0);

/**
 * As much of a text as has room, empty if that says nothing.
 *
 * @param {string} text @param {number} room @param {number} size
 */
export function cut(text, room, size) {
  if (wide(text, size) <= room) return text;
  const shown = begun(text, room - wide("…", size), size);
  return shown.length > 3 ? `${shown}…` : "";
}

/**
 * The first letters of a text, as many as have room; one at least.
 *
 * @param {string} text @param {number} room @param {number} size
 */
function begun(text, room, size) {
  let shown = text;
  while (shown.length > 1 && wide(shown, size) > room) shown = shown.slice(0, -1).trimEnd();
  return shown;
}

/**
 * The first letters of a name in a shape where it has no room, without pictograms.
 *
 * @param {Name} name @param {number} size
 * @returns {Place}
 */
function squeezed({ box = [0, 0, 0, 0], text }, size) {
  const [, y, width, height] = box;
  return { lines: [begun(text, width, size)], top: y + (height - size * LEADING) / 2, plain: true };
}

/**
 * @param {string} text @param {number} room @param {number} size
 * @returns {string[]}
 */
function wrapped(text, room, size) {
  /** @type {string[]} */
  const lines = [];
  for (const word of text.split(/\s+/)) {
    if (lines.length && wide(`${lines.at(-1)} ${word}`, size) <= room) lines.push(`${lines.pop()} ${word}`);
    else lines.push(word);
  }
  return lines;
}

/**
 * What a name shows in its box: {lines, top, plain: whether the pictograms have to go}; null where it has no room.
 *
 * @param {Name} name @param {number} size
 * @returns {Place | null}
 */
function inside({ box = [0, 0, 0, 0], text, corner, foot }, size) {
  const [, y, width, height] = box;
  const room = width - 2 * PAD;
  const line = size * LEADING;
  const lines = wrapped(text, room, size);
  const fits = lines.every((one) => wide(one, size) <= room);
  for (const [above, below] of [
    [corner ? CORNER : PAD, foot ? FOOT : PAD],
    [PAD, PAD],
  ]) {
    const free = height - above - below;
    if (fits && lines.length * line <= free)
      return {
        lines,
        top: y + above + (free - lines.length * line) / 2,
        plain: above + below < (corner + foot) * CORNER,
      };
  }
  const most = Math.floor((height - 2 * PAD) / line);
  const shown = lines.slice(0, most);
  if (lines.length > most && most > 0) shown[most - 1] = `${shown[most - 1]} …`;
  const short = shown.map((one) => cut(one, room, size));
  return short.length && short.every(Boolean)
    ? { lines: short, top: y + (height - short.length * line) / 2, plain: true }
    : null;
}

/**
 * Where a name beside a shape begins when it is larger: it grows away from the shape.
 *
 * @param {Name} name @param {number} size
 */
function begins({ owner, at: [, y, , height], lines }, size) {
  const tall = lines.length * size * LEADING;
  if (owner && y + height / 2 > owner[1] + owner[3]) return y;
  return owner && y + height / 2 < owner[1] ? y + height - tall : y + (height - tall) / 2;
}

/**
 * A text of a drawing with its place, what it names (`owner`: the box of that), and how much room it has in there.
 *
 * @param {any} node @param {Map<number, Box>} shapes @param {Point} shift
 * @returns {Name}
 */
function nameOf(node, shapes, shift) {
  const group = node.parentNode.closest("[data-element]") ?? s("g");
  const box = shapes.get(Number(group.dataset.element));
  const owner = box && moved(box, shift);
  const kept = [...node.childNodes];
  const size = Number(node.getAttribute("font-size"));
  const lines = kept.map((one) => one.textContent);
  const [corner, foot] = [signs(group, owner, -1), signs(group, owner, 1)];
  const halo = node.hasAttribute("paint-order") || !owner;
  const [x, first] = ["x", "y"].map((name) => Number(kept[0].getAttribute(name)));
  const width = Math.max(...lines.map((line) => wide(line, size)));
  /** @type {Box | undefined} */
  const room =
    owner && group.classList.contains("frame") ? [owner[0], owner[1] + 2, owner[2], 2 * size + 2 * PAD] : owner;
  /** @type {Box} */
  const at = [x - width / 2, first - 0.95 * size, width, lines.length * size * LEADING];
  return { group, node, kept, size, lines, text: lines.join(" "), x, corner, foot, halo, owner, box: room, at };
}

/**
 * Whether a shape has pictograms in its upper (`side` -1) or lower (1) half: 1 or 0.
 *
 * @param {Element} group @param {Box | undefined} owner @param {-1 | 1} side
 */
function signs(group, owner, side) {
  const found = [...group.querySelectorAll(":scope > g")];
  return Number(found.some((sign) => owner && side * (heightOf(sign) - owner[1] - owner[3] / 2) > 0));
}

export class Names {
  /** The names of a plane: a text is inside its shape, or beside it with a halo; pools and lanes are named by pins. */
  /**
   * @param {object} plane @param {Element} plane.drawing @param {Map<number, Element>} plane.groups
   * @param {Map<number, Box>} plane.shapes @param {Point} plane.shift @param {Pins} plane.pins
   */
  constructor({ drawing, groups, shapes, shift, pins }) {
    this.pools = pins.frames.map(({ box }) => moved(box, shift));
    this.bands = this.pools.filter((_, at) => pins.frames[at].turned);
    /** @type {[group: Element, box: Box][]} */
    this.shapes = [...shapes].flatMap(([number, box]) => {
      const group = groups.get(number);
      return !group || group.classList.contains("frame") ? [] : [[group, moved(box, shift)]];
    });
    this.names = [...drawing.querySelectorAll("text")].map((node) => nameOf(node, shapes, shift));
  }

  /**
   * Show what can be read at a scale. `cuts`: whether no shape is left without letters.
   *
   * @param {number} scale @param {boolean} cuts
   */
  fit(scale, cuts) {
    for (const [group, [, , width, height]] of this.shapes)
      group.classList.toggle("dot", Math.min(width, height) * scale < DOT);
    /** @type {Box[]} */
    const taken = [];
    const shapes = this.shapes.map(([, box]) => box);
    const bare = SIGN * scale < BARE;
    for (const name of this.names) {
      const size = Math.max(name.size, LEAST / scale);
      const grown = size > name.size;
      const place = name.halo
        ? this.beside(name, size, taken, grown ? shapes : [])
        : grown
          ? (inside(name, size) ?? (cuts ? squeezed(name, size) : null))
          : {};
      name.node.toggleAttribute("hidden", place === null);
      name.group.classList.toggle("plain", bare || Boolean(place?.plain));
      if (place === null) continue;
      name.node.setAttribute("font-size", String(size));
      if (place.lines)
        name.node.replaceChildren(
          ...place.lines.map((line, at) =>
            s("tspan", { x: place.x ?? name.x, y: (place.top ?? 0) + (at + 0.5) * size * LEADING + 0.35 * size }, line),
          ),
        );
      else name.node.replaceChildren(...name.kept);
    }
  }

  /**
   * Whether a name that grows stays in the pools and lanes that its shape is in, and out of the others.
   *
   * @param {Name} name @param {Box} box
   */
  stays({ owner }, box) {
    /** @type {(inner: Box, outer: Box) => boolean} */
    const within = ([x, y, width, height], [left, top, wide, high]) =>
      x >= left && y >= top && x + width <= left + wide && y + height <= top + high;
    return !owner || this.pools.every((pool) => (within(owner, pool) ? within(box, pool) : apart(box, pool)));
  }

  /**
   * The first place at or around its own where a name is on nothing else: {lines, top, x}; null if there is none.
   *
   * @param {Name} name @param {number} size @param {Box[]} taken @param {Box[]} shapes
   * @returns {Place | null}
   */
  beside(name, size, taken, shapes) {
    const { lines } = name;
    const grown = size > name.size;
    const width = Math.max(...lines.map((line) => wide(line, size)));
    const tall = lines.length * size * LEADING;
    const top = grown ? begins(name, size) : name.at[1];
    const aside = width / 2 + size;
    const bands = this.bands
      .filter(([x, y, wideAs, high]) => name.x > x && name.x < x + wideAs && top > y && top < y + high)
      .map(([x]) => x + BAND);
    const left = Math.max(name.x - width / 2, ...(grown ? bands : [])); // not under the name of a pool
    if (size > MOST * name.size) return null;
    /** @type {Box[]} */
    const places = AROUND.map(([x, y]) => [left + x * aside, top + y * tall, width, tall]);
    const box = places.find(
      (one) =>
        taken.every((other) => apart(spaced(one, size), other)) &&
        shapes.every((other) => apart(one, other)) &&
        (!grown || this.stays(name, one)),
    );
    if (box === undefined && grown) return null;
    taken.push(box ?? name.at);
    if (box === undefined || (!grown && box[0] === left && box[1] === top)) return {};
    return { lines, top: box[1], x: box[0] + width / 2 };
  }
}

/**
 * Where the name of a pool or lane is shown: {box: [x, y, width, height], long}; null where it has no room.
 *
 * @param {Frame} frame @param {Point} origin @param {number} scale
 * @param {[width: number, height: number]} room
 * @returns {{box: Box, long: number} | null}
 */
function pinAt({ box, depth, over }, origin, scale, room) {
  const along = 1 - over;
  /** @type {(end: number) => (axis: number) => number} */
  const edge = (end) => (axis) => origin[axis] + (box[axis] + end * box[2 + axis]) * scale;
  const [begins, ends] = [0, 1].map((end) => [0, 1].map(edge(end)));
  const band = BAND * scale;
  const wideAs = Math.max(band, 20);
  const from = Math.max(depth * 20, begins[over] + band - wideAs);
  const first = Math.max(0, begins[along]);
  const long = Math.min(room[along], ends[along]) - first;
  if (from + wideAs > ends[over] || long < 2 * LEAST) return null;
  return { box: over ? [first, from, long, wideAs] : [from, first, wideAs, long], long };
}

/**
 * @param {Frame} frame
 * @param {{box: Box, long: number}} place
 * @param {number} scale @param {boolean} on
 */
function pin({ number, text, turned }, { box: [x, y, width, height], long }, scale, on) {
  const size = Math.min(Math.max(12 * scale, 11), 16);
  const shown = cut(text, long - 6, size) || begun(text, long - 2, size);
  const transform = `translate(${x + width / 2} ${y + height / 2})${turned ? " rotate(-90)" : ""}`;
  return s(
    "g",
    { cls: on ? "pin on" : "pin", dataset: { element: number } },
    s("title", null, text),
    s("rect", { x, y, width, height }),
    shown ? s("text", { transform, y: 0.35 * size, "font-size": size, "text-anchor": "middle" }, shown) : null,
  );
}

/**
 * Whether a pool or lane is around another one: it is larger along the axis that the bands lie across.
 *
 * @param {Frame} outer @param {Frame} inner
 */
function encloses({ box: outer }, { box: inner, over }) {
  return outer !== inner && overlap(outer, inner) && outer[2 + over] > inner[2 + over];
}

/**
 * The names of pools and lanes, in their band (left, or above where they are drawn upright) or, where that is out of
 * sight, at the edge: they stay while one scrolls.
 */
export class Pins {
  /** @param {{groups: Map<number, Element>, shapes: Map<number, Box>}} plane */
  constructor({ groups, shapes }) {
    this.node = s("g", { cls: "pins" });
    /** @type {Frame[]} */
    this.frames = [...groups].flatMap(([number, group]) => {
      const banner = group.classList.contains("frame") && group.querySelector(":scope > g > text")?.parentElement;
      const box = shapes.get(number);
      if (!banner || box === undefined) return [];
      const text = [...banner.querySelectorAll("tspan")].map((one) => one.textContent).join(" ");
      const turned = /rotate/.test(banner.getAttribute("transform") ?? "");
      banner.remove();
      return [{ number, text, box, turned, over: turned ? 0 : 1, depth: 0 }];
    });
    for (const frame of this.frames) frame.depth = this.frames.filter((other) => encloses(other, frame)).length;
  }

  /**
   * The content is at `origin` [x, y] in a box of a size [width, height].
   *
   * @param {Point} origin @param {number} scale @param {[width: number, height: number]} room
   * @param {number} chosen
   */
  place(origin, scale, room, chosen) {
    this.node.replaceChildren(
      ...this.frames.flatMap((frame) => {
        const place = pinAt(frame, origin, scale, room);
        return place === null ? [] : pin(frame, place, scale, frame.number === chosen);
      }),
    );
  }
}
