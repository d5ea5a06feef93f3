// The fields of the chosen vehicle: numbers, class, what cameras see of it.
import { byId, fill, h } from "./dom.js";
import { duration, percent } from "./format.js";

const FIELDS = /** @type {Array<[string, number, number, number]>} name, place in a box, factor to show it, step */ ([
  ["x, m", 0, 1, 0.05], ["y, m", 1, 1, 0.05], ["z, m", 2, 1, 0.05], ["length, m", 3, 1, 0.05], ["width, m", 4, 1, 0.05], ["height, m", 5, 1, 0.05], ["yaw, °", 6, 180 / Math.PI, 1],
]);

/** Whether an instant is there to be changed; says so where none is. @param {import("./labelmodel.js").Model} model @returns {boolean} */
export function mayChange(model) {
  if (!model.isOpen) byId("saved").textContent = "nothing can be changed until the instant is loaded";
  return model.isOpen;
}

/** Make the fields, once. @param {{classes: string[], cameras: string[], update: (change: any, step: string|null) => void, current: () => any}} page */
export function makePanel(page) {
  fill(byId("class"), page.classes.map((name) => h("option", { value: name }, name)));
  byId("class").addEventListener("change", () => page.update({ class: byId("class").value }, null));
  byId("ignored").addEventListener("change", () => page.update({ ignored: byId("ignored").checked }, null));
  fill(byId("numbers"), FIELDS.map(([title, place, factor, step]) => h("label", null, `${title} `, h("input.number", {
    id: `field-${place}`, type: "number", step, onchange: (/** @type {Event} */ event) => {
      const input = /** @type {HTMLInputElement} */ (event.target), vehicle = page.current(), least = place >= 3 && place <= 5 ? 0.2 : -1e7;
      if (!vehicle || input.value === "" || Number(input.value) < least) return;
      page.update({ box: vehicle.box.map((/** @type {number} */ value, /** @type {number} */ k) => (k === place ? Number(input.value) / factor : value)) }, null);
    },
  }))));
  fill(byId("seen"), page.cameras.map((camera) => h("tr", null, h("th", { scope: "row" }, camera), h("td.number", { id: `estimated-${camera}` }), h("td", null, h("input.number", {
    id: `corrected-${camera}`, type: "number", min: 0, max: 100, step: 5, "aria-label": `Share that ${camera} sees, corrected, in per cent`, onchange: (/** @type {Event} */ event) => {
      const input = /** @type {HTMLInputElement} */ (event.target), visibility = { ...page.current()?.visibility };
      if (input.value === "" || !input.checkValidity()) delete visibility[camera];
      else visibility[camera] = Number(input.value) / 100;
      page.update({ visibility }, null);
    },
  })))));
}

/** Show a vehicle. @param {any} vehicle @param {string[]} cameras @param {Object<string, number>} seen camera -> share @param {number} seconds */
export function showVehicle(vehicle, cameras, seen, seconds) {
  byId("fields").hidden = !vehicle;
  byId("none-chosen").hidden = Boolean(vehicle);
  if (!vehicle) return;
  const put = (/** @type {string} */ id, /** @type {string} */ value) => { if (document.activeElement !== byId(id)) byId(id).value = value; };
  put("class", vehicle.class);
  byId("ignored").checked = vehicle.ignored;
  for (const [, place, factor] of FIELDS) put(`field-${place}`, (vehicle.box[place] * factor).toFixed(place === 6 ? 1 : 2));
  for (const camera of cameras) {
    byId(`estimated-${camera}`).textContent = percent(seen[camera] ?? null);
    put(`corrected-${camera}`, camera in vehicle.visibility ? String(Math.round(100 * vehicle.visibility[camera])) : "");
  }
  byId("vehicle-worked").textContent = `${duration(vehicle.seconds + seconds)} of work on this vehicle`;
}
