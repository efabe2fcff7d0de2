// Light, dark, or sunlight (black on white, heavier); "auto" follows the system.

const CHOSEN = "mavcal-theme";
export const THEMES = /** @type {const} */ (["auto", "light", "dark", "sunlight"]);

/** @returns {typeof THEMES[number]} */
export function theme() {
  const chosen = localStorage.getItem(CHOSEN);
  return THEMES.find((name) => name === chosen) ?? "auto";
}

/** @param {string} name */
export function useTheme(name) {
  localStorage.setItem(CHOSEN, name);
  showTheme();
}

/** Give the page its theme, and the look that a host asks for by `?cockpit_mode=1`. */
export function showTheme() {
  document.documentElement.dataset.theme = theme();
  const asked = new URLSearchParams(location.search);
  if (asked.get("cockpit_mode") === "1") document.documentElement.dataset.cockpit = "1";
}
