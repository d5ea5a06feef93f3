// What keys and the wheel do to the chosen vehicle.
import { driven, FACES, heading, stretched } from "./labelmodel.js";

const MOVE_M = 0.05, TURN_RAD = Math.PI / 180, COARSE = 10;
const SIZES = /** @type {Object<string, typeof FACES[number]>} */ ({ l: FACES[0], w: FACES[2], h: FACES[4] });

/** The box after a key, or null where the key is none of these. @param {number[]} box @param {KeyboardEvent} event @returns {number[]|null} */
export function boxAfterKey(box, event) {
  const times = event.shiftKey ? COARSE : 1, by = MOVE_M * times, key = event.key.toLowerCase();
  if (SIZES[key]) return both(box, SIZES[key], event.altKey ? -by : by);
  if (event.altKey) return null;
  switch (key) {
    case "arrowup": return driven(box, by, 0);
    case "arrowdown": return driven(box, -by, 0);
    case "arrowleft": return driven(box, 0, by);
    case "arrowright": return driven(box, 0, -by);
    case "q": return heading(box, box[6] + TURN_RAD * times);
    case "e": return heading(box, box[6] - TURN_RAD * times);
    default: return null;
  }
}

/** The box after a turn of the wheel with a key held, or null. @param {number[]} box @param {WheelEvent} event @returns {number[]|null} */
export function boxAfterWheel(box, event) {
  const turned = Math.sign(event.deltaY || event.deltaX);
  if (!turned) return null;
  if (event.shiftKey) return heading(box, box[6] - turned * TURN_RAD);
  if (event.altKey) return both(box, FACES[0], -turned * MOVE_M);
  return null;
}

/** Stretched at both ends; in height at the top alone. @param {number[]} box @param {typeof FACES[number]} face @param {number} byM */
function both(box, face, byM) {
  if (face.size === 5) return stretched(box, face, byM);
  return stretched(stretched(box, face, byM / 2), { ...face, side: -face.side }, byM / 2);
}
