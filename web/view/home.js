// Home: who is there, and what each vehicle needs now.

import { h } from "../core/dom.js";
import { to } from "../core/route.js";
import { ask } from "../core/service.js";
import { store } from "../core/store.js";
import { AUTOPILOTS, kindName, LANDED, STATES } from "../core/words.js";
import { choose, goingOn, hands } from "./fleet.js";
import { badge, quiet, VERDICT_TONES } from "./parts.js";
import { sensorStates, tiles, worst } from "./tiles.js";

/** @import { VehicleModel } from "../mavcal.d.ts" */
/** @typedef {typeof import("../core/store.js").store} Store */

const CARDS = 6; // more than so many vehicles are a table

/** @param {Store} store */
export function home(store) {
  const vehicles = [...store.vehicles.values()].sort((a, b) => vehicleName(a).localeCompare(vehicleName(b), undefined, { numeric: true }));
  if (!vehicles.length) return nobody(store);
  return h("div", {},
    h("h1", { class: "hidden" }, "Vehicles"),
    goingOn(store),
    hands(store, vehicles),
    vehicles.length > CARDS ? list(store, vehicles) : h("div", { class: "cards" }, vehicles.map((vehicle) => card(store, vehicle))));
}

/** What a vehicle is called. @param {VehicleModel} vehicle */
export const vehicleName = (vehicle) => store.names.get(vehicle.id) || `${AUTOPILOTS[vehicle.autopilot]} ${vehicle.system}`;

/** @param {VehicleModel} vehicle @returns {["good" | "warn" | "bad", string]} */
export function condition(vehicle) {
  if (vehicle.silent) return ["bad", "silent"];
  if (vehicle.armed) return ["warn", "armed"];
  return vehicle.landed === "in_air" ? ["warn", "in the air"] : ["good", "disarmed"];
}

/** @param {VehicleModel} vehicle @returns {["good" | "warn" | "bad", string]} */
export function linkQuality(vehicle) {
  const share = 100 * vehicle.loss;
  const text = `link: ${share < 0.05 ? "no" : share.toFixed(1).replace(".0", "")}${share < 0.05 ? "" : " %"} loss`;
  return [share < 2 ? "good" : share < 10 ? "warn" : "bad", text];
}

/** What stands first: the running job, or what the vehicle needs. @param {Store} store @param {VehicleModel} vehicle */
export function firstLine(store, vehicle) {
  const job = store.running(vehicle.id);
  if (job) {
    return h("a", { class: "first-line busy", href: to("job", job.id) },
      `${kindName(job.kind)}: ${STATES[job.state].toLowerCase()}. Open it.`);
  }
  const waiting = store.newest().find((other) => other.vehicle_id === vehicle.id && other.state === "review");
  if (waiting) return h("a", { class: "first-line warn", href: to("job", waiting.id) }, `${kindName(waiting.kind)} is ready for your review. Open it.`);
  if (vehicle.silent) return h("p", { class: "first-line bad" }, "No message for 3 s. Check its power and the link.");
  const states = sensorStates(store, vehicle);
  return h("p", { class: `first-line ${worst(states)}` }, states?.summary ?? "Reading its calibration …");
}

/** @param {Store} store @param {VehicleModel} vehicle */
function card(store, vehicle) {
  return h("article", { class: "card vehicle-card", key: vehicle.id, "aria-label": vehicleName(vehicle) },
    h("div", { class: "title" },
      h("h2", {}, store.vehicles.size > 1 ? choose(store, vehicle, vehicleName(vehicle)) : null,
        h("a", { href: to("vehicle", vehicle.id) }, vehicleName(vehicle))),
      h("p", { class: "badges" }, badge(...condition(vehicle)), badge(...linkQuality(vehicle)))),
    h("p", { class: "quiet small" }, `${AUTOPILOTS[vehicle.autopilot]} ${vehicle.firmware} · ${LANDED[vehicle.landed]}`),
    firstLine(store, vehicle),
    tiles(store, vehicle));
}

/** Many vehicles: a row each; on a phone a row is a small card. @param {Store} store @param {VehicleModel[]} vehicles */
function list(store, vehicles) {
  const known = vehicles.map((vehicle) => sensorStates(store, vehicle)?.sensors).find((sensors) => sensors) ?? [];
  const head = ["Vehicle", "State", ...known.map((state) => kindName(state.kind)), "Needs now"];
  return h("div", { class: "scroll fleet", tabindex: "0", role: "region", "aria-label": "Vehicles" },
    h("table", {},
      h("thead", {}, h("tr", {}, head.map((text) => h("th", { scope: "col" }, text)))),
      h("tbody", {}, vehicles.map((vehicle) => row(store, vehicle, known.length)))));
}

/** @param {Store} store @param {VehicleModel} vehicle @param {number} columns of sensors */
function row(store, vehicle, columns) {
  const sensors = sensorStates(store, vehicle)?.sensors ?? [];
  return h("tr", { key: vehicle.id },
    h("th", { scope: "row" }, h("span", { class: "pick" }, choose(store, vehicle, vehicleName(vehicle)),
      h("a", { href: to("vehicle", vehicle.id) }, vehicleName(vehicle)))),
    h("td", { class: "state" }, badge(...condition(vehicle)), badge(...linkQuality(vehicle))),
    sensors.length ? sensors.map((state) => h("td", { class: "sensor" }, h("span", { class: "name quiet" }, kindName(state.kind)),
      badge(VERDICT_TONES[state.verdict], state.label))) : Array.from({ length: columns }, () => h("td", { class: "sensor" }, "…")),
    h("td", { class: "needs" }, firstLine(store, vehicle)));
}

/** @param {Store} store */
function nobody(store) {
  if (!store.ready) return h("section", { class: "card empty" }, h("h1", {}, "Looking for vehicles …"), quiet("Nothing has answered yet."));
  const links = [...store.links.values()];
  return h("section", { class: "card empty" },
    h("h1", {}, "No vehicle has been heard yet"),
    links.length
      ? h("ul", { class: "plain" }, links.map((link) => h("li", {}, `${link.url}: ${link.state}${link.reason ? `, ${link.reason}` : ""}`)))
      : h("p", {}, "Connect one in Setup, or look around with a simulated vehicle that follows the prompts by itself."),
    h("div", { class: "actions" },
      h("a", { class: "button primary", href: to("setup") }, "Connect a vehicle"),
      ["ardupilot", "px4"].map((kind) => h("button", {
        onclick: () => store.act(async () => {
          await ask("open_link", { body: { url: `sim:${kind}?hand=auto` } });
          await store.refresh();
        }) }, `Try a simulated ${AUTOPILOTS[kind]}`))));
}
