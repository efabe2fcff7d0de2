// The last minute of a stream, thinned out for a chart: what is drawn in one column of the screen has its least and its
// greatest value, so that no peak is lost and a fast stream costs no more than a slow one.

/** @typedef {import("./line-chart.js").Chart} Chart */

const COLUMNS = 600;

export class Strip {
  /** @param {number} axes how many lines @param {number} span length of the picture, s */
  constructor(axes, span) {
    this.span = span;
    this.end = -Infinity;
    this._width = span / COLUMNS;
    /** @type {number[]} */
    this._t = [];
    /** @type {(number | null)[][]} */
    this._y = Array.from({ length: axes }, () => []);
    /** @type {number[]} Times of the column that is being filled. */
    this._open = [];
    /** @type {(number | null)[][]} */
    this._values = this._y.map(() => []);
  }

  _clear() {
    for (const list of [this._t, this._open, ...this._y, ...this._values]) list.length = 0;
  }

  /** Take samples in the order of time; a clock that jumps back begins a new picture. @param {number[]} t @param {(number | null)[][]} values a column an axis */
  push(t, values) {
    for (let i = 0; i < t.length; i += 1) {
      if (t[i] < this.end) this._clear();
      if (this._open.length && Math.floor(t[i] / this._width) !== Math.floor(this._open[0] / this._width)) this._close();
      this._open.push(t[i]);
      this._values.forEach((axis, k) => axis.push(values[k]?.[i] ?? null));
      this.end = t[i];
    }
    let gone = 0;
    while (gone < this._t.length && this._t[gone] < this.end - this.span - 1) gone += 1;
    if (gone) for (const list of [this._t, ...this._y]) list.splice(0, gone);
  }

  /** A column with its extremes, in the order in which they came; one with two samples at most as it is. */
  _close() {
    const open = this._open;
    const [first, last] = [open[0], open[open.length - 1]];
    if (open.length <= 2) {
      this._t.push(...open);
      this._values.forEach((axis, k) => this._y[k].push(...axis));
    } else {
      this._t.push(first, last);
      this._values.forEach((axis, k) => this._y[k].push(...extremes(axis)));
    }
    this._open = [];
    this._values = this._y.map(() => []);
  }

  /** What is drawn: times before `now`. @param {number} now @param {string[]} names @param {string} unit @returns {Chart} */
  chart(now, names, unit) {
    return {
      x: this._t.map((t) => t - now), unit, xUnit: "s", xRange: [-this.span, 0],
      lines: this._y.map((y, i) => ({ name: names[i], color: names[i] || "accent", y })),
    };
  }
}

/** The least and the greatest value, the earlier one first. @param {(number | null)[]} axis @returns {[number | null, number | null]} */
function extremes(axis) {
  let [low, high] = [-1, -1];
  for (let i = 0; i < axis.length; i += 1) {
    const value = axis[i];
    if (value === null) continue;
    if (low < 0 || value < /** @type {number} */ (axis[low])) low = i;
    if (high < 0 || value > /** @type {number} */ (axis[high])) high = i;
  }
  if (low < 0) return [null, null];
  return low < high ? [axis[low], axis[high]] : [axis[high], axis[low]];
}
