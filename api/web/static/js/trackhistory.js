// What is known of one road user over time: all seven degrees of freedom, with their intervals.
import { h } from "./dom.js";
import { clock, number } from "./format.js";

const DEGREES = 180 / Math.PI;
/** Half of a 95 % interval in standard deviations. */
const WITHIN = 1.96;
/** Title, field of a state, field of its standard deviation, digits, factor to what is shown. */
const COLUMNS = /** @type {Array<[string, string, string, number, number]>} */ ([
  ["x, m", "x_m", "sd_x_m", 2, 1], ["y, m", "y_m", "sd_y_m", 2, 1], ["z, m", "z_m", "sd_z_m", 2, 1],
  ["length, m", "length_m", "sd_length_m", 2, 1], ["width, m", "width_m", "sd_width_m", 2, 1], ["height, m", "height_m", "sd_height_m", 2, 1],
  ["yaw, °", "yaw_rad", "sd_yaw_rad", 1, DEGREES],
]);

/** A table of a track's states. @param {any[]} track its states by time @returns {HTMLElement} */
export function historyOf(track) {
  const title = (/** @type {string} */ text) => h("th.number", { scope: "col" }, text), cell = (/** @type {string} */ text) => h("td.number", null, text);
  const within = (/** @type {any} */ state, /** @type {[string, string, string, number, number]} */ [, field, sd, digits, factor]) =>
    number(state[field] * factor, digits) + (state[sd] === null ? "" : ` ± ${number(WITHIN * state[sd] * factor, digits)}`);
  return h("table", null, h("caption", null, "With 95 % intervals"),
    h("thead", null, h("tr", null, title("time"), COLUMNS.map(([name]) => title(name)), title("speed, m/s"))),
    h("tbody", null, track.map((state) => h("tr", null, cell(clock(state.time_ns / 1e9)), COLUMNS.map((column) => cell(within(state, column))), cell(number(state.speed_mps, 1))))));
}
