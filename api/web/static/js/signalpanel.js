// Signal regions of a camera, each with the states that it shows over a minute of the recording.
import { get, query } from "./api.js";
import { attempt, byId, fill, h } from "./dom.js";
import { clock } from "./format.js";

const LENGTH_S = 60;
const COLOURS = /** @type {Object<string, string>} */ ({ red: "#c62828", amber: "#ef9a00", green: "#1b8a3c", red_amber: "#e65100", off: "#555c64" });

const PHASES = ["#7dffa8", "#ffd166", "#7cc7ff", "#ff9ecf", "#c3b1ff", "#ffb38a", "#9ef0f0", "#e2f58a"];

/** A colour for the name of a phase, the same in every camera. @param {string} id */
export function phaseColour(id) {
  return PHASES[[...id].reduce((sum, letter) => (sum * 31 + /** @type {number} */ (letter.codePointAt(0))) % 9973, 7) % PHASES.length];
}

/** The regions of one camera while they are edited. */
export class SignalPanel {
  /** @param {any[]} signals of the site's document @param {import("./footage.js").Footage|null} recording @param {() => void} changed @param {() => number} now the time shown, s */
  constructor(signals, recording, changed, now) {
    this.signals = signals.map((signal) => ({ id: signal.id, region: [...signal.region] }));
    /** What is known of each region's states, drawn: it moves into the list whenever that is made anew. @type {WeakMap<any, HTMLElement>} */
    this.strips = new WeakMap();
    this.recording = recording;
    this.changed = changed;
    this.now = now;
    this.selected = -1;
    this.drawn = /** @type {number[]|null} */ (null);
    this.show();
  }

  document() {
    return this.signals.map(({ id, region }) => ({ id, region }));
  }

  /** @param {number[]} pixel */
  begin(pixel) {
    this.drawn = [...pixel, ...pixel];
  }

  /** @param {number[]} pixel */
  drag(pixel) {
    if (this.drawn) [this.drawn[2], this.drawn[3]] = pixel;
  }

  end() {
    const drawn = this.drawn;
    this.drawn = null;
    if (!drawn) return;
    const region = [Math.min(drawn[0], drawn[2]), Math.min(drawn[1], drawn[3]), Math.abs(drawn[2] - drawn[0]), Math.abs(drawn[3] - drawn[1])].map((value) => Math.round(value * 10) / 10);
    if (region[2] < 2 || region[3] < 4) return;
    const taken = new Set(this.signals.map((signal) => signal.id));
    let id = "a";
    for (let code = 97; taken.has(`phase-${id}`) && code < 123; code += 1) id = String.fromCharCode(code);
    this.signals.push({ id: `phase-${id}`, region });
    this.selected = this.signals.length - 1;
    this.show();
    this.changed();
    this.look(this.selected);
  }

  show() {
    fill(byId("signals"), this.signals.length ? this.signals.map((signal, index) => this.row(signal, index)) : h("p.note", null, "None. Choose “draws a signal region” above the frame and drag a box around a head; or add one and type its numbers."),
      h("button.small", { type: "button", onclick: () => { this.signals.push({ id: `phase-${this.signals.length + 1}`, region: [0, 0, 20, 50] }); this.selected = this.signals.length - 1; this.show(); this.changed(); } }, "Add a region"));
  }

  /** @param {any} signal @param {number} index */
  row(signal, index) {
    const swatch = h("span.swatch", { "aria-hidden": "true" });
    swatch.style.background = phaseColour(signal.id);
    const id = h("input", { value: signal.id, maxlength: 64, "aria-label": `Id of region ${index + 1}` }), box = h("input", { value: signal.region.join(", "), "aria-label": `x, y, width and height of region ${index + 1}` });
    id.addEventListener("change", () => { signal.id = /** @type {HTMLInputElement} */ (id).value.trim(); swatch.style.background = phaseColour(signal.id); this.changed(); });
    box.addEventListener("change", () => {
      const numbers = /** @type {HTMLInputElement} */ (box).value.split(/[\s,;]+/).filter(Boolean).map(Number);
      if (numbers.length === 4 && numbers.every(Number.isFinite)) { signal.region = numbers; this.changed(); this.look(index); }
    });
    return h(`div.region${index === this.selected ? ".selected" : ""}`, { onclick: () => { if (this.selected !== index) { this.selected = index; this.changed(); } } },
      h("div.row", null, swatch, h("label", null, "Phase ", id), h("label", null, "x, y, width, height ", box),
        h("button.small", { type: "button", disabled: !this.recording, onclick: () => this.look(index) }, "What does it show?"),
        h("button.small.quiet", { type: "button", "aria-label": `Remove region ${index + 1}`, onclick: () => { this.signals.splice(index, 1); this.selected = -1; this.show(); this.changed(); } }, "×")),
      this.strip(signal));
  }

  /** Where a region's states are shown. @param {any} signal @returns {HTMLElement} */
  strip(signal) {
    const place = this.strips.get(signal) ?? h("div.strip-place", { "aria-live": "polite" });
    this.strips.set(signal, place);
    return place;
  }

  /** Ask what the region shows for a minute from the time shown. @param {number} index */
  look(index) {
    const signal = this.signals[index];
    if (!signal || !this.recording) return;
    const place = this.strip(signal), region = signal.region.join(","), { recording } = this;
    const current = () => region === signal.region.join(","); // a region that was changed meanwhile has its own answer
    fill(place, h("p.note", null, "Looking …"));
    attempt(async () => {
      try {
        if (!await recording.isRead()) { if (current()) fill(place, h("p.note", null, "The recording is not read yet.")); return; }
        const { path, time, start } = recording.at(this.now());
        const strip = await get(`${path}/signal${query({ region, start_s: time, duration_s: LENGTH_S })}`);
        if (current()) fill(place, stripOf(strip, start));
      } catch (error) {
        if (current()) fill(place);
        throw error;
      }
    });
  }
}

/** States over time, as colours with their names. @param {any} strip of a file @param {number} start of that file in the recording, s */
function stripOf(strip, start) {
  const clockOf = (/** @type {number} */ seconds) => clock(start + seconds);
  if (!strip.changes.length) return h("p.note", null, `No change was seen from ${clockOf(strip.from_s)} to ${clockOf(strip.to_s)}: the region may be wrong, or the lamp did not change.`);
  const spans = [{ from: strip.from_s, state: strip.changes[0].before }, ...strip.changes.map((/** @type {any} */ change) => ({ from: change.time_s, state: change.after }))];
  const length = strip.to_s - strip.from_s, canvas = document.createElement("canvas");
  canvas.width = 900;
  canvas.height = 60;
  canvas.className = "strip";
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", spans.map((span) => `${span.state} from ${span.from.toFixed(1)} s`).join(", "));
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  spans.forEach((span, index) => {
    const end = spans[index + 1]?.from ?? strip.to_s, x0 = (900 * (span.from - strip.from_s)) / length, x1 = (900 * (end - strip.from_s)) / length;
    context.fillStyle = COLOURS[span.state] ?? "#888";
    context.fillRect(x0, 0, x1 - x0, 60);
    context.fillStyle = "#fff";
    context.font = "600 22px system-ui, sans-serif";
    if (x1 - x0 > 24) context.fillText(x1 - x0 > 90 ? span.state.replace("_", " ") : span.state[0].toUpperCase(), x0 + 8, 38);
  });
  return h("div", null, canvas, h("p.note", null, `${clockOf(strip.from_s)} to ${clockOf(strip.to_s)}: ${strip.changes.length} changes, confidence ${Math.min(...strip.changes.map((/** @type {any} */ change) => change.confidence)).toFixed(2)} and more.`));
}
