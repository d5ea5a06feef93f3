// Files that are chapters of one recording, by the names that cameras give them.

const SCHEMES = [/^g[a-z](\d{2})(\d{4})$/i, /^go(p)r(\d{4})$/i, /^gp(\d{2})(\d{4})$/i];
const NUMBERED = /^(.*?)[-_ .]*(?:part|chapter|teil|kapitel)[-_ .]*\d+$/i;

/** What the chapters of one recording have in common; null where a name says nothing of chapters. @param {string} filename */
export function recordingName(filename) {
  const stem = filename.replace(/\.[^.]*$/, "");
  for (const scheme of SCHEMES) {
    const found = stem.match(scheme);
    if (found) return `gopro ${found[2]}`;
  }
  return stem.match(NUMBERED)?.[1].toLowerCase() ?? null;
}
