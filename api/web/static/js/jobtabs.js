// What all pages of one job share: which job, whether it may be changed, and the ways between its pages.
import { get, Results } from "./api.js";
import { byId, fill, h } from "./dom.js";

export const jobId = document.body.dataset.job ?? "";
export const readOnly = "readOnly" in document.body.dataset;

const TABS = [["", "Progress"], ["/preflight", "Preflight"], ["/results", "Results"], ["/instants", "Instants"], ["/player", "Player"], ["/conflicts", "Conflicts"], ["/labelling", "Labelling"]];

/** @param {any} job */
export function showTabs(job) {
  fill(byId("tabs"), TABS.map(([path, title]) => {
    const href = `/jobs/${jobId}${path}`;
    return h("a", { href, "aria-current": location.pathname === href ? "page" : null }, title);
  }));
  document.title = `${job.name || job.site_name}: ${document.title}`;
}

/** @param {any} job */
export function showTitle(job) {
  byId("site-name").textContent = `Site ${job.site_name} · ${job.id}`;
  byId("name").textContent = job.name || job.id;
}

/** The job, once its title and tabs are shown, and what its stages have made. Both are asked for at once. @returns {Promise<[any, Results]>} */
export async function openJob() {
  const made = Results.of(jobId);
  made.catch(() => {}); // what is wrong with the job is told once, by the other answer
  const job = await get(`/v1/jobs/${jobId}`);
  showTitle(job);
  showTabs(job);
  return [job, await made];
}
