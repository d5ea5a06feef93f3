// All jobs, the newest first: filtered, by pages, and kept up to date while some run.
import { get, getAll, nextPage, query, request } from "../api.js";
import { attempt, byId, fill, h } from "../dom.js";
import { duration, percent, when, words } from "../format.js";

const PAGE = 50, LOOK_AGAIN_MS = 3000;
/** @type {any[]} */
let shown = [];
/** The address of the next page; how many lists were asked for. */
let older = "", asked = 0;

function filters() {
  return { state: byId("state").value, site: byId("site").value, text: byId("text").value.trim(), tag: byId("tag").value.trim() };
}

/** @param {any} job */
function row(job) {
  const warnings = job.stages.reduce((/** @type {number} */ sum, /** @type {any} */ stage) => sum + stage.warnings.length, 0);
  const running = job.stages.find((/** @type {any} */ stage) => stage.state === "running");
  const took = job.started_at && job.finished_at ? (Date.parse(job.finished_at) - Date.parse(job.started_at)) / 1000 : null;
  return h("tr", null,
    h("th", { scope: "row" }, h("a", { href: `/jobs/${job.id}` }, job.name || job.id), job.name ? h("div.note.mono", null, job.id) : null, job.tags.map((/** @type {string} */ tag) => [h("span.chip", null, tag), " "])),
    h("td", null, job.site_name),
    h("td", null, h(`span.state.${job.state}`, null, job.state), job.error ? h("div.note", null, words(job.error.code)) : null),
    h("td", null, h("progress", { value: job.fraction, max: 1, "aria-label": "Done" }), " ", h("span.figures", null, percent(job.fraction)),
      running ? h("div.note", null, running.title, job.remaining_s !== null ? `, ${duration(job.remaining_s)} left` : "") : null),
    h("td", null, when(job.created_at)),
    h("td", null, duration(took)),
    h("td", null, warnings ? h("span.chip.caution", null, `${warnings} to look at`) : "none"));
}

function show() {
  fill(byId("jobs").tBodies[0], shown.map(row));
  const filtered = Object.values(filters()).some(Boolean);
  byId("empty").hidden = shown.length > 0;
  fill(byId("empty"), filtered ? "No job is like that: take a filter away." : ["There are no jobs yet. ", h("a", { href: "/sites" }, "Describe a site"), ", send its recordings, and start one there."]);
}

/** @param {string} path of a page of the list @param {any[]} before the jobs of the pages before */
async function load(path = `/v1/jobs${query({ ...filters(), limit: PAGE })}`, before = []) {
  const mine = ++asked, response = await request("GET", path), found = await response.json();
  if (mine !== asked) return; // what was asked for later may have been answered before
  shown = [...before, ...found];
  older = nextPage(response);
  byId("more").hidden = !older;
  show();
}

async function refresh() {
  if (document.hidden || !shown.some((job) => !job.is_terminal)) return;
  const mine = asked, latest = await get(`/v1/jobs${query({ ...filters(), limit: Math.max(PAGE, Math.min(shown.length, 1000)) })}`);
  if (mine === asked && JSON.stringify(latest) !== JSON.stringify(shown) && !byId("jobs").contains(document.activeElement)) { shown = latest; show(); }
}

async function start() {
  const wanted = new URLSearchParams(location.search);
  for (const site of await getAll("/v1/sites")) byId("site").append(h("option", { value: site.id }, site.name));
  for (const name of ["state", "site", "text", "tag"]) byId(name).value = wanted.get(name) ?? "";
  byId("filter").addEventListener("submit", (/** @type {Event} */ event) => event.preventDefault());
  byId("filter").addEventListener("input", () => {
    history.replaceState(null, "", location.pathname + query(filters()));
    attempt(() => load());
  });
  byId("more").addEventListener("click", () => attempt(() => load(older, shown)));
  await load();
  setInterval(() => { refresh().catch(() => { /* the next look says it again, and a click says it aloud */ }); }, LOOK_AGAIN_MS);
}

attempt(start);
