// Drawing of road users: footprints and trails on the plan, boxes in the cameras' frames.
import { drawCamera, cameraColour, token } from "./plan.js";
import { EDGES, footprint } from "./projection.js";
import { boxOf } from "./trackdata.js";

const TRACK_COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5195", "#8a6d3b", "#c0392b", "#2c7873"];
const FASTEST_MPS = 20;

/** @typedef {import("./trackdata.js").State} State */

/** Blue (standing) through green and yellow to red (fast): lightness rises with speed, too. @param {number} speed */
function speedColour(speed) {
  const share = Math.min(1, speed / FASTEST_MPS);
  return `hsl(${230 - 230 * share} 85% ${42 + 14 * share}%)`;
}

/** @param {State} state @param {"class"|"speed"|"track"} by @param {Map<string, string>} classes */
export function colourOf(state, by, classes) {
  if (by === "speed") return speedColour(state.speed_mps);
  if (by === "track") return TRACK_COLOURS[state.track_id % TRACK_COLOURS.length];
  return classes.get(state.class) ?? "#888888";
}

/**
 * @typedef {Object} Shown what the player shows now
 * @property {State[]} states that pass the filter
 * @property {import("./trackdata.js").Tracks} tracks
 * @property {number} timeNs
 * @property {number} trailNs
 * @property {Set<number>} chosen tracks that are marked
 * @property {(state: State) => string} colour
 * @property {number[][]} polygon of the filter
 * @property {any|null} conflict marked now
 * @property {import("./projection.js").Camera[]} cameras
 */

/** @param {import("./plan.js").Plan} plan @param {CanvasRenderingContext2D} context @param {Shown} shown */
export function drawRoad(plan, context, shown) {
  shown.cameras.forEach((camera, index) => drawCamera(plan, context, camera, cameraColour(index)));
  if (shown.polygon.length) {
    plan.trace(context, shown.polygon, shown.polygon.length > 2);
    context.strokeStyle = token("--accent");
    context.lineWidth = 2;
    context.setLineDash([6, 4]);
    context.stroke();
    context.setLineDash([]);
    for (const corner of shown.polygon) {
      const [x, y] = plan.toCanvas(corner);
      context.fillStyle = token("--accent");
      context.fillRect(x - 3, y - 3, 6, 6);
    }
  }
  for (const state of shown.states) {
    const colour = shown.colour(state), trail = shown.trailNs ? shown.tracks.trail(state.track_id, shown.timeNs, shown.trailNs) : [];
    if (trail.length > 1) {
      plan.trace(context, trail.map((past) => [past.x_m, past.y_m]));
      context.strokeStyle = colour;
      context.globalAlpha = 0.55;
      context.lineWidth = 2;
      context.stroke();
      context.globalAlpha = 1;
    }
    drawFootprint(plan, context, state, colour, shown.chosen.has(state.track_id));
  }
  if (shown.conflict) drawConflict(plan, context, shown.conflict);
}

/** @param {import("./plan.js").Plan} plan @param {CanvasRenderingContext2D} context @param {State} state @param {string} colour @param {boolean} chosen */
function drawFootprint(plan, context, state, colour, chosen) {
  const box = boxOf(state), corners = footprint(box);
  plan.trace(context, corners, true);
  context.fillStyle = colour;
  context.globalAlpha = 0.8;
  context.fill();
  context.globalAlpha = 1;
  context.strokeStyle = chosen ? token("--focus") : token("--ink");
  context.lineWidth = chosen ? 3.5 : 1;
  context.stroke();
  const c = Math.cos(state.yaw_rad), s = Math.sin(state.yaw_rad), front = state.length_m / 2; // a line from the middle to the front says where it heads
  plan.trace(context, [[state.x_m, state.y_m], [state.x_m + c * front, state.y_m + s * front]]);
  context.strokeStyle = "#ffffff";
  context.lineWidth = 2;
  context.stroke();
  if (chosen) {
    const [x, y] = plan.toCanvas([state.x_m, state.y_m]);
    plan.write(context, `${state.track_id} · ${state.speed_mps.toFixed(1)} m/s`, [x, y - 14], { size: 13 });
  }
}

/** @param {import("./plan.js").Plan} plan @param {CanvasRenderingContext2D} context @param {any} conflict */
function drawConflict(plan, context, conflict) {
  const [x, y] = plan.toCanvas([conflict.x_m, conflict.y_m]);
  context.strokeStyle = token("--bad");
  context.lineWidth = 3;
  context.beginPath(); context.arc(x, y, 16, 0, 2 * Math.PI); context.stroke();
  context.beginPath(); context.moveTo(x - 22, y); context.lineTo(x + 22, y); context.moveTo(x, y - 22); context.lineTo(x, y + 22); context.stroke();
}

/**
 * A frame with the boxes of road users.
 * @param {HTMLCanvasElement} canvas @param {import("./projection.js").Camera} camera @param {ImageBitmap|null|undefined} image @param {Shown} shown @param {boolean} boxes
 */
export function drawFrame(canvas, camera, image, shown, boxes) {
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d")), scale = canvas.width / camera.width;
  if (image) context.drawImage(image, 0, 0, canvas.width, canvas.height);
  else {
    context.fillStyle = "#14181d";
    context.fillRect(0, 0, canvas.width, canvas.height);
    if (image === null) { context.fillStyle = "#9aa4ae"; context.font = "15px system-ui, sans-serif"; context.textAlign = "center"; context.fillText("no frame at this instant", canvas.width / 2, canvas.height / 2); }
  }
  if (!boxes) return;
  for (const state of shown.states) {
    const chosen = shown.chosen.has(state.track_id), box = boxOf(state), edges = camera.boxEdges(box);
    if (!camera.around(edges)) continue;
    context.strokeStyle = chosen ? "#f5b301" : shown.colour(state);
    context.lineWidth = chosen ? 3 : 1.6;
    context.beginPath();
    edges.forEach((edge, index) => {
      edge.forEach(([u, v], point) => { if (point) context.lineTo((u + 0.5) * scale, (v + 0.5) * scale); else context.moveTo((u + 0.5) * scale, (v + 0.5) * scale); });
      if (index === FRONT && edge.length > 1) cross(context, camera, box, scale);
    });
    context.stroke();
  }
}

/** The edge at the top of the front, after which the front is crossed out: so one sees where a box heads. */
const FRONT = EDGES.findIndex(([a, b]) => a === 7 && b === 4);

/** @param {CanvasRenderingContext2D} context @param {import("./projection.js").Camera} camera @param {number[]} box @param {number} scale */
function cross(context, camera, box, scale) {
  const [x, y, z, length, width, height, yaw] = box, c = Math.cos(yaw), s = Math.sin(yaw);
  const front = (/** @type {number} */ left, /** @type {number} */ up) => [x + (c * length) / 2 - (s * left * width) / 2, y + (s * length) / 2 + (c * left * width) / 2, z + (up * height) / 2];
  for (const [from, to] of [[front(1, -1), front(-1, 1)], [front(-1, -1), front(1, 1)]]) {
    camera.line(from, to).forEach(([u, v], index) => { if (index) context.lineTo((u + 0.5) * scale, (v + 0.5) * scale); else context.moveTo((u + 0.5) * scale, (v + 0.5) * scale); });
  }
}
