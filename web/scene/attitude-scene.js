// <attitude-scene>: the vehicle as it is held now, beside a ghost of the pose that is asked for.
// With the attribute `flat` it is drawn without WebGL: browsers allow few such pictures at a time. With `turnable` it is
// turned by dragging it or with the arrow keys: it then sends the event "turn" with the attitude wished for.

import { three } from "../core/vendor.js";
import { angle, blend, IDENTITY } from "./rotation.js";
import { CanvasRenderer } from "./canvas.js";
import { colorsOf } from "./colors.js";
import { Hand } from "./hand.js";

/** @import { Quaternion } from "./rotation.js" */

const FOLLOW = 0.25; // share of the way to the newest attitude, a frame
const NEAR = 0.002; // rad

export class AttitudeScene extends HTMLElement {
  static observedAttributes = ["turnable"];

  constructor() {
    super();
    this._airframe = "multirotor";
    this._sides = false;
    this._told = "";
    /** @type {Quaternion} */
    this._attitude = IDENTITY;
    /** @type {Quaternion | null} */
    this._wanted = null;
    /** @type {Quaternion | null} */
    this._ghost = null;
    /** @type {{ draw: Function, dispose: () => void } | undefined} */
    this._renderer = undefined;
    this._frame = 0;
    this._seen = false;
    /** @type {Hand | undefined} */
    this._hand = undefined;
    /** @type {Quaternion | null} As the hand holds it. */
    this._held = null;
  }

  attributeChangedCallback() {
    this._hand?.dispose();
    this._held = null;
    this._hand = this.hasAttribute("turnable") ? new Hand(this, () => this._wanted ?? this._attitude, (held) => this._turned(held)) : undefined;
  }

  /** @param {Quaternion | null} held */
  _turned(held) {
    this._held = held;
    if (held) this.dispatchEvent(new CustomEvent("turn", { detail: held }));
    this._soon();
  }

  connectedCallback() {
    this._sizes = new ResizeObserver(() => this._soon());
    this._sizes.observe(this);
    this._start();
  }

  disconnectedCallback() {
    this._sizes?.disconnect();
    cancelAnimationFrame(this._frame);
    this._frame = 0;
    this._renderer?.dispose();
    this._renderer = undefined;
  }

  /** What is shown; null: not known yet. @param {{ airframe: string, attitude: Quaternion | null, ghost: Quaternion | null, sides?: boolean }} scene */
  set scene({ airframe, attitude, ghost, sides }) {
    const told = JSON.stringify([airframe, attitude, ghost, sides]);
    if (told === this._told) return; // a picture that stays as it is costs nothing
    this._told = told;
    this._airframe = airframe;
    this._sides = sides ?? false;
    this._wanted = attitude;
    this._ghost = ghost;
    if (!this._seen && attitude) this._attitude = attitude;
    this._seen ||= attitude !== null;
    this._soon();
  }

  async _start() {
    try {
      if (this.hasAttribute("flat") || !webgl()) throw new Error("drawn flat");
      const [library, { ThreeRenderer }] = await Promise.all([three(), import("./three.js")]);
      if (!library) throw new Error("three.js is not installed");
      if (!this.isConnected || this._renderer) return;
      this._renderer = new ThreeRenderer(library, this);
    } catch {
      if (!this.isConnected || this._renderer) return;
      this._renderer = new CanvasRenderer(this);
    }
    this._soon();
  }

  _soon() {
    if (!this._frame && this._renderer) this._frame = requestAnimationFrame(() => this._draw());
  }

  _draw() {
    this._frame = 0;
    const wanted = this._held ?? this._wanted;
    if (wanted) this._attitude = this._held ?? blend(this._attitude, wanted, FOLLOW);
    this._renderer?.draw({ airframe: this._airframe, attitude: this._attitude, ghost: this._ghost, sides: this._sides }, colorsOf(this));
    if (wanted && angle(this._attitude, wanted) > NEAR) this._soon();
  }
}

let able = /** @type {boolean | undefined} */ (undefined);

function webgl() {
  able ??= document.createElement("canvas").getContext("webgl2") !== null;
  return able;
}

customElements.define("attitude-scene", AttitudeScene);
