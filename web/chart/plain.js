// Draws a chart with nothing but a canvas: for an installation without uPlot.

import { colorsOf } from "../scene/colors.js";
import { number } from "../core/words.js";

/** @import { Chart } from "./line-chart.js" */

const MARGIN = { left: 56, right: 8, top: 8, bottom: 24 };

/** @param {HTMLElement} host @param {HTMLCanvasElement} canvas @param {Chart} chart */
export function drawPlain(host, canvas, chart) {
  const ratio = window.devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = host;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const pen = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  const colors = /** @type {Record<string, string>} */ (colorsOf(host));
  pen.scale(ratio, ratio);
  pen.font = "12px system-ui";
  pen.fillStyle = colors.quiet;
  const bend = chart.log ? Math.log10 : (/** @type {number} */ v) => v;
  const usable = (/** @type {number | null} */ v) => v !== null && Number.isFinite(v) && (!chart.log || v > 0);
  const [x0, x1] = chart.xRange ?? limits(chart.x.filter(usable).map(bend));
  const [y0, y1] = limits(chart.lines.flatMap((line) => line.y.filter(usable)).map((v) => bend(/** @type {number} */ (v))));
  const px = (/** @type {number} */ v) => MARGIN.left + ((v - x0) / (x1 - x0)) * (width - MARGIN.left - MARGIN.right);
  const py = (/** @type {number} */ v) => height - MARGIN.bottom - ((v - y0) / (y1 - y0)) * (height - MARGIN.top - MARGIN.bottom);
  const back = (/** @type {number} */ v) => (chart.log ? 10 ** v : v);
  pen.strokeStyle = colors.line;
  for (const v of [y0, (y0 + y1) / 2, y1]) {
    pen.beginPath();
    pen.moveTo(MARGIN.left, py(v));
    pen.lineTo(width - MARGIN.right, py(v));
    pen.stroke();
    pen.fillText(number(back(v), 3), 2, py(v) + 4);
  }
  pen.fillText(`${number(back(x0), 3)}`, MARGIN.left, height - 8);
  const end = `${number(back(x1), 3)} ${chart.xUnit}   [${chart.unit}]`;
  pen.fillText(end, width - MARGIN.right - pen.measureText(end).width, height - 8);
  for (const line of chart.lines) {
    pen.strokeStyle = colors[line.color] ?? line.color;
    pen.lineWidth = 1.5;
    pen.beginPath();
    line.y.forEach((v, i) => { if (usable(v) && usable(chart.x[i])) pen.lineTo(px(bend(chart.x[i])), py(bend(/** @type {number} */ (v)))); });
    pen.stroke();
  }
}

/** @param {number[]} values @returns {[number, number]} */
function limits(values) {
  let [low, high] = [Infinity, -Infinity];
  for (const v of values) {
    if (v < low) low = v;
    if (v > high) high = v;
  }
  if (!(low <= high)) return [0, 1];
  const room = 0.05 * (high - low) || Math.abs(high) * 0.05 || 1;
  return [low - room, high + room];
}
