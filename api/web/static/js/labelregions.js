// Regions of an instant: on the ground, where nobody looks closely, and in a camera's picture, where something stands before the road.
import { byId, fill, h, say } from "./dom.js";
import { mayChange } from "./labelpanel.js";
import { token } from "./plan.js";

/**
 * @typedef {Object} Region as the API has it
 * @property {"do_not_care"|"hidden"} kind
 * @property {string|null} camera
 * @property {number[][]} polygon X, Y in m on the ground, or u, v in px of a camera's picture
 */

const NAMES = { do_not_care: "do not care", hidden: "hidden" };

/** What two people left of the regions that both began with: what one took away is gone, what one added is there. @param {Region[]} base @param {Region[]} mine @param {Region[]} theirs @returns {Region[]} */
export function mergedRegions(base, mine, theirs) {
  const keys = (/** @type {Region[]} */ all) => new Set(all.map(keyOf)), [b, m, t] = [keys(base), keys(mine), keys(theirs)];
  const all = new Map([...mine, ...theirs].map((one) => [keyOf(one), one]));
  return [...all].filter(([key]) => !b.has(key) || (m.has(key) && t.has(key))).map(([, one]) => one);
}

/** @param {Region} one */
const keyOf = (one) => JSON.stringify([one.kind, one.camera, one.polygon]);

/** Draws regions by their corners, and lists them. */
export class RegionTool {
  /** @param {import("./labelmodel.js").Model} model @param {() => void} redraw @param {boolean} readOnly */
  constructor(model, redraw, readOnly) {
    this.model = model;
    this.redraw = redraw;
    this.readOnly = readOnly;
    /** @type {Region|null} being drawn */
    this.drawn = null;
    for (const kind of /** @type {Array<"do_not_care"|"hidden">} */ (["do_not_care", "hidden"])) {
      byId(`region-${kind}`).disabled = readOnly;
      byId(`region-${kind}`).addEventListener("click", () => (this.drawn?.kind === kind ? this.end() : this.begin(kind)));
    }
    byId("region-form").hidden = readOnly;
    byId("region-form").addEventListener("submit", (/** @type {Event} */ event) => { event.preventDefault(); this.#typed(); });
  }

  /** @param {string[]} cameras */
  offer(cameras) {
    fill(byId("region-where"), h("option", { value: "" }, "on the ground, m: do not care"), cameras.map((camera) => h("option", { value: camera }, `in the picture of ${camera}, px: hidden`)));
  }

  /** @param {"do_not_care"|"hidden"} kind */
  begin(kind) {
    this.drawn = { kind, camera: null, polygon: [] };
    this.#show();
    say(kind === "hidden" ? "Click corners in one camera's picture; Enter ends, Escape drops it." : "Click corners in the plan or in a view; Enter ends, Escape drops it.");
  }

  /** Take what was drawn; while an instant is loading, it stays drawn. */
  end() {
    if (!mayChange(this.model)) return;
    const region = this.drawn;
    this.drawn = null;
    this.#show();
    if (region && region.polygon.length > 2) this.model.replace(this.model.vehicles, { regions: [...this.model.regions, region] });
    else this.redraw();
  }

  /** Drop what was drawn. */
  drop() {
    this.drawn = null;
    this.#show();
    this.redraw();
  }

  /** Whether a click is a corner. @param {string|null} camera null in the plan @param {number[]} at px in a camera's picture, m in the plan @param {number[]|null} ground */
  click(camera, at, ground) {
    const region = this.drawn;
    if (!region) return false;
    if (region.kind === "do_not_care" && ground) region.polygon.push([ground[0], ground[1]]);
    if (region.kind === "hidden" && camera && (region.camera ?? camera) === camera) { region.camera = camera; region.polygon.push([at[0], at[1]]); }
    this.redraw();
    return true;
  }

  #typed() {
    const camera = byId("region-where").value || null, input = byId("region-corners");
    const polygon = input.value.split(";").map((/** @type {string} */ corner) => corner.trim().split(/[\s,]+/).map(Number));
    const wrong = polygon.length < 3 || polygon.some((/** @type {number[]} */ corner) => corner.length !== 2 || corner.some((value) => !Number.isFinite(value)));
    input.setCustomValidity(wrong ? "Three corners at least: x,y; x,y; x,y" : "");
    if (!input.reportValidity() || !mayChange(this.model)) return;
    input.value = "";
    this.model.replace(this.model.vehicles, { regions: [...this.model.regions, { kind: camera ? "hidden" : "do_not_care", camera, polygon }] });
  }

  #show() {
    for (const kind of ["do_not_care", "hidden"]) byId(`region-${kind}`).setAttribute("aria-pressed", String(this.drawn?.kind === kind));
    byId("labelling").classList.toggle("placing", !!this.drawn);
  }

  /** The list of all. */
  list() {
    const remove = (/** @type {Region} */ region) => { if (mayChange(this.model)) this.model.replace(this.model.vehicles, { regions: this.model.regions.filter((one) => one !== region) }); };
    fill(byId("regions"), this.model.regions.map((region, index) => {
      const name = `${index + 1}: ${NAMES[region.kind]}${region.camera ? ` in ${region.camera}` : ""}, ${region.polygon.length} corners`;
      return h("li", null, name, " ", this.readOnly ? null : h("button.small.quiet", { type: "button", "aria-label": `Remove region ${name}`, onclick: () => remove(region) }, "Remove"));
    }));
  }

  /** @param {import("./plan.js").Plan} plan @param {CanvasRenderingContext2D} context */
  drawInPlan(plan, context) {
    for (const region of this.#all("do_not_care")) outline(plan, context, region.polygon, region !== this.drawn);
  }

  /** @param {import("./frameview.js").FrameView} view @param {CanvasRenderingContext2D} context @param {import("./projection.js").Camera} camera */
  drawInView(view, context, camera) {
    for (const region of this.#all("hidden")) if (region.camera === camera.id) outline(view, context, region.polygon, region !== this.drawn);
    for (const region of this.#all("do_not_care")) {
      const corners = region.polygon, closed = region !== this.drawn && corners.length > 2;
      for (let k = 0; k < corners.length - (closed ? 0 : 1); k += 1) {
        const [a, b] = [corners[k], corners[(k + 1) % corners.length]];
        outline(view, context, camera.line([a[0], a[1], 0], [b[0], b[1], 0]), false);
      }
    }
  }

  /** @param {"do_not_care"|"hidden"} kind @returns {Region[]} */
  #all(kind) {
    return [...this.model.regions, ...(this.drawn ? [this.drawn] : [])].filter((region) => region.kind === kind);
  }
}

/** Dashed, with a light fill: a region is no thing. @param {import("./plan.js").Plan|import("./frameview.js").FrameView} on @param {CanvasRenderingContext2D} context @param {number[][]} corners @param {boolean} closed */
function outline(on, context, corners, closed) {
  if (!corners.length) return;
  on.trace(context, corners, closed);
  if (closed) { context.globalAlpha = 0.25; context.fillStyle = "#b07aa1"; context.fill(); context.globalAlpha = 1; }
  for (const [colour, width] of /** @type {Array<[string, number]>} */ ([[token("--sheet"), 4], ["#8a4f7d", 2]])) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.setLineDash([7, 4]);
    context.stroke();
  }
  context.setLineDash([]);
  if (!closed && corners.length === 1) { const [x, y] = on.toCanvas(corners[0]); context.fillStyle = "#8a4f7d"; context.fillRect(x - 4, y - 4, 8, 8); }
}
