// A site's picture from above, beneath a plan.
import { h } from "./dom.js";

/** A picture and its place: pixel (u, v), whose (0, 0) is the centre of the top-left one, is x = a u + b v + c, y = d u + e v + f in m. */
export class MapLayer {
  /** @param {ImageBitmap|HTMLImageElement} image @param {number[][]} placing rows a, b, c and d, e, f */
  constructor(image, placing) {
    this.image = image;
    this.placing = placing;
  }

  /** @param {number[]} pixel @returns {number[]} */
  toWorld([u, v]) {
    const [[a, b, c], [d, e, f]] = this.placing;
    return [a * u + b * v + c, d * u + e * v + f];
  }

  /** @param {number[]} world @returns {number[]} pixel of the picture */
  toPicture([x, y]) {
    const [[a, b, c], [d, e, f]] = this.placing, det = a * e - b * d;
    return [(e * (x - c) - b * (y - f)) / det, (a * (y - f) - d * (x - c)) / det];
  }

  /** @returns {number[][]} in the world */
  corners() {
    const { width, height } = this.image;
    return [[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]].map((pixel) => this.toWorld(pixel));
  }

  /** @param {import("./plan.js").Plan} plan @param {CanvasRenderingContext2D} context */
  draw(plan, context) {
    const [[a, b], [d, e]] = this.placing, s = plan.pxPerM, [x, y] = plan.toCanvas(this.toWorld([-0.5, -0.5]));
    context.save();
    context.setTransform(a * s, -d * s, b * s, -e * s, x, y);
    context.drawImage(this.image, 0, 0);
    context.restore();
  }
}

/**
 * Lay a map beneath a plan once it is loaded; the plan is drawn without it until then.
 * @param {import("./plan.js").Plan} plan
 * @param {string} address of the picture
 * @param {{map: {placing: number[][]|null}, note: string}|null} said what the service says of it; its note, if any, is shown below
 */
export async function layMap(plan, address, said) {
  plan.canvas.parentElement?.querySelector(".map-note")?.remove();
  if (said?.note) plan.canvas.after(h("p.note.map-note", null, said.note));
  if (!said?.map.placing) return;
  plan.map = new MapLayer(await loadImage(address), said.map.placing);
  plan.redraw();
}

/** Load a picture. @param {string} url @returns {Promise<HTMLImageElement>} */
export function loadImage(url) {
  return new Promise((resolve, reject) => {
    const image = new Image();
    image.addEventListener("load", () => resolve(image));
    image.addEventListener("error", () => reject(new Error("the picture could not be loaded")));
    image.src = url;
  });
}
