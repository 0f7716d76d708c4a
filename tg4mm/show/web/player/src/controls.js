// The panel: shows a state, and calls `change` with what a reader of the page sets in it.
import { drawSpectrum } from "./spectrum.js";
import { SPEEDS, bandOfAllPeaks, peaksOf, topOf } from "./state.js";
import { lengthText, short } from "./units.js";

const find = (id) => document.getElementById(id);
const fraction = (speed) => ({ 1: "1×", 0.5: "½", 0.25: "¼", 0.125: "⅛", 0.0625: "1⁄16" })[speed] ?? `${speed}×`;

function button(text, onClick, parent) {
  const made = document.createElement("button");
  made.type = "button";
  made.textContent = text;
  made.addEventListener("click", onClick);
  parent.append(made);
  return made;
}

function facts({ layout, motion, length }) {
  const parts = [`${layout.n_gaussians.toLocaleString("en")} Gaussians`];
  if (!motion) return parts[0];
  parts.push(`${short(motion.n_timesteps / motion.fps)} s at ${short(motion.fps, 4)} frames/s`);
  for (const { hz, amplitude } of motion.peaks.slice(0, 3))
    parts.push(`${short(hz)} Hz, up to ${lengthText(amplitude, length)}`);
  return parts.join(" · ");
}

export class Controls {
  constructor(scene, change) {
    this.scene = scene;
    this.change = change;
    find("facts").textContent = facts(scene);
    find("motion").hidden = find("play").hidden = !scene.motion;
    find("still").hidden = Boolean(scene.motion);
    if (scene.motion) this.build(scene.motion);
  }

  build(motion) {
    const { change } = this;
    const alpha = find("alpha");
    Object.assign(alpha, { min: -1, max: motion.alpha_max, step: motion.alpha_max > 20 ? 1 : 0.1 });
    for (const input of [alpha, find("alpha-number")])
      input.addEventListener("input", () => input.value !== "" && change({ alpha: Number(input.value) }));
    this.top = topOf(motion);
    this.colour = drawSpectrum(find("spectrum"), motion, this.top, this.scene.length);
    this.peaks = peaksOf(motion);
    const chips = find("peaks");
    this.chips = [{ band: null, chip: button("all", () => change({ band: null }), chips) }];
    const together = bandOfAllPeaks(motion);
    if (this.peaks.length > 1)
      this.chips.push({ band: together, chip: button("peaks", () => change({ band: together }), chips) });
    for (const { hz, band } of this.peaks)
      this.chips.push({ band, chip: button(`${short(hz)} Hz`, () => change({ band }), chips) });
    this.low = find("band-low");
    this.high = find("band-high");
    for (const input of [this.low, this.high]) {
      Object.assign(input, { min: 0, max: this.top, step: this.top / 300 });
      input.addEventListener("input", () => this.slide(input));
    }
    Object.assign(find("time"), { max: motion.n_timesteps });
    find("time").addEventListener("input", () => change({ time: Number(find("time").value), playing: false }));
    this.speeds = SPEEDS.map((speed) => [speed, button(fraction(speed), () => change({ speed }), find("speeds"))]);
  }

  /** One thumb of the band was moved: the other stays, or is pushed along. */
  slide(input) {
    let [low, high] = [Number(this.low.value), Number(this.high.value)];
    if (low > high) input === this.low ? (high = low) : (low = high);
    this.change({ band: [low, high] });
  }

  show(state) {
    const { motion } = this.scene;
    find("play").textContent = state.playing ? "Pause" : "Play";
    if (!motion) return;
    find("alpha").value = state.alpha;
    if (document.activeElement !== find("alpha-number")) find("alpha-number").value = state.alpha;
    find("alpha-hint").textContent = this.hint(state);
    this.showBand(state.band);
    for (const [speed, chip] of this.speeds) chip.setAttribute("aria-pressed", speed === state.speed);
    this.showTime(state);
  }

  hint({ alpha }) {
    if (alpha === 0) return "As captured.";
    if (alpha === -1) return "The motion in the band is stopped.";
    return `A displacement is shown ${short(1 + alpha, 6)} times as large.`;
  }

  showBand(band) {
    const { motion } = this.scene;
    const [low, high] = band ?? [0, this.top];
    [this.low.value, this.high.value] = [low, high];
    find("band-text").textContent = band ? `${short(low)} to ${short(high)} Hz` : "every frequency";
    const same = (other) => String(other) === String(band);
    for (const entry of this.chips) entry.chip.setAttribute("aria-pressed", same(entry.band));
    this.colour((k) => motion.magnified[k] && motion.freqs_hz[k] >= low && motion.freqs_hz[k] <= high);
  }

  showTime({ time }) {
    find("time").value = time;
    find("time-text").textContent = `${(time / this.scene.motion.fps).toFixed(3)} s`;
  }
}
