// The history of a unit: every calibration of each sensor, its drift, two of them compared, the last one restored.

import { h } from "../core/dom.js";
import { go, to } from "../core/route.js";
import { ask } from "../core/service.js";
import { AUTOPILOTS, kindName, moment, number, unitName, unitText } from "../core/words.js";
import { vehicleName } from "./home.js";
import { badge, quiet, table, title } from "./parts.js";

/** @import { FleetSensorModel, SensorRecordModel, UnitHistoryModel } from "../mavcal.d.ts" */
/** @typedef {typeof import("../core/store.js").store} Store */

const DAY_S = 86400;

/** @param {Store} store */
export function historyRoom(store) {
  const { id } = store.place;
  const history = store.answer(`history ${id}`, () => ask("get_unit_history", { parameters: { unit_id: id } }), 30000);
  if (!history) return h("div", {}, title("History"), quiet("Reading the history …"));
  const { unit } = history;
  const vehicle = store.vehicles.get(id);
  return h("div", {},
    title(`History of ${unit.name || (vehicle ? vehicleName(vehicle) : AUTOPILOTS[unit.autopilot] ?? "a vehicle")}`, vehicle ? h("div", { class: "actions" },
      h("a", { class: "button", href: to("vehicle", id) }, "The vehicle"),
      h("button", { onclick: () => restore(store, id) }, "Restore the last verified calibration")) : null),
    vehicle ? null : h("p", { class: "quiet small" }, `Unit ${unit.unit}`),
    unit.needs_recalibration ? h("div", { class: "first-line warn" }, h("p", {}, "Calibrate it again:"), h("ul", {}, unit.reasons.map((reason) => h("li", { key: reason.text }, reason.text)))) : null,
    unit.sensors.length ? unit.sensors.map((sensor) => sensorCard(store, history, sensor)) : quiet("No calibration of this unit has been verified yet."));
}

/** A plan that puts the last verified calibration back, for a review like any other. @param {Store} store @param {string} id */
function restore(store, id) {
  return store.act(async () => {
    const job = await ask("restore_calibration", { parameters: { vehicle_id: id }, body: {} });
    await store.load(job.id);
    go("job", job.id);
  });
}

/** @param {Store} store @param {UnitHistoryModel} history @param {FleetSensorModel} sensor */
function sensorCard(store, history, sensor) {
  const ours = history.records.filter((record) =>
    record.sensor === sensor.sensor && (sensor.device_id ? record.device_id === sensor.device_id : record.instance === sensor.instance));
  const key = `${sensor.sensor}${sensor.instance}`;
  const chosen = store.keep(`compare ${history.unit.unit} ${key}`, () => /** @type {string[]} */ ([]));
  const pick = (/** @type {SensorRecordModel} */ record) => () => {
    const at = chosen.indexOf(record.source_id);
    if (at >= 0) chosen.splice(at, 1);
    else chosen.push(record.source_id);
    if (chosen.length > 2) chosen.shift();
    store.changed();
  };
  const rows = [...ours].reverse().slice(0, 30).map((record) => [
    h("input", { type: "checkbox", "aria-label": `Compare ${moment(record.at)}`, checked: chosen.includes(record.source_id), onchange: pick(record) }),
    moment(record.at),
    record.what === "rest" ? "Preflight" : kindName(record.what), number(record.temperature, 3),
    (record.bias ?? []).map((value) => number(value, 3)).join(", ") || "–", (record.sd ?? []).map((value) => number(value, 2)).join(", ") || "–",
    record.source === "job" ? h("a", { href: to("job", record.source_id) }, "Open") : "–"]);
  return h("section", { class: "card", key },
    h("div", { class: "title" }, h("h2", {}, `${unitName(sensor.sensor, sensor.instance)}${sensor.type ? ` · ${sensor.type}` : ""}`),
      sensor.oddness?.odd ? badge("warn", "unlike others of its type") : null),
    drift(sensor),
    ours.filter((record) => record.bias).length > 1 ? curves(ours) : null,
    compared(ours.filter((record) => chosen.includes(record.source_id))),
    rows.length ? table(["", "when", "by", ">°C", `>offset, ${unitText(sensor.drift.unit)}`, ">± sd", "job"], rows, "Calibrations", [1, 2]) : quiet("Not measured yet."));
}

/** @param {FleetSensorModel} sensor */
function drift({ drift: found }) {
  const leaving = found.leaving?.middle;
  const said = [
    leaving ? `It leaves its limit of ${number(found.limit, 2)} ${unitText(found.unit)} about ${new Date(1000 * leaving).toLocaleDateString()}.` : "",
    ...found.open.map((open) => open.why),
  ].filter(Boolean);
  const once = [...new Set(said)];
  return once.length ? h("ul", { class: "small quiet" }, once.map((text, i) => h("li", { key: `${i}` }, text))) : null;
}

/** The offset over the days, and against temperature. @param {SensorRecordModel[]} records */
function curves(records) {
  const measured = records.filter((record) => record.bias !== null);
  const last = measured[measured.length - 1].at;
  /** @type {(x: (record: SensorRecordModel) => number, xUnit: string, these: SensorRecordModel[]) => any} */
  const chart = (x, xUnit, these) => {
    const sorted = [...these].sort((a, b) => x(a) - x(b));
    return h("line-chart", { role: "img", "aria-label": `Offset against ${xUnit}`, chart: {
      x: sorted.map(x), unit: sorted[0].unit, xUnit,
      lines: ["x", "y", "z"].map((name, i) => ({ name, color: name, y: sorted.map((record) => record.bias?.[i] ?? null) })) } });
  };
  const warm = measured.filter((record) => record.temperature !== null);
  return h("div", { class: "charts" },
    h("figure", { key: "time" }, h("figcaption", {}, "Offset over time"), chart((record) => (record.at - last) / DAY_S, "days", measured)),
    warm.length > 1 ? h("figure", { key: "warm" }, h("figcaption", {}, "Offset against temperature"), chart((record) => record.temperature ?? 0, "°C", warm)) : null);
}

/** What changed between two of them. @param {SensorRecordModel[]} two */
function compared(two) {
  if (two.length !== 2 || !two[0].bias || !two[1].bias) return null;
  const [a, b] = two[0].at < two[1].at ? two : [two[1], two[0]];
  const rows = ["x", "y", "z"].map((axis, i) => {
    const [from, till] = [a.bias?.[i] ?? NaN, b.bias?.[i] ?? NaN];
    const sd = Math.hypot(a.sd?.[i] ?? 0, b.sd?.[i] ?? 0);
    return [axis, number(from), number(till), number(till - from, 3), sd ? `${number(Math.abs(till - from) / sd, 2)} sd` : "–"];
  });
  return table(["axis", `>${moment(a.at)}`, `>${moment(b.at)}`, `>change, ${a.unit}`, ">that is"], rows, "Two calibrations compared", [0, 3, 4]);
}
