// What is known of the run: blocks, and the state at any instant. Mirrors
// fame/robot/robot_state.py, with numbers for ids.

/**
 * @import {BlockData, Changes, Columns, IndexRow, Key, MessageRow, ScopeRow, Wait} from "./types.js"
 * @import {VariablesRow, WaitsRow} from "./types.js"
 *
 * @typedef {{r: number, i: number, s: number, e: number, n: number, since: number}} Token
 * @typedef {{r: number, s: number, i: number, parent: number, openers: number[], depth: number}} Scope
 * @typedef {{r: number, i: number, s: number, e: number, from: number, until: number, how: number, depth: number}} Span
 *
 * @typedef {object} Loaded what is loaded of a block
 * @property {number} number
 * @property {number} start
 * @property {number} end
 * @property {Key} key
 * @property {Columns} columns
 * @property {Map<number, any>} details of events, by their place
 * @property {ScopeRow[]} scopes
 * @property {Map<string, Scope>} scopeIndex by key of the scope
 * @property {Set<string>} held keys of the tokens at its start
 * @property {number} size characters of JSON
 * @property {number} [until]
 * @property {Span[] | null} [spans] kept by `spansOf`
 * @property {number} [settled] events for which the timeline has rows
 * @property {{taken: number, rows: Map<string, MessageRow[]>}} [topics] kept by `byTopic`
 * @property {any} [signals] kept by `signals.js`
 * @property {any} [density] kept by `axis.js`
 * @property {number[]} [marks] kept by `bars.js`
 * @property {number} [marksLength]
 *
 * @typedef {Loaded & Changes} LoadedBlock
 *
 * @typedef {object} Block
 * @property {number} number
 * @property {number} start
 * @property {number} end
 * @property {number} events
 * @property {LoadedBlock | null} data
 * @property {Promise<Block | undefined> | null} loading
 * @property {number} [look] the number of the last look at it
 * @property {any[]} [properties] what was judged in it, which stays
 * @property {any} [ways] kept by `world.js`
 */

export const START = 0;
export const ENTER = 1;
export const LEAVE = 2;
export const TAKE = 3;
export const CANCEL = 4;
export const FAIL = 5;
export const END = 6;
export const LOG = 7;
export const REPORT = 8;
export const ANSWER = 9;
/** Kinds of events that are lines of the log, with the word before it. */
export const LOGGED = new Map([
  [LOG, ""],
  [REPORT, "report"],
  [FAIL, "failed"],
  [END, "ended"],
]);
/** @type {(keyof Columns)[]} */
const COLUMNS = ["t", "r", "i", "s", "e", "w"];
/** @type {(keyof Changes)[]} */
const LISTS = ["variables", "waits", "circles", "messages", "poses", "world", "properties"];
const ROOM = 32e6; // characters of JSON in loaded blocks, with which a page has some 230 MB
const LEAST = 6; // blocks that stay even if they do not fit: at the cursor, beside it, and what is searched

/**
 * The first index whose value is above `time`.
 *
 * @template T
 * @param {T[]} values @param {number} time
 * @param {(value: T) => number} [of] the number that an entry is ordered by
 * @returns {number}
 */
export function after(values, time, of = Number) {
  let low = 0;
  let high = values.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (of(values[middle]) <= time) low = middle + 1;
    else high = middle;
  }
  return low;
}

/**
 * A scope as the page keeps it, from its row.
 *
 * @param {ScopeRow} row
 * @returns {[string, Scope]}
 */
const scopeFrom = ([r, s, i, parent, openers, depth]) => [`${r}/${s}`, { r, s, i, parent, openers, depth }];

/**
 * Where a token is, as a key.
 *
 * @param {number} r @param {number} i @param {number} s @param {number} e
 * @returns {string}
 */
export const tokenKey = (r, i, s, e) => `${r}/${i}/${s}/${e}`;

const ELEMENTS = 2 ** 20; // more than there are elements

/** @param {number} r @param {number} e */
const countKey = (r, e) => r * ELEMENTS + e;

/**
 * Robot and element of a key of `State.counts`.
 *
 * @param {number} key
 * @returns {[r: number, e: number]}
 */
export const counted = (key) => [Math.floor(key / ELEMENTS), key % ELEMENTS];

/** The state of a run at an instant. `apply` moves it forward within its block. */
export class State {
  /** @param {LoadedBlock} block */
  constructor(block) {
    this.block = block;
    this.time = -Infinity;
    this.position = 0; // events that are applied
    this.at = Object.fromEntries(LISTS.map((name) => [name, 0]));
    const key = block.key;
    /** @type {Map<string, Token>} */
    this.tokens = new Map();
    /** @type {Map<number, number[]>} */
    this.counts = new Map();
    this.scopes = new Map(key.scopes.map(scopeFrom));
    /** @type {Map<string, {r: number, s: number, values: Map<string, [value: any, since: number]>}>} */
    this.variables = new Map();
    /** @type {Map<number, Map<string, Wait>>} */
    this.waits = new Map(key.waits.map(([r, tokens]) => [r, new Map(tokens.map((token) => [token.key, token]))]));
    this.circles = new Map(key.circles); // robot -> that others wait for it as it waits for them, in words
    // robot -> [ended, failed, how and when the last one ended]
    /** @type {Map<number, [ended: number, failed: number, how: string, time: number]>} */
    this.ends = new Map((key.ends ?? []).map(([r, ...ends]) => [r, ends]));
    this.poses = new Map(key.poses);
    this.world = new Map(Object.entries(key.world));
    for (const [r, i, s, e, n, since] of key.tokens) this.tokens.set(tokenKey(r, i, s, e), { r, i, s, e, n, since });
    for (const [r, e, done, failed, cancelled] of key.counts)
      this.counts.set(countKey(r, e), [done, failed, cancelled]);
    for (const [r, s, values] of key.variables) {
      this.variables.set(`${r}/${s}`, { r, s, values: new Map(Object.entries(values)) });
    }
  }

  /** @param {number} r @param {number} e @param {number} outcome @param {number} [by] */
  count(r, e, outcome, by = 1) {
    const key = countKey(r, e);
    let counts = this.counts.get(key);
    if (counts === undefined) this.counts.set(key, (counts = [0, 0, 0]));
    counts[outcome] += by;
  }

  /**
   * Apply everything of the block until `time`.
   *
   * @param {number} time
   */
  apply(time) {
    const { t, r, i, s, e, w } = this.block.columns;
    const end = t.length;
    let at = this.position;
    for (; at < end && t[at] <= time; at += 1) {
      this.event(t[at], r[at], i[at], s[at], e[at], w[at]);
      if (w[at] === END) this.end(r[at], String(this.block.details.get(at) ?? "completed"), t[at]);
    }
    this.position = at;
    this.list("variables", time, (row) => this.variable(row));
    this.list("waits", time, (row) => this.wait(row));
    this.list("circles", time, ([, robot, text]) => this.circles.set(robot, text));
    this.list("poses", time, ([, robot, pose]) => this.poses.set(robot, pose));
    this.list("world", time, ([, name, value]) => this.world.set(name, value));
    this.time = time;
  }

  /**
   * @template {keyof Changes} N
   * @param {N} name @param {number} time @param {(row: Changes[N][number]) => void} change
   */
  list(name, time, change) {
    const rows = this.block[name];
    let at = this.at[name];
    for (; at < rows.length && rows[at][0] <= time; at += 1) change(rows[at]);
    this.at[name] = at;
  }

  /**
   * @param {number} time @param {number} r @param {number} i @param {number} s @param {number} e
   * @param {number} w
   */
  event(time, r, i, s, e, w) {
    if (w > END || w === START) return;
    if (w === TAKE) {
      this.count(r, e, 0);
      return;
    }
    if (w === END) {
      this.ended(r, i);
      return;
    }
    const key = tokenKey(r, i, s, e);
    const held = this.tokens.get(key);
    if (w === ENTER) {
      if (held === undefined) this.tokens.set(key, { r, i, s, e, n: 1, since: time });
      else held.n += 1;
      return;
    }
    if (held !== undefined) {
      if (held.n === 1) this.tokens.delete(key);
      else held.n -= 1;
    } else if (w === FAIL) this.count(r, e, 0, -1);
    this.count(r, e, w === LEAVE ? 0 : w === FAIL ? 1 : 2);
  }

  /** @param {number} r @param {number} i */
  ended(r, i) {
    for (const [key, token] of this.tokens) {
      if (token.r === r && token.i === i) {
        this.count(r, token.e, 2, token.n);
        this.tokens.delete(key);
      }
    }
  }

  /** @param {number} r @param {string} status @param {number} time */
  end(r, status, time) {
    const [ended, failed] = this.ends.get(r) ?? [0, 0];
    this.ends.set(r, [ended + 1, failed + (status === "failed" ? 1 : 0), status, time]);
  }

  /** @param {VariablesRow} row */
  variable([time, r, s, values, gone]) {
    const key = `${r}/${s}`;
    if (values === null) {
      this.variables.delete(key);
      return;
    }
    let known = this.variables.get(key);
    if (known === undefined) this.variables.set(key, (known = { r, s, values: new Map() }));
    for (const [name, value] of Object.entries(values)) known.values.set(name, [value, time]);
    for (const name of gone) known.values.delete(name);
  }

  /** @param {WaitsRow} row */
  wait([, r, tokens, gone]) {
    const known = this.waits.get(r) ?? new Map();
    this.waits.set(r, known);
    for (const key of gone) known.delete(key);
    for (const token of tokens) known.set(token.key, token);
  }

  /**
   * What is known of a scope. Scopes are kept for the whole block.
   *
   * @param {number} r @param {number} s
   * @returns {Scope | undefined}
   */
  scopeOf(r, s) {
    return this.scopes.get(`${r}/${s}`) ?? this.block.scopeIndex.get(`${r}/${s}`);
  }

  /**
   * The variables that are visible in a scope: [name, value], the innermost first.
   *
   * @param {number} r @param {number} s
   * @returns {Generator<[string, any]>}
   */
  *visible(r, s) {
    for (let at = s, left = 64; at !== -1 && left > 0; left -= 1) {
      for (const [name, [value]] of this.variables.get(`${r}/${at}`)?.values ?? []) yield [name, value];
      at = this.scopeOf(r, at)?.parent ?? -1;
    }
  }

  /**
   * The value of a variable that is visible in a scope.
   *
   * @param {number} r @param {number} s @param {string} wanted
   */
  valueOf(r, s, wanted) {
    for (const [name, value] of this.visible(r, s)) if (name === wanted) return value;
    return undefined;
  }

  /**
   * The calls, sub-processes and event sub-processes around a scope, outermost first.
   *
   * @param {number} r @param {number} s
   * @returns {number[]} elements
   */
  openers(r, s) {
    const found = [];
    for (let scope = this.scopeOf(r, s), left = 64; scope !== undefined && left > 0; left -= 1) {
      found.unshift(...scope.openers);
      scope = scope.parent !== -1 ? this.scopeOf(r, scope.parent) : undefined;
    }
    return found;
  }
}

/**
 * The blocks of a run, and who loads them. `onchange` is called after a block has come, with its number; -1 if it was
 * made for an instant.
 */
export class Store {
  /**
   * @param {(number: number) => Promise<BlockData>} load
   * @param {((time: number) => Promise<BlockData>) | null} peek gives a block around an instant that the server has not
   *   read yet
   */
  constructor(load, peek = null) {
    this.load = load;
    this.peek = peek; // gives a block around an instant that the server has not read yet
    this.complete = true; // whether it has read everything
    /** @type {LoadedBlock | null} */
    this.ahead = null; // the last such block, its state, and whether one is on its way
    /** @type {State | null} */
    this.aheadState = null;
    this.peeking = false;
    /** @type {Block[]} */
    this.blocks = [];
    /** @type {Set<(number: number) => void>} */
    this.listeners = new Set();
    /** @type {State | null} */
    this.cursor = null;
    this.end = 0;
    this.room = ROOM;
    this.size = 0; // characters of JSON in loaded blocks
    this.looks = 0; // at blocks, so far
    this.version = 0; // of what is loaded
    this.said = 0; // grows when messages are loaded
  }

  /** The time of the first entry. */
  get start() {
    return this.blocks[0]?.start ?? 0;
  }

  /** @param {(number: number) => void} listener */
  onchange(listener) {
    this.listeners.add(listener);
  }

  /** @param {number} number */
  changed(number) {
    for (const listener of this.listeners) listener(number);
  }

  /**
   * The blocks that there are; those already loaded are kept.
   *
   * @param {IndexRow[]} rows @param {number} end
   */
  index(rows, end) {
    for (const [number, start, stop, events] of rows) {
      const known = this.blocks[number];
      if (known === undefined) this.blocks[number] = { number, start, end: stop, events, data: null, loading: null };
      else Object.assign(known, { end: Math.max(stop, known.end), events: Math.max(events, known.events) });
    }
    this.end = Math.max(this.end, end);
  }

  /**
   * Take what the server has sent of a run that lasts.
   *
   * @param {any} news @param {import("./types.js").Mission} mission
   */
  take(news, mission) {
    if (news.type === "index") {
      this.index(news.blocks, news.end);
      mission.reading = news.reading;
      this.complete = news.reading >= 1;
      if (news.elements)
        mission.elements.push(...news.elements.slice(Math.max(0, mission.elements.length - news.from)));
    } else if (news.type === "data") this.add(news.block);
    else if (news.type === "run") this.end = Math.max(this.end, news.time);
  }

  /**
   * The number of the block that an instant is in.
   *
   * @param {number} time
   */
  numberAt(time) {
    return Math.max(0, after(this.blocks, time, (block) => block.start) - 1);
  }

  /**
   * Take a block, or what is new in one.
   *
   * @param {BlockData} data
   */
  add(data) {
    const known = (this.blocks[data.number] ??= {
      number: data.number,
      start: data.start,
      end: data.end,
      events: 0,
      data: null,
      loading: null,
    });
    if (data.key !== undefined) {
      if (known.data !== null && known.data.columns.t.length >= data.t.length && known.data.columns.t.length > 0)
        return;
      known.data = prepared(data);
      if (this.cursor?.block.number === data.number) this.cursor = null;
    } else if (known.data === null) return;
    else if (!extend(known.data, data)) {
      known.data = null;
      this.want(known.number);
      return;
    }
    known.properties = known.data.properties;
    known.end = Math.max(known.end, data.end);
    known.events = known.data.columns.t.length;
    this.look(known);
    this.forget();
    this.end = Math.max(this.end, known.end);
    this.version += 1;
    this.said += data.messages.length;
  }

  /** @param {Block} block */
  look(block) {
    this.looks += 1;
    block.look = this.looks;
  }

  /** Whether no more blocks are loaded before they are needed; those that are needed have some room beyond. */
  get full() {
    return this.size > 0.8 * this.room;
  }

  /** Let blocks leave memory until the others fit, first what was not looked at for the longest time. */
  forget() {
    const loaded = this.blocks.filter((block) => block?.data);
    loaded.sort((one, other) => (one.look ?? 0) - (other.look ?? 0));
    this.size = loaded.reduce((sum, block) => sum + (block.data?.size ?? 0), 0);
    for (const block of loaded.slice(0, -LEAST)) {
      if (this.size <= this.room) break;
      this.size -= block.data?.size ?? 0;
      block.data = null;
      block.ways = null;
    }
  }

  /**
   * Blocks to load before anything needs them, the nearest to an instant first: as many as fit, else those beside it.
   *
   * @param {number} time
   */
  missing(time) {
    const here = this.numberAt(time);
    /** @param {Block} block */
    const distance = (block) => Math.abs(block.number - here);
    const wanted = this.blocks.filter((block) => block && block.data === null && (!this.full || distance(block) < 2));
    return wanted.sort((one, other) => distance(one) - distance(other));
  }

  /**
   * Load a block if it is not there.
   *
   * @param {number} number
   * @returns {Promise<Block | undefined>}
   */
  want(number) {
    const block = this.blocks[number];
    if (block === undefined || block.data !== null) return Promise.resolve(block);
    block.loading ??= this.load(number)
      .then((data) => {
        this.add(data);
        this.changed(number);
        return block;
      })
      .finally(() => {
        block.loading = null;
      });
    return block.loading;
  }

  /**
   * The last message on a topic until an instant, or null.
   *
   * @param {string} topic @param {number} time
   * @returns {MessageRow | null}
   */
  lastMessage(topic, time) {
    for (let number = this.numberAt(time); number >= 0; number -= 1) {
      const rows = byTopic(this.blocks[number]?.data).get(topic);
      const at = rows === undefined ? 0 : after(rows, time, ([t]) => t);
      if (rows !== undefined && at > 0) return rows[at - 1];
    }
    return null;
  }

  /**
   * Whether the server has not read as far as an instant, but can make a block for it.
   *
   * @param {number} time
   */
  isAhead(time) {
    return !this.complete && this.peek !== null && time > (this.blocks.at(-1)?.end ?? -1);
  }

  /**
   * Load what an instant needs, without waiting for the next frame.
   *
   * @param {number} time
   */
  ask(time) {
    if (this.isAhead(time)) this.askAhead(time);
    else this.want(this.numberAt(time));
  }

  /**
   * The state at an instant, or null while its block is being loaded. The same object is given again if it fits.
   *
   * @param {number} time
   */
  stateAt(time) {
    if (this.isAhead(time)) return this.stateAhead(time);
    const number = this.numberAt(time);
    const block = this.blocks[number];
    if (block === undefined) return null;
    if (block.data === null) {
      this.want(number);
      return null;
    }
    this.look(block);
    if (this.cursor === null || this.cursor.block !== block.data || this.cursor.time > time)
      this.cursor = new State(block.data);
    this.cursor.apply(time);
    return this.cursor;
  }

  /**
   * The state at an instant that the server has not read yet; null while it makes a block for it.
   *
   * @param {number} time
   */
  stateAhead(time) {
    const { ahead } = this;
    if (ahead === null || !this.hasAhead(time)) {
      this.askAhead(time);
      return null;
    }
    if (this.aheadState === null || this.aheadState.block !== ahead || this.aheadState.time > time)
      this.aheadState = new State(ahead);
    this.aheadState.apply(time);
    return this.aheadState;
  }

  /** @param {number} time */
  hasAhead(time) {
    return this.ahead !== null && this.ahead.start <= time && time <= (this.ahead.until ?? -Infinity);
  }

  /** @param {number} time */
  askAhead(time) {
    // one at a time: what is wanted meanwhile is asked for afterwards
    if (this.peek === null || this.peeking || this.hasAhead(time)) return;
    this.peeking = true;
    this.peek(time)
      .then(
        (data) => {
          this.ahead = { ...prepared(data), until: data.until };
        },
        () => {
          this.peek = null;
        },
      )
      .finally(() => {
        this.peeking = false;
        this.changed(-1);
      });
  }

  /**
   * Loaded blocks that overlap a span of time.
   *
   * @param {number} from @param {number} until
   */
  *within(from, until) {
    for (let number = this.numberAt(from); number < this.blocks.length; number += 1) {
      const block = this.blocks[number];
      if (block.start > until) return;
      yield block;
    }
  }

  /**
   * The time of the next or previous event from an instant on (`step` 1 or -1) for which `wanted` holds, or null.
   *
   * @param {number} time @param {1 | -1} step @param {(data: LoadedBlock, at: number) => boolean} wanted
   * @returns {Promise<number | null>}
   */
  async find(time, step, wanted) {
    for (let number = this.numberAt(time); number >= 0 && number < this.blocks.length; number += step) {
      const { data } = (await this.want(number)) ?? {};
      if (!data) return null;
      const { t } = data.columns;
      const begin = step > 0 ? after(t, time) : after(t, time - 1) - 1;
      for (let at = begin; at >= 0 && at < t.length; at += step) if (wanted(data, at)) return t[at];
    }
    return null;
  }
}

const NONE = new Map();

/**
 * The messages of a block, by topic.
 *
 * @param {LoadedBlock | null | undefined} block
 * @returns {Map<string, MessageRow[]>}
 */
function byTopic(block) {
  if (!block) return NONE;
  const known = (block.topics ??= { taken: 0, rows: new Map() });
  for (; known.taken < block.messages.length; known.taken += 1) {
    const row = block.messages[known.taken];
    const rows = known.rows.get(row[1]);
    if (rows === undefined) known.rows.set(row[1], [row]);
    else rows.push(row);
  }
  return known.rows;
}

/**
 * @param {BlockData} data
 * @returns {LoadedBlock}
 */
function prepared(data) {
  const { number, start, end, key, variables, waits, circles, messages, poses, world, properties } = data;
  const { t, r, i, s, e, w } = data;
  if (key === undefined) throw new Error(`block ${number} has no state at its start`);
  const block = {
    number,
    start,
    end,
    key,
    details: new Map(),
    scopes: [],
    scopeIndex: new Map(key.scopes.map(scopeFrom)),
    held: new Set(key.tokens.map(([robot, instance, scope, element]) => tokenKey(robot, instance, scope, element))),
    columns: { t, r, i, s, e, w }, // not copied: `extend` adds nothing that is there
    ...{ variables, waits, circles, messages, poses, world, properties },
    size: 0,
  };
  extend(block, data);
  return block;
}

/**
 * Add what is new. False if something between is missing: then the block has to be loaded again.
 *
 * @param {LoadedBlock} block @param {BlockData} data
 * @returns {boolean}
 */
function extend(block, data) {
  const skip = block.columns.t.length - data.first;
  if (skip < 0 || LISTS.some((name) => block[name].length < data.at[name]) || block.scopes.length < data.at.scopes)
    return false;
  for (const name of COLUMNS) for (const value of data[name].slice(skip)) block.columns[name].push(value);
  for (const name of LISTS) {
    /** @type {any[]} */
    const list = block[name];
    for (const row of data[name].slice(list.length - data.at[name])) list.push(row);
  }
  for (const [at, detail] of Object.entries(data.d)) block.details.set(Number(at), detail);
  for (const row of data.scopes.slice(block.scopes.length - data.at.scopes)) {
    block.scopes.push(row);
    block.scopeIndex.set(...scopeFrom(row));
  }
  block.end = Math.max(block.end, data.end);
  block.size += data.size ?? JSON.stringify(data).length;
  block.spans = null;
  return true;
}

/** Follows the tokens of a block from event to event. */
class Spans {
  /** @param {LoadedBlock} block */
  constructor(block) {
    this.block = block;
    /** @type {Span[]} */
    this.found = [];
    /** @type {Map<string, Span[]>} */
    this.open = new Map(); // by key of the token, the oldest first
    for (const [r, i, s, e, n, since] of block.key.tokens)
      for (let count = 0; count < n; count += 1) this.begin(r, i, s, e, since);
    const { t, r, i, s, e, w } = block.columns;
    for (let at = 0; at < t.length; at += 1) {
      if (w[at] === ENTER) this.begin(r[at], i[at], s[at], e[at], t[at]);
      else if (w[at] === LEAVE || w[at] === CANCEL || w[at] === FAIL)
        this.finish(r[at], i[at], s[at], e[at], t[at], w[at]);
      else if (w[at] === END) this.cancel(r[at], i[at], t[at]);
    }
  }

  /** @param {number} r @param {number} i @param {number} s @param {number} e @param {number} t */
  begin(r, i, s, e, t) {
    const depth = this.block.scopeIndex.get(`${r}/${s}`)?.depth ?? 0;
    const span = { r, i, s, e, from: t, until: Infinity, how: -1, depth };
    const key = tokenKey(r, i, s, e);
    this.found.push(span);
    const held = this.open.get(key);
    if (held === undefined) this.open.set(key, [span]);
    else held.push(span);
  }

  /**
   * @param {number} r @param {number} i @param {number} s @param {number} e @param {number} t
   * @param {number} how
   */
  finish(r, i, s, e, t, how) {
    const span = this.open.get(tokenKey(r, i, s, e))?.shift();
    if (span !== undefined) Object.assign(span, { until: t, how });
  }

  /**
   * An instance has ended, and with it whatever it still did.
   *
   * @param {number} r @param {number} i @param {number} t
   */
  cancel(r, i, t) {
    for (const held of this.open.values()) {
      if (held[0]?.r !== r || held[0].i !== i) continue;
      for (const span of held) Object.assign(span, { until: t, how: CANCEL });
      held.length = 0;
    }
  }
}

/**
 * The executions in a block: bars of the timeline. Each is clipped to the block but knows when it began.
 *
 * @param {LoadedBlock} block
 * @returns {Span[]}
 */
export function spansOf(block) {
  block.spans ??= new Spans(block).found;
  return block.spans;
}
