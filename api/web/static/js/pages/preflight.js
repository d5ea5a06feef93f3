// What is known of a job's recordings before anything is learned: do they fit together, in time and in space?
import { figure } from "../chart.js";
import { Coverage } from "../coverage.js";
import { attempt, byId, fill, h, message } from "../dom.js";
import { duration, number, percent, size } from "../format.js";
import { jobId, openJob } from "../jobtabs.js";
import { layMap } from "../maplayer.js";
import { cameraColour, drawCamera, groundInView, Plan } from "../plan.js";
import { Camera } from "../projection.js";
import { table } from "../resulttables.js";
import { spans } from "../spans.js";

/** Stages whose warnings are about what was recorded. */
const STAGES = ["preflight", "calibrate", "sync"];

/** @param {any} job */
function showWarnings(job) {
  const stages = job.stages.filter((/** @type {any} */ stage) => STAGES.includes(stage.name));
  const failed = stages.filter((/** @type {any} */ stage) => stage.error), warnings = stages.flatMap((/** @type {any} */ stage) => stage.warnings.map((/** @type {any} */ warning) => [stage, warning]));
  const waiting = stages.filter((/** @type {any} */ stage) => !["succeeded", "reused", "failed"].includes(stage.state));
  fill(byId("warnings"),
    failed.map((/** @type {any} */ stage) => message("bad", stage.error.message, stage.error.hint, h("p.note", null, stage.title))),
    warnings.map((/** @type {any[]} */ [stage, warning]) => message("caution", warning.message, warning.hint, h("p.note", null, stage.title))),
    waiting.length ? h("p.note", null, `Not known yet: ${waiting.map((/** @type {any} */ stage) => stage.title.toLowerCase()).join(", ")}.`) : null,
    !failed.length && !warnings.length && !waiting.length ? message("plain", "nothing is doubtful", "The recordings and the calibration fit together.") : null);
}

/** What is unusual about a recording, in words. @param {any} video */
function notes(video) {
  return [
    video.missing_frames ? `${video.missing_frames} frames are missing at its end` : "", video.missing_files?.length ? `${video.missing_files.join(", ")} should lie between its files` : "",
    video.variable_rate ? "its rate varies" : "", video.stray_frames ? `${video.stray_frames} stray stamps` : "", video.doubled_frames ? `${video.doubled_frames} frames twice` : "",
    video.size_changes?.length ? "its size changes" : "", video.rate_changes?.length ? "its frame rate changes" : "", video.interlaced ? "interlaced" : "", video.has_clock === false ? "no times: its nominal rate was taken" : "",
    video.mirrored ? "mirrored" : "", video.rotation_deg ? `turned by ${video.rotation_deg}°` : "",
  ].filter(Boolean).join("; ");
}

/** @param {any} job @param {any} probe */
function showRecordings(job, probe) {
  const bytes = (/** @type {string} */ camera) => job.files.filter((/** @type {any} */ one) => one.camera === camera).reduce((/** @type {number} */ sum, /** @type {any} */ one) => sum + one.size_bytes, 0);
  const rows = Object.entries(probe.cameras).map(([camera, video]) => [camera, video.codec, `${video.width_px}x${video.height_px}`, video.fps, video.frames, video.duration_s, video.largest_gap_s, bytes(camera), notes(video)]);
  const cells = Object.entries(probe.cameras).map(([camera, video]) => [camera, video.codec, `${video.width_px} × ${video.height_px}`, number(video.fps), video.frames, number(video.duration_s, 1), number(video.largest_gap_s), size(bytes(camera)), notes(video) || "–"]);
  const columns = ["Camera", "Codec", "Size, px", "Frames per second", "Frames", "Length, s", "Longest gap, s", "Size on disk, B", "Remarks"];
  fill(byId("recordings"), table("Recordings", columns, rows, { cells }));
}

/** A recording's time on the reference clock, s. @param {any} clock @param {number} localNs */
function toReference(clock, localNs) {
  const piece = (clock.pieces ?? []).findLast((/** @type {any} */ one) => one.from_ns <= localNs);
  return (localNs + clock.offset_ns + clock.drift * localNs + (piece?.shift_ns ?? 0)) / 1e9;
}

/** @param {any} probe @param {any} clocks */
function showClocks(probe, clocks) {
  const cameras = Object.keys(probe.cameras);
  const lines = cameras.map((camera, index) => {
    const video = probe.cameras[camera], clock = clocks?.clocks.find((/** @type {any} */ one) => one.camera_id === camera);
    const pieces = video.segments?.length ? video.segments : [video];
    return { name: camera, colour: cameraColour(index), spans: pieces.map((/** @type {any} */ piece) => /** @type {[number, number]} */ (clock ? [toReference(clock, piece.first_ns), toReference(clock, piece.last_ns)] : [piece.first_ns / 1e9, piece.last_ns / 1e9])) };
  });
  const starts = lines.map((line) => line.spans[0][0]), ends = lines.map((line) => line.spans[line.spans.length - 1][1]);
  const from = Math.max(...starts), to = Math.min(...ends), longest = Math.max(...lines.map((line, index) => ends[index] - starts[index]));
  const known = !!clocks;
  fill(byId("clocks"),
    known ? null : message("plain", "each recording is drawn on its own clock", "How the clocks lie against each other is known once the cameras are synchronised."),
    known && to <= from ? message("bad", "there is no time that all cameras recorded", "Instants need two cameras at least; look whether a recording of another hour was uploaded.") : null,
    known && to > from && to - from < longest / 2 ? message("caution", `all cameras share ${duration(to - from)} of up to ${duration(longest)}`, "The rest is seen by fewer cameras. If that is not how they were recorded, check the offsets under Results.") : null,
    figure({
      title: known ? "On the reference clock" : "Each on its own clock", caption: known && to > from ? `All cameras record from ${number(from, 1)} s to ${number(to, 1)} s: ${duration(to - from)}, the shaded stretch.` : "",
      chart: spans({ lines, common: known && to > from ? [from, to] : null, x: known ? "time on the reference clock, s" : "time on each recording's own clock, s", label: "When each camera recorded" }),
      columns: ["camera", "from_s", "to_s"], rows: lines.flatMap((line) => line.spans.map((span) => [line.name, ...span])),
    }));
}

/** @param {any} scene @param {any} residuals */
function showViews(scene, residuals) {
  const cameras = scene.cameras.map((/** @type {any} */ camera) => new Camera(camera));
  const coverage = new Coverage(cameras);
  const plan = new Plan(byId("plan"), (view, context) => {
    coverage.draw(view, context);
    cameras.forEach((/** @type {Camera} */ camera, /** @type {number} */ index) => {
      view.trace(context, groundInView(camera), true);
      context.strokeStyle = cameraColour(index);
      context.lineWidth = 1.4;
      context.stroke();
      drawCamera(view, context, camera, cameraColour(index));
    });
  });
  plan.fit(cameras.flatMap((/** @type {Camera} */ camera) => [camera.centre, ...groundInView(camera)]));
  attempt(() => layMap(plan, `/v1/jobs/${jobId}/map?version=${scene.map?.version}`, scene.map));
  fill(byId("view-key"), coverage.key.map(({ name, colour }) => {
    const swatch = h("span.swatch", null);
    swatch.style.background = colour;
    return h("li", null, swatch, name);
  }));
  const overlap = residuals?.overlap;
  if (overlap) {
    fill(byId("overlap"), h("p.note", null, `What each pair sees of the road within ${number(overlap.within_m, 0)} m of the middle of all cameras.`),
      table("Pairs of cameras", ["Cameras", "Road in common, m²", "Of what the one that sees less sees"], overlap.pairs.map((/** @type {any} */ pair) => [pair.cameras.join(" and "), pair.area_m2, pair.share]),
        { cells: overlap.pairs.map((/** @type {any} */ pair) => [pair.cameras.join(" and "), number(pair.area_m2, 0), percent(pair.share)]) }),
      table("Road by number of cameras", ["Cameras at least", "Road, m²"], Object.entries(overlap.seen_by_m2), { cells: Object.entries(overlap.seen_by_m2).map(([count, area]) => [count, number(area, 0)]) }));
  }
  byId("views").hidden = false;
}

attempt(async () => {
  const [job, made] = await openJob();
  showWarnings(job);
  const [probe, clocks, residuals, scene] = await Promise.all([made.document("probe"), made.document("clocks"), made.document("residuals"), made.scene()]);
  if (probe) { showRecordings(job, probe); showClocks(probe, clocks); }
  byId("known").hidden = !probe;
  if (scene) showViews(scene, residuals);
});
