// <point-cloud>: readings of a compass around its origin, beside the circle that the Earth's field makes.

import { colorsOf } from "./colors.js";
import { Drawing } from "./drawing.js";
import { seen } from "./eye.js";

/** @import { Quaternion, Vector } from "./rotation.js" */
/** @typedef {{ raw: Vector[], radius: number, attitude: Quaternion | null }} Cloud points in uT, radius of the Earth's field */

export class PointCloud extends Drawing {
  constructor() {
    super();
    /** @type {Cloud} */
    this._cloud = { raw: [], radius: 50, attitude: null };
  }

  /** @param {Cloud} cloud */
  set cloud(cloud) {
    this._cloud = cloud;
    this._soon();
  }

  _share() {
    return 0.48;
  }

  _reach() {
    return Math.max(1.25 * this._cloud.radius, ...this._cloud.raw.map((point) => Math.hypot(...point)));
  }

  /** @param {CanvasRenderingContext2D} pen @param {number} scale */
  _paint(pen, scale) {
    const { raw, radius } = this._cloud;
    const colors = colorsOf(this);
    pen.strokeStyle = colors.good;
    pen.lineWidth = 1.5 / scale;
    pen.beginPath();
    pen.arc(0, 0, radius, 0, 7);
    pen.stroke();
    pen.fillStyle = colors.text;
    for (const point of raw) {
      const [x, y] = seen(point);
      pen.fillRect(x - 1.5 / scale, y - 1.5 / scale, 3 / scale, 3 / scale);
    }
  }
}

customElements.define("point-cloud", PointCloud);
