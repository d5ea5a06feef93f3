// A job's tracks and the instants of its frames, a few seconds at a time: fetched before they are shown, forgotten afterwards.
import { get, query, request } from "./api.js";
import { statesOf, Tracks } from "./trackdata.js";

/** How long a window is, how far frames may lie from what they are shown with, and when what failed is asked for again. */
const WINDOW_NS = 4e9, MARGIN_NS = 200_000_000, AGAIN_MS = 3000;
/** A frame that is shown with an instant lies no farther from it. */
const NEAR_NS = 120_000_000;
/** Answers of the kind "your request is wrong" that may be others a little later: it took too long, there were too many. */
const PASSING = [408, 429];
/** So many windows beyond what is needed are kept on both sides, for whoever goes back and forth. */
const SPARE = 2;

/** @param {import("./trackdata.js").State} state */
const keyOf = (state) => `${state.time_ns}/${state.track_id}`;

/**
 * @typedef {Object} Part one window
 * @property {import("./trackdata.js").State[]} states
 * @property {number[]} instants of stored frames, those a little beyond its ends, too
 * @property {Object<string, Array<number|null>>} exposures camera -> when it exposed the frame of each instant
 * @property {string|null} area of which is known who is in it
 * @property {Set<string>} inside keys of the states in it
 */

/** The job has been restarted since, and has made others. */
class OtherTracks extends Error {}

/** What is known of the time around the one that is shown. */
export class TrackWindows {
  /**
   * @param {string} jobId @param {number} firstNs of all states @param {number} lastNs
   * @param {{version: string, frames: boolean, arrived: () => void, failed: (error: unknown) => void, changed: () => void}} page
   *   `version`: the SHA-256 of the job's tracks; `frames`: whether any are stored; `arrived`: there is more to show; `changed`: the
   *   job may have been restarted, and nothing more is asked for until the page takes `over` back
   */
  constructor(jobId, firstNs, lastNs, page) {
    this.path = `/v1/jobs/${jobId}`;
    /** The API's `polygon`. @type {string|null} */
    this.area = null;
    this.over = false;
    this.firstNs = firstNs;
    this.last = Math.floor((lastNs - firstNs) / WINDOW_NS);
    this.page = page;
    /** @type {Map<number, Part>} */
    this.parts = new Map();
    /** @type {Map<number, AbortController>} */
    this.loading = new Map();
    /** Those that the service has refused: asking again would not help. @type {Set<number>} */
    this.no = new Set();
    /** Nothing is asked for now, since it failed a moment ago; whether that was said. */
    this.failing = this.said = false;
    /** The windows that are joined in what follows, all in a row: the first, and the one after the last. */
    this.joined = [0, 0];
    this.tracks = new Tracks([]);
    /** @type {number[]} */
    this.instants = [];
    /** @type {Object<string, Array<number|null>>} */
    this.exposures = {};
  }

  /** @param {number} timeNs */
  #number(timeNs) {
    return Math.min(Math.max(Math.floor((timeNs - this.firstNs) / WINDOW_NS), 0), this.last);
  }

  /** @param {number} number */
  #isWhole(number) {
    return this.parts.get(number)?.area === this.area;
  }

  /** Whether all that is known of a time is here. @param {number} timeNs */
  has(timeNs) {
    return this.#isWhole(this.#number(timeNs));
  }

  /** From now on ask who is in an area, too: places are rounded here, and the service knows them. @param {string|null} polygon as the API wants it */
  within(polygon) {
    if (polygon === this.area) return;
    this.area = polygon;
    for (const control of this.loading.values()) control.abort();
    this.loading.clear();
    this.no.clear(); // the area before may have been what was refused
  }

  /** Whether a state is in the area; undefined as long as the service has not said so, and where none was asked for. @param {import("./trackdata.js").State} state @returns {boolean|undefined} */
  inside(state) {
    const part = this.parts.get(this.#number(state.time_ns));
    return this.area !== null && part?.area === this.area ? part.inside.has(keyOf(state)) : undefined;
  }

  /** Whether the service has refused to say what is known of a time. @param {number} timeNs */
  refused(timeNs) {
    return this.no.has(this.#number(timeNs));
  }

  /** The stored instant nearest to a time, of which a camera has a frame. @param {string} camera @param {number} timeNs @returns {number|null} */
  frameAt(camera, timeNs) {
    const times = this.exposures[camera], { instants } = this;
    if (!times) return null;
    let low = 0, high = instants.length;
    while (low < high) { const middle = (low + high) >> 1; if (instants[middle] < timeNs) low = middle + 1; else high = middle; }
    let best = /** @type {number|null} */ (null);
    for (const at of [low - 1, low]) {
      if (at < 0 || at >= instants.length || times[at] === null) continue;
      if (Math.abs(instants[at] - timeNs) <= NEAR_NS && (best === null || Math.abs(instants[at] - timeNs) < Math.abs(best - timeNs))) best = instants[at];
    }
    return best;
  }

  /** When a camera exposed its frame of an instant. @param {string} camera @param {number} instant @returns {number} */
  exposedAt(camera, instant) {
    return this.exposures[camera]?.[this.instants.indexOf(instant)] ?? instant;
  }

  /**
   * Say which time is shown, and what is needed around it.
   * @param {number} nowNs @param {number} fromNs @param {number} toNs @param {boolean} [load] whether to ask for what is not here
   */
  want(nowNs, fromNs, toNs, load = true) {
    const now = this.#number(nowNs), from = this.#number(fromNs), to = this.#number(toNs);
    for (const [number, control] of this.loading) if (number < from || number > to) { control.abort(); this.loading.delete(number); }
    for (const number of this.parts.keys()) if (number < from - SPARE || number > to + SPARE) this.parts.delete(number);
    if (load && !this.failing && !this.over) {
      for (let by = 0; by <= to - from; by += 1) {
        for (const number of by ? [now + by, now - by] : [now]) {
          if (number >= from && number <= to && !this.#isWhole(number) && !this.loading.has(number) && !this.no.has(number)) this.#load(number);
        }
      }
    }
    this.#join(now);
  }

  /** @param {number} number */
  async #load(number) {
    const control = new AbortController(), options = { signal: control.signal }, { area } = this;
    this.loading.set(number, control);
    try {
      const [part, inside] = await Promise.all([this.parts.get(number) ?? this.#part(number, options), area === null ? [] : this.#states(number, area, options)]);
      if (control.signal.aborted) return;
      this.parts.set(number, { ...part, area, inside: new Set(inside.map(keyOf)) });
      this.loading.delete(number);
      this.said = false;
      this.page.arrived();
    } catch (error) {
      if (control.signal.aborted) return;
      this.loading.delete(number);
      if (error instanceof OtherTracks || /** @type {any} */ (error).status === 409) {
        if (!this.over) this.page.changed();
        this.over = true;
        this.#pause();
        return;
      }
      if (!this.said) this.page.failed(error);
      this.said = true;
      const status = /** @type {any} */ (error).status ?? 0;
      if (status >= 400 && status < 500 && !PASSING.includes(status)) { this.no.add(number); this.page.arrived(); return; }
      this.#pause();
    }
  }

  /** Ask for nothing for a moment. */
  #pause() {
    this.failing = true;
    setTimeout(() => { this.failing = false; this.page.arrived(); }, AGAIN_MS);
  }

  /** @param {number} number @returns {[number, number]} ns */
  #ends(number) {
    const start = this.firstNs + number * WINDOW_NS;
    return [start, start + WINDOW_NS];
  }

  /** @param {number} number @param {{signal: AbortSignal}} options */
  async #part(number, options) {
    const [start, end] = this.#ends(number), [states, stored] = await Promise.all([
      this.#states(number, null, options),
      this.page.frames ? get(`${this.path}/instants${query({ start_ns: start - MARGIN_NS, end_ns: end + MARGIN_NS })}`, options) : { times_ns: [], frame_times_ns: {} },
    ]);
    return { states, instants: stored.times_ns, exposures: stored.frame_times_ns };
  }

  /** @param {number} number @param {string|null} polygon @param {{signal: AbortSignal}} options */
  async #states(number, polygon, options) {
    const [start_ns, end_ns] = this.#ends(number);
    /** @type {import("./trackdata.js").State[]} */
    const states = [];
    for (let cursor = null; ;) {
      const response = await request("GET", `${this.path}/tracks/compact${query({ start_ns, end_ns, polygon, cursor })}`, options);
      if (response.headers.get("ETag")?.includes(this.page.version) === false) throw new OtherTracks();
      const page = await response.json();
      for (const state of statesOf(page)) states.push(state);
      cursor = page.next;
      if (!cursor) return states;
    }
  }

  /** Put together all windows that follow each other around one. @param {number} now */
  #join(now) {
    let first = now, after = now;
    while (this.parts.has(after)) after += 1;
    while (after > now && this.parts.has(first - 1)) first -= 1;
    if (this.joined[0] === first && this.joined[1] === after) return;
    this.joined = [first, after];
    const parts = [];
    for (let number = first; number < after; number += 1) parts.push(/** @type {Part} */ (this.parts.get(number)));
    this.tracks = new Tracks(parts.flatMap((part) => part.states));
    this.instants = [];
    this.exposures = {};
    for (const part of parts) {
      const last = this.instants.at(-1) ?? -Infinity, from = part.instants.findIndex((time) => time > last);
      if (from < 0) continue;
      const before = this.instants.length;
      this.instants.push(...part.instants.slice(from));
      for (const [camera, times] of Object.entries(part.exposures)) {
        this.exposures[camera] ??= Array(before).fill(null);
        this.exposures[camera].push(...times.slice(from));
      }
    }
  }
}
