// Where the page has its data from: the server that sent it, or itself, if it is a file that has all data in it.

const SILENCE = 5000; // ms without a message, of which one comes each second, after which what is live is not known

/** The server of `fame view`, or of a page below it. */
export class Server {
  tab = "team"; // that is shown first

  constructor(below = ".") {
    this.base = new URL(below, location.href);
  }

  async fetch(path) {
    const answer = await fetch(new URL(path, this.base));
    if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
    return Object.assign(await answer.json(), { size: Number(answer.headers.get("content-length")) || undefined });
  }

  async post(command) {
    const answer = await fetch(new URL("control", this.base), { method: "POST", body: JSON.stringify(command) });
    const found = await answer.json().catch(() => ({ error: "the server has ended" }));
    if (!answer.ok) throw new Error(found.error);
    return found;
  }

  /** Give the page what comes while it is open. */
  listen(app) {
    const address = new URL("live", this.base);
    address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(address);
    let heard = performance.now();
    const watch = setInterval(() => {
      if (app.mission.kind === "live" && !app.gone && performance.now() - heard > SILENCE)
        app.disconnected("Nothing comes from fame view any more. The page shows the last state.");
    }, 1000);
    socket.onmessage = ({ data }) => {
      heard = performance.now();
      if (app.gone) app.disconnected("");
      app.news(JSON.parse(data));
    };
    socket.onclose = () => {
      clearInterval(watch);
      app.disconnected("The connection to fame view has ended. The page shows the last state.");
    };
  }
}

/** This file (`page_file.py`): each part is JSON, compressed, in a script element that is never run. */
class File {
  tab = "diagram";

  async fetch(path) {
    const text = await unpacked(await partOf(path));
    return Object.assign(JSON.parse(text), { size: text.length });
  }

  post() {
    return Promise.reject(new Error("This page is a file: nobody listens to it."));
  }

  listen() {}
}

/**
 * The text of a part, once the browser has read as far as that.
 *
 * @param {string} path
 */
async function partOf(path) {
  if (!document.getElementById(path)?.nextElementSibling && document.readyState === "loading")
    await new Promise((done) => document.addEventListener("DOMContentLoaded", done, { once: true }));
  const part = document.getElementById(path);
  if (part === null) throw new Error(`${path} is not in this file`);
  return part.textContent ?? "";
}

/**
 * What gzip has made, from its base64.
 *
 * @param {string} text
 */
function unpacked(text) {
  if (!("DecompressionStream" in window))
    throw new Error("It needs a browser of 2023 or later: Chrome 80, Firefox 113, Safari 16.4.");
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
}

export const source = document.getElementById("mission.json") ? new File() : new Server();
