// Signing in with the token, once; or with an address that carries it behind its #, which no request and no log contains.
import { send } from "../api.js";
import { attempt, byId } from "../dom.js";

/** Where to go then: an address of our own, whatever the link said. */
function destination() {
  const wanted = new URLSearchParams(location.search).get("next") ?? "/jobs";
  const url = new URL(wanted, location.origin);
  return url.origin === location.origin && !wanted.startsWith("//") ? url.pathname + url.search : "/jobs";
}

/** @param {string} token */
function signIn(token) {
  return attempt(async () => {
    await send("POST", "/session", { token });
    location.replace(destination());
  });
}

byId("sign-in").addEventListener("submit", (/** @type {Event} */ event) => {
  event.preventDefault();
  signIn(byId("token").value);
});
const given = new URLSearchParams(location.hash.slice(1)).get("token");
if (given) {
  history.replaceState(null, "", location.pathname + location.search);
  signIn(given);
}
