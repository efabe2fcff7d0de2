// A small view for other programs' windows: the state of the compasses, and of the rest in a line.

import { h } from "../core/dom.js";
import { badge, quiet, VERDICT_TONES } from "./parts.js";
import { vehicleName } from "./home.js";
import { sensorStates } from "./tiles.js";
import { kindName } from "../core/words.js";

/** @typedef {typeof import("../core/store.js").store} Store */

/** @param {Store} store */
export function widgetRoom(store) {
  const vehicles = [...store.vehicles.values()];
  if (!vehicles.length) return quiet("No vehicle is connected.");
  return h("div", {}, vehicles.map((vehicle) => {
    const states = sensorStates(store, vehicle);
    const compass = states?.sensors.find((state) => state.kind === "mag");
    const rest = states?.sensors.filter((state) => state.kind !== "mag") ?? [];
    return h("section", { class: "card", key: vehicle.id },
      h("h2", {}, vehicleName(vehicle)),
      compass ? h("p", {}, badge(VERDICT_TONES[compass.verdict], `Compass: ${compass.label}`), " ", compass.text) : quiet("Reading …"),
      h("p", { class: "badges" }, rest.map((state) => badge(VERDICT_TONES[state.verdict], `${kindName(state.kind)}: ${state.label}`))));
  }));
}
