// Cuboids to take hold of: in the plan and in every view, with handles on the chosen one.
import { FACES, faceCentre, later, outward } from "./labelmodel.js";
import { footprint } from "./projection.js";
import { token } from "./plan.js";

const HANDLE_PX = 5, KNOB_PX = 26, NEAR_PX = 9, MOST_ALONG = 0.8; // px of the screen; cosine to the line of sight

/** The chosen one is white with a dark border, which no class is. */
const CHOSEN = [["#10161c", 3.4], ["#ffffff", 1.6]];

/** @typedef {import("./labelmodel.js").Vehicle} Vehicle */
/** @typedef {{kind: "body"|"turn"|"face", id: number, face?: {name: string, size: number, side: number}}} Grip what a pointer has taken hold of */

/** Where one turns a box in the plan: ahead of its front. @param {import("./plan.js").Plan} plan @param {number[]} box @returns {number[]} canvas px */
function knob(plan, box) {
  const [x, y] = plan.toCanvas(faceCentre(box, FACES[0]));
  const away = KNOB_PX * plan.unit;
  return [x + away * Math.cos(box[6]), y - away * Math.sin(box[6])];
}

/** @param {import("./plan.js").Plan} plan @param {CanvasRenderingContext2D} context @param {Vehicle[]} vehicles @param {number|null} chosen @param {Map<string, string>} colours */
export function drawVehicles(plan, context, vehicles, chosen, colours) {
  for (const vehicle of vehicles) {
    const marked = vehicle.id === chosen, [x, y] = plan.toCanvas(vehicle.box), nose = plan.toCanvas(faceCentre(vehicle.box, FACES[0]));
    plan.trace(context, footprint(vehicle.box), true);
    context.setLineDash(vehicle.ignored ? [5, 4] : []);
    context.globalAlpha = vehicle.ignored ? 0.15 : 0.45;
    context.fillStyle = colours.get(vehicle.class) ?? "#888888";
    context.fill();
    context.globalAlpha = 1;
    context.strokeStyle = marked ? token("--focus") : token("--ink");
    context.lineWidth = marked ? 3 : 1.2;
    context.stroke();
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(nose[0], nose[1]);
    context.stroke();
    context.setLineDash([]);
    plan.write(context, String(vehicle.id), [x, y - 7], { size: 11 });
    if (!marked) continue;
    const [u, v] = knob(plan, vehicle.box);
    context.beginPath();
    context.moveTo(nose[0], nose[1]);
    context.lineTo(u, v);
    context.stroke();
    context.beginPath();
    context.arc(u, v, HANDLE_PX * plan.unit, 0, 2 * Math.PI);
    context.fillStyle = token("--focus");
    context.fill();
    for (const face of FACES.slice(0, 4)) square(context, plan.toCanvas(faceCentre(vehicle.box, face)), HANDLE_PX * plan.unit);
  }
}

/** @param {CanvasRenderingContext2D} context @param {number[]} at @param {number} half */
function square(context, at, half) {
  context.fillStyle = "#f5b301";
  context.strokeStyle = "#1b2530";
  context.lineWidth = 1;
  context.fillRect(at[0] - half, at[1] - half, 2 * half, 2 * half);
  context.strokeRect(at[0] - half, at[1] - half, 2 * half, 2 * half);
}

/**
 * @param {import("./frameview.js").FrameView} view @param {CanvasRenderingContext2D} context @param {import("./projection.js").Camera} camera
 * @param {Vehicle[]} vehicles @param {number|null} chosen @param {Map<string, string>} colours @param {number} lateS how much later than the instant the frame was exposed
 */
export function drawCuboids(view, context, camera, vehicles, chosen, colours, lateS) {
  for (const vehicle of vehicles) {
    const marked = vehicle.id === chosen, box = later(vehicle, lateS), edges = camera.boxEdges(box), around = camera.around(edges);
    if (!around) continue;
    const lines = [...edges, ...frontCross(camera, box)];
    context.setLineDash(vehicle.ignored ? [6, 5] : []);
    for (const [colour, width] of marked ? CHOSEN : [[colours.get(vehicle.class) ?? "#888888", 1.2]]) {
      context.strokeStyle = String(colour);
      context.lineWidth = Number(width) * view.unit;
      for (const line of lines) {
        view.trace(context, line);
        context.stroke();
      }
    }
    context.setLineDash([]);
    const [x, y] = view.toCanvas([(around[0] + around[2]) / 2, around[1]]);
    view.write(context, String(vehicle.id), [x, y - 6], { size: 11, ink: "#ffffff", halo: "rgb(10 14 18 / .8)" });
    if (!marked) continue;
    for (const { at } of handles(view, camera, box)) square(context, at, HANDLE_PX * view.unit);
  }
}

/**
 * The handles of a box in a view: not of faces that look at the camera or away from it. Pulling these would say nothing, and
 * they lie over the middle, where one takes hold of the whole box.
 * @param {import("./frameview.js").FrameView} view @param {import("./projection.js").Camera} camera @param {number[]} box
 */
function handles(view, camera, box) {
  const sight = [0, 1, 2].map((k) => box[k] - camera.centre[k]), away = Math.hypot(...sight), found = [];
  for (const face of FACES) {
    const axis = outward(box, face), along = Math.abs(axis.reduce((sum, value, k) => sum + value * sight[k], 0)) / away;
    const pixel = along < MOST_ALONG ? camera.project(faceCentre(box, face)) : null;
    if (pixel) found.push({ face, at: view.toCanvas(pixel) });
  }
  return found;
}

/** A cross over the front says where a box heads: two lines in px. @param {import("./projection.js").Camera} camera @param {number[]} box */
function frontCross(camera, box) {
  const [x, y, z] = faceCentre(box, FACES[0]), c = Math.cos(box[6]), s = Math.sin(box[6]);
  const at = (/** @type {number} */ left, /** @type {number} */ up) => [x - (s * left * box[4]) / 2, y + (c * left * box[4]) / 2, z + (up * box[5]) / 2];
  return [camera.line(at(1, -1), at(-1, 1)), camera.line(at(-1, -1), at(1, 1))];
}

/** The handle within reach that is nearest, unless the middle of the box is nearer. @template {{at: number[]}} T @param {T[]} grips @param {number[]} at @param {number[]} middle @param {number} reach @returns {T|null} */
function nearest(grips, at, middle, reach) {
  const distance = (/** @type {number[]} */ point) => Math.hypot(point[0] - at[0], point[1] - at[1]);
  const found = grips.reduce((best, grip) => (best && distance(best.at) <= distance(grip.at) ? best : grip), /** @type {T|null} */ (null));
  return found && distance(found.at) <= reach && distance(found.at) < distance(middle) ? found : null;
}

/** What lies under a pointer in the plan. @param {import("./plan.js").Plan} plan @param {number[]} world @param {Vehicle[]} vehicles @param {Vehicle|undefined} chosen @returns {Grip|null} */
export function gripInPlan(plan, world, vehicles, chosen) {
  if (chosen) {
    const grips = [{ face: /** @type {typeof FACES[number]|null} */ (null), at: knob(plan, chosen.box) }, ...FACES.slice(0, 4).map((face) => ({ face, at: plan.toCanvas(faceCentre(chosen.box, face)) }))];
    const grip = nearest(grips, plan.toCanvas(world), plan.toCanvas(chosen.box), NEAR_PX * plan.unit);
    if (grip) return grip.face ? { kind: "face", id: chosen.id, face: grip.face } : { kind: "turn", id: chosen.id };
  }
  const under = vehicles.filter((vehicle) => {
    const dx = world[0] - vehicle.box[0], dy = world[1] - vehicle.box[1], c = Math.cos(vehicle.box[6]), s = Math.sin(vehicle.box[6]);
    return Math.abs(c * dx + s * dy) <= vehicle.box[3] / 2 && Math.abs(c * dy - s * dx) <= vehicle.box[4] / 2;
  });
  const hit = under.find((vehicle) => vehicle.id === chosen?.id) ?? under[0];
  return hit ? { kind: "body", id: hit.id } : null;
}

/** What lies under a pointer in a view. @param {import("./frameview.js").FrameView} view @param {import("./projection.js").Camera} camera @param {number[]} pixel @param {Vehicle[]} vehicles @param {Vehicle|undefined} chosen @param {number} lateS @returns {Grip|null} */
export function gripInView(view, camera, pixel, vehicles, chosen, lateS) {
  const box = chosen ? later(chosen, lateS) : null, middle = box ? camera.project(box.slice(0, 3)) : null;
  if (chosen && box && middle) {
    const grip = nearest(handles(view, camera, box), view.toCanvas(pixel), view.toCanvas(middle), NEAR_PX * view.unit);
    if (grip) return { kind: "face", id: chosen.id, face: grip.face };
  }
  const under = vehicles.filter((vehicle) => {
    const around = camera.boxAround(later(vehicle, lateS));
    return around && pixel[0] >= around[0] && pixel[0] <= around[2] && pixel[1] >= around[1] && pixel[1] <= around[3];
  });
  const distance = (/** @type {Vehicle} */ vehicle) => Math.hypot(...[0, 1, 2].map((k) => vehicle.box[k] - camera.centre[k]));
  const hit = under.find((vehicle) => vehicle.id === chosen?.id) ?? under.sort((a, b) => distance(a) - distance(b))[0];
  return hit ? { kind: "body", id: hit.id } : null;
}
