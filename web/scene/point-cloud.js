// <point-cloud>: readings of a compass around its origin, beside the circle that the Earth's field makes.

import { colorsOf } from "./colors.js";
import { seen } from "./eye.js";

/** @import { Quaternion, Vector } from "./rotation.js" */
/** @typedef {{ raw: Vector[], radius: number, attitude: Quaternion | null }} Cloud points in uT, radius of the Earth's field */

export class PointCloud extends HTMLElement {
  constructor() {
    super();
    /** @type {Cloud} */
    this._cloud = { raw: [], radius: 50, attitude: null };
    this._frame = 0;
  }

  connectedCallback() {
    this._canvas = this.appendChild(document.createElement("canvas"));
    this._sizes = new ResizeObserver(() => this._soon());
    this._sizes.observe(this);
  }

  disconnectedCallback() {
    this._sizes?.disconnect();
    cancelAnimationFrame(this._frame);
    this._frame = 0;
    this._canvas?.remove();
  }

  /** @param {Cloud} cloud */
  set cloud(cloud) {
    this._cloud = cloud;
    this._soon();
  }

  _soon() {
    if (!this._frame && this.isConnected) this._frame = requestAnimationFrame(() => this._draw());
  }

  _draw() {
    this._frame = 0;
    const { clientWidth: width, clientHeight: height } = this;
    const canvas = this._canvas;
    if (!canvas || !width || !height) return;
    const ratio = window.devicePixelRatio || 1;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const pen = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    const { raw, radius } = this._cloud;
    const colors = colorsOf(this);
    const reach = Math.max(1.25 * radius, ...raw.map((point) => Math.hypot(...point)));
    const scale = (0.48 * Math.min(width, height) * ratio) / reach;
    pen.setTransform(scale, 0, 0, -scale, canvas.width / 2, canvas.height / 2);
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
