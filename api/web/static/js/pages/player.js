// The player: the plan and all cameras' frames in step, with what happened drawn in.
import { get, Problem, query, Results, wholeNumber } from "../api.js";
import { attempt, byId, complain, fill, h, isTaken, message, say } from "../dom.js";
import { clock, number, percent, words } from "../format.js";
import { ClipPanel } from "../clippanel.js";
import { FrameCache } from "../frames.js";
import { jobId, openJob } from "../jobtabs.js";
import { layMap } from "../maplayer.js";
import { Plan } from "../plan.js";
import { colourOf, drawFrame, drawRoad } from "../playerdraw.js";
import { Camera, footprint } from "../projection.js";
import { historyOf } from "../trackhistory.js";
import { boxOf, inside, parameters, passes } from "../trackdata.js";
import { TrackWindows } from "../trackwindows.js";

const FRAME_PX = 480, AHEAD = 12, KEPT_MEASURES = 600;
/** How far tracks are fetched ahead, beside what trails need; how many states a history has; how long a filter is typed, ms. */
const NEXT_NS = 1e9, AHEAD_NS = 4e9, HISTORY = 600, TYPED_MS = 300;
/** For how long the slider must rest before tracks are fetched, ms. */
const RESTS_MS = 100;
/** What the service takes as an area; when a job is looked at again that has no tracks, or did not answer, and when one that has, ms. */
const MOST_CORNERS = 100, AGAIN_MS = 5000, RARELY_MS = 60_000;
/** @type {import("../trackdata.js").Filter} */
const filter = { classes: [], minSpeed: null, startNs: null, endNs: null, polygon: [] };
/** All that was tracked, in short, and the stretch of it that is here. */
let whole = /** @type {any} */ ({ first_ns: 0, last_ns: 0, period_ns: null }), known = new TrackWindows(jobId, 0, 0, { version: "", frames: false, arrived: () => {}, failed: complain, changed: () => {} }), cameras = /** @type {Camera[]} */ ([]), conflicts = /** @type {any[]} */ ([]), classes = /** @type {Map<string, string>} */ (new Map());
let now = 0, drawn = 0, playing = false, lastTick = 0, chosen = /** @type {Set<number>} */ (new Set()), conflict = /** @type {any} */ (null);
const canvases = /** @type {Map<string, HTMLCanvasElement>} */ (new Map());
let cache = new FrameCache(jobId, FRAME_PX, redraw);
const plan = new Plan(byId("plan"), (view, context) => drawRoad(view, context, shown()));
let states = /** @type {import("../trackdata.js").State[]} */ ([]), pending = false, counting = new AbortController(), typed = 0, moving = 0;
/** Of the tracks that are shown, the SHA-256; of none, nothing. */
let version = "", looking = false, again = 0, clips = /** @type {ClipPanel|null} */ (null);

/** @returns {import("../playerdraw.js").Shown} */
function shown() {
  return {
    states, tracks: known.tracks, timeNs: moment(), trailNs: Number(byId("trail").value) * 1e9, chosen, polygon: filter.polygon, conflict, cameras,
    colour: (state) => colourOf(state, byId("colour").value, classes),
  };
}

/** The index of the instant that is shown; -1 where nobody was tracked then, or it is not here yet. One period away is another instant. */
function index() {
  return known.tracks.indexNear(now, 0.75 * period());
}

/** Between two instants, ns. @returns {number} */
function period() {
  return whole.period_ns ?? 1e9;
}

/** The time that is shown, ns: that of an instant, where there is one. */
function moment() {
  return known.tracks.times[index()] ?? now;
}

/** What is shown now, where it was when a camera exposed the frame beside it. @param {string} camera @param {number|null} instant of that frame @returns {import("../trackdata.js").State[]} */
function statesIn(camera, instant) {
  return instant === null ? states : states.map((state) => known.tracks.moved(state, known.exposedAt(camera, instant)));
}

/** Ask for what is shown and what comes next. */
function fetchAhead() {
  /** @type {Array<[string, number]>} */
  const wanted = [];
  for (let step = 0; step <= (playing ? AHEAD : 2); step += 1) {
    const time = moment() + step * period();
    for (const camera of cameras) {
      const at = known.frameAt(camera.id, time);
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
  const start = performance.now(), time = moment();
  states = present();
  plan.drawNow();
  const picture = shown();
  for (const camera of cameras) {
    const at = known.frameAt(camera.id, time), canvas = canvases.get(camera.id);
    const image = at !== null ? cache.get(camera.id, at) : known.has(time) ? null : undefined; // which frames there are may not be known yet
    if (canvas) drawFrame(canvas, camera, image, { ...picture, states: statesIn(camera.id, at) }, byId("boxes").checked);
  }
  performance.measure("draw", { start, end: performance.now() });
  if (performance.getEntriesByName("draw").length > KEPT_MEASURES) performance.clearMeasures("draw");
}

/** Who is shown. */
function present() {
  return (known.tracks.at[index()] ?? []).filter((state) => passes(state, filter, known.inside(state)));
}

/** Go to a time. @param {number} timeNs */
function show(timeNs) {
  now = Math.min(Math.max(timeNs, whole.first_ns), whole.last_ns);
  const before = Math.max(Number(byId("trail").value) * 1e9, NEXT_NS), after = playing ? AHEAD_NS * Math.max(1, Number(byId("speed").value)) : NEXT_NS;
  known.want(now, now - before, now + after, !moving);
  drawn = moment();
  const seconds = drawn / 1e9;
  byId("time").value = Math.round((drawn - whole.first_ns) / period());
  byId("time").setAttribute("aria-valuetext", clock(seconds));
  byId("clock").textContent = clock(seconds);
  byId("waiting").textContent = known.has(now) ? "" : known.refused(now) ? "The service refuses the tracks of this time; reload the page to ask again." : "Loading tracks …";
  fetchAhead();
  redraw();
  if (!playing) showPresent();
}

/** One instant forward or back; where nobody was tracked, as far as to the next instant elsewhere. @param {number} by 1 or -1 */
function step(by) {
  const at = index(), from = moment(), next = at < 0 ? undefined : known.tracks.times[at + by];
  show(next !== undefined && Math.abs(next - from) < 1.5 * period() ? next : from + by * period());
}

/** Where the slider is now. Its steps are even and instants may not be: one that ends at the same instant goes on to the next. */
function slide() {
  const before = drawn, to = whole.first_ns + Number(byId("time").value) * period();
  clearTimeout(moving);
  moving = window.setTimeout(() => { moving = 0; show(now); }, RESTS_MS);
  show(to);
  if (drawn === before && to !== before) step(Math.sign(to - before));
}

/** @param {number} at ms */
function tick(at) {
  if (!playing) return;
  const to = now + (known.has(now) ? ((at - lastTick) / 1000) * Number(byId("speed").value) * 1e9 : 0);
  lastTick = at;
  now = Math.min(to, whole.last_ns);
  if (index() < 0 ? now - drawn >= period() : moment() !== drawn) show(now);
  if (to >= whole.last_ns) { play(false); return; }
  requestAnimationFrame(tick);
}

/** @param {boolean} on */
function play(on) {
  playing = on && whole.last_ns > whole.first_ns;
  byId("play").textContent = playing ? "Pause" : "Play";
  byId("play").setAttribute("aria-pressed", String(playing));
  if (playing) {
    show(now >= whole.last_ns ? whole.first_ns : now);
    requestAnimationFrame((at) => { lastTick = at; tick(at); });
  } else show(now); // the frames of this instant come first again
}

function showPresent() {
  const here = present();
  fill(byId("present"), h("option", { value: "" }, `${here.length} road users`), here.map((state) => h("option", { value: state.track_id, selected: chosen.has(state.track_id) }, `${state.track_id}: ${state.class}, ${number(state.speed_mps, 1)} m/s`)));
}

/** @param {number|null} trackId */
async function choose(trackId) {
  chosen = trackId === null ? new Set() : new Set([trackId]);
  redraw();
  if (trackId === null) { fill(byId("chosen"), h("p.note", null, "Nothing. Click a vehicle in the plan or in a view, or choose one here:")); return; }
  fill(byId("chosen"), h("p.note", null, "Loading its history …"));
  const path = `/v1/jobs/${jobId}/tracks`, isChosen = () => chosen.has(trackId) && chosen.size === 1; // else another is meanwhile
  let of = /** @type {any} */ (null), history = /** @type {any[]} */ ([]);
  try {
    const at = moment();
    of = await get(`${path}/summary${query({ track_id: trackId })}`);
    const start = of.states > HISTORY ? Math.round(Math.max(of.first_ns, Math.min(at - (HISTORY / 2) * of.period_ns, of.last_ns - HISTORY * of.period_ns))) : null;
    history = (await get(`${path}${query({ track_id: trackId, start_ns: start, limit: HISTORY })}`)).states;
  } catch (error) {
    if (isChosen()) fill(byId("chosen"), h("p.note", null, `The history of track ${trackId} could not be loaded; choose it again.`));
    throw error;
  }
  if (!isChosen()) return;
  const name = `Track ${trackId}, ${of.classes[0].class}`;
  fill(byId("chosen"), h("p", null, h("strong", null, name), ` · ${clock(of.first_ns / 1e9)} to ${clock(of.last_ns / 1e9)} · fastest ${number(of.fastest_mps, 1)} m/s `,
    h("a", { href: `${path}${query({ format: "csv", track_id: trackId })}`, download: true }, "CSV")),
  of.states > history.length ? h("p.note", null, `${history.length} of ${of.states} states, around the time shown; the CSV has all.`) : null,
  h("div.scroll.history", { tabindex: 0, role: "region", "aria-label": `History of track ${trackId}` }, historyOf(history)));
  say(`${name} is chosen.`);
}

/** @param {any} found */
function openConflict(found) {
  conflict = found;
  const [a, b] = found.track_ids;
  chosen = new Set([a, b]);
  plan.fit([[found.x_m - 22, found.y_m - 16], [found.x_m + 22, found.y_m + 16]]);
  show(found.time_ns);
  fill(byId("chosen"), h("p", null, h("strong", null, `Conflict ${found.conflict_id}: ${words(found.type)}`), ` at ${clock(found.time_ns / 1e9)}`),
    h("p", null, `${found.classes[0]} ${a} at ${number(found.speeds_mps[0], 1)} m/s and ${found.classes[1]} ${b} at ${number(found.speeds_mps[1], 1)} m/s. TTC ${number(found.ttc_s)} s, PET ${number(found.pet_s)} s, probability ${percent(found.probability)}.`));
}

/** @param {number} by */
function stepConflict(by) {
  const at = moment(), off = 0.5 * period(), sorted = [...conflicts].sort((a, b) => a.time_ns - b.time_ns);
  const next = by > 0 ? sorted.find((one) => one.time_ns > at + off) : sorted.findLast((one) => one.time_ns < at - off);
  if (next) openConflict(next);
}

function showQuery() {
  const address = `/v1/jobs/${jobId}/tracks${query(parameters(filter))}`, more = query(parameters(filter)) ? "&" : "?";
  byId("query-url").textContent = byId("query-url").href = address;
  byId("query-curl").textContent = `curl -H "Authorization: Bearer $WIBAM_TOKEN" \\\n  '${location.origin}${address}'`;
  byId("as-csv").href = `${address}${more}format=csv`;
  byId("as-parquet").href = `${address}${more}format=parquet`;
  clearTimeout(typed);
  counting.abort();
  counting = new AbortController();
  typed = window.setTimeout(() => attempt(() => count(counting.signal)), TYPED_MS);
}

/** Say how much of the whole job passes the filter. @param {AbortSignal} signal */
async function count(signal) {
  const asked = query(parameters(filter)), found = asked ? await get(`/v1/jobs/${jobId}/tracks/summary${asked}`, { signal }) : whole;
  byId("matched").textContent = `${found.tracks} of ${whole.tracks} road users, ${found.states} of ${whole.states} states${found.states ? `, from ${clock(found.first_ns / 1e9)} to ${clock(found.last_ns / 1e9)}` : ""}.`;
}

/** Show what the form asks for, in an area; as long as a field is not valid, filter and area stay as they were. @param {number[][]} [polygon] @returns {boolean} whether it is */
function filtered(polygon = filter.polygon) {
  if ([...byId("filter").elements].some(({ validity: is }) => is?.badInput || is?.rangeOverflow || is?.rangeUnderflow)) { byId("filter").reportValidity(); return false; }
  filter.polygon = polygon;
  filter.classes = [...byId("classes").querySelectorAll("input:checked")].map((input) => /** @type {HTMLInputElement} */ (input).value);
  if (filter.classes.length === byId("classes").querySelectorAll("input").length) filter.classes = [];
  const value = (/** @type {string} */ id, /** @type {number} */ factor) => (byId(id).value === "" ? null : Math.round(Number(byId(id).value) * factor));
  const speed = value("min-speed", 100);
  filter.minSpeed = speed === null ? null : speed / 100;
  filter.startNs = value("from", 1e9);
  filter.endNs = value("to", 1e9);
  known.within(parameters(filter).polygon);
  showQuery();
  show(now);
  return true;
}

/** @param {number[]} world */
function clickPlan(world) {
  if (byId("draw").getAttribute("aria-pressed") === "true") {
    if (filter.polygon.length >= MOST_CORNERS) { complain(new Problem(`an area has at most ${MOST_CORNERS} corners`, { hint: "Press “Done”, or draw it anew with fewer." })); return; }
    filtered([...filter.polygon, world.map((value) => Number(value.toFixed(2)))]);
    return;
  }
  const hit = states.find((state) => inside(footprint(boxOf(state)), world[0], world[1])) ?? states.find((state) => Math.hypot(state.x_m - world[0], state.y_m - world[1]) < 10 / plan.pxPerM);
  attempt(() => choose(hit?.track_id ?? null));
}

/** @param {Camera} camera @param {MouseEvent} event */
function clickView(camera, event) {
  const canvas = /** @type {HTMLCanvasElement} */ (event.currentTarget), box = canvas.getBoundingClientRect();
  const u = ((event.clientX - box.left) / box.width) * camera.width, v = ((event.clientY - box.top) / box.height) * camera.height;
  const hits = statesIn(camera.id, known.frameAt(camera.id, moment())).map((state) => ({ state, around: camera.boxAround(boxOf(state)) })).filter(({ around }) => around && u >= around[0] && u <= around[2] && v >= around[1] && v <= around[3]);
  hits.sort((a, b) => Math.hypot(a.state.x_m - camera.centre[0], a.state.y_m - camera.centre[1]) - Math.hypot(b.state.x_m - camera.centre[0], b.state.y_m - camera.centre[1]));
  attempt(() => choose(hits[0]?.state.track_id ?? null));
}

/** @param {KeyboardEvent} event */
function keys(event) {
  if (isTaken(event)) return;
  const work = /** @type {Object<string, () => void>} */ ({ " ": () => play(!playing), ",": () => step(-1), ".": () => step(1), "[": () => stepConflict(-1), "]": () => stepConflict(1), Escape: () => { conflict = null; attempt(() => choose(null)); } })[event.key];
  if (!work) return;
  event.preventDefault();
  work();
}

function listen() {
  byId("play").addEventListener("click", () => play(!playing));
  byId("back").addEventListener("click", () => step(-1));
  byId("forward").addEventListener("click", () => step(1));
  byId("time").addEventListener("input", slide);
  for (const id of ["colour", "trail", "boxes"]) byId(id).addEventListener("input", () => show(now));
  byId("present").addEventListener("change", () => attempt(() => choose(byId("present").value === "" ? null : Number(byId("present").value))));
  byId("filter").addEventListener("submit", (/** @type {Event} */ event) => event.preventDefault());
  byId("filter").addEventListener("input", () => filtered());
  byId("draw").addEventListener("click", () => {
    const on = byId("draw").getAttribute("aria-pressed") !== "true";
    if (on && !filtered([])) return;
    byId("draw").setAttribute("aria-pressed", String(on));
    byId("draw").textContent = on ? "Done: the corners are drawn" : "Draw an area";
    if (on) say("Click corners in the plan.");
  });
  byId("clear").addEventListener("click", () => {
    byId("filter").reset();
    filtered([]);
  });
  plan.onclick = clickPlan;
  document.addEventListener("keydown", keys);
}

function showMarks() {
  const length = Math.max(whole.last_ns - whole.first_ns, 1);
  fill(byId("marks"), conflicts.map((one) => {
    const mark = h(`span${one.ttc_s === null ? ".pet" : ""}`, { title: `${words(one.type)} at ${clock(one.time_ns / 1e9)}` });
    mark.style.left = `${(100 * (one.time_ns - whole.first_ns)) / length}%`;
    return mark;
  }));
}

/** Which tracks the job has now. @returns {Promise<string>} */
async function versionNow() {
  const [file] = await get(`/v1/jobs/${jobId}/artifacts?artifact=tracks`);
  return file?.sha256 ?? "";
}

/** A job that was restarted has other tracks: what is here of those before must not be mixed with them. */
async function renew() {
  if (looking || document.hidden) return;
  looking = true;
  let wait = AGAIN_MS;
  try {
    const hadTracks = version !== "", isSame = await versionNow() === version;
    if (isSame && known.over && !byId("player").hidden) { known.over = false; show(now); }
    if (!isSame && await load(await Results.of(jobId)) && hadTracks) fill(byId("nothing"), message("plain", "the job has made other tracks since", "They are shown now; ids may mean other road users than before."));
    if (version) wait = RARELY_MS;
  } finally {
    looking = false;
    lookAgain(wait);
  }
}

/** @param {number} wait ms; whatever was to come before does not */
function lookAgain(wait) {
  clearTimeout(again);
  again = window.setTimeout(() => attempt(renew), wait);
}

/** @param {string} text @param {string} hint */
function showNothing(text, hint) {
  known.over = true;
  if (playing) play(false);
  byId("player").hidden = true;
  fill(byId("nothing"), message("plain", text, hint));
}

/** Show what a job has tracked, with the filter and at the time that were chosen. If a request fails, all stays as it was. @param {Results} made @returns {Promise<boolean>} whether there is anything to show */
async function load(made) {
  const scene = made.has("tracks") ? await made.scene() : null;
  const [found, document_] = scene ? await Promise.all([get(`/v1/jobs/${jobId}/tracks/summary`), made.answer("conflicts", "/conflicts")]) : [null, null];
  version = scene ? made.files.find((one) => one.artifact === "tracks").sha256 : "";
  if (!scene) { showNothing("there are no tracks yet", "They can be played once the stage “Track” has finished, and appear here by themselves."); return false; }
  if (!found.states) { showNothing("nothing was tracked", "The recordings may show no road user that the network knows."); return false; }
  cameras = scene.cameras.map((/** @type {any} */ camera) => new Camera(camera));
  classes = new Map(scene.classes.map((/** @type {any} */ one) => [one.name, one.colour]));
  whole = found;
  conflicts = document_?.conflicts ?? [];
  known = new TrackWindows(jobId, whole.first_ns, whole.last_ns, { version, frames: made.has("frames"), arrived: () => show(now), failed: complain, changed: () => attempt(renew) });
  known.within(parameters(filter).polygon);
  cache.close();
  cache = new FrameCache(jobId, FRAME_PX, redraw);
  [conflict, chosen] = [null, new Set()];
  fill(byId("nothing"));
  byId("player").hidden = false;
  canvases.clear();
  fill(byId("views"), cameras.map((camera) => {
    const canvas = /** @type {HTMLCanvasElement} */ (h("canvas", { width: FRAME_PX, height: Math.round((FRAME_PX * camera.height) / camera.width), role: "img", "aria-label": `Frame of camera ${camera.id} with boxes` }));
    canvas.addEventListener("click", (event) => clickView(camera, event));
    canvases.set(camera.id, canvas);
    return h("figure", null, canvas, h("figcaption", null, camera.id));
  }));
  const seen = new Set(whole.classes.map((/** @type {any} */ one) => one.class)), isChecked = (/** @type {string} */ name) => !filter.classes.length || filter.classes.includes(name);
  fill(byId("classes"), scene.classes.filter((/** @type {any} */ one) => seen.has(one.name)).map((/** @type {any} */ one) => {
    const swatch = h("span.swatch", null);
    swatch.style.background = one.colour;
    return h("label", null, h("input", { type: "checkbox", value: one.name, checked: isChecked(one.name) }), swatch, one.name);
  }));
  byId("time").max = Math.round((whole.last_ns - whole.first_ns) / period());
  const [x0, y0, x1, y1] = whole.bounds_m;
  plan.fit([[x0, y0], [x1, y1], ...cameras.map((camera) => camera.centre)], 0.03);
  attempt(() => layMap(plan, `/v1/jobs/${jobId}/map?version=${scene.map?.version}`, scene.map));
  showMarks();
  showQuery();
  if (clips) { clips.renew(); attempt(() => choose(null)); show(now); return true; }
  listen();
  clips = new ClipPanel(() => ({ filter, colour: byId("colour").value, trailS: Number(byId("trail").value), boxes: byId("boxes").checked, speed: Number(byId("speed").value) }), moment, () => [whole.first_ns, whole.last_ns + 1e8]);
  const asked = conflicts.find((one) => one.conflict_id === wholeNumber("conflict"));
  if (asked) openConflict(asked);
  else show(wholeNumber("time_ns") ?? whole.first_ns);
  return true;
}

async function start() {
  const [, made] = await openJob();
  window.addEventListener("focus", () => attempt(renew));
  document.addEventListener("visibilitychange", () => attempt(renew));
  looking = true;
  try {
    await load(made);
  } finally {
    looking = false;
    lookAgain(version ? RARELY_MS : AGAIN_MS);
  }
}

attempt(start);
