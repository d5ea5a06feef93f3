// What is being labelled at one instant: vehicles that are never changed but replaced, so that undoing is remembering.

/**
 * @typedef {Object} Vehicle as the API has it
 * @property {number} id
 * @property {string} class
 * @property {number[]} box x, y, z, length, width, height (m), yaw (rad)
 * @property {number[]} velocity_mps along X and Y
 * @property {Object<string, number>} visibility corrected by hand
 * @property {boolean} ignored
 * @property {number} seconds
 */

/** @typedef {import("./labelregions.js").Region} Region */
/** @typedef {{vehicles: Vehicle[], regions: Region[], finished: boolean}} Step */

/** Faces of a box: which size they change (its place in a box), and in which direction. */
export const FACES = /** @type {Array<{name: string, size: number, side: number}>} */ ([
  { name: "front", size: 3, side: 1 }, { name: "back", size: 3, side: -1 }, { name: "left", size: 4, side: 1 }, { name: "right", size: 4, side: -1 }, { name: "top", size: 5, side: 1 },
]);
const SMALLEST_M = 0.2, LARGEST_M = 40, KEPT_STEPS = 300;

/** An angle in (−π, π]. @param {number} angle */
export function normalised(angle) {
  return angle - 2 * Math.PI * Math.ceil(angle / (2 * Math.PI) - 0.5);
}

/** Unit vector in the world that a face looks along. @param {number[]} box @param {{size: number, side: number}} face @returns {number[]} */
export function outward(box, face) {
  const c = Math.cos(box[6]), s = Math.sin(box[6]);
  const axis = face.size === 3 ? [c, s, 0] : face.size === 4 ? [-s, c, 0] : [0, 0, 1];
  return axis.map((value) => value * face.side);
}

/** Middle of a face in the world. @param {number[]} box @param {{size: number, side: number}} face @returns {number[]} */
export function faceCentre(box, face) {
  const axis = outward(box, face), half = box[face.size] / 2;
  return [0, 1, 2].map((k) => box[k] + axis[k] * half);
}

/** Move a face outwards; the one opposite stays where it is. @param {number[]} box @param {{size: number, side: number}} face @param {number} byM @returns {number[]} */
export function stretched(box, face, byM) {
  const size = Math.min(LARGEST_M, Math.max(SMALLEST_M, box[face.size] + byM)), by = size - box[face.size], axis = outward(box, face), found = [...box];
  found[face.size] = size;
  for (const k of [0, 1, 2]) found[k] += (axis[k] * by) / 2;
  return found;
}

/** @param {number[]} box @param {number} dx m @param {number} dy @returns {number[]} */
export function moved(box, dx, dy) {
  return [box[0] + dx, box[1] + dy, ...box.slice(2)];
}

/** Moved in its own frame. @param {number[]} box @param {number} forward m @param {number} left m @returns {number[]} */
export function driven(box, forward, left) {
  const c = Math.cos(box[6]), s = Math.sin(box[6]);
  return moved(box, c * forward - s * left, s * forward + c * left);
}

/** @param {number[]} box @param {number} yaw @returns {number[]} */
export function heading(box, yaw) {
  return [...box.slice(0, 6), normalised(yaw)];
}

/** Put on the ground. @param {number[]} box @returns {number[]} */
export function grounded(box) {
  return [box[0], box[1], box[5] / 2, ...box.slice(3)];
}

/** Where a vehicle is a little later, as it moves. @param {Vehicle} vehicle @param {number} seconds @returns {number[]} */
export function later(vehicle, seconds) {
  return moved(vehicle.box, vehicle.velocity_mps[0] * seconds, vehicle.velocity_mps[1] * seconds);
}

/** The vehicles of one instant, which of them is chosen, and the way back. */
export class Model {
  /** @param {() => void} changed called after every change */
  constructor(changed) {
    this.changed = changed;
    /** @type {Vehicle[]} */
    this.vehicles = [];
    /** @type {Region[]} */
    this.regions = [];
    this.finished = false;
    /** @type {number|null} */
    this.chosen = null;
    /** @type {Step[]} */
    this.past = [];
    /** @type {Step[]} */
    this.future = [];
    this.step = /** @type {string|null} */ (null);
    this.isOpen = false;
  }

  /** Leave an instant: until another is loaded there is nothing to change, since nobody would save it. */
  close() {
    [this.vehicles, this.past, this.future, this.isOpen] = [[], [], [], false];
  }

  /** Begin with another instant. @param {Vehicle[]} vehicles @param {boolean} finished @param {Region[]} regions */
  load(vehicles, finished, regions) {
    this.vehicles = vehicles;
    this.regions = regions;
    this.finished = finished;
    this.past = [];
    this.future = [];
    this.step = null;
    this.isOpen = true;
    if (!vehicles.some((vehicle) => vehicle.id === this.chosen)) this.chosen = vehicles[0]?.id ?? null;
  }

  /** @returns {Vehicle|undefined} */
  get current() {
    return this.vehicles.find((vehicle) => vehicle.id === this.chosen);
  }

  /** Replace everything. @param {Vehicle[]} vehicles @param {{finished?: boolean, regions?: Region[], step?: string|null}} [how] changes of one `step` are undone together */
  replace(vehicles, { finished = this.finished, regions = this.regions, step = null } = {}) {
    if (!this.isOpen) return;
    if (step === null || step !== this.step) {
      this.past.push({ vehicles: this.vehicles, regions: this.regions, finished: this.finished });
      if (this.past.length > KEPT_STEPS) this.past.shift();
    }
    this.step = step;
    this.future = [];
    this.vehicles = vehicles;
    this.regions = regions;
    this.finished = finished;
    this.changed();
  }

  /** The next change is a step of its own. */
  endStep() {
    this.step = null;
  }

  /** Change the chosen vehicle. @param {Partial<Vehicle>} change @param {string|null} [step] */
  update(change, step = null) {
    if (!this.current) return;
    this.replace(this.vehicles.map((vehicle) => (vehicle.id === this.chosen ? { ...vehicle, ...change } : vehicle)), { step });
  }

  /** Add a vehicle, and choose it. @param {string} kind @param {number[]} box @param {number[]} [taken] ids that mean other vehicles */
  add(kind, box, taken = []) {
    if (!this.isOpen) return;
    const id = 1 + Math.max(0, ...this.vehicles.map((vehicle) => vehicle.id), ...taken);
    this.chosen = id;
    this.replace([...this.vehicles, { id, class: kind, box, velocity_mps: [0, 0], visibility: {}, ignored: false, seconds: 0 }], { step: `add ${id}` });
  }

  remove() {
    const at = this.vehicles.findIndex((vehicle) => vehicle.id === this.chosen);
    if (at < 0) return;
    const left = this.vehicles.filter((vehicle) => vehicle.id !== this.chosen);
    this.chosen = left[Math.min(at, left.length - 1)]?.id ?? null;
    this.replace(left);
  }

  /** Choose the next or the previous vehicle. @param {number} by */
  cycle(by) {
    if (!this.vehicles.length) return;
    const at = this.vehicles.findIndex((vehicle) => vehicle.id === this.chosen), count = this.vehicles.length;
    this.chosen = this.vehicles[(((at < 0 && by < 0 ? 0 : at) + by) % count + count) % count].id;
  }

  undo() {
    this.#go(this.past, this.future);
  }

  redo() {
    this.#go(this.future, this.past);
  }

  /** @param {Step[]} from @param {Step[]} to */
  #go(from, to) {
    const found = from.pop();
    if (!found) return;
    to.push({ vehicles: this.vehicles, regions: this.regions, finished: this.finished });
    this.vehicles = found.vehicles;
    this.regions = found.regions;
    this.finished = found.finished;
    this.step = null;
    if (!this.current) this.chosen = this.vehicles[0]?.id ?? null;
    this.changed();
  }
}

/**
 * Put two people's changes of the same vehicles together.
 * @param {Vehicle[]} base what both began with @param {Vehicle[]} mine @param {Vehicle[]} theirs
 * @returns {{vehicles: Vehicle[], both: Array<{id: number, mine: Vehicle|null, theirs: Vehicle|null}>}} what only one changed
 *   is as that one left it; of what both changed, mine stands, and `both` names it
 */
export function merged(base, mine, theirs) {
  const by = (/** @type {Vehicle[]} */ all) => new Map(all.map((vehicle) => [vehicle.id, vehicle]));
  const [b, m, t] = [by(base), by(mine), by(theirs)];
  const same = (/** @type {Vehicle|undefined} */ one, /** @type {Vehicle|undefined} */ other) => said(one) === said(other);
  /** @type {Vehicle[]} */
  const vehicles = [];
  const both = [];
  for (const id of new Set([...m.keys(), ...t.keys(), ...b.keys()])) {
    const keep = same(m.get(id), b.get(id)) ? t.get(id) : m.get(id);
    if (keep) vehicles.push(keep);
    if (!same(m.get(id), b.get(id)) && !same(t.get(id), b.get(id)) && !same(m.get(id), t.get(id))) both.push({ id, mine: m.get(id) ?? null, theirs: t.get(id) ?? null });
  }
  return { vehicles, both };
}

/** What a vehicle says, whatever the order of its fields and the time it took. @param {Vehicle|undefined} vehicle */
function said(vehicle) {
  if (!vehicle) return "";
  return JSON.stringify([vehicle.class, vehicle.box, vehicle.velocity_mps, Object.entries(vehicle.visibility).sort(), vehicle.ignored]);
}
