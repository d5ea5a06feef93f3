// Which instants there are near a time, and how far labelling has come.
import { get, query } from "./api.js";
import { byId } from "./dom.js";
import { duration } from "./format.js";
import { jobId } from "./jobtabs.js";

const FAR_NS = 1e9;

/** Stored instants about a time, and when each camera exposed its frames of them. @param {number} time @param {number} within ns @param {AbortSignal} [signal] @returns {Promise<any>} */
export function around(time, within, signal) {
  return get(`/v1/jobs/${jobId}/instants${query({ start_ns: time - within, end_ns: time + within })}`, { signal });
}

/** The instant of this job nearest to a time, which an address may have from another job. @param {number} time @param {number[]} all of the job @returns {Promise<number>} */
export async function nearest(time, all) {
  const close = (await around(time, FAR_NS)).times_ns, found = close.length ? close : all;
  return found.reduce((/** @type {number} */ best, /** @type {number} */ one) => (Math.abs(one - time) < Math.abs(best - time) ? one : best), found[0]);
}

/** What each camera sees of each vehicle of an answer. @param {any} answer @returns {Object<string, Object<number, number>>} camera -> id -> share */
export function sharesSeen(answer) {
  return Object.fromEntries(Object.entries(answer.visibility).map(([camera, shares]) => [camera, Object.fromEntries(
    answer.labels.vehicles.map((/** @type {{id: number}} */ vehicle, /** @type {number} */ row) => [vehicle.id, shares[row]]))]));
}

/** How many instants are finished, and where they are had. @param {Array<{finished: boolean, seconds: number, vehicles: number}>} labelled @param {string} set */
export function showProgress(labelled, set) {
  const finished = labelled.filter((one) => one.finished), seconds = finished.reduce((sum, one) => sum + one.seconds, 0);
  byId("progress").textContent = `${finished.length} instant${finished.length === 1 ? "" : "s"} finished with ${finished.reduce((sum, one) => sum + one.vehicles, 0)} vehicles${finished.length ? `, ${duration(seconds / finished.length)} of work each` : ""}.`;
  for (const format of ["parquet", "coco", "wibam"]) byId(`as-${format}`).href = `/v1/jobs/${jobId}/labels/export/${format === "wibam" ? "wibam-dataset" : format}${query({ set })}`;
}
