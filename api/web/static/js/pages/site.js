// One site: cameras, uploads, what the cameras see, starting a job.
import { get, getAll, Problem, query, send } from "../api.js";
import { ask, attempt, byId, fill, h, message, say, sentence } from "../dom.js";
import { resized } from "../footage.js";
import { duration, percent, size, when } from "../format.js";
import { layMap } from "../maplayer.js";
import { cameraColour, drawView, groundInView, Plan } from "../plan.js";
import { Camera } from "../projection.js";
import { recordingName } from "../chapters.js";
import { changeSite, editSite } from "../sitedocument.js";
import { UploadQueue } from "../tus.js";

const siteId = document.body.dataset.site ?? "";
let record = /** @type {any} */ (null);
let files = /** @type {any[]} */ ([]);
/** @type {Map<string, {camera: Camera|null, problem: any, cautions: any[]}>} */
const solved = new Map();
const plan = new Plan(byId("plan"), (view, context) => {
  record?.site.cameras.forEach((/** @type {any} */ one, /** @type {number} */ index) => {
    const camera = solved.get(one.id)?.camera;
    if (camera) drawView(view, context, camera, cameraColour(index));
  });
});

/** @param {string} cameraId */
const recordingsOf = (cameraId) => files.filter((file) => file.purpose === "recording" && file.camera === cameraId).sort((a, b) => a.filename.localeCompare(b.filename));

/** The change under way: the next begins where it ended, so that none is lost. */
let changing = Promise.resolve();

/** @param {(site: any) => any} change from the site's document to another */
function change(change) {
  const mine = changing.catch(() => {}).then(async () => {
    await changeSite(siteId, change);
    await show();
  });
  changing = mine;
  return mine;
}

/** @param {any} camera */
function card(camera) {
  const all = recordingsOf(camera.id), file = all[0], state = solved.get(camera.id), given = camera.calibration;
  const points = given.correspondences?.length;
  const page = `/sites/${siteId}/cameras/${camera.id}`;
  const calibrated = given.kind !== "matrices" && points === 0 ? h("span.chip.caution", null, "not calibrated yet")
    : state?.problem ? h("span.chip.caution", null, "cannot be solved") : h("span.chip", null, given.kind === "matrices" ? "matrices" : `${points} points`);
  const facts = [
    file && `${all.length > 1 ? `one recording of ${all.length} chapters: ` : ""}${all.map((one) => one.filename).join(", ")}`, file && size(all.reduce((sum, one) => sum + one.size_bytes, 0)),
    file?.probe && duration(file.probe.duration_s), file?.probe?.codec, (file || points !== 0) && `${camera.width_px} × ${camera.height_px} px`, `${camera.signals.length} signal region${camera.signals.length === 1 ? "" : "s"}`,
  ];
  return h("li.card.camera", null,
    file ? h("img", { src: `/v1/sites/${siteId}/recordings/${file.id}/frame${query({ width_px: 480, time_s: 1 })}`, alt: `A frame of camera ${camera.id}`, loading: "lazy" }) : h("div.blank", null, "no recording yet"),
    h("div.row.spread", null, h("h3", null, camera.id), h("span.row", null, record.cameras[0] === camera.id ? h("span.chip", null, "reference") : null, calibrated)),
    h("p.note", null, facts.filter(Boolean).join(" · ")),
    state?.problem ? h("p.note", null, sentence(state.problem.message), " ", state.problem.hint) : null,
    state?.cautions.map((caution) => h("p.note", null, sentence(caution.message), " ", caution.hint)),
    h("div.row", null, h("a.button", { href: page }, "Calibrate and signals"),
      file ? h("button.small.quiet", { type: "button", onclick: () => attempt(() => removeFiles(all)) }, "Take the recording off") : null,
      record.site.cameras.length > 1 ? h("button.small.quiet", { type: "button", onclick: () => attempt(() => removeCamera(camera.id)) }, "Remove the camera") : null));
}

/** @param {any[]} all */
async function removeFiles(all) {
  if (!window.confirm(`Take ${all.map((file) => file.filename).join(", ")} off this site? Jobs that were made with it keep it.`)) return;
  for (const file of all) await send("DELETE", `/v1/sites/${siteId}/recordings/${file.id}`);
  await show();
}

/** @param {string} id */
async function removeCamera(id) {
  if (!window.confirm(`Remove camera ${id} with its calibration, signals and recording?`)) return;
  await change((/** @type {any} */ site) => ({ ...site, cameras: site.cameras.filter((/** @type {any} */ camera) => camera.id !== id) }));
}

async function solveAll() {
  await Promise.all(record.site.cameras.map(async (/** @type {any} */ camera) => {
    if (camera.calibration.kind !== "matrices" && !camera.calibration.correspondences.length) { solved.delete(camera.id); return; }
    const answer = await send("POST", "/v1/calibration/solve", camera);
    solved.set(camera.id, { camera: answer.camera && new Camera(answer.camera), problem: answer.problem, cautions: answer.cautions });
  }));
}

function showPlan() {
  const cameras = [...solved.values()].flatMap((state) => (state.camera ? [state.camera] : []));
  byId("plan").hidden = !cameras.length && !record.map;
  plan.fit(cameras.flatMap((camera) => [camera.centre, ...groundInView(camera)]));
  attempt(() => layMap(plan, `/v1/sites/${siteId}/map?version=${record.map?.version}`, record.map));
  const rest = record.site.cameras.filter((/** @type {any} */ camera) => !solved.get(camera.id)?.camera).map((/** @type {any} */ camera) => camera.id);
  const alone = cameras.length > 1 ? cameras.filter((one) => !cameras.some((other) => other !== one && overlaps(one, other))).map((camera) => camera.id) : [];
  fill(byId("overlap"),
    alone.length ? message("caution", `${alone.join(", ")}: no other camera sees what ${alone.length > 1 ? "these see" : "this one sees"} of the ground`, "At least two cameras must see the same ground; check that all calibrations use one world frame.") : null,
    rest.length ? h("p.note", null, `Not on the plan: ${rest.join(", ")}, until calibrated.`) : null,
    byId("plan").hidden ? null : h("p.note", null, "Views up to 60 m from each camera. Drag to move, wheel or + and − to enlarge."));
}

/** Whether a camera sees some of the ground that another sees. @param {Camera} one @param {Camera} other */
function overlaps(one, other) {
  const sees = (/** @type {Camera} */ a, /** @type {Camera} */ b) => {
    for (let i = 1; i < 16; i += 1) {
      for (let j = 1; j < 16; j += 1) {
        const ground = a.ground([(a.width * i) / 16, (a.height * j) / 16]);
        if (ground && Math.hypot(ground[0] - a.centre[0], ground[1] - a.centre[1]) < 100 && b.contains(b.project(ground))) return true;
      }
    }
    return false;
  };
  return sees(one, other) || sees(other, one);
}

async function show() {
  [record, files] = await Promise.all([get(`/v1/sites/${siteId}`), getAll(`/v1/sites/${siteId}/recordings`)]);
  byId("site-id").textContent = siteId;
  byId("name").textContent = record.name;
  document.title = `${record.name} · WIBAM`;
  await solveAll();
  fill(byId("cameras"), record.site.cameras.map(card));
  showPlan();
  const jobs = await get(`/v1/jobs${query({ site: siteId, limit: 20 })}`);
  fill(byId("jobs"), jobs.length ? jobs.map((/** @type {any} */ job) => h("li", null, h("a", { href: `/jobs/${job.id}` }, job.name || job.id), " ", h(`span.state.${job.state}`, null, job.state), " ", h("span.note", null, when(job.created_at)))) : h("li.note", null, "None yet."));
}

const shown = attempt(show);

// --- uploads -----------------------------------------------------------------------------------
const queue = new UploadQueue((upload) => {
  showQueue();
  if (upload.state === "done") attempt(() => arrived(upload));
});

/**
 * The camera that a file most likely is of: that of another chapter, the one whose id its name contains, else the first
 * without a recording.
 * @param {File} file
 */
function guess(file) {
  const chapter = recordingName(file.name), sibling = chapter && queue.uploads.find((upload) => recordingName(upload.file.name) === chapter);
  if (sibling) return sibling.target.camera ?? "";
  const cameras = /** @type {string[]} */ (record.cameras), name = file.name.toLowerCase();
  const named = [...cameras].sort((a, b) => b.length - a.length).find((id) => name.includes(id.toLowerCase()));
  const taken = new Set(queue.uploads.map((upload) => upload.target.camera));
  return named ?? cameras.find((id) => !recordingsOf(id).length && !taken.has(id)) ?? cameras[0];
}

/** @param {File[]} chosen */
async function add(chosen) {
  await shown; // which camera a file is of is guessed from the site
  for (const file of chosen) {
    const labels = /^labels\.(json|parquet)$/i.test(file.name);
    if (labels) { queue.add(file, { site: siteId, purpose: "labels" }); continue; }
    const camera = guess(file);
    await list(camera, file.name);
    queue.add(file, { site: siteId, purpose: "recording", camera });
  }
}

/** Where a second file is sent to a camera, its recording is of several files, which the site's document lists. @param {string} id @param {string} name */
async function list(id, name) {
  const camera = record.site.cameras.find((/** @type {any} */ one) => one.id === id);
  const sent = queue.uploads.filter((upload) => upload.target.camera === id).map((upload) => upload.file.name);
  const names = [...new Set([...(camera?.recordings ?? []), ...sent, name])];
  if (names.length < 2 || names.length === camera?.recordings.length) return;
  await change((site) => ({ ...site, cameras: site.cameras.map((/** @type {any} */ one) => (one.id === id ? { ...one, recordings: names } : one)) }));
}

/** A recording says how large its pictures are: until points are set, the camera's description follows it. @param {import("../tus.js").Upload} upload */
async function arrived(upload) {
  say(`${upload.file.name} has arrived.`);
  files = await getAll(`/v1/sites/${siteId}/recordings`);
  const camera = record.site.cameras.find((/** @type {any} */ one) => one.id === upload.target.camera), file = camera && recordingsOf(camera.id)[0];
  if (file) {
    const header = await get(`/v1/sites/${siteId}/recordings/${file.id}/header`);
    if (resized(record.site, camera.id, header)) { await change((site) => resized(site, camera.id, header)); return; }
  }
  await show();
}

function showQueue() {
  fill(byId("queue"), queue.uploads.map((upload) => {
    const select = h("select", { "aria-label": `Camera of ${upload.file.name}`, disabled: upload.state !== "waiting" && upload.state !== "paused" },
      record.cameras.map((/** @type {string} */ id) => h("option", { selected: id === upload.target.camera }, id)));
    select.addEventListener("change", () => attempt(async () => {
      const camera = /** @type {HTMLSelectElement} */ (select).value;
      queue.remove(upload);
      await list(camera, upload.file.name);
      queue.add(upload.file, { ...upload.target, camera });
    }));
    const share = upload.file.size ? upload.offset / upload.file.size : 0;
    const button = upload.state === "sending" || upload.state === "waiting" ? h("button.small", { type: "button", onclick: () => upload.pause() }, "Pause")
      : upload.state === "done" ? null : h("button.small", { type: "button", onclick: () => queue.resume(upload) }, upload.state === "failed" ? "Try again" : "Go on");
    return h("li", null, h("span", null, upload.file.name, h("span.note", null, ` ${size(upload.file.size)}`)), upload.target.purpose === "recording" ? select : h("span.note", null, "hand labels"),
      h("progress", { value: share, max: 1, "aria-label": `${upload.file.name}: sent` }), h("span.note", null, `${percent(share)} · ${upload.state}`, upload.error ? `: ${upload.error.message}. ${upload.error.hint ?? ""}` : ""), button ?? h("span", null));
  }));
}

// --- starting a job ----------------------------------------------------------------------------
function options() {
  let found;
  try { found = JSON.parse(byId("options").value || "{}"); } catch (error) { throw new Problem(`the options are not JSON: ${/** @type {Error} */ (error).message}`, { hint: 'For example {"finetune": {"steps": 200}}.' }); }
  const set = (/** @type {string} */ stage, /** @type {string} */ name, /** @type {string} */ value) => { if (value) found[stage] = { ...found[stage], [name]: Number(value) }; };
  set("finetune", "steps", byId("steps").value);
  set("track", "rate_hz", byId("rate").value);
  return found;
}

async function showPlanned() {
  const planned = await send("POST", `/v1/sites/${siteId}/plan`, { options: options() });
  fill(byId("planned"), h("ol", null, planned.map((/** @type {any} */ stage) => h("li", null, stage.title, stage.would === "reuse" ? h("span.note", null, " (made before)") : ""))));
}

/** @param {string} id @param {string} kind @param {(event: any) => any} work */
const on = (id, kind, work) => byId(id).addEventListener(kind, (/** @type {any} */ event) => { if (kind === "submit") event.preventDefault(); attempt(async () => work(event)); });
const drop = byId("drop");
drop.addEventListener("dragover", (/** @type {DragEvent} */ event) => { event.preventDefault(); drop.classList.add("over"); });
drop.addEventListener("dragleave", () => drop.classList.remove("over"));
drop.addEventListener("drop", (/** @type {DragEvent} */ event) => { event.preventDefault(); drop.classList.remove("over"); if (event.dataTransfer) attempt(() => add([...event.dataTransfer.files])); });
on("files", "change", async () => {
  const chosen = [...byId("files").files];
  byId("files").value = "";
  await add(chosen);
});
on("add", "submit", async () => {
  const id = byId("add-id").value.trim();
  await change((/** @type {any} */ site) => ({ ...site, cameras: [...site.cameras, { id, width_px: 1920, height_px: 1080, calibration: { kind: "homography", correspondences: [] } }] }));
  byId("add-id").value = "";
});
on("edit", "click", async () => {
  if (await editSite(siteId)) await show();
});
on("rename", "click", async () => {
  byId("new-name").value = record.name;
  if (await ask(byId("rename-dialog")) === "yes") await change((/** @type {any} */ site) => ({ ...site, name: byId("new-name").value.trim() }));
});
on("delete", "click", async () => {
  if (!window.confirm("Delete this site with its recordings? A site that still has jobs is kept.")) return;
  await send("DELETE", `/v1/sites/${siteId}`);
  location.assign("/sites");
});
on("plan-button", "click", showPlanned);
on("start", "submit", async () => {
  const job = await send("POST", `/v1/sites/${siteId}/jobs`, { name: byId("job-name").value.trim(), options: options() });
  location.assign(`/jobs/${job.id}`);
});
window.addEventListener("beforeunload", (event) => { if (queue.uploads.some((upload) => upload.state === "sending")) event.preventDefault(); });
