// What every page has: the scheme of colours, signing out, and which part of the site one is in.
import { send } from "./api.js";
import { attempt } from "./dom.js";

const THEMES = ["auto", "light", "dark"];
const NAMES = { auto: "Auto", light: "Light", dark: "Dark" };
const SAID = { auto: "as the system has them", light: "light", dark: "dark" };

/** @param {string} theme */
function show(theme) {
  if (theme === "auto") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = theme;
  const button = document.getElementById("theme");
  if (!button) return;
  button.textContent = NAMES[theme];
  button.setAttribute("aria-label", `Colours: ${SAID[theme]}`);
}

let theme = localStorage.getItem("wibam-theme") ?? "auto";
show(theme);
document.getElementById("theme")?.addEventListener("click", () => {
  theme = THEMES[(THEMES.indexOf(theme) + 1) % THEMES.length];
  localStorage.setItem("wibam-theme", theme);
  show(theme);
  document.dispatchEvent(new Event("wibam-theme"));
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => document.dispatchEvent(new Event("wibam-theme")));
document.getElementById("sign-out")?.addEventListener("click", () => attempt(async () => {
  await send("DELETE", "/session");
  location.assign("/sign-in");
}));
for (const link of document.querySelectorAll(".bar nav a")) {
  const path = link.getAttribute("href") ?? "";
  if (location.pathname === path || location.pathname.startsWith(`${path}/`)) link.setAttribute("aria-current", "page");
}
