// Small pieces that several rooms show.

import { h } from "../core/dom.js";

/** @import { View } from "../core/dom.js" */

const SIGNS = { good: "✓", warn: "!", bad: "✕", busy: "…", unknown: "?" };

/** @typedef {keyof typeof SIGNS} Tone */

/** A state with a color, a sign and words: no meaning rests on the color. @param {Tone} tone @param {string} text */
export function badge(tone, text) {
  return h("span", { class: `badge ${tone}` }, h("span", { class: "sign", "aria-hidden": "true" }, SIGNS[tone]), text);
}

/** @type {Record<string, Tone>} */
export const VERDICT_TONES = { pass: "good", warn: "warn", fail: "bad", unknown: "unknown" };

/** A table whose headings that begin with ">" stand over numbers. @param {string[]} head @param {any[][]} rows @param {string} label */
export function table(head, rows, label) {
  const numeric = head.map((text) => text.startsWith(">"));
  return h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": label },
    h("table", {},
      h("thead", {}, h("tr", {}, head.map((text, i) =>
        h("th", { scope: "col", class: numeric[i] ? "number" : "" }, text.replace(">", ""))))),
      h("tbody", {}, rows.map((row) => h("tr", {}, row.map((cell, i) => h("td", { class: numeric[i] ? "number" : "" }, cell)))))));
}

/** A bar that fills. @param {number} current @param {number} target @param {string} text */
export function bar(current, target, text) {
  const share = target > 0 ? Math.min(1, Math.max(0, current / target)) : 0;
  return h("div", { class: "bar", role: "progressbar", "aria-label": "Progress", "aria-valuemin": "0", "aria-valuemax": "100",
    "aria-valuenow": `${Math.round(100 * share)}`, "aria-valuetext": text },
  h("div", { class: "fill", style: { width: `${100 * share}%` } }));
}

/** A heading of a room with what leads back. @param {string} title @param {any} [beside] */
export const title = (title, beside) => h("div", { class: "title" }, h("h1", {}, title), beside);

/** What is shown while something is on its way, or is not there. @param {string} text @returns {View} */
export const quiet = (text) => h("p", { class: "quiet" }, text);

/** A choice of rooms beside each other. @param {[string, string, boolean][]} tabs address, text, chosen */
export const tabs = (tabs) => h("nav", { class: "tabs", "aria-label": "Views of this vehicle" },
  tabs.map(([href, text, chosen]) => h("a", { href, "aria-current": chosen ? "page" : null }, text)));
