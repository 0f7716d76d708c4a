// What the page shows: time, magnification, band, speed, and whether it plays. Numbers in, numbers out: no page here.

const SPEEDS = [1, 1 / 2, 1 / 4, 1 / 8, 1 / 16];
const SLOW_ENOUGH = 2; // cycles a second at which a motion is easily followed

/** Highest frequency of the band's sliders, Hz: half the frame rate. */
export const topOf = (motion) => motion.fps / 2;

/** {hz, band: [low, high] Hz} of each peak, by frequency. */
export const peaksOf = (motion) => [...motion.peaks].sort((a, b) => a.hz - b.hz);

/** From the lowest peak's band to the highest one's: not drift below nor noise above. Null without a peak: everything. */
export function bandOfAllPeaks(motion) {
  const bands = peaksOf(motion);
  return bands.length ? [bands[0].band[0], bands.at(-1).band[1]] : null;
}

/** A state to begin with: all peaks magnified, at a speed at which the strongest peak can be followed. */
export function firstState(scene) {
  const { motion } = scene;
  if (!motion) return { time: 0, alpha: 0, band: null, speed: 1, playing: false };
  const main = motion.peaks[0]?.hz ?? 1;
  const speed = SPEEDS.find((s) => main * s <= SLOW_ENOUGH) ?? SPEEDS.at(-1);
  return { time: 0, alpha: motion.alpha, band: bandOfAllPeaks(motion), speed, playing: true };
}

const finite = (value, name) => {
  const number = Number(value);
  if (!Number.isFinite(number)) throw new Error(`${name} is ${value}; expected a number`);
  return number;
};

/** `state` with what `wanted` gives of it: alpha, time (timesteps), band ([low, high] Hz or null), speed, playing. */
export function withState(state, wanted) {
  const next = { ...state };
  for (const name of ["alpha", "time", "speed"]) if (wanted[name] !== undefined) next[name] = finite(wanted[name], name);
  if (next.speed <= 0) throw new Error(`speed is ${wanted.speed}; expected a number above 0`);
  if (wanted.band !== undefined) {
    next.band = wanted.band && wanted.band.map((f) => finite(f, "band"));
    if (next.band && !(next.band.length === 2 && next.band[0] <= next.band[1]))
      throw new Error(`band is ${wanted.band}; expected low, high in Hz`);
  }
  if (wanted.playing !== undefined) next.playing = Boolean(wanted.playing);
  return next;
}

/** What an address asks for after its #: alpha=20&band=4,6&speed=0.25&time=3&paused; band=all; what is no number is left out. */
export function stateOfAddress(hash) {
  const given = new URLSearchParams(hash.replace(/^#/, ""));
  const wanted = {};
  for (const name of ["alpha", "time", "speed"]) {
    const value = Number.parseFloat(given.get(name));
    if (Number.isFinite(value) && (name !== "speed" || value > 0)) wanted[name] = value;
  }
  const band = (given.get("band") ?? "").split(",").map(Number.parseFloat);
  if (band.length === 2 && band.every(Number.isFinite) && band[0] <= band[1]) wanted.band = band;
  if (given.get("band") === "all") wanted.band = null;
  if (given.has("paused")) wanted.playing = false;
  return wanted;
}

/** The state after `seconds` of playing: time runs to the end of the capture, then begins again. */
export function advanced(state, motion, seconds) {
  const time = state.time + seconds * state.speed * motion.fps;
  return { ...state, time: time % motion.n_timesteps };
}

export { SPEEDS };
