// One job: its stages as they go, log, warnings, files; cancel, restart, rename, share, delete.
import { follow, get, Results, send } from "../api.js";
import { ask, attempt, byId, complain, fill, h, message, say, sentence } from "../dom.js";
import { duration, percent, size, when } from "../format.js";
import { drawGraph } from "../graph.js";
import { jobId, readOnly, showTabs, showTitle } from "../jobtabs.js";

const LOG_EVERY_MS = 1500, MOST_LOG = 2_000_000;
let job = /** @type {any} */ (null);
let logOffset = 0, ended = () => {}, wanted = false, logTimer = 0;

function showFacts() {
  const running = job.started_at ? ((job.finished_at ? Date.parse(job.finished_at) : Date.now()) - Date.parse(job.started_at)) / 1000 : null;
  const facts = [
    ["State", h(`span.state.${job.state}`, null, job.state)],
    ["Done", [percent(job.fraction), " ", h("progress", { value: job.fraction, max: 1, "aria-label": "Done" })]],
    ["Time left", job.is_terminal ? "–" : job.remaining_s === null ? h("small", null, "not known yet") : duration(job.remaining_s)],
    ["Running time", duration(running)],
    ["Created", h("small", null, when(job.created_at))],
    ["Restarts", job.restarts],
  ];
  fill(byId("facts"), facts.map(([title, value]) => h("div", null, h("dt", null, title), h("dd", null, value))));
  fill(byId("failure"), job.error ? message("bad", job.error.message, job.error.hint, h("p.note.mono", null, `${job.error.details.stage ?? ""} · ${job.error.code}`)) : null);
}

function showWarnings() {
  const found = job.stages.flatMap((/** @type {any} */ stage) => stage.warnings.map((/** @type {any} */ warning) => ({ ...warning, title: stage.title })));
  fill(byId("warnings"), found.length
    ? found.map((/** @type {any} */ warning) => message("caution", warning.message, warning.hint, h("p.note", null, `${warning.title} · ${warning.code}`)))
    : h("p.note", null, job.is_terminal ? "None." : "None so far."));
}

function showActions() {
  byId("actions").hidden = readOnly;
  byId("cancel").hidden = job.is_terminal || job.state === "cancelling";
  byId("restart").hidden = !job.is_terminal;
  byId("delete").hidden = !job.is_terminal;
}

async function showFiles() {
  const { files } = await Results.of(jobId);
  fill(byId("files").tBodies[0], files.length
    ? files.map((/** @type {any} */ file) => h("tr", null, h("td", null, file.title), h("td", null, file.stage),
      h("td", null, h("a", { href: `/v1/jobs/${jobId}/artifacts/${file.id}`, download: true }, file.name)), h("td.number", null, size(file.size_bytes))))
    : h("tr", null, h("td", { colspan: 4 }, "No stage has finished yet.")));
}

async function refresh() {
  const before = job?.state;
  job = await get(`/v1/jobs/${jobId}`);
  showTitle(job);
  showFacts();
  drawGraph(byId("graph"), job.stages);
  showWarnings();
  showActions();
  if (before && before !== job.state) say(`The job is ${job.state}.`);
}

/** Changes come in bursts; one look a quarter of a second shows them all. */
function refreshSoon() {
  if (wanted) return;
  wanted = true;
  setTimeout(() => {
    wanted = false;
    attempt(async () => {
      await refresh();
      if (job.is_terminal) await showFiles();
    });
  }, 250);
}

async function readLog() {
  const place = byId("log");
  for (;;) {
    const part = await get(`/v1/jobs/${jobId}/log?offset=${logOffset}`);
    logOffset = part.next_offset;
    if (part.text) {
      const text = place.textContent + part.text;
      place.textContent = text.length > MOST_LOG ? `… (the whole log has ${logOffset} bytes)\n${text.slice(-MOST_LOG)}` : text;
      if (byId("follow").checked) place.scrollTop = place.scrollHeight;
      continue;
    }
    if (part.complete) clearInterval(logTimer);
    return;
  }
}

function watch() {
  ended();
  ended = follow(jobId, refreshSoon);
  clearInterval(logTimer);
  logTimer = window.setInterval(() => { if (!document.hidden) readLog().catch(() => {}); }, LOG_EVERY_MS);
}

async function showPlan() {
  const from = byId("from").value || null;
  const plan = await send("POST", `/v1/jobs/${jobId}/plan`, { from_stage: from });
  const rerun = plan.filter((/** @type {any} */ stage) => stage.would === "run");
  fill(byId("plan"), rerun.length
    ? [h("p", null, `${rerun.length} of ${plan.length} stages would run; the others keep what they have made:`), h("ol", null, rerun.map((/** @type {any} */ stage) => h("li", null, stage.title)))]
    : h("p", null, "Everything is there already: nothing would run."));
}

async function restart() {
  fill(byId("from"), h("option", { value: "" }, "where something is missing or has changed"),
    job.stages.map((/** @type {any} */ stage) => h("option", { value: stage.name }, stage.title)));
  await showPlan();
  if (await ask(byId("restart-dialog")) !== "yes") return;
  await send("POST", `/v1/jobs/${jobId}/restart`, { from_stage: byId("from").value || null });
  await refresh();
  watch();
}

async function rename() {
  byId("new-name").value = job.name;
  if (await ask(byId("rename-dialog")) !== "yes") return;
  job = await send("PATCH", `/v1/jobs/${jobId}`, { name: byId("new-name").value.trim() });
  showTitle(job);
}

async function makeLink() {
  const link = await send("POST", `/v1/jobs/${jobId}/share-link`, { lifetime_h: Number(byId("share-hours").value) });
  byId("share-url").value = new URL(link.url, location.origin).href;
  byId("share-url").select();
}

async function share() {
  await makeLink();
  await ask(byId("share-dialog"));
}

async function remove() {
  if (!window.confirm("Delete this job and all that only it refers to? Its recordings stay with the site.")) return;
  await send("DELETE", `/v1/jobs/${jobId}`);
  location.assign("/jobs");
}

/** @param {string} id @param {string} kind @param {() => Promise<void>} work */
const on = (id, kind, work) => byId(id).addEventListener(kind, () => attempt(work));

async function start() {
  await refresh();
  showTabs(job);
  on("cancel", "click", async () => { await send("POST", `/v1/jobs/${jobId}/cancel`); await refresh(); });
  on("restart", "click", restart);
  on("from", "change", showPlan);
  on("rename", "click", rename);
  on("share", "click", share);
  on("share-hours", "change", makeLink);
  on("delete", "click", remove);
  await Promise.all([readLog(), showFiles()]);
  watch();
}

start().catch((error) => {
  complain(error);
  fill(byId("facts"), h("p", null, sentence(error.message)));
});
