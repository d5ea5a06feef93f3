// Instant by instant: how boxes were associated, what was fitted to them, and what the network says before and after.
import { get, wholeNumber } from "../api.js";
import { attempt, byId, fill, h, isTaken, message, say } from "../dom.js";
import { clock, number } from "../format.js";
import { saveCanvases } from "../chart.js";
import { FrameCache } from "../frames.js";
import { drawInstantPlan, drawInstantView } from "../instantdraw.js";
import { jobId, openJob } from "../jobtabs.js";
import { layMap } from "../maplayer.js";
import { groundInView, Plan } from "../plan.js";
import { Camera } from "../projection.js";
import { table } from "../resulttables.js";

const FRAME_PX = 640, KEPT = 40;
const WORDS = /** @type {Object<string, string>} */ ({
  association: "Rays through the boxes of each camera, in its colour, and the vehicles that they meet in. Dashed: with no other.",
  fits: "Boxes fitted to all views of each vehicle; white: the 2D boxes that they were fitted to.",
  networks: "What the network says of one camera's frame, drawn into all views. Dashed: before fine-tuning. White: 2D boxes.",
});
let cameras = /** @type {Camera[]} */ ([]), times = /** @type {number[]} */ ([]), parts = /** @type {Map<number, string>} */ (new Map());
let index = 0, findings = /** @type {any} */ (null), chosen = /** @type {number|null} */ (null);
const canvases = /** @type {Map<string, HTMLCanvasElement>} */ (new Map()), known = /** @type {Map<number, any>} */ (new Map());
const cache = new FrameCache(jobId, FRAME_PX, () => draw());
const plan = new Plan(byId("plan"), (view, context) => { if (findings) drawInstantPlan(view, context, scene()); });

/** @returns {import("../instantdraw.js").Scene} */
function scene() {
  return { findings, cameras, show: byId("show").value, source: byId("source").value, before: byId("before").checked, after: byId("after").checked, least: Number(byId("score").value), chosen };
}

function draw() {
  if (!findings) return;
  plan.redraw();
  cameras.forEach((camera, place) => {
    const canvas = canvases.get(camera.id);
    if (canvas) drawInstantView(canvas, camera, place, cache.get(camera.id, findings.time_ns), scene());
  });
}

/** @param {number} timeNs */
async function load(timeNs) {
  if (!known.has(timeNs)) {
    known.set(timeNs, await get(`/v1/jobs/${jobId}/instants/${timeNs}`));
    while (known.size > KEPT) known.delete(/** @type {number} */ (known.keys().next().value));
  }
  return known.get(timeNs);
}

/** @param {number} to */
async function show(to) {
  index = Math.min(Math.max(to, 0), times.length - 1);
  const time = times[index];
  byId("time").value = index;
  byId("time").setAttribute("aria-valuetext", `${clock(time / 1e9)}, ${parts.get(time)} part`);
  byId("clock").textContent = clock(time / 1e9);
  byId("part").textContent = `${parts.get(time)} part`;
  cache.want(cameras.map((camera) => [camera.id, time]));
  const found = await load(time);
  if (times[index] !== time) return; // somebody has gone on meanwhile
  findings = found;
  chosen = null;
  showVehicles();
  draw();
}

function showVehicles() {
  fill(byId("vehicle"), h("option", { value: "" }, `all ${findings.vehicles.length}`), findings.vehicles.map((/** @type {any} */ one) => h("option", { value: one.id }, `${one.id}: ${one.class}, ${one.cameras.length} views`)));
  const mode = byId("show").value, networks = mode === "networks";
  byId("of-networks").hidden = !networks;
  byId("of-association").hidden = mode !== "association";
  byId("words").textContent = WORDS[mode];
  const counts = `${Object.values(findings.detections).flat().length} 2D boxes, ${findings.vehicles.length} vehicles, ${findings.fits.length} fits`;
  byId("counts").textContent = networks && parts.get(findings.time_ns) !== "test" ? `${counts}. The networks were asked in the test part alone.` : counts;
  const rows = mode === "association" ? findings.vehicles.map((/** @type {any} */ one) => [one.id, one.class, one.cameras.join(" "), one.x_m, one.y_m])
    : mode === "fits" ? findings.fits.map((/** @type {any} */ one) => [one.id, one.class, ...one.box])
      : ["baseline", "finetuned"].flatMap((name) => (findings[name][byId("source").value] ?? []).filter((/** @type {any} */ one) => one.score >= Number(byId("score").value)).map((/** @type {any} */ one) => [name, one.class, ...one.box, one.score]));
  const columns = mode === "association" ? ["vehicle", "class", "cameras", "x_m", "y_m"] : [mode === "fits" ? "track" : "network", "class", "x_m", "y_m", "z_m", "length_m", "width_m", "height_m", "yaw_rad", ...(networks ? ["score"] : [])];
  fill(byId("numbers"), table("Numbers of this instant", columns, rows, { cells: rows.map((/** @type {any[]} */ row) => row.map((value) => (typeof value === "number" && !Number.isInteger(value) ? number(value) : value))) }));
}

/** @param {number} by */
function step(by) { attempt(() => show(index + by)); }

/** To the vehicle after, or before, the chosen one. @param {number} by */
function stepVehicle(by) {
  const ids = [null, ...findings.vehicles.map((/** @type {any} */ one) => one.id)], at = (ids.indexOf(chosen) + by + ids.length) % ids.length;
  chosen = ids[at];
  byId("vehicle").value = chosen ?? "";
  say(chosen === null ? "All vehicles." : `Vehicle ${chosen}.`);
  draw();
}

/** @param {KeyboardEvent} event */
function keys(event) {
  if (isTaken(event)) return;
  const work = /** @type {Object<string, () => void>} */ ({ ",": () => step(-1), ".": () => step(1), "[": () => stepVehicle(-1), "]": () => stepVehicle(1) })[event.key];
  if (!work) return;
  event.preventDefault();
  work();
}

function listen() {
  byId("back").addEventListener("click", () => step(-1));
  byId("forward").addEventListener("click", () => step(1));
  byId("time").addEventListener("input", () => attempt(() => show(Number(byId("time").value))));
  byId("picture").addEventListener("click", () => saveCanvases(`instant-${clock(times[index] / 1e9).replace(":", "-")}-${byId("show").value}.png`, [byId("plan"), ...canvases.values()]));
  byId("test").addEventListener("click", () => attempt(() => show(times.findIndex((time) => parts.get(time) === "test"))));
  byId("vehicle").addEventListener("change", () => { chosen = byId("vehicle").value === "" ? null : Number(byId("vehicle").value); draw(); });
  for (const id of ["show", "source"]) byId(id).addEventListener("change", () => { chosen = null; showVehicles(); draw(); });
  byId("score").addEventListener("input", () => { showVehicles(); draw(); });
  for (const id of ["before", "after"]) byId(id).addEventListener("change", draw);
  document.addEventListener("keydown", keys);
}

attempt(async () => {
  const [, made] = await openJob(), [found, split] = await Promise.all([made.scene(), made.document("split")]);
  if (!found || !split) { fill(byId("nothing"), message("plain", "nothing was associated yet", "Instants can be looked at once the stage “Split in time” has finished.")); return; }
  cameras = found.cameras.map((/** @type {any} */ camera) => new Camera(camera));
  for (const [part, of] of Object.entries(split.times_ns)) for (const time of of) parts.set(time, part);
  times = [...parts.keys()].sort((a, b) => a - b);
  if (!times.length) { fill(byId("nothing"), message("plain", "there is no instant with road users")); return; }
  byId("instants").hidden = false;
  fill(byId("views"), cameras.map((camera) => {
    const canvas = /** @type {HTMLCanvasElement} */ (h("canvas", { width: FRAME_PX, height: Math.round((FRAME_PX * camera.height) / camera.width), role: "img", "aria-label": `Frame of camera ${camera.id} with boxes` }));
    canvases.set(camera.id, canvas);
    return h("figure", null, canvas, h("figcaption", null, camera.id));
  }));
  fill(byId("source"), cameras.map((camera) => h("option", null, camera.id)));
  byId("time").max = times.length - 1;
  byId("test").hidden = !split.times_ns.test?.length;
  plan.fit(cameras.flatMap((camera) => [camera.centre, ...groundInView(camera, 35)]), 0.03);
  attempt(() => layMap(plan, `/v1/jobs/${jobId}/map?version=${found.map?.version}`, found.map));
  listen();
  const wanted = wholeNumber("time_ns");
  await show(wanted !== null ? Math.max(times.findIndex((time) => time >= wanted), 0) : 0);
});
