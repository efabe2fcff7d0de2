// The samples of the vehicle that is looked at: the newest values, and a minute of them for charts.

import { ask, follow, Refused } from "../core/service.js";
import { Strip } from "../chart/strip.js";

/** @import { LiveModel, SamplesModel, WatchStatusModel } from "../mavcal.d.ts" */
/** @import { Quaternion, Vector } from "../scene/rotation.js" */
/** @typedef {typeof import("../core/store.js").store} Store */

export const KEPT_S = 60;
const CLOUD = 1500;
const RATE_S = 3;

/**
 * @typedef {{ sensor: string, instance: number, unit: string, source: string, t: number[], axes: (number | null)[][], strip: Strip, rate: number }} Trace
 * @typedef {{
 *   vehicle: string, attitude: Quaternion | null, field: number | null, traces: Map<string, Trace>, cloud: Map<number, Vector[]>,
 *   now: Map<string, (number | null)[]>, drift: Map<string, [number, number, number, number][]>, heard: number,
 *   loss: number | null, watch: WatchStatusModel | null, refused: string
 * }} Samples
 */

/** @type {Samples | undefined} */
let samples;
let stop = () => {};
/** What is followed: the vehicle, and the rate that it is asked for; 0: it is asked for nothing. */
let followed = "";

/** What is known of the vehicle that is looked at. @returns {Samples | undefined} */
export const current = () => samples;

/** The vehicle that the page is about, if it shows samples. @param {Store} store */
function wanted(store) {
  const { room, id } = store.place;
  if (room === "vehicle") return id;
  if (room === "job") return store.jobs.get(id)?.vehicle_id ?? "";
  return "";
}

/** The rate that the live room asks for, Hz. @param {Store} store */
export const wish = (store) => store.keep("wish", () => ({ rate: 50 }));

/** Follow the samples of the vehicle that is looked at, and of no other. @param {Store} store */
export function followSamples(store) {
  const found = wanted(store);
  const id = store.vehicles.has(found) ? found : "";
  const rate = id && store.place.room === "vehicle" && store.place.tab === "live" ? wish(store).rate : 0;
  if (`${id} ${rate}` === followed) return;
  followed = `${id} ${rate}`;
  stop();
  stop = () => {};
  if (!id) samples = undefined;
  else if (samples?.vehicle !== id) samples = nothing(id);
  if (!samples) return;
  const into = samples;
  Object.assign(into, { watch: null, refused: "" });
  stop = follow("follow_samples", () => asked(into, rate), ["samples"], {
    told: (_, data) => {
      take(into, data);
      store.changed();
    },
  });
}

/** @param {string} vehicle @returns {Samples} */
const nothing = (vehicle) => ({
  vehicle, attitude: null, field: null, traces: new Map(), cloud: new Map(), now: new Map(), drift: new Map(), heard: 0,
  loss: null, watch: null, refused: "",
});

/**
 * What the stream takes: a watch, if the vehicle is to send its samples. Without one it is followed all the same.
 * @param {Samples} into @param {number} rate
 */
async function asked(into, rate) {
  const parameters = { vehicle_id: into.vehicle };
  if (!rate) return { parameters };
  try {
    const { id } = await ask("watch_vehicle", { parameters, body: { rate_hz: rate } });
    into.refused = "";
    return { parameters, query: { watch: id } };
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    into.refused = error.message;
    return { parameters };
  }
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
  into.loss = data.loss;
  into.watch = data.watch;
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
  const trace = into.traces.get(key) ?? {
    sensor, instance, unit, source, t: [], axes: channel.values.map(() => []), strip: new Strip(channel.values.length, KEPT_S), rate: 0,
  };
  trace.source = source;
  into.traces.set(key, trace);
  const first = channel.t[0] ?? 0;
  if (trace.t.length && first < trace.t[trace.t.length - 1]) { // the vehicle started again
    trace.t.length = 0;
    trace.axes.forEach((axis) => { axis.length = 0; });
  }
  trace.strip.push(channel.t, channel.values);
  trace.t.push(...channel.t);
  trace.axes.forEach((axis, i) => axis.push(...(channel.values[i] ?? [])));
  const end = trace.t[trace.t.length - 1];
  const gone = trace.t.findIndex((t) => t >= end - KEPT_S);
  if (gone > 0) {
    trace.t.splice(0, gone);
    trace.axes.forEach((axis) => axis.splice(0, gone));
  }
  trace.rate = lately(trace.t);
}

/** How often samples came within the last seconds, Hz; 0: too short to say. @param {number[]} t */
function lately(t) {
  const end = t[t.length - 1];
  let i = t.length - 1;
  while (i > 0 && t[i - 1] >= end - RATE_S) i -= 1;
  const span = end - t[i];
  return span > 0.5 ? (t.length - 1 - i) / span : 0;
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
