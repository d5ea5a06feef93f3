// The OpenAPI document, readable.
import { attempt, byId, fill, h } from "../dom.js";

/** What a value is, in short. @param {any} schema @returns {string} */
function kind(schema) {
  if (!schema) return "";
  if (schema.$ref) return schema.$ref.split("/").pop();
  if (schema.anyOf) return schema.anyOf.map(kind).join(" | ");
  if (schema.enum) return schema.enum.join(" | ");
  return schema.type === "array" ? `${kind(schema.items)}[]` : schema.type ?? "";
}

/** @param {Object<string, any>|undefined} content */
const bodies = (content) => Object.entries(content ?? {}).map(([type, one]) => `${type} ${kind(one.schema)}`).join(", ");

/** @param {string} path @param {string} method @param {any} operation @param {Object<string, any>} shared answers that several operations have */
function operationOf(path, method, operation, shared) {
  const row = (/** @type {string[]} */ cells) => h("tr", null, cells.map((cell) => h("td", null, cell)));
  return h("details.card", null, h("summary", null, h("strong", null, method.toUpperCase()), " ", h("code", null, path), " ", h("span.note", null, operation.summary ?? "")),
    h("p", null, operation.description ?? ""),
    h("div.scroll", { tabindex: 0, role: "region", "aria-label": `${method} ${path}` }, h("table", null, h("thead", null, h("tr", null, ["Name", "In", "Type", "Meaning"].map((title) => h("th", { scope: "col" }, title)))), h("tbody", null,
      (operation.parameters ?? []).map((/** @type {any} */ one) => row([one.name + (one.required ? " *" : ""), one.in, kind(one.schema), one.description ?? ""])),
      operation.requestBody ? row(["body", "", bodies(operation.requestBody.content), ""]) : null,
      Object.entries(operation.responses).map(([status, given]) => { const answer = given.$ref ? shared[given.$ref.split("/").pop()] : given; return row([status, "answer", bodies(answer.content), answer.description]); })))));
}

attempt(async () => {
  const api = await (await fetch("/openapi.json")).json();
  byId("title").textContent = `${api.info.title} ${api.info.version}`;
  byId("description").textContent = api.info.description.trim();
  /** @type {Map<string, HTMLElement[]>} */
  const sections = new Map();
  for (const [path, operations] of Object.entries(api.paths)) {
    for (const [method, operation] of Object.entries(operations)) {
      const tag = operation.tags?.[0] ?? "other";
      sections.set(tag, [...(sections.get(tag) ?? []), operationOf(path, method, operation, api.components.responses)]);
    }
  }
  const schemas = Object.entries(api.components.schemas).map(([name, schema]) => h("details.card", null, h("summary", null, h("code", null, name)), h("pre.log", { tabindex: 0, role: "region", "aria-label": name }, JSON.stringify(schema, null, 1))));
  fill(byId("operations"), [...sections].map(([tag, found]) => h("section", null, h("h2", null, tag), found)), h("section", null, h("h2", null, "schemas"), schemas));
});
