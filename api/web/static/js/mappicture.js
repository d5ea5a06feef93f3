// The site's map on the page of a camera: sent to the service, and placed by its world file or by two points and their distance.
import { request, send } from "./api.js";
import { attempt, byId, fill, h, message, say } from "./dom.js";
import { percent } from "./format.js";
import { loadImage, MapLayer } from "./maplayer.js";
import { Upload } from "./tus.js";

/** How wide an unplaced picture is shown, m. */
const GUESS_M = 100;

/** The controls beneath the plan. */
export class MapPicture {
  /** @param {import("./plan.js").Plan} plan @param {string} siteId */
  constructor(plan, siteId) {
    this.plan = plan;
    this.path = `/v1/sites/${siteId}/map`;
    this.siteId = siteId;
    /** @type {number[][]|null} picture px that were clicked, while a distance is asked for */
    this.clicked = null;
    byId("map-file").addEventListener("change", () => attempt(() => this.#take(byId("map-file"))));
    byId("world-file").addEventListener("change", () => attempt(() => this.#world(byId("world-file"))));
    byId("map-remove").addEventListener("click", () => attempt(() => this.#remove()));
  }

  /** @param {any} said `map` of the site, or null @param {boolean} [look] turn the plan to it */
  async show(said, look = false) {
    byId("map-remove").hidden = byId("map-place").hidden = !said;
    this.clicked = null;
    if (!said) { this.plan.map = null; this.plan.redraw(); return; }
    const image = await loadImage(`${this.path}?version=${said.version}`), scale = GUESS_M / image.width;
    this.plan.map = new MapLayer(image, said.map.placing ?? [[scale, 0, -GUESS_M / 2], [0, -scale, (scale * image.height) / 2]]);
    if (look) this.plan.fit(this.plan.map.corners());
    this.plan.redraw();
    const start = h("button.small", { type: "button", onclick: () => { this.clicked = []; fill(byId("map-help"), message("plain", "click two places in the picture whose distance you know", "The first becomes the world's origin, X points to the second.")); } }, "Place it by two points");
    fill(byId("map-help"), h("p", null, said.map.placing ? `${said.map.filename} is placed by ${{ points: "two points", "world file": "its world file", GeoTIFF: "what the file itself says" }[said.map.placed_by]}. Choose a point in the table, then click where it is in the picture.`
      : said.note || `${said.map.filename} has no place yet: its scale is a guess. Choose its world file, or:`), h("div.row", null, start));
  }

  /** @param {HTMLInputElement} input */
  async #take(input) {
    const file = input.files?.[0];
    if (!file) return;
    input.value = "";
    const upload = new Upload(file, { site: this.siteId, purpose: "map" }, (one) => { byId("map-help").textContent = `${file.name}: ${percent(one.offset / file.size)} sent`; });
    await upload.send();
    if (upload.error) { byId("map-help").textContent = ""; throw upload.error; }
    await this.#keep({ file: upload.url.split("/").pop() });
  }

  /** @param {HTMLInputElement} input */
  async #world(input) {
    const file = input.files?.[0];
    if (!file) return;
    input.value = "";
    await this.#keep({ world_file: (await file.text()).slice(0, 2000) });
  }

  /** @param {any} change */
  async #keep(change) {
    await this.show(await send("PUT", this.path, change), true);
    say("The map is kept with the site.");
  }

  async #remove() {
    await request("DELETE", this.path);
    await this.show(null);
    fill(byId("map-help"), "The map is gone.");
  }

  /** Whether the picture takes this click, to be placed by. @param {number[]} world */
  click(world) {
    if (!this.clicked || !this.plan.map || this.clicked.length === 2) return !!this.clicked;
    this.clicked.push(this.plan.map.toPicture(world));
    if (this.clicked.length === 2) {
      const input = /** @type {HTMLInputElement} */ (h("input.number", { type: "number", min: "0.1", step: "any", "aria-label": "Distance in m" }));
      fill(byId("map-help"), h("form.row", { onsubmit: (/** @type {Event} */ event) => { event.preventDefault(); attempt(() => this.#placeBy(Number(input.value))); } }, h("label", null, "Distance between them, m ", input), h("button.small.primary", null, "Place it")));
      input.focus();
    }
    this.plan.redraw();
    return true;
  }

  /** @param {number} distance */
  async #placeBy(distance) {
    if (!this.clicked || !(distance > 0)) return;
    const [first, second] = this.clicked;
    await this.#keep({ points: [{ pixel: first, world: [0, 0] }, { pixel: second, world: [distance, 0] }] });
  }

  /** What was clicked to place it by. @param {CanvasRenderingContext2D} context */
  draw(context) {
    for (const pixel of this.clicked ?? []) {
      const [u, v] = this.plan.toCanvas(/** @type {MapLayer} */ (this.plan.map).toWorld(pixel));
      context.strokeStyle = "#d50000";
      context.lineWidth = 3;
      context.beginPath(); context.arc(u, v, 7, 0, 2 * Math.PI); context.stroke();
    }
  }
}
