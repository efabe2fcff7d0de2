// Quaternions w x y z that take the body (front, right, down) to the world (north, east, down).

/** @typedef {[number, number, number, number]} Quaternion */
/** @typedef {[number, number, number]} Vector */

/** @type {Quaternion} */
export const IDENTITY = [1, 0, 0, 0];

/** @param {Quaternion} a @param {Quaternion} b @returns {Quaternion} */
export function multiply([aw, ax, ay, az], [bw, bx, by, bz]) {
  return [
    aw * bw - ax * bx - ay * by - az * bz,
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
  ];
}

/** @param {Quaternion} q @returns {Quaternion} */
export const conjugate = ([w, x, y, z]) => [w, -x, -y, -z];

/** @param {Vector} a @param {Vector} b */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/** @param {Vector} a @param {Vector} b @returns {Vector} */
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/** @param {Vector} v @returns {Vector} */
export function unit(v) {
  const length = Math.hypot(...v) || 1;
  return [v[0] / length, v[1] / length, v[2] / length];
}

/** @param {Quaternion} q @param {Vector} v @returns {Vector} */
export function rotate(q, v) {
  const [, x, y, z] = multiply(multiply(q, [0, ...v]), conjugate(q));
  return [x, y, z];
}

/** A turn by `angle` (rad) about `axis`. @param {Vector} axis @param {number} angle @returns {Quaternion} */
export function turn(axis, angle) {
  const [x, y, z] = unit(axis);
  const s = Math.sin(angle / 2);
  return [Math.cos(angle / 2), s * x, s * y, s * z];
}

/** The shortest turn that brings `from` onto `to`. @param {Vector} from @param {Vector} to @returns {Quaternion} */
export function between(from, to) {
  const [a, b] = [unit(from), unit(to)];
  const cosine = dot(a, b);
  if (cosine < -0.9999) {
    const side = cross(a, Math.abs(a[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]);
    return turn(side, Math.PI);
  }
  const [x, y, z] = cross(a, b);
  const w = 1 + cosine;
  const length = Math.hypot(w, x, y, z);
  return [w / length, x / length, y / length, z / length];
}

/** The share `t` of the way from `a` to `b`. @param {Quaternion} a @param {Quaternion} b @param {number} t @returns {Quaternion} */
export function blend(a, b, t) {
  const sign = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] < 0 ? -1 : 1;
  const mixed = /** @type {Quaternion} */ (a.map((value, i) => (1 - t) * value + t * sign * b[i]));
  const length = Math.hypot(...mixed) || 1;
  return /** @type {Quaternion} */ (mixed.map((value) => value / length));
}

/** Angle of the turn from `a` to `b`, rad. @param {Quaternion} a @param {Quaternion} b */
export const angle = (a, b) =>
  2 * Math.acos(Math.min(1, Math.abs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3])));

/** @param {number} roll @param {number} pitch @param {number} yaw deg @returns {Quaternion} */
export function euler(roll, pitch, yaw) {
  const rad = Math.PI / 180;
  return multiply(multiply(turn([0, 0, 1], yaw * rad), turn([0, 1, 0], pitch * rad)), turn([1, 0, 0], roll * rad));
}

/** Which body direction points down on each face. @type {Record<string, Vector>} */
export const DOWN = {
  level: [0, 0, 1], back: [0, 0, -1], left: [0, -1, 0], right: [0, 1, 0], nose_down: [1, 0, 0], nose_up: [-1, 0, 0],
};

/** The attitude nearest to `q` in which the body direction `down` points down. @param {Quaternion} q @param {Vector} down @returns {Quaternion} */
export function pointing(q, down) {
  const now = rotate(conjugate(q), [0, 0, 1]);
  return multiply(q, between(down, now));
}
