// Two people's work on one instant: where both have changed a vehicle, who saves second says whose stands.
import { ask, byId, fill, h } from "./dom.js";

/** @typedef {import("./labelmodel.js").Vehicle} Vehicle */

/** Ends with the dialog that was asked for last: there is but one, and instants that were left unsaved may need it at once. */
let before = /** @type {Promise<unknown>} */ (Promise.resolve());

/**
 * Ask, once all that was asked before is answered, and put the vehicles together.
 * @param {{vehicles: Vehicle[], both: any[]}} found as `merged` in labelmodel.js says @param {string} author who saved first @param {string} when the instant
 * @returns {Promise<Vehicle[]>}
 */
export function settle(found, author, when) {
  const settled = before.then(() => settleNow(found, author, when));
  before = settled.catch(() => undefined);
  return settled;
}

/** @param {{vehicles: Vehicle[], both: any[]}} found @param {string} author @param {string} when @returns {Promise<Vehicle[]>} */
async function settleNow(found, author, when) {
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
