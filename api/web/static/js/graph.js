// The graph of a job's stages: a column for each depth, lines to what a stage waits for.
import { fill, h, s } from "./dom.js";
import { duration, percent } from "./format.js";

const COLUMN_PX = 196, MOST_ROWS = 8, BAND_GAP_PX = 24;

/** How many stages lie before one. @param {any[]} stages @returns {Map<string, number>} */
function depths(stages) {
  /** @type {Map<string, number>} */
  const found = new Map();
  for (const stage of stages) { // they come in the order of the pipeline
    found.set(stage.name, 1 + Math.max(-1, ...stage.requires.map((/** @type {string} */ name) => found.get(name) ?? -1)));
  }
  return found;
}

/** Lines that are not implied by others. @param {any[]} stages */
function edges(stages) {
  const of = new Map(stages.map((stage) => [stage.name, stage]));
  const reaches = (/** @type {string} */ from, /** @type {string} */ to) => {
    const stage = of.get(from);
    return !!stage && stage.requires.some((/** @type {string} */ name) => name === to || reaches(name, to));
  };
  return stages.flatMap((stage) => stage.requires
    .filter((/** @type {string} */ name) => of.has(name) && !stage.requires.some((/** @type {string} */ other) => other !== name && reaches(other, name)))
    .map((/** @type {string} */ name) => [name, stage.name]));
}

/** @param {any} stage */
function box(stage) {
  const detail = stage.state === "running"
    ? [h("progress", { value: stage.fraction, max: 1, "aria-label": `${stage.title}: done` }), h("p", null, percent(stage.fraction), stage.message ? ` · ${stage.message}` : ""), figures(stage)]
    : [h("p", null, stage.state === "reused" ? "made before" : stage.seconds !== null ? duration(stage.seconds) : "", stage.attempts > 1 ? ` · attempt ${stage.attempts}` : "")];
  const warnings = stage.warnings.length;
  return h(`article.stage.is-${stage.state}`, { "data-stage": stage.name, title: stage.name },
    h("h3", null, stage.title), h(`span.state.${stage.state}`, null, stage.state), detail,
    warnings ? h("p", null, h("a", { href: "#warnings-title" }, `${warnings} warning${warnings > 1 ? "s" : ""}`)) : null);
}

/** @param {any} stage */
function figures(stage) {
  const known = Object.entries(stage.figures).filter(([, value]) => value !== null).slice(0, 2);
  return known.length ? h("p", null, known.map(([name, value]) => `${name.replaceAll("_", " ")} ${Number(value).toPrecision(3)}`).join(" · ")) : null;
}

/**
 * Draw the stages into an element.
 * @param {HTMLElement} place
 * @param {any[]} stages
 */
export function drawGraph(place, stages) {
  const depth = depths(stages), rows = /** @type {Map<number, any[]>} */ (new Map());
  for (const stage of stages) {
    const column = depth.get(stage.name) ?? 0;
    rows.set(column, [...(rows.get(column) ?? []), stage]);
  }
  const across = Math.max(2, Math.floor((place.parentElement?.clientWidth ?? 1000) / COLUMN_PX));
  const boxes = new Map();
  for (const [column, members] of rows) {
    const band = Math.floor(column / across);
    const tallest = Math.max(...[...rows].filter(([other]) => Math.floor(other / across) === band).map(([, all]) => all.length));
    members.forEach((stage, row) => {
      const node = box(stage), top = band * MOST_ROWS + 1;
      node.style.gridColumn = String((column % across) + 1);
      node.style.gridRow = members.length === 1 ? `${top} / span ${tallest}` : String(top + row);
      boxes.set(stage.name, node);
    });
  }
  const lines = s("svg", { "aria-hidden": "true" });
  fill(place, lines, [...boxes.values()]);
  for (const [from, to] of edges(stages)) {
    const a = boxes.get(from), b = boxes.get(to);
    const x0 = a.offsetLeft + a.offsetWidth, y0 = a.offsetTop + a.offsetHeight / 2, x1 = b.offsetLeft, y1 = b.offsetTop + b.offsetHeight / 2;
    if (x1 < x0) { // down to the next band
      const band = Math.floor((depth.get(to) ?? 0) / across);
      const tops = [...boxes].filter(([name]) => Math.floor((depth.get(name) ?? 0) / across) === band).map(([, node]) => node.offsetTop);
      const between = Math.min(...tops) - BAND_GAP_PX / 2;
      lines.append(s("path", { d: `M${x0} ${y0} h10 V${between} H${x1 - 10} V${y1} H${x1}` }));
      continue;
    }
    const bend = Math.min(24, (x1 - x0) / 2);
    lines.append(s("path", { d: `M${x0} ${y0} H${x1 - 2 * bend} C${x1 - bend} ${y0} ${x1 - bend} ${y1} ${x1} ${y1}` }));
  }
}
