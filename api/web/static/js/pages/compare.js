// Two jobs side by side: figures, options that differ, how long stages took, what they warn of.
import { get, getAll, Problem, query, Results } from "../api.js";
import { attempt, byId, fill, h, message, sentence } from "../dom.js";
import { bars, figure } from "../chart.js";
import { meanSd, number, percent, when } from "../format.js";
import { METRICS, table, tooFew } from "../resulttables.js";

/** @param {any} job */
const nameOf = (job) => job.name || job.id;

/** @param {string} id */
async function load(id) {
  const [job, made] = await Promise.all([get(`/v1/jobs/${id}`), Results.of(id)]);
  const [metrics, conflicts] = await Promise.all([made.answer("metrics", "/metrics"), made.answer("conflicts", "/conflicts")]);
  return { job, metrics, conflicts };
}

/** Options that differ, by stage and name; one that a job does not give has its default. @param {any} a @param {any} b @param {any} defaults */
function differences(a, b, defaults) {
  const names = new Set([a, b].flatMap((job) => Object.entries(job.options).flatMap(([stage, values]) => Object.keys(/** @type {any} */ (values)).map((name) => `${stage}.${name}`))));
  const valueOf = (/** @type {any} */ job, /** @type {string} */ path) => { const [stage, name] = path.split("."); return job.options[stage]?.[name] ?? defaults[stage]?.[name]; };
  return [...names].sort().map((path) => [path, valueOf(a, path), valueOf(b, path)]).filter(([, x, y]) => JSON.stringify(x) !== JSON.stringify(y)).map(([path, x, y]) => [path, JSON.stringify(x), JSON.stringify(y)]);
}

/** @param {any} a @param {any} b */
function quality(a, b) {
  const of = (/** @type {any} */ one) => one.metrics?.finetuned ?? null, columns = ["", `A: ${nameOf(a.job)}`, `B: ${nameOf(b.job)}`, "B − A"];
  if (!of(a) && !of(b)) return h("p.note", null, "Neither was measured against hand labels.");
  const difference = (/** @type {number|null|undefined} */ x, /** @type {number|null|undefined} */ y, /** @type {number} */ digits) => (x === null || x === undefined || y === null || y === undefined ? "–" : `${y > x ? "+" : ""}${number(y - x, digits)}`);
  const cells = METRICS.map(([title, field, digits]) => [title, meanSd(of(a)?.[field], digits), meanSd(of(b)?.[field], digits), difference(of(a)?.[field].mean, of(b)?.[field].mean, digits)]);
  cells.push(["Recall", percent(of(a)?.recall.mean), percent(of(b)?.recall.mean), difference(of(a)?.recall.mean, of(b)?.recall.mean, 2)]);
  cells.push(["Precision", percent(of(a)?.precision), percent(of(b)?.precision), difference(of(a)?.precision, of(b)?.precision, 2)]);
  const rows = METRICS.map(([, field]) => [field, of(a)?.[field].mean, of(b)?.[field].mean]);
  return table("Fine-tuned networks", columns, [...rows, ["recall", of(a)?.recall.mean, of(b)?.recall.mean], ["precision", of(a)?.precision, of(b)?.precision]], { cells, note: a.job.site_id === b.job.site_id ? "The same site. A difference within the spread of seeds says nothing: docs/learning.md says how wide that is." : "Different sites: their figures differ by the sites, too." });
}

/** @param {any} a @param {any} b */
function consistency(a, b) {
  const of = (/** @type {any} */ one) => one.metrics?.self_consistency?.finetuned;
  return table("Without labels", ["", "A", "B"], [["IoU in other views", of(a)?.other_views.mean, of(b)?.other_views.mean], ["Sightings found", of(a)?.found, of(b)?.found], ["Conflicts", a.conflicts?.conflicts.length, b.conflicts?.conflicts.length]],
    { cells: [["IoU in other views", meanSd(of(a)?.other_views), meanSd(of(b)?.other_views)], ["Sightings found", percent(of(a)?.found), percent(of(b)?.found)], ["Conflicts", a.conflicts?.conflicts.length ?? "–", b.conflicts?.conflicts.length ?? "–"]] });
}

/** The networks of two jobs on the instants that neither learned from. @param {any} a @param {any} b */
async function sameInstants(a, b) {
  if (a.job.id === b.job.id) return h("p.note", null, "This is one and the same network.");
  const recordings = (/** @type {any} */ one) => JSON.stringify(one.job.files.filter((/** @type {any} */ file) => file.camera).map((/** @type {any} */ file) => [file.camera, file.sha256]).sort());
  if (recordings(a) !== recordings(b)) return h("p.note", null, "The jobs worked on different recordings: there are no instants on which both networks can be judged.");
  const [first, second] = await Promise.all([a, b].map(async (one) => (await get(`/v1/models${query({ job: one.job.id, limit: 1 })}`))[0]));
  if (!first || !second) return h("p.note", null, "Both jobs must have made a network.");
  let found;
  try { found = await get(`/v1/models/compare${query({ first: first.id, second: second.id })}`); } catch (error) {
    if (error instanceof Problem && error.status === 409) return h("p.note", null, `${sentence(error.message)} ${error.hint}`);
    throw error;
  }
  const between = (/** @type {any} */ test, /** @type {number} */ digits) => (test.difference === null ? "–" : `${test.difference > 0 ? "+" : ""}${number(test.difference, digits)} (${tooFew(test) || `${number(test.low, digits)} to ${number(test.high, digits)}`})`);
  const cells = [["IoU in other views", meanSd(found.first.consistency.other_views), meanSd(found.second.consistency.other_views), between(found.other_views, 3)]];
  const rows = [["other_views", found.first.consistency.other_views.mean, found.second.consistency.other_views.mean, found.other_views.difference]];
  if (found.significance) for (const [title, field, digits] of METRICS) {
    if (!found.significance[field]) continue;
    cells.push([title, meanSd(found.first.figures[field], digits), meanSd(found.second.figures[field], digits), between(found.significance[field], digits)]);
    rows.push([field, found.first.figures[field].mean, found.second.figures[field].mean, found.significance[field].difference]);
  }
  const cautions = found.cautions.map((/** @type {string} */ one) => sentence(one)).join(" ");
  return table("On the same held-out instants", ["", `A: ${nameOf(a.job)}`, `B: ${nameOf(b.job)}`, "B − A (95 % interval)"], rows, { cells, note: `${found.instants} instants from ${number(found.from_s, 1)} to ${number(found.to_s, 1)} s, of which neither network learned; intervals by resampling vehicles. ${cautions}` });
}

/** @param {any} a @param {any} b */
function times(a, b) {
  const names = a.job.stages.map((/** @type {any} */ stage) => stage.name), of = (/** @type {any} */ one) => names.map((/** @type {string} */ name) => { const stage = one.job.stages.find((/** @type {any} */ other) => other.name === name); return stage?.state === "succeeded" ? stage.seconds : null; });
  const rows = names.map((/** @type {string} */ name, /** @type {number} */ index) => [name, of(a)[index], of(b)[index]]);
  const key = [{ name: "A", colour: "--before" }, { name: "B", colour: "--after" }];
  return figure({ title: "Running time", caption: "Stages that were run; outputs that were there already took none.", key,
    chart: bars({ categories: names, groups: [{ ...key[0], values: of(a), hatch: true }, { ...key[1], values: of(b) }], y: "s", label: "Running time of the stages in s" }), columns: ["stage", "a_s", "b_s"], rows });
}

/** @param {any} one @param {string} letter */
function warnings({ job }, letter) {
  const found = job.stages.flatMap((/** @type {any} */ stage) => stage.warnings);
  return h("section.card", null, h("h3", null, `${letter}: `, h("a", { href: `/jobs/${job.id}` }, nameOf(job))), h("p.note", null, `${job.site_name} · ${job.state} · ${when(job.created_at)}`),
    found.length ? h("ul", null, found.map((/** @type {any} */ warning) => h("li", null, sentence(warning.message)))) : h("p", null, "No warnings."));
}

async function compare() {
  const [x, y] = [byId("a").value, byId("b").value];
  history.replaceState(null, "", location.pathname + query({ a: x, b: y }));
  const [a, b, options] = await Promise.all([load(x), load(y), get("/v1/options")]);
  const differing = differences(a.job, b.job, options.defaults);
  fill(byId("compared"), h("div.cards", null, warnings(a, "A"), warnings(b, "B")), h("h2", null, "How good the networks are"), quality(a, b), h("div", { id: "same" }), h("h2", null, "What needs no labels"), consistency(a, b),
    h("h2", null, "Options that differ"), differing.length ? table("Options", ["Option", "A", "B"], differing) : h("p.note", null, "None."), h("div.figure-grid", null, times(a, b)));
  const same = byId("same");
  fill(same, h("p.note", null, "Both networks are judged on the instants that neither learned from …"));
  fill(same, await sameInstants(a, b)); // of the jobs that stand there now, whatever was chosen meanwhile
}

attempt(async () => {
  const jobs = await getAll("/v1/jobs?limit=200"), wanted = new URLSearchParams(location.search);
  if (jobs.length < 2) { fill(byId("compared"), message("plain", "there are fewer than two jobs", "Start another one on a site's page.")); byId("choice").hidden = true; return; }
  for (const [id, index] of /** @type {Array<[string, number]>} */ ([["a", 1], ["b", 0]])) {
    fill(byId(id), jobs.map((/** @type {any} */ job) => h("option", { value: job.id }, `${nameOf(job)} (${job.site_name}, ${job.state})`)));
    byId(id).value = jobs.some((/** @type {any} */ job) => job.id === wanted.get(id)) ? wanted.get(id) : jobs[index].id;
  }
  byId("choice").addEventListener("change", () => attempt(compare));
  byId("choice").addEventListener("submit", (/** @type {Event} */ event) => event.preventDefault());
  byId("swap").addEventListener("click", () => { [byId("a").value, byId("b").value] = [byId("b").value, byId("a").value]; attempt(compare); });
  await compare();
});
