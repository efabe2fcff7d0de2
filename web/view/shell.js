// What is around every room: name, ways, connection, and the words about what went wrong.

import { h } from "../core/dom.js";
import { to } from "../core/route.js";
import { useKey } from "../core/service.js";
import { kindName, STATES } from "../core/words.js";
import { condition, home, vehicleName } from "./home.js";
import { vehicleRoom } from "./vehicle.js";
import { jobRoom } from "./job/room.js";
import { logsRoom } from "./logs.js";
import { logRoom } from "./log.js";
import { gapRoom } from "./gap.js";
import { historyRoom } from "./history.js";
import { setupRoom } from "./setup.js";
import { campaignRoom } from "./campaign.js";
import { campaignName } from "./fleet.js";
import { widgetRoom } from "./widget.js";

/** @import { View } from "../core/dom.js" */
/** @typedef {typeof import("../core/store.js").store} Store */

/** @type {Record<string, (store: Store) => View>} */
const ROOMS = {
  home, vehicle: vehicleRoom, job: jobRoom, campaign: campaignRoom, logs: logsRoom, log: logRoom, gap: gapRoom, history: historyRoom, setup: setupRoom, widget: widgetRoom,
};

/** @param {Store} store @returns {View[]} */
export function shell(store) {
  const room = ROOMS[store.place.room] ? store.place.room : "home";
  return [
    h("a", { class: "skip", href: "#content", onclick: (/** @type {Event} */ event) => {
      event.preventDefault(); // the address names a room, not a place in the page
      document.getElementById("content")?.focus();
    } }, "Skip to content"),
    header(store, room),
    banner(store),
    room === "job" ? null : notice(store),
    store.keyNeeded ? keyForm(store) : h("main", { id: "content", class: `room ${room}`, key: room, tabindex: "-1" }, ROOMS[room](store)),
  ].filter((view) => view !== null);
}

/** The page and its state, for whoever has many windows or does not see them. @param {Store} store */
export function pageTitle(store) {
  const { room, id } = store.place;
  const job = store.full.get(id);
  const vehicle = store.vehicles.get(id);
  /** @type {Record<string, string>} */
  const titles = {
    home: `Vehicles (${store.vehicles.size})`, logs: "Logs", log: "Log", gap: "Gap", setup: "Setup",
    vehicle: vehicle ? `${vehicleName(vehicle)}: ${condition(vehicle)[1]}` : "Vehicle",
    history: vehicle ? `History of ${vehicleName(vehicle)}` : "History",
    job: job ? `${kindName(job.kind)}: ${STATES[job.state]}` : "Job",
    campaign: job ? `${campaignName(job)} of many: ${STATES[job.state]}` : "Campaign",
  };
  return [titles[room], store.connection.good ? "" : "not connected", "mavcal"].filter(Boolean).join(" · ");
}

/** @param {Store} store @param {string} room */
function header(store, room) {
  /** @type {(name: string, text: string, also?: string[]) => View} */
  const way = (name, text, also = []) =>
    h("a", { href: to(name), "aria-current": [name, ...also].includes(room) ? "page" : null }, text);
  return h("header", { class: "top" },
    h("a", { class: "brand", href: to("home"), "aria-label": "mavcal, home" }, needle(), "mavcal"),
    h("nav", { "aria-label": "Rooms" },
      way("home", "Vehicles", ["vehicle", "job", "campaign", "history"]), way("logs", "Logs", ["log"]), way("gap", "Gap"), way("setup", "Setup")),
    connection(store));
}

/** Whether the service answers, and the vehicle that the page is about. @param {Store} store */
function connection(store) {
  const { room, id } = store.place;
  const job = room === "job" ? store.full.get(id) : undefined;
  const silent = job?.prompt?.step === "silent" || store.vehicles.get(job?.vehicle_id ?? "")?.silent;
  const [tone, words] = !store.connection.good ? ["bad", store.connection.text] : silent ? ["warn", "Vehicle silent"] : ["good", store.connection.text];
  return h("p", { class: `connection ${tone}`, role: "status" },
    h("span", { class: "lamp", "aria-hidden": "true" }), h("span", { class: "words" }, words));
}

function needle() {
  return h("svg", { viewBox: "0 0 24 24", width: "22", height: "22", "aria-hidden": "true" },
    h("circle", { cx: "12", cy: "12", r: "10.5", fill: "none", stroke: "currentColor", "stroke-width": "1.5" }),
    h("path", { d: "M12 3.5 L15 12 L12 20.5 L9 12 Z", fill: "currentColor", opacity: "0.3" }),
    h("path", { d: "M12 3.5 L15 12 L9 12 Z", class: "north" }));
}

/** Simulated vehicles are said to be so. @param {Store} store */
function banner(store) {
  const simulated = [...store.links.values()].some((link) => link.url.startsWith("sim:"));
  const hands = new Set([...store.vehicles.values()].map((vehicle) => vehicle.hand));
  const who = hands.has("mouse") ? "You turn it in its picture" : hands.has("off") ? "It stays as it is" : "It follows the prompts by itself";
  return simulated ? h("p", { class: "banner", key: "banner" }, "A simulated vehicle is connected.", h("span", { class: "more" }, ` ${who}; nothing here moves a real one.`)) : null;
}

/** @param {Store} store */
export function notice(store) {
  if (!store.notice) return null;
  return h("div", { class: "notice", role: "alert", key: "notice" },
    h("p", {}, store.notice),
    h("button", { class: "plain", "aria-label": "Dismiss the message", onclick: () => { store.notice = ""; store.changed(); } }, "Dismiss"));
}

/** @param {Store} store */
function keyForm(store) {
  return h("main", { id: "content", class: "room", key: "key" },
    h("form", { class: "card key-form", onsubmit: (/** @type {Event} */ event) => {
      event.preventDefault();
      const field = /** @type {HTMLInputElement} */ (/** @type {HTMLFormElement} */ (event.target).elements.namedItem("key"));
      useKey(field.value.trim());
      field.value = "";
      store.again();
    } },
    h("h1", {}, "This service asks for an API key"),
    h("p", {}, "Whoever runs it makes one with ", h("code", {}, "mavcal config key"), ". It is kept until this window is closed."),
    h("label", { for: "key" }, "API key"),
    h("input", { id: "key", name: "key", type: "password", autocomplete: "current-password", required: true }),
    h("button", { type: "submit", class: "primary" }, "Use this key")));
}
