// Drawing of what was found at one instant: rays and clusters, 2D boxes, fits, and boxes before and after fine-tuning.
import { cameraColour, drawCamera, token } from "./plan.js";
import { footprint } from "./projection.js";

/**
 * @typedef {Object} Scene what is drawn
 * @property {any} findings `GET /v1/jobs/{id}/instants/{time_ns}`
 * @property {import("./projection.js").Camera[]} cameras
 * @property {"association"|"fits"|"networks"} show
 * @property {string} source camera whose boxes of the networks are drawn
 * @property {boolean} before @property {boolean} after
 * @property {number} least score of boxes of the networks that are drawn
 * @property {number|null} chosen a vehicle of the association
 */

/** The boxes of the networks that are shown. @param {Scene} scene @returns {Array<{name: string, colour: string, dash: number[], boxes: number[][]}>} */
export function networkBoxes(scene) {
  const of = (/** @type {string} */ name) => (scene.findings[name][scene.source] ?? []).filter((/** @type {any} */ one) => one.score >= scene.least).map((/** @type {any} */ one) => one.box);
  return [
    ...(scene.before ? [{ name: "before", colour: token("--before"), dash: [7, 4], boxes: of("baseline") }] : []),
    ...(scene.after ? [{ name: "after", colour: token("--after"), dash: [], boxes: of("finetuned") }] : []),
  ];
}

/** @param {import("./plan.js").Plan} plan @param {CanvasRenderingContext2D} context @param {Scene} scene */
export function drawInstantPlan(plan, context, scene) {
  scene.cameras.forEach((camera, index) => drawCamera(plan, context, camera, cameraColour(index)));
  if (scene.show === "association") drawRays(plan, context, scene);
  else if (scene.show === "fits") for (const fit of scene.findings.fits) outline(plan, context, fit.box, token("--truth"), []);
  else for (const { colour, dash, boxes } of networkBoxes(scene)) for (const box of boxes) outline(plan, context, box, colour, dash);
}

/** @param {import("./plan.js").Plan} plan @param {CanvasRenderingContext2D} context @param {Scene} scene */
function drawRays(plan, context, scene) {
  scene.cameras.forEach((camera, index) => {
    for (const seen of scene.findings.detections[camera.id] ?? []) {
      if (!seen.ground_m || (scene.chosen !== null && seen.vehicle !== scene.chosen)) continue;
      context.strokeStyle = context.fillStyle = cameraColour(index);
      context.globalAlpha = seen.vehicle === null ? 0.3 : 0.8;
      context.lineWidth = 1.2;
      context.setLineDash(seen.vehicle === null ? [3, 4] : []);
      plan.trace(context, [camera.centre, seen.ground_m]);
      context.stroke();
      context.setLineDash([]);
      const [x, y] = plan.toCanvas(seen.ground_m);
      context.beginPath(); context.arc(x, y, 3.5, 0, 2 * Math.PI); context.fill();
      context.globalAlpha = 1;
    }
  });
  for (const vehicle of scene.findings.vehicles) {
    if (scene.chosen !== null && vehicle.id !== scene.chosen) continue;
    const [x, y] = plan.toCanvas([vehicle.x_m, vehicle.y_m]);
    context.strokeStyle = vehicle.id === scene.chosen ? token("--bad") : token("--ink");
    context.lineWidth = 2;
    context.beginPath(); context.arc(x, y, 10, 0, 2 * Math.PI); context.stroke();
    plan.write(context, `${vehicle.id}`, [x + 12, y - 6], { align: "left" });
  }
}

/** A footprint with a line to its front. @param {import("./plan.js").Plan} plan @param {CanvasRenderingContext2D} context @param {number[]} box @param {string} colour @param {number[]} dash */
function outline(plan, context, box, colour, dash) {
  const corners = footprint(box), front = [(corners[0][0] + corners[3][0]) / 2, (corners[0][1] + corners[3][1]) / 2];
  context.strokeStyle = colour;
  context.lineWidth = 2;
  context.setLineDash(dash);
  plan.trace(context, corners, true);
  context.stroke();
  plan.trace(context, [[box[0], box[1]], front]);
  context.stroke();
  context.setLineDash([]);
}

/**
 * A frame with what was found in it, or is reprojected into it.
 * @param {HTMLCanvasElement} canvas @param {import("./projection.js").Camera} camera @param {number} index of the camera @param {ImageBitmap|null|undefined} image @param {Scene} scene
 */
export function drawInstantView(canvas, camera, index, image, scene) {
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d")), scale = canvas.width / camera.width;
  context.fillStyle = "#14181d";
  context.fillRect(0, 0, canvas.width, canvas.height);
  if (image) context.drawImage(image, 0, 0, canvas.width, canvas.height);
  const detections = scene.findings.detections[camera.id] ?? [], px = (/** @type {number} */ value) => (value + 0.5) * scale;
  for (const seen of detections) {
    const mine = scene.chosen === null || seen.vehicle === scene.chosen;
    if (!mine && scene.show === "association") continue;
    const [x0, y0, x1, y1] = seen.box_px;
    context.strokeStyle = scene.show === "association" ? cameraColour(index) : "#ffffff";
    context.lineWidth = scene.show === "association" ? 2 : 1;
    context.setLineDash(seen.vehicle === null ? [4, 4] : []);
    context.strokeRect(px(x0), px(y0), (x1 - x0) * scale, (y1 - y0) * scale);
    context.setLineDash([]);
    if (scene.show !== "association" || seen.vehicle === null) continue;
    context.font = "600 13px system-ui, sans-serif";
    context.fillStyle = "rgb(10 14 18 / .8)";
    context.fillRect(px(x0), px(y0) - 16, 10 + 8 * String(seen.vehicle).length, 16);
    context.fillStyle = "#ffffff";
    context.textAlign = "left";
    context.fillText(String(seen.vehicle), px(x0) + 4, px(y0) - 4);
  }
  const boxes = scene.show === "fits" ? [{ colour: "#49d17c", dash: /** @type {number[]} */ ([]), boxes: scene.findings.fits.map((/** @type {any} */ fit) => fit.box) }] : scene.show === "networks" ? networkBoxes(scene).map((one) => ({ ...one, colour: one.name === "before" ? "#ff9b63" : "#6cb0f5" })) : [];
  for (const { colour, dash, boxes: all } of boxes) {
    context.strokeStyle = colour;
    context.lineWidth = 1.8;
    context.setLineDash(dash);
    for (const box of all) {
      const edges = camera.boxEdges(box);
      if (!camera.around(edges)) continue;
      context.beginPath();
      for (const edge of edges) edge.forEach(([u, v], point) => { if (point) context.lineTo(px(u), px(v)); else context.moveTo(px(u), px(v)); });
      context.stroke();
    }
    context.setLineDash([]);
  }
}
