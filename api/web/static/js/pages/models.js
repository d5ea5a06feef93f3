// All networks that the service keeps, and the latest runs of them.
import { get, getAll, send } from "../api.js";
import { attempt, byId, fill, h } from "../dom.js";
import { when } from "../format.js";

/** @param {any} about */
function learned(about) {
  return about.training ? `${about.training.frames} pictures of ${about.cameras.join(", ")}` : "unknown: it was sent";
}

/** @param {any} about */
function agreement(about) {
  const found = about.metrics?.self_consistency?.finetuned?.other_views;
  if (!found || found.mean === null) return "";
  return found.sd === null ? found.mean.toFixed(2) : `${found.mean.toFixed(2)} ± ${found.sd.toFixed(2)}`;
}

/** @param {any} model @param {string} state @param {string} text */
function change(model, state, text) {
  const button = h("button.quiet", { type: "button", "aria-label": `${text} ${model.name}, version ${model.version}` }, text);
  button.addEventListener("click", () => attempt(async () => {
    await send("PATCH", `/v1/models/${model.id}`, { state });
    await show();
  }));
  return button;
}

/** @param {any} model */
function row(model) {
  const file = `/v1/models/${model.id}/file?format=`;
  return h("tr", null,
    h("th", { scope: "row" }, model.job_id ? h("a", { href: `/jobs/${model.job_id}` }, model.name) : model.name),
    h("td", null, h("a", { href: `/sites/${model.site_id}` }, model.about.site_name ?? model.site_id)),
    h("td", null, String(model.version)),
    h("td", null, model.state),
    h("td", null, learned(model.about)),
    h("td", null, agreement(model.about)),
    h("td", null, when(model.created_at)),
    h("td", null, h("a", { href: `${file}safetensors`, download: "" }, "safetensors"), model.has_onnx ? " " : "", model.has_onnx ? h("a", { href: `${file}onnx`, download: "" }, "ONNX") : ""),
    h("td", null, model.state === "promoted" ? "" : change(model, "promoted", "Promote"), model.state === "retired" ? "" : change(model, "retired", "Retire")));
}

/** @param {any} run */
function runRow(run) {
  const cameras = [...new Set(run.files.map((/** @type {any} */ file) => file.camera).filter(Boolean))];
  return h("tr", null, h("th", { scope: "row" }, h("a", { href: `/jobs/${run.id}` }, run.name || run.id)), h("td", null, cameras.join(", ")), h("td", null, run.state), h("td", null, `${Math.floor(run.fraction * 100)} %`), h("td", null, when(run.created_at)));
}

async function show() {
  const [models, runs] = await Promise.all([getAll("/v1/models"), get("/v1/jobs?kind=run&limit=50")]);
  fill(byId("models").tBodies[0], models.length ? models.map(row) : h("tr", null, h("td", { colspan: 9 }, "There are none yet: every job that has ended leaves one.")));
  fill(byId("runs").tBodies[0], runs.length ? runs.map(runRow) : h("tr", null, h("td", { colspan: 5 }, "There are none yet: wibam models run MODEL CAMERA=FILE.")));
}
attempt(show);
