// Setup: connections, looks, and signs.

import { h } from "../core/dom.js";
import { ask } from "../core/service.js";
import { chosen, choose } from "../core/cues.js";
import { theme, THEMES, useTheme } from "../core/theme.js";
import { sentence } from "../core/words.js";
import { badge, quiet, title } from "./parts.js";

/** @import { LinkModel } from "../mavcal.d.ts" */
/** @typedef {typeof import("../core/store.js").store} Store */

const EXAMPLES = ["udpin:0.0.0.0:14550", "serial:/dev/ttyACM0:115200", "tcp:127.0.0.1:5760", "sim:ardupilot?hand=auto", "sim:px4?hand=auto"];

/** @param {Store} store */
export function setupRoom(store) {
  const links = [...store.links.values()];
  return h("div", {}, title("Setup"),
    h("section", { class: "card" }, h("h2", {}, "Connections"),
      links.length ? h("ul", { class: "plain jobs" }, links.map((link) => row(store, link))) : quiet("No connection is open."),
      linkForm(store)),
    h("section", { class: "card" }, h("h2", {}, "Look"),
      h("div", { class: "segmented", role: "group", "aria-label": "Theme" }, THEMES.map((name) =>
        h("button", { key: name, "aria-pressed": `${theme() === name}`, onclick: () => { useTheme(name); store.changed(); } }, sentence(name))))),
    h("section", { class: "card" }, h("h2", {}, "Signs while you hold the vehicle"),
      switchFor(store, "sound", "Tones"), switchFor(store, "speech", "Spoken prompts"), switchFor(store, "vibration", "Vibration, on a phone")));
}

/** @param {Store} store @param {"sound" | "speech" | "vibration"} name @param {string} text */
const switchFor = (store, name, text) => h("label", { class: "choice" },
  h("input", { type: "checkbox", checked: chosen()[name], onchange: () => { choose({ [name]: !chosen()[name] }); store.changed(); } }), text);

/** @param {Store} store @param {LinkModel} link */
function row(store, link) {
  const tone = link.state === "up" ? "good" : link.state === "connecting" ? "busy" : "bad";
  return h("li", { key: link.id }, h("span", { class: "url" }, link.url), badge(tone, link.state),
    link.reason ? h("span", { class: "quiet small" }, link.reason) : null,
    h("button", { class: "danger", "aria-label": `Close ${link.url}`, onclick: () => store.act(async () => {
      await ask("close_link", { parameters: { link_id: link.id } });
      await store.refresh();
    }) }, "Close"));
}

/** @param {Store} store */
function linkForm(store) {
  return h("form", { class: "row-form", onsubmit: (/** @type {Event} */ event) => {
    event.preventDefault();
    const field = /** @type {HTMLInputElement} */ (/** @type {HTMLFormElement} */ (event.target).elements.namedItem("url"));
    store.act(async () => {
      await ask("open_link", { body: { url: field.value.trim() } });
      field.value = "";
      await store.refresh();
    });
  } },
  h("label", { for: "url" }, "Endpoint"),
  h("input", { id: "url", name: "url", list: "endpoints", placeholder: EXAMPLES[0], autocomplete: "off", required: true }),
  h("datalist", { id: "endpoints" }, EXAMPLES.map((value) => h("option", { value }))),
  h("button", { type: "submit", class: "primary" }, "Connect"));
}
