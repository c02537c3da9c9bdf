// The page's policy lets no inline style in, neither as an attribute nor as an element. The library that draws sets
// some: they are applied by the CSS object model instead, which the policy allows, since no text of a model gets there
// as markup. This runs before the library.

(() => {
  const KEPT = "data-style";
  const { setAttribute } = Element.prototype;
  /** @type {any} */
  const inner = Object.getOwnPropertyDescriptor(Element.prototype, "innerHTML");
  const create = Document.prototype.createElement;

  /** @this {any} @param {string} name @param {string} value */
  Element.prototype.setAttribute = function (name, value) {
    if (name === "style" && this.style) this.style.cssText = value;
    else setAttribute.call(this, name, value);
  };

  Object.defineProperty(Element.prototype, "innerHTML", {
    ...inner,
    set(markup) {
      inner.set.call(this, String(markup).replace(/(<[a-z][^<>]*?\s)style=/gi, `$1${KEPT}=`));
      for (const one of (this.content ?? this).querySelectorAll(`[${KEPT}]`)) {
        one.style.cssText = one.getAttribute(KEPT);
        one.removeAttribute(KEPT);
      }
    },
  });

  /** A style element that is a sheet of the document: its text is replaced as a whole. */
  Document.prototype.createElement = function (name, ...options) {
    if (String(name).toLowerCase() !== "style") return create.call(this, name, ...options);
    const sheet = new CSSStyleSheet();
    this.adoptedStyleSheets.push(sheet);
    return Object.defineProperty(create.call(this, "template"), "textContent", {
      get: () => [...sheet.cssRules].map((rule) => rule.cssText).join("\n"),
      set(text) {
        sheet.replaceSync(text);
      },
    });
  };
})();
