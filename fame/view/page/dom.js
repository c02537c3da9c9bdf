// Builds elements. Text always becomes a text node: nothing from a model or a message is ever parsed as markup.

/**
 * @import {Point} from "./types.js"
 *
 * @typedef {{[name: string]: any, cls?: string, dataset?: Object<string, any>}} Attributes
 * @typedef {Node | string | number | boolean | null | undefined | Child[]} Child
 */

const SVG = "http://www.w3.org/2000/svg";

/**
 * What an element does at an event. It is looked up when the event comes: `renew` gives an element what a later one
 * does.
 *
 * @param {any} element @param {string} type @param {(event: any) => void} action
 */
function listen(element, type, action) {
  element.actions ??= new Map();
  if (!element.actions.has(type))
    element.addEventListener(type, (/** @type {Event} */ event) => element.actions.get(type)?.(event));
  element.actions.set(type, action);
}

/**
 * @param {any[]} children
 * @returns {any[]}
 */
const present = (children) =>
  children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false);

/** @param {any} element @param {Attributes | null | undefined} attributes @param {Child[]} children */
function fill(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes ?? {})) {
    if (value === undefined || value === null || value === false) continue;
    if (typeof value === "function") listen(element, name.slice(2), value);
    else if (name === "dataset") Object.assign(element.dataset, value);
    else element.setAttribute(name === "cls" ? "class" : name, value === true ? "" : String(value));
  }
  element.append(...present(children));
  return element;
}

/**
 * An HTML element: attributes as an object (`cls` is the class, `onclick` a listener), then children or text.
 *
 * @param {string} tag @param {Attributes | null} [attributes] @param {Child[]} children
 * @returns {any} an element of any kind
 */
export function h(tag, attributes, ...children) {
  return fill(document.createElement(tag), attributes, children);
}

/**
 * An SVG element.
 *
 * @param {string} tag @param {Attributes | null} [attributes] @param {Child[]} children
 * @returns {any}
 */
export function s(tag, attributes, ...children) {
  return fill(document.createElementNS(SVG, tag), attributes, children);
}

/**
 * The element with this id, which the page has.
 *
 * @param {string} id
 */
export const byId = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

const ICONS = {
  play: "M7 5v14l12-7z",
  pause: "M7 5h4v14H7zM14 5h4v14h-4z",
  next: "M6 5v14l9-7zM16.5 5h2.5v14h-2.5z",
  previous: "M18 5v14l-9-7zM5 5h2.5v14H5z",
  fit: "M4 9V4h5M15 4h5v5M20 15v5h-5M9 20H4v-5",
  maximise: "M14 4h6v6M10 20H4v-6M20 4l-7 7M4 20l7-7",
  plus: "M12 5v14M5 12h14",
  minus: "M5 12h14",
  clock: "M12 7v5l3.500 2M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18z",
  text: "M4 6h16M12 6v13",
  link: "M10 14a4 4 0 0 0 5.7 0l3-3a4 4 0 0 0-5.7-5.7l-1 1M14 10a4 4 0 0 0-5.7 0l-3 3A4 4 0 0 0 11 18.7l1-1",
  moon: "M20 14.5A8 8 0 1 1 9.5 4a6.5 6.5 0 0 0 10.5 10.5z",
  help: "M9.2 9a3 3 0 1 1 4.3 2.7c-.9.5-1.5 1.1-1.5 2.3M12 17.5v.01M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18z",
  plot: "M4 19h16M5 15l4-5 4 3 6-8",
  back: "M15 5l-7 7 7 7",
  forth: "M9 5l7 7-7 7",
  close: "M6 6l12 12M18 6L6 18",
  up: "M12 19V6M6 11l6-6 6 6",
  step: "M5 12h11M12 7l5 5-5 5M20 5v14",
  branch: "M7 4v16M7 14c0-4 10-2 10-8M17 6a2 2 0 1 0 0-.01M7 4a2 2 0 1 0 0-.01",
  bolt: "M13 3L5 14h6l-1 7 8-11h-6z",
  team:
    "M9 11a3.5 3.5 0 1 0 0-7 3.5 3.5 0 0 0 0 7zM3 20c0-4 2.5-6 6-6s6 2 6 6M16 11a3 3 0 1 0-1-5.8" +
    "M17 14c2.5.5 4 2.5 4 6",
  person: "M12 12a4 4 0 1 0 0-8 4 4 0 0 0 0 8zM5 20.5c0-4 3-6 7-6s7 2 7 6",
  alert: "M12 3.5L2.5 20h19zM12 10v4.5M12 17.2v.01",
  check: "M5 12.5l4.5 4.5L19 7",
  off: "M5 5l14 14M4 12a11 11 0 0 1 4-4M20 12a11 11 0 0 0-7-5M8.5 15.5a5 5 0 0 1 6 0M12 19.5v.01",
  map: "M9 4L3 6.5v13.5l6-2.5 6 2.5 6-2.5V4l-6 2.5zM9 4v13.5M15 6.5V20",
  flow: "M3 9h6v6H3zM15 9h6v6h-6zM9 12h6",
  list: "M8 6h13M8 12h13M8 18h13M3.5 6h.01M3.5 12h.01M3.5 18h.01",
  send: "M4 12l16-8-6 16-3-6z",
  dot: "M12 7a5 5 0 1 0 0 10 5 5 0 0 0 0-10z",
};
/** @typedef {keyof typeof ICONS} Picture */

const SOLID = new Set(["play", "pause", "next", "previous", "dot"]);

/** @type {Map<string, Element>} */
const drawn = new Map(); // pictograms: copied, which is faster than to build them

/**
 * A pictogram of 24 by 24.
 *
 * @param {Picture} name
 * @returns {Node}
 */
export function icon(name) {
  const known = drawn.get(name) ?? drawnIcon(name);
  drawn.set(name, known);
  return known.cloneNode(true);
}

/**
 * @param {Picture} name
 * @returns {Element}
 */
function drawnIcon(name) {
  const solid = SOLID.has(name);
  const path = s("path", {
    d: ICONS[name],
    fill: solid ? "currentColor" : "none",
    stroke: solid ? "none" : "currentColor",
    "stroke-width": 2,
    "stroke-linecap": "round",
    "stroke-linejoin": "round",
  });
  return s("svg", { viewBox: "0 0 24 24", cls: "icon", "aria-hidden": "true" }, path);
}

/**
 * Replace the children of an element.
 *
 * @param {Element} element @param {Child[]} children
 */
export function show(element, ...children) {
  element.replaceChildren(...present(children));
}

/**
 * Give an element these nodes as its children, without moving those that are in their place.
 *
 * @param {Element} element @param {Node[]} nodes
 */
export function arrange(element, nodes) {
  const wanted = new Set(nodes);
  for (const node of [...element.childNodes]) if (!wanted.has(node)) node.remove();
  let place = element.firstChild;
  for (const node of nodes) {
    if (node === place) place = place.nextSibling;
    else element.insertBefore(node, place);
  }
}

/** Give an element other children, but keep those that it has: what somebody is clicking at must not be replaced.

Children of the same kind are the same, one after the other; those with `data-key`, wherever they are. Their listeners
are those of the new ones, which may not refer to their own element but by `event.currentTarget`. */
/** @param {Element} element @param {Child[]} children */
export function renew(element, ...children) {
  renewChildren(
    element,
    present(children).map((child) => (child instanceof Node ? child : document.createTextNode(child))),
  );
}

/** @param {any} node */
const kindOf = (node) => (node.nodeType === Node.ELEMENT_NODE ? `${node.localName} ${node.dataset.key ?? ""}` : "text");

/** @param {any} element @param {any[]} fresh */
function renewChildren(element, fresh) {
  const known = new Map();
  for (const node of element.childNodes) {
    const kind = kindOf(node);
    if (known.has(kind)) known.get(kind).push(node);
    else known.set(kind, [node]);
  }
  let place = element.firstChild;
  for (const node of fresh) {
    const kept = known.get(kindOf(node))?.shift();
    if (kept !== undefined && kept !== node && !(node.localName === "svg" && kept.isEqualNode(node)))
      renewNode(kept, node);
    const child = kept ?? node;
    if (child === place) place = place.nextSibling;
    else element.insertBefore(child, place);
  }
  for (const nodes of known.values()) for (const node of nodes) node.remove();
}

/** @param {any} node @param {any} fresh */
function renewNode(node, fresh) {
  if (node.nodeType !== Node.ELEMENT_NODE) {
    if (node.nodeValue !== fresh.nodeValue) node.nodeValue = fresh.nodeValue;
    return;
  }
  for (const { name } of [...node.attributes])
    if (!fresh.hasAttribute(name) && !(name === "open" && node.localName === "details")) node.removeAttribute(name);
  for (const { name, value } of fresh.attributes) {
    if (node.getAttribute(name) === value) continue;
    if (name === "style")
      node.style.cssText = value; // the policy of the page forbids the attribute
    else node.setAttribute(name, value);
  }
  for (const type of node.actions?.keys() ?? []) node.actions.set(type, null);
  for (const [type, action] of fresh.actions ?? []) listen(node, type, action);
  const { value } = fresh; // before its options are moved
  renewChildren(node, [...fresh.childNodes]);
  if (node.localName === "select" && node.value !== value && node !== document.activeElement) node.value = value;
}

/**
 * What the browser keeps under a name. Where it may keep nothing, as for a page in a sandbox, it has nothing.
 *
 * @param {"localStorage" | "sessionStorage"} where @param {string} name
 * @returns {string | null}
 */
export function kept(where, name) {
  try {
    return window[where].getItem(name);
  } catch {
    return null;
  }
}

/** @param {"localStorage" | "sessionStorage"} where @param {string} name @param {string} value */
export function keep(where, name, value) {
  try {
    window[where].setItem(name, value);
  } catch {
    /* it is not kept */
  }
}

/**
 * What an error says.
 *
 * @param {unknown} error
 */
export const messageOf = (error) => (error instanceof Error ? error.message : String(error));

/**
 * A value on one line, short.
 *
 * @param {any} value
 * @returns {string}
 */
export function brief(value, most = 120) {
  if (value !== null && typeof value === "object" && "$cut" in value) {
    const inside = value.first === undefined ? "" : ` ${brief(value.first, most - 20)}`;
    return `${value.$cut}${inside}`;
  }
  const text =
    typeof value === "string"
      ? JSON.stringify(value)
      : typeof value === "number"
        ? String(Number(value.toPrecision(9)))
        : JSON.stringify(value, (_, one) => (typeof one === "number" ? Number(one.toPrecision(6)) : one));
  return text !== undefined && text.length > most ? `${text.slice(0, most - 1)}…` : (text ?? "–");
}

/**
 * Nanoseconds as m:ss.mmm, or h:mm:ss.mmm.
 *
 * @param {number} time
 */
export function clock(time) {
  const ms = Math.round(Math.max(0, time) / 1e6);
  const two = (/** @type {number} */ number) => String(number).padStart(2, "0");
  const minutes = Math.floor(ms / 60000);
  const rest = `${two(Math.floor(ms / 1000) % 60)}.${String(ms % 1000).padStart(3, "0")}`;
  return minutes < 60 ? `${minutes}:${rest}` : `${Math.floor(minutes / 60)}:${two(minutes % 60)}:${rest}`;
}

/**
 * A duration in nanoseconds, short: 12 ms, 3.4 s, 2 min.
 *
 * @param {number} time
 */
export function duration(time) {
  if (time < 1e9) return `${Math.round(time / 1e6)} ms`;
  if (time < 120e9) return `${Number((time / 1e9).toPrecision(3))} s`;
  return `${Number((time / 60e9).toPrecision(3))} min`;
}

const LIGHT = ["#2364c9", "#b04b05", "#1a7841", "#8a3ab9", "#0a707f", "#c2257e", "#65691a", "#7a4a2b"];
const DARK = ["#79a9ff", "#ff9d52", "#5fd08f", "#cf9bf2", "#4fd0e2", "#ff86c4", "#c9ce62", "#d9a583"];

/** Whether the page is dark now. */
export const isDark = () => document.documentElement.dataset.theme === "dark";

/** @type {Map<number, number>} */
const places = new Map();

/**
 * Give the robots their colours: those of a network come in any order, and have the same ones each time.
 *
 * @param {number[]} order robots by number
 */
export function colourRobots(order) {
  order.forEach((robot, place) => places.set(robot, place));
}

/**
 * The colour of robot number `index`.
 *
 * @param {number} index
 */
export const robotColour = (index) => (isDark() ? DARK : LIGHT)[(places.get(index) ?? index) % LIGHT.length];

/**
 * A small square in the colour of a robot.
 *
 * @param {number} index
 */
export function swatch(index) {
  const square = h("i", { cls: "swatch" });
  square.style.background = robotColour(index);
  return square;
}

const variables = new Map();

/**
 * The value of a CSS variable. The browser is asked once for each theme: it would bring its styles up to date each
 * time.
 *
 * @param {string} name
 * @returns {string}
 */
export function css(name) {
  const key = `${document.documentElement.dataset.theme} ${name}`;
  if (!variables.get(key)) variables.set(key, getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  return variables.get(key);
}

/**
 * A canvas as large as its box, sharp on any screen. Gives its context, in CSS pixels.
 *
 * @param {HTMLCanvasElement} canvas @param {number} width @param {number} height
 * @returns {CanvasRenderingContext2D}
 */
export function sharp(canvas, width, height) {
  const ratio = window.devicePixelRatio || 1;
  const w = Math.round(width * ratio);
  const hgt = Math.round(height * ratio);
  if (canvas.width !== w || canvas.height !== hgt) {
    canvas.width = w;
    canvas.height = hgt;
    canvas.style.width = `${width}px`;
    canvas.style.height = `${height}px`;
  }
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return context;
}

/**
 * Make a line through these points the path of a context, without what was in it.
 *
 * @param {CanvasRenderingContext2D} context @param {Point[]} points
 */
export function trace(context, points) {
  context.beginPath();
  points.forEach(([x, y], place) => context[place ? "lineTo" : "moveTo"](x, y));
}

/**
 * Fill the path of a context, and draw along it, in these colours.
 *
 * @param {CanvasRenderingContext2D} context
 * @param {{fill?: string, stroke?: string, width?: number}} look
 */
export function paint(context, { fill, stroke, width = 1.5 }) {
  if (fill) {
    context.fillStyle = fill;
    context.fill();
  }
  if (stroke) {
    context.strokeStyle = stroke;
    context.lineWidth = width;
    context.stroke();
  }
}

/**
 * A cross about a point, which reaches as far as `half` (px).
 *
 * @param {CanvasRenderingContext2D} context @param {number} x @param {number} y @param {number} half
 * @param {string} stroke @param {number} width
 */
export function cross(context, x, y, half, stroke, width) {
  for (const side of [1, -1]) {
    trace(context, [
      [x - half, y - side * half],
      [x + half, y + side * half],
    ]);
    paint(context, { stroke, width });
  }
}
