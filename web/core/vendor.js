// Libraries of others, which set-up brings into vendor/ and which are loaded when they are first needed. Where one is
// missing, the panel draws by itself.

const THREE = "../vendor/three.module.js";
const UPLOT = "../vendor/uPlot.esm.js";

/** @type {Map<string, Promise<any>>} */
const asked = new Map();

/** @param {string} path @returns {Promise<any>} the module, or null where it is not installed */
function loaded(path) {
  const known = asked.get(path) ?? import(path).catch(() => null);
  asked.set(path, known);
  return known;
}

/** three.js, or null. */
export const three = () => loaded(THREE);

/** The class of uPlot, or null. */
export const uPlot = () => loaded(UPLOT).then((module) => {
  if (module && !document.getElementById("uplot-style")) {
    const style = Object.assign(document.createElement("link"), { id: "uplot-style", rel: "stylesheet", href: "panel/vendor/uPlot.min.css" });
    document.head.append(style);
  }
  return module?.default ?? null;
});
