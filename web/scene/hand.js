// Turns what a scene shows: by dragging it, or with the arrow keys. Tells the new attitude; who listens does the rest.

import { multiply, turn } from "./rotation.js";
import { RIGHT, UP } from "./eye.js";

/** @import { Quaternion, Vector } from "./rotation.js" */

const RAD_PER_PX = 0.01;
const STEP = Math.PI / 12; // six presses are a quarter turn: from face to face
const FINE = Math.PI / 60;
/** Roll, pitch and yaw of the body, by key. @type {Record<string, [Vector, number]>} */
const KEYS = {
  ArrowLeft: [[1, 0, 0], -1], ArrowRight: [[1, 0, 0], 1], ArrowUp: [[0, 1, 0], 1], ArrowDown: [[0, 1, 0], -1],
  PageUp: [[0, 0, 1], -1], PageDown: [[0, 0, 1], 1],
};

export class Hand {
  /**
   * @param {HTMLElement} host what is dragged
   * @param {() => Quaternion} now how it is held
   * @param {(attitude: Quaternion | null) => void} told the attitude wished for; null: it was let go
   */
  constructor(host, now, told) {
    this._host = host;
    this._now = now;
    this._told = told;
    /** @type {Quaternion | null} */
    this._held = null;
    this._letGo = 0;
    this._ends = new AbortController();
    const { signal } = this._ends;
    host.addEventListener("pointerdown", (event) => this._grip(event), { signal });
    host.addEventListener("pointermove", (event) => this._move(event), { signal });
    for (const end of /** @type {const} */ (["pointerup", "pointercancel"])) host.addEventListener(end, () => this._release(), { signal });
    host.addEventListener("keydown", (event) => this._key(event), { signal });
  }

  dispose() {
    clearTimeout(this._letGo);
    this._ends.abort();
  }

  /** @param {PointerEvent} event */
  _grip(event) {
    if (event.button) return;
    this._host.setPointerCapture(event.pointerId);
    this._hold();
  }

  /** @param {PointerEvent} event */
  _move(event) {
    if (!this._held || !this._host.hasPointerCapture(event.pointerId)) return;
    const across = turn(UP, RAD_PER_PX * event.movementX);
    const along = turn(RIGHT, RAD_PER_PX * event.movementY);
    this._to(multiply(multiply(along, across), this._held));
  }

  /** @param {KeyboardEvent} event */
  _key(event) {
    const known = KEYS[event.key];
    if (!known || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    const [axis, sign] = known;
    this._to(multiply(this._hold(), turn(axis, sign * (event.shiftKey ? FINE : STEP))));
    this._release();
  }

  /** @returns {Quaternion} */
  _hold() {
    clearTimeout(this._letGo);
    this._held ??= this._now();
    return this._held;
  }

  /** @param {Quaternion} attitude */
  _to(attitude) {
    const length = Math.hypot(...attitude);
    this._held = /** @type {Quaternion} */ (attitude.map((part) => part / length));
    this._told(this._held);
  }

  /** The vehicle needs a moment to follow; until then its picture stays as it was left. */
  _release() {
    clearTimeout(this._letGo);
    this._letGo = window.setTimeout(() => {
      this._held = null;
      this._told(null);
    }, 1200);
  }
}
