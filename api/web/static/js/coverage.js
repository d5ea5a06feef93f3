// How many cameras see each place of the ground.
import { groundInView } from "./plan.js";
import { inside } from "./trackdata.js";

const CELLS = 90;
/** Shades by number of cameras: the more, the darker; one camera alone is another colour. */
const SHADES = ["", "rgb(217 145 32 / .30)", "rgb(20 110 180 / .28)", "rgb(20 110 180 / .46)", "rgb(20 110 180 / .66)"];

/** Cells of the ground with the number of cameras that see them. */
export class Coverage {
  /** @param {import("./projection.js").Camera[]} cameras */
  constructor(cameras) {
    this.cameras = cameras;
    const views = cameras.map((camera) => groundInView(camera)).filter((view) => view.length);
    const points = views.flat(), x = points.map((point) => point[0]), y = points.map((point) => point[1]);
    this.low = points.length ? [Math.min(...x), Math.min(...y)] : [0, 0];
    this.cell = points.length ? Math.max(Math.max(...x) - this.low[0], Math.max(...y) - this.low[1]) / CELLS : 1;
    /** @type {number[][]} x, y of the lower left corner, count */
    this.cells = [];
    for (let i = 0; points.length && i <= CELLS; i += 1) {
      for (let j = 0; j <= CELLS; j += 1) {
        const at = [this.low[0] + i * this.cell, this.low[1] + j * this.cell], middle = [at[0] + this.cell / 2, at[1] + this.cell / 2];
        const count = views.filter((view) => inside(view, middle[0], middle[1])).length;
        if (count) this.cells.push([at[0], at[1], count]);
      }
    }
  }

  /** @param {import("./plan.js").Plan} plan @param {CanvasRenderingContext2D} context */
  draw(plan, context) {
    for (const [x, y, count] of this.cells) {
      const [left, top] = plan.toCanvas([x, y + this.cell]).map(Math.round), [right, bottom] = plan.toCanvas([x + this.cell, y]).map(Math.round);
      context.fillStyle = SHADES[Math.min(count, SHADES.length - 1)];
      context.fillRect(left, top, right - left, bottom - top);
    }
  }

  /** What the shades say. @returns {Array<{name: string, colour: string}>} */
  get key() {
    return SHADES.slice(1, this.cameras.length + 1).map((colour, index) => ({ name: index + 1 === SHADES.length - 1 ? `${index + 1} cameras or more` : index ? `${index + 1} cameras` : "one camera alone", colour }));
  }
}
