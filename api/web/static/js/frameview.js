// A frame of a camera on a canvas, with drawings over it: enlarged by the wheel or keys, moved by dragging.
import { CanvasView } from "./canvasview.js";

const WIDTH_PX = 1280, LARGEST = 60;

/** A frame and what is drawn over it. Coordinates are pixels of the recording; (0, 0) is the centre of the first one. */
export class FrameView extends CanvasView {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {number} width of the recording, px
   * @param {number} height
   * @param {(view: FrameView, context: CanvasRenderingContext2D) => void} draw what lies over the frame
   */
  constructor(canvas, width, height, draw) {
    super(canvas);
    this.content = draw;
    this.image = /** @type {CanvasImageSource|null} */ (null);
    /** Where Enter clicks, as shares of the canvas. */
    this.aimed = [0.5, 0.5];
    this.resize(width, height);
  }

  /** The recording's size. @param {number} width @param {number} height */
  resize(width, height) {
    this.width = width;
    this.height = height;
    this.canvas.width = WIDTH_PX;
    this.canvas.height = Math.round((WIDTH_PX * height) / width);
    this.scale = this.canvas.width / width;
    this.origin = [0, 0];
    this.redraw();
  }

  /** @param {CanvasImageSource|null} image */
  show(image) {
    this.image = image;
    this.redraw();
  }

  /** @param {number[]} pixel @returns {number[]} */
  toCanvas(pixel) {
    return [(pixel[0] + 0.5 - this.origin[0]) * this.scale, (pixel[1] + 0.5 - this.origin[1]) * this.scale];
  }

  /** @param {number[]} at @returns {number[]} */
  fromCanvas(at) {
    return [at[0] / this.scale + this.origin[0] - 0.5, at[1] / this.scale + this.origin[1] - 0.5];
  }

  cursor() {
    return [this.aimed[0] * this.canvas.width, this.aimed[1] * this.canvas.height];
  }

  /**
   * A whole frame cannot be moved under the cross, as a plan can: the cross moves, and the picture where it meets the border.
   * Where there is no cross, since clicks do nothing, the picture moves.
   */
  keys() {
    const step = (/** @type {any} */ event) => (event.shiftKey ? 0.05 : 0.005);
    const aim = (/** @type {number} */ right, /** @type {number} */ down) => {
      const wanted = [this.aimed[0] + right, this.aimed[1] + down];
      if (this.onclick) this.aimed = wanted.map((share) => Math.min(1, Math.max(0, share)));
      this.pan((this.aimed[0] - wanted[0]) * this.canvas.width, (this.aimed[1] - wanted[1]) * this.canvas.height);
    };
    return {
      ...super.keys(), ArrowLeft: (/** @type {any} */ event) => aim(-step(event), 0), ArrowRight: (/** @type {any} */ event) => aim(step(event), 0),
      ArrowUp: (/** @type {any} */ event) => aim(0, -step(event)), ArrowDown: (/** @type {any} */ event) => aim(0, step(event)),
    };
  }

  /** @param {CanvasRenderingContext2D} context */
  paint(context) {
    context.fillStyle = "#1a1f25";
    context.fillRect(0, 0, this.canvas.width, this.canvas.height);
    if (this.image) {
      context.imageSmoothingEnabled = this.scale < 4;
      context.drawImage(this.image, -this.origin[0] * this.scale, -this.origin[1] * this.scale, this.width * this.scale, this.height * this.scale);
    }
    this.content(this, context);
  }

  /** @param {number[]} at @param {number} factor */
  zoom(at, factor) {
    const least = this.canvas.width / this.width, before = this.fromCanvas(at);
    this.scale = Math.min(LARGEST, Math.max(least, this.scale * factor));
    const after = this.fromCanvas(at);
    this.#move(before[0] - after[0], before[1] - after[1]);
  }

  /** @param {number} right @param {number} down */
  pan(right, down) {
    this.#move(-right / this.scale, -down / this.scale);
  }

  /** Show a part of the picture as large as it fits, or all of it. @param {number[]|null} part x0, y0, x1, y1 in px of the recording */
  lookAt(part) {
    const least = this.canvas.width / this.width, [x0, y0, x1, y1] = part ?? [0, 0, this.width, this.height];
    this.scale = part ? Math.min(LARGEST, Math.max(least, Math.min(this.canvas.width / Math.max(x1 - x0, 1), this.canvas.height / Math.max(y1 - y0, 1)))) : least;
    this.origin = [(x0 + x1 - this.canvas.width / this.scale) / 2, (y0 + y1 - this.canvas.height / this.scale) / 2];
    this.#move(0, 0);
  }

  /** @param {number} u px of the recording @param {number} v */
  #move(u, v) {
    const shown = [this.canvas.width / this.scale, this.canvas.height / this.scale];
    this.origin = [Math.min(Math.max(this.origin[0] + u, 0), Math.max(this.width - shown[0], 0)), Math.min(Math.max(this.origin[1] + v, 0), Math.max(this.height - shown[1], 0))];
    this.redraw();
  }
}
