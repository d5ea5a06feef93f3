// What a solved camera looks like: grid and horizon in the frame, points with their errors, camera and view on the plan.
import { drawView, token } from "./plan.js";

const GRID_M = 5, GRID_RANGE_M = 60, PIECES = 24;

/** @param {import("./frameview.js").FrameView} view @param {CanvasRenderingContext2D} context @param {import("./projection.js").Camera} camera */
export function drawGround(view, context, camera) {
  const x0 = Math.round(camera.centre[0] / GRID_M) * GRID_M, y0 = Math.round(camera.centre[1] / GRID_M) * GRID_M;
  context.strokeStyle = "rgb(90 200 255 / .5)";
  for (let k = -GRID_RANGE_M; k <= GRID_RANGE_M; k += GRID_M) {
    context.lineWidth = k % (2 * GRID_M) ? 1 : 1.8;
    for (const [from, to] of [[[x0 + k, y0 - GRID_RANGE_M, 0], [x0 + k, y0 + GRID_RANGE_M, 0]], [[x0 - GRID_RANGE_M, y0 + k, 0], [x0 + GRID_RANGE_M, y0 + k, 0]]]) {
      for (let piece = 0; piece < PIECES; piece += 1) { // close to the camera a line runs far out of the picture: only pieces do
        const at = (/** @type {number} */ share) => from.map((value, axis) => value + share * (to[axis] - value));
        const line = camera.line(at(piece / PIECES), at((piece + 1) / PIECES), 2);
        if (line.length && line.every((pixel) => Math.abs(pixel[0]) < 1e5 && Math.abs(pixel[1]) < 1e5)) { view.trace(context, line); context.stroke(); }
      }
    }
  }
  drawHorizon(view, context, camera);
}

/** Where level directions go. @param {import("./frameview.js").FrameView} view @param {CanvasRenderingContext2D} context @param {import("./projection.js").Camera} camera */
function drawHorizon(view, context, camera) {
  const forward = Math.atan2(camera.rotation[1][2], camera.rotation[0][2]), far = 1e6, pixels = [];
  for (let step = -80; step <= 80; step += 2) {
    const angle = forward + (step * Math.PI) / 180;
    const pixel = camera.project([camera.centre[0] + far * Math.cos(angle), camera.centre[1] + far * Math.sin(angle), camera.centre[2]]);
    if (pixel && Math.abs(pixel[0]) < 1e5 && Math.abs(pixel[1]) < 1e5) pixels.push(pixel);
  }
  if (pixels.length < 2) return;
  context.strokeStyle = "#ffd54a";
  context.lineWidth = 2;
  context.setLineDash([10, 6]);
  view.trace(context, pixels);
  context.stroke();
  context.setLineDash([]);
  const [x, y] = view.toCanvas(pixels[Math.floor(pixels.length / 2)]);
  label(context, x, y - 8, "horizon", "#ffd54a");
}

/** @param {CanvasRenderingContext2D} context @param {number} x @param {number} y @param {string} text @param {string} colour */
export function label(context, x, y, text, colour) {
  context.font = "600 15px system-ui, sans-serif";
  context.textAlign = "center";
  context.lineWidth = 4;
  context.strokeStyle = "rgb(0 0 0 / .75)";
  context.strokeText(text, x, y);
  context.fillStyle = colour;
  context.fillText(text, x, y);
}

/** Points where they were clicked, and where the solved camera sees them. @param {import("./frameview.js").FrameView} view @param {CanvasRenderingContext2D} context @param {import("./calibrationpanel.js").CalibrationPanel} panel */
export function drawPoints(view, context, panel) {
  panel.points.forEach((point, index) => {
    if (point.u === null || point.v === null) return;
    const [x, y] = view.toCanvas([point.u, point.v]), outlier = point.residual && !point.residual.used;
    const colour = outlier ? "#ff6b5e" : index === panel.selected ? "#ffffff" : "#ffd54a";
    if (panel.camera && point.x !== null && point.y !== null) {
      const seen = panel.camera.project([point.x, point.y, point.z]);
      if (seen) {
        const [px, py] = view.toCanvas(seen);
        context.strokeStyle = "#ff6b5e";
        context.lineWidth = 2;
        context.beginPath(); context.moveTo(x, y); context.lineTo(px, py); context.stroke();
        context.beginPath(); context.arc(px, py, 3, 0, 2 * Math.PI); context.stroke();
      }
    }
    context.strokeStyle = "rgb(0 0 0 / .8)";
    context.lineWidth = 4;
    cross(context, x, y);
    context.strokeStyle = colour;
    context.lineWidth = 2;
    cross(context, x, y);
    label(context, x + 16, y - 8, `${index + 1}${outlier ? " ✕" : ""}`, colour);
  });
}

/** @param {CanvasRenderingContext2D} context @param {number} x @param {number} y */
function cross(context, x, y) {
  context.beginPath();
  context.moveTo(x - 9, y); context.lineTo(x + 9, y);
  context.moveTo(x, y - 9); context.lineTo(x, y + 9);
  context.stroke();
}

/** @param {import("./plan.js").Plan} plan @param {CanvasRenderingContext2D} context @param {import("./calibrationpanel.js").CalibrationPanel} panel */
export function drawOnPlan(plan, context, panel) {
  if (panel.camera) drawView(plan, context, panel.camera, token("--accent"));
  panel.points.forEach((point, index) => {
    if (point.x === null || point.y === null) return;
    const [x, y] = plan.toCanvas([point.x, point.y]), outlier = point.residual && !point.residual.used;
    context.strokeStyle = context.fillStyle = outlier ? token("--bad") : index === panel.selected ? token("--accent") : token("--ink");
    context.lineWidth = 2;
    cross(context, x, y);
    plan.write(context, `${index + 1}${outlier ? " ✕" : ""}`, [x + 8, y - 6], { size: 13, align: "left", ink: String(context.fillStyle) });
    if (panel.camera && point.u !== null && point.v !== null) {
      const ground = panel.camera.ground([point.u, point.v], point.z);
      if (ground) { plan.trace(context, [[point.x, point.y], ground]); context.strokeStyle = token("--bad"); context.stroke(); }
    }
  });
}
