// Figures of a job, each from the document of a stage.
import { bars, figure, plot } from "./chart.js";

const BEFORE = { name: "Baseline", colour: "--before", mark: /** @type {"square"} */ ("square") };
const AFTER = { name: "Fine-tuned", colour: "--after", mark: /** @type {"circle"} */ ("circle") };
const MARKS = /** @type {const} */ (["circle", "square", "triangle", "cross"]);
const CAMERAS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5195", "#8a6d3b"];

/** Share of a bin: "20–30". @param {any} bin @param {number} [factor] */
const between = (bin, factor = 1) => (bin.high === null ? `≥ ${bin.low * factor}` : `${(bin.low ?? 0) * factor}–${bin.high * factor}`);

/** A figure of merit by parts, before and after. @param {string} title @param {any} byNetwork @param {string} x @param {string} caption @param {number} [factor] */
function byBin(title, byNetwork, x, caption, factor = 1) {
  const before = byNetwork.baseline ?? [], after = byNetwork.finetuned ?? [];
  const bins = after.length ? after : before;
  const value = (/** @type {any} */ bin) => bin.bev_iou.mean;
  return figure({
    title, caption, key: [BEFORE, AFTER].map(({ name, colour }) => ({ name, colour })),
    chart: bars({ categories: bins.map((/** @type {any} */ bin) => between(bin, factor)), y: "BEV IoU", x, yRange: [0, 1], label: `${title}: BEV IoU before and after`,
      groups: [{ ...BEFORE, values: before.map(value), hatch: true }, { ...AFTER, values: after.map(value) }] }),
    columns: ["low", "high", "baseline_bev_iou", "finetuned_bev_iou", "baseline_recall", "finetuned_recall", "matched", "missed"],
    rows: bins.map((/** @type {any} */ bin, /** @type {number} */ index) => [bin.low, bin.high, before[index] ? value(before[index]) : null, after[index] ? value(after[index]) : null, before[index]?.recall, after[index]?.recall, bin.matched, bin.missed]),
  });
}

/** @param {any} metrics */
export function qualityFigures(metrics) {
  const found = [];
  if (metrics.by_distance) found.push(byBin("By distance", metrics.by_distance, "distance from the camera, m", "Only vehicles that were found count."));
  if (metrics.by_visibility) found.push(byBin("By visibility", metrics.by_visibility, "visible share, %", "Share of a vehicle that the camera sees.", 100));
  if (metrics.by_elevation) found.push(byBin("By elevation", metrics.by_elevation, "elevation angle, °", "How steeply the camera looks down on the vehicle."));
  for (const [kind, reliability] of Object.entries(metrics.reliability?.finetuned ?? {})) {
    if (reliability.coverage) found.push(coverage(kind, reliability.coverage, reliability.count));
  }
  return found;
}

/** @param {string} kind @param {any} shares @param {number} count */
function coverage(kind, shares, count) {
  const series = ["laplace", "normal"].map((name, index) => ({ name: `intervals of a ${name === "normal" ? "normal" : "Laplace"} distribution`, colour: index ? "--before" : "--after", mark: MARKS[index],
    points: shares.level.map((/** @type {number} */ level, /** @type {number} */ i) => [level, shares[name][i]]) }));
  return figure({
    title: `Reliability of ${kind.replaceAll("_", " ")}`, caption: `Of ${count} boxes: the share of errors within intervals that should hold the share below. On the dashed line, stated standard deviations are right.`,
    key: series,
    chart: plot({ series: [{ name: "right", colour: "--line-strong", kind: "line", dash: "4 3", points: [[0, 0], [1, 1]] }, ...series], x: "share that should be within", y: "share that is", xRange: [0, 1], yRange: [0, 1], label: `Reliability of ${kind}` }),
    columns: ["level", "laplace", "normal"], rows: shares.level.map((/** @type {number} */ level, /** @type {number} */ i) => [level, shares.laplace[i], shares.normal[i]]),
  });
}

/**
 * What jobs of a site that can be compared came to, by how much they learned from.
 * @param {any[]} amounts `GET /v1/sites/{id}/amounts` @param {string} jobId whose test part and labels the others must have
 * @returns {HTMLElement[]} none where there is nothing to compare with
 */
export function amountFigures(amounts, jobId) {
  const own = amounts.find((one) => one.job_id === jobId);
  const same = amounts.filter((one) => own && Math.abs(one.test_from_s - own.test_from_s) < 1 && Math.abs(one.test_to_s - own.test_to_s) < 1 && one.labels === own.labels && one.labelled_instants === own.labelled_instants);
  if (same.length < 2) return [];
  const [field, y] = own.labels === "hand" ? ["bev_iou_misses_zero", "BEV IoU, misses as 0"] : ["other_views", "IoU in other views"];
  const series = [{ ...BEFORE, of: "baseline" }, { ...AFTER, of: "finetuned" }].map(({ of, ...how }) => {
    const known = same.filter((one) => one[field][of] !== null);
    return { ...how, kind: /** @type {"dots"} */ ("dots"), points: known.map((one) => /** @type {[number, number]} */ ([one.train_s / 60, one[field][of]])), titles: known.map((one) => `${one.name || one.job_id}: ${one.train_vehicles} vehicles`) };
  });
  return [figure({
    title: "Amount of footage", key: series,
    caption: `${same.length} jobs of this site with the same test part${own.labels === "hand" ? " and as many labels" : ""}, a mark each. How far jobs with the same amount lie apart is what a difference means nothing below.`,
    chart: plot({ series, x: "footage learned from, min", y, yRange: [0, 1], label: `${y} by the amount of footage` }),
    columns: ["job", "train_s", "train_vehicles", `baseline_${field}`, `finetuned_${field}`, "baseline_recall", "finetuned_recall"],
    rows: same.map((one) => [one.job_id, one.train_s, one.train_vehicles, one[field].baseline, one[field].finetuned, one.recall.baseline, one.recall.finetuned]),
  })];
}

/** @param {any} curves */
export function trainingFigures(curves) {
  const parts = [...new Set(curves.epochs.flatMap((/** @type {any} */ epoch) => Object.keys(epoch.train)))];
  const line = (/** @type {string} */ part, /** @type {"train"|"validation"} */ of) => curves.epochs.filter((/** @type {any} */ epoch) => part in epoch[of]).map((/** @type {any} */ epoch) => [epoch.step, epoch[of][part]]);
  return [...parts].sort((a, b) => Number(b === "total") - Number(a === "total")).map((part) => {
    const series = [{ name: "training part", colour: "--before", mark: MARKS[1], points: line(part, "train") }, { name: "validation part", colour: "--after", mark: MARKS[0], points: line(part, "validation") }];
    return figure({
      title: part === "total" ? "Loss" : `Loss: ${part}`, key: series,
      caption: part === "total" ? `The weights of step ${curves.kept_step} were kept (${curves.kept}).` : "",
      chart: plot({ series, x: "step", y: "loss", label: `Loss ${part} by step`, refs: [{ x: curves.kept_step, name: "kept" }] }),
      columns: ["step", "train", "validation"], rows: curves.epochs.map((/** @type {any} */ epoch) => [epoch.step, epoch.train[part], epoch.validation[part]]),
    });
  });
}

/** @param {any} changes */
export function syncFigures(changes) {
  const cameras = Object.keys(changes.cameras);
  const rows = changes.groups.flatMap((/** @type {any} */ group) => group.observations.map((/** @type {any} */ seen) => [group.signal, group.time_s, seen.camera, seen.delay_before_s, seen.delay_after_s, seen.residual_s]));
  if (!rows.length) return [];
  const series = (/** @type {number} */ column) => cameras.map((camera, index) => ({ name: camera, colour: CAMERAS[index % CAMERAS.length], kind: /** @type {"dots"} */ ("dots"), mark: MARKS[index % MARKS.length],
    points: rows.filter((/** @type {any} */ row) => row[2] === camera && row[column] !== null).map((/** @type {any} */ row) => [row[1], column === 3 ? row[3] : row[column] * 1000]) }));
  const columns = ["signal", "time_s", "camera", "delay_before_s", "delay_after_s", "residual_s"];
  return [
    figure({ title: "Before synchronisation", caption: "How much later each camera shows a light change than the reference camera, by its own clock.", key: series(3), chart: plot({ series: series(3), x: "time, s", y: "delay, s", label: "Delays before synchronisation" }), columns, rows }),
    figure({ title: "After synchronisation", caption: "What remains, against the mean of all cameras that saw the change.", key: series(5), chart: plot({ series: series(5), x: "time, s", y: "residual, ms", label: "Residuals after synchronisation", refs: [{ y: 0, name: "" }] }), columns, rows }),
  ];
}

/** @param {string} title @param {any} histogram @param {string} x @param {string} y */
function histogramFigure(title, histogram, x, y) {
  const edges = histogram.edges;
  return figure({
    title, chart: bars({ categories: histogram.counts.map((/** @type {number} */ _, /** @type {number} */ index) => String(Number(edges[index].toPrecision(4)))), groups: [{ name: title, colour: "--after", values: histogram.counts }], x: `${x} (from)`, y, label: title }),
    columns: ["from", "to", "count"], rows: histogram.counts.map((/** @type {number} */ count, /** @type {number} */ index) => [edges[index], edges[index + 1], count]),
  });
}

/** @param {string} title @param {Object<string, number>} counts @param {string} x @param {string} y */
function countsFigure(title, counts, x, y) {
  const names = Object.keys(counts);
  return figure({ title, chart: bars({ categories: names, groups: [{ name: title, colour: "--after", values: names.map((name) => counts[name]) }], x, y, label: title }), columns: [x, y], rows: names.map((name) => [name, counts[name]]) });
}

/** @param {any} statistics of the data set */
export function dataFigures(statistics) {
  return [
    countsFigure("Views of a vehicle", statistics.by_views, "cameras that see it", "sightings"),
    countsFigure("Road users by class", statistics.by_class, "class", "sightings"),
    countsFigure("2D boxes by camera", statistics.boxes_by_camera, "camera", "boxes"),
    histogramFigure("Distance", statistics.depth_m, "distance along the optical axis, m", "views"),
    histogramFigure("Elevation", statistics.elevation_deg, "angle below the horizontal, °", "views"),
    histogramFigure("Vehicles at once", statistics.vehicles_per_instant, "vehicles", "instants"),
    histogramFigure("Sightings of a vehicle", statistics.sightings_per_track, "sightings", "vehicles"),
  ];
}
