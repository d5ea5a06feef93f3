"""The page at ``/docs``: the OpenAPI document, readable. Self-contained: it loads nothing from anywhere else."""

DOCS_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>WIBAM API</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
 body { font: 15px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #1b1f24 }
 pre, code { font: 13px ui-monospace, monospace; background: #f3f4f6; border-radius: 4px; padding: .1em .3em }
 pre { padding: .8em; overflow: auto } h2 { margin-top: 2.2rem; border-bottom: 1px solid #ddd }
 details { margin: .4rem 0; border: 1px solid #e2e4e8; border-radius: 6px; padding: .4rem .7rem }
 summary { cursor: pointer }
 .method { display: inline-block; min-width: 5.2em; margin-right: .6em; font-weight: 700; color: #0550ae }
 td, th { text-align: left; vertical-align: top; padding: .15rem .9rem .15rem 0 } .muted { color: #6a737d }
</style></head><body><h1 id="title">WIBAM API</h1><pre id="description"></pre>
<p><a href="/openapi.json">openapi.json</a></p><main></main>
<script>
const make = (name, text, parent) => {
  const node = document.createElement(name); node.textContent = text ?? ""; parent?.append(node); return node };
const row = (table, cells) => { const line = make("tr", "", table); cells.forEach(c => make("td", c, line)) };
const kind = s => !s ? "" : s.$ref ? s.$ref.split("/").pop() : s.anyOf ? s.anyOf.map(kind).join(" | ")
  : s.enum ? s.enum.join(" | ") : s.type === "array" ? kind(s.items) + "[]" : s.type ?? "";
const bodies = contents => Object.entries(contents ?? {}).map(([t, c]) => t + " " + kind(c.schema)).join(", ");
fetch("/openapi.json").then(r => r.json()).then(api => {
  document.getElementById("title").textContent = `${api.info.title} ${api.info.version}`;
  document.getElementById("description").textContent = api.info.description.trim();
  const main = document.querySelector("main"), sections = {};
  for (const [path, operations] of Object.entries(api.paths))
    for (const [method, operation] of Object.entries(operations)) {
      const tag = operation.tags?.[0] ?? "other";
      sections[tag] ??= (make("h2", tag, main), make("section", "", main));
      const box = make("details", "", sections[tag]), summary = make("summary", "", box);
      make("span", method.toUpperCase(), summary).className = "method"; summary.append(" ");
      make("code", path, summary);
      make("span", "  " + (operation.summary ?? ""), summary).className = "muted";
      make("p", operation.description, box);
      const table = make("table", "", box);
      for (const p of operation.parameters ?? [])
        row(table, [p.name + (p.required ? " *" : ""), p.in, kind(p.schema), p.description ?? ""]);
      if (operation.requestBody) row(table, ["body", "", bodies(operation.requestBody.content), ""]);
      for (const [status, answer] of Object.entries(operation.responses))
        row(table, [status, "", bodies(answer.content), answer.description]);
    }
  make("h2", "schemas", main);
  for (const [name, schema] of Object.entries(api.components.schemas)) {
    const box = make("details", "", main); make("summary", name, box);
    make("pre", JSON.stringify(schema, null, 1), box);
  }
});
</script></body></html>
"""
