// What each robot of the team does at an instant, in the words of the diagram, and who needs somebody.

/** The states of a robot, those that need somebody first. */
export const STATES = [
  "incident",
  "lost",
  "failed",
  "waiting",
  "suspended",
  "running",
  "ready",
  "idle",
  "completed",
  "cancelled",
];
export const STATE_WORDS = {
  incident: "incident",
  lost: "lost",
  failed: "failed",
  waiting: "waits for a person",
  suspended: "suspended",
  running: "running",
  ready: "to be started",
  idle: "no mission",
  completed: "completed",
  cancelled: "cancelled",
};
const OR = new Intl.ListFormat("en-GB", { type: "disjunction" });
const byName = new Intl.Collator(undefined, { numeric: true });
/** The states of robots that need somebody. */
export const WANTED = new Set(["incident", "lost", "failed", "waiting"]);
const SPOKEN = /task|callActivity|subProcess|transaction|adHoc/i;
/** @type {[name: string, text: (value: number) => string][]} */
const PROGRESS = [
  ["distance_remaining", (m) => `${m.toFixed(1)} m to go`],
  ["number_of_poses_remaining", (n) => `${n} places to go`],
  ["time_left", (s) => `${s.toFixed(0)} s to go`],
  ["distance_traveled", (m) => `${m.toFixed(1)} m done`],
  ["angular_distance_traveled", (rad) => `${((rad * 180) / Math.PI).toFixed(0)}° done`],
];

/** The people that have to do something at a token: it waits for somebody to complete it, or to repair it. */
export const needsSomebody = (wait) => wait.kind === "incident" || (wait.kind === "user" && !wait.suspended);

/**
 * A row for each robot: {r, name, state, doing, progress, since, battery, open: tokens that need somebody, missed,
 * failed: how many of its instances did, blind: why its monitor cannot judge}.
 */
export function roster(app, state, time) {
  const rows = app.mission.robots.map(({ name }, r) => ({
    r,
    name,
    tokens: [],
    waits: [...(state.waits.get(r)?.values() ?? [])],
  }));
  for (const token of state.tokens.values()) rows[token.r]?.tokens.push(token);
  const lost = app.lost(time);
  for (const row of rows) describe(app, state, time, row, lost.get(row.name));
  // the others keep their places while they work
  const longest = (a, b) => (WANTED.has(a.state) ? a.since - b.since : 0);
  return rows.sort(
    (a, b) => STATES.indexOf(a.state) - STATES.indexOf(b.state) || longest(a, b) || byName.compare(a.name, b.name),
  );
}

function describe(app, state, time, row, lost) {
  const [ended, failed, last, at] = state.ends.get(row.r) ?? [0, 0, "idle", -1];
  occupy(app, state, row, at);
  row.failed = failed && (ended > 1 || row.tokens.length) ? `${failed} of ${ended} instances failed` : "";
  const suspended = row.waits.find((wait) => wait.suspended);
  if (lost !== undefined) Object.assign(row, { state: "lost", since: lost });
  else if (row.open.some((wait) => wait.kind === "incident")) row.state = "incident";
  else if (row.open.length) row.state = "waiting";
  else if (suspended) row.state = "suspended";
  else if (row.tokens.length) row.state = "running";
  // one that failed stays, whatever completed after it
  else row.state = failed ? "failed" : last in STATE_WORDS ? last : "completed";
  row.blind = blindness(app, state, row);
  row.start = row.tokens.length || lost !== undefined ? "" : startOf(app, row.r);
  if (row.state === "idle" && row.start) row.state = "ready";
  row.by = suspended?.by ?? "";
  if (row.open.length) row.since = Math.min(...row.open.map((wait) => wait.since));
  row.battery = battery(app, state, row, time);
  row.missed = row.waits.reduce(
    (last, { missed, e }) => (missed && (!last || missed.time > last.time) ? { ...missed, e } : last),
    null,
  );
}

/** Why a monitor that a robot runs cannot judge; empty if it can. */
export function blindness(app, state, { r, tokens }) {
  const tasks = tokens.filter((token) => /service/i.test(app.mission.elements[token.e]?.tag));
  const told = tasks.map((token) => state.valueOf(r, token.s, "monitor_blind"));
  return told.find((text) => typeof text === "string" && text) ?? "";
}

/** Add to a row what its robot does, and the tokens that need somebody. `idle`: since when it does nothing. */
function occupy(app, state, row, idle = -1) {
  row.open = row.waits.filter(needsSomebody).sort((a, b) => a.since - b.since);
  const [task] = row.open;
  const e = task === undefined ? -1 : drawn(app, state.openers(row.r, task.scope), task.e);
  return Object.assign(
    row,
    activity(app, state, row) ?? { doing: e < 0 ? "" : nameOf(app, e), since: idle, element: e },
  );
}

/** What a robot does at an instant, in the words of the diagram. */
export function doing(app, state, r) {
  const tokens = [...state.tokens.values()].filter((token) => token.r === r);
  return occupy(app, state, {
    r,
    name: app.mission.robots[r].name,
    tokens,
    waits: [...(state.waits.get(r)?.values() ?? [])],
  }).doing;
}

/** What begins the process of a robot: "waits for stand_open"; empty if it begins at once, or there is none. */
export function startOf(app, r) {
  const { starts = [] } = app.mission.robots[r] ?? {};
  return starts.length ? `waits for ${OR.format(starts.map((e) => nameOf(app, e)))}` : "";
}

/** The element of the diagram that a token belongs to: of what a library does, the call activity that is drawn. */
export function drawn(app, openers, element) {
  return openers.find((opener) => app.mission.elements[opener]?.calls !== undefined) ?? element;
}

/** The words that people see for an element. */
export function nameOf(app, element) {
  const { name, id, tag = "", topics } = app.mission.elements[element] ?? { id: "?" };
  return name || (/Event$/.test(tag) && topics?.length ? topics[0][0] : id);
}

function activity(app, state, row) {
  const { elements } = app.mission;
  const found = candidates(app, state, row);
  const [first, ...more] = found.sort((a, b) => b.rank - a.rank || b.since - a.since);
  if (first === undefined) return null;
  const spoken = SPOKEN.test(elements[first.e].tag);
  return {
    element: first.e,
    doing: `${spoken ? "" : "Waits: "}${elements[first.e].name || first.gate || nameOf(app, first.e)}`,
    more: more.filter(({ rank }) => rank > 1).length,
    since: first.since,
    progress: progress(app, state, row, first),
  };
}

/**
 * The elements that hold a robot's tokens: {e, rank: how much it says of what the robot does, since, scopes, gate: what
 * it waits for at a gateway}.
 */
function candidates(app, state, row) {
  const { elements } = app.mission;
  const held = new Set(row.waits.filter((wait) => wait.suspended).map((wait) => `${wait.scope}/${wait.e}`));
  const around = new Set(row.tokens.flatMap((token) => state.openers(token.r, token.s)));
  const found = new Map();
  for (const token of row.tokens) {
    const e = drawn(app, state.openers(token.r, token.s), token.e);
    const element = elements[e];
    const within = around.has(token.e) && element?.calls === undefined;
    if (element === undefined || /process$/.test(element.tag) || within) continue;
    const gate = /Gateway$/.test(element.tag) ? shortened(waitAt(row, token)?.text, row.name) : "";
    if (gate === undefined) continue; // it goes on at once
    const need = row.open.includes(waitAt(row, token));
    const still = held.has(`${token.s}/${token.e}`);
    const rank = need ? 4 : still ? 0 : SPOKEN.test(element.tag) ? 3 : gate ? 0.5 : 1;
    const known = found.get(e);
    found.set(e, {
      e,
      gate,
      rank: Math.max(rank, known?.rank ?? 0),
      since: Math.min(token.since, known?.since ?? Infinity),
      scopes: [...(known?.scopes ?? []), token.s],
    });
  }
  return [...found.values()];
}

/** What a token of a robot waits for, undefined if it does not. */
function waitAt(row, token) {
  return row.waits.find((wait) => wait.e === token.e && wait.scope === token.s);
}

/** What is waited for, without what a robot's own topics begin with: "joint_trajectory or timer". */
const shortened = (text, robot) => text?.replaceAll("topic /", "").replaceAll(`${robot}/`, "");

/** How far an activity has come: from the feedback of its action, or the way to its goal. */
function progress(app, state, { r }, { e, scopes }) {
  const element = app.mission.elements[e];
  const values = new Map();
  if (element.calls === undefined && !/service/i.test(element.tag)) return "";
  for (const scope of scopes)
    for (const [name, value] of state.visible(r, scope)) if (!values.has(name)) values.set(name, value);
  for (const [name, text] of PROGRESS)
    if (typeof values.get(name) === "number" && reads(app, element, name)) return text(values.get(name));
  const pose = state.poses.get(r);
  const [x, y] = [values.get("x_goal"), values.get("y_goal")];
  return pose && typeof x === "number" && typeof y === "number" && reads(app, element, "x_goal")
    ? `${Math.hypot(x - pose.x, y - pose.y).toFixed(1)} m to go`
    : "";
}

/** Whether a call's process, or a task itself, is about a variable: others may have left it behind. */
function reads(app, element, name) {
  const { elements } = app.mission;
  element.about ??= new Map();
  if (!element.about.has(name)) {
    const inside =
      element.calls === undefined
        ? [element]
        : elements.filter((one) => (one.file ?? 0) === (elements[element.calls]?.file ?? 0));
    element.about.set(
      name,
      inside.some((one) => one.uses?.includes(name)),
    );
  }
  return element.about.get(name);
}

/** The charge of a robot, 0 to 1: of the simulated robot, or as its battery_state said last; null where nobody says. */
function battery(app, state, { r, name }, time) {
  const charge = state.poses.get(r)?.charge;
  const row = app.store.lastMessage(`/${name}/battery_state`, time);
  const told = row?.[3]?.percentage;
  if (typeof told === "number") return told;
  return charge !== undefined && charge < 1 ? charge : null;
}
