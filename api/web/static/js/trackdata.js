// Tracks in the browser: states by instant, and the filter that the API knows, too.

/**
 * @typedef {Object} State of a road user at one time, rounded for drawing
 * @property {number} time_ns @property {number} track_id @property {string} class
 * @property {number} x_m @property {number} y_m @property {number} z_m
 * @property {number} length_m @property {number} width_m @property {number} height_m @property {number} yaw_rad
 * @property {number} speed_mps
 */

const NUMBERS = /** @type {const} */ (["x_m", "y_m", "z_m", "length_m", "width_m", "height_m", "yaw_rad", "speed_mps"]);

/**
 * States of what `GET /v1/jobs/{id}/tracks/compact` answers, sorted by time. A number that is the same in all states of a track stands there once.
 * @param {any} compact @returns {State[]}
 */
export function statesOf(compact) {
  /** @type {State[][]} */
  const at = compact.times_ns.map(() => []);
  for (const track of compact.tracks) {
    track.at.forEach((/** @type {number} */ place, /** @type {number} */ row) => {
      const state = /** @type {any} */ ({ time_ns: compact.times_ns[place], track_id: track.track_id, class: track.class });
      for (const name of NUMBERS) state[name] = track[name].length === 1 ? track[name][0] : track[name][row];
      at[place].push(state);
    });
  }
  return at.flat();
}

/**
 * @typedef {Object} Filter
 * @property {string[]} classes none: all
 * @property {number|null} minSpeed m/s
 * @property {number|null} startNs
 * @property {number|null} endNs
 * @property {number[][]} polygon corners; fewer than three: everywhere
 */

/** The box of a state, as `projection.js` wants it. @param {State} state @returns {number[]} */
export function boxOf(state) {
  return [state.x_m, state.y_m, state.z_m, state.length_m, state.width_m, state.height_m, state.yaw_rad];
}

/** The API's parameters of a filter. @param {Filter} filter */
export function parameters(filter) {
  return {
    class: filter.classes, min_speed_mps: filter.minSpeed, start_ns: filter.startNs, end_ns: filter.endNs,
    polygon: filter.polygon.length > 2 ? filter.polygon.map((corner) => corner.map((value) => value.toFixed(2)).join(",")).join(";") : null,
  };
}

/** States of a stretch of time. */
export class Tracks {
  /** @param {State[]} states sorted by time */
  constructor(states) {
    /** @type {number[]} */
    this.times = [];
    /** @type {State[][]} */
    this.at = [];
    /** @type {Map<number, State[]>} */
    this.byTrack = new Map();
    for (const state of states) {
      if (this.times.at(-1) !== state.time_ns) { this.times.push(state.time_ns); this.at.push([]); }
      this.at[this.at.length - 1].push(state);
      const track = this.byTrack.get(state.track_id);
      if (track) track.push(state);
      else this.byTrack.set(state.track_id, [state]);
    }
  }

  /** Index of the last instant at or before a time. @param {number} timeNs */
  indexAt(timeNs) {
    let low = 0, high = this.times.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.times[middle] <= timeNs) low = middle + 1;
      else high = middle;
    }
    return Math.max(0, low - 1);
  }

  /** Index of the instant nearest to a time; -1 where there is none within a limit. @param {number} timeNs @param {number} withinNs */
  indexNear(timeNs, withinNs) {
    const before = this.indexAt(timeNs), off = (/** @type {number} */ index) => Math.abs((this.times[index] ?? Infinity) - timeNs);
    const best = off(before + 1) < off(before) ? before + 1 : before;
    return off(best) <= withinNs ? best : -1;
  }

  /**
   * A state moved along its own track to a time nearby: between two states of it, and beyond its ends as between the two there.
   * @param {State} state @param {number} timeNs @returns {State}
   */
  moved(state, timeNs) {
    const own = this.byTrack.get(state.track_id) ?? [];
    if (timeNs === state.time_ns || own.length < 2) return state;
    let low = 1, high = own.length - 1;
    while (low < high) { const middle = (low + high) >> 1; if (own[middle].time_ns < timeNs) low = middle + 1; else high = middle; }
    const a = own[low - 1], b = own[low], share = (timeNs - a.time_ns) / (b.time_ns - a.time_ns);
    const turn = Math.atan2(Math.sin(b.yaw_rad - a.yaw_rad), Math.cos(b.yaw_rad - a.yaw_rad)), between = (/** @type {number} */ from, /** @type {number} */ to) => from + share * (to - from);
    return { ...state, time_ns: timeNs, x_m: between(a.x_m, b.x_m), y_m: between(a.y_m, b.y_m), z_m: between(a.z_m, b.z_m), yaw_rad: a.yaw_rad + share * turn };
  }

  /** States of a track within a stretch up to a time. @param {number} trackId @param {number} untilNs @param {number} lengthNs @returns {State[]} */
  trail(trackId, untilNs, lengthNs) {
    const states = this.byTrack.get(trackId) ?? [];
    return states.filter((state) => state.time_ns <= untilNs && state.time_ns >= untilNs - lengthNs);
  }
}

/**
 * Whether a state is to be shown: what the API answers to `parameters`.
 * @param {State} state @param {Filter} filter @param {boolean} [isInside] whether the service has found it in the polygon; by its rounded place as long as that is not known
 */
export function passes(state, filter, isInside) {
  if (filter.classes.length && !filter.classes.includes(state.class)) return false;
  if (filter.minSpeed !== null && state.speed_mps < filter.minSpeed) return false;
  if (filter.startNs !== null && state.time_ns < filter.startNs) return false;
  if (filter.endNs !== null && state.time_ns >= filter.endNs) return false;
  return filter.polygon.length < 3 || (isInside ?? inside(filter.polygon, state.x_m, state.y_m));
}

/** Even-odd rule, as the service counts. @param {number[][]} polygon @param {number} x @param {number} y */
export function inside(polygon, x, y) {
  let odd = false;
  polygon.forEach(([x0, y0], index) => {
    const [x1, y1] = polygon[(index + 1) % polygon.length];
    if ((y >= y0) !== (y >= y1) && x < x0 + ((y - y0) * (x1 - x0)) / (y1 - y0)) odd = !odd;
  });
  return odd;
}
