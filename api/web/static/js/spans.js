// A chart of stretches of time, a line each: what lies where on a common clock.
import { ticks } from "./chart.js";
import { s } from "./dom.js";

const WIDTH = 860, LINE = 30, LEFT = 110, RIGHT = 20, TOP = 10, BOTTOM = 42;

/**
 * Stretches of time, line by line, and one that all share.
 * @param {{lines: Array<{name: string, colour: string, spans: Array<[number, number]>}>, common: [number, number]|null, x: string, label: string}} options in seconds
 * @returns {SVGElement}
 */
export function spans({ lines, common, x, label }) {
  const all = lines.flatMap((line) => line.spans.flat()), height = TOP + BOTTOM + LINE * lines.length;
  const low = Math.min(...all), high = Math.max(...all, low + 1);
  const px = (/** @type {number} */ value) => LEFT + ((value - low) / (high - low)) * (WIDTH - LEFT - RIGHT), bottom = height - BOTTOM;
  const root = s("svg.chart", { viewBox: `0 0 ${WIDTH} ${height}`, role: "img", "aria-label": label });
  if (common) root.append(s("rect", { x: px(common[0]), y: TOP, width: Math.max(px(common[1]) - px(common[0]), 1), height: bottom - TOP, fill: "var(--good-soft)" }));
  for (const value of ticks(low, high, 8)) {
    root.append(s("line.grid", { x1: px(value), x2: px(value), y1: TOP, y2: bottom }), s("text", { x: px(value), y: bottom + 16, "text-anchor": "middle" }, String(value)));
  }
  lines.forEach((line, index) => {
    const y = TOP + LINE * index;
    root.append(s("text.name", { x: LEFT - 10, y: y + LINE / 2 + 4, "text-anchor": "end" }, line.name));
    for (const [from, to] of line.spans) root.append(s("rect", { x: px(from), y: y + 7, width: Math.max(px(to) - px(from), 1), height: LINE - 14, rx: 2, fill: line.colour }, s("title", null, `${from.toFixed(2)} s to ${to.toFixed(2)} s`)));
  });
  root.append(s("line.axis", { x1: LEFT, x2: WIDTH - RIGHT, y1: bottom, y2: bottom }), s("text.name", { x: (LEFT + WIDTH - RIGHT) / 2, y: height - 6, "text-anchor": "middle" }, x));
  return root;
}
