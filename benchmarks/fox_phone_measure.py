"""Virtual sensors on the fox's tripod or clips against the exact motion: amplitude and phase in pixels.

python -m benchmarks fox_phone_measure RUN --truth CAPTURES/fox_phone/truth

Of a tripod the sensors are pixels of its view; of clips spheres around the same places, and each component of the
motion common to all of them is compared, on the clock of the first clip.

A deviation is that of the real and of the imaginary part of a phasor, so both are compared with it: what is in phase
with the truth, and what is a quarter of a period off. Errors within their deviations are 68 % of each then (of the
modulus of both together it would be 39 %).
"""

import argparse
from pathlib import Path

import numpy as np

from benchmarks.fox_phone_truth import Similarity, Truth, kind_of, project, visible, world_of
from tg4mm.run import Run
from tg4mm.show.measure import Prepared, Sensor, SensorResult, measure, parse_sensor, prepare
from tg4mm.show.measure.spectrum import sinusoid_columns

# x, y, radius in pixels of the tripod's view: the nose, the picture frame's lower edge, wallpaper that stands still
PLACES = {"nose": (302, 423, 14), "frame": (90, 192, 16), "wall": (430, 120, 40)}


OPTIONS = {
    "run": Path,
    "--truth": {"type": Path, "required": True},
    "--sensor": {"action": "append", "default": [], "help": "NAME=REGION beside nose, frame and wall"},
}


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    truth, scene = Truth.load(options.truth), prepare(Run.open(options.run))
    kind = kind_of(scene.capture)
    world, _ = world_of(scene.capture, truth)
    own = [parse_sensor(text) for text in options.sensor]
    sensors = [*(_pixel(name) if kind == "tripod" else _sphere(name, truth, world) for name in PLACES), *own]
    for sensor in sensors:
        print(f"--sensor {sensor}")
    found = measure(scene, sensors)
    print(
        f"\n{'sensor':<10} {'Hz':>5} {'axis':<6} {'found, px':>18} {'truth, px':>10} {'phase, °':>11} "
        f"{'in phase':>9} {'quarter off':>11}"
    )
    times = [t for result in found.sensors for t in _print(result, scene, truth, world, kind)]
    told = np.array([t for t in times if np.isfinite(t)])
    within = ", ".join(f"{np.mean(told < k):.0%} within {k}" for k in (1, 2, 3))
    print(f"\n{len(told)} parts of phasors; errors by their deviations: {within} (68%, 95%, 99.7% expected)")


def _pixel(name: str) -> Sensor:
    x, y, radius = PLACES[name]
    return parse_sensor(f"{name}=pixel:cam_00,{x},{y},{radius}")


def _sphere(name: str, truth: Truth, world: Similarity) -> Sensor:
    """Around what the tripod's view shows at the place, as wide as the place is there."""
    x, y, radius = PLACES[name]
    K, size = np.array(truth.values["K"]), (truth.values["W"], truth.values["H"])
    uv, depth = project(truth.means, np.array(truth.values["c2w_fixed"]), K)
    near = visible(uv, depth, size) & (truth.opacities > 0.3) & (np.hypot(*(uv - [x, y]).T) < radius)
    centre = np.median(truth.means[near], axis=0)
    in_run = (centre - world.shift) @ world.rotation / world.scale
    reach = radius / K[0, 0] * float(np.median(depth[near])) / world.scale
    return Sensor(name, "sphere", (*map(float, in_run), reach))


def _print(result: SensorResult, scene: Prepared, truth: Truth, world: Similarity, kind: str) -> list[float]:
    """Lines of one sensor; errors of both parts of each phasor over deviations."""
    rows = np.flatnonzero(result.body.weights)
    weights = (result.body.weights * scene.seen)[rows]
    phasors = truth.phasors(world.to_truth(scene.means[rows]))
    mean = world.vectors_to_run(np.einsum("n,fnc->fc", weights / weights.sum(), phasors))
    hz, out = np.array(truth.freqs_hz), []
    if kind == "clips":
        mean = mean * np.exp(1j * truth.values["clips"]["phases"][0] * hz / hz[0])[:, None]
    along = mean @ result.axes.T * result.px_per_unit
    own, deviation = _of_clips(result, hz) if result.clips else _of_series(result, hz)
    own, deviation = own * result.px_per_unit, deviation * result.px_per_unit
    for f in range(len(hz)):
        for k, label in enumerate(result.labels):
            moves = abs(along[f, k]) > 1e-9
            turned = own[f, k] * (np.exp(-1j * np.angle(along[f, k])) if moves else 1.0)
            off = turned - abs(along[f, k])
            is_told = np.isfinite(deviation[f, k]) and deviation[f, k] > 0
            by = np.abs([off.real, off.imag]) / (deviation[f, k] if is_told else np.nan)
            out += by.tolist()
            phase = f"{np.degrees(np.angle(turned)):11.1f}" if moves else f"{'–':>11}"
            print(
                f"{result.name:<10} {hz[f]:5.2f} {label:<6} {abs(own[f, k]):9.4f} ± {deviation[f, k]:6.4f} "
                f"{abs(along[f, k]):10.4f} {phase} {by[0]:7.2f} σ {by[1]:9.2f} σ"
            )
    for peak, orbit in zip(result.spectrum.peaks, result.orbits, strict=True):
        size = orbit.amplitude * result.px_per_unit
        print(
            f"{'':<10} peak at {peak.frequency_hz:.4f} ± {peak.frequency_deviation_hz:.4f} Hz, {size:.4f} px",
            peak.is_above,
            peak.harmonic or "",
        )
    return out


def _of_series(result: SensorResult, hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[F, 3] phasors at frequencies and their deviations, scene units."""
    n = len(hz)
    design = np.linalg.pinv(sinusoid_columns(hz, result.times_s)) @ result.displacement
    own = design[1 : 1 + n] + 1j * design[1 + n :]
    noise = result.series.noise[0] * np.sqrt(2 / len(result.times_s))
    size = np.linalg.norm(own[:, result.series.is_resolved], axis=1)
    return own, np.hypot(noise, result.series.model_share * size[:, None])


def _of_clips(result: SensorResult, hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `_of_series`; NaN for a frequency that no clip shows."""
    own, deviation = np.full((len(hz), 3), np.nan, complex), np.full((len(hz), 3), np.nan)
    for peak in result.together.everywhere if result.together else ():
        f = int(np.abs(hz - peak.frequency_hz).argmin())
        if abs(hz[f] - peak.frequency_hz) < 0.5 / np.ptp(result.times_s):
            own[f], deviation[f] = peak.phasor, peak.deviation
    return own, deviation
