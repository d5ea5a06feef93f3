// Figures of places: residuals of a calibration in the camera's frame, and where road users went.
import { request } from "./api.js";
import { figure, ticks } from "./chart.js";
import { s } from "./dom.js";
import { number } from "./format.js";

const WIDE = 640, LARGER = 20;

/** A picture as a data URI, so that a figure that is saved has it, too. @param {string} path @returns {Promise<string>} */
async function pictureOf(path) {
  const blob = await (await request("GET", path)).blob();
  return new Promise((resolve, reject) => {
    const reader = new FileReader();
    reader.addEventListener("load", () => resolve(String(reader.result)));
    reader.addEventListener("error", () => reject(reader.error));
    reader.readAsDataURL(blob);
  });
}

/**
 * A camera's points in its frame: a ring where one was clicked, a line to where the camera sees it, twenty times as long.
 * @param {string} jobId @param {import("./projection.js").Camera} camera @param {any} residuals of the camera @param {boolean} frames whether there is a frame to show
 * @returns {Promise<HTMLElement|null>} null where it has no points
 */
export async function residualFigure(jobId, camera, residuals, frames) {
  if (!residuals.residuals.length) return null;
  const scale = WIDE / camera.width, height = camera.height * scale;
  const root = s("svg.chart", { viewBox: `0 0 ${WIDE} ${height.toFixed(0)}`, role: "img", "aria-label": `Residuals of camera ${camera.id} in its frame` }, s("rect", { x: 0, y: 0, width: WIDE, height, fill: "#14181d" }));
  if (frames) root.append(s("image", { href: await pictureOf(`/v1/jobs/${jobId}/frames/${encodeURIComponent(camera.id)}?time_ns=0&width_px=${WIDE}`), width: WIDE, height }));
  const rows = residuals.residuals.map((/** @type {any} */ point, /** @type {number} */ index) => {
    const [u, v] = point.pixel, seen = camera.project([...point.world, 0].slice(0, 3)), x = (u + 0.5) * scale, y = (v + 0.5) * scale;
    const colour = point.used ? "#6cb0f5" : "#ff9a90";
    if (seen) root.append(s("line", { x1: x, y1: y, x2: x + (seen[0] - u) * scale * LARGER, y2: y + (seen[1] - v) * scale * LARGER, stroke: colour, "stroke-width": 2 }));
    root.append(s("circle", { cx: x, cy: y, r: 5, fill: "none", stroke: colour, "stroke-width": 2, "stroke-dasharray": point.used ? null : "3 2" }, s("title", null, `point ${index + 1}: ${number(point.error_px)} px${point.used ? "" : ", taken for an outlier"}`)));
    return [index + 1, u, v, ...point.world, point.used, point.error_px, point.error_m];
  });
  return figure({
    title: camera.id, caption: `${residuals.points} points, ${residuals.rejected} taken for outliers (dashed). Median ${number(residuals.median_px)} px, largest ${number(residuals.max_px)} px. Lines are ${LARGER} times as long as the residuals.`,
    chart: root, columns: ["point", "u_px", "v_px", "x_m", "y_m", "z_m", "used", "error_px", "error_m"], rows,
  });
}

/**
 * Where all road users went, from above, by class.
 * @param {any} scene @param {any} found `GET /v1/jobs/{id}/tracks/paths`
 */
export function trajectoryFigure(scene, found) {
  const size = 700, drawn = found.paths.length;
  const ends = (/** @type {number[]} */ all) => { const sorted = all.sort((a, b) => a - b); return [sorted[Math.floor(sorted.length * 0.01)], sorted[Math.ceil(sorted.length * 0.99) - 1]]; };
  const [x0, x1] = ends(found.paths.flatMap((/** @type {any} */ path) => path.x_m)), [y0, y1] = ends(found.paths.flatMap((/** @type {any} */ path) => path.y_m));
  const scale = (size - 60) / Math.max(x1 - x0, y1 - y0, 1), px = (/** @type {number} */ x) => 40 + (x - x0) * scale, py = (/** @type {number} */ y) => size - 40 - (y - y0) * scale;
  const root = s("svg.chart", { viewBox: `0 0 ${size} ${size}`, role: "img", "aria-label": `${drawn} trajectories from above` });
  for (const x of ticks(x0, x1, 6)) root.append(s("line.grid", { x1: px(x), x2: px(x), y1: 20, y2: size - 40 }), s("text", { x: px(x), y: size - 24, "text-anchor": "middle" }, String(x)));
  for (const y of ticks(y0, y1, 6)) root.append(s("line.grid", { x1: 40, x2: size - 20, y1: py(y), y2: py(y) }), s("text", { x: 34, y: py(y) + 4, "text-anchor": "end" }, String(y)));
  root.append(s("text.name", { x: size / 2, y: size - 6, "text-anchor": "middle" }, "x, m (y upwards)"));
  const colours = new Map(scene.classes.map((/** @type {any} */ one) => [one.name, one.colour]));
  for (const path of found.paths) {
    const colour = colours.get(path.class) ?? "#888888", name = s("title", null, `track ${path.track_id}, ${path.class}`);
    if (path.x_m.length < 2) { root.append(s("circle", { cx: px(path.x_m[0]), cy: py(path.y_m[0]), r: 2.2, fill: colour, opacity: 0.75 }, name)); continue; }
    const corners = path.x_m.map((/** @type {number} */ x, /** @type {number} */ index) => `${px(x).toFixed(1)} ${py(path.y_m[index]).toFixed(1)}`);
    root.append(s("path.line", { d: `M${corners.join("L")}`, stroke: colour, opacity: 0.75, "stroke-width": 1.3 }, name));
  }
  const present = [...new Set(found.paths.map((/** @type {any} */ path) => path.class))];
  return figure({
    title: "Trajectories", caption: `${drawn < found.tracks ? `${drawn} of ${found.tracks}` : drawn} tracks, each to ${number(found.tolerance_m, 1)} m, dots where they stood; “Tracks” at the top of the page has every state. What lies beyond the outermost hundredth of all corners is cut.`,
    key: present.map((name) => ({ name, colour: colours.get(name) ?? "#888888" })),
    chart: root, columns: ["track_id", "class", "x_m", "y_m"], rows: found.paths.flatMap((/** @type {any} */ path) => path.x_m.map((/** @type {number} */ x, /** @type {number} */ index) => [path.track_id, path.class, x, path.y_m[index]])),
  });
}
