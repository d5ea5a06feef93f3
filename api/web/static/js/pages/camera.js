// One camera of a site: look at its recording, calibrate it by clicks, draw its signal regions.
import { get, getAll, Problem, query, request, send } from "../api.js";
import { attempt, byId, fill, h, message, say } from "../dom.js";
import { clock, number } from "../format.js";
import { drawGround, drawOnPlan, drawPoints, label } from "../calibrationdraw.js";
import { CalibrationPanel } from "../calibrationpanel.js";
import { follows, Footage, resized } from "../footage.js";
import { FrameView } from "../frameview.js";
import { MapPicture } from "../mappicture.js";
import { groundInView, Plan } from "../plan.js";
import { phaseColour, SignalPanel } from "../signalpanel.js";
import { changeSite } from "../sitedocument.js";

const siteId = document.body.dataset.site ?? "", cameraId = document.body.dataset.camera ?? "";
let record = /** @type {any} */ (null), dirty = false, asked = 0, fitted = false;
let panel = /** @type {CalibrationPanel|null} */ (null), signals = /** @type {SignalPanel|null} */ (null), recording = /** @type {Footage|null} */ (null);
/** @type {number[][]} */
let measured = [];
/** Of the site's world, where points that were read from files gave it one. */
let origin = /** @type {any} */ (null);
const mode = () => /** @type {any} */ (document.querySelector("input[name=mode]:checked")).value;

const view = new FrameView(byId("frame"), 1920, 1080, (frame, context) => {
  if (!panel) return;
  if (panel.camera) drawGround(frame, context, panel.camera);
  drawPoints(frame, context, panel);
  signals?.signals.forEach((signal, index) => outline(context, signal.region, index === signals?.selected ? "#ffffff" : phaseColour(signal.id), signal.id));
  const drawn = signals?.drawn;
  if (drawn) outline(context, [Math.min(drawn[0], drawn[2]), Math.min(drawn[1], drawn[3]), Math.abs(drawn[2] - drawn[0]), Math.abs(drawn[3] - drawn[1])], "#ffffff", "");
  drawMeasure(context);
});
const plan = new Plan(byId("plan"), (ground, context) => {
  map.draw(context);
  if (panel) drawOnPlan(ground, context, panel);
});
const map = new MapPicture(plan, siteId);

/** @param {CanvasRenderingContext2D} context @param {number[]} region @param {string} colour @param {string} name */
function outline(context, [x, y, width, height], colour, name) {
  context.lineWidth = 2;
  context.strokeStyle = colour;
  view.trace(context, [[x, y], [x + width, y], [x + width, y + height], [x, y + height]], true);
  context.stroke();
  const [u, v] = view.toCanvas([x + width / 2, y]);
  if (name) label(context, u, v - 6, name, colour);
}

/** @param {CanvasRenderingContext2D} context */
function drawMeasure(context) {
  const camera = panel?.camera, [from, to] = measured;
  if (!camera || !from) return;
  context.strokeStyle = "#ff80ff";
  context.lineWidth = 3;
  const [x, y] = view.toCanvas(from);
  context.beginPath(); context.arc(x, y, 5, 0, 2 * Math.PI); context.stroke();
  const a = camera.ground(from), b = to && camera.ground(to);
  if (!a || !b) return;
  view.trace(context, camera.line(a, b));
  context.stroke();
  const [u, v] = view.toCanvas(to);
  label(context, u, v - 12, `${number(Math.hypot(b[0] - a[0], b[1] - a[1]))} m`, "#ff80ff");
}

/** @param {number[]} pixel */
function measure(pixel) {
  if (!panel?.camera) { fill(byId("frame-note"), message("plain", "lengths can be measured once the camera is solved")); return; }
  if (!panel.camera.ground(pixel)) { fill(byId("frame-note"), message("plain", "that lies above the horizon", "Click on the road.")); return; }
  measured = measured.length === 1 ? [measured[0], pixel] : [pixel];
  if (measured.length === 2) {
    const [a, b] = measured.map((point) => /** @type {number[]} */ (panel?.camera?.ground(point)));
    const text = `On the road: ${number(Math.hypot(b[0] - a[0], b[1] - a[1]))} m.`;
    byId("frame-note").textContent = text;
    say(text);
  }
  view.redraw();
}

function changed() {
  if (!dirty && panel && signals) {
    const now = JSON.stringify([panel.document(), signals.document()]);
    dirty = now !== before;
  }
  byId("save").disabled = !dirty;
  byId("saved").textContent = dirty ? "not saved yet" : "";
  if (!fitted && panel?.camera) { fitted = true; plan.fit([panel.camera.centre, ...groundInView(panel.camera)]); }
  view.redraw();
  plan.redraw();
}

let before = "";

/** Show the frame at the slider's time. While one is under way, the next waits, and only for the latest time. */
async function showFrame() {
  byId("time-text").textContent = clock(Number(byId("time").value));
  if (!await recording?.isRead() || !recording) return;
  asked += 1;
  if (asked > 1) return;
  try {
    for (let served = 0; served !== asked;) {
      served = asked;
      const { path, time } = recording.at(Number(byId("time").value));
      const response = await request("GET", `${path}/frame${query({ time_s: time })}`);
      view.show(await createImageBitmap(await response.blob()));
    }
  } finally {
    asked = 0;
  }
}

/** Files of other programs take the place of what is on the page; nothing is saved yet. */
async function readFiles() {
  const input = byId("calibration-files"), place = byId("read-notes");
  if (!panel || !record || !input.files.length) return;
  const camera = { ...record.site.cameras.find((/** @type {any} */ one) => one.id === cameraId), calibration: panel.document() };
  const files = await Promise.all([...input.files].map(async (/** @type {File} */ file) => ({ name: file.name, text: await file.text() })));
  const names = byId("calibration-name").value.trim();
  input.value = "";
  try {
    const answer = await send("POST", "/v1/calibration/read", { camera, files, names: names ? [names] : [], origin: origin ?? record.site.origin });
    origin = answer.origin;
    panel.take(answer.camera.calibration);
    fill(place, h("p.note", null, files.map((file, index) => `${file.name}: ${answer.formats[index]}`).join("; ")), answer.notes.map((/** @type {string} */ note) => h("p.note", null, note)));
  } catch (error) {
    fill(place, error instanceof Problem ? message("bad", error.message, error.hint) : message("bad", String(error)));
  }
}

async function save() {
  if (!panel || !signals) return;
  panel.check();
  const description = { calibration: panel.document(), signals: signals.document() };
  const left = panel.points.length - panel.complete().length;
  record = await changeSite(siteId, (site) => ({ ...site, origin: site.origin ?? origin, cameras: site.cameras.map((/** @type {any} */ one) => (one.id === cameraId ? { ...one, ...description } : one)) }));
  before = JSON.stringify([panel.document(), signals.document()]);
  dirty = false;
  changed();
  byId("saved").textContent = left && panel.kind !== "matrices" ? `saved; ${left} points without all coordinates were left out` : "saved";
  say("Saved.");
}

/** @param {KeyboardEvent} event */
function keys(event) {
  const by = event.shiftKey ? 5 : 0.5, moves = /** @type {Object<string, number[]>} */ ({ ArrowLeft: [-by, 0], ArrowRight: [by, 0], ArrowUp: [0, -by], ArrowDown: [0, by] });
  if (!panel || panel.selected < 0 || mode() !== "points") return;
  if (moves[event.key]) { event.preventDefault(); panel.nudge(moves[event.key][0], moves[event.key][1]); }
  if (event.key === "Escape") { panel.selected = -1; panel.mark(); }
}

async function start() {
  const [site, files] = await Promise.all([get(`/v1/sites/${siteId}`), getAll(`/v1/sites/${siteId}/recordings`)]);
  record = site;
  const described = () => record.site.cameras.find((/** @type {any} */ one) => one.id === cameraId);
  byId("back").textContent = record.name;
  byId("back").href = `/sites/${siteId}`;
  byId("name").textContent = `Camera ${cameraId}`;
  if (!described()) { fill(byId("solution"), message("bad", `the site has no camera ${cameraId} any more`, "Go back to the site.")); return; }
  attempt(() => map.show(record.map));
  const own = files.filter((/** @type {any} */ one) => one.purpose === "recording" && one.camera === cameraId).sort((a, b) => a.filename.localeCompare(b.filename));
  recording = own.length ? new Footage(own.map((/** @type {any} */ one) => `/v1/sites/${siteId}/recordings/${one.id}`)) : null;
  const help = [...byId("frame-note").childNodes];
  const read = attempt(async () => recording?.load()); // which takes longer than all else
  if (recording) fill(byId("frame-note"), "Reading the recording …");
  if (follows(described())) { await read; await attempt(followSize); }
  const description = described();
  view.resize(description.width_px, description.height_px);
  const now = () => Number(byId("time").value);
  signals = new SignalPanel(description.signals, recording, changed, now);
  panel = new CalibrationPanel(description, changed);
  before = JSON.stringify([panel.document(), signals.document()]);
  view.ondown = (pixel) => {
    if (mode() === "signals") { signals?.begin(pixel); return true; }
    const hit = mode() === "points" && panel ? panel.at(pixel, 12 / view.scale) : -1;
    if (hit >= 0 && panel) { panel.selected = hit; panel.mark(); return true; }
    return false;
  };
  view.ondrag = (pixel) => {
    if (mode() === "signals") signals?.drag(pixel);
    else if (panel && panel.selected >= 0) { Object.assign(panel.points[panel.selected], { u: pixel[0], v: pixel[1] }); panel.edited(); }
    view.redraw();
  };
  view.onup = () => { if (mode() === "signals") { signals?.end(); view.redraw(); } };
  const click = (/** @type {number[]} */ pixel) => { if (mode() === "measure") measure(pixel); else if (panel && panel.kind !== "matrices") panel.click(pixel); };
  const listen = () => { view.onclick = mode() === "signals" ? null : click; view.redraw(); }; // a region is dragged, and typed in its panel
  listen();
  for (const choice of document.querySelectorAll("input[name=mode]")) choice.addEventListener("change", listen);
  plan.onclick = (world) => { if (!map.click(world) && panel) panel.place(world); };
  byId("frame").addEventListener("keydown", keys, { capture: true }); // before the view's own: a chosen point is moved, else the cross
  byId("calibration-files").addEventListener("change", () => attempt(readFiles));
  byId("save").addEventListener("click", () => attempt(save));
  window.addEventListener("beforeunload", (event) => { if (dirty) event.preventDefault(); });
  if (!recording) { fill(byId("frame-note"), message("plain", "this camera has no recording yet", "Upload one on the site's page; points can be typed meanwhile.")); return; }
  byId("time").addEventListener("input", () => attempt(showFrame));
  for (const [id, by] of [["earlier", -1], ["later", 1]]) byId(id).addEventListener("click", () => { byId("time").value = now() + Number(by); attempt(showFrame); });
  await read;
  await showRecording(description, help);
}

/** Show a recording that is read, or offer to read it again. @param {any} description of the camera @param {Node[]} help what can be done in the frame */
async function showRecording(description, help) {
  if (!recording) return;
  const { header } = recording;
  if (!header) {
    const again = async () => {
      if (follows(description) && !dirty) { location.reload(); return; } // its size is the recording's
      fill(byId("frame-note"), "Reading the recording …");
      await attempt(async () => recording?.load());
      await showRecording(description, help);
    };
    fill(byId("frame-note"), message("bad", "the recording could not be read", "", h("button.small", { type: "button", onclick: () => attempt(again) }, "Read it again")));
    return;
  }
  if (recording.length) byId("time").max = recording.length;
  if (header.width_px !== description.width_px || header.height_px !== description.height_px) {
    fill(byId("frame-note"), message("caution", `the recording has ${header.width_px} × ${header.height_px} px, the site says ${description.width_px} × ${description.height_px}`, "Points and regions are in the site's pixels; correct the size in the site's JSON, or upload the recording that it was made for."));
  }
  await showFrame();
  if (byId("frame-note").textContent === "Reading the recording …") fill(byId("frame-note"), help);
}

/** A click is of a pixel of the recording: a new camera takes the size of its pictures before anything is clicked in them. */
async function followSize() {
  if (!recording?.header || !resized(record.site, cameraId, recording.header)) return;
  const { header } = recording;
  record = await changeSite(siteId, (site) => resized(site, cameraId, header));
}

attempt(start);
