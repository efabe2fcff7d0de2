// Signs for somebody who holds the vehicle and does not look: tones, vibration, speech, a screen that stays on.

const CHOSEN = "mavcal-cues";
const TONES = {
  next: [[660, 0.12]],
  hold: [[440, 0.08]],
  done: [[660, 0.1], [880, 0.1], [1320, 0.22]],
  fail: [[330, 0.25], [220, 0.4]],
};
const SHAKES = { next: [60], hold: [25], done: [60, 60, 160], fail: [300] };

/** @typedef {keyof typeof TONES} Cue */
/** @typedef {{ sound: boolean, speech: boolean }} Chosen */

/** @type {AudioContext | undefined} */
let audio;
/** @type {any} */
let lock;

/** What the person has chosen. @returns {Chosen} */
export function chosen() {
  try {
    return { sound: true, speech: false, ...JSON.parse(localStorage.getItem(CHOSEN) ?? "{}") };
  } catch {
    return { sound: true, speech: false };
  }
}

/** @param {Partial<Chosen>} change */
export function choose(change) {
  localStorage.setItem(CHOSEN, JSON.stringify({ ...chosen(), ...change }));
}

/** Make sound possible; browsers ask for a touch first. */
export function wakeUp() {
  if (!audio && "AudioContext" in window) audio = new AudioContext();
  audio?.resume().catch(() => {});
}

/** Give a sign. @param {Cue} cue */
export function cue(cue) {
  navigator.vibrate?.(SHAKES[cue]);
  if (!chosen().sound || audio?.state !== "running") return;
  let at = audio.currentTime;
  for (const [hertz, seconds] of TONES[cue]) {
    const tone = audio.createOscillator();
    const loudness = audio.createGain();
    tone.frequency.value = hertz;
    loudness.gain.setValueAtTime(0.0001, at);
    loudness.gain.exponentialRampToValueAtTime(0.25, at + 0.015);
    loudness.gain.exponentialRampToValueAtTime(0.0001, at + seconds);
    tone.connect(loudness).connect(audio.destination);
    tone.start(at);
    tone.stop(at + seconds + 0.02);
    at += seconds;
  }
}

/** Say a prompt aloud, if the person has chosen that. @param {string} text */
export function say(text) {
  if (!chosen().speech || !("speechSynthesis" in window)) return;
  speechSynthesis.cancel();
  speechSynthesis.speak(new SpeechSynthesisUtterance(text));
}

/** Keep the screen on while a job runs. @param {boolean} on */
export async function keepAwake(on) {
  try {
    if (on && !lock && "wakeLock" in navigator) {
      lock = await navigator.wakeLock.request("screen");
      lock.addEventListener("release", () => { lock = undefined; });
    }
    if (!on && lock) await lock.release();
  } catch {
    lock = undefined; // a screen that goes dark is no reason to stop a calibration
  }
}
