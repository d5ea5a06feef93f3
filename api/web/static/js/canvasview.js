// What the plan and the frames of cameras share: a canvas that is moved and enlarged by mouse and keys, on which things are drawn
// in coordinates of their own.

/** A token's colour, as it stands now. @param {string} name */
export function token(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

/** A view on a canvas. Who extends it says how its coordinates lie on the canvas, and what is behind what is drawn. */
export class CanvasView {
  /** How far a pointer moves before a click becomes a drag, canvas px. */
  static still = 4;

  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.pending = false;
    /** Called where one clicks, in the view's coordinates; null where clicks do nothing. @type {((point: number[], event: PointerEvent|KeyboardEvent) => void)|null} */
    this.onclick = null;
    /** Called where a drag may begin; says whether it is taken, or else moves the view. @type {(point: number[], event: PointerEvent) => boolean} */
    this.ondown = () => false;
    /** @type {(point: number[], event: PointerEvent) => void} */
    this.ondrag = () => {};
    /** @type {(point: number[], event: PointerEvent) => void} */
    this.onup = () => {};
    this.#listen();
  }

  /** Coordinates to canvas px. @param {number[]} _point @returns {number[]} */
  toCanvas(_point) {
    throw new Error("of those who extend it");
  }

  /** Canvas px to coordinates. @param {number[]} _at @returns {number[]} */
  fromCanvas(_at) {
    throw new Error("of those who extend it");
  }

  /** Move what is seen. @param {number} _right canvas px @param {number} _down */
  pan(_right, _down) {
    throw new Error("of those who extend it");
  }

  /** @param {number[]} _at canvas px that stays where it is @param {number} _factor */
  zoom(_at, _factor) {
    throw new Error("of those who extend it");
  }

  /** @param {CanvasRenderingContext2D} _context */
  paint(_context) {
    throw new Error("of those who extend it");
  }

  /** Draw again, once, before the next picture is shown. */
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
    this.paint(context);
    if (this.onclick && this.canvas.matches(":focus-visible")) this.#aim(context);
  }

  /** A cross where Enter clicks, for whoever came here by keys. @param {CanvasRenderingContext2D} context */
  #aim(context) {
    const [x, y] = this.cursor(), reach = 12 * this.unit;
    context.beginPath();
    context.moveTo(x - reach, y); context.lineTo(x + reach, y);
    context.moveTo(x, y - reach); context.lineTo(x, y + reach);
    for (const [colour, width] of /** @type {Array<[string, number]>} */ ([[token("--sheet"), 4], [token("--ink"), 1.5]])) {
      context.strokeStyle = colour;
      context.lineWidth = width * this.unit;
      context.stroke();
    }
  }

  /** Where Enter clicks, canvas px. @returns {number[]} */
  cursor() {
    return [this.canvas.width / 2, this.canvas.height / 2];
  }

  /** A way through points. @param {CanvasRenderingContext2D} context @param {number[][]} points @param {boolean} [closed] */
  trace(context, points, closed = false) {
    context.beginPath();
    points.forEach((point, index) => {
      const [x, y] = this.toCanvas(point);
      if (index) context.lineTo(x, y);
      else context.moveTo(x, y);
    });
    if (closed) context.closePath();
  }

  /** Canvas px for each px of the screen: a plan on a phone is shown at a third of its size. */
  get unit() {
    return this.canvas.width / (this.canvas.clientWidth || this.canvas.width);
  }

  /**
   * Text that is read on any ground, as large on every screen.
   * @param {CanvasRenderingContext2D} context @param {string} text @param {number[]} at canvas px
   * @param {{size?: number, align?: CanvasTextAlign, ink?: string, halo?: string}} [how] size in px of the screen
   */
  write(context, text, at, { size = 12, align = "center", ink = token("--ink"), halo = token("--sheet") } = {}) {
    context.font = `600 ${Math.round(size * this.unit)}px system-ui, sans-serif`;
    context.textAlign = align;
    context.lineJoin = "round";
    context.lineWidth = 3 * this.unit;
    context.strokeStyle = halo;
    context.strokeText(text, at[0], at[1]);
    context.fillStyle = ink;
    context.fillText(text, at[0], at[1]);
  }

  /** Canvas px under the mouse. @param {MouseEvent} event @returns {number[]} */
  at(event) {
    const box = this.canvas.getBoundingClientRect();
    return [((event.clientX - box.left) * this.canvas.width) / box.width, ((event.clientY - box.top) * this.canvas.height) / box.height];
  }

  /** What keys do. @returns {Object<string, (event: any) => void>} */
  keys() {
    const click = this.onclick, zooming = { "+": () => this.zoom(this.cursor(), 1.25), "-": () => this.zoom(this.cursor(), 0.8) };
    return click ? { ...zooming, Enter: (event) => click(this.fromCanvas(this.cursor()), event) } : zooming;
  }

  #listen() {
    const canvas = this.canvas;
    canvas.tabIndex = 0;
    let from = /** @type {number[]|null} */ (null), moved = false, taken = false;
    canvas.addEventListener("pointerdown", (event) => {
      from = this.at(event);
      moved = false;
      taken = event.button === 0 && this.ondown(this.fromCanvas(from), event);
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!from) return;
      const to = this.at(event);
      if (!moved && Math.hypot(to[0] - from[0], to[1] - from[1]) < CanvasView.still) return;
      moved = true;
      if (taken) this.ondrag(this.fromCanvas(to), event);
      else { this.pan(to[0] - from[0], to[1] - from[1]); from = to; }
    });
    canvas.addEventListener("pointerup", (event) => {
      if (from && !moved && !taken) this.onclick?.(this.fromCanvas(this.at(event)), event);
      if (taken) this.onup(this.fromCanvas(this.at(event)), event);
      from = null;
      taken = false;
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(this.at(event), Math.exp(-event.deltaY * 0.0015));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const work = this.keys()[event.key];
      if (!work || event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      event.stopPropagation();
      work(event);
      this.redraw();
    });
    for (const kind of ["focus", "blur"]) canvas.addEventListener(kind, () => this.redraw());
  }
}
