// Frames of a job's cameras, fetched ahead and kept for a while; asking never waits.

const KEPT_PER_CAMERA = 60, AT_ONCE = 6;

/** Frames by camera and instant. */
export class FrameCache {
  /** @param {string} jobId @param {number} widthPx @param {() => void} arrived */
  constructor(jobId, widthPx, arrived) {
    this.jobId = jobId;
    this.widthPx = widthPx;
    this.arrived = arrived;
    /** @type {Map<string, ImageBitmap|null>} */
    this.kept = new Map();
    /** @type {Array<[string, number]>} */
    this.wanted = [];
    this.loading = 0;
    this.closed = new AbortController();
  }

  /** Give back all frames, and ask for none any more. */
  close() {
    this.closed.abort();
    this.wanted = [];
    for (const image of this.kept.values()) image?.close();
    this.kept.clear();
  }

  /** The frame, or undefined while it is on its way. @param {string} camera @param {number} timeNs */
  get(camera, timeNs) {
    return this.kept.get(`${camera}/${timeNs}`);
  }

  /** Say what will be needed, the most urgent first; what was wanted before and has not begun is forgotten. @param {Array<[string, number]>} wanted */
  want(wanted) {
    this.wanted = wanted.filter(([camera, time]) => !this.kept.has(`${camera}/${time}`));
    this.#next();
  }

  #next() {
    while (this.loading < AT_ONCE && this.wanted.length) {
      const [camera, time] = /** @type {[string, number]} */ (this.wanted.shift()), key = `${camera}/${time}`;
      if (this.kept.has(key)) continue;
      this.kept.set(key, /** @type {any} */ (undefined));
      this.loading += 1;
      this.#load(camera, time, key);
    }
  }

  /** @param {string} camera @param {number} time @param {string} key */
  async #load(camera, time, key) {
    try {
      const response = await fetch(`/v1/jobs/${this.jobId}/frames/${encodeURIComponent(camera)}?time_ns=${time}&width_px=${this.widthPx}`, { signal: this.closed.signal });
      const image = response.ok ? await createImageBitmap(await response.blob()) : null;
      if (this.closed.signal.aborted) { image?.close(); return; }
      this.kept.set(key, image);
    } catch {
      if (this.closed.signal.aborted) return;
      this.kept.delete(key); // asked for again when it is next needed
    }
    this.loading -= 1;
    this.#forget(camera);
    this.arrived();
    this.#next();
  }

  /** @param {string} camera */
  #forget(camera) {
    const mine = [...this.kept.keys()].filter((key) => key.startsWith(`${camera}/`));
    for (const key of mine.slice(0, Math.max(0, mine.length - KEPT_PER_CAMERA))) {
      this.kept.get(key)?.close();
      this.kept.delete(key);
    }
  }
}
