// Points of a calibration: a table, the marks in the frame, the solve at every change, and what comes out of it.
import { Problem, send } from "./api.js";
import { byId, fill, h, message, sentence } from "./dom.js";
import { number } from "./format.js";
import { Camera } from "./projection.js";

/**
 * @typedef {Object} Point
 * @property {number|null} u
 * @property {number|null} v
 * @property {number|null} x
 * @property {number|null} y
 * @property {number} z
 * @property {any} [residual]
 */

const SOLVE_AFTER_MS = 180;
const INTRINSICS = ["fx", "fy", "cx", "cy"];
/** What a site's document can say, and the service refuses otherwise. */
const MOST_DISTORTION = 14, LARGEST_XI = 10, LARGEST = 1e10;

/** Why no site can have what was typed: the sentence and what to do, or null. @param {any} calibration as a site's document has it @returns {[string, string]|null} */
function refusal(calibration) {
  if (!calibration) return ["ready matrices are given in the site's JSON", "Open the site and choose “Edit as JSON”, or another kind here."];
  const { K = [], dist = [], xi = 0, correspondences = [] } = calibration;
  const points = correspondences.flatMap((/** @type {any} */ pair) => [...pair.pixel, ...pair.world]);
  if (dist.some(Number.isNaN)) return ["the distortion has something that is no number", "Use a point for decimals, and commas or blanks between."];
  if (dist.length > MOST_DISTORTION) return [`the distortion has ${dist.length} numbers`, `OpenCV's order has ${MOST_DISTORTION} at most.`];
  if (!(xi >= 0 && xi <= LARGEST_XI)) return [`xi is ${xi}`, `It lies between 0 and ${LARGEST_XI}.`];
  const tooLarge = [...K.flat(), ...dist, ...points].find((value) => !(Math.abs(value) <= LARGEST));
  return tooLarge === undefined ? null : [`${tooLarge} is too large for a calibration`, "Pixels and metres are meant; correct the number."];
}

/** The calibration of one camera while it is edited. */
export class CalibrationPanel {
  /** @param {any} description the camera in the site's document @param {() => void} changed */
  constructor(description, changed) {
    this.changed = changed;
    this.size = [description.width_px, description.height_px];
    this.id = description.id;
    /** @type {Array<{node: HTMLElement, update: (point: Point, selected: boolean) => void}>} */
    this.rows = [];
    /** @type {Camera|null} */
    this.camera = null;
    this.timer = 0;
    this.number = 0;
    this.read(description.calibration);
    byId("kind").addEventListener("change", () => { this.kind = byId("kind").value; this.showIntrinsics(); this.edited(); });
    byId("paste").addEventListener("click", () => this.paste());
    this.solve();
  }

  /** Go on with another calibration. @param {any} calibration */
  take(calibration) {
    this.read(calibration);
    this.edited();
  }

  /** Show a calibration. @param {any} given */
  read(given) {
    this.kind = given.kind;
    /** What this page does not edit stays as it was given, as long as the kind does. */
    const { kind, K: K_, dist: dist_, lens: lens_, xi: xi_, rvec, tvec, correspondences, ...rest } = given;
    this.rest = { kind, rest };
    this.matrices = given.kind === "matrices" ? given : null;
    const K = given.K ?? [[this.size[0] * 0.7, 0, (this.size[0] - 1) / 2], [0, this.size[0] * 0.7, (this.size[1] - 1) / 2], [0, 0, 1]];
    this.lens = { fx: K[0][0], fy: K[1][1], skew: K[0][1], cx: K[0][2], cy: K[1][2], dist: given.dist ?? [], lens: given.lens ?? "pinhole", xi: given.xi ?? 0 };
    /** @type {Point[]} */
    this.points = (given.correspondences ?? []).map((/** @type {any} */ pair) => ({ u: pair.pixel[0], v: pair.pixel[1], x: pair.world[0], y: pair.world[1], z: pair.world[2] }));
    this.selected = -1;
    byId("kind").value = this.kind;
    this.showIntrinsics();
    this.showPoints();
  }

  /** The calibration as the site's document has it; points without all coordinates are left out. */
  document() {
    if (this.kind === "matrices") return this.matrices;
    const correspondences = this.complete().map((point) => ({ pixel: [point.u, point.v], world: [point.x, point.y, point.z] }));
    const kept = this.rest.kind === this.kind ? this.rest.rest : {};
    if (this.kind === "homography" || this.kind === "points") return { ...kept, kind: this.kind, correspondences };
    const { fx, fy, skew, cx, cy, dist, lens, xi } = this.lens;
    return { ...kept, kind: "pnp", K: [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], dist, lens, xi: lens === "omnidirectional" ? xi : 0, correspondences };
  }

  /** Throws a `Problem` where no site can have what was typed: nobody need ask the service for that. */
  check() {
    const refused = refusal(this.document());
    if (refused) throw new Problem(refused[0], { hint: refused[1] });
  }

  /** Fewest points that tell what is unknown. */
  least() { return this.kind === "points" ? 6 : 4; }

  complete() {
    return this.points.filter((point) => [point.u, point.v, point.x, point.y, point.z].every((value) => value !== null && Number.isFinite(value)));
  }

  /** A click in the frame: the first point without a pixel gets it, else a new one. @param {number[]} pixel */
  click(pixel) {
    const [u, v] = pixel.map((value) => Math.round(value * 100) / 100);
    const chosen = this.points[this.selected];
    const waiting = chosen && chosen.u === null ? this.selected : this.points.findIndex((point) => point.u === null);
    if (waiting >= 0) { Object.assign(this.points[waiting], { u, v }); this.selected = waiting; }
    else { this.points.push({ u, v, x: null, y: null, z: 0 }); this.selected = this.points.length - 1; }
    this.edited();
    /** @type {HTMLElement|null} */ (this.rows[this.selected]?.node.querySelector("input[data-field=x]"))?.focus();
  }

  /** A click on the plan gives the chosen point its place. @param {number[]} world */
  place(world) {
    const point = this.points[this.selected];
    if (!point) return false;
    point.x = Math.round(world[0] * 1000) / 1000;
    point.y = Math.round(world[1] * 1000) / 1000;
    this.edited();
    return true;
  }

  /** The point at a pixel. @param {number[]} pixel @param {number} within px */
  at(pixel, within) {
    return this.points.findIndex((point) => point.u !== null && point.v !== null && Math.hypot(point.u - pixel[0], point.v - pixel[1]) <= within);
  }

  /** @param {number} du @param {number} dv */
  nudge(du, dv) {
    const point = this.points[this.selected];
    if (!point || point.u === null || point.v === null) return;
    point.u += du;
    point.v += dv;
    this.edited();
  }

  edited() {
    this.showPoints();
    this.changed();
    clearTimeout(this.timer);
    this.timer = window.setTimeout(() => this.solve(), SOLVE_AFTER_MS);
  }

  async solve() {
    const place = byId("solution"), mine = ++this.number;
    if (this.kind !== "matrices" && this.complete().length < this.least()) {
      this.camera = null;
      fill(place, h("p.note", null, `${this.complete().length} of at least ${this.least()} points; ${this.least() + 2} and more show which one is wrong.`));
      this.changed();
      return;
    }
    try {
      this.check();
      const answer = await send("POST", "/v1/calibration/solve", { id: this.id, width_px: this.size[0], height_px: this.size[1], calibration: this.document() });
      if (mine !== this.number) return; // a later change has its own answer
      if (answer.problem) throw new Problem(answer.problem.message, answer.problem);
      this.camera = new Camera(answer.camera);
      this.complete().forEach((point, index) => { point.residual = answer.residuals.residuals[index]; });
      fill(place, this.facts(answer.residuals), answer.cautions.map((/** @type {any} */ caution) => message("caution", caution.message, caution.hint)));
    } catch (error) {
      if (mine !== this.number) return;
      this.camera = null;
      for (const point of this.points) delete point.residual;
      fill(place, error instanceof Problem ? message("bad", error.message, error.hint) : message("bad", String(error)));
    }
    this.showPoints();
    this.changed();
  }

  /** @param {any} residuals */
  facts(residuals) {
    const facts = [["Height", `${number(residuals.position_m[2])} m`], ["Position", `${number(residuals.position_m[0])}, ${number(residuals.position_m[1])} m`], ["Focal length", `${number(residuals.focal_px[0], 0)}${residuals.focal_sd_px ? ` ± ${number(residuals.focal_sd_px, 0)}` : ""} px`],
      ["Median error", residuals.median_px === null ? "–" : `${number(residuals.median_px, 1)} px`], ["Left out", residuals.rejected], ["Ground within 50 m", residuals.ground_sd_m === null ? "–" : `± ${number(residuals.ground_sd_m)} m`]];
    if (residuals.k1 !== null) facts.push(["Distortion k1", `${number(residuals.k1, 3)}${residuals.k1_sd ? ` ± ${number(residuals.k1_sd, 3)}` : ""}`]);
    return h("dl.facts", null, facts.map(([title, value]) => h("div", null, h("dt", null, title), h("dd", null, value))));
  }

  showIntrinsics() {
    const place = byId("intrinsics");
    byId("points").parentElement.hidden = this.kind === "matrices";
    if (this.kind === "matrices") {
      if (!this.matrices) { fill(place, message("plain", "ready matrices are given in the site's JSON", "Open the site and choose “Edit as JSON”.")); return; }
      fill(place, h("p.note", null, "K, dist, rvec and tvec as they were given; they are changed in the site's JSON."));
      return;
    }
    if (this.kind === "points") { fill(place, h("p.note", null, "Six points or more, near and far, some of them raised (Z above the road): the focal length and how the lens bends follow from them.")); return; }
    if (this.kind === "homography") { fill(place, h("p.note", null, "All points lie on the road (Z = 0). The focal length follows from them; the lens must not bend lines.")); return; }
    const field = (/** @type {string} */ name) => {
      const input = h("input.number", { type: "number", step: "any", value: /** @type {any} */ (this.lens)[name] });
      input.addEventListener("change", () => { /** @type {any} */ (this.lens)[name] = Number(/** @type {HTMLInputElement} */ (input).value); this.edited(); });
      return h("label", null, name, " ", input);
    };
    const dist = h("input", { value: this.lens.dist.join(", "), size: 28 });
    dist.addEventListener("change", () => { this.lens.dist = /** @type {HTMLInputElement} */ (dist).value.split(/[\s,;]+/).filter(Boolean).map(Number); this.edited(); });
    const lens = h("select", null, ["pinhole", "fisheye", "omnidirectional"].map((name) => h("option", { selected: name === this.lens.lens }, name)));
    lens.addEventListener("change", () => { this.lens.lens = /** @type {HTMLSelectElement} */ (lens).value; this.showIntrinsics(); this.edited(); });
    fill(place, h("div.row", null, h("label", null, "Lens ", lens), this.lens.lens === "omnidirectional" ? field("xi") : null), h("div.row", null, INTRINSICS.map(field)), h("label", null, "Distortion, in OpenCV's order ", dist));
  }

  /** Bring the table up to date. Rows that are there stay, so that whoever types in one goes on typing in it. */
  showPoints() {
    const body = byId("points").tBodies[0];
    if (this.rows.length !== this.points.length) {
      this.rows = this.points.map((_, index) => this.row(index));
      fill(body, this.rows.length ? this.rows.map((row) => row.node) : h("tr", null, h("td", { colspan: 8 }, "Click a place in the frame whose coordinates you know.")));
    }
    this.rows.forEach((row, index) => row.update(this.points[index], index === this.selected));
  }

  /** @param {number} index */
  row(index) {
    const fields = /** @type {const} */ (["u", "v", "x", "y", "z"]);
    const inputs = fields.map((name) => {
      const made = /** @type {HTMLInputElement} */ (h("input", { type: "number", step: "any", "aria-label": `${name} of point ${index + 1}`, "data-field": name }));
      made.addEventListener("input", () => {
        /** @type {any} */ (this.points[index])[name] = made.value === "" ? (name === "z" ? 0 : null) : Number(made.value);
        this.selected = index;
        this.edited();
      });
      made.addEventListener("focus", () => { this.selected = index; this.mark(); });
      return made;
    });
    const off = h("td.number", null), remove = () => { this.points.splice(index, 1); this.selected = -1; this.edited(); };
    const node = h("tr", null, h("th", { scope: "row" }, index + 1), inputs.map((input) => h("td", null, input)), off,
      h("td", null, h("button.small.quiet", { type: "button", "aria-label": `Remove point ${index + 1}`, onclick: remove }, "×")));
    const update = (/** @type {Point} */ point, /** @type {boolean} */ selected) => {
      const residual = point.residual, outlier = !!residual && !residual.used;
      node.classList.toggle("selected", selected);
      node.classList.toggle("outlier", outlier);
      inputs.forEach((input, at) => { if (input !== document.activeElement) input.value = String(point[fields[at]] ?? ""); });
      fill(off, residual && residual.error_px !== null ? `${number(residual.error_px, 1)} px` : "", outlier ? h("div.note", null, "contradicts the others") : residual && residual.error_m !== null ? h("div.note", null, `${number(residual.error_m)} m`) : "");
    };
    return { node, update };
  }

  /** Show which point is chosen. */
  mark() {
    this.showPoints();
    this.changed();
  }

  paste() {
    const lines = byId("csv").value.split("\n").map((/** @type {string} */ line) => line.trim()).filter(Boolean);
    /** @type {Point[]} */
    const found = [];
    for (const [index, line] of lines.entries()) {
      const values = line.split(/[;\t,]\s*|\s+/).filter(Boolean).map(Number);
      if (values.some(Number.isNaN)) { if (index === 0) continue; fill(byId("solution"), message("bad", `line ${index + 1} has something that is no number: ${line}`, "Use a point for decimals, and commas, semicolons or tabs between.")); return; }
      if (values.length === 5 || values.length === 4) found.push({ u: values[0], v: values[1], x: values[2], y: values[3], z: values[4] ?? 0 });
      else if (values.length === 3 || values.length === 2) found.push({ u: null, v: null, x: values[0], y: values[1], z: values[2] ?? 0 });
      else { fill(byId("solution"), message("bad", `line ${index + 1} has ${values.length} numbers: ${sentence(line)}`, "A line is u, v, X, Y, Z or X, Y, Z.")); return; }
    }
    this.points.push(...found);
    byId("csv").value = "";
    this.edited();
  }
}
