// Figures as a person reads them. A dash stands for "there is none".

const NONE = "–";

/** @param {number|null|undefined} value @param {number} [digits] */
export function number(value, digits = 2) {
  return value === null || value === undefined || !Number.isFinite(value) ? NONE : value.toFixed(digits).replace("-", "−");
}

/** @param {{mean: number|null, sd: number|null}|null|undefined} value @param {number} [digits] */
export function meanSd(value, digits = 2) {
  if (!value || value.mean === null) return NONE;
  return number(value.mean, digits) + (value.sd === null ? "" : ` ± ${number(value.sd, digits)}`);
}

/** @param {number|null|undefined} share */
export function percent(share) {
  return share === null || share === undefined ? NONE : `${Math.round(100 * share)} %`;
}

/** @param {number|null|undefined} seconds */
export function duration(seconds) {
  if (seconds === null || seconds === undefined) return NONE;
  if (seconds < 59.5) return `${seconds < 10 ? seconds.toFixed(1) : Math.round(seconds)} s`;
  const whole = Math.round(seconds), minutes = Math.floor(whole / 60), rest = whole % 60;
  if (minutes < 60) return `${minutes} min ${String(rest).padStart(2, "0")} s`;
  return `${Math.floor(minutes / 60)} h ${String(minutes % 60).padStart(2, "0")} min`;
}

/** Seconds as m:ss.t. @param {number} seconds */
export function clock(seconds) {
  const sign = seconds < 0 ? "−" : "", whole = Math.round(Math.abs(seconds) * 10) / 10, minutes = Math.floor(whole / 60);
  return `${sign}${minutes}:${(whole - 60 * minutes).toFixed(1).padStart(4, "0")}`;
}

/** @param {number} bytes */
export function size(bytes) {
  const units = ["B", "kB", "MB", "GB", "TB"];
  let value = bytes, unit = 0;
  while (value >= 1000 && unit < units.length - 1) { value /= 1000; unit += 1; }
  return `${unit && value < 100 ? value.toFixed(1) : Math.round(value)} ${units[unit]}`;
}

/** @param {string|null|undefined} iso */
export function when(iso) {
  if (!iso) return NONE;
  return new Date(iso).toLocaleString(undefined, { dateStyle: "medium", timeStyle: "short" });
}

/** An underscored name in words. @param {string} name */
export function words(name) {
  return name.replaceAll("_", " ");
}
