// Labels on their way to the service: saved by themselves, kept in the browser until they are, merged where two people edit.
import { get, Problem, query, request } from "./api.js";
import { merged } from "./labelmodel.js";
import { mergedRegions } from "./labelregions.js";

const WAIT_MS = 700, AGAIN_MS = 4000;

/** @typedef {import("./labelmodel.js").Vehicle} Vehicle */
/** @typedef {import("./labelregions.js").Region} Region */
/**
 * @typedef {Object} Draft what is not saved yet
 * @property {number} version that it was made from
 * @property {Vehicle[]} base of that version
 * @property {Region[]} baseRegions
 * @property {Vehicle[]} vehicles
 * @property {Region[]} regions
 * @property {boolean} finished
 * @property {number} seconds
 */

/** Labels of one instant in one set. */
export class LabelStore {
  /**
   * @param {string} jobId @param {string} set @param {number} timeNs
   * @param {{author: () => string, saved: (answer: any) => void, said: (text: string, bad?: boolean) => void, merge: (found: {vehicles: Vehicle[], regions: Region[], both: any[]}, author: string) => Promise<Vehicle[]>}} page
   */
  constructor(jobId, set, timeNs, page) {
    this.path = `/v1/jobs/${jobId}/labels/instants/${timeNs}${query({ set })}`;
    this.key = `wibam-labels ${jobId} ${set} ${timeNs}`;
    this.page = page;
    this.version = 0;
    /** @type {Vehicle[]} */
    this.base = [];
    /** @type {Region[]} */
    this.baseRegions = [];
    /** @type {Draft|null} */
    this.draft = null;
    this.timer = 0;
    this.busy = /** @type {Promise<void>|null} */ (null);
  }

  /**
   * What to show: as saved, or as left unsaved in this browser. Meanwhile nothing is saved, or the answer would be of before.
   * @param {Promise<unknown>} beside what is needed to show it, too @param {AbortSignal} signal
   * @returns {Promise<{answer: any, draft: Draft|null}>}
   */
  async open(beside, signal) {
    while (this.busy) await this.busy;
    const opened = this.#open(beside, signal), done = () => { this.busy = null; };
    this.busy = opened.then(done, done);
    return opened;
  }

  /** @param {Promise<unknown>} beside @param {AbortSignal} signal @returns {Promise<{answer: any, draft: Draft|null}>} */
  async #open(beside, signal) {
    const [answer] = await Promise.all([get(this.path, { signal }), beside]), kept = localStorage.getItem(this.key);
    this.version = answer.version;
    this.base = answer.labels.vehicles;
    this.baseRegions = answer.labels.regions;
    if (kept === null) return { answer, draft: null };
    this.draft = /** @type {Draft} */ ({ regions: [], baseRegions: [], ...JSON.parse(kept) });
    return { answer, draft: this.draft };
  }

  /** Remember at once, and save soon. @param {Vehicle[]} vehicles @param {Region[]} regions @param {boolean} finished @param {number} seconds */
  put(vehicles, regions, finished, seconds) {
    const from = this.draft ?? { version: this.version, base: this.base, baseRegions: this.baseRegions };
    this.draft = { version: from.version, base: from.base, baseRegions: from.baseRegions, vehicles, regions, finished, seconds };
    localStorage.setItem(this.key, JSON.stringify(this.draft));
    this.page.said("saving …");
    this.#soon(WAIT_MS);
  }

  /** Save now what is unsaved; resolves when it is, or cannot be. @returns {Promise<void>} */
  async flush() {
    clearTimeout(this.timer);
    while (this.busy) await this.busy;
    if (!this.draft) return;
    this.busy = this.#save();
    await this.busy;
  }

  /** @param {number} ms */
  #soon(ms) {
    clearTimeout(this.timer);
    this.timer = window.setTimeout(() => this.flush(), ms);
  }

  async #save() {
    const draft = /** @type {Draft} */ (this.draft);
    try {
      const response = await request("PUT", this.path, {
        body: { author: this.page.author(), vehicles: draft.vehicles, regions: draft.regions, finished: draft.finished, seconds: draft.seconds },
        headers: { "If-Match": `"${draft.version}"` },
      });
      const answer = await response.json();
      this.version = answer.version;
      this.base = draft.vehicles;
      this.baseRegions = draft.regions;
      if (this.draft === draft) this.#forget();
      else if (this.draft) this.draft = { ...this.draft, version: this.version, base: this.base, baseRegions: this.baseRegions };
      this.page.saved(answer);
      this.page.said(`saved as version ${answer.version}`);
    } catch (error) {
      await this.#failed(error, draft);
    } finally {
      this.busy = null;
    }
  }

  /** @param {unknown} error @param {Draft} draft */
  async #failed(error, draft) {
    if (!(error instanceof Problem)) throw error;
    if (error.code === "changed_meanwhile") {
      const theirs = await get(this.path), regions = mergedRegions(draft.baseRegions, draft.regions, theirs.labels.regions);
      const found = { ...merged(draft.base, draft.vehicles, theirs.labels.vehicles), regions };
      this.version = theirs.version;
      this.base = theirs.labels.vehicles;
      this.baseRegions = theirs.labels.regions;
      const vehicles = await this.page.merge(found, theirs.author);
      this.draft = { ...draft, version: this.version, base: this.base, baseRegions: this.baseRegions, vehicles, regions };
      localStorage.setItem(this.key, JSON.stringify(this.draft));
      this.#soon(0);
      return;
    }
    const again = error.code === "unreachable" || error.status >= 500 || error.status === 401;
    this.page.said(`not saved: ${error.message}. It is kept in this browser${again ? ", and saved when the service answers" : ""}. ${error.hint}`, true);
    if (again) this.#soon(AGAIN_MS);
  }

  #forget() {
    this.draft = null;
    localStorage.removeItem(this.key);
  }
}
