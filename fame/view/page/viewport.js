// Zoom and pan of what has a size of its own: by wheel, by dragging, with two fingers.

const MARGIN = 10, LEAST = 0.05, MOST = 6;

export class Viewport {
  /** `moved(x, y, scale)` places the content in the box of `element`. */
  constructor(element, place, below = 0) {
    this.below = below; // room for what lies on the lower edge
    this.element = element;
    this.place = place;
    this.width = this.height = 1;
    this.x = this.y = 0;
    this.scale = 1;
    this.fitted = true;
    this.moved = false; // whether the last press was a drag
    this.pointers = new Map();
    element.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    element.addEventListener("pointerdown", (event) => this.down(event));
    element.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"]) element.addEventListener(name, (event) => this.pointers.delete(event.pointerId));
  }

  content(width, height) {
    this.width = width;
    this.height = height;
  }

  box() {
    return this.element.getBoundingClientRect();
  }

  fit() {
    const { width, height } = this.box();
    if (!width || !height) return;
    this.scale = Math.min((width - 2 * MARGIN) / this.width, (height - 2 * MARGIN - this.below) / this.height, 1.6);
    this.x = (width - this.width * this.scale) / 2;
    this.y = (height - this.below - this.height * this.scale) / 2;
    this.fitted = true;
    this.apply();
  }

  resized() {
    if (this.fitted) this.fit();
  }

  /** Zoom about a point of the box, by default its middle. */
  zoom(by, x, y) {
    const { width, height } = this.box(), scale = Math.min(MOST, Math.max(LEAST, this.scale * by));
    const cx = x ?? width / 2, cy = y ?? height / 2;
    this.x = cx - ((cx - this.x) * scale) / this.scale;
    this.y = cy - ((cy - this.y) * scale) / this.scale;
    this.scale = scale;
    this.fitted = false;
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

  shift(dx, dy) {
    this.x += dx;
    this.y += dy;
    this.fitted = false;
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
    const dx = event.clientX - before.x, dy = event.clientY - before.y;
    if (!this.moved && Math.hypot(event.clientX - before.from[0], event.clientY - before.from[1]) < 4) return;
    if (!this.moved) this.element.setPointerCapture(event.pointerId);
    this.moved = true;
    const others = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, one]) => one);
    if (others.length === 0) this.shift(dx, dy);
    else {
      const [other] = others, { left, top } = this.box();
      const was = Math.hypot(before.x - other.x, before.y - other.y), is = Math.hypot(event.clientX - other.x, event.clientY - other.y);
      if (was > 0) this.zoom(is / was, (event.clientX + other.x) / 2 - left, (event.clientY + other.y) / 2 - top);
    }
    Object.assign(before, { x: event.clientX, y: event.clientY });
  }
}
