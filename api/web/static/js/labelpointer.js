// Dragging cuboids, in the plan and in views: from where a drag began and where it is now to the box as it is then.
import { faceCentre, heading, later, moved, outward, stretched } from "./labelmodel.js";

/** @typedef {import("./labelmodel.js").Vehicle} Vehicle */
/** @typedef {import("./labeldraw.js").Grip} Grip */

/** A box after a drag in the plan. @param {number[]} box as the drag began @param {Grip} grip @param {number[]} from world @param {number[]} to @returns {number[]} */
export function draggedInPlan(box, grip, from, to) {
  const dx = to[0] - from[0], dy = to[1] - from[1];
  if (grip.kind === "turn") return heading(box, Math.atan2(to[1] - box[1], to[0] - box[0]));
  if (grip.kind === "face" && grip.face) {
    const axis = outward(box, grip.face);
    return stretched(box, grip.face, axis[0] * dx + axis[1] * dy);
  }
  return moved(box, dx, dy);
}

/**
 * A box after a drag in a view: its body slides over the plane at its middle, a face follows the pointer along its axis.
 * @param {import("./projection.js").Camera} camera @param {Vehicle} vehicle as the drag began @param {Grip} grip @param {number[]} from px @param {number[]} to px @param {number} lateS
 * @returns {number[]}
 */
export function draggedInView(camera, vehicle, grip, from, to, lateS) {
  const { box } = vehicle;
  if (grip.kind === "face" && grip.face) {
    const centre = faceCentre(later(vehicle, lateS), grip.face), axis = outward(box, grip.face), half = 0.25;
    const [near, far] = [-half, half].map((by) => camera.project(centre.map((value, k) => value + by * axis[k])));
    if (!near || !far) return box;
    const along = [(far[0] - near[0]) / (2 * half), (far[1] - near[1]) / (2 * half)], squared = along[0] ** 2 + along[1] ** 2;
    if (squared < 4) return box; // the axis points at the camera: less than 2 px a metre say nothing
    return stretched(box, grip.face, ((to[0] - from[0]) * along[0] + (to[1] - from[1]) * along[1]) / squared);
  }
  const start = camera.ground(from, box[2]), end = camera.ground(to, box[2]);
  return start && end ? moved(box, end[0] - start[0], end[1] - start[1]) : box;
}
