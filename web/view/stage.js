// The vehicle as it is held now; a simulated one is turned here with the mouse, a finger or the arrow keys.

import { h } from "../core/dom.js";
import { ask } from "../core/service.js";

/** @import { VehicleModel } from "../mavcal.d.ts" */
/** @import { Quaternion } from "../scene/rotation.js" */
/** @typedef {typeof import("../core/store.js").store} Store */

const PAUSE_MS = 150; // a hand is told where it goes no more often

/** @type {Quaternion | null} */
let next = null;
let sending = false;

/**
 * The picture; `flat`: without WebGL.
 * @param {Store} store @param {VehicleModel | undefined} vehicle
 * @param {{ attitude: Quaternion | null, ghost: Quaternion | null, words: string, flat?: boolean }} shown
 */
export function picture(store, vehicle, { attitude, ghost, words, flat }) {
  const scene = { airframe: vehicle?.airframe ?? "multirotor", attitude, ghost };
  if (vehicle?.hand !== "mouse") return h("attitude-scene", { role: "img", "aria-label": words, scene, flat });
  return h("attitude-scene", {
    turnable: true, tabindex: "0", role: "application", scene, flat,
    "aria-label": `${words}. Turn it with the arrow keys; page up and page down turn its nose.`,
    onturn: (/** @type {Event} */ event) => to(store, vehicle.id, /** @type {CustomEvent<Quaternion>} */ (event).detail),
  });
}

/** Who moves a simulated vehicle; nothing for a real one. @param {Store} store @param {VehicleModel | undefined} vehicle */
export function handSwitch(store, vehicle) {
  if (!vehicle?.hand) return null;
  const { id } = vehicle;
  const choose = (/** @type {"auto" | "mouse"} */ hand) => () => store.act(async () => {
    store.vehicles.set(id, await ask("choose_hand", { parameters: { vehicle_id: id }, body: { hand } }));
  });
  /** @type {(hand: "auto" | "mouse", text: string) => any} */
  const one = (hand, text) => h("button", { class: "small", "aria-pressed": `${vehicle.hand === hand}`, onclick: choose(hand) }, text);
  return h("div", { class: "hand", key: "hand" },
    h("div", { class: "segmented", role: "group", "aria-label": "Who moves the simulated vehicle" }, one("auto", "It obeys by itself"), one("mouse", "I turn it")),
    vehicle.hand === "mouse" ? h("p", { class: "quiet small" }, "Drag it, or use the arrow keys.") : null);
}

/** Turn it there; what is wished meanwhile is done next. @param {Store} store @param {string} id @param {Quaternion} attitude */
async function to(store, id, attitude) {
  next = attitude;
  if (sending) return;
  sending = true;
  while (next) {
    const wished = next;
    next = null;
    await store.act(() => ask("turn_vehicle", { parameters: { vehicle_id: id }, body: { attitude: wished } }));
    await new Promise((done) => { setTimeout(done, PAUSE_MS); });
  }
  sending = false;
}
