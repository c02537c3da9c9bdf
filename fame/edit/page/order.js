// The order of elements, which decides: an exclusive gateway tries its sequence flows in that of the file. The library
// puts what Undo brings back behind all others.

const ACTS = ["updateSemanticParent", "updateConnection"];

/** The lists with an element: of its parent, of what it connects, and of the file. @returns {any[][]} */
const lists = (one, root) =>
  [...new Set([one.$parent, one.sourceRef, one.targetRef, root])]
    .flatMap((holder) => (holder ? Object.getOwnPropertyNames(holder).map((name) => holder[name]) : []))
    .filter((list) => Array.isArray(list) && list.includes(one));

/** Let what has left a list come back to its place there. @param {any} modeler */
export function keepOrder(modeler) {
  const updater = modeler.get("bpmnUpdater");
  /** @type {WeakMap<object, Map<any[], any[]>>} what was behind an element in the lists that it has left */
  const left = new WeakMap();

  /** @param {any} one @param {() => void} act */
  const around = (one, act) => {
    const root = modeler.getDefinitions();
    const before = new Map(lists(one, root).map((list) => [list, list.slice(list.indexOf(one) + 1)]));
    act();
    const places = left.get(one) ?? new Map();
    left.set(one, places);
    for (const list of lists(one, root)) {
      const next = !before.delete(list) && places.get(list)?.find((other) => list.includes(other));
      if (next) list.splice(list.indexOf(next), 0, ...list.splice(list.indexOf(one), 1));
    }
    before.forEach((behind, list) => places.set(list, behind));
  };

  for (const act of ACTS) {
    const done = updater[act].bind(updater);
    updater[act] = (subject, ...more) => {
      const one = subject.connection?.businessObject ?? subject; // in a context, in which a connection gets its ends
      const process = one.processRef; // which comes and goes with its pool
      around(one, () => (process ? around(process, () => done(subject, ...more)) : done(subject, ...more)));
    };
  }
}
