// What a prompt says of the pose in which the vehicle lies.

/** @import { Pose, PromptModel } from "../../mavcal.d.ts" */

/**
 * Whether it lies in a face that is done already, while others are open.
 * @param {PromptModel} prompt
 */
export function taken(prompt) {
  if (prompt.taken) return true;
  const { detected, pose, remaining } = prompt;
  const free = pose === null || pose === "oblique"; // else it is this one pose, or none
  return free && detected !== null && detected !== "oblique" && remaining.length > 0 && !remaining.includes(detected);
}

/** Whether it is held as it should be. @param {PromptModel} prompt */
export const held = (prompt) => prompt.stable && !taken(prompt);
