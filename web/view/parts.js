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

const NARROW = 640; // pixels: a table of many columns is rows of one line, and charts wait until they are asked for

/** Whether this is a phone, held upright. */
export const isNarrow = () => window.innerWidth <= NARROW;

/**
 * A table whose headings that begin with ">" stand over numbers. On a phone each row is one line of the columns `line`,
 * and the others are folded below it.
 * @param {string[]} head @param {any[][]} rows @param {string} label @param {number[]} [line]
 */
export function table(head, rows, label, line) {
  if (line && isNarrow()) return folded(head, rows, label, line);
  const numeric = head.map((text) => text.startsWith(">"));
  return h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": label },
    h("table", {},
      h("thead", {}, h("tr", {}, head.map((text, i) =>
        h("th", { scope: "col", class: numeric[i] ? "number" : "" }, text.replace(">", ""))))),
      h("tbody", {}, rows.map((row) => h("tr", {}, row.map((cell, i) => h("td", { class: numeric[i] ? "number" : "" }, cell)))))));
}

/** @param {string[]} head @param {any[][]} rows @param {string} label @param {number[]} line */
function folded(head, rows, label, line) {
  const others = head.map((_, i) => i).filter((i) => head[i] && !line.includes(i));
  const columns = `repeat(${line.length - 1}, auto) minmax(0, 1fr)`.replace("repeat(0, auto) ", "");
  return h("div", { class: "rows", role: "group", "aria-label": label }, rows.map((row, k) => {
    const before = row[head.indexOf("")]; // a box to tick stands beside what can be opened
    return h("div", { class: "row", key: `${k}` }, before ?? null, h("details", {},
      h("summary", {}, h("span", { class: "line", style: { "grid-template-columns": columns } }, line.map((i) =>
        h("span", { class: head[i].startsWith(">") ? "number" : "" }, row[i])))),
      h("dl", { class: "small" }, others.map((i) => [h("dt", {}, head[i].replace(">", "")), h("dd", {}, row[i] === "" ? "–" : row[i])]))));
  }));
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
