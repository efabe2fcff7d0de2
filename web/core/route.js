// Where the person is: `#/vehicle/abc/live` in the address. A reload or a second browser shows the same place.

/** @typedef {{ room: string, id: string, tab: string }} Place */

/** The place that the address names. @returns {Place} */
export function here() {
  const [room = "", id = "", tab = ""] = location.hash.replace(/^#\/?/, "").split("/").map(decodeURIComponent);
  return { room: room || "home", id, tab };
}

/** The address of a place. @param {string} room @param {string} [id] @param {string} [tab] */
export function to(room, id = "", tab = "") {
  return `#/${[room, id, tab].filter(Boolean).map(encodeURIComponent).join("/")}`;
}

/** Go to a place. @param {string} room @param {string} [id] @param {string} [tab] */
export function go(room, id, tab) {
  location.hash = to(room, id, tab);
}

/** Be called whenever the place has changed. @param {() => void} told */
export function whenMoved(told) {
  window.addEventListener("hashchange", () => {
    window.scrollTo(0, 0);
    told();
  });
}
