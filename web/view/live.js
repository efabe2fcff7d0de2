// What the sensors read now: strip charts with rate and loss, noise spectra, |B| and |f| against what they should be.

import { h } from "../core/dom.js";
import { number, unitName } from "../core/words.js";
import { quiet, table } from "./parts.js";
import { current } from "./samples.js";
import { spectrum } from "../chart/spectrum.js";

/** @import { VehicleModel } from "../mavcal.d.ts" */
/** @import { Trace } from "./samples.js" */
/** @typedef {typeof import("../core/store.js").store} Store */

const G = 9.80665;
const ORDER = ["accel", "gyro", "mag", "temperature"];
const SILENT_MS = 3000;

/** @param {Store} store @param {VehicleModel} vehicle */
export function live(store, vehicle) {
  const samples = current();
  const held = store.keep("live", () => ({ view: "time", sensor: "accel" }));
  if (!samples || !samples.traces.size) return quiet("No sample has come yet. A vehicle streams more while a calibration runs.");
  const set = (/** @type {Partial<typeof held>} */ change) => () => { Object.assign(held, change); store.changed(); };
  const traces = [...samples.traces.values()].sort((a, b) => ORDER.indexOf(a.sensor) - ORDER.indexOf(b.sensor) || a.instance - b.instance);
  const kinds = ORDER.filter((kind) => traces.some((trace) => trace.sensor === kind));
  const shown = traces.filter((trace) => trace.sensor === held.sensor);
  const silent = performance.now() - samples.heard > SILENT_MS;
  return h("section", { key: "live" },
    silent ? h("p", { class: "notice", role: "status" }, "No sample for 3 s. The charts stand still.") : null,
    lengths(traces, samples.field),
    h("div", { class: "segmented", role: "group", "aria-label": "Sensor" }, kinds.map((kind) =>
      h("button", { "aria-pressed": `${held.sensor === kind}`, onclick: set({ sensor: kind }) }, { accel: "Accelerometer", gyro: "Gyro", mag: "Compass", temperature: "Temperature" }[kind]))),
    held.sensor === "temperature" ? null : h("div", { class: "segmented", role: "group", "aria-label": "View" },
      h("button", { "aria-pressed": `${held.view === "time"}`, onclick: set({ view: "time" }) }, "Last minute"),
      h("button", { "aria-pressed": `${held.view === "noise"}`, onclick: set({ view: "noise" }) }, "Noise spectrum")),
    h("div", { class: "charts" }, shown.map((trace) => figure(trace, held.sensor === "temperature" ? "time" : held.view, vehicle))));
}

/** @param {Trace} trace @param {string} view @param {VehicleModel} vehicle */
function figure(trace, view, vehicle) {
  const names = trace.axes.length === 3 ? ["x", "y", "z"] : [""];
  const end = trace.t[trace.t.length - 1];
  const chart = view === "noise" ? spectrum(trace) : {
    x: trace.t.map((t) => t - end),
    lines: trace.axes.map((y, i) => ({ name: names[i], color: names[i] || "accent", y })),
    unit: trace.unit, xUnit: "s",
  };
  return h("figure", { key: `${trace.sensor}${trace.instance}${view}` },
    h("figcaption", {}, h("strong", {}, trace.sensor === "temperature" ? `IMU ${trace.instance + 1}` : unitName(trace.sensor, trace.instance)),
      h("span", { class: "quiet small" }, ` ${trace.source} · ${number(trace.rate, 3)} Hz · ${(100 * vehicle.loss).toFixed(1)} % lost`)),
    h("line-chart", { role: "img", "aria-label": `${unitName(trace.sensor, trace.instance)}, ${view === "noise" ? "noise spectrum" : "last minute"}`, chart }));
}

/** |f| and |B| now, beside what they should be. @param {Trace[]} traces @param {number | null} field */
function lengths(traces, field) {
  const rows = traces.filter((trace) => trace.sensor === "accel" || trace.sensor === "mag").map((trace) => {
    const last = trace.axes.map((axis) => axis[axis.length - 1] ?? NaN);
    const length = Math.hypot(...last);
    const should = trace.sensor === "accel" ? G : field;
    const text = should === null ? "position not known" : `${number(should, 3)} ${trace.unit}`;
    return [unitName(trace.sensor, trace.instance), `${number(length, 3)} ${trace.unit}`, text,
      should === null ? "–" : `${(100 * (length / should - 1)).toFixed(1)} %`];
  });
  return rows.length ? table(["length of the vector", ">now", ">should be, at rest", ">off by"], rows, "Lengths of the vectors") : null;
}
