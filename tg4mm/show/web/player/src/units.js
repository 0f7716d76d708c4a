// Numbers as people read them.

/** `digits` significant digits, no exponent where a person would write none. */
export const short = (number, digits = 3) => String(Number(number.toPrecision(digits)));

/** A length in scene units, shown in another unit (docs/conventions.md): below 0.1 mm in µm. */
export function lengthText(units, { unit, per_scene_unit: factor }) {
  const size = units * factor;
  return unit === "mm" && size < 0.1 ? `${short(size * 1000, 2)} µm` : `${short(size, 2)} ${unit}`;
}
