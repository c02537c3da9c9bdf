// The bar above the timeline: play, pause, speed, time, how many levels are shown, zoom.

import { h, icon, show } from "./dom.js";
import { SPEEDS } from "./player.js";

export class Transport {
  constructor(root, timeline) {
    const { app } = timeline, button = (name, title, action) => h("button", { title, "aria-label": title, onclick: action }, icon(name));
    this.playButton = h("button", { cls: "play", onclick: () => app.player.play() });
    this.now = h("output", { cls: "now", "aria-label": "Time" });
    this.total = h("span", { cls: "total" });
    this.speed = h("select", { title: "Speed ([ slower, ] faster)", "aria-label": "Speed", onchange: () => {
      app.player.speed = Number(this.speed.value);
      app.changedPlayer();
    } }, SPEEDS.map((speed) => h("option", { value: speed }, `${speed}×`)));
    this.live = h("button", { cls: "text live", hidden: true, title: "Follow the run (L)", onclick: () => app.player.follow() }, icon("dot"), "Live");
    this.reading = h("span", { cls: "reading", role: "status" });
    this.level = h("select", { title: "How many levels of called processes have bars", "aria-label": "Levels", onchange: () => {
      timeline.levels = Number(this.level.value);
      app.redraw();
    } }, [1, 2, 3, 4].map((count) => h("option", { value: count }, `${count} level${count > 1 ? "s" : ""}`)));
    this.level.value = "2";
    root.append(h("div", { cls: "bar transport", role: "toolbar", "aria-label": "Playback" },
      button("previous", "Previous event (←)", () => app.step(-1)), this.playButton, button("next", "Next event (→)", () => app.step(1)),
      h("span", { cls: "times" }, this.now, " / ", this.total), this.speed, this.live, this.reading, h("span", { cls: "space" }), this.level,
      h("div", { cls: "tools" }, button("minus", "Longer span (−)", () => timeline.zoom(1.6)), button("plus", "Shorter span (+)", () => timeline.zoom(1 / 1.6)),
        button("fit", "The whole run (0)", () => timeline.all()))));
    this.app = app;
    this.playerChanged();
  }

  /** What the player does has changed. */
  playerChanged() {
    const { player } = this.app, title = player.playing ? "Pause (Space)" : "Play (Space)";
    show(this.playButton, icon(player.playing ? "pause" : "play"));
    this.playButton.title = title;
    this.playButton.setAttribute("aria-label", title);
    this.speed.value = String(player.speed);
    this.live.classList.toggle("on", player.following);
    this.live.hidden = !this.app.isLive();
  }
}
