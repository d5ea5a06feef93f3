// Two people's work on one instant: where both have changed a vehicle, who saves second says whose stands.
import { ask, byId, fill, h } from "./dom.js";

/** @typedef {import("./labelmodel.js").Vehicle} Vehicle */

/**
 * Ask, and put the vehicles together.
 * @param {{vehicles: Vehicle[], both: any[]}} found as `merged` in labelmodel.js says @param {string} author who saved first @param {string} when the instant
 * @returns {Promise<Vehicle[]>}
 */
export async function settle(found, author, when) {
  let { vehicles } = found;
  byId("merge-said").textContent = `${author} saved this instant meanwhile, ${when}. What only one of you changed is taken over${found.both.length ? "; of what both changed, say whose stands." : "."}`;
  fill(byId("merge-both"), found.both.map(({ id, mine, theirs }) => h("fieldset", null, h("legend", null, `Vehicle ${id}`), ["mine", "theirs"].map((whose) => h("label", null,
    h("input", { type: "radio", name: `of-${id}`, value: whose, checked: whose === "mine" }), whose === "mine" ? ` yours${mine ? "" : " (removed)"}` : ` theirs${theirs ? "" : " (removed)"}`)))));
  await ask(byId("merge-dialog"));
  for (const { id, theirs } of found.both) {
    const whose = /** @type {HTMLInputElement|null} */ (byId("merge-both").querySelector(`input[name="of-${id}"]:checked`))?.value;
    if (whose === "theirs") vehicles = [...vehicles.filter((vehicle) => vehicle.id !== id), ...(theirs ? [theirs] : [])];
  }
  return vehicles;
}
