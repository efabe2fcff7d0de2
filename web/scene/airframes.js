// Shapes of vehicles as flat convex faces in the body frame (front, right, down), about two units long.

/**
 * @import { Vector } from "./rotation.js"
 * @typedef {"hull" | "trim" | "nose"} Paint
 * @typedef {{ paint: Paint, corners: Vector[] }} Face
 */

/** @param {Vector[]} base @param {Vector[]} top @param {Paint} paint @returns {Face[]} */
function prism(base, top, paint) {
  const sides = base.map((corner, i) => {
    const next = (i + 1) % base.length;
    return { paint, corners: [corner, base[next], top[next], top[i]] };
  });
  return [{ paint, corners: base }, { paint, corners: [...top].reverse() }, ...sides];
}

/** A box between two corners; its front end may be narrower. @param {Vector} low @param {Vector} high @param {Paint} paint */
function box(low, high, paint, taper = 1) {
  const [x0, y0, z0] = low;
  const [x1, y1, z1] = high;
  const [cy, cz] = [(y0 + y1) / 2, (z0 + z1) / 2];
  /** @type {(x: number, by: number) => Vector[]} */
  const end = (x, by) => [
    [x, cy + (y0 - cy) * by, cz + (z0 - cz) * by], [x, cy + (y1 - cy) * by, cz + (z0 - cz) * by],
    [x, cy + (y1 - cy) * by, cz + (z1 - cz) * by], [x, cy + (y0 - cy) * by, cz + (z1 - cz) * by]];
  return prism(end(x0, 1), end(x1, taper), paint);
}

/** A flat disk. @param {Vector} centre @param {number} radius @param {Paint} paint @returns {Face[]} */
function disk([x, y, z], radius, paint, corners = 14) {
  /** @type {(height: number) => Vector[]} */
  const ring = (height) => Array.from({ length: corners }, (_, i) => {
    const a = (2 * Math.PI * i) / corners;
    return [x + radius * Math.cos(a), y + radius * Math.sin(a), z + height];
  });
  return prism(ring(0.02), ring(-0.02), paint);
}

/** A beam between two points of the plane. @param {Vector} from @param {Vector} to @param {number} width @param {Paint} paint */
function beam(from, to, width, paint) {
  const length = Math.hypot(to[0] - from[0], to[1] - from[1]);
  const [sx, sy] = [(-(to[1] - from[1]) / length) * width, ((to[0] - from[0]) / length) * width];
  /** @type {(z: number) => Vector[]} */
  const level = (z) => [
    [from[0] + sx, from[1] + sy, from[2] + z], [to[0] + sx, to[1] + sy, to[2] + z],
    [to[0] - sx, to[1] - sy, to[2] + z], [from[0] - sx, from[1] - sy, from[2] + z]];
  return prism(level(width), level(-width), paint);
}

/** @returns {Face[]} */
function multirotor() {
  const motors = [[0.62, 0.62], [-0.62, 0.62], [-0.62, -0.62], [0.62, -0.62]];
  return [
    ...box([-0.42, -0.2, -0.14], [0.34, 0.2, 0.12], "hull"),
    ...box([0.34, -0.2, -0.14], [0.6, 0.2, 0.12], "nose", 0.35),
    ...motors.flatMap(([x, y]) => [
      ...beam([0, 0, 0], [x, y, 0], 0.05, "hull"),
      ...disk([x, y, -0.12], 0.36, x > 0 ? "nose" : "trim"),
    ]),
    ...[-0.3, 0.3].flatMap((y) => beam([-0.35, y, 0.3], [0.35, y, 0.3], 0.03, "hull")),
  ];
}

/** @returns {Face[]} */
function plane() {
  /** @type {(corners: Vector[], paint: Paint, thick?: number) => Face[]} */
  const sheet = (corners, paint, thick = 0.03) =>
    prism(corners, corners.map(([x, y, z]) => [x, y, z - thick]), paint);
  return [
    ...box([-0.95, -0.08, -0.1], [0.55, 0.08, 0.08], "hull"),
    ...box([0.55, -0.08, -0.1], [0.95, 0.08, 0.08], "nose", 0.3),
    ...sheet([[0.35, 0, 0], [0.15, 1.05, -0.05], [-0.1, 1.05, -0.05], [-0.2, 0, 0]], "hull"),
    ...sheet([[-0.2, 0, 0], [-0.1, -1.05, -0.05], [0.15, -1.05, -0.05], [0.35, 0, 0]], "hull"),
    ...sheet([[0.2, 0.75, -0.06], [0.15, 1.06, -0.07], [-0.1, 1.06, -0.07], [-0.12, 0.75, -0.06]], "trim"),
    ...sheet([[-0.12, -0.75, -0.06], [-0.1, -1.06, -0.07], [0.15, -1.06, -0.07], [0.2, -0.75, -0.06]], "trim"),
    ...sheet([[-0.7, 0.4, -0.02], [-0.92, 0.4, -0.02], [-0.95, -0.4, -0.02], [-0.66, -0.4, -0.02]], "hull"),
    ...prism([[-0.62, 0.02, -0.08], [-0.95, 0.02, -0.08], [-0.98, 0.02, -0.48], [-0.82, 0.02, -0.48]],
      [[-0.62, -0.02, -0.08], [-0.95, -0.02, -0.08], [-0.98, -0.02, -0.48], [-0.82, -0.02, -0.48]], "trim"),
  ];
}

/** A boat, or anything else that stays on the ground. @returns {Face[]} */
function boat() {
  return [
    ...box([-0.9, -0.38, -0.12], [0.35, 0.38, 0.2], "hull"),
    ...box([0.35, -0.38, -0.12], [1, 0.38, 0.2], "nose", 0.12),
    ...box([-0.6, -0.24, -0.4], [0.05, 0.24, -0.12], "trim", 0.8),
    ...box([-0.36, -0.02, -0.8], [-0.3, 0.02, -0.4], "hull"),
  ];
}

/** @type {Record<string, () => Face[]>} */
const SHAPES = { multirotor, plane, boat };

/** @type {Map<string, Face[]>} */
const made = new Map();

/** The faces of an airframe: multirotor, plane or boat. @param {string} name @returns {Face[]} */
export function airframe(name) {
  const known = made.get(name) ?? (SHAPES[name] ?? multirotor)();
  made.set(name, known);
  return known;
}
