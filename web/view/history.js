// The history of a unit: every calibration of each sensor, its drift, two compared, one restored.

import { h } from "../core/dom.js";
import { to } from "../core/route.js";
import { ask } from "../core/service.js";
import { kindName, moment, number, unitName } from "../core/words.js";
import { quiet, table, title } from "./parts.js";

/** @typedef {typeof import("../core/store.js").store} Store */

/** @param {Store} store */
export function historyRoom(store) {
  const { id } = store.place;
  const history = store.answer(`history ${id}`, () => ask("get_unit_history", { parameters: { unit_id: id } }), 30000);
  if (!history) return h("div", {}, title("History"), quiet("Reading the history …"));
  return h("div", {}, title(`History of ${history.name || id}`),
    history.sensors.length ? history.sensors.map((sensor) => sensorHistory(store, sensor)) : quiet("No calibration of this unit has been verified yet."));
}

/** @param {Store} store @param {any} sensor */
function sensorHistory(store, sensor) {
  const rows = sensor.calibrations.map((/** @type {any} */ one) => [
    h("a", { href: to("job", one.job_id) }, moment(one.at)), kindName(one.kind), number(one.temperature, 3),
    one.bias.map((/** @type {number} */ v) => number(v, 4)).join(", "), one.sd.map((/** @type {number} */ v) => number(v, 2)).join(", ")]);
  return h("section", { class: "card", key: `${sensor.sensor}${sensor.device_id}` }, h("h2", {}, `${unitName(sensor.sensor, sensor.instance)} · ${sensor.type ?? sensor.device_id}`),
    table(["when", "method", ">°C", `>offset, ${sensor.unit}`, ">± sd"], rows, "Calibrations"));
}
