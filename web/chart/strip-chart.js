// <strip-chart>: a stream that runs from right to left, smoothly between its samples.

import { LineChart } from "./line-chart.js";

/** @import { Strip } from "./strip.js" */

const PICTURE_MS = 1000 / 31; // no more pictures than a person sees run smoothly: a phone stays cool
const CATCH_UP = 3; // so many that a busy browser has missed are made up for when it can
const FOLLOW_MS = 300; // samples come ten times a second, and not evenly
const THERE_S = 0.01;

export class StripChart extends LineChart {
  constructor() {
    super();
    /** @type {{ strip: Strip, names: string[], unit: string } | undefined} */
    this._stream = undefined;
    this._now = -Infinity;
    this._last = this._due = 0;
    /** How many pictures were drawn, for who measures. */
    this.pictures = 0;
  }

  /** Set whenever samples have come. @param {{ strip: Strip, names: string[], unit: string }} stream */
  set stream(stream) {
    if (stream.strip !== this._stream?.strip) this._now = -Infinity;
    this._stream = stream;
    this._soon();
  }

  _draw() {
    this._frame = 0;
    const stream = this._stream;
    if (!stream) return;
    const time = performance.now();
    if (time < this._due) {
      this._soon();
      return;
    }
    this._due = Math.max(this._due, time - CATCH_UP * PICTURE_MS) + PICTURE_MS;
    const passed = time - this._last;
    const { end } = stream.strip;
    const near = end - this._now < 2 && end >= this._now;
    this._now = near ? end + (this._now - end) * Math.exp(-passed / FOLLOW_MS) : end;
    this._last = time;
    this._chart = stream.strip.chart(this._now, stream.names, stream.unit);
    super._draw();
    this.pictures += 1;
    if (end - this._now > THERE_S) this._soon();
  }
}

customElements.define("strip-chart", StripChart);
