// The drift of a sensor against its temperature, as it grows.

import { h } from "../../core/dom.js";
import { current } from "../samples.js";
import { quiet } from "../parts.js";

/** @import { JobModel } from "../../mavcal.d.ts" */

/** @param {JobModel} job */
export function driftChart(job) {
  const drift = current()?.drift;
  const gyros = [...(drift?.keys() ?? [])].filter((key) => key.startsWith("gyro"));
  if (!drift || !gyros.length) return quiet("The drift curve begins with the first change of temperature.");
  return h("div", { class: "charts" }, gyros.map((key) => {
    const points = [...(drift.get(key) ?? [])].sort((a, b) => a[0] - b[0]);
    const first = points[0] ?? [0, 0, 0, 0];
    const degrees = 180 / Math.PI;
    return h("figure", { key }, h("figcaption", {}, `Gyro ${Number(key.split(" ")[1]) + 1}: change against temperature`),
      h("line-chart", { role: "img", "aria-label": "Drift of the gyro against its temperature", chart: {
        x: points.map((p) => p[0]),
        lines: ["x", "y", "z"].map((name, i) => ({ name, color: name, y: points.map((p) => (p[i + 1] - first[i + 1]) * degrees) })),
        unit: "deg/s", xUnit: "°C",
      } }));
  }));
}
