// Video clips: asking for one of what the player shows, and those that were asked for.
import { getAll, send } from "./api.js";
import { attempt, byId, fill, h, message, say } from "./dom.js";
import { clock, size } from "./format.js";
import { jobId, readOnly } from "./jobtabs.js";

const LOOK_EVERY_MS = 1000;

/**
 * @typedef {Object} Asked what the player shows now, for the service
 * @property {import("./trackdata.js").Filter} filter
 * @property {string} colour @property {number} trailS @property {boolean} boxes @property {number} speed
 */

/** The card beneath the player. */
export class ClipPanel {
  /** @param {() => Asked} shown @param {() => number} nowNs where the player stands @param {() => [number, number]} ends ns of all that was tracked */
  constructor(shown, nowNs, ends) {
    this.shown = shown;
    this.timer = 0;
    byId("clip-form").hidden = readOnly;
    byId("clip-form").addEventListener("submit", (/** @type {Event} */ event) => { event.preventDefault(); attempt(() => this.#ask()); });
    byId("clip-start").addEventListener("click", () => { byId("clip-from").value = (nowNs() / 1e9).toFixed(1); });
    byId("clip-end").addEventListener("click", () => { byId("clip-to").value = (nowNs() / 1e9).toFixed(1); });
    this.ends = ends;
    this.suggested = ["", ""];
    this.#suggest();
    attempt(() => this.look());
  }

  #suggest() {
    const [first, last] = this.ends();
    this.suggested = [first, Math.min(last, first + 10e9)].map((ns) => (ns / 1e9).toFixed(1));
    [byId("clip-from").value, byId("clip-to").value] = this.suggested;
  }

  /** There are other tracks: times that nobody has chosen follow them, and clips may have become outdated. */
  renew() {
    if (byId("clip-from").value === this.suggested[0] && byId("clip-to").value === this.suggested[1]) this.#suggest();
    attempt(() => this.look());
  }

  async #ask() {
    const { filter, ...how } = this.shown(), ns = (/** @type {string} */ id) => Math.round(Number(byId(id).value) * 1e9);
    await send("POST", `/v1/jobs/${jobId}/clips`, {
      start_ns: ns("clip-from"), end_ns: ns("clip-to"), classes: filter.classes, min_speed_mps: filter.minSpeed, polygon: filter.polygon.length > 2 ? filter.polygon : [],
      colour: how.colour, trail_s: how.trailS, boxes: how.boxes, speed: how.speed, width_px: Number(byId("clip-width").value),
    });
    say("The clip is queued.");
    await this.look();
  }

  /** Show all clips, again and again while any is being made. */
  async look() {
    clearTimeout(this.timer);
    const clips = await getAll(`/v1/jobs/${jobId}/clips`);
    const focused = document.activeElement?.closest("[data-clip]")?.getAttribute("data-clip");
    fill(byId("clips"), clips.length ? h("ul.plain", null, clips.map((/** @type {any} */ clip) => this.#row(clip))) : h("p.note", null, "None yet."));
    if (focused) /** @type {HTMLElement|null} */ (document.querySelector(`[data-clip="${focused}"] button`))?.focus();
    if (clips.some((/** @type {any} */ clip) => ["queued", "running"].includes(clip.state))) this.timer = window.setTimeout(() => attempt(() => this.look()), LOOK_EVERY_MS);
  }

  /** @param {any} clip */
  #row(clip) {
    const name = `${clock(clip.spec.start_ns / 1e9)} to ${clock(clip.spec.end_ns / 1e9)}`, video = `/v1/jobs/${jobId}/clips/${clip.id}/video`;
    const remove = () => attempt(async () => { await send("DELETE", `/v1/jobs/${jobId}/clips/${clip.id}`); await this.look(); });
    return h("li.clip", { "data-clip": clip.id, "data-state": clip.state }, h("span", null, name, clip.outdated ? h("small", null, " of earlier tracks") : null),
      clip.state === "succeeded" ? h("a.button.small", { href: video, download: true, "aria-label": `Download the clip ${name}` }, `MP4, ${size(clip.size_bytes)}`) : null,
      clip.state === "running" ? h("progress", { max: 1, value: clip.fraction, "aria-label": `Rendering the clip ${name}` }) : null,
      clip.state === "queued" ? h("span.note", null, "waits for a worker") : null,
      readOnly ? null : h("button.small.quiet", { type: "button", onclick: remove, "aria-label": `Delete the clip ${name}` }, clip.state === "succeeded" || clip.state === "failed" ? "Delete" : "Stop"),
      clip.error ? message("bad", clip.error.message, clip.error.hint) : null);
  }
}
