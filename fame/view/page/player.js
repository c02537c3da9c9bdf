// The one time cursor: where it is, and how it moves.

/** @import {App} from "./main.js" */

const JUMP = 90; // ms between two moves of the cursor which are no longer one movement
export const SPEEDS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100];

export class Player {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    this.time = 0;
    this.speed = 1;
    this.playing = false;
    this.following = false; // whether the cursor stays at the end of a run that lasts
    this.last = null;
    this.sought = -Infinity; // when somebody moved the cursor (ms)
  }

  seek(time, { keep = false } = {}) {
    this.time = Math.min(Math.max(this.app.store.start, Math.round(time)), this.app.store.end);
    if (!keep) this.following = false;
    const now = performance.now();
    if (now - this.sought > JUMP) this.app.inspector.hurry();
    this.sought = now;
    this.app.store.ask(this.time);
    this.app.redraw();
  }

  play(on = !this.playing) {
    if (on && this.time >= this.app.store.end && !this.app.isLive()) this.time = this.app.store.start;
    this.playing = on;
    this.last = null;
    if (!on) this.following = false;
    this.app.changedPlayer();
    this.app.redraw();
  }

  follow(on = true) {
    this.following = on;
    if (on) {
      this.playing = true;
      this.time = this.app.store.end;
    }
    this.app.changedPlayer();
    this.app.redraw();
  }

  faster(step) {
    const at = SPEEDS.findIndex((speed) => speed >= this.speed);
    this.speed = SPEEDS[Math.min(SPEEDS.length - 1, Math.max(0, at + step))];
    this.app.changedPlayer();
  }

  /** Move on by what has passed on the wall (ms). Whether it moved. */
  frame(now) {
    const { store } = this.app;
    if (this.following) {
      const moved = this.time !== store.end;
      this.time = store.end;
      this.last = now;
      return moved;
    }
    if (!this.playing) return false;
    const passed = this.last === null ? 0 : Math.min(now - this.last, 250);
    this.last = now;
    if (!store.blocks[store.numberAt(this.time)]?.data) return true; // wait for it, do not skip it
    this.time = Math.min(store.end, Math.round(this.time + passed * 1e6 * this.speed));
    if (this.time >= store.end) {
      if (this.app.isLive()) this.follow();
      else this.play(false);
    }
    return true;
  }
}
