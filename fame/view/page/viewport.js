// Zoom and pan of what has a size of its own: by wheel, by dragging, with two fingers.

const MARGIN = 10;
const LEAST = 0.05;
const MOST = 6;
const GLIDE = 220; // ms that a chosen part takes to come
const still = matchMedia("(prefers-reduced-motion: reduce)");

export class Viewport {
  /** `moved(x, y, scale)` places the content in the box of `element`. */
  constructor(element, place, { below = 0, beside = 0 } = {}) {
    this.below = below; // room for what lies on the lower edge
    this.beside = beside; // and on the left one
    this.element = element;
    this.place = place;
    this.width = this.height = 1;
    this.x = this.y = 0;
    this.scale = 1;
    /** @type {any} */
    this.target = {}; // what is shown, until somebody moves it
    this.moved = false; // whether the last press was a drag
    this.pointers = new Map();
    element.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    element.addEventListener("pointerdown", (event) => this.down(event));
    element.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"])
      element.addEventListener(name, (event) => this.pointers.delete(event.pointerId));
  }

  content(width, height) {
    this.width = width;
    this.height = height;
  }

  box() {
    return this.element.getBoundingClientRect();
  }

  fit() {
    this.focus({});
  }

  /**
   * Show a part [x, y, width, height] of the content, at `least` at this scale: then what is around a point. `unless`:
   * the scale from which on the whole is shown.
   */
  focus(target, glides = false) {
    const { width, height } = this.box();
    this.target = target;
    if (!width || !height) return;
    const rooms = [width - 2 * MARGIN - this.beside, height - 2 * MARGIN - this.below];
    const whole = Math.min(rooms[0] / this.width, rooms[1] / this.height) >= (target.unless ?? Infinity);
    const { part = [0, 0, this.width, this.height], least = 0, about = part } = whole ? {} : target;
    const [left, top, wide, tall] = part;
    const scale = Math.max(least, Math.min(rooms[0] / wide, rooms[1] / tall, 1.6));
    const [x, y] = [
      [left, wide, this.beside],
      [top, tall, 0],
    ].map(([from, size, before], axis) => {
      const room = rooms[axis];
      const spare = room - size * scale;
      const begin = MARGIN + before;
      const beyond = room - [this.width, this.height][axis] * scale; // below 0: no place beside the content is shown
      const place = spare >= 0 ? spare / 2 : Math.max(spare, Math.min(0, room / 2 - (about[axis] - from) * scale));
      const at = place - from * scale;
      return begin + (beyond < 0 ? Math.min(0, Math.max(beyond, at)) : at);
    });
    this.glide({ x, y, scale }, glides && !still.matches ? GLIDE : 0);
  }

  glide(to, lasts) {
    const from = { x: this.x, y: this.y, scale: this.scale };
    const begun = performance.now();
    const { target } = this;
    const frame = (now) => {
      if (this.target !== target) return; // somebody has moved it, or chosen another part
      const part = lasts ? Math.min(1, Math.max(0, (now - begun) / lasts)) : 1;
      const eased = 1 - (1 - part) ** 3;
      for (const name of ["x", "y", "scale"]) this[name] = from[name] + (to[name] - from[name]) * eased;
      this.apply();
      if (part < 1) requestAnimationFrame(frame);
    };
    frame(begun);
  }

  resized() {
    if (this.target) this.focus(this.target);
  }

  /** Zoom about a point of the box, by default its middle. */
  zoom(by, x, y) {
    const { width, height } = this.box();
    const scale = Math.min(MOST, Math.max(LEAST, this.scale * by));
    const cx = x ?? width / 2;
    const cy = y ?? height / 2;
    this.x = cx - ((cx - this.x) * scale) / this.scale;
    this.y = cy - ((cy - this.y) * scale) / this.scale;
    this.scale = scale;
    this.target = null;
    this.apply();
  }

  apply() {
    this.place(this.x, this.y, this.scale);
  }

  wheel(event) {
    event.preventDefault();
    const { left, top } = this.box();
    if (event.ctrlKey || event.deltaMode !== 0 || Math.abs(event.deltaX) < 1) {
      this.zoom(Math.exp(-event.deltaY * (event.ctrlKey ? 0.01 : 0.0015)), event.clientX - left, event.clientY - top);
    } else this.shift(-event.deltaX, -event.deltaY);
  }

  /** What can be seen of the content: [x, y, width, height]. */
  sight() {
    const { width, height } = this.box();
    return [-this.x / this.scale, -this.y / this.scale, width / this.scale, height / this.scale];
  }

  /** Have a point of the content in the middle. */
  centre([x, y]) {
    const { width, height } = this.box();
    this.shift(width / 2 - x * this.scale - this.x, height / 2 - y * this.scale - this.y);
  }

  shift(dx, dy) {
    this.x += dx;
    this.y += dy;
    this.target = null;
    this.apply();
  }

  down(event) {
    if (event.button > 0) return;
    this.moved = false;
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY, from: [event.clientX, event.clientY] });
  }

  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (before === undefined) return;
    const dx = event.clientX - before.x;
    const dy = event.clientY - before.y;
    if (!this.moved && Math.hypot(event.clientX - before.from[0], event.clientY - before.from[1]) < 4) return;
    if (!this.moved) this.element.setPointerCapture(event.pointerId);
    this.moved = true;
    const others = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, one]) => one);
    if (others.length === 0) this.shift(dx, dy);
    else {
      const [other] = others;
      const { left, top } = this.box();
      const was = Math.hypot(before.x - other.x, before.y - other.y);
      const is = Math.hypot(event.clientX - other.x, event.clientY - other.y);
      if (was > 0) this.zoom(is / was, (event.clientX + other.x) / 2 - left, (event.clientY + other.y) / 2 - top);
    }
    Object.assign(before, { x: event.clientX, y: event.clientY });
  }
}
