// A frame of a camera on a canvas, with drawings over it: enlarged by the wheel or keys, moved by dragging.

/** A frame and what is drawn over it. Coordinates are pixels of the recording; (0, 0) is the centre of the first one. */
export class FrameView {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {number} width of the recording, px
   * @param {number} height
   * @param {(view: FrameView, context: CanvasRenderingContext2D) => void} draw what lies over the frame
   */
  constructor(canvas, width, height, draw) {
    this.canvas = canvas;
    this.content = draw;
    this.image = /** @type {CanvasImageSource|null} */ (null);
    this.width = width;
    this.height = height;
    this.pending = false;
    /** @type {(pixel: number[], event: PointerEvent) => boolean} returns whether it takes the drag that begins here */
    this.ondown = () => false;
    /** @type {(pixel: number[], event: PointerEvent) => void} */
    this.ondrag = () => {};
    /** @type {(pixel: number[], event: PointerEvent) => void} */
    this.onup = () => {};
    /** @type {(pixel: number[], event: PointerEvent) => void} */
    this.onclick = () => {};
    this.#listen();
    this.resize(width, height);
  }

  /** The recording's size. @param {number} width @param {number} height */
  resize(width, height) {
    this.width = width;
    this.height = height;
    this.canvas.width = 1280;
    this.canvas.height = Math.round((1280 * height) / width);
    this.scale = this.canvas.width / width;
    this.origin = [0, 0];
    this.redraw();
  }

  /** @param {CanvasImageSource|null} image */
  show(image) {
    this.image = image;
    this.redraw();
  }

  /** Pixel of the recording to canvas px. @param {number[]} pixel @returns {number[]} */
  toCanvas(pixel) {
    return [(pixel[0] + 0.5 - this.origin[0]) * this.scale, (pixel[1] + 0.5 - this.origin[1]) * this.scale];
  }

  /** Canvas px to pixel of the recording. @param {number[]} point @returns {number[]} */
  toPixel(point) {
    return [point[0] / this.scale + this.origin[0] - 0.5, point[1] / this.scale + this.origin[1] - 0.5];
  }

  redraw() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => {
      this.pending = false;
      this.drawNow();
    });
  }

  drawNow() {
    const context = this.canvas.getContext("2d");
    if (!context) return;
    context.fillStyle = "#1a1f25";
    context.fillRect(0, 0, this.canvas.width, this.canvas.height);
    if (this.image) {
      context.imageSmoothingEnabled = this.scale < 4;
      context.drawImage(this.image, -this.origin[0] * this.scale, -this.origin[1] * this.scale, this.width * this.scale, this.height * this.scale);
    }
    this.content(this, context);
  }

  /** A way through pixels. @param {CanvasRenderingContext2D} context @param {number[][]} pixels @param {boolean} [closed] */
  trace(context, pixels, closed = false) {
    context.beginPath();
    pixels.forEach((pixel, index) => {
      const [x, y] = this.toCanvas(pixel);
      if (index) context.lineTo(x, y);
      else context.moveTo(x, y);
    });
    if (closed) context.closePath();
  }

  /** @param {number[]} at canvas px @param {number} factor */
  zoom(at, factor) {
    const least = this.canvas.width / this.width, before = this.toPixel(at);
    this.scale = Math.min(60, Math.max(least, this.scale * factor));
    const after = this.toPixel(at);
    this.#move(before[0] - after[0], before[1] - after[1]);
  }

  /** Show a part of the picture as large as it fits, or all of it. @param {number[]|null} part x0, y0, x1, y1 in px of the recording */
  lookAt(part) {
    const least = this.canvas.width / this.width, [x0, y0, x1, y1] = part ?? [0, 0, this.width, this.height];
    this.scale = part ? Math.min(60, Math.max(least, Math.min(this.canvas.width / Math.max(x1 - x0, 1), this.canvas.height / Math.max(y1 - y0, 1)))) : least;
    this.origin = [(x0 + x1 - this.canvas.width / this.scale) / 2, (y0 + y1 - this.canvas.height / this.scale) / 2];
    this.#move(0, 0);
  }

  /** @param {number} u @param {number} v */
  #move(u, v) {
    const shown = [this.canvas.width / this.scale, this.canvas.height / this.scale];
    this.origin = [Math.min(Math.max(this.origin[0] + u, 0), Math.max(this.width - shown[0], 0)), Math.min(Math.max(this.origin[1] + v, 0), Math.max(this.height - shown[1], 0))];
    this.redraw();
  }

  /** @param {MouseEvent} event @returns {number[]} */
  #at(event) {
    const box = this.canvas.getBoundingClientRect();
    return [((event.clientX - box.left) * this.canvas.width) / box.width, ((event.clientY - box.top) * this.canvas.height) / box.height];
  }

  #listen() {
    const canvas = this.canvas;
    canvas.tabIndex = 0;
    let from = /** @type {number[]|null} */ (null), moved = false, taken = false;
    canvas.addEventListener("pointerdown", (event) => {
      from = this.#at(event);
      moved = false;
      taken = event.button === 0 && this.ondown(this.toPixel(from), event);
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!from) return;
      const to = this.#at(event);
      if (!moved && Math.hypot(to[0] - from[0], to[1] - from[1]) < 3) return;
      moved = true;
      if (taken) this.ondrag(this.toPixel(to), event);
      else { this.#move((from[0] - to[0]) / this.scale, (from[1] - to[1]) / this.scale); from = to; }
    });
    canvas.addEventListener("pointerup", (event) => {
      if (from && !moved && !taken) this.onclick(this.toPixel(this.#at(event)), event);
      if (taken) this.onup(this.toPixel(this.#at(event)), event);
      from = null;
      taken = false;
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(this.#at(event), Math.exp(-event.deltaY * 0.0015));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      if (event.key !== "+" && event.key !== "-") return;
      event.preventDefault();
      this.zoom([canvas.width / 2, canvas.height / 2], event.key === "+" ? 1.25 : 0.8);
    });
  }
}
