// Numbers as people read them.

/** `digits` significant digits, no exponent where a person would write none. */
export const short = (number, digits = 3) => String(Number(number.toPrecision(digits)));

/** A length in scene units: in mm or µm where the scale, metres per unit, is known. */
export function lengthText(units, scale) {
  if (!scale) return `${short(units, 2)} scene units`;
  const mm = units * scale * 1000;
  return mm < 0.1 ? `${short(mm * 1000, 2)} µm` : `${short(mm, 2)} mm`;
}
