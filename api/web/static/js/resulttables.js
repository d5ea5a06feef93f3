// Tables of figures: before and after, by part, clocks, cameras.
import { save, toCsv } from "./chart.js";
import { h } from "./dom.js";
import { meanSd, number, percent } from "./format.js";

/** Metrics as rows of the table: title, field, digits, whether less is better. */
export const METRICS = /** @type {Array<[string, string, number, boolean]>} */ ([
  ["BEV IoU", "bev_iou", 2, false], ["3D IoU", "iou_3d", 2, false], ["BEV IoU, misses as 0", "bev_iou_misses_zero", 2, false],
  ["ATE, m", "ate_m", 2, true], ["ASE", "ase", 2, true], ["AOE, °", "aoe_deg", 1, true],
]);
const NETWORKS = [["baseline_depth", "Baseline (depth)"], ["baseline_plane", "Baseline (plane)"], ["baseline", "Baseline"], ["finetuned", "Fine-tuned"]];

/**
 * A table that can be saved as CSV.
 * @param {string} title @param {string[]} columns @param {any[][]} rows @param {{cells?: any[][], note?: string}} [options]
 *   `rows` are what is saved; `cells` what is shown, where that differs
 */
export function table(title, columns, rows, { cells = rows, note = "" } = {}) {
  const name = title.toLowerCase().replaceAll(/[^a-z0-9]+/g, "-");
  return h("div", null,
    h("div.scroll", { tabindex: 0, role: "region", "aria-label": title }, h("table", null, h("caption.unseen", null, title),
      h("thead", null, h("tr", null, columns.map((column, index) => h(index ? "th.number" : "th", { scope: "col" }, column)))),
      h("tbody", null, cells.map((row) => h("tr", null, row.map((cell, index) => (index ? h("td.number", null, cell) : h("th", { scope: "row" }, cell)))))))),
    h("div.row.save", null, h("button.small", { type: "button", "aria-label": `${title}: save as CSV`, onclick: () => save(`${name}.csv`, new Blob([toCsv(columns, rows)], { type: "text/csv" })) }, "CSV"),
      note ? h("span.note", null, note) : null));
}

/** Before and after, against hand labels. @param {any} metrics */
export function beforeAfter(metrics) {
  const present = NETWORKS.filter(([name]) => metrics[name]);
  const columns = ["", ...present.map(([, title]) => title), "Change", "95 % interval", "p (bootstrap)"];
  const cells = METRICS.map(([title, field, digits, lessIsBetter]) => {
    const test = metrics.significance?.[field];
    return [title, ...present.map(([name]) => meanSd(metrics[name][field], digits)), change(test, digits, lessIsBetter),
      test && test.low !== null ? `${number(test.low, digits)} to ${number(test.high, digits)}` : "–", test ? number(test.p_bootstrap, 3) : "–"];
  });
  cells.push(["Recall", ...present.map(([name]) => percent(metrics[name].recall.mean)), "", "", ""]);
  cells.push(["Precision", ...present.map(([name]) => percent(metrics[name].precision)), "", "", ""]);
  cells.push(["Matched, missed, false", ...present.map(([name]) => `${metrics[name].matched}, ${metrics[name].missed ?? "–"}, ${metrics[name].false_positives ?? "–"}`), "", "", ""]);
  const saved = ["network", ...METRICS.flatMap(([, field]) => [`${field}_mean`, `${field}_sd`]), "recall", "precision", "matched", "missed", "false_positives"];
  const rows = present.map(([name]) => [name, ...METRICS.flatMap(([, field]) => [metrics[name][field].mean, metrics[name][field].sd]),
    metrics[name].recall.mean, metrics[name].precision, metrics[name].matched, metrics[name].missed, metrics[name].false_positives]);
  const shown = table("Before and after", columns, cells, { note: `Mean ± standard deviation over ${metrics.frames} images of ${metrics.instants} instants that nothing was learned from.` });
  shown.querySelector("button")?.replaceWith(h("button.small", { type: "button", "aria-label": "Before and after: save as CSV", onclick: () => save("before-and-after.csv", new Blob([toCsv(saved, rows)], { type: "text/csv" })) }, "CSV"));
  return shown;
}

/** @param {any} test @param {number} digits @param {boolean} lessIsBetter */
function change(test, digits, lessIsBetter) {
  if (!test || test.difference === null) return "–";
  const sure = test.p_bootstrap !== null && test.p_bootstrap < 0.05;
  const better = (test.difference < 0) === lessIsBetter;
  const sign = test.difference > 0 ? "+" : "";
  return h(`span${sure ? (better ? ".better" : ".worse") : ""}`, { title: sure ? (better ? "better" : "worse") : "may be chance" }, sign + number(test.difference, digits));
}

/** Agreement with the other views, which needs no labels. @param {any} metrics */
export function selfConsistency(metrics) {
  const of = Object.entries(metrics.self_consistency);
  return table("Self-consistency", ["", "Sightings found", "IoU in other views, where found", "IoU in own view", "Roughness, m", "Pairs"],
    of.map(([name, value]) => [name, value.found, value.other_views.mean, value.own_view.mean, value.roughness_m.mean, value.pairs]),
    { cells: of.map(([name, value]) => [NETWORKS.find(([known]) => known === name)?.[1] ?? name, percent(value.found), meanSd(value.other_views), meanSd(value.own_view), meanSd(value.roughness_m), value.pairs]),
      note: "Boxes against the 2D boxes of views that they were not made in; no labels are needed." });
}

/** @param {any} changes the document of the synchronisation */
export function clocks(changes) {
  const of = Object.entries(changes.cameras);
  return table("Clocks", ["Camera", "Offset, s", "± s", "Drift, ppm", "Changes", "Matched", "RMS before, ms", "RMS after, ms"],
    of.map(([id, clock]) => [id, clock.offset_s, clock.offset_sd_s, clock.drift_ppm, clock.changes, clock.matched, ms(clock.rms_before_s), ms(clock.rms_after_s)]),
    { cells: of.map(([id, clock]) => [clock.ambiguous ? [id, " ", h("span.chip.caution", null, "ambiguous")] : id, number(clock.offset_s, 4), number(clock.offset_sd_s, 4), number(clock.drift_ppm, 1), clock.changes, clock.matched, number(ms(clock.rms_before_s), 1), number(ms(clock.rms_after_s), 1)]) });
}

/** @param {number|null} seconds */
const ms = (seconds) => (seconds === null ? null : seconds * 1000);

/** @param {any} residuals the document of the calibration */
export function cameras(residuals) {
  const of = Object.entries(residuals.cameras);
  return table("Cameras", ["Camera", "Kind", "Points", "Left out", "Median, px", "Largest, px", "Median, m", "Height, m", "Focal length, px", "Ground within 50 m, ± m"],
    of.map(([id, camera]) => [id, camera.kind, camera.points, camera.rejected, camera.median_px, camera.max_px, camera.median_m, camera.position_m[2], camera.focal_px[0], camera.ground_sd_m]),
    { cells: of.map(([id, camera]) => [id, camera.kind, camera.points, camera.rejected, number(camera.median_px, 1), number(camera.max_px, 1), number(camera.median_m, 2), number(camera.position_m[2], 2), number(camera.focal_px[0], 0), number(camera.ground_sd_m, 2)]) });
}
