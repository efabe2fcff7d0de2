// Where one looks from: behind and above, to the north. World (north, east, down) to picture (right, up, nearness).

/** @import { Vector } from "./rotation.js" */

const ELEVATION = 0.5; // rad
const AZIMUTH = 0.45;
const [CE, SE] = [Math.cos(ELEVATION), Math.sin(ELEVATION)];
const [CA, SA] = [Math.cos(AZIMUTH), Math.sin(AZIMUTH)];

/** @param {Vector} world @returns {Vector} */
export function seen([north, east, down]) {
  const away = CA * north + SA * east;
  return [CA * east - SA * north, SE * away - CE * down, -CE * away - SE * down];
}

/** What is to the right in the picture, and what is up, as directions in the world. @type {Vector} */
export const RIGHT = [-SA, CA, 0];
/** @type {Vector} */
export const UP = [SE * CA, SE * SA, -CE];

/** Where the eye is, as a direction in the world. @type {Vector} */
export const EYE = [-CE * CA, -CE * SA, -SE];
