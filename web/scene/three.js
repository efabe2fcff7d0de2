// Draws scenes with three.js. Loaded only when a scene is shown; without it, or without WebGL, canvas.js draws.

import { airframe } from "./airframes.js";
import { EYE } from "./eye.js";

/**
 * @import { Quaternion, Vector } from "./rotation.js"
 * @import { Colors, Scene } from "./canvas.js"
 */

// North, east, down of the world are -z, x, -y of three.js.
/** @param {Vector} v @returns {Vector} */
const world = ([north, east, down]) => [east, -down, -north];

export class ThreeRenderer {
  /** @param {any} THREE the library @param {HTMLElement} host */
  constructor(THREE, host) {
    this._three = THREE;
    this._host = host;
    this._renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true });
    host.append(this._renderer.domElement);
    this._camera = new THREE.OrthographicCamera();
    this._camera.position.set(...world(EYE)).multiplyScalar(5);
    this._camera.lookAt(0, 0, 0);
    this._scene = new THREE.Scene();
    this._scene.add(new THREE.AmbientLight(0xffffff, 1.6));
    const sun = new THREE.DirectionalLight(0xffffff, 2.2);
    sun.position.set(2, 5, 3);
    this._scene.add(sun);
    this._ground = new THREE.Group();
    this._scene.add(this._ground);
    this._shown = "";
    this._vehicle = new THREE.Group();
    this._ghost = new THREE.Group();
    this._scene.add(this._vehicle, this._ghost);
  }

  /** @param {Scene} scene @param {Colors} colors */
  draw(scene, colors) {
    const { clientWidth: width, clientHeight: height } = this._host;
    if (!width || !height) return;
    this._size(width, height);
    const shown = JSON.stringify([scene.airframe, colors]);
    if (shown !== this._shown) this._build(scene.airframe, colors);
    this._shown = shown;
    turn(this._vehicle, scene.attitude);
    this._ghost.visible = scene.ghost !== null;
    if (scene.ghost) turn(this._ghost, scene.ghost);
    this._renderer.render(this._scene, this._camera);
  }

  dispose() {
    this._renderer.dispose();
    this._renderer.domElement.remove();
  }

  /** @param {number} width @param {number} height */
  _size(width, height) {
    const half = 1.5 / Math.min(width, height);
    Object.assign(this._camera, { left: -half * width, right: half * width, top: half * height, bottom: -half * height, near: 0.1, far: 20 });
    this._camera.updateProjectionMatrix();
    this._renderer.setPixelRatio(window.devicePixelRatio || 1);
    this._renderer.setSize(width, height, false);
  }

  /** @param {string} name @param {Colors} colors */
  _build(name, colors) {
    const THREE = this._three;
    for (const group of [this._vehicle, this._ghost, this._ground]) group.clear();
    for (const paint of /** @type {const} */ (["hull", "trim", "nose"])) {
      const shape = geometry(THREE, name, paint);
      if (!shape) continue;
      this._vehicle.add(new THREE.Mesh(shape, new THREE.MeshLambertMaterial({ color: colors[paint], side: THREE.DoubleSide })));
      const veil = new THREE.MeshBasicMaterial({ color: colors.ghost, transparent: true, opacity: 0.18, depthWrite: false, side: THREE.DoubleSide });
      this._ghost.add(new THREE.Mesh(shape, veil));
      const lines = new THREE.LineBasicMaterial({ color: colors.ghost, transparent: true, opacity: 0.8 });
      this._ghost.add(new THREE.LineSegments(new THREE.EdgesGeometry(shape, 30), lines));
    }
    for (const radius of [0.7, 1.3]) {
      const points = Array.from({ length: 65 }, (_, i) => {
        const a = (2 * Math.PI * i) / 64;
        return new THREE.Vector3(...world([radius * Math.cos(a), radius * Math.sin(a), 0.75]));
      });
      this._ground.add(new THREE.Line(new THREE.BufferGeometry().setFromPoints(points), new THREE.LineBasicMaterial({ color: colors.ground })));
    }
  }
}

/** @param {any} group @param {Quaternion} q */
function turn(group, [w, x, y, z]) {
  group.quaternion.set(...world([x, y, z]), w);
}

/** @param {any} THREE @param {string} name @param {string} wanted */
function geometry(THREE, name, wanted) {
  /** @type {number[]} */
  const points = [];
  for (const { paint, corners } of airframe(name)) {
    if (paint !== wanted) continue;
    for (let i = 1; i + 1 < corners.length; i += 1) {
      for (const corner of [corners[0], corners[i], corners[i + 1]]) points.push(...world(corner));
    }
  }
  if (!points.length) return null;
  const shape = new THREE.BufferGeometry();
  shape.setAttribute("position", new THREE.Float32BufferAttribute(points, 3));
  shape.computeVertexNormals();
  return shape;
}
