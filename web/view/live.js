// What the sensors read now: strip charts with rate and loss, noise spectra, |B| and |f| against what they should be.
// While this room is open the vehicle is asked to send its samples.

import { h } from "../core/dom.js";
import { number, unitName, unitText } from "../core/words.js";
import { badge, quiet, table } from "./parts.js";
import { current, wish } from "./samples.js";
import { handSwitch, picture } from "./stage.js";
import { spectrum } from "../chart/spectrum.js";

/** @import { VehicleModel } from "../mavcal.d.ts" */
/** @import { Tone } from "./parts.js" */
/** @import { Samples, Trace } from "./samples.js" */
/** @typedef {typeof import("../core/store.js").store} Store */

const G = 9.80665;
const ORDER = ["accel", "gyro", "mag", "temperature"];
const SILENT_MS = 3000;
const RATES = [10, 50, 200]; // Hz

/** @param {Store} store @param {VehicleModel} vehicle */
export function live(store, vehicle) {
  const samples = current();
  const held = store.keep("live", () => ({ view: "time", sensor: "accel" }));
  if (!samples) return quiet("Waiting for this vehicle …");
  if (!samples.traces.size) return h("section", { key: "live" }, asked(store, samples), quiet("No sample has come yet."));
  const set = (/** @type {Partial<typeof held>} */ change) => () => { Object.assign(held, change); store.changed(); };
  const traces = [...samples.traces.values()].sort((a, b) => ORDER.indexOf(a.sensor) - ORDER.indexOf(b.sensor) || a.instance - b.instance);
  const kinds = ORDER.filter((kind) => traces.some((trace) => trace.sensor === kind));
  const shown = traces.filter((trace) => trace.sensor === held.sensor);
  const silent = performance.now() - samples.heard > SILENT_MS;
  return h("section", { key: "live" },
    asked(store, samples),
    silent ? h("p", { class: "notice", role: "status" }, "No sample for 3 s. The charts stand still.") : null,
    h("div", { class: "now-held" },
      h("div", { class: "stage" }, picture(store, vehicle, { attitude: samples.attitude, ghost: null, words: "The vehicle as it is held now", flat: true }), handSwitch(store, vehicle)),
      lengths(traces, samples.field)),
    h("div", { class: "segmented", role: "group", "aria-label": "Sensor" }, kinds.map((kind) =>
      h("button", { "aria-pressed": `${held.sensor === kind}`, onclick: set({ sensor: kind }) }, { accel: "Accelerometer", gyro: "Gyro", mag: "Compass", temperature: "Temperature" }[kind]))),
    held.sensor === "temperature" ? null : h("div", { class: "segmented", role: "group", "aria-label": "View" },
      h("button", { "aria-pressed": `${held.view === "time"}`, onclick: set({ view: "time" }) }, "Last minute"),
      h("button", { "aria-pressed": `${held.view === "noise"}`, onclick: set({ view: "noise" }) }, "Noise spectrum")),
    h("div", { class: "charts" }, shown.map((trace) => figure(trace, held.sensor === "temperature" ? "time" : held.view, samples.loss ?? vehicle.loss))));
}

/** What the vehicle is asked for, and what became of that. @param {Store} store @param {Samples} samples */
function asked(store, samples) {
  const wished = wish(store);
  const choose = (/** @type {number} */ rate) => () => { wished.rate = rate; store.changed(); };
  return h("div", { class: "asked", key: "asked" },
    h("div", { class: "segmented", role: "group", "aria-label": "Samples a second" }, RATES.map((rate) =>
      h("button", { "aria-pressed": `${wished.rate === rate}`, onclick: choose(rate) }, `${rate} Hz`))),
    h("p", { class: "small", role: "status" }, badge(...fate(samples, wished.rate))));
}

/** @param {Samples} samples @param {number} rate @returns {[Tone, string]} */
function fate({ refused, watch }, rate) {
  if (refused) return ["warn", `The vehicle is not asked for samples: ${refused}`];
  if (!watch || watch.state === "asking") return ["busy", `Asking the vehicle for ${rate} samples a second …`];
  if (watch.state === "waiting") return ["warn", watch.text];
  const others = watch.rate_hz === rate ? "" : " Somebody else who watches asked for more.";
  return [watch.text ? "warn" : "good", `${watch.text || `Asked for ${watch.rate_hz} samples a second; put back when you leave.`}${others}`];
}

/** @param {Trace} trace @param {string} view @param {number} loss */
function figure(trace, view, loss) {
  const names = trace.axes.length === 3 ? ["x", "y", "z"] : [""];
  return h("figure", { key: `${trace.sensor}${trace.instance}${view}` },
    h("figcaption", {}, h("strong", {}, trace.sensor === "temperature" ? `IMU ${trace.instance + 1}` : unitName(trace.sensor, trace.instance)),
      h("span", { class: "quiet small" }, ` ${trace.source} · ${number(trace.rate, 3)} Hz · ${(100 * loss).toFixed(1)} % lost`)),
    view === "noise"
      ? h("line-chart", { role: "img", "aria-label": `${unitName(trace.sensor, trace.instance)}, noise spectrum`, chart: spectrum(trace) })
      : h("strip-chart", { role: "img", "aria-label": `${unitName(trace.sensor, trace.instance)}, last minute`, stream: { strip: trace.strip, names, unit: trace.unit } }));
}

/** |f| and |B| now, beside what they should be. @param {Trace[]} traces @param {number | null} field */
function lengths(traces, field) {
  const rows = traces.filter((trace) => trace.sensor === "accel" || trace.sensor === "mag").map((trace) => {
    const last = trace.axes.map((axis) => axis[axis.length - 1] ?? NaN);
    const length = Math.hypot(...last);
    const should = trace.sensor === "accel" ? G : field;
    const text = should === null ? "position not known" : `${number(should, 3)} ${unitText(trace.unit)}`;
    return [unitName(trace.sensor, trace.instance), `${number(length, 3)} ${unitText(trace.unit)}`, text,
      should === null ? "–" : `${(100 * (length / should - 1)).toFixed(1)} %`];
  });
  return rows.length ? table(["length of the vector", ">now", ">should be, at rest", ">off by"], rows, "Lengths of the vectors") : null;
}
