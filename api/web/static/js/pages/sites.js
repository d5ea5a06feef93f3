// All sites, and new ones: from the ids of their cameras, or from a site.json.
import { getAll, Problem, send } from "../api.js";
import { attempt, byId, fill, h } from "../dom.js";
import { when } from "../format.js";

async function show() {
  const sites = await getAll("/v1/sites");
  fill(byId("sites").tBodies[0], sites.length
    ? sites.map((/** @type {any} */ site) => h("tr", null, h("th", { scope: "row" }, h("a", { href: `/sites/${site.id}` }, site.name)), h("td", null, site.cameras.join(", ")), h("td", null, when(site.created_at)), h("td.mono", null, site.id)))
    : h("tr", null, h("td", { colspan: 4 }, "There are none yet. Describe one below.")));
}

/** @param {any} document */
async function create(document) {
  const made = await send("POST", "/v1/sites", document);
  location.assign(`/sites/${made.id}`);
}

byId("new").addEventListener("submit", (/** @type {Event} */ event) => {
  event.preventDefault();
  attempt(async () => {
    const ids = byId("new-cameras").value.split(/[\s,;]+/).filter(Boolean);
    await create({ name: byId("new-name").value.trim(), cameras: ids.map((/** @type {string} */ id) => ({ id, width_px: 1920, height_px: 1080, calibration: { kind: "homography", correspondences: [] } })) });
  });
});
byId("import").addEventListener("submit", (/** @type {Event} */ event) => {
  event.preventDefault();
  attempt(async () => {
    let document;
    try { document = JSON.parse(byId("json").value); } catch (error) { throw new Problem(`this is not JSON: ${/** @type {Error} */ (error).message}`, { hint: "Paste the whole site.json." }); }
    await create(document);
  });
});
byId("json-file").addEventListener("change", () => attempt(async () => {
  const [file] = byId("json-file").files;
  if (file) byId("json").value = await file.text();
}));
attempt(show);
