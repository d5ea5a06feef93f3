// Runs before anything is shown, so that no page flashes in the other scheme. The rest of the pages are modules.
(() => {
  const kept = localStorage.getItem("wibam-theme");
  if (kept === "light" || kept === "dark") document.documentElement.dataset.theme = kept;
})();
