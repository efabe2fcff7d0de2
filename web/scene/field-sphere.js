// <field-sphere>: directions of the field that a compass has seen, the ones still missing, and where to turn next.

import { SECTIONS } from "./sections.js";
import { colorsOf } from "./colors.js";
import { Drawing } from "./drawing.js";
import { seen } from "./eye.js";
import { rotate, IDENTITY } from "./rotation.js";

/** @import { Quaternion, Vector } from "./rotation.js" */

/**
 * @typedef {{
 *   mask: number[], points: Vector[], next: Vector | null, now: Vector | null, attitude: Quaternion | null
 * }} Field
 * Coverage mask (10 bytes); points of unit length and the present one in the body frame; the body direction that
 * should point down next.
 */

export class FieldSphere extends Drawing {
  constructor() {
    super();
    /** @type {Field} */
    this._field = { mask: [], points: [], next: null, now: null, attitude: null };
  }

  /** @param {Field} field */
  set field(field) {
    this._field = field;
    this._soon();
  }

  /** @param {CanvasRenderingContext2D} pen */
  _paint(pen) {
    const { mask, points, next, now, attitude } = this._field;
    const colors = colorsOf(this);
    /** @param {Vector} direction */
    const picture = (direction) => seen(rotate(attitude ?? IDENTITY, direction));
    pen.beginPath();
    pen.arc(0, 0, 1, 0, 7);
    pen.fillStyle = colors.surface;
    pen.fill();
    pen.strokeStyle = colors.line;
    pen.lineWidth = 0.012;
    pen.stroke();
    /** @type {{ near: number, paint: () => void }[]} */
    const marks = [];
    SECTIONS.forEach((centre, i) => {
      const [x, y, near] = picture(/** @type {Vector} */ (centre));
      const visited = ((mask[i >> 3] ?? 0) >> (i & 7)) & 1;
      marks.push({ near, paint: () => dot(pen, x, y, visited ? 0.085 : 0.05, visited ? colors.good : colors.line, near > 0 ? 1 : 0.3) });
    });
    for (const point of points) {
      const [x, y, near] = picture(point);
      marks.push({ near: near + 0.001, paint: () => dot(pen, x, y, 0.016, colors.text, near > 0 ? 0.8 : 0.15) });
    }
    marks.sort((a, b) => a.near - b.near).forEach(({ paint }) => paint());
    if (now) {
      const [x, y] = picture(now);
      dot(pen, x, y, 0.07, colors.accent, 1);
    }
    if (next) arrow(pen, picture(next), colors.nose);
  }
}

/** @param {CanvasRenderingContext2D} pen @param {number} x @param {number} y @param {number} radius @param {string} color @param {number} alpha */
function dot(pen, x, y, radius, color, alpha) {
  pen.globalAlpha = alpha;
  pen.fillStyle = color;
  pen.beginPath();
  pen.arc(x, y, radius, 0, 7);
  pen.fill();
  pen.globalAlpha = 1;
}

/** From the side of the vehicle that should point down, to where it should be. @param {CanvasRenderingContext2D} pen @param {Vector} from @param {string} color */
function arrow(pen, [x0, y0], color) {
  const [x1, y1] = seen([0, 0, 1]);
  const length = Math.hypot(x1 - x0, y1 - y0);
  dot(pen, x0, y0, 0.07, color, 1);
  if (length < 0.12) return;
  const [ux, uy] = [(x1 - x0) / length, (y1 - y0) / length];
  pen.strokeStyle = color;
  pen.fillStyle = color;
  pen.lineWidth = 0.05;
  pen.beginPath();
  pen.moveTo(x0, y0);
  pen.quadraticCurveTo((x0 + x1) / 2 - 0.25 * uy, (y0 + y1) / 2 + 0.25 * ux, x1 - 0.12 * ux, y1 - 0.12 * uy);
  pen.stroke();
  pen.beginPath();
  pen.moveTo(x1, y1);
  pen.lineTo(x1 - 0.2 * ux - 0.1 * uy, y1 - 0.2 * uy + 0.1 * ux);
  pen.lineTo(x1 - 0.2 * ux + 0.1 * uy, y1 - 0.2 * uy - 0.1 * ux);
  pen.fill();
}

customElements.define("field-sphere", FieldSphere);
