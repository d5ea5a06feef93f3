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
  const words = columns.map((_, index) => cells.length > 0 && cells.every((row) => typeof row[index] === "string" && /^[a-z]/i.test(row[index])));
  const as = (/** @type {string} */ tag, /** @type {number} */ index) => (words[index] ? tag : `${tag}.number`);
  return h("div", null,
    h("div.scroll", { tabindex: 0, role: "region", "aria-label": title }, h("table", null, h("caption.unseen", null, title),
      h("thead", null, h("tr", null, columns.map((column, index) => h(index ? as("th", index) : "th", { scope: "col" }, column)))),
      h("tbody", null, cells.map((row) => h("tr", null, row.map((cell, index) => (index ? h(as("td", index), null, cell) : h("th", { scope: "row" }, cell)))))))),
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
      test && test.low !== null ? `${number(test.low, digits)} to ${number(test.high, digits)}` : tooFew(test) || "–", test ? number(test.p_bootstrap, 3) : "–"];
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

/** What stands in place of an interval where there are too few vehicles for one; empty where there are enough, or none. @param {any} test */
export function tooFew(test) {
  if (!test || test.difference === null || test.p_bootstrap !== null) return "";
  return `${test.vehicles} vehicle${test.vehicles === 1 ? "" : "s"}: too few`;
}

/** @param {any} test @param {number} digits @param {boolean} lessIsBetter */
function change(test, digits, lessIsBetter) {
  if (!test || test.difference === null) return "–";
  const sure = test.p_bootstrap !== null && test.p_bootstrap < 0.05;
  const better = (test.difference < 0) === lessIsBetter;
  const sign = test.difference > 0 ? "+" : "";
  return h(`span${sure ? (better ? ".better" : ".worse") : ""}`, { title: sure ? (better ? "better" : "worse") : tooFew(test) || "may be chance" }, sign + number(test.difference, digits));
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

/** What each two cameras' road users say, other offsets that were considered, and segments that were placed: tables, where there are any. @param {any} changes */
export function clockWitnesses(changes) {
  const cameras = Object.entries(changes.cameras);
  const pairs = (changes.traffic ?? []).map((/** @type {any} */ pair) => [`${pair.second} against ${pair.first}`, pair.offset_s, pair.sd_s, pair.drift_ppm, pair.matched, pair.could, pair.score, ms(pair.residual_s), pair.clear]);
  const others = cameras.flatMap(([id, clock]) => clock.alternatives.map((/** @type {any} */ other) => [id, other.offset_s, other.drift_ppm, other.matched, other.could, other.score, other.excluded]));
  const segments = cameras.flatMap(([id, clock]) => (clock.segments ?? []).map((/** @type {any} */ one) => [id, one.from_s, one.shift_s, one.sd_s, one.matched]));
  const found = [];
  if (pairs.length) {
    found.push(table("What the traffic says", ["Cameras", "Offset, s", "± s", "Drift, ppm", "Road users that meet", "Could", "Share", "Minus all witnesses' answer, ms", "Used"], pairs,
      { cells: pairs.map((/** @type {any[]} */ [names, offset, sd, drift, matched, could, share, residual, clear]) => [clear ? names : [names, " ", h("span.chip.caution", null, "not used")], number(offset, 3), number(sd, 3), number(drift, 0), matched, number(could, 0), percent(share), number(residual, 1), clear ? "yes" : "no"]),
        note: "Road users that both cameras see. Not used: too few meet, or other offsets explain as much." }));
  }
  if (others.length) {
    found.push(table("Other offsets", ["Camera", "Offset, s", "Drift, ppm", "Changes that meet", "Could", "Share", "Excluded"], others,
      { cells: others.map((/** @type {any[]} */ [id, offset, drift, matched, could, share, excluded]) => [id, number(offset, 2), number(drift, 0), matched, number(could, 0), percent(share), excluded ? "yes" : "as likely"]),
        note: "Offsets under which light changes meet, too. Excluded ones explain them far worse than the one that was taken." }));
  }
  if (segments.length) {
    found.push(table("Placed segments", ["Camera", "From, s", "Later by, s", "± s", "Shared changes"], segments,
      { cells: segments.map((/** @type {any[]} */ [id, from, shift, sd, matched]) => [id, number(from, 1), number(shift, 3), number(sd, 3), matched]),
        note: "Before each, the camera was off for a time that only what it shows can tell." }));
  }
  return found;
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
