// The bar above the timeline: one pause and one speed, of the run that the cursor follows or of the replay; time,
// levels, zoom.

import { h, icon, renew, show } from "./dom.js";
import { SPEEDS } from "./player.js";

const button = (name, title, action) => h("button", { title, "aria-label": title, onclick: action }, icon(name));

const zooms = (timeline) => [
  button("minus", "Longer span (−)", () => timeline.zoom(1.6)),
  button("plus", "Shorter span (+)", () => timeline.zoom(1 / 1.6)),
  button("fit", "The whole run (0)", () => timeline.all()),
];

function levels(timeline) {
  const onchange = () => {
    timeline.levels = Number(pick.value);
    timeline.app.redraw();
  };
  const pick = h(
    "select",
    { title: "How many levels of called processes have bars", "aria-label": "Levels", onchange },
    [1, 2, 3, 4].map((count) => h("option", { value: count }, `${count} level${count > 1 ? "s" : ""}`)),
  );
  pick.value = "2";
  return pick;
}

export class Transport {
  constructor(root, timeline) {
    const { app } = timeline;
    const follow = () => app.player.follow();
    this.app = app;
    this.playButton = h("button", { cls: "play", onclick: () => app.pause() });
    this.now = h("output", { cls: "now", "aria-label": "Time" });
    this.total = h("span", { cls: "total" });
    this.speed = h("select", { onchange: () => app.setSpeed(Number(this.speed.value)) });
    const live = { cls: "text live", hidden: true, title: "Follow the run (L)", onclick: follow };
    this.live = h("button", live, icon("dot"), "Live");
    this.reading = h("span", { cls: "reading", role: "status" });
    this.level = levels(timeline);
    root.append(
      h(
        "div",
        { cls: "bar transport", role: "toolbar", "aria-label": "Playback" },
        button("previous", "Previous event (←)", () => app.step(-1)),
        this.playButton,
        button("next", "Next event (→)", () => app.forward()),
        h("span", { cls: "times" }, this.now, h("span", { cls: "of" }, " / "), this.total),
        h("label", { cls: "speed" }, "Speed ", this.speed),
        this.live,
        this.reading,
        h("span", { cls: "space" }),
        h("div", { cls: "tools levels" }, this.level, zooms(timeline)),
      ),
    );
    this.playerChanged();
  }

  /** What the player does has changed. */
  playerChanged() {
    const { app } = this;
    const { player, control } = app;
    const run = app.runs();
    const playing = run ? !control.status?.paused : player.playing;
    const word = playing ? "Pause" : run ? "Resume" : "Play";
    const of = run ? "run" : "replay";
    const now = run ? control.status?.speed : player.speed;
    const key = [run, playing, now, player.following, app.isLive()].join();
    if (key === this.key) return;
    this.key = key;
    show(this.playButton, icon(playing ? "pause" : "play"), word);
    this.playButton.title = `${word} the ${of} (Space)`;
    const speeds = run
      ? [...[...new Set([0.1, 0.5, 1, 2, 5, 10, 50, now || 1])].sort((one, other) => one - other), 0]
      : SPEEDS;
    renew(
      this.speed,
      speeds.map((speed) => h("option", { value: speed }, speed ? `${speed}×` : "at once")),
    );
    this.speed.title = `Speed of the ${of}`;
    this.speed.value = String(now);
    this.live.classList.toggle("on", player.following);
    this.live.hidden = !this.app.isLive();
  }
}
