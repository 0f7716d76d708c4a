// How strong each mode is, over its frequency; the band's modes in colour.

import { lengthText } from "./units.js";

const SVG = "http://www.w3.org/2000/svg";
const HEIGHT = 58; // of the bars; the rest of the box is for the numbers under them
const FLOOR = 1e-3; // of the strongest: 60 dB down, the foot of the scale

function element(name, attributes, text) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text) made.textContent = text;
  return made;
}

/** Steps of 1, 2 or 5 times a power of ten: some five of them up to `top`. */
function tick(top) {
  const power = 10 ** Math.floor(Math.log10(top / 4));
  return [1, 2, 5, 10].map((m) => m * power).find((step) => top / step <= 6);
}

/** Draw into `svg`; frequencies run from 0 to `top` Hz, `length` is the unit of lengths. Returns what colours the bars of a band. */
export function drawSpectrum(svg, motion, top, length) {
  const width = 300;
  svg.setAttribute("viewBox", `0 0 ${width} 74`);
  svg.setAttribute("preserveAspectRatio", "none");
  const strongest = Math.max(...motion.amplitude, 1e-30);
  const bars = motion.freqs_hz.map((f, k) => {
    const level = Math.log10(Math.max(motion.amplitude[k] / strongest, FLOOR)) / -Math.log10(FLOOR) + 1;
    const height = Math.max(1, level * HEIGHT);
    const bar = element("rect", { x: (f / top) * width - 2, y: HEIGHT - height, width: 4, height });
    bar.append(element("title", {}, `${f.toPrecision(4)} Hz: ${lengthText(motion.amplitude[k], length)}`));
    return bar;
  });
  svg.replaceChildren(element("line", { x1: 0, x2: width, y1: HEIGHT, y2: HEIGHT }), ...bars);
  const step = tick(top);
  for (let f = 0; f <= top * 1.001; f += step) {
    const anchor = f === 0 ? "start" : f > top * 0.95 ? "end" : "middle";
    const label = `${Number(f.toPrecision(6))}${f === 0 ? " Hz" : ""}`;
    svg.append(element("text", { x: (f / top) * width, y: 72, "text-anchor": anchor }, label));
  }
  return (isInside) => bars.forEach((bar, k) => bar.setAttribute("class", isInside(k) ? "in" : "out"));
}
