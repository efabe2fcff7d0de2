// The samples of the vehicle that is looked at: the newest values, and a minute of them for charts.

import { follow } from "../core/service.js";

/** @import { LiveModel, SamplesModel } from "../mavcal.d.ts" */
/** @import { Quaternion, Vector } from "../scene/rotation.js" */
/** @typedef {typeof import("../core/store.js").store} Store */

export const KEPT_S = 60;
const CLOUD = 1500;

/**
 * @typedef {{ sensor: string, instance: number, unit: string, source: string, t: number[], axes: (number | null)[][], rate: number }} Trace
 * @typedef {{
 *   vehicle: string, attitude: Quaternion | null, field: number | null, traces: Map<string, Trace>, cloud: Map<number, Vector[]>,
 *   now: Map<string, (number | null)[]>, drift: Map<string, [number, number, number, number][]>, heard: number
 * }} Samples
 */

/** @type {Samples | undefined} */
let samples;
let stop = () => {};

/** What is known of the vehicle that is looked at. @returns {Samples | undefined} */
export const current = () => samples;

/** The vehicle that the page is about, if it shows samples. @param {Store} store */
function wanted(store) {
  const { room, id } = store.place;
  if (room === "vehicle") return id;
  if (room === "job") return store.jobs.get(id)?.vehicle_id ?? "";
  return "";
}

/** Follow the samples of the vehicle that is looked at, and of no other. @param {Store} store */
export function followSamples(store) {
  const id = wanted(store);
  const known = store.vehicles.has(id);
  if ((known ? id : "") === (samples?.vehicle ?? "")) return;
  stop();
  stop = () => {};
  samples = undefined;
  if (!known) return;
  samples = { vehicle: id, attitude: null, field: null, traces: new Map(), cloud: new Map(), now: new Map(), drift: new Map(), heard: 0 };
  stop = follow("follow_samples", { parameters: { vehicle_id: id } }, ["samples"], {
    told: (_, data) => {
      take(/** @type {Samples} */ (samples), data);
      store.changed();
    },
  });
}

/** Forget the points of the compasses: another job begins. */
export function forgetCloud() {
  samples?.cloud.clear();
  samples?.drift.clear();
}

/** @param {Samples} into @param {LiveModel} data */
function take(into, data) {
  into.attitude = data.attitude ?? into.attitude;
  into.field = data.model_field_ut ?? into.field;
  if (data.channels.length) into.heard = performance.now();
  for (const channel of data.channels) {
    const key = `${channel.sensor} ${channel.instance}`;
    append(into, key, channel);
    into.now.set(key, channel.values.map((axis) => axis[axis.length - 1] ?? null));
  }
  for (const channel of data.bare) gather(into, channel);
  drift(into, data);
}

/** @param {Samples} into @param {string} key @param {SamplesModel} channel */
function append(into, key, channel) {
  const { sensor, instance, unit, source } = channel;
  const trace = into.traces.get(key) ?? { sensor, instance, unit, source, t: [], axes: channel.values.map(() => []), rate: 0 };
  into.traces.set(key, trace);
  const first = channel.t[0] ?? 0;
  if (trace.t.length && first < trace.t[trace.t.length - 1]) { // the vehicle started again
    trace.t.length = 0;
    trace.axes.forEach((axis) => { axis.length = 0; });
  }
  trace.t.push(...channel.t);
  trace.axes.forEach((axis, i) => axis.push(...(channel.values[i] ?? [])));
  const end = trace.t[trace.t.length - 1];
  const gone = trace.t.findIndex((t) => t >= end - KEPT_S);
  if (gone > 0) {
    trace.t.splice(0, gone);
    trace.axes.forEach((axis) => axis.splice(0, gone));
  }
  const span = end - trace.t[0];
  trace.rate = span > 1 ? (trace.t.length - 1) / span : 0;
}

/** Points of a compass, no two of them close together. @param {Samples} into @param {SamplesModel} channel */
function gather(into, channel) {
  const cloud = into.cloud.get(channel.instance) ?? [];
  into.cloud.set(channel.instance, cloud);
  const [x, y, z] = channel.values;
  for (let i = 0; i < channel.t.length; i += 1) {
    if (x[i] === null || y[i] === null || z[i] === null) continue;
    const point = /** @type {Vector} */ ([x[i], y[i], z[i]]);
    const last = cloud[cloud.length - 1];
    if (last && Math.hypot(point[0] - last[0], point[1] - last[1], point[2] - last[2]) < 1.5) continue;
    cloud.push(point);
  }
  if (cloud.length > CLOUD) cloud.splice(0, cloud.length - CLOUD);
}

/** Readings against temperature, a point for each tenth of a degree. @param {Samples} into @param {LiveModel} data */
function drift(into, data) {
  for (const channel of data.channels) {
    if (channel.sensor !== "gyro" && channel.sensor !== "accel") continue;
    const warm = into.now.get(`temperature ${channel.instance}`)?.[0];
    if (warm === null || warm === undefined || !channel.t.length) continue;
    const key = `${channel.sensor} ${channel.instance}`;
    const points = into.drift.get(key) ?? [];
    into.drift.set(key, points);
    const means = channel.values.map((axis) => {
      const there = axis.filter((value) => value !== null);
      return there.reduce((sum, value) => sum + value, 0) / Math.max(1, there.length);
    });
    const last = points[points.length - 1];
    if (last && Math.abs(last[0] - warm) < 0.1) {
      for (let i = 0; i < 3; i += 1) last[i + 1] += 0.1 * (means[i] - last[i + 1]); // a running mean while it stays as warm
    } else {
      points.push([warm, means[0], means[1], means[2]]);
      if (points.length > 2000) points.splice(0, 1);
    }
  }
}
