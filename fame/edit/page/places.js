// Where the tokens of a run are in the diagram.

/**
 * @import {Mission} from "./types.js"
 * @import {State} from "./store.js"
 */

/**
 * The robots that have a token at each element that is drawn: what is inside of a called process is at the call.
 *
 * @param {Mission} mission @param {State} state @param {(id: string) => boolean} isDrawn
 */
export function places(mission, state, isDrawn) {
  const { elements, models } = mission;
  const isHere = (/** @type {number} */ e) => models[elements[e]?.file ?? -1] === models[0] && isDrawn(elements[e].id);
  /** @type {Map<string, Set<number>>} */
  const found = new Map();
  for (const token of state.tokens.values()) {
    const e = [token.e, ...state.openers(token.r, token.s).reverse()].find(isHere);
    if (e === undefined) continue;
    const { id } = elements[e];
    found.set(id, (found.get(id) ?? new Set()).add(token.r));
  }
  return found;
}
