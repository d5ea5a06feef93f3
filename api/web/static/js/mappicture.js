// A plan or aerial picture beneath the ground plan: placed by a world file, or by two points and the distance between them.
import { byId, complain, fill, h, message } from "./dom.js";
import { loadImage } from "./frameview.js";

const LARGEST_BYTES = 60_000_000;

/** A picture of the ground. Its affine map takes picture px to world m: x = a u + b v + c, y = d u + e v + f. */
export class MapPicture {
  /** @param {import("./plan.js").Plan} plan */
  constructor(plan) {
    this.plan = plan;
    /** @type {HTMLImageElement|null} */
    this.image = null;
    this.affine = [1, 0, 0, 0, -1, 0];
    /** @type {number[][]|null} picture px that were clicked, while a distance is asked for */
    this.clicked = null;
    byId("map-file").addEventListener("change", () => this.#open(byId("map-file").files[0]));
    byId("world-file").addEventListener("change", () => this.#world(byId("world-file").files[0]));
  }

  /** @param {File|undefined} file */
  async #open(file) {
    if (!file) return;
    if (file.size > LARGEST_BYTES) {
      complain({ message: `the picture has ${Math.round(file.size / 1e6)} MB, more than a browser can show at once`, hint: "Cut out the intersection, or save it smaller; a world file of the cut-out keeps coordinates right." });
      return;
    }
    try { this.image = await loadImage(URL.createObjectURL(file)); } catch { complain({ message: `${file.name} is no picture that this browser shows`, hint: "Save it as PNG or JPEG." }); return; }
    const scale = 100 / this.image.naturalWidth;
    this.affine = [scale, 0, -50, 0, -scale, (scale * this.image.naturalHeight) / 2];
    this.plan.fit([[-50, -30], [50, 30]]);
    this.#ask();
  }

  /** ESRI world file: A, D, B, E, C, F, of the centre of the top-left pixel. @param {File|undefined} file */
  async #world(file) {
    if (!file) return;
    const values = (await file.text()).trim().split(/\s+/).map(Number);
    if (values.length < 6 || values.some((value) => !Number.isFinite(value))) { complain({ message: `${file.name} is no world file`, hint: "It has six lines, a number on each." }); return; }
    const [a, d, b, e, c, f] = values;
    this.affine = [a, b, c - (a + b) / 2, d, e, f - (d + e) / 2];
    this.clicked = null;
    fill(byId("map-help"), h("p", null, "Placed by its world file. The world's coordinates are those of the map."));
    if (this.image) this.plan.fit([this.toWorld([0, 0]), this.toWorld([this.image.naturalWidth, this.image.naturalHeight])]);
  }

  #ask() {
    const start = h("button.small", { type: "button", onclick: () => { this.clicked = []; fill(byId("map-help"), message("plain", "click two places in the picture whose distance you know", "The first becomes the world's origin, X points to the second.")); } }, "Place it by two points");
    fill(byId("map-help"), h("div.row", null, start, h("span.note", null, "or choose its world file above. Until then its scale is a guess.")));
  }

  /** @param {number[]} pixel of the picture @returns {number[]} */
  toWorld([u, v]) {
    const [a, b, c, d, e, f] = this.affine;
    return [a * u + b * v + c, d * u + e * v + f];
  }

  /** @param {number[]} world @returns {number[]} pixel of the picture */
  toPicture([x, y]) {
    const [a, b, c, d, e, f] = this.affine, det = a * e - b * d;
    return [(e * (x - c) - b * (y - f)) / det, (a * (y - f) - d * (x - c)) / det];
  }

  /** Whether the picture takes this click, to be placed by. @param {number[]} world */
  click(world) {
    if (!this.clicked) return false;
    this.clicked.push(this.toPicture(world));
    if (this.clicked.length === 2) {
      const input = h("input.number", { type: "number", min: "0.1", step: "any", "aria-label": "Distance in m" });
      fill(byId("map-help"), h("form.row", { onsubmit: (/** @type {Event} */ event) => { event.preventDefault(); this.#placeBy(Number(/** @type {HTMLInputElement} */ (input).value)); } }, h("label", null, "Distance between them, m ", input), h("button.small.primary", null, "Place it")));
      input.focus();
    }
    this.plan.redraw();
    return true;
  }

  /** @param {number} distance */
  #placeBy(distance) {
    if (!this.clicked || !(distance > 0)) return;
    const [[u0, v0], [u1, v1]] = this.clicked, du = u1 - u0, dv = v1 - v0, length2 = du * du + dv * dv, k = distance / length2;
    // picture v points down: a rotation and a mirroring that take the first point to 0 and the second onto X
    const a = k * du, b = k * dv, d = k * dv, e = -k * du;
    this.affine = [a, b, -(a * u0 + b * v0), d, e, -(d * u0 + e * v0)];
    this.clicked = null;
    fill(byId("map-help"), h("p", null, `Placed: ${Math.sqrt(length2).toFixed(0)} px are ${distance} m. Choose a point in the table, then click where it is in the picture.`));
    if (this.image) this.plan.fit([[0, 0], [this.image.naturalWidth, 0], [0, this.image.naturalHeight], [this.image.naturalWidth, this.image.naturalHeight]].map((corner) => this.toWorld(corner)));
  }

  /** @param {CanvasRenderingContext2D} context */
  draw(context) {
    if (!this.image) return;
    const [a, b, c, d, e, f] = this.affine, s = this.plan.pxPerM, [x, y] = this.plan.toCanvas([c, f]);
    context.save();
    context.setTransform(a * s, -d * s, b * s, -e * s, x, y);
    context.drawImage(this.image, 0, 0);
    context.restore();
    for (const pixel of this.clicked ?? []) {
      const [u, v] = this.plan.toCanvas(this.toWorld(pixel));
      context.strokeStyle = "#d50000";
      context.lineWidth = 3;
      context.beginPath(); context.arc(u, v, 7, 0, 2 * Math.PI); context.stroke();
    }
  }
}
