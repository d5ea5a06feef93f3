// Resumable uploads (tus 1.0): in pieces, several files at once, with pause; after a reload the same file goes on where
// it stopped, since its upload's address is kept in the browser.
import { Problem, request } from "./api.js";

const PIECE = 8_000_000, TRIES = 6, KEY = "wibam-uploads";
const TUS = { "Tus-Resumable": "1.0.0" };

/** What identifies a file across reloads. @param {File} file @param {string} site @param {string} purpose @param {string} camera */
const nameOf = (file, site, purpose, camera) => [site, purpose, camera, file.name, file.size, file.lastModified].join("|");

/** @returns {Object<string, string>} */
function kept() {
  try { return JSON.parse(localStorage.getItem(KEY) ?? "{}"); } catch { return {}; }
}

/** @param {string} name @param {string|null} url */
function keep(name, url) {
  const all = kept();
  if (url) all[name] = url;
  else delete all[name];
  localStorage.setItem(KEY, JSON.stringify(all));
}

/** @param {string} text */
function base64(text) {
  return btoa(String.fromCharCode(...new TextEncoder().encode(text)));
}

/** One file on its way. */
export class Upload {
  /**
   * @param {File} file
   * @param {{site: string, purpose: string, camera?: string}} target
   * @param {(upload: Upload) => void} changed
   */
  constructor(file, target, changed) {
    this.file = file;
    this.target = target;
    this.offset = 0;
    this.url = "";
    /** @type {"waiting"|"sending"|"paused"|"done"|"failed"} */
    this.state = "waiting";
    this.error = /** @type {any} */ (null);
    this.changed = changed;
    this.name = nameOf(file, target.site, target.purpose, target.camera ?? "");
    this.abort = new AbortController();
  }

  pause() {
    if (this.state === "done") return;
    this.state = "paused";
    this.abort.abort();
    this.changed(this);
  }

  /** Begin, or go on. Resolves when it is done, paused or has failed for good. */
  async send() {
    this.abort = new AbortController();
    this.state = "sending";
    this.error = null;
    this.changed(this);
    let tries = 0;
    for (;;) {
      try {
        const url = (this.url = await this.#address());
        while (this.offset < this.file.size) {
          await this.#piece(url);
          tries = 0;
        }
        if (this.file.size === 0) throw new Problem(`${this.file.name} is empty`, { hint: "Choose the recording again." });
        keep(this.name, null);
        this.state = "done";
        this.changed(this);
        return;
      } catch (error) {
        if (/** @type {string} */ (this.state) === "paused") return;
        const problem = /** @type {any} */ (error);
        const again = problem.code === "unreachable" || problem.status >= 500 || [408, 409, 423].includes(problem.status);
        tries += 1;
        if (!again || tries > TRIES) {
          this.state = "failed";
          this.error = problem;
          this.changed(this);
          return;
        }
        await new Promise((resolve) => setTimeout(resolve, 500 * 2 ** tries));
      }
    }
  }

  /** Where to send to: an upload that was begun before, or a new one. */
  async #address() {
    const before = kept()[this.name];
    if (before) {
      try {
        const response = await request("HEAD", before, { headers: TUS, signal: this.abort.signal });
        this.offset = Number(response.headers.get("Upload-Offset"));
        this.changed(this);
        return before;
      } catch (error) {
        if (![404, 410].includes(/** @type {any} */ (error).status)) throw error;
        keep(this.name, null); // it has expired: from the beginning
      }
    }
    const values = { site: this.target.site, purpose: this.target.purpose, camera: this.target.camera ?? "", filename: this.file.name };
    const metadata = Object.entries(values).filter(([, value]) => value).map(([key, value]) => `${key} ${base64(value)}`).join(",");
    const response = await request("POST", "/v1/uploads", { headers: { ...TUS, "Upload-Length": String(this.file.size), "Upload-Metadata": metadata }, signal: this.abort.signal });
    const url = response.headers.get("Location") ?? "";
    this.offset = 0;
    keep(this.name, url);
    return url;
  }

  /** @param {string} url */
  async #piece(url) {
    const piece = this.file.slice(this.offset, this.offset + PIECE);
    const response = await request("PATCH", url, {
      headers: { ...TUS, "Upload-Offset": String(this.offset), "Content-Type": "application/offset+octet-stream" }, raw: piece, signal: this.abort.signal,
    });
    this.offset = Number(response.headers.get("Upload-Offset"));
    this.changed(this);
  }
}

/** Sends files, a few at a time. */
export class UploadQueue {
  /** @param {(upload: Upload) => void} changed @param {number} [atOnce] */
  constructor(changed, atOnce = 3) {
    /** @type {Upload[]} */
    this.uploads = [];
    this.changed = changed;
    this.atOnce = atOnce;
  }

  /** @param {File} file @param {{site: string, purpose: string, camera?: string}} target */
  add(file, target) {
    const upload = new Upload(file, target, this.changed);
    this.uploads.push(upload);
    this.changed(upload);
    this.next();
    return upload;
  }

  /** Go on with one that was paused or has failed. @param {Upload} upload */
  resume(upload) {
    upload.state = "waiting";
    this.changed(upload);
    this.next();
  }

  /** @param {Upload} upload */
  remove(upload) {
    upload.pause();
    this.uploads = this.uploads.filter((other) => other !== upload);
    this.next();
  }

  next() {
    const sending = this.uploads.filter((upload) => upload.state === "sending").length;
    for (const upload of this.uploads.filter((one) => one.state === "waiting").slice(0, Math.max(0, this.atOnce - sending))) {
      upload.send().finally(() => this.next());
    }
  }
}
