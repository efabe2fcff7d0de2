// Colors of scenes and charts, as the theme has them.

/** @param {Element} host */
export function colorsOf(host) {
  const style = getComputedStyle(host);
  /** @param {string} name */
  const color = (name) => style.getPropertyValue(`--${name}`).trim() || "#888";
  return {
    hull: color("hull"), trim: color("trim"), nose: color("nose"), ghost: color("ghost"), ground: color("line"),
    text: color("text"), quiet: color("quiet"), line: color("line"), good: color("good"), bad: color("bad"),
    x: color("axis-x"), y: color("axis-y"), z: color("axis-z"), accent: color("accent"), surface: color("surface"),
  };
}
