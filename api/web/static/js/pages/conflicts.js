// A job's conflicts: filtered, on the ground, as a scatter, each with what somebody says of it.
import { getAll, request, send } from "../api.js";
import { attempt, byId, fill, h, message, say } from "../dom.js";
import { clock, number, percent, words } from "../format.js";
import { figure, plot, save, saveCanvases, toCsv } from "../chart.js";
import { drawHeat } from "../heatmap.js";
import { jobId, openJob, readOnly } from "../jobtabs.js";
import { layMap } from "../maplayer.js";
import { cameraColour, drawCamera, Plan, token } from "../plan.js";
import { Camera } from "../projection.js";

const TYPES = /** @type {const} */ ([["rear_end", "#e69f00", "circle"], ["merging", "#56b4e9", "square"], ["crossing", "#d55e00", "triangle"], ["head_on", "#a3154b", "cross"]]);
let area = /** @type {Array<Array<[number, number]>>} */ ([]), conflicts = /** @type {any[]} */ ([]), shown = /** @type {any[]} */ ([]), cameras = /** @type {Camera[]} */ ([]);
/** @type {Map<number, {verdict: string, note: string}>} */
const reviews = new Map();
const plan = new Plan(byId("heat"), (view, context) => {
  cameras.forEach((camera, index) => drawCamera(view, context, camera, cameraColour(index)));
  drawArea(view, context);
  drawHeat(view, context, shown);
});

/** The outlines of where conflicts are told. @param {Plan} view @param {CanvasRenderingContext2D} context */
function drawArea(view, context) {
  context.save();
  context.setLineDash([2, 4]);
  context.strokeStyle = token("--ink");
  for (const ring of area) {
    context.beginPath();
    for (const point of ring) { const [x, y] = view.toCanvas(point); context.lineTo(x, y); }
    context.closePath();
    context.stroke();
  }
  context.restore();
}

/** What a count of conflicts is to be compared with. @param {any} exposure */
function exposed(exposure) {
  return `Conflicts are told of ${number(exposure.area_m2, 0)} m²${conflicts.length ? " (dotted on the map)" : ""}, where tracks are good enough to say so. Road users spent ${number(60 * exposure.road_user_hours, 1)} minutes there and went ${number(exposure.road_user_km, 1)} km in ${number(60 * exposure.hours, 1)} minutes of recording.${exposure.conflicts_elsewhere ? ` ${exposure.conflicts_elsewhere} more that look like conflicts outside are not told.` : ""}`;
}

/** @param {any} one */
const player = (one) => `/jobs/${jobId}/player?conflict=${one.conflict_id}`;

/** @param {any} one */
function passes(one) {
  const of = (/** @type {string} */ id) => byId(id).value, verdict = reviews.get(one.conflict_id)?.verdict ?? "none";
  return (!of("type") || one.type === of("type")) && (!of("class") || one.classes.includes(of("class")))
    && (!of("ttc") || (one.ttc_s !== null && one.ttc_s <= Number(of("ttc")))) && (!of("pet") || (one.pet_s !== null && one.pet_s <= Number(of("pet"))))
    && (!of("probability") || (one.probability !== null && one.probability >= Number(of("probability")))) && (!of("verdict") || verdict === of("verdict"));
}

/** @param {number|null} value @param {Array<number|null>} ends */
function interval(value, ends) {
  return value === null ? "–" : [number(value), h("small", null, `${number(ends[0])} to ${ends[1] === null ? "∞" : number(ends[1])}`)];
}

/** @param {any} one */
function reviewOf(one) {
  const review = reviews.get(one.conflict_id);
  if (readOnly) return review ? [review.verdict, review.note ? h("small", null, review.note) : null] : "not yet";
  const note = /** @type {HTMLInputElement} */ (h("input", { value: review?.note ?? "", placeholder: "note", maxlength: 2000, "aria-label": `Note on conflict ${one.conflict_id}`, disabled: !review }));
  const button = (/** @type {string} */ verdict, /** @type {string} */ text) => h("button.small", { type: "button", "aria-pressed": String(review?.verdict === verdict), "aria-label": `Conflict ${one.conflict_id}: ${text}`, onclick: () => attempt(() => judge(one, review?.verdict === verdict ? null : verdict, note.value)) }, text);
  note.addEventListener("change", () => attempt(() => judge(one, review?.verdict ?? null, note.value)));
  return h("div.review", null, button("confirmed", "confirmed"), button("rejected", "rejected"), note);
}

/** @param {any} one @param {string|null} verdict @param {string} note */
async function judge(one, verdict, note) {
  const path = `/v1/jobs/${jobId}/conflicts/${one.conflict_id}/review`;
  if (verdict) reviews.set(one.conflict_id, await send("PUT", path, { verdict, note }));
  else { await request("DELETE", path); reviews.delete(one.conflict_id); }
  say(`Conflict ${one.conflict_id}: ${verdict ?? "not reviewed"}.`);
  const place = document.activeElement?.getAttribute("aria-label");
  show();
  if (place) /** @type {HTMLElement|null} */ ([...byId("conflicts").querySelectorAll("[aria-label]")].find((node) => node.getAttribute("aria-label") === place))?.focus();
}

/** @param {any} one */
function row(one) {
  return h("tr", null, h("th", { scope: "row" }, h("a", { href: player(one), "aria-label": `Conflict ${one.conflict_id} at ${clock(one.time_ns / 1e9)}: open in the player` }, clock(one.time_ns / 1e9)), h("small", null, `no. ${one.conflict_id}`)),
    h("td", null, words(one.type)), h("td", null, one.classes.map((/** @type {string} */ name, /** @type {number} */ index) => `${name} ${one.track_ids[index]}`).join(", ")),
    h("td.number", null, interval(one.ttc_s, one.ttc_interval_s)), h("td.number", null, interval(one.pet_s, one.pet_interval_s)), h("td.number", null, percent(one.probability)),
    h("td.number", null, one.speeds_mps.map((/** @type {number} */ speed) => number(speed, 1)).join(", ")), h("td.number", null, number(one.deceleration_mps2, 1)), h("td", null, reviewOf(one)));
}

function show() {
  shown = conflicts.filter(passes);
  fill(byId("conflicts").tBodies[0], shown.length ? shown.map(row) : h("tr", null, h("td", { colspan: 9 }, "No conflict is like that: take a filter away.")));
  const judged = conflicts.filter((one) => reviews.has(one.conflict_id)).length;
  byId("count").textContent = `${shown.length} of ${conflicts.length} conflicts; ${judged} reviewed.`;
  const series = TYPES.map(([type, colour, mark]) => { const of = shown.filter((one) => one.type === type && one.ttc_s !== null); return { name: words(type), colour, mark, kind: /** @type {"dots"} */ ("dots"), points: of.map((one) => /** @type {[number, number]} */ ([Math.max(...one.speeds_mps), one.ttc_s])), titles: of.map((one) => `no. ${one.conflict_id}`) }; });
  fill(byId("scatter"), figure({ title: "Time to collision against speed", caption: "Of those that have a time to collision; the faster one's speed.", key: series,
    chart: plot({ series, x: "speed of the faster one, m/s", y: "TTC, s", label: "Time to collision against speed", ...(shown.some((one) => one.ttc_s !== null) ? {} : { xRange: [0, 20], yRange: [0, 3] }) }),
    columns: ["conflict_id", "type", "speed_mps", "ttc_s"], rows: shown.map((one) => [one.conflict_id, one.type, Math.max(...one.speeds_mps), one.ttc_s]) }));
  plan.redraw();
}

attempt(async () => {
  const [, made] = await openJob(), document_ = await made.answer("conflicts", "/conflicts");
  if (!document_) { fill(byId("nothing"), message("plain", "conflicts have not been looked for yet", "They appear here once the stage has finished.")); return; }
  conflicts = document_.conflicts;
  if (document_.exposure) { area = document_.exposure.outlines_m; byId("exposure").textContent = exposed(document_.exposure); }
  if (!conflicts.length) { fill(byId("nothing"), message("plain", "there are no conflicts", `The thresholds were TTC ${document_.thresholds.ttc_s} s and PET ${document_.thresholds.pet_s} s. Another job of the site with other options safety.ttc_s and safety.pet_s finds others: it takes over all that is made before.`)); return; }
  const [said, scene] = await Promise.all([getAll(`/v1/jobs/${jobId}/conflicts/reviews`), made.scene()]);
  for (const review of said) reviews.set(review.conflict_id, review);
  cameras = (scene?.cameras ?? []).map((/** @type {any} */ camera) => new Camera(camera));
  if (scene) attempt(() => layMap(plan, `/v1/jobs/${jobId}/map?version=${scene.map?.version}`, scene.map));
  for (const type of new Set(conflicts.map((one) => one.type))) byId("type").append(h("option", { value: type }, words(type)));
  for (const name of new Set(conflicts.flatMap((one) => one.classes))) byId("class").append(h("option", null, name));
  for (const format of ["csv", "pdf"]) byId(format).href = `/v1/jobs/${jobId}/conflicts?format=${format}&reviews=true`;
  byId("found").hidden = false;
  byId("filter").addEventListener("submit", (/** @type {Event} */ event) => event.preventDefault());
  byId("filter").addEventListener("input", show);
  byId("print").addEventListener("click", () => window.print());
  byId("heat-csv").addEventListener("click", () => save("where-they-are.csv", new Blob([toCsv(["conflict_id", "type", "x_m", "y_m"], shown.map((one) => [one.conflict_id, one.type, one.x_m, one.y_m]))], { type: "text/csv" })));
  byId("heat-png").addEventListener("click", () => saveCanvases("where-they-are.png", [byId("heat")]));
  plan.onclick = (point) => { const near = shown.find((one) => Math.hypot(one.x_m - point[0], one.y_m - point[1]) < 12 / plan.pxPerM); if (near) location.assign(player(near)); };
  plan.fit([...conflicts.map((one) => [one.x_m, one.y_m]), ...cameras.map((camera) => camera.centre)], 0.12);
  show();
});
