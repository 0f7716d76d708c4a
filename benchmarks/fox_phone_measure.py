"""Virtual sensors on the fox's tripod against the exact motion: amplitude and phase in pixels of the tripod's view.

python benchmarks/fox_phone_measure.py RUN --truth CAPTURES/fox_phone/truth
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks.fox_phone_truth import Similarity, Truth, similarity
from tg4mm.measure import Prepared, SensorResult, measure, parse_sensor, prepare
from tg4mm.measure.fourier import tones
from tg4mm.runs import Run

# pixels of the tripod's view: the nose, the lower edge of the picture frame, wallpaper that stands still
SENSORS = "nose=pixel:cam_00,302,423,14", "frame=pixel:cam_00,90,192,16", "wall=pixel:cam_00,430,120,40"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", type=Path)
    parser.add_argument("--truth", type=Path, required=True)
    parser.add_argument("--sensor", action="append", help="NAME=REGION beside nose, frame and wall")
    asked = parser.parse_args()
    truth, scene = Truth.load(asked.truth), prepare(Run.open(asked.run))
    world = _world(scene, truth)
    sensors = [parse_sensor(text) for text in [*SENSORS, *(asked.sensor or [])]]
    for sensor in sensors:
        print(f"--sensor {sensor}")
    found = measure(scene, sensors)
    print(
        f"\n{'sensor':<10} {'Hz':>5} {'axis':<6} {'found, px':>18} {'truth, px':>10} {'phase, deg':>14} {'inside':>7}"
    )
    for result in found.sensors:
        _print(result, scene, truth, world)


def _world(scene: Prepared, truth: Truth) -> Similarity:
    """By the sweep's photographs, whose true poses are known."""
    capture, own, true = scene.capture, [], []
    for row, path in enumerate(capture.paths):
        pose = truth.c2w(path.stem, int(capture.timesteps[row]), "tripod")
        if pose is not None and capture.camera_ids[row] not in capture.camera_ids[:row]:
            own.append(np.linalg.inv(capture.viewmats[row]))
            true.append(pose)
    return similarity(np.stack(own), np.stack(true))


def _print(result: SensorResult, scene: Prepared, truth: Truth, world: Similarity) -> None:
    rows = np.flatnonzero(result.body.weights)
    weights = (result.body.weights * scene.seen)[rows]
    phasors = truth.phasors(world.to_truth(scene.means[rows]))
    mean = world.vectors_to_run(np.einsum("n,fnc->fc", weights / weights.sum(), phasors))
    along = mean @ result.axes.T * result.px_per_unit
    hz = np.array(truth.freqs_hz)
    design = np.linalg.pinv(tones(hz, result.times_s)) @ result.displacement * result.px_per_unit
    noise = result.series.noise[0] * np.sqrt(2 / len(result.times_s)) * result.px_per_unit
    for f in range(len(hz)):
        own = design[1 + f] + 1j * design[1 + len(hz) + f]
        deviation = np.hypot(noise, result.series.model_share * np.linalg.norm(own[result.series.is_told]))
        for k, label in enumerate(result.labels):
            error = abs(own[k] - along[f, k])
            phase = np.degrees(np.angle(own[k] / along[f, k])) if abs(along[f, k]) > 1e-9 else 0.0
            times = error / deviation[k] if np.isfinite(deviation[k]) and deviation[k] > 0 else 0.0
            print(
                f"{result.name:<10} {hz[f]:5.2f} {label:<6} {abs(own[k]):9.4f} ± {deviation[k]:6.4f} "
                f"{abs(along[f, k]):10.4f} {phase:14.1f} {times:6.2f} σ"
            )
    for peak, orbit in zip(result.spectrum.peaks, result.orbits, strict=True):
        size = orbit.amplitude * result.px_per_unit
        print(
            f"{'':<10} peak at {peak.frequency_hz:.4f} ± {peak.frequency_deviation_hz:.4f} Hz, {size:.4f} px",
            peak.is_above,
        )


if __name__ == "__main__":
    main()
