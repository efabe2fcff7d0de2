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
/** @typedef {{ sound: boolean, speech: boolean, vibration: boolean }} Chosen */

/** Nothing sounds or moves unasked. @type {Chosen} */
const QUIET = { sound: false, speech: false, vibration: false };

/** @type {AudioContext | undefined} */
let audio;
/** @type {Promise<WakeLockSentinel | null> | undefined} */
let lock;

/** What the person has chosen. @returns {Chosen} */
export function chosen() {
  try {
    return { ...QUIET, ...JSON.parse(localStorage.getItem(CHOSEN) ?? "{}") };
  } catch {
    return QUIET;
  }
}

/** @param {Partial<Chosen>} change */
export function choose(change) {
  localStorage.setItem(CHOSEN, JSON.stringify({ ...chosen(), ...change }));
  wakeUp();
}

/** Make sound possible, if it is wanted; browsers ask for a touch first. */
export function wakeUp() {
  if (!chosen().sound) return;
  if (!audio && "AudioContext" in window) audio = new AudioContext();
  audio?.resume().catch(() => {});
}

/** Give a sign. @param {Cue} cue */
export function cue(cue) {
  if (chosen().vibration) navigator.vibrate?.(SHAKES[cue]);
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
  if (on === (lock !== undefined)) return; // it is asked for once, also while the answer is on its way
  if (!on) {
    const held = lock;
    lock = undefined;
    await (await held)?.release();
  } else if ("wakeLock" in navigator) {
    const asked = navigator.wakeLock.request("screen").catch(() => null); // a dark screen stops no calibration
    lock = asked;
    (await asked)?.addEventListener("release", () => { if (lock === asked) lock = undefined; });
  }
}
