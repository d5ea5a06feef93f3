// The description of a site, changed without losing what others change meanwhile.
import { Problem, request } from "./api.js";
import { ask, byId, fill, h, message } from "./dom.js";

/** A site, and the version of its description. @param {string} siteId @returns {Promise<{record: any, etag: string}>} */
async function read(siteId) {
  const response = await request("GET", `/v1/sites/${siteId}`);
  return { record: await response.json(), etag: response.headers.get("ETag") ?? "" };
}

/** @param {string} siteId @param {any} site its new description @param {string} etag of the one that it was made from @returns {Promise<any>} the site */
async function write(siteId, site, etag) {
  return (await request("PUT", `/v1/sites/${siteId}`, { body: site, headers: { "If-Match": etag } })).json();
}

/** @param {unknown} error */
const meanwhile = (error) => error instanceof Problem && error.code === "changed_meanwhile";

/**
 * Put a change into what is there now, and again where somebody else is quicker.
 * @param {string} siteId @param {(site: any) => any} change from the site's description to another; null: there is nothing to change
 * @returns {Promise<any>} the site as it is then
 */
export async function changeSite(siteId, change) {
  for (;;) {
    const { record, etag } = await read(siteId), site = change(record.site);
    if (!site) return record;
    try {
      return await write(siteId, site, etag);
    } catch (error) {
      if (!meanwhile(error)) throw error;
    }
  }
}

/** Where two descriptions differ: "name", "cameras[south].signals[phase-1]". @param {any} before @param {any} after @param {string} [path] @returns {string[]} */
export function changedPlaces(before, after, path = "") {
  if (JSON.stringify(before) === JSON.stringify(after)) return [];
  const inside = [before, after].every((one) => one !== null && typeof one === "object");
  if (!inside || Array.isArray(before) !== Array.isArray(after)) return [path];
  if (!Array.isArray(before)) return [...new Set([...Object.keys(before), ...Object.keys(after)])].flatMap((key) => changedPlaces(before[key], after[key], path ? `${path}.${key}` : key));
  if (![...before, ...after].every((one) => one?.id)) return [path];
  const [old, now] = [before, after].map((all) => new Map(all.map((/** @type {any} */ one) => [one.id, one])));
  const found = [...new Set([...old.keys(), ...now.keys()])].flatMap((id) => changedPlaces(old.get(id), now.get(id), `${path}[${id}]`));
  return found.length ? found : [path]; // they stand in another order
}

/**
 * Let the whole description be edited. What was typed stays until it is saved or left.
 * @param {string} siteId
 * @returns {Promise<boolean>} whether it was saved
 */
export async function editSite(siteId) {
  let { record, etag } = await read(siteId);
  const text = byId("document"), place = byId("edit-problem");
  text.value = JSON.stringify(record.site, null, 1);
  fill(place);
  while (await ask(byId("edit-dialog")) === "yes") {
    try {
      await write(siteId, JSON.parse(text.value), etag);
      return true;
    } catch (error) {
      const theirs = meanwhile(error) ? await read(siteId).catch(() => null) : null;
      if (theirs) {
        fill(place, conflict(record.site, theirs.record.site));
        ({ record, etag } = theirs);
      } else fill(place, refusal(error));
    }
  }
  return false;
}

/** @param {any} before what the text was made from @param {any} now what others have made of it */
function conflict(before, now) {
  const shown = h("textarea", { id: "theirs", rows: 10, cols: 80, readonly: true, spellcheck: false });
  shown.textContent = JSON.stringify(now, null, 1);
  return [
    message("caution", "somebody else has changed the site meanwhile; nothing was saved",
      `They changed: ${changedPlaces(before, now).join(", ")}. Your text stands above. Put into it what you want to keep of theirs, and save again: it then takes the place of what stands here.`),
    h("label", { for: "theirs" }, "The site as it is now"), shown,
  ];
}

/** @param {unknown} error */
function refusal(error) {
  const { message: said, hint } = /** @type {any} */ (error);
  return error instanceof Problem ? message("bad", said, hint) : message("bad", `this is not JSON: ${said}`, "Nothing was saved; your text stands above.");
}
