// A camera's recording on one scale of time, be it one file or several chapters.
import { get } from "./api.js";

/** Whether a camera's size follows its recording's: no point and no region is set in its pixels yet. @param {any} camera as the site describes it */
export function follows(camera) {
  return camera.calibration.correspondences?.length === 0 && !camera.signals.length;
}

/**
 * A site with a camera as large as its recording's pictures; null where it is, or where its size does not follow them.
 * @param {any} site its description @param {string} id of the camera @param {any} header of the recording
 */
export function resized(site, id, header) {
  const camera = site.cameras.find((/** @type {any} */ one) => one.id === id), { width_px, height_px } = header;
  if (!camera || !follows(camera)) return null; // it may have been taken out of the site
  if (camera.width_px === width_px && camera.height_px === height_px) return null;
  return { ...site, cameras: site.cameras.map((/** @type {any} */ one) => (one === camera ? { ...one, width_px, height_px } : one)) };
}

/** The files of a recording, in their order. */
export class Footage {
  /** @param {string[]} paths addresses of the files */
  constructor(paths) {
    this.parts = paths.map((path) => ({ path, start: 0, length: 0 }));
    /** @type {any} of the first file */
    this.header = null;
    this.loading = /** @type {Promise<void>|null} */ (null);
  }

  /** Ask how long the files are; until then all times are of the first. */
  load() {
    this.loading = this.#read();
    return this.loading;
  }

  /** Wait for what is being asked. @returns {Promise<boolean>} whether it is known how long the files are */
  async isRead() {
    await this.loading?.catch(() => {}); // whoever asked says what went wrong
    return this.header !== null;
  }

  async #read() {
    const headers = await Promise.all(this.parts.map((part) => get(`${part.path}/header`)));
    let start = 0;
    headers.forEach((header, index) => {
      Object.assign(this.parts[index], { start, length: header.duration_s });
      start += header.duration_s;
    });
    this.header = headers[0];
  }

  /** Length of all, s; 0 where no header says it. */
  get length() {
    return this.parts.reduce((sum, part) => sum + part.length, 0);
  }

  /** The file that shows a time of the whole, and when in it. @param {number} time s */
  at(time) {
    const part = this.parts.findLast((one) => one.start <= time && (one.length > 0 || one === this.parts[0])) ?? this.parts[0];
    return { path: part.path, time: Math.max(0, time - part.start), start: part.start };
  }
}
