// What came out of a job: figures from the stages' documents, with the numbers behind them.
import { get, query, Results } from "../api.js";
import { attempt, byId, fill, h, message } from "../dom.js";
import { size } from "../format.js";
import { jobId, openJob, readOnly } from "../jobtabs.js";
import { residualFigure, trajectoryFigure } from "../placefigures.js";
import { Camera } from "../projection.js";
import { beforeAfter, cameras, clocks, clockWitnesses, selfConsistency, table } from "../resulttables.js";
import { amountFigures, dataFigures, qualityFigures, syncFigures, trainingFigures } from "../resultfigures.js";

let made = new Results(jobId, []);

/** Show a section. @param {string} id @param {...any} content */
function show(id, ...content) {
  fill(byId(id).querySelector(".content"), content);
  byId(id).hidden = false;
}

const whenIdle = window.requestIdleCallback ?? ((/** @type {() => void} */ work) => setTimeout(work, 200));

/**
 * Fill a section once the browser has nothing else to do: it may grow with the recording, so all else is shown first, but a printed page needs it.
 * @param {string} id @param {() => Promise<any>} work
 */
function later(id, work) {
  show(id, h("p.note", { role: "status" }, "Loading …"));
  whenIdle(() => attempt(async () => {
    try {
      await work();
    } catch (error) {
      show(id, h("p.note", null, "This could not be loaded; reload the page to ask again."));
      throw error;
    }
  }));
}

/** @param {HTMLElement[]} found */
const figures = (found) => (found.length ? h("div.figure-grid", null, found) : null);

async function quality() {
  const metrics = await made.answer("metrics", "/metrics");
  if (!metrics) return false;
  show("quality",
    metrics.baseline ? beforeAfter(metrics) : message("plain", "there are no hand labels of this site", "Agreement with the other views says how good boxes are without them."),
    h("h3", null, "Without labels"), selfConsistency(metrics), figures(qualityFigures(metrics)));
  return true;
}

async function training() {
  const curves = await made.document("curves");
  if (curves) show("training", figures(trainingFigures(curves)));
  return !!curves;
}

function sync() {
  if (!made.has("changes")) return false;
  later("sync", showSync);
  return true;
}

async function showSync() {
  const changes = await made.document("changes");
  show("sync", changes.method === "none" ? h("p.note", null, "The recordings share a clock; nothing was searched.") : [clocks(changes), ...clockWitnesses(changes)], figures(syncFigures(changes)));
}

async function calibration() {
  const residuals = await made.document("residuals");
  if (!residuals) return false;
  const scene = await made.scene();
  const found = await Promise.all((scene?.cameras ?? []).filter((/** @type {any} */ one) => residuals.cameras[one.id]).map((/** @type {any} */ one) => residualFigure(jobId, new Camera(one), residuals.cameras[one.id], one.stored_width_px !== null)));
  show("calibration", cameras(residuals), figures(found.filter(Boolean)));
  return true;
}

function trajectories() {
  if (!made.has("tracks")) return false;
  later("tracks", async () => {
    const [scene, found] = await Promise.all([made.scene(), made.answer("tracks", "/tracks/paths")]);
    show("tracks", scene && found.paths.length ? figures([trajectoryFigure(scene, found)]) : h("p.note", null, "Nobody was tracked."));
  });
  return true;
}

async function data() {
  const statistics = await made.document("dataset-statistics");
  if (!statistics) return false;
  const parts = Object.entries(statistics.subsets);
  show("data", table("Parts in time", ["Part", "Instants", "Seconds", "Vehicles linked over time", "Sightings", "2D boxes"],
    parts.map(([name, part]) => [name, part.instants, part.seconds, part.tracks, part.vehicles, part.boxes])), figures(dataFigures(statistics)));
  return true;
}

/** Other jobs are not shared with whoever has a link to this one. @param {any} job */
async function amounts(job) {
  const found = readOnly || !made.has("metrics") ? [] : amountFigures(await get(`/v1/sites/${job.site_id}/amounts`), jobId);
  if (found.length) show("amounts", figures(found));
  return found.length > 0;
}

/** @param {any} file */
const isFrame = (file) => file.artifact === "frames";
/** @param {any[]} files */
const total = (files) => files.reduce((sum, file) => sum + file.size_bytes, 0);

function downloads() {
  const files = made.files, has = (/** @type {string} */ artifact) => made.has(artifact);
  const link = (/** @type {string} */ href, /** @type {string} */ text) => h("a.button", { href, download: true }, text);
  fill(byId("downloads"),
    has("report") ? h("button.primary", { type: "button", onclick: () => attempt(async () => { location.assign((await get(`/v1/jobs/${jobId}/report-link`)).url); }) }, "Report") : null,
    has("weights") ? link(`/v1/jobs/${jobId}/model`, "Network (safetensors)") : null,
    has("weights-onnx") ? link(`/v1/jobs/${jobId}/model?format=onnx`, "Network (ONNX)") : null,
    has("tracks") ? link(`/v1/jobs/${jobId}/tracks?format=csv`, "Tracks (CSV)") : null,
    has("tracks") ? link(`/v1/jobs/${jobId}/tracks?format=parquet`, "Tracks (Parquet)") : null,
    has("conflicts") ? link(`/v1/jobs/${jobId}/conflicts?format=csv`, "Conflicts (CSV)") : null,
    files.length ? link(`/v1/jobs/${jobId}/archive`, `All files (zip of ${size(total(files))})`) : null,
    files.some(isFrame) ? link(`/v1/jobs/${jobId}/archive${query({ artifact: [...new Set(files.filter((/** @type {any} */ one) => !isFrame(one)).map((/** @type {any} */ one) => one.artifact))] })}`, `All but frames (zip of ${size(total(files.filter((/** @type {any} */ one) => !isFrame(one))))})`) : null);
}

attempt(async () => {
  const [job, found] = await openJob();
  made = found;
  downloads();
  const there = await Promise.all([quality(), training(), calibration(), data(), amounts(job)]);
  there.push(sync(), trajectories());
  if (!there.includes(true)) fill(byId("nothing"), message("plain", "nothing has been made yet", "Figures appear here as stages finish."));
});
