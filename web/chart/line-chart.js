// <line-chart>: lines against a common axis. uPlot draws them where it is installed, a few lines of our own elsewhere.

import { uPlot } from "../core/vendor.js";
import { colorsOf } from "../scene/colors.js";
import { drawPlain } from "./plain.js";

/**
 * @typedef {{ name: string, color: string, y: (number | null)[] }} Line
 * @typedef {{ x: number[], lines: Line[], unit: string, xUnit: string, log?: boolean, xRange?: [number, number] }} Chart
 */

export class LineChart extends HTMLElement {
  constructor() {
    super();
    /** @type {Chart | undefined} */
    this._chart = undefined;
    /** @type {any} */
    this._plot = undefined;
    this._form = "";
    this._frame = 0;
  }

  connectedCallback() {
    this._sizes = new ResizeObserver(() => { this._form = ""; this._soon(); });
    this._sizes.observe(this);
    uPlot().then((found) => {
      this._maker = found;
      this._soon();
    });
  }

  disconnectedCallback() {
    this._sizes?.disconnect();
    cancelAnimationFrame(this._frame);
    this._frame = 0;
    this._forget();
  }

  /** @param {Chart} chart */
  set chart(chart) {
    this._chart = chart;
    this._soon();
  }

  _soon() {
    if (!this._frame && this.isConnected && this._maker !== undefined) this._frame = requestAnimationFrame(() => this._draw());
  }

  _forget() {
    this._plot?.destroy();
    this._plot = undefined;
    this._form = "";
    this.replaceChildren();
  }

  _draw() {
    this._frame = 0;
    const chart = this._chart;
    if (!chart || !this.clientWidth || !this.clientHeight) return;
    if (this._maker === null) {
      if (!this._canvas?.isConnected) this._canvas = this.appendChild(document.createElement("canvas"));
      drawPlain(this, this._canvas, chart);
      return;
    }
    const data = [chart.x, ...chart.lines.map((line) => (chart.log ? line.y.map((v) => (v !== null && v > 0 ? v : null)) : line.y))];
    const form = JSON.stringify([chart.lines.map(({ name, color }) => [name, color]), chart.unit, chart.xUnit, chart.log, chart.xRange, document.documentElement.dataset.theme]);
    if (form !== this._form) {
      this._forget();
      this._plot = new this._maker(this._options(chart), data, this);
      this._form = form;
    } else {
      this._plot.setData(data);
    }
  }

  /** @param {Chart} chart */
  _options(chart) {
    const colors = /** @type {Record<string, string>} */ (colorsOf(this));
    const axis = { stroke: colors.quiet, grid: { stroke: colors.line, width: 1 }, ticks: { stroke: colors.line, width: 1 }, font: "12px system-ui" };
    const { width, height } = this.getBoundingClientRect();
    return {
      width, height: height - 28, cursor: { drag: { x: false, y: false } }, legend: { live: false },
      scales: { x: { time: false, ...(chart.log ? { distr: 3 } : {}), ...(chart.xRange ? { range: chart.xRange } : {}) }, y: chart.log ? { distr: 3 } : {} },
      axes: [{ ...axis, label: chart.xUnit, labelSize: 16, size: 34 }, { ...axis, label: chart.unit, labelSize: 16, size: 58 }],
      series: [{}, ...chart.lines.map((line) => ({ label: line.name || "value", stroke: colors[line.color] ?? line.color, width: 1.5, points: { show: false } }))],
    };
  }
}

customElements.define("line-chart", LineChart);
