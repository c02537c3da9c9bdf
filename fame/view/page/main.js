// The page: loads the mission, keeps cursor and selection, and redraws what follows them.

/**
 * @import {Finding, Mission} from "./types.js"
 * @import {State} from "./store.js"
 */
import { byId, clock, colourRobots, h, icon, keep, kept, show, messageOf } from "./dom.js";
import { Acts } from "./acts.js";
import { Change } from "./change.js";
import { Control } from "./control.js";
import { Diagram } from "./diagram.js";
import { Heat } from "./heat.js";
import { Inspector } from "./inspector.js";
import { Panes } from "./panes.js";
import { Player } from "./player.js";
import { source } from "./source.js";
import { Steer } from "./steer.js";
import { Store, TAKE } from "./store.js";
import { Tabs } from "./tabs.js";
import { Team } from "./team.js";
import { Timeline } from "./timeline.js";
import { World } from "./world.js";

const PATIENCE = 250; // ms until the page says that it loads a part of the run
const REST = 150; // ms after the cursor was moved in which nothing else is loaded
const PAINT = 40; // ms in which the browser paints what a jump has changed
const SOON = 200; // ms until what was loaded elsewhere is seen

const KEYS = [
  ["Space", "play, pause"],
  ["← →", "previous, next event (of the chosen robot)"],
  ["Shift ← →", "one second back, forward"],
  ["Home End", "start, end"],
  ["[ ]", "slower, faster"],
  ["+ −", "shorter, longer span of the timeline"],
  ["0", "the whole run"],
  ["F", "fit the diagram"],
  ["M", "the whole page for one part, and back"],
  ["← → Enter", "on a splitter: move it, collapse what is after it"],
  ["1 … 9 A", "choose a robot, all robots"],
  ["/", "search the run"],
  ["L", "follow a run that is in progress"],
  ["Esc", "leave a part with the whole page, clear the selection, then leave a called process"],
  ["?", "this help"],
];

const LEGEND = [
  "A disc is a token: its colour and number are those of the robot. ×3 are three tokens.",
  "Bars are elements in progress: filled for activities, dashed where a token waits, hatched if cancelled, " +
    "with a red border and ✕ if failed.",
  "Arrows are signals, from their sender to the robots that received them. ✕ is an error, ▲ a report.",
  "Double-click a call activity to see what runs in it.",
];

/** @param {Finding[]} findings @returns {Map<number, Finding[]>} */
function byElement(findings) {
  const found = new Map();
  for (const finding of findings) found.set(finding.element, [...(found.get(finding.element) ?? []), finding]);
  return found;
}

/** The page: what it shows, and what is chosen. */
export class App {
  /** @type {Mission} */
  mission = {
    kind: "",
    title: "",
    chips: [],
    notices: [],
    robots: [],
    order: [],
    elements: [],
    planes: [],
    models: [],
    types: {},
    sentences: {},
    reading: 1,
    blocks: [],
    end: 0,
    control: [],
    messages: false,
  };
  selected = { robot: -1, element: -1 };
  /** @type {Set<number>} elements */
  breakpoints = new Set();
  /** @type {Map<number, Finding[]>} by element */
  findings = new Map();
  /** @type {State | null} at the cursor; null while its block is being loaded */
  state = null;
  waiting = false;
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  timer = undefined; // redraws at `due`
  due = Infinity;
  /** @type {number | null} */
  missing = null; // since when the state at the cursor is being loaded (ms)
  gone = ""; // what has become of the connection, if nothing comes by it
  reloading = Promise.resolve();
  /** @type {Mission["version"]} */
  version = undefined; // of the mission, once it is loaded
  drawing = true; // whether the diagram is that of the mission

  constructor() {
    this.store = new Store(
      (number) => this.fetch(`block/${number}.json`),
      (time) => this.fetch(`at/${time}.json`),
    );
    this.player = new Player(this);
    this.control = new Control(byId("controls"), this);
    this.acts = new Acts(this);
    this.heat = new Heat(this);
    this.change = new Change(this);
    this.steer = new Steer(byId("steer"), this);
    this.tabs = new Tabs(byId("tabs"), this);
    this.team = new Team(byId("team"), byId("needs"), this);
    this.diagram = new Diagram(byId("diagram"), this);
    this.world = new World(byId("world"), this);
    this.inspector = new Inspector(byId("inspector"), this);
    this.timeline = new Timeline(byId("time"), this);
    this.plots = this.timeline.plots;
    this.panes = new Panes(this);
    this.store.onchange((number) => this.loaded(number));
    this.tools();
    this.keys();
  }

  fetch(path) {
    return source.fetch(path);
  }

  post(command) {
    return source.post(command);
  }

  // ---- the mission -------------------------------------------------------------------------------

  async start() {
    await this.reload();
    this.fromLink();
    source.listen(this);
    // the address may be replaced meanwhile
    addEventListener("hashchange", (event) => this.fromLink(new URL(event.newURL).hash));
    this.inspector.warm();
    this.prefetch();
  }

  /** Take the mission as it is now, after those that are on their way, unless that is a version which is there. */
  reload(version) {
    const last = this.reloading.catch(() => {});
    this.reloading = last.then(async () => {
      if (version !== undefined && version === this.version) return;
      this.version = undefined;
      const mission = await this.fetch("mission.json");
      await this.load(mission);
      this.version = mission.version;
    });
    return this.reloading;
  }

  /** Take the mission, or a new one that differs. Nothing of it is drawn before its diagram is there. */
  async load(mission) {
    const models = JSON.stringify([mission.models, mission.planes.map(({ file, title }) => [file, title])]);
    const before = this.mission.elements;
    this.mission = mission;
    this.renumber(before);
    colourRobots(mission.order);
    this.store.index(mission.blocks, mission.end);
    this.store.complete = mission.reading >= 1;
    if (this.player.time < this.store.start) this.player.seek(this.store.start, { keep: true });
    else this.store.ask(this.player.time);
    this.findings = byElement(mission.findings ?? []);
    const same = models === this.models;
    this.models = models;
    this.drawing = false;
    try {
      if (!same || mission.kind === "model") await this.redrawDiagram(same ? this.diagram.trail : []);
    } finally {
      this.drawing = true;
    }
    this.heading();
    document.body.dataset.kind = mission.kind;
    if (mission.kind === "model") this.tabs.choose("diagram", false);
    document.body.style.setProperty("--lanes", String(Math.max(2, mission.robots.length)));
    if (mission.monitor && !this.plots.shown.length) this.plots.judge(mission.monitor);
    this.changedPlayer();
    this.inspector.hurry();
    this.redraw();
  }

  /** What is chosen and open stays so in a model that was saved, where its elements have other numbers. */
  renumber(before) {
    const { kind, elements } = this.mission;
    if (kind !== "model") return void elements.push(...before.slice(elements.length)); // they came in the meantime
    const now = (old) => elements.findIndex(({ id, file }) => id === before[old]?.id && file === before[old]?.file);
    this.selected.element = now(this.selected.element);
    this.diagram.trail = this.diagram.trail.map(([plane, opener]) => [plane, now(opener)]);
  }

  /** Draw the models anew: the same place at the same zoom, if it is still there. */
  async redrawDiagram(trail) {
    const { mission, diagram } = this;
    diagram.forget();
    diagram.trail = trail;
    if (trail.length) {
      await diagram.draw(trail.at(-1)[0]);
      return;
    }
    diagram.plane = -1;
    if (mission.planes.length) await diagram.open(Math.max(0, mission.robots[mission.order[0]]?.plane ?? 0));
    else if (mission.models.length) diagram.draw(-1);
    else diagram.nothing(mission.empty?.[0] ?? "Nothing to show", mission.empty?.[1] ?? "");
  }

  heading() {
    const { mission } = this;
    const chip = (text, cls = "", title = "") => h("span", { cls: `chip ${cls}`, title }, text);
    byId("title").textContent = mission.title;
    document.title = `${mission.title} · fame view`;
    const person = mission.person
      ? [[`${mission.person.user} (${mission.person.role})`, "completed", "who uses this page"]]
      : [];
    const chips = mission.chips.map(([text, cls, title]) =>
      this.gone && cls === "live" ? ["not live", "failed", this.gone] : [text, cls, title],
    );
    show(
      byId("chips"),
      [...chips, ...person].map(([text, cls, title]) => chip(text, cls, title)),
    );
    byId("top").classList.toggle("gone", this.gone !== "");
    show(
      byId("notices"),
      [...(this.gone && mission.kind === "live" ? [this.gone] : []), ...(mission.notices ?? [])].map((text) =>
        h("span", { cls: "notice", title: text }, text),
      ),
    );
  }

  isLive() {
    return this.mission.kind === "live" && !this.control.status?.over;
  }

  findingsOf(element) {
    return this.findings.get(element);
  }

  /** The robots that are lost at an instant, and since when. */
  lost(time) {
    const lost = this.control.status?.lost;
    return new Map(lost && time >= this.store.end - 1e9 ? Object.entries(lost) : []);
  }

  /** Show a robot, or one of its elements, in its diagram. */
  goTo(robot, element = -1) {
    this.tabs.choose("diagram");
    this.select({ robot, element }, { reveal: element >= 0 });
  }

  controlKey() {
    return `${JSON.stringify(this.control.status)}${[...this.breakpoints]}`;
  }

  /** Say that what is shown may have changed since; or nothing any more: the connection is there again. */
  disconnected(text) {
    this.gone = text;
    this.heading();
    if (!text) byId("toast").hidden = true;
    else if (this.mission.kind !== "recording" || this.mission.reading < 1) this.toast(text, true);
  }

  news(news) {
    if (news.type === "beat") return;
    if (news.type === "begin") return void location.reload(); // another run
    this.store.take(news, this.mission);
    if (news.type === "index") {
      this.prefetch();
      this.soon();
      return;
    }
    if (news.type === "run") this.run(news);
    else if (news.type === "reload") this.reload(news.version).then(() => this.prefetch());
    this.redraw();
  }

  run(news) {
    const stopped = news.stopped && news.stopped !== this.control.status?.stopped;
    this.control.status = news;
    this.breakpoints = new Set(news.breakpoints);
    if (stopped) this.toast(news.stopped);
    this.changedPlayer();
  }

  /** Load the blocks one after the other, those at the cursor first. */
  async prefetch() {
    if (this.fetching) return;
    this.fetching = true;
    try {
      for (;;) {
        await this.calm();
        const missing = this.store.missing(this.player.time).slice(0, 2);
        if (!missing.length) break;
        await Promise.all(missing.map((block) => this.store.want(block.number)));
      }
    } catch {
      /* the server has ended; what is there stays */
    } finally {
      this.fetching = false;
    }
  }

  /** Wait until no movement of the cursor is to be shown, and the browser has nothing else to do. */
  async calm() {
    for (;;) {
      if ("requestIdleCallback" in window) await new Promise((done) => requestIdleCallback(done, { timeout: SOON }));
      if (!this.store.peeking && this.missing === null && performance.now() - this.player.sought > REST) return;
      await new Promise((done) => setTimeout(done, 30));
    }
  }

  // ---- cursor and selection ----------------------------------------------------------------------

  /**
   * @param {{robot?: number, element?: number}} change
   * @param {{reveal?: boolean, scope?: number | null, openers?: number[] | null}} [options]
   */
  select(change, { reveal = false, scope = null, openers = null } = {}) {
    const before = this.selected.robot;
    /** @type {Promise<void> | null} */
    let shown = null;
    Object.assign(this.selected, change);
    if (reveal && this.selected.element >= 0) {
      const around = openers ?? (scope !== null && this.state ? this.state.openers(this.selected.robot, scope) : []);
      shown = this.diagram.reveal(this.selected.element, around);
    } else if (change.robot !== undefined && change.robot >= 0) shown = this.diagram.ofRobot(change.robot);
    if (this.selected.robot !== before) Promise.resolve(shown).then(() => this.diagram.focus());
    this.saveLink();
    this.redraw();
  }

  changedPlayer() {
    this.timeline?.transport.playerChanged();
    this.saveLink();
  }

  changedPlots() {
    const { length } = this.plots.shown; // room for the first ones; more are scrolled to
    document.body.style.setProperty(
      "--lanes",
      String(Math.max(2, this.mission.robots.length) + 1.3 * Math.min(length, 3)),
    );
    this.redraw();
  }

  /** Whether pause, step and speed are those of the run: the cursor follows it, whether it has said anything or not. */
  runs() {
    return this.player.following && this.isLive() && this.control.can.has("pause");
  }

  /** Pause or resume what goes on: the run, or the replay. */
  pause() {
    if (this.runs()) this.control.send({ do: this.control.status?.paused ? "resume" : "pause" });
    else this.player.play();
  }

  setSpeed(speed) {
    if (this.runs()) this.control.send({ do: "speed", speed });
    else {
      this.player.speed = speed;
      this.changedPlayer();
    }
  }

  /** To the next event, which a paused run makes. */
  forward() {
    if (this.runs()) this.control.send({ do: "step" });
    else this.step(1);
  }

  /** To the next or previous event that moved a token. */
  async step(by) {
    this.player.play(false);
    const { robot } = this.selected;
    const found = await this.store.find(
      this.player.time,
      by,
      (data, at) => data.columns.w[at] !== TAKE && (robot < 0 || data.columns.r[at] === robot),
    );
    if (found !== null) this.player.seek(found);
    else if (by < 0) this.player.seek(0);
  }

  // ---- links -------------------------------------------------------------------------------------

  link() {
    const { robots, elements } = this.mission;
    const parts = new URLSearchParams();
    parts.set("t", String(this.player.time / 1e9));
    if (this.selected.robot >= 0) parts.set("robot", robots[this.selected.robot].name);
    const element = elements[this.selected.element];
    if (element !== undefined) parts.set("element", element.file ? `${element.id}@${element.file}` : element.id);
    return parts.toString();
  }

  saveLink() {
    if (!this.mission.kind) return;
    clearTimeout(this.linkTimer);
    this.linkTimer = setTimeout(() => {
      const hash = `#${this.link()}`;
      if (location.hash !== hash) history.replaceState(null, "", hash);
    }, 250);
  }

  fromLink(hash = location.hash) {
    clearTimeout(this.linkTimer);
    const parts = new URLSearchParams(hash.slice(1));
    const { robots, elements } = this.mission;
    if (parts.has("t")) this.player.seek(Math.round(Number(parts.get("t")) * 1e9) || 0);
    else if (this.isLive()) this.player.follow();
    const robot = robots.findIndex((one) => one.name === parts.get("robot"));
    const [id, file = "0"] = (parts.get("element") ?? "").split("@");
    const element = id ? elements.findIndex((one) => one.id === id && String(one.file ?? 0) === file) : -1;
    this.select({ robot, element }, { reveal: element >= 0 });
  }

  // ---- drawing -----------------------------------------------------------------------------------

  redraw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame((now) => {
      this.waiting = false;
      this.draw(now);
    });
  }

  /** Redraw what is not urgent, not more than once for all that comes meanwhile. */
  soon(after = SOON) {
    const due = performance.now() + after;
    if (due >= this.due) return;
    clearTimeout(this.timer);
    this.due = due;
    this.timer = setTimeout(() => {
      this.due = Infinity;
      this.redraw();
    }, after);
  }

  /** Draw at once what the cursor waits for: the next frame then has only to paint it. */
  loaded(number) {
    if (this.missing !== null && (number < 0 || number === this.store.numberAt(this.player.time)))
      this.draw(performance.now());
    else this.soon();
    this.prefetch();
  }

  draw(now) {
    if (!this.drawing) return;
    const begun = performance.now();
    const moved = this.player.frame(now);
    const { time } = this.player;
    this.state = this.store.stateAt(time);
    if (moved) this.saveLink();
    // the end of a run that is followed moves with the news
    if (this.player.playing && !this.player.following) this.redraw();
    const jumped = this.missing !== null;
    if (this.isMissing(begun)) {
      // it comes soon: whatever is drawn meanwhile would delay it
      this.timeline.point(time);
      return;
    }
    this.frames = (this.frames ?? 0) + 1;
    this.team.update(this.state, time);
    this.steer.update(this.state);
    if (this.state !== null) {
      this.world.attend(this.state);
      if (this.tabs.shows("map")) this.drawWorld(time);
      if (this.tabs.shows("diagram")) this.diagram.update(this.state, this.player.playing);
    } else if (this.mission.kind === "model") this.diagram.update(null, false);
    if (this.tabs.shows("log")) this.inspector.update(this.state, time);
    if (jumped && this.timeline.has(time)) {
      // the bars have been there before
      this.timeline.follow(time);
      this.soon(PAINT);
    } else this.timeline.update(time, begun);
    this.control.update();
  }

  /** Whether everything that can be seen shows an instant. */
  shows(time) {
    return (
      this.state?.time === time &&
      [this.diagram, this.world, this.inspector, this.timeline].every((part) => part.shown === time)
    );
  }

  /** The world comes from any simulation: one that cannot be drawn does not stop the rest of the page. */
  drawWorld(time) {
    try {
      this.world.update(this.state, time);
    } catch (error) {
      if (!this.strangeWorld) this.toast(`The world cannot be drawn: ${messageOf(error)}`, true);
      this.strangeWorld = true;
    }
  }

  /** Whether the state at the cursor is being loaded, and has been for a moment only. */
  isMissing(now) {
    const since = this.missing ?? now;
    this.missing = this.state !== null || !this.store.blocks.length ? null : since;
    const missing = this.missing !== null && now - since < PATIENCE;
    if (missing) this.soon(PATIENCE);
    return missing;
  }

  // ---- page --------------------------------------------------------------------------------------

  toast(text, bad = false) {
    const box = byId("toast");
    box.textContent = text;
    box.className = bad ? "bad" : "";
    box.hidden = false;
    clearTimeout(this.toastTimer);
    this.toastTimer = setTimeout(
      () => {
        box.hidden = true;
      },
      bad ? 9000 : 5000,
    );
  }

  tools() {
    const button = (name, title, action) => h("button", { title, "aria-label": title, onclick: action }, icon(name));
    show(
      byId("tools"),
      button("link", "Copy a link to this instant, robot and element", () => this.copy()),
      button("moon", "Light or dark", () => this.theme()),
      button("help", "Keyboard and legend (?)", () => this.help()),
    );
    const saved = kept("localStorage", "fame-theme");
    this.setTheme(saved ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"));
  }

  setTheme(theme) {
    document.documentElement.dataset.theme = theme;
    this.redraw();
  }

  theme() {
    const theme = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
    keep("localStorage", "fame-theme", theme);
    this.setTheme(theme);
  }

  async copy() {
    const address = `${location.href.split("#")[0]}#${this.link()}`;
    history.replaceState(null, "", address);
    try {
      await navigator.clipboard.writeText(address);
      this.toast(`Link to ${clock(this.player.time)} copied.`);
    } catch {
      this.toast("The link is in the address bar.");
    }
  }

  help() {
    const dialog = /** @type {HTMLDialogElement} */ (byId("help"));
    const keys = KEYS.map(([names, text]) => {
      const each = names.split(" ").map((name) => h("kbd", null, name));
      return [h("dt", null, each), h("dd", null, text)];
    });
    const legend = LEGEND.map((text) => h("li", null, text));
    const close = h("button", { title: "Close" }, icon("close"));
    show(
      dialog,
      h(
        "form",
        { method: "dialog" },
        h("div", { cls: "head" }, h("h2", null, "Keyboard"), close),
        h("dl", { cls: "keys" }, keys),
        h("h2", null, "Legend"),
        h("ul", null, legend),
      ),
    );
    dialog.showModal();
  }

  keys() {
    const actions = this.actions();
    addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
      const { localName } = /** @type {Element} */ (event.target);
      if (/^(input|select|textarea)$/i.test(localName)) return;
      if (event.key === " " && localName === "button") return;
      const action = actions[event.key] ?? actions[event.key.toLowerCase()];
      if (action === undefined) return;
      event.preventDefault();
      action(event);
    });
  }

  /** What the keys do. */
  actions() {
    const { player, timeline } = this;
    const choose = (place) => place in this.mission.order && this.select({ robot: this.mission.order[place] });
    const digits = [1, 2, 3, 4, 5, 6, 7, 8, 9].map((number) => [number, () => choose(number - 1)]);
    return {
      ...Object.fromEntries(digits),
      " ": () => this.pause(),
      ArrowLeft: (event) => (event.shiftKey ? player.seek(player.time - 1e9) : this.step(-1)),
      ArrowRight: (event) => (event.shiftKey ? player.seek(player.time + 1e9) : this.forward()),
      Home: () => player.seek(0),
      End: () => player.seek(this.store.end),
      "[": () => player.faster(-1),
      "]": () => player.faster(1),
      "+": () => timeline.zoom(1 / 1.6),
      "=": () => timeline.zoom(1 / 1.6),
      "-": () => timeline.zoom(1.6),
      0: () => timeline.all(),
      f: () => this.diagram.fit(),
      l: () => this.isLive() && player.follow(),
      a: () => this.select({ robot: -1 }),
      "?": () => this.help(),
      "/": () => this.mission.kind !== "model" && this.inspector.openSearch(),
      m: () => this.panes.maximise(),
      Escape: () => this.panes.restore() || this.escape(),
    };
  }

  escape() {
    const { robot, element } = this.selected;
    if (element >= 0 || robot >= 0) this.select({ robot: -1, element: -1 });
    else this.diagram.up();
  }
}

const app = new App();
Object.assign(window, { fame: app }); // for the console, and for tests
app.start().catch((error) => {
  app.diagram.nothing("The page could not be loaded", messageOf(error));
});
