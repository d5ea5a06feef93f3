// How far two people's labels of the same instants agree, as a table.
import { get, query } from "./api.js";
import { byId, fill, h } from "./dom.js";
import { number, percent } from "./format.js";
import { jobId } from "./jobtabs.js";

/** Compare two sets, and show it. @param {string} first @param {string} second their names */
export async function showAgreement(first, second) {
  const found = await get(`/v1/jobs/${jobId}/labels/agreement${query({ first, second })}`);
  const row = (/** @type {string} */ title, /** @type {string} */ value) => h("tr", null, h("th", { scope: "row" }, title), h("td.number", null, value));
  const pair = (/** @type {any} */ one, /** @type {number} */ digits = 2) => (one.mean === null ? "–" : `${number(one.mean, digits)} ± ${number(one.sd, digits)}`);
  fill(byId("agreement"), h("table", null, h("caption", null, `${first} and ${second}, mean ± standard deviation`), h("tbody", null,
    row("Instants that both finished", String(found.instants)), row("Vehicles of both", String(found.pairs)), row("Only in the first, only in the second", `${found.only_first}, ${found.only_second}`),
    row("BEV IoU", pair(found.bev_iou)), row("3D IoU", pair(found.iou_3d)), row("Distance of centres, m", pair(found.ate_m)), row("Difference of headings, °", pair(found.aoe_deg, 1)),
    row("Difference of visibility", pair(found.visibility)), row("Same class", percent(found.same_class)))));
}
