// What every drawing of ours on a canvas shares: it follows the size of its element and draws once a frame at most.

export class Drawing extends HTMLElement {
  constructor() {
    super();
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

  /** Draw before the next picture of the screen. */
  _soon() {
    if (!this._frame && this.isConnected) this._frame = requestAnimationFrame(() => this._draw());
  }

  _draw() {
    this._frame = 0;
    const canvas = this._canvas;
    const { clientWidth: width, clientHeight: height } = this;
    if (!canvas || !width || !height) return;
    const ratio = window.devicePixelRatio || 1;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const pen = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    const scale = (this._share() * Math.min(width, height) * ratio) / this._reach();
    pen.setTransform(scale, 0, 0, -scale, canvas.width / 2, canvas.height / 2);
    this._paint(pen, scale);
  }

  /** Share of the smaller side that the drawing reaches from its middle. */
  _share() {
    return 0.42;
  }

  /** How far the drawing reaches in its own unit. */
  _reach() {
    return 1;
  }

  /** @param {CanvasRenderingContext2D} _pen y up, origin in the middle @param {number} _scale pixels per unit */
  _paint(_pen, _scale) {}
}
