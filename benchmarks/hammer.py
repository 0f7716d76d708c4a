"""A hammer test on a beam: film and instrument made with known modes, analysed by `tg4mm analyse`, beside the truth.

A steel cantilever, 0.8 m × 40 mm × 8 mm, by Euler and Bernoulli, modes below 250 Hz, struck four times at its tip. The
film, 500 frames a second, gives three regions with white noise of 0.002 mm; hammer and accelerometer at the tip are
read 5,000 times a second by another clock.
"""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import cont2discrete, lfilter

from benchmarks.common import print_found
from tg4mm.show.analyse.results import analyse, format_analysis
from tg4mm.show.options import AnalyseOptions

OPTIONS: dict[str, Any] = {"out": Path}
FILM, INSTRUMENT, SECONDS = 500, 5000, 16.0
LAG_S, NOISE_MM = 0.7321, 0.002
LENGTH, WIDTH, THICK, YOUNG, DENSITY = 0.8, 0.04, 0.008, 210e9, 7850.0  # SI
ROOTS = np.array([1.87510407, 4.69409113, 7.85475744])
DAMPING = np.array([0.008, 0.005, 0.006])
PLACES = {"tip": 1.0, "middle": 0.6, "root": 0.3}


def frequencies() -> np.ndarray:
    """[3] Hz."""
    stiff = YOUNG * WIDTH * THICK**3 / 12 / (DENSITY * WIDTH * THICK)
    return ROOTS**2 / (2 * np.pi * LENGTH**2) * np.sqrt(stiff)


def shapes() -> np.ndarray:
    """[places, 3], 1 / √kg."""
    x, b = np.array(list(PLACES.values()))[:, None], ROOTS
    s = (np.sinh(b) - np.sin(b)) / (np.cosh(b) + np.cos(b))
    phi = np.cosh(b * x) - np.cos(b * x) - s * (np.sinh(b * x) - np.sin(b * x))
    return np.asarray(phi / np.sqrt(DENSITY * WIDTH * THICK * LENGTH))


def run(options: Any) -> None:
    """Writes OUT/film.csv and instrument.csv, and prints what is found and what is true."""
    options.out.mkdir(parents=True, exist_ok=True)
    rng, t = np.random.default_rng(0), np.arange(0, SECONDS, 1 / INSTRUMENT)
    force = np.zeros(len(t))
    for hit in np.arange(4) * 4 + 0.5 + rng.uniform(0, 0.8, 4):
        force += rng.uniform(10, 20) * np.exp(-(((t - hit) / 0.0015) ** 2))
    w, phi = 2 * np.pi * frequencies(), shapes()
    moved, pushed = np.zeros((3, len(t))), np.zeros(len(t))
    for k in range(3):
        poles = [1, 2 * DAMPING[k] * w[k], w[k] ** 2]
        q, speed = (_filtered(top, poles, phi[0, k] * force) for top in ([1], [1, 0]))
        moved += np.outer(phi[:, k], q)
        pushed += phi[0, k] * (phi[0, k] * force - poles[1] * speed - poles[2] * q)
    every = INSTRUMENT // FILM
    film = 1000 * moved[:, ::every].T
    film += NOISE_MM * rng.normal(size=film.shape)
    sure = np.full(len(film), NOISE_MM)
    head = "time_s," + ",".join(f"{name}_mm,{name}_mm_deviation" for name in PLACES)
    columns = [t[::every] + LAG_S, *(c for one in film.T for c in (one, sure))]
    _write(options.out / "film.csv", head, columns)
    noisy = pushed + 0.02 * pushed.std() * rng.normal(size=len(t))
    _write(options.out / "instrument.csv", "time_s,force [N],acc [m/s²]", [t, force, noisy])
    found = analyse(
        options.out / "film.csv",
        AnalyseOptions(
            band=(3.0, 190.0), window="boxcar", segment_s=4.0, overlap=0.0, reference=options.out / "instrument.csv",
            column="force", sync="acc", modes=True,
        ),
    )  # fmt: skip
    print(format_analysis(found))
    lag = found["transfers"][0].lag_s
    rows = [("lag, s", lag.value, lag.deviation, LAG_S)]
    for method in found["modes"]:
        for k, hz in enumerate(frequencies()):
            near = [m for m in method.modes if abs(m.frequency_hz.value - hz) < 0.05 * hz]
            for m in near[:1]:
                pairs = ("Hz", m.frequency_hz, hz), ("ζ", m.damping, DAMPING[k])
                name = f"{method.method} {k + 1}"
                rows += [(f"{name}, {unit}", x.value, x.deviation, true) for unit, x, true in pairs]
    t0 = found["transfers"][0]
    for hz in (10.0, 40.0):
        k = int(np.abs(t0.freqs_hz - hz).argmin())
        s = 2j * np.pi * t0.freqs_hz[k]
        true = 1000 * float(abs((phi[0] ** 2 / (s**2 + 2 * DAMPING * w * s + w**2)).sum()))
        rows.append((f"|H1| at {t0.freqs_hz[k]:g} Hz, mm/N", abs(t0.h1[k]), t0.deviation[k], true))
    print_found(rows)


def _filtered(top: list[float], poles: list[float], force: np.ndarray) -> np.ndarray:
    """Exact for a force that is straight between samples."""
    b, a, _ = cont2discrete((top, poles), 1 / INSTRUMENT, "foh")
    return np.asarray(lfilter(np.ravel(b), a, force))


def _write(path: Path, head: str, columns: list[np.ndarray]) -> None:
    np.savetxt(path, np.stack(columns, 1), delimiter=",", header=head, comments="", fmt="%.9g")
