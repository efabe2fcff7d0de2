// Starts the panel.

import { render } from "./core/dom.js";
import { store } from "./core/store.js";
import { showTheme } from "./core/theme.js";
import { wakeUp } from "./core/cues.js";
import { pageTitle, shell } from "./view/shell.js";
import { watchJobs } from "./view/job/signs.js";
import { followSamples } from "./view/samples.js";
import "./scene/attitude-scene.js";
import "./scene/field-sphere.js";
import "./scene/point-cloud.js";
import "./chart/line-chart.js";
import "./chart/strip-chart.js";

const panel = /** @type {HTMLElement} */ (document.getElementById("panel"));

showTheme();
let place = location.hash;
store.begin(() => {
  const focused = /** @type {HTMLButtonElement | null} */ (document.activeElement);
  followSamples(store);
  watchJobs(store);
  render(panel, shell(store));
  document.title = pageTitle(store);
  const moved = place !== location.hash;
  place = location.hash;
  // focus never falls to the body: whoever uses keys goes on in the room
  const lost = focused !== null && focused !== document.body && (!focused.isConnected || focused.disabled);
  if (moved || lost) document.getElementById("content")?.focus({ preventScroll: true });
});
window.addEventListener("resize", () => store.changed());
for (const touch of ["pointerdown", "keydown"]) window.addEventListener(touch, wakeUp, { once: true });
