// Labelling: all cameras' frames and the plan at one instant, with cuboids that are the same in all of them.
import { get, query, send, wholeNumber } from "../api.js";
import { attempt, byId, fill, h, message, say } from "../dom.js";
import { clock, duration } from "../format.js";
import { FrameCache } from "../frames.js";
import { FrameView } from "../frameview.js";
import { jobId, openJob, readOnly } from "../jobtabs.js";
import { layMap } from "../maplayer.js";
import { drawCuboids, drawVehicles, gripInPlan, gripInView } from "../labeldraw.js";
import { showAgreement } from "../labelagreement.js";
import { around, nearest, sharesSeen, showProgress } from "../labelinstants.js";
import { boxAfterKey, boxAfterWheel } from "../labelkeys.js";
import { grounded, heading, later, Model } from "../labelmodel.js";
import { settle } from "../labelmerge.js";
import { makePanel, mayChange, showVehicle } from "../labelpanel.js";
import { draggedInPlan, draggedInView } from "../labelpointer.js";
import { RegionTool } from "../labelregions.js";
import { LabelStore } from "../labelstore.js";
import { WorkTimer } from "../labeltimer.js";
import { cameraColour, drawCamera, groundInView, Plan } from "../plan.js";
import { Camera } from "../projection.js";

/** @typedef {import("../labelmodel.js").Vehicle} Vehicle */
/** @typedef {import("../labeldraw.js").Grip} Grip */
const FRAME_PX = 1280, SUGGESTED = 20, SNAP_M = 4, MOTION_S = 2.5, KEPT_MEASURES = 600, NEAR_NS = 1e6;
let cameras = /** @type {Camera[]} */ ([]), classes = /** @type {any[]} */ ([]), colours = /** @type {Map<string, string>} */ (new Map());
/** Camera -> when it exposed its frame of the instant that is open. */
let exposures = /** @type {Object<string, number|null>} */ ({});
let parts = /** @type {Object<string, number[]>} */ ({}), test = /** @type {number[]} */ ([]), listed = /** @type {number[]} */ ([]), labelled = /** @type {Map<number, any>} */ (new Map());
let timeNs = NaN, proposals = /** @type {Vehicle[]} */ ([]), seen = /** @type {Object<string, Object<number, number>>} */ ({});
let store = /** @type {LabelStore|null} */ (null), placing = false, from = /** @type {{timeNs: number, boxes: Map<number, number[]>}|null} */ (null);
const stores = /** @type {Map<string, LabelStore>} */ (new Map());
/** Drops what is loading of an instant once another is asked for, or the same one again. */
let loading = new AbortController(), drag = /** @type {{grip: Grip, vehicle: Vehicle, at: number[]}|null} */ (null);
const views = /** @type {Map<string, FrameView>} */ (new Map()), timer = new WorkTimer();
const model = new Model(changed), regions = new RegionTool(model, redraw, readOnly);
const cache = new FrameCache(jobId, FRAME_PX, showFrames);
const plan = new Plan(byId("plan"), (view, context) => {
  cameras.forEach((camera, index) => drawCamera(view, context, camera, cameraColour(index)));
  regions.drawInPlan(view, context);
  drawVehicles(view, context, model.vehicles, model.chosen, colours);
});
const setName = () => byId("set").value || "main";

/** How much later than the instant a camera exposed its frame. @param {string} camera */
function lateS(camera) {
  const at = exposures[camera];
  return at === null || at === undefined ? 0 : (at - timeNs) / 1e9;
}

function redraw() {
  plan.redraw();
  for (const view of views.values()) view.redraw();
  const vehicle = model.current, of = /** @type {Object<string, number>} */ ({});
  for (const camera of cameras) if (vehicle && seen[camera.id]?.[vehicle.id] !== undefined) of[camera.id] = seen[camera.id][vehicle.id];
  showVehicle(vehicle, cameras.map((camera) => camera.id), of, vehicle ? (timer.vehicles.get(vehicle.id) ?? 0) : 0);
  fill(byId("present"), model.vehicles.length ? null : h("option", { value: "" }, "none"), model.vehicles.map((one) => h("option", { value: one.id, selected: one.id === model.chosen }, `${one.id}: ${one.class}`)));
  regions.list();
  byId("undo").disabled = readOnly || !model.past.length;
  byId("redo").disabled = readOnly || !model.future.length;
  byId("finish").textContent = model.finished ? "Finished" : "Finish";
  byId("finish").setAttribute("aria-pressed", String(model.finished));
  byId("worked").textContent = `${model.vehicles.length} vehicles · ${duration(timer.seconds)} of work`;
}

/** Whatever was changed is saved. */
function changed() {
  if (!readOnly) store?.put(model.vehicles.map((vehicle) => ({ ...withMotion(vehicle), seconds: vehicle.seconds + (timer.vehicles.get(vehicle.id) ?? 0) })), model.regions, model.finished, timer.seconds);
  redraw();
}

/** A vehicle that was copied here moves as it was moved since. @param {Vehicle} vehicle @returns {Vehicle} */
function withMotion(vehicle) {
  const before = from?.boxes.get(vehicle.id);
  if (!from || !before) return vehicle;
  const seconds = (timeNs - from.timeNs) / 1e9;
  return { ...vehicle, velocity_mps: [(vehicle.box[0] - before[0]) / seconds, (vehicle.box[1] - before[1]) / seconds] };
}

function showFrames() {
  for (const camera of cameras) views.get(camera.id)?.show(cache.get(camera.id, timeNs) ?? null);
}

/** What saves an instant in the set that is chosen. One that was left unsaved goes on saving, and says nothing of the one that is shown. @param {number} time @returns {LabelStore} */
function storeOf(time) {
  const set = setName(), key = `${set} ${time}`, isShown = () => store === here;
  const here = stores.get(key) ?? new LabelStore(jobId, set, time, {
    author: () => byId("author").value.trim() || "somebody",
    saved: (answer) => { if (set === setName()) noteSaved(answer); if (isShown()) { seen = sharesSeen(answer); redraw(); } },
    said: (text, bad = false) => { if (isShown()) { byId("saved").textContent = text; byId("saved").classList.toggle("bad", bad); } },
    merge: async (found, author) => {
      const vehicles = await settle(found, author, clock(time / 1e9));
      if (isShown()) model.replace(vehicles, { regions: found.regions });
      return vehicles;
    },
  });
  stores.set(key, here);
  return here;
}

/** Leave the instant that is open, and drop what is still loading. @returns {Promise<void>|undefined} ends when what was left is saved, or cannot be */
function leave() {
  const left = store;
  loading.abort();
  [loading, store, drag] = [new AbortController(), null, null];
  model.close();
  redraw();
  return left?.flush();
}

/** Go to an instant. @param {number} time @param {Vehicle[]} [copied] vehicles that are to stand there, too */
async function open(time, copied = []) {
  const left = leave(), { signal } = loading, here = storeOf(time);
  [timeNs, proposals, exposures] = [time, [], {}]; // those of the instant before do not hold here
  byId("saved").textContent = `loading ${clock(time / 1e9)} …`;
  cache.want(neighbours(time).flatMap((at) => cameras.map((camera) => /** @type {[string, number]} */ ([camera.id, at]))));
  showFrames(); showList();
  const load = async () => {
    await left;
    const beside = Promise.all([get(`/v1/jobs/${jobId}/labels/instants/${time}/proposal`, { signal }), around(time, NEAR_NS, signal)]);
    return Promise.all([here.open(beside, signal), beside]);
  };
  const [{ answer, draft }, [proposed, stored]] = await load().catch((error) => {
    if (!signal.aborted) [byId("saved").textContent, byId("instant").value] = [`${clock(time / 1e9)} could not be loaded; open it again`, ""];
    throw error;
  });
  proposals = proposed;
  exposures = Object.fromEntries(Object.entries(stored.frame_times_ns).map(([camera, times]) => [camera, times[stored.times_ns.indexOf(time)]]));
  if (!copied.length) from = null;
  const labels = draft ?? answer.labels;
  seen = sharesSeen(answer);
  timer.start(labels.seconds);
  // what stands before a camera stands there at all instants: a new one begins with the regions of the one before
  model.load(labels.vehicles, labels.finished, answer.version || draft ? labels.regions : model.regions);
  byId("saved").textContent = answer.version ? `version ${answer.version} by ${answer.author}` : "not labelled yet";
  store = here;
  const added = copied.filter((vehicle) => !labels.vehicles.some((/** @type {Vehicle} */ one) => one.id === vehicle.id));
  if (added.length) { model.replace([...model.vehicles, ...added]); model.chosen ??= added[0].id; }
  if (draft) changed();
  redraw();
  say(`Instant ${clock(time / 1e9)}, ${model.vehicles.length} vehicles.`);
}

/** An instant, and those that one is likely to go to next. @param {number} time @returns {number[]} */
function neighbours(time) {
  const at = listed.indexOf(time), after = test.find((one) => one > time);
  return [...new Set([time, listed[at + 1], after, listed[at - 1]])].filter((one) => one !== undefined);
}

/** @param {any} answer */
function noteSaved(answer) {
  labelled.set(answer.labels.time_ns, { time_ns: answer.labels.time_ns, vehicles: answer.labels.vehicles.length, finished: answer.labels.finished, seconds: answer.labels.seconds });
  showList();
}

function showList() {
  const shown = [...new Set([...listed, ...labelled.keys(), timeNs])].sort((a, b) => a - b);
  listed = shown;
  const state = (/** @type {number} */ time) => { const one = labelled.get(time); return !one ? "○ suggested" : `${one.finished ? "● finished" : "◐ begun"}, ${one.vehicles}`; };
  fill(byId("instant"), shown.map((time) => h("option", { value: time, selected: time === timeNs }, `${clock(time / 1e9)} ${state(time)}`)));
  showProgress([...labelled.values()], setName());
}

/** Put the vehicles on to the next instant of the test part, where they have moved to. */
async function copyOn() {
  if (!mayChange(model)) return;
  const next = test.find((time) => time > timeNs);
  if (next === undefined) { byId("saved").textContent = "there is no later instant in the test part"; return; }
  const seconds = (next - timeNs) / 1e9, near = seconds <= MOTION_S;
  const copied = model.vehicles.map(withMotion).map((vehicle) => ({ ...vehicle, box: near ? later(vehicle, seconds) : vehicle.box, visibility: {}, seconds: 0 }));
  const kept = copied.filter((vehicle) => cameras.some((camera) => camera.boxAround(vehicle.box)));
  from = near ? { timeNs, boxes: new Map(model.vehicles.map((vehicle) => [vehicle.id, vehicle.box])) } : null;
  await open(next, kept);
}

function takeProposals() {
  const added = proposals.filter((one) => !model.vehicles.some((vehicle) => vehicle.id === one.id) && cameras.some((camera) => camera.boxAround(one.box)));
  if (!added.length) { byId("saved").textContent = "there is no proposal that is not here already"; return; }
  model.chosen ??= added[0].id;
  model.replace([...model.vehicles, ...added]);
  say(`${added.length} proposals taken.`);
}

function snapToFit() {
  const vehicle = model.current;
  if (!vehicle) return;
  const distance = (/** @type {Vehicle} */ one) => Math.hypot(one.box[0] - vehicle.box[0], one.box[1] - vehicle.box[1]);
  const nearest = [...proposals].filter((one) => distance(one) < SNAP_M).sort((a, b) => distance(a) - distance(b))[0];
  if (!nearest) { byId("saved").textContent = `no fit within ${SNAP_M} m`; return; }
  model.update({ box: nearest.box, velocity_mps: nearest.velocity_mps });
}

/** A new vehicle of the usual size. @param {number[]} ground @returns {boolean} whether it is there */
function place(ground) {
  if (!mayChange(model)) return false;
  const kind = classes.find((one) => one.name === byId("class").value) ?? classes[0], [length, width, height] = kind.size_m;
  model.add(kind.name, [ground[0], ground[1], height / 2, length, width, height, model.current?.box[6] ?? 0], proposals.map((one) => one.id));
  setPlacing(false);
  return true;
}

/** @param {boolean} on */
function setPlacing(on) {
  placing = on;
  byId("new").setAttribute("aria-pressed", String(on));
  byId("labelling").classList.toggle("placing", on);
}

/** Begin a drag, or not. @param {Grip|null} grip @param {number[]} at @param {number[]|null} ground @param {string|null} camera in whose picture; null in the plan @returns {boolean} */
function take(grip, at, ground, camera) {
  timer.act(model.chosen);
  if (!readOnly && regions.click(camera, at, ground)) return true;
  if (readOnly) { model.chosen = grip?.id ?? model.chosen; redraw(); return false; }
  if (placing && ground) {
    if (!place(ground)) return false;
    drag = { grip: { kind: "turn", id: model.chosen ?? 0 }, vehicle: /** @type {Vehicle} */ (model.current), at };
    return true;
  }
  if (!grip) return false;
  if (grip.id !== model.chosen) { model.chosen = grip.id; redraw(); }
  drag = { grip, vehicle: /** @type {Vehicle} */ (model.current), at };
  model.endStep();
  return true;
}

/** @param {number[]} box */
function dragTo(box) {
  const start = performance.now();
  timer.act(model.chosen);
  model.update({ box }, drag?.grip.id === model.chosen && model.step?.startsWith("add") ? model.step : "drag");
  plan.drawNow();
  for (const view of views.values()) view.drawNow();
  performance.measure("drag", { start, end: performance.now() });
  if (performance.getEntriesByName("drag").length > KEPT_MEASURES) performance.clearMeasures("drag");
}

function drop() {
  timer.act(model.chosen);
  drag = null;
  model.endStep();
}

function listenPlan() {
  plan.ondown = (world) => take(placing ? null : gripInPlan(plan, world, model.vehicles, model.current), world, world, null);
  plan.ondrag = (world) => { if (drag) dragTo(draggedInPlan(drag.vehicle.box, drag.grip, drag.at, world)); };
  plan.onup = drop;
}

/** @param {Camera} camera @param {FrameView} view */
function listenView(camera, view) {
  view.ondown = (pixel) => take(placing ? null : gripInView(view, camera, pixel, model.vehicles, model.current, lateS(camera.id)), pixel, camera.ground(pixel), camera.id);
  view.ondrag = (pixel) => {
    if (!drag) return;
    const ground = drag.grip.kind === "turn" ? camera.ground(pixel) : null, { box } = drag.vehicle;
    if (drag.grip.kind !== "turn") dragTo(draggedInView(camera, drag.vehicle, drag.grip, drag.at, pixel, lateS(camera.id)));
    else if (ground) dragTo(heading(box, Math.atan2(ground[1] - box[1], ground[0] - box[0])));
  };
  view.onup = drop;
}

/** @param {number} by */
function step(by) {
  const at = listed.indexOf(timeNs) + by;
  if (at >= 0 && at < listed.length) attempt(() => open(listed[at]));
}

/** @param {KeyboardEvent} event */
function keys(event) {
  const tag = /** @type {Element} */ (event.target).tagName, typing = /^(INPUT|SELECT|TEXTAREA)$/.test(tag), control = event.ctrlKey || event.metaKey;
  if (typing || document.querySelector("dialog[open]") || (event.key === "Enter" && /^(BUTTON|A|SUMMARY)$/.test(tag))) return;
  timer.act(model.chosen);
  const key = event.key.toLowerCase(), vehicle = model.current;
  const box = vehicle && !control && !readOnly ? boxAfterKey(vehicle.box, event) : null;
  const walk = /** @type {Object<string, () => void>} */ ({ ",": () => choose(-1), ".": () => choose(1), v: lookCloser, pageup: () => step(-1), pagedown: () => step(1) });
  const work = /** @type {Object<string, () => void>} */ ({
    n: () => setPlacing(!placing), i: () => place(plan.centre), escape: () => (regions.drawn ? regions.drop() : setPlacing(false)), b: () => regions.begin("do_not_care"), o: () => regions.begin("hidden"), delete: () => model.remove(), x: () => model.update({ ignored: !vehicle?.ignored }), f: snapToFit, p: takeProposals,
    g: () => vehicle && model.update({ box: grounded(vehicle.box) }), r: turnAround, c: () => attempt(copyOn), enter: () => (regions.drawn ? regions.end() : finish()),
  });
  const undoing = /** @type {Object<string, () => void>} */ ({ z: () => (event.shiftKey ? model.redo() : model.undo()), y: () => model.redo() });
  const act = box ? () => model.update({ box }, `keys ${key}`) : control ? (readOnly ? undefined : undoing[key]) : (walk[key] ?? (readOnly || event.altKey ? undefined : work[key]));
  if (!act) return;
  event.preventDefault();
  event.stopPropagation();
  act();
}

/** @param {number} by */
function choose(by) {
  model.cycle(by);
  model.endStep();
  redraw();
}

/** Enlarge all views around the chosen vehicle, or show them whole again. */
function lookCloser() {
  const vehicle = model.current, closer = byId("closer").getAttribute("aria-pressed") !== "true" && vehicle;
  byId("closer").setAttribute("aria-pressed", String(Boolean(closer)));
  for (const camera of cameras) {
    const around = closer ? camera.boxAround(later(vehicle, lateS(camera.id))) : null, margin = around ? 0.6 * Math.max(around[2] - around[0], around[3] - around[1]) : 0;
    views.get(camera.id)?.lookAt(around && [around[0] - margin, around[1] - margin, around[2] + margin, around[3] + margin]);
  }
}

function turnAround() {
  const vehicle = model.current;
  if (vehicle) model.update({ box: heading(vehicle.box, vehicle.box[6] + Math.PI) });
}

function finish() {
  model.replace(model.vehicles, { finished: !model.finished });
}

/** @param {WheelEvent} event */
function wheel(event) {
  if (!model.current || readOnly || !(event.shiftKey || event.altKey) || !(event.target instanceof HTMLCanvasElement)) return;
  event.preventDefault();
  event.stopPropagation();
  timer.act(model.chosen);
  const box = boxAfterWheel(model.current.box, event);
  if (box) model.update({ box }, "wheel");
}

async function evaluate() {
  await store?.flush();
  await send("POST", `/v1/jobs/${jobId}/labels/evaluate`, { set: setName() });
  location.assign(`/jobs/${jobId}`);
}

function listen() {
  const on = (/** @type {string} */ id, /** @type {() => any} */ work) => byId(id).addEventListener("click", () => { timer.act(model.chosen); attempt(async () => work()); });
  for (const [id, work] of /** @type {Array<[string, () => any]>} */ ([["before", () => step(-1)], ["after", () => step(1)], ["compare", () => showAgreement(setName(), byId("other").value)], ["closer", lookCloser]])) on(id, work);
  for (const [id, work] of /** @type {Array<[string, () => any]>} */ ([
    ["propose", takeProposals], ["new", () => setPlacing(!placing)], ["undo", () => model.undo()], ["redo", () => model.redo()], ["copy", copyOn], ["finish", finish], ["remove", () => model.remove()],
    ["snap", snapToFit], ["ground", () => model.current && model.update({ box: grounded(model.current.box) })], ["reverse", turnAround], ["evaluate", evaluate],
  ])) { on(id, work); byId(id).disabled = readOnly; }
  byId("instant").addEventListener("change", () => attempt(() => open(Number(byId("instant").value))));
  byId("present").addEventListener("change", () => { model.chosen = Number(byId("present").value); redraw(); });
  byId("author").addEventListener("change", () => localStorage.setItem("wibam-author", byId("author").value));
  byId("set").addEventListener("change", () => attempt(async () => {
    if (!byId("set").reportValidity()) return;
    localStorage.setItem("wibam-label-set", setName());
    model.regions = [];
    await leave(); await loadList(); await open(timeNs);
  }));
  byId("fields").addEventListener("submit", (/** @type {Event} */ event) => event.preventDefault());
  for (const input of byId("fields").elements) input.disabled = readOnly;
  document.addEventListener("keydown", keys, { capture: true });
  document.addEventListener("wheel", wheel, { capture: true, passive: false });
  document.addEventListener("visibilitychange", () => { if (document.hidden) store?.flush(); });
  listenPlan();
}

async function loadList() {
  const set = setName(), [summary, suggested] = await Promise.all([get(`/v1/jobs/${jobId}/labels${query({ set })}`), get(`/v1/jobs/${jobId}/labels/suggestions${query({ set, count: SUGGESTED })}`)]);
  if (set !== setName()) { await loadList(); return; } // another was chosen meanwhile
  const here = summary.instants.filter((/** @type {any} */ one) => one.in_job), elsewhere = summary.instants.length - here.length;
  labelled = new Map(here.map((/** @type {any} */ one) => [one.time_ns, one]));
  byId("elsewhere").textContent = elsewhere ? `${elsewhere} more labelled instant${elsewhere === 1 ? " is" : "s are"} of another job of this footage, with other instants than this one's. They are kept, and shown and changed on that job's page.` : "";
  listed = suggested.map((/** @type {any} */ one) => one.time_ns);
  test = [...new Set([...parts.test, ...labelled.keys()])].sort((a, b) => a - b);
  const asked = wholeNumber("time_ns");
  if (Number.isNaN(timeNs)) timeNs = asked === null ? (listed[0] ?? test[0] ?? Object.values(parts).flat()[0]) : await nearest(asked, Object.values(parts).flat());
  showList();
}

async function start() {
  const [, made] = await openJob();
  if (!["rig", "frames", "split", "fits"].every((name) => made.has(name))) { fill(byId("nothing"), message("plain", "there is nothing to label yet", "Instants can be labelled once the stage “Fit 7DoF boxes to all views” has finished.")); return; }
  fill(byId("nothing"), h("p.note", { role: "status" }, "Loading instants and labels …"));
  const [scene, split] = await Promise.all([made.scene(), made.document("split")]);
  parts = split.times_ns;
  if (!Object.values(parts).flat().length) { fill(byId("nothing"), message("plain", "there is no instant to label", "The job has found no time at which cameras recorded together; Preflight says when each did.")); return; }
  cameras = scene.cameras.map((/** @type {any} */ camera) => new Camera(camera));
  classes = scene.classes;
  colours = new Map(classes.map((one) => [one.name, one.colour]));
  byId("author").value = localStorage.getItem("wibam-author") ?? "";
  byId("set").value = localStorage.getItem("wibam-label-set") ?? "main";
  byId("labelling").hidden = false;
  fill(byId("views"), cameras.map((camera) => {
    const canvas = /** @type {HTMLCanvasElement} */ (h("canvas", { "aria-label": `Frame of camera ${camera.id} with labelled vehicles` }));
    const view = new FrameView(canvas, camera.width, camera.height, (shown, context) => {
      regions.drawInView(shown, context, camera);
      drawCuboids(shown, context, camera, model.vehicles, model.chosen, colours, lateS(camera.id));
    });
    views.set(camera.id, view);
    listenView(camera, view);
    return h("figure", null, canvas, h("figcaption", null, camera.id));
  }));
  regions.offer(cameras.map((camera) => camera.id));
  makePanel({ classes: classes.map((one) => one.name), cameras: cameras.map((camera) => camera.id), update: (change, of) => { timer.act(model.chosen); model.update(change, of); }, current: () => model.current });
  plan.fit(cameras.flatMap((camera) => groundInView(camera, 40)), 0.03);
  attempt(() => layMap(plan, `/v1/jobs/${jobId}/map?version=${scene.map?.version}`, scene.map));
  listen();
  await loadList();
  await open(timeNs);
}

attempt(start).finally(() => byId("nothing").querySelector("[role=status]")?.remove());
