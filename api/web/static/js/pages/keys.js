// Keys: those that there are, a new one, and who changed what.
import { get, getAll, send } from "../api.js";
import { attempt, byId, fill, h, say } from "../dom.js";
import { when } from "../format.js";

async function show() {
  const [keys, lines] = await Promise.all([getAll("/v1/keys"), get("/v1/audit?limit=50")]);
  fill(byId("keys").tBodies[0], keys.length
    ? keys.map((/** @type {any} */ key) => h("tr", null,
      h("th", { scope: "row" }, key.name), h("td", null, key.scopes.join(", ")),
      h("td", null, key.revoked_at ? "revoked" : key.expires_at ? when(key.expires_at) : "never"),
      h("td", null, key.last_used_at ? when(key.last_used_at) : "not yet"), h("td.mono", null, key.id),
      h("td", null, key.works ? revokeButton(key) : "")))
    : h("tr", null, h("td", { colspan: 6 }, "There are none yet.")));
  const names = new Map(keys.map((/** @type {any} */ key) => [key.id, key.name]));
  fill(byId("audit").tBodies[0], lines.length
    ? lines.map((/** @type {any} */ line) => h("tr", null,
      h("td", null, when(line.at)), h("td", null, names.get(line.who) ?? line.who), h("td.mono", null, line.what), h("td", null, String(line.status))))
    : h("tr", null, h("td", { colspan: 4 }, "Nothing was changed yet.")));
}

/** @param {any} key */
function revokeButton(key) {
  const button = h("button", { type: "button", "aria-label": `Revoke ${key.name}` }, "Revoke");
  button.addEventListener("click", () => attempt(async () => {
    await send("DELETE", `/v1/keys/${key.id}`);
    say(`${key.name} works no more`);
    await show();
  }));
  return button;
}

byId("new").addEventListener("submit", (/** @type {Event} */ event) => {
  event.preventDefault();
  attempt(async () => {
    const scopes = [...document.querySelectorAll('#new input[name="scope"]')].filter((box) => /** @type {HTMLInputElement} */ (box).checked).map((box) => /** @type {HTMLInputElement} */ (box).value);
    const days = byId("days").value;
    const made = await send("POST", "/v1/keys", { name: byId("name").value.trim(), scopes, lifetime_days: days ? Number(days) : null });
    byId("made-name").textContent = made.name;
    byId("secret").textContent = made.secret;
    byId("made").hidden = false;
    say("the key is made");
    await show();
  });
});
attempt(show);
