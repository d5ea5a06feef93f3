// Two jobs side by side: figures, options that differ, how long stages took, what they warn of.
import { get, getAll, query, Results } from "../api.js";
import { attempt, byId, fill, h, message, sentence } from "../dom.js";
import { bars, figure } from "../chart.js";
import { meanSd, number, percent, when } from "../format.js";
import { METRICS, table } from "../resulttables.js";

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
  fill(byId("compared"), h("div.cards", null, warnings(a, "A"), warnings(b, "B")), h("h2", null, "How good the networks are"), quality(a, b), h("h2", null, "What needs no labels"), consistency(a, b),
    h("h2", null, "Options that differ"), differing.length ? table("Options", ["Option", "A", "B"], differing) : h("p.note", null, "None."), h("div.figure-grid", null, times(a, b)));
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
