// Figures as SVG, with the numbers behind them: every figure can be saved as CSV, SVG and PNG.
import { h, s } from "./dom.js";

/**
 * @typedef {Object} Series
 * @property {string} name
 * @property {string} colour a colour, or the name of a token such as "--before"
 * @property {Array<[number, number]>} points
 * @property {"line"|"dots"|"steps"} [kind]
 * @property {string} [dash]
 * @property {"circle"|"square"|"triangle"|"cross"} [mark] tells series apart without colour
 * @property {string[]} [titles] said of each point when it is pointed at
 */

const WIDTH = 560, HEIGHT = 300, LEFT = 56, RIGHT = 14, TOP = 14, BOTTOM = 44;

/** A colour or a token. @param {string} colour */
const paint = (colour) => (colour.startsWith("--") ? `var(${colour})` : colour);

/** Round steps that cover a range. @param {number} low @param {number} high @param {number} count */
export function ticks(low, high, count = 5) {
  if (!(high > low)) return [low];
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 2.5, 5, 10].map((factor) => factor * power).find((value) => value >= raw) ?? raw;
  const found = [];
  for (let value = Math.ceil(low / step - 1e-9) * step; value <= high + step * 1e-9; value += step) found.push(Number(value.toPrecision(10)));
  return found;
}

/** @param {number[]} values @param {number} [margin] @returns {[number, number]} */
function rangeOf(values, margin = 0.04) {
  const known = values.filter(Number.isFinite);
  if (!known.length) return [0, 1];
  let low = Math.min(...known), high = Math.max(...known);
  if (low === high) { low -= 0.5; high += 0.5; }
  const by = (high - low) * margin;
  return [low - by, high + by];
}

/** A mark of a series at a pixel. @param {string} mark @param {number} x @param {number} y @param {string} colour @param {string} [title] */
function markAt(mark, x, y, colour, title) {
  const inside = title ? s("title", null, title) : null;
  if (mark === "square") return s("rect", { x: x - 3, y: y - 3, width: 6, height: 6, fill: paint(colour) }, inside);
  if (mark === "triangle") return s("path", { d: `M${x} ${y - 4}L${x + 4} ${y + 3}H${x - 4}Z`, fill: paint(colour) }, inside);
  if (mark === "cross") return s("path", { d: `M${x - 3} ${y - 3}l6 6m0 -6l-6 6`, stroke: paint(colour), "stroke-width": 1.6, fill: "none" }, inside);
  return s("circle", { cx: x, cy: y, r: 3.2, fill: paint(colour) }, inside);
}

/**
 * Lines, dots and steps over common axes.
 * @param {{series: Series[], x: string, y: string, xRange?: [number, number], yRange?: [number, number], label: string, refs?: Array<{y?: number, x?: number, name: string}>}} options
 * @returns {SVGElement}
 */
export function plot({ series, x, y, xRange, yRange, label, refs = [] }) {
  const [x0, x1] = xRange ?? rangeOf(series.flatMap((one) => one.points.map((point) => point[0])));
  const [y0, y1] = yRange ?? rangeOf(series.flatMap((one) => one.points.map((point) => point[1])));
  const px = (/** @type {number} */ value) => LEFT + ((value - x0) / (x1 - x0)) * (WIDTH - LEFT - RIGHT);
  const py = (/** @type {number} */ value) => HEIGHT - BOTTOM - ((value - y0) / (y1 - y0)) * (HEIGHT - TOP - BOTTOM);
  const root = frame(label);
  axes(root, { x, y, px, py, xTicks: ticks(x0, x1, 6), yTicks: ticks(y0, y1) });
  for (const ref of refs) {
    const line = ref.y !== undefined ? { x1: LEFT, x2: WIDTH - RIGHT, y1: py(ref.y), y2: py(ref.y) } : { x1: px(ref.x ?? 0), x2: px(ref.x ?? 0), y1: TOP, y2: HEIGHT - BOTTOM };
    root.append(s("line.ref", line), s("text.ref", { x: ref.y !== undefined ? WIDTH - RIGHT : px(ref.x ?? 0) + 3, y: ref.y !== undefined ? py(ref.y) - 4 : TOP + 10, "text-anchor": ref.y !== undefined ? "end" : "start" }, ref.name));
  }
  for (const one of series) {
    const points = one.points.filter((point) => point.every(Number.isFinite));
    if (one.kind !== "dots" && points.length > 1) {
      root.append(s("path.line", { d: `M${points.map((point) => `${px(point[0]).toFixed(1)} ${py(point[1]).toFixed(1)}`).join("L")}`, stroke: paint(one.colour), "stroke-dasharray": one.dash }));
    }
    if (one.kind !== "line") points.forEach((point, index) => root.append(markAt(one.mark ?? "circle", px(point[0]), py(point[1]), one.colour, one.titles?.[index])));
  }
  return root;
}

/**
 * Bars side by side for each category.
 * @param {{categories: string[], groups: Array<{name: string, colour: string, values: Array<number|null>, hatch?: boolean}>, y: string, x?: string, label: string, yRange?: [number, number]}} options
 * @returns {SVGElement}
 */
export function bars({ categories, groups, y, x = "", label, yRange }) {
  const values = groups.flatMap((group) => group.values.filter((value) => value !== null));
  const [y0, y1] = yRange ?? [0, Math.max(1e-9, ...values.map(Number)) * 1.06];
  const root = frame(label), each = (WIDTH - LEFT - RIGHT) / categories.length, one = (each * 0.76) / groups.length;
  const py = (/** @type {number} */ value) => HEIGHT - BOTTOM - ((value - y0) / (y1 - y0)) * (HEIGHT - TOP - BOTTOM);
  axes(root, { x, y, px: () => 0, py, xTicks: [], yTicks: ticks(y0, y1) });
  categories.forEach((category, index) => {
    const left = LEFT + index * each;
    if (categories.length <= 14 || index % Math.ceil(categories.length / 12) === 0) root.append(s("text", { x: left + each / 2, y: HEIGHT - BOTTOM + 15, "text-anchor": "middle" }, category));
    groups.forEach((group, number) => {
      const value = group.values[index];
      if (value === null || value === undefined) return;
      root.append(s("rect", { x: left + each * 0.12 + number * one, y: py(value), width: Math.max(one - 1, 1), height: Math.max(HEIGHT - BOTTOM - py(value), 0), fill: paint(group.colour), "fill-opacity": group.hatch ? 0.55 : 1, stroke: paint(group.colour) },
        s("title", null, `${group.name}, ${category}: ${Number(value.toPrecision(4))}`)));
    });
  });
  return root;
}

/** @param {string} label */
function frame(label) {
  return s("svg.chart", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": label, width: WIDTH, height: HEIGHT });
}

/** @param {SVGElement} root @param {{x: string, y: string, px: (v: number) => number, py: (v: number) => number, xTicks: number[], yTicks: number[]}} options */
function axes(root, { x, y, px, py, xTicks, yTicks }) {
  const bottom = HEIGHT - BOTTOM;
  for (const value of yTicks) {
    root.append(s("line.grid", { x1: LEFT, x2: WIDTH - RIGHT, y1: py(value), y2: py(value) }), s("text", { x: LEFT - 6, y: py(value) + 4, "text-anchor": "end" }, String(value).replace("-", "−")));
  }
  for (const value of xTicks) {
    root.append(s("line.axis", { x1: px(value), x2: px(value), y1: bottom, y2: bottom + 4 }), s("text", { x: px(value), y: bottom + 16, "text-anchor": "middle" }, String(value).replace("-", "−")));
  }
  root.append(s("line.axis", { x1: LEFT, x2: WIDTH - RIGHT, y1: bottom, y2: bottom }),
    s("text.name", { x: (LEFT + WIDTH - RIGHT) / 2, y: HEIGHT - 8, "text-anchor": "middle" }, x),
    s("text.name", { x: 14, y: (TOP + bottom) / 2, "text-anchor": "middle", transform: `rotate(-90 14 ${(TOP + bottom) / 2})` }, y));
}

/** What stands for what. @param {Array<{name: string, colour: string, mark?: string, dash?: string}>} series */
export function legend(series) {
  return h("ul.legend", null, series.map((one) => h("li", null,
    s("svg", { width: 22, height: 12, "aria-hidden": "true" }, one.dash !== undefined || !one.mark ? s("path", { d: "M1 6H21", stroke: paint(one.colour), "stroke-width": 3, "stroke-dasharray": one.dash }) : markAt(one.mark, 11, 6, one.colour)),
    one.name)));
}

/**
 * A figure with its caption, legend, and the numbers behind it.
 * @param {{title: string, caption?: string, chart: Element, key?: Array<{name: string, colour: string, mark?: string, dash?: string}>, columns: string[], rows: any[][]}} options
 * @returns {HTMLElement}
 */
export function figure({ title, caption = "", chart, key = [], columns, rows }) {
  const name = title.toLowerCase().replaceAll(/[^a-z0-9]+/g, "-");
  const svg = chart instanceof SVGElement ? chart : null;
  return h("figure.card", null, h("h3", null, title), key.length > 1 ? legend(key) : null, chart,
    caption ? h("figcaption", null, caption) : null,
    h("div.row.save", null,
      h("button.small", { type: "button", onclick: () => save(`${name}.csv`, new Blob([toCsv(columns, rows)], { type: "text/csv" })), "aria-label": `${title}: save the numbers as CSV` }, "CSV"),
      svg ? h("button.small", { type: "button", onclick: () => save(`${name}.svg`, standalone(svg)), "aria-label": `${title}: save as SVG` }, "SVG") : null,
      svg ? h("button.small", { type: "button", onclick: () => savePng(`${name}.png`, svg), "aria-label": `${title}: save as PNG` }, "PNG") : null));
}

/** RFC 4180. @param {string[]} columns @param {any[][]} rows */
export function toCsv(columns, rows) {
  const cell = (/** @type {any} */ value) => {
    const text = value === null || value === undefined ? "" : String(value);
    return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  return [columns, ...rows].map((row) => row.map(cell).join(",")).join("\r\n") + "\r\n";
}

/** Give a file to the user. @param {string} name @param {Blob} blob */
export function save(name, blob) {
  const link = h("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.getAttribute("href") ?? ""), 10_000);
}

/**
 * Save pictures as one PNG file: the first at the left, the others beside it, two in a row.
 * @param {string} name @param {HTMLCanvasElement[]} canvases
 */
export function saveCanvases(name, canvases) {
  const [first, ...others] = canvases, all = document.createElement("canvas"), context = all.getContext("2d");
  const width = first.width / 2, heights = others.map((one) => (one.height * width) / one.width);
  const rows = heights.flatMap((height, index) => (index % 2 ? [] : [Math.max(height, heights[index + 1] ?? 0)]));
  all.width = others.length ? 2 * first.width : first.width;
  all.height = Math.max(first.height, Math.ceil(rows.reduce((sum, height) => sum + height, 0)));
  if (!context) return;
  context.fillStyle = getComputedStyle(document.documentElement).getPropertyValue("--sheet").trim();
  context.fillRect(0, 0, all.width, all.height);
  context.drawImage(first, 0, 0);
  others.forEach((one, index) => context.drawImage(one, first.width + (index % 2) * width, rows.slice(0, Math.floor(index / 2)).reduce((sum, height) => sum + height, 0), width, heights[index]));
  all.toBlob((blob) => { if (blob) save(name, blob); }, "image/png");
}

const INLINED = ["fill", "fill-opacity", "stroke", "stroke-width", "stroke-dasharray", "font-family", "font-size", "font-weight", "opacity", "text-anchor"];

/** A drawing that looks the same without our styles. @param {SVGElement} svg @returns {Blob} */
function standalone(svg) {
  const copy = /** @type {SVGElement} */ (svg.cloneNode(true));
  const from = [svg, ...svg.querySelectorAll("*")], to = [copy, ...copy.querySelectorAll("*")];
  from.forEach((node, index) => {
    const style = getComputedStyle(node);
    for (const property of INLINED) to[index].setAttribute(property, style.getPropertyValue(property));
    to[index].removeAttribute("class");
  });
  const ground = s("rect", { width: "100%", height: "100%", fill: getComputedStyle(document.documentElement).getPropertyValue("--sheet").trim() });
  copy.prepend(ground);
  copy.setAttribute("xmlns", "http://www.w3.org/2000/svg");
  return new Blob([new XMLSerializer().serializeToString(copy)], { type: "image/svg+xml" });
}

/** @param {string} name @param {SVGElement} svg */
function savePng(name, svg) {
  const url = URL.createObjectURL(standalone(svg)), image = new Image(), scale = 2;
  image.addEventListener("load", () => {
    const canvas = document.createElement("canvas");
    canvas.width = image.naturalWidth * scale;
    canvas.height = image.naturalHeight * scale;
    canvas.getContext("2d")?.drawImage(image, 0, 0, canvas.width, canvas.height);
    URL.revokeObjectURL(url);
    canvas.toBlob((blob) => { if (blob) save(name, blob); }, "image/png");
  });
  image.src = url;
}
