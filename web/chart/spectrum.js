// The noise spectrum of the last samples, for a chart: amplitude density against frequency (Hann window, averaged).

/** @import { Trace } from "../view/samples.js" */

const LENGTH = 256;

/** @param {Trace} trace */
export function spectrum(trace) {
  const rate = trace.rate || 1;
  const x = Array.from({ length: LENGTH / 2 - 1 }, (_, i) => ((i + 1) * rate) / LENGTH);
  const names = ["x", "y", "z"];
  return {
    x,
    lines: trace.axes.map((axis, i) => ({ name: names[i], color: names[i], y: density(axis, rate) })),
    unit: `${trace.unit}/√Hz`, xUnit: "Hz", log: true,
  };
}

/** @param {(number | null)[]} axis @param {number} rate */
function density(axis, rate) {
  const values = axis.map((value) => value ?? 0);
  const sum = new Float64Array(LENGTH / 2 - 1);
  let count = 0;
  for (let start = values.length - LENGTH; start >= 0 && count < 16; start -= LENGTH / 2) {
    const power = periodogram(values.slice(start, start + LENGTH), rate);
    for (let i = 0; i < sum.length; i += 1) sum[i] += power[i];
    count += 1;
  }
  return count ? Array.from(sum, (value) => Math.sqrt(value / count)) : Array.from(sum, () => null);
}

/** One-sided power density of one windowed piece. @param {number[]} piece @param {number} rate */
function periodogram(piece, rate) {
  const mean = piece.reduce((a, b) => a + b, 0) / LENGTH;
  const re = new Float64Array(LENGTH);
  const im = new Float64Array(LENGTH);
  let weight = 0;
  for (let i = 0; i < LENGTH; i += 1) {
    const w = 0.5 - 0.5 * Math.cos((2 * Math.PI * i) / LENGTH);
    re[i] = w * (piece[i] - mean);
    weight += w * w;
  }
  transform(re, im);
  return Array.from({ length: LENGTH / 2 - 1 }, (_, i) => (2 * (re[i + 1] ** 2 + im[i + 1] ** 2)) / (rate * weight));
}

/** Radix-2 fast Fourier transform in place. @param {Float64Array} re @param {Float64Array} im */
function transform(re, im) {
  const n = re.length;
  for (let i = 1, j = 0; i < n; i += 1) {
    let bit = n >> 1;
    for (; j & bit; bit >>= 1) j ^= bit;
    j ^= bit;
    if (i < j) {
      [re[i], re[j]] = [re[j], re[i]];
      [im[i], im[j]] = [im[j], im[i]];
    }
  }
  for (let size = 2; size <= n; size *= 2) {
    const step = (-2 * Math.PI) / size;
    for (let start = 0; start < n; start += size) {
      for (let k = 0; k < size / 2; k += 1) {
        const [c, s] = [Math.cos(step * k), Math.sin(step * k)];
        const [a, b] = [start + k, start + k + size / 2];
        const [tr, ti] = [re[b] * c - im[b] * s, re[b] * s + im[b] * c];
        [re[b], im[b], re[a], im[a]] = [re[a] - tr, im[a] - ti, re[a] + tr, im[a] + ti];
      }
    }
  }
}
