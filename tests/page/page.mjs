// As much of a browser as the modules of the page ask for when they are loaded, and as names in a diagram need: letters
// are 60 px wide in a font of 100 px.

export class Node {
  constructor(tag = "", attributes = {}, children = []) {
    this.localName = tag;
    this.attributes = new Map(Object.entries(attributes));
    this.dataset = {};
    this.childNodes = children;
    this.parentNode = null;
    for (const child of children) if (child instanceof Node) child.parentNode = this;
    const classes = new Set(attributes.class?.split(" "));
    this.classList = {
      contains: (name) => classes.has(name),
      toggle: (name, on) => (on ? classes.add(name) : classes.delete(name)),
    };
  }

  get textContent() {
    return this.childNodes.map((child) => child.textContent ?? child).join("");
  }

  getAttribute(name) {
    return this.attributes.get(name) ?? null;
  }

  setAttribute(name, value) {
    this.attributes.set(name, value);
  }

  hasAttribute(name) {
    return this.attributes.has(name);
  }

  toggleAttribute(name, on) {
    if (on) this.attributes.set(name, "");
    else this.attributes.delete(name);
  }

  append(...children) {
    this.childNodes.push(...children);
  }

  replaceChildren(...children) {
    this.childNodes = children;
  }

  /** The nearest group that has the number of an element: what the page looks for. */
  closest() {
    return this.dataset.element !== undefined ? this : (this.parentNode?.closest() ?? null);
  }

  /** All texts inside, or no pictograms: what the page looks for. */
  querySelectorAll(selector) {
    const inside = this.childNodes.flatMap((child) => [child, ...(child.querySelectorAll?.(selector) ?? [])]);
    return inside.filter((child) => child.localName === selector);
  }
}

const ruler = { font: "", measureText: (text) => ({ width: 60 * text.length }) };

Object.assign(globalThis, {
  document: {
    createElement: () => ({ getContext: () => ruler }),
    createElementNS: (_, tag) => new Node(tag),
    documentElement: { dataset: { theme: "light" } },
  },
  matchMedia: () => ({ matches: false }),
});
