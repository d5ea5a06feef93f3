// The API, as pages use it: with the browser's session, and the header that marks our own pages.

/** What the service says when it refuses (RFC 9457), as an error. */
export class Problem extends Error {
  /**
   * @param {string} message one sentence
   * @param {{code?: string, hint?: string, status?: number, details?: Object<string, any>}} [rest]
   */
  constructor(message, { code = "", hint = "", status = 0, details = {} } = {}) {
    super(message);
    this.name = "Problem";
    this.code = code;
    this.hint = hint;
    this.status = status;
    this.details = details;
  }
}

const HEADERS = { "X-Wibam-Page": "1" };

/**
 * One request.
 * @param {string} method
 * @param {string} path with a leading slash
 * @param {{body?: any, headers?: Object<string, string>, raw?: BodyInit, signal?: AbortSignal}} [options]
 *   `body` is sent as JSON, `raw` as it is
 * @returns {Promise<Response>} of success
 * @throws {Problem}
 */
export async function request(method, path, { body, headers = {}, raw, signal } = {}) {
  const all = { ...HEADERS, ...headers };
  if (body !== undefined) all["Content-Type"] = "application/json";
  let response;
  try {
    response = await fetch(path, {
      method, headers: all, body: body !== undefined ? JSON.stringify(body) : raw, signal, credentials: "same-origin",
    });
  } catch (error) {
    if (signal?.aborted) throw error;
    throw new Problem("the service does not answer", { code: "unreachable", hint: "Nothing is lost. Is it running? Try again in a moment." });
  }
  if (response.ok) return response;
  throw await problemOf(response);
}

/** @param {Response} response @returns {Promise<Problem>} */
async function problemOf(response) {
  let said = {};
  try {
    said = await response.json();
  } catch { /* a proxy in between may answer without a problem document */ }
  if (response.status === 401 && "readOnly" in document.body.dataset) {
    return new Problem("the link to this job works no more", { code: "unauthorised", status: 401, hint: "Links end after some time: ask whoever sent it for a new one. What stands here stays." });
  }
  if (response.status === 401 && !location.pathname.startsWith("/sign-in")) {
    return new Problem("you are no longer signed in", { code: "unauthorised", status: 401, hint: "Sign in again in another tab; what stands here stays." });
  }
  return new Problem(said.detail ?? `the service answered ${response.status}`, {
    code: said.code, hint: said.hint, status: response.status, details: said.details,
  });
}

/** @param {string} path @param {{signal?: AbortSignal}} [options] @returns {Promise<any>} */
export async function get(path, options = {}) {
  return (await request("GET", path, options)).json();
}

/**
 * All items of a list, page by page.
 * @param {string} path with its filters
 * @param {number} [most] stop after so many
 * @returns {Promise<any[]>}
 */
export async function getAll(path, most = Infinity) {
  const found = [];
  for (let next = path; next && found.length < most;) {
    const response = await request("GET", next);
    found.push(...await response.json());
    next = nextPage(response);
  }
  return found;
}

/** @param {Response} response of a list @returns {string} the address of its next page; empty: this is the last */
export function nextPage(response) {
  return /<([^>]+)>;\s*rel="next"/.exec(response.headers.get("Link") ?? "")?.[1] ?? "";
}

/**
 * A JSON request that changes something.
 * @param {"POST"|"PUT"|"PATCH"|"DELETE"} method
 * @param {string} path
 * @param {any} [body]
 * @param {Object<string, string>} [headers]
 * @returns {Promise<any>} the answer; null where it has none
 */
export async function send(method, path, body, headers = {}) {
  const response = await request(method, path, { body, headers });
  const text = await response.text();
  return text ? JSON.parse(text) : null;
}

/** What the finished stages of a job have made, so that nothing is asked for that is not there. */
export class Results {
  /** @param {string} jobId @param {any[]} files as `GET /v1/jobs/{id}/artifacts` lists them */
  constructor(jobId, files) {
    this.path = `/v1/jobs/${jobId}`;
    this.files = files;
  }

  /** @param {string} jobId */
  static async of(jobId) {
    return new Results(jobId, await getAll(`/v1/jobs/${jobId}/artifacts?limit=1000`));
  }

  /** @param {string} artifact its name @returns {boolean} */
  has(artifact) {
    return this.files.some((one) => one.artifact === artifact);
  }

  /** The document of an artifact that is one JSON file; null where it is not there. @param {string} artifact its name @returns {Promise<any>} */
  async document(artifact) {
    const file = this.files.find((one) => one.artifact === artifact);
    return file ? get(`${this.path}/artifacts/${file.id}`) : null;
  }

  /** What the job answers once an artifact is there; null before. @param {string} artifact its name @param {string} path with a leading slash @returns {Promise<any>} */
  async answer(artifact, path) {
    return this.has(artifact) ? get(this.path + path) : null;
  }

  /** Cameras and classes, once the cameras are calibrated; null before. @returns {Promise<any>} */
  async scene() {
    return this.answer(this.has("rig") ? "rig" : "calibrated-rig", "/scene");
  }
}

/**
 * Follow a job's events, from the first on. The browser reconnects by itself and goes on after the last event.
 * @param {string} jobId
 * @param {(event: {sequence: number, kind: string, at: string, data: any}) => void} seen
 * @returns {() => void} ends it
 */
export function follow(jobId, seen) {
  const source = new EventSource(`/v1/jobs/${jobId}/events`);
  for (const kind of ["job", "stage", "progress"]) {
    source.addEventListener(kind, (event) => seen(JSON.parse(/** @type {MessageEvent} */ (event).data)));
  }
  source.addEventListener("error", () => {
    if (source.readyState === EventSource.CLOSED) source.close();
  });
  return () => source.close();
}

/**
 * Parameters of an address; lists become repeated ones, and what is null, undefined or empty is left out.
 * @param {Object<string, any>} values
 * @returns {string} with its question mark, or nothing
 */
export function query(values) {
  const found = new URLSearchParams();
  for (const [name, value] of Object.entries(values)) {
    for (const item of Array.isArray(value) ? value : [value]) {
      if (item !== null && item !== undefined && item !== "") found.append(name, String(item));
    }
  }
  const text = found.toString();
  return text ? `?${text}` : "";
}

/** A whole number that the page's own address gives; null where it gives none, or something else. @param {string} name @returns {number|null} */
export function wholeNumber(name) {
  const text = new URLSearchParams(location.search).get(name)?.trim(), value = text ? Math.round(Number(text)) : NaN;
  return Number.isSafeInteger(value) ? value : null;
}
