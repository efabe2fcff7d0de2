// Draws scenes without a 3-D library: flat faces, the far ones first.

import { EYE, seen } from "./eye.js";
import { airframe } from "./airframes.js";
import { cross, dot, rotate, unit } from "./rotation.js";

/**
 * @import { Quaternion, Vector } from "./rotation.js"
 * @typedef {{ airframe: string, attitude: Quaternion, ghost: Quaternion | null, sides?: boolean }} Scene
 * @typedef {{ hull: string, trim: string, nose: string, ghost: string, ground: string, surface: string, bad: string, good: string }} Colors
 */

const SUN = unit([-0.4, 0.5, -1]);

export class CanvasRenderer {
  /** @param {HTMLElement} host */
  constructor(host) {
    this.canvas = host.appendChild(document.createElement("canvas"));
    this._host = host;
  }

  /** @param {Scene} scene @param {Colors} colors */
  draw(scene, colors) {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = this._host;
    if (!width || !height) return;
    if (this.canvas.width !== Math.round(width * ratio)) this.canvas.width = Math.round(width * ratio);
    if (this.canvas.height !== Math.round(height * ratio)) this.canvas.height = Math.round(height * ratio);
    const pen = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    const scale = (Math.min(width, height) * ratio) / (scene.sides ? 2.5 : 3); // the small ones are larger
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    pen.setTransform(scale, 0, 0, -scale, this.canvas.width / 2, this.canvas.height / 2);
    if (!scene.sides) ground(pen, colors.ground);
    if (scene.ghost) body(pen, scene.airframe, scene.ghost, colors, true);
    body(pen, scene.airframe, scene.attitude, colors, false);
    if (scene.sides) sides(pen, scene.attitude, scale, colors);
  }

  dispose() {
    this.canvas.remove();
  }
}

/** @param {CanvasRenderingContext2D} pen @param {string} color */
function ground(pen, color) {
  pen.strokeStyle = color;
  pen.lineWidth = 0.012;
  for (const radius of [0.7, 1.3]) {
    pen.beginPath();
    for (let i = 0; i <= 48; i += 1) {
      const a = (2 * Math.PI * i) / 48;
      const [x, y] = seen([radius * Math.cos(a), radius * Math.sin(a), 0.75]);
      if (i) pen.lineTo(x, y);
      else pen.moveTo(x, y);
    }
    pen.stroke();
  }
}

/** L and R beside the body: a small picture of one side looks like that of the other. @param {CanvasRenderingContext2D} pen @param {Quaternion} attitude @param {number} scale pixels per unit @param {Colors} colors */
function sides(pen, attitude, scale, colors) {
  pen.save();
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.lineJoin = "round";
  pen.font = `bold ${0.5}px sans-serif`;
  pen.lineWidth = 0.16;
  for (const [letter, right] of /** @type {const} */ ([["L", -1.12], ["R", 1.12]])) {
    const [x, y] = seen(rotate(attitude, [0, right, 0]));
    pen.setTransform(scale, 0, 0, scale, pen.canvas.width / 2 + scale * x, pen.canvas.height / 2 - scale * y);
    pen.strokeStyle = colors.surface;
    pen.strokeText(letter, 0, 0);
    pen.fillStyle = letter === "L" ? colors.bad : colors.good;
    pen.fillText(letter, 0, 0);
  }
  pen.restore();
}

/** @param {CanvasRenderingContext2D} pen @param {string} name @param {Quaternion} attitude @param {Colors} colors @param {boolean} ghost */
function body(pen, name, attitude, colors, ghost) {
  const faces = airframe(name).map(({ paint, corners }) => {
    const world = corners.map((corner) => rotate(attitude, corner));
    const picture = world.map(seen);
    const depth = picture.reduce((sum, [, , near]) => sum + near, 0) / picture.length;
    return { paint, world, picture, depth };
  });
  faces.sort((a, b) => a.depth - b.depth);
  for (const { paint, world, picture } of faces) {
    pen.beginPath();
    for (const [x, y] of picture) pen.lineTo(x, y);
    pen.closePath();
    if (ghost) {
      pen.globalAlpha = 0.16;
      pen.fillStyle = colors.ghost;
      pen.fill();
      pen.globalAlpha = 0.55;
      pen.strokeStyle = colors.ghost;
      pen.lineWidth = 0.01;
      pen.stroke();
    } else {
      pen.fillStyle = colors[paint];
      pen.fill();
      pen.globalAlpha = shade(world);
      pen.fillStyle = "#000";
      pen.fill();
      pen.globalAlpha = 1;
    }
  }
  pen.globalAlpha = 1;
}

/** How much of the light a face misses. @param {Vector[]} corners */
function shade([a, b, c]) {
  /** @type {(p: Vector, q: Vector) => Vector} */
  const edge = (p, q) => [q[0] - p[0], q[1] - p[1], q[2] - p[2]];
  let normal = unit(cross(edge(a, b), edge(a, c)));
  if (dot(normal, EYE) < 0) normal = [-normal[0], -normal[1], -normal[2]];
  return 0.45 * (1 - Math.max(0, dot(normal, SUN)));
}
