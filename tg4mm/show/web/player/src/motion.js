// x(t, α) = x + Σ_k (1 + α g_k) Re[m_k exp(i 2π f_k t / fps)], by fields: tg4mm/show/web/factor.py.

/** Complex gains (1 + α g_k) exp(i 2π f_k t / fps) as [re, im] lists; g_k is 1 in the band [low, high] Hz, or null: all. */
export function modeGains(motion, t, alpha, band) {
  const re = [];
  const im = [];
  motion.freqs_hz.forEach((f, k) => {
    const inside = motion.magnified[k] && (!band || (f >= band[0] && f <= band[1]));
    const size = 1 + (inside ? alpha : 0);
    const angle = (2 * Math.PI * f * t) / motion.fps;
    re.push(size * Math.cos(angle));
    im.push(size * Math.sin(angle));
  });
  return [re, im];
}

/** c_r = Σ_k Re[series[k][r] g_k]: what each field is multiplied with. */
export function coefficients(series, [re, im]) {
  const count = series.re.length ? series.re[0].length : 0;
  const out = new Array(count).fill(0);
  for (let k = 0; k < re.length; k++)
    for (let r = 0; r < count; r++) out[r] += series.re[k][r] * re[k] - series.im[k][r] * im[k];
  return out;
}
