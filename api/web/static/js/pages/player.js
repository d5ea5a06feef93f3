// The player: the plan and all cameras' frames in step, with what happened drawn in.
import { query } from "../api.js";
import { attempt, byId, fill, h, message, say } from "../dom.js";
import { clock, number, percent, words } from "../format.js";
import { ClipPanel } from "../clippanel.js";
import { FrameCache } from "../frames.js";
import { jobId, openJob } from "../jobtabs.js";
import { layMap } from "../maplayer.js";
import { groundInView, Plan } from "../plan.js";
import { colourOf, drawFrame, drawRoad } from "../playerdraw.js";
import { Camera, footprint } from "../projection.js";
import { historyOf } from "../trackhistory.js";
import { boxOf, inside, parameters, passes, Tracks } from "../trackdata.js";

const FRAME_PX = 480, AHEAD = 12, NEAR_NS = 120_000_000, KEPT_MEASURES = 600;
/** @type {import("../trackdata.js").Filter} */
const filter = { classes: [], minSpeed: null, startNs: null, endNs: null, polygon: [] };
let tracks = new Tracks([]), cameras = /** @type {Camera[]} */ ([]), conflicts = /** @type {any[]} */ ([]), classes = /** @type {Map<string, string>} */ (new Map());
let instants = /** @type {number[]} */ ([]), frameTimes = /** @type {Object<string, Array<number|null>>} */ ({});
let index = 0, playing = false, drawing = false, lastTick = 0, owed = 0, chosen = /** @type {Set<number>} */ (new Set()), conflict = /** @type {any} */ (null);
const canvases = /** @type {Map<string, HTMLCanvasElement>} */ (new Map());
const cache = new FrameCache(jobId, FRAME_PX, () => redraw());
const plan = new Plan(byId("plan"), (view, context) => drawRoad(view, context, shown()));
let states = /** @type {import("../trackdata.js").State[]} */ ([]), pending = false;

/** @returns {import("../playerdraw.js").Shown} */
function shown() {
  return {
    states, tracks, timeNs: tracks.times[index] ?? 0, trailNs: Number(byId("trail").value) * 1e9, chosen, polygon: filter.polygon, conflict, cameras,
    colour: (state) => colourOf(state, byId("colour").value, classes),
  };
}

/** The stored instant nearest to a time, of which a camera has a frame. @param {string} camera @param {number} timeNs @returns {number|null} */
function frameAt(camera, timeNs) {
  const times = frameTimes[camera];
  if (!times) return null;
  let low = 0, high = instants.length;
  while (low < high) { const middle = (low + high) >> 1; if (instants[middle] < timeNs) low = middle + 1; else high = middle; }
  let best = /** @type {number|null} */ (null);
  for (const at of [low - 1, low]) {
    if (at < 0 || at >= instants.length || times[at] === null) continue;
    if (Math.abs(instants[at] - timeNs) <= NEAR_NS && (best === null || Math.abs(instants[at] - timeNs) < Math.abs(best - timeNs))) best = instants[at];
  }
  return best;
}

/** When a camera exposed its frame of an instant. @param {string} camera @param {number} instant @returns {number} */
function exposedAt(camera, instant) {
  let low = 0, high = instants.length;
  while (low < high) { const middle = (low + high) >> 1; if (instants[middle] < instant) low = middle + 1; else high = middle; }
  return frameTimes[camera]?.[low] ?? instant;
}

/** What is shown now, where it was when a camera exposed the frame beside it. @param {string} camera @param {number|null} instant of that frame @returns {import("../trackdata.js").State[]} */
function statesIn(camera, instant) {
  return instant === null ? states : states.map((state) => tracks.moved(state, exposedAt(camera, instant)));
}

/** Ask for what is shown and what comes next. */
function fetchAhead() {
  /** @type {Array<[string, number]>} */
  const wanted = [];
  for (let step = 0; step <= (playing ? AHEAD : 2); step += 1) {
    const time = tracks.times[index + step];
    if (time === undefined) break;
    for (const camera of cameras) {
      const at = frameAt(camera.id, time);
      if (at !== null) wanted.push([camera.id, at]);
    }
  }
  cache.want(wanted);
}

function redraw() {
  if (pending) return;
  pending = true;
  requestAnimationFrame(() => {
    pending = false;
    drawNow();
  });
}

function drawNow() {
  const start = performance.now(), time = tracks.times[index] ?? 0;
  states = (tracks.at[index] ?? []).filter((state) => passes(state, filter));
  plan.drawNow();
  const now = shown();
  for (const camera of cameras) {
    const at = frameAt(camera.id, time), canvas = canvases.get(camera.id);
    if (canvas) drawFrame(canvas, camera, at === null ? null : cache.get(camera.id, at), { ...now, states: statesIn(camera.id, at) }, byId("boxes").checked);
  }
  performance.measure("draw", { start, end: performance.now() });
  if (performance.getEntriesByName("draw").length > KEPT_MEASURES) performance.clearMeasures("draw");
}

/** Go to an instant. @param {number} to */
function show(to) {
  index = Math.min(Math.max(to, 0), Math.max(tracks.times.length - 1, 0));
  const seconds = (tracks.times[index] ?? 0) / 1e9;
  byId("time").value = index;
  byId("time").setAttribute("aria-valuetext", clock(seconds));
  byId("clock").textContent = clock(seconds);
  fetchAhead();
  redraw();
  if (!playing) showPresent();
}

/** @param {number} now ms */
function tick(now) {
  if (!playing) return;
  owed += ((now - lastTick) / 1000) * Number(byId("speed").value) * 1e9;
  lastTick = now;
  let to = index;
  while (to + 1 < tracks.times.length && tracks.times[to + 1] - tracks.times[to] <= owed) { owed -= tracks.times[to + 1] - tracks.times[to]; to += 1; }
  if (to !== index) show(to);
  if (to + 1 >= tracks.times.length) { play(false); return; }
  requestAnimationFrame(tick);
}

/** @param {boolean} on */
function play(on) {
  playing = on && tracks.times.length > 1;
  byId("play").textContent = playing ? "Pause" : "Play";
  byId("play").setAttribute("aria-pressed", String(playing));
  if (playing) {
    if (index + 1 >= tracks.times.length) index = 0;
    owed = 0;
    requestAnimationFrame((now) => { lastTick = now; tick(now); });
  } else showPresent();
}

function showPresent() {
  const here = (tracks.at[index] ?? []).filter((state) => passes(state, filter));
  fill(byId("present"), h("option", { value: "" }, `${here.length} road users`), here.map((state) => h("option", { value: state.track_id, selected: chosen.has(state.track_id) }, `${state.track_id}: ${state.class}, ${number(state.speed_mps, 1)} m/s`)));
}

/** @param {number|null} trackId */
function choose(trackId) {
  chosen = trackId === null ? new Set() : new Set([trackId]);
  if (trackId === null) { fill(byId("chosen"), h("p.note", null, "Nothing. Click a vehicle in the plan or in a view, or choose one here:")); redraw(); return; }
  const track = tracks.byTrack.get(trackId) ?? [];
  fill(byId("chosen"), h("p", null, h("strong", null, `Track ${trackId}, ${track[0]?.class}`), ` · ${clock(track[0].time_ns / 1e9)} to ${clock(track[track.length - 1].time_ns / 1e9)} · fastest ${number(Math.max(...track.map((state) => state.speed_mps)), 1)} m/s `,
    h("a", { href: `/v1/jobs/${jobId}/tracks${query({ format: "csv", track_id: trackId })}`, download: true }, "CSV")),
  h("div.scroll.history", { tabindex: 0, role: "region", "aria-label": `History of track ${trackId}` }, historyOf(track)));
  say(`Track ${trackId}, ${track[0]?.class}, is chosen.`);
  redraw();
}

/** @param {any} found */
function openConflict(found) {
  conflict = found;
  const [a, b] = found.track_ids;
  chosen = new Set([a, b]);
  plan.fit([[found.x_m - 22, found.y_m - 16], [found.x_m + 22, found.y_m + 16]]);
  show(tracks.indexAt(found.time_ns));
  fill(byId("chosen"), h("p", null, h("strong", null, `Conflict ${found.conflict_id}: ${words(found.type)}`), ` at ${clock(found.time_ns / 1e9)}`),
    h("p", null, `${found.classes[0]} ${a} at ${number(found.speeds_mps[0], 1)} m/s and ${found.classes[1]} ${b} at ${number(found.speeds_mps[1], 1)} m/s. TTC ${number(found.ttc_s)} s, PET ${number(found.pet_s)} s, probability ${percent(found.probability)}.`));
}

/** @param {number} by */
function stepConflict(by) {
  const now = tracks.times[index], sorted = [...conflicts].sort((a, b) => a.time_ns - b.time_ns);
  const next = by > 0 ? sorted.find((one) => one.time_ns > now + 1e6) : sorted.findLast((one) => one.time_ns < now - 1e6 && tracks.indexAt(one.time_ns) < index);
  if (next) openConflict(next);
}

function showQuery() {
  const address = `/v1/jobs/${jobId}/tracks${query(parameters(filter))}`, more = query(parameters(filter)) ? "&" : "?";
  byId("query-url").textContent = byId("query-url").href = address;
  byId("query-curl").textContent = `curl -H "Authorization: Bearer $WIBAM_TOKEN" \\\n  '${location.origin}${address}'`;
  byId("as-csv").href = `${address}${more}format=csv`;
  byId("as-parquet").href = `${address}${more}format=parquet`;
}

function filtered() {
  filter.classes = [...byId("classes").querySelectorAll("input:checked")].map((input) => /** @type {HTMLInputElement} */ (input).value);
  if (filter.classes.length === byId("classes").querySelectorAll("input").length) filter.classes = [];
  const value = (/** @type {string} */ id, /** @type {number} */ factor) => (byId(id).value === "" ? null : Math.round(Number(byId(id).value) * factor));
  filter.minSpeed = byId("min-speed").value === "" ? null : Number(byId("min-speed").value);
  filter.startNs = value("from", 1e9);
  filter.endNs = value("to", 1e9);
  showQuery();
  show(index);
}

/** @param {number[]} world */
function clickPlan(world) {
  if (byId("draw").getAttribute("aria-pressed") === "true") { filter.polygon = [...filter.polygon, world]; filtered(); return; }
  const hit = states.find((state) => inside(footprint(boxOf(state)), world[0], world[1])) ?? states.find((state) => Math.hypot(state.x_m - world[0], state.y_m - world[1]) < 10 / plan.pxPerM);
  choose(hit?.track_id ?? null);
}

/** @param {Camera} camera @param {MouseEvent} event */
function clickView(camera, event) {
  const canvas = /** @type {HTMLCanvasElement} */ (event.currentTarget), box = canvas.getBoundingClientRect();
  const u = ((event.clientX - box.left) / box.width) * camera.width, v = ((event.clientY - box.top) / box.height) * camera.height;
  const hits = statesIn(camera.id, frameAt(camera.id, tracks.times[index] ?? 0)).map((state) => ({ state, around: camera.boxAround(boxOf(state)) })).filter(({ around }) => around && u >= around[0] && u <= around[2] && v >= around[1] && v <= around[3]);
  hits.sort((a, b) => Math.hypot(a.state.x_m - camera.centre[0], a.state.y_m - camera.centre[1]) - Math.hypot(b.state.x_m - camera.centre[0], b.state.y_m - camera.centre[1]));
  choose(hits[0]?.state.track_id ?? null);
}

/** @param {KeyboardEvent} event */
function keys(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT|TEXTAREA|BUTTON|A|SUMMARY)$/.test(/** @type {Element} */ (event.target).tagName)) return;
  const work = /** @type {Object<string, () => void>} */ ({ " ": () => play(!playing), ",": () => show(index - 1), ".": () => show(index + 1), "[": () => stepConflict(-1), "]": () => stepConflict(1), Escape: () => { conflict = null; choose(null); } })[event.key];
  if (!work) return;
  event.preventDefault();
  work();
}

function listen() {
  byId("play").addEventListener("click", () => play(!playing));
  byId("back").addEventListener("click", () => show(index - 1));
  byId("forward").addEventListener("click", () => show(index + 1));
  byId("time").addEventListener("input", () => show(Number(byId("time").value)));
  for (const id of ["colour", "trail", "boxes"]) byId(id).addEventListener("input", redraw);
  byId("present").addEventListener("change", () => choose(byId("present").value === "" ? null : Number(byId("present").value)));
  byId("filter").addEventListener("submit", (/** @type {Event} */ event) => event.preventDefault());
  byId("filter").addEventListener("input", filtered);
  byId("draw").addEventListener("click", () => {
    const on = byId("draw").getAttribute("aria-pressed") !== "true";
    byId("draw").setAttribute("aria-pressed", String(on));
    byId("draw").textContent = on ? "Done: the corners are drawn" : "Draw an area";
    if (on) { filter.polygon = []; filtered(); say("Click corners in the plan."); }
  });
  byId("clear").addEventListener("click", () => {
    byId("filter").reset();
    filter.polygon = [];
    filtered();
  });
  plan.onclick = clickPlan;
  document.addEventListener("keydown", keys);
}

function showMarks() {
  const last = Math.max(tracks.times.length - 1, 1);
  fill(byId("marks"), conflicts.map((one) => {
    const mark = h(`span${one.ttc_s === null ? ".pet" : ""}`, { title: `${words(one.type)} at ${clock(one.time_ns / 1e9)}` });
    mark.style.left = `${(100 * tracks.indexAt(one.time_ns)) / last}%`;
    return mark;
  }));
}

async function start() {
  const [, made] = await openJob(), scene = made.has("tracks") ? await made.scene() : null;
  if (!scene) { fill(byId("nothing"), message("plain", "there are no tracks yet", "They can be played once the stage “Track” has finished.")); return; }
  cameras = scene.cameras.map((/** @type {any} */ camera) => new Camera(camera));
  classes = new Map(scene.classes.map((/** @type {any} */ one) => [one.name, one.colour]));
  fill(byId("nothing"), h("p.note", { role: "status" }, "Loading tracks …"));
  const [found, document_, stored] = await Promise.all([Tracks.load(jobId, (count) => { byId("nothing").textContent = `Loading tracks … ${count} states`; }), made.answer("conflicts", "/conflicts"), made.answer("frames", "/instants")]);
  tracks = found;
  conflicts = document_?.conflicts ?? [];
  instants = stored?.times_ns ?? [];
  frameTimes = stored?.frame_times_ns ?? {};
  fill(byId("nothing"), tracks.times.length ? null : message("plain", "nothing was tracked", "The recordings may show no road user that the network knows."));
  byId("player").hidden = false;
  fill(byId("views"), cameras.map((camera) => {
    const canvas = /** @type {HTMLCanvasElement} */ (h("canvas", { width: FRAME_PX, height: Math.round((FRAME_PX * camera.height) / camera.width), role: "img", "aria-label": `Frame of camera ${camera.id} with boxes` }));
    canvas.addEventListener("click", (event) => clickView(camera, event));
    canvases.set(camera.id, canvas);
    return h("figure", null, canvas, h("figcaption", null, camera.id));
  }));
  const present = new Set([...tracks.byTrack.values()].map((track) => track[0].class));
  fill(byId("classes"), scene.classes.filter((/** @type {any} */ one) => present.has(one.name)).map((/** @type {any} */ one) => {
    const swatch = h("span.swatch", null);
    swatch.style.background = one.colour;
    return h("label", null, h("input", { type: "checkbox", value: one.name, checked: true }), swatch, one.name);
  }));
  byId("time").max = Math.max(tracks.times.length - 1, 0);
  const places = [...tracks.byTrack.values()].flat().map((state) => [state.x_m, state.y_m]);
  plan.fit(places.length ? [...places, ...cameras.map((camera) => camera.centre)] : cameras.flatMap((camera) => groundInView(camera)), 0.03);
  attempt(() => layMap(plan, `/v1/jobs/${jobId}/map?version=${scene.map?.version}`, scene.map));
  showMarks();
  listen();
  showQuery();
  if (tracks.times.length) new ClipPanel(() => ({ filter, colour: byId("colour").value, trailS: Number(byId("trail").value), boxes: byId("boxes").checked, speed: Number(byId("speed").value) }), () => tracks.times[index], () => [tracks.times[0], tracks.times[tracks.times.length - 1] + 1e8]);
  const wanted = new URLSearchParams(location.search);
  const asked = conflicts.find((one) => String(one.conflict_id) === wanted.get("conflict"));
  if (asked) openConflict(asked);
  else show(wanted.has("time_ns") ? tracks.indexAt(Number(wanted.get("time_ns"))) : 0);
}

attempt(start);
