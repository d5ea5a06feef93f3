// The ground seen from above: a canvas that can be moved and enlarged by mouse and keys. World X is to the right, Y is up.
import { CanvasView, token } from "./canvasview.js";

export { token };

/** A plan on a canvas. Coordinates are the world's, m. */
export class Plan extends CanvasView {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {(plan: Plan, context: CanvasRenderingContext2D) => void} draw what stands on the ground; it is called whenever something changes
   */
  constructor(canvas, draw) {
    super(canvas);
    this.content = draw;
    this.centre = [0, 0];
    this.pxPerM = 8;
    /** Beneath everything. @type {import("./maplayer.js").MapLayer|null} */
    this.map = null;
    new ResizeObserver(() => this.redraw()).observe(canvas);
    document.addEventListener("wibam-theme", () => this.redraw());
    matchMedia("print").addEventListener("change", () => this.drawNow()); // paper has the light colours, and waits for no frame
  }

  /** @param {number[]} point @returns {number[]} */
  toCanvas(point) {
    return [this.canvas.width / 2 + (point[0] - this.centre[0]) * this.pxPerM, this.canvas.height / 2 - (point[1] - this.centre[1]) * this.pxPerM];
  }

  /** @param {number[]} pixel @returns {number[]} */
  fromCanvas(pixel) {
    return [this.centre[0] + (pixel[0] - this.canvas.width / 2) / this.pxPerM, this.centre[1] - (pixel[1] - this.canvas.height / 2) / this.pxPerM];
  }

  /** Show all of these points. @param {number[][]} points @param {number} [margin] */
  fit(points, margin = 0.08) {
    const known = points.filter((point) => Number.isFinite(point[0]) && Number.isFinite(point[1]));
    if (!known.length) return;
    const x = known.map((point) => point[0]), y = known.map((point) => point[1]);
    const x0 = Math.min(...x), x1 = Math.max(...x), y0 = Math.min(...y), y1 = Math.max(...y);
    this.centre = [(x0 + x1) / 2, (y0 + y1) / 2];
    this.pxPerM = Math.min(200, (1 - 2 * margin) * Math.min(this.canvas.width / Math.max(x1 - x0, 1), this.canvas.height / Math.max(y1 - y0, 1)));
    this.redraw();
  }

  /** @param {CanvasRenderingContext2D} context */
  paint(context) {
    context.fillStyle = token("--sheet");
    context.fillRect(0, 0, this.canvas.width, this.canvas.height);
    this.map?.draw(this, context);
    this.#grid(context);
    this.content(this, context);
    this.#scale(context);
  }

  /** @param {CanvasRenderingContext2D} context */
  #grid(context) {
    const step = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].find((value) => value * this.pxPerM >= 34) ?? 2000;
    const [left, top] = this.fromCanvas([0, 0]), [right, bottom] = this.fromCanvas([this.canvas.width, this.canvas.height]);
    context.strokeStyle = token("--line");
    context.lineWidth = 1;
    context.beginPath();
    for (let x = Math.ceil(left / step) * step; x <= right; x += step) {
      const [u] = this.toCanvas([x, 0]);
      context.moveTo(Math.round(u) + 0.5, 0);
      context.lineTo(Math.round(u) + 0.5, this.canvas.height);
    }
    for (let y = Math.ceil(bottom / step) * step; y <= top; y += step) {
      const [, v] = this.toCanvas([0, y]);
      context.moveTo(0, Math.round(v) + 0.5);
      context.lineTo(this.canvas.width, Math.round(v) + 0.5);
    }
    context.globalAlpha = this.map ? 0.45 : 1; // a picture is to be seen through it
    context.stroke();
    context.globalAlpha = 1;
    this.step = step;
  }

  /** A bar as long as one step of the grid. @param {CanvasRenderingContext2D} context */
  #scale(context) {
    const step = this.step ?? 10, length = step * this.pxPerM, y = this.canvas.height - 14;
    context.beginPath();
    context.moveTo(14, y - 4); context.lineTo(14, y); context.lineTo(14 + length, y); context.lineTo(14 + length, y - 4);
    for (const [colour, width] of /** @type {Array<[string, number]>} */ ([[token("--sheet"), 5], [token("--ink"), 2]])) {
      context.strokeStyle = colour;
      context.lineWidth = width * this.unit;
      context.stroke();
    }
    this.write(context, `${step} m`, [20, y - 6], { align: "left" });
  }

  /** @param {number[]} pixel @param {number} factor */
  zoom(pixel, factor) {
    const before = this.fromCanvas(pixel);
    this.pxPerM = Math.min(400, Math.max(0.2, this.pxPerM * factor));
    const after = this.fromCanvas(pixel);
    this.centre = [this.centre[0] + before[0] - after[0], this.centre[1] + before[1] - after[1]];
    this.redraw();
  }

  /** @param {number} right @param {number} down */
  pan(right, down) {
    this.centre = [this.centre[0] - right / this.pxPerM, this.centre[1] + down / this.pxPerM];
    this.redraw();
  }

  keys() {
    return { ...super.keys(), ArrowLeft: () => this.pan(60, 0), ArrowRight: () => this.pan(-60, 0), ArrowUp: () => this.pan(0, 60), ArrowDown: () => this.pan(0, -60) };
  }
}

const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5195", "#8a6d3b"];

/** Colour of the n-th camera of a site. @param {number} index */
export function cameraColour(index) {
  return COLOURS[index % COLOURS.length];
}

/**
 * What a camera sees of the ground, up to a distance from it.
 * @param {import("./projection.js").Camera} camera
 * @param {number} [rangeM]
 * @returns {number[][]} a polygon; empty where it sees none
 */
export function groundInView(camera, rangeM = 60) {
  const near = [], far = [], columns = 24;
  const within = (/** @type {number[]} */ pixel) => {
    const ground = camera.ground(pixel);
    return ground && Math.hypot(ground[0] - camera.centre[0], ground[1] - camera.centre[1]) <= rangeM ? ground : null;
  };
  for (let i = 0; i <= columns; i += 1) {
    const u = -0.5 + (camera.width * i) / columns, bottom = camera.height - 0.5, last = within([u, bottom]);
    if (!last) continue;
    let seen = bottom, unseen = -0.5, found = last;
    const top = within([u, unseen]);
    if (top) found = top;
    else {
      for (let step = 0; step < 22; step += 1) {
        const middle = (seen + unseen) / 2, ground = within([u, middle]);
        if (ground) { seen = middle; found = ground; } else unseen = middle;
      }
    }
    near.push([last[0], last[1]]);
    far.push([found[0], found[1]]);
  }
  return near.length > 1 ? [...near, ...far.reverse()] : [];
}

/** Draw a camera's view, with its name and where it looks. @param {Plan} plan @param {CanvasRenderingContext2D} context @param {import("./projection.js").Camera} camera @param {string} colour @param {number} [rangeM] */
export function drawView(plan, context, camera, colour, rangeM) {
  const view = groundInView(camera, rangeM);
  if (view.length) {
    plan.trace(context, view, true);
    context.globalAlpha = 0.1;
    context.fillStyle = colour;
    context.fill();
    context.globalAlpha = 0.9;
    context.strokeStyle = colour;
    context.lineWidth = 1.4;
    context.stroke();
    context.globalAlpha = 1;
  }
  drawCamera(plan, context, camera, colour);
}

/** A wedge where a camera stands, and its name. @param {Plan} plan @param {CanvasRenderingContext2D} context @param {import("./projection.js").Camera} camera @param {string} colour */
export function drawCamera(plan, context, camera, colour) {
  const [x, y] = plan.toCanvas(camera.centre), forward = [camera.rotation[0][2], camera.rotation[1][2]];
  const angle = Math.atan2(-forward[1], forward[0]);
  context.save();
  context.translate(x, y);
  context.rotate(angle);
  context.fillStyle = colour;
  context.beginPath();
  context.moveTo(-5, 0); context.lineTo(11, -7); context.lineTo(11, 7);
  context.closePath();
  context.fill();
  context.restore();
  plan.write(context, camera.id, [x, y + (forward[1] > 0 ? 10 + 12 * plan.unit : -12)], { size: 13 });
}
