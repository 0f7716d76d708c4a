"""Random small sets of our generator, by kind of capture: train and measure against the exact motion."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from benchmarks.calibration.score import Score
from dataset_gen.scenes import NAMES
from tg4mm.capture.codec import before_compression
from tg4mm.capture.truth_file import Truth, load_truth
from tg4mm.core.phasors import peak_displacement
from tg4mm.research.evaluate.displacement import exact_motion
from tg4mm.run.train import train
from tg4mm.show.measure import Prepared, Sensor, SensorResult, measure, prepare
from tg4mm.show.measure.spectrum import main_is_above
from tg4mm.show.result.read import result_from
from tg4mm.show.result.reading import ResultSources, reading_of

FPS = 30.0
# Options of the generator, pictures of each camera over time, and the fewest periods that such a record must hold.
KINDS: dict[str, tuple[str, int, float]] = {
    "tripod": ("--cameras sweep --views 12", 60, 4),
    "handheld": ("--cameras handheld", 90, 9),
    "rig": ("--cameras rig --views 4 --clock-offsets 0.3", 40, 4),
    "clips": ("--cameras clips --views 4", 40, 4),
}
LEAST_PX, MOST_PX = 0.02, 0.5
SETTINGS = {"space.max_gaussians": "4000", "space.iterations": "1500"}
_PLACES = 4  # sensors that move, beside one that stands still
_RADIUS = 0.12  # scene units, of a sensor: scenes are two across
_MOVES = 0.3  # of the largest motion: sensors are put where things move by more
_STILL = 1e-3
_SCENES = Path(__file__).parents[2] / "dataset_gen" / "scenes"


@dataclass(frozen=True)
class Drawn:
    """One set: a scene, how it is filmed, and how it vibrates."""

    seed: int
    kind: str
    scene: str
    size: int
    hz: float
    amplitude_px: float
    decay_s: float | None
    crf: int | None  # of the video; None: pictures as they are

    @property
    def options(self) -> list[str]:
        """The generator's options, all but where the set goes and its motion."""
        cameras, frames, _ = KINDS[self.kind]
        out = [self.scene, *cameras.split(), "--timesteps", frames, "--fps", FPS, "--size", self.size]
        out += ["--frequency", self.hz, "--amplitude-px", self.amplitude_px, "--samples", 4, "--points", 1000]
        out += ["--test-views", 0, "--truth", "none", "--background", "white", "--sensor", "phone"]
        out += ["--jpeg", 0, "--seed", self.seed, "--processes", 1]
        out += [] if self.crf is None else ["--codec", "h264", "--crf", self.crf]
        return [str(value) for value in out]


def drawn(seed: int) -> Drawn:
    """By its number; kinds take turns."""
    rng = np.random.default_rng([42, seed])
    kind = tuple(KINDS)[seed % len(KINDS)]
    _, frames, periods = KINDS[kind]
    duration = frames / FPS
    hz = float(np.exp(rng.uniform(np.log(periods / duration), np.log(0.46 * FPS))))
    pixels = float(np.exp(rng.uniform(np.log(LEAST_PX), np.log(MOST_PX))))
    rings = kind == "tripod" and rng.random() < 0.4
    return Drawn(
        seed=seed,
        kind=kind,
        scene=str(rng.choice(NAMES)),
        size=int(rng.choice([64, 80, 96])),
        hz=round(hz, 4),
        amplitude_px=round(pixels, 4),
        decay_s=round(float(rng.uniform(0.2, 1) * duration), 3) if rings else None,
        crf=int(rng.integers(8, 20)) if rng.random() < 0.5 else None,
    )


def kinds_stage(seed: int, folder: Path) -> dict[str, Score]:
    """A set's scores: `KIND, train` of what the run names, `KIND, sensors` of what sensors in it measure."""
    what, home = drawn(seed), folder / f"{seed:04d}"
    dataset = _generated(what, home)
    began = time.process_time()
    run = train(dataset, home / "run", settings=SETTINGS)
    scene, reading = prepare(run), reading_of(run)
    truth = load_truth(dataset, FPS, KINDS[what.kind][1])
    exact = exact_motion(truth, scene.means).displacement.astype(complex)
    out = {f"{what.kind}, train": _of_run(reading, truth, exact, what)}
    sensors = list(_sensors(scene, exact, seed))
    found = measure(scene, sensors)
    by_sensor = Score()
    for result in found.sensors:
        _of_sensor(by_sensor, result, scene, truth, exact, what, dataset)
    by_sensor.seconds = time.process_time() - began
    return out | {f"{what.kind}, sensors": by_sensor}


def _generated(what: Drawn, home: Path) -> Path:
    """The dataset's folder, made or gone on with."""
    home.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "dataset_gen", *what.options, "--out", str(home / "set")]
    if what.decay_s is not None:
        motion = yaml.safe_load((_SCENES / f"{what.scene}.yaml").read_text())
        for mode in motion["modes"]:
            mode["decay"] = what.decay_s
        (home / "motion.yaml").write_text(yaml.safe_dump(motion))
        command += ["--motion", str(home / "motion.yaml")]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    (found,) = (path.parent for path in (home / "set").glob("*/scene.json"))
    return found


def _sensors(scene: Prepared, exact: np.ndarray, seed: int) -> Iterator[Sensor]:
    """Spheres around Gaussians that are seen: some on what moves, one on what stands still."""
    size = np.sqrt((np.abs(exact) ** 2).sum((0, 2)))
    seen = scene.seen * (scene.gaussians.opacities.numpy() > 0.3)
    rng, top = np.random.default_rng(seed), float(np.quantile(size[seen > 0], 0.99))
    for name, count, chosen in (("moves", _PLACES, size > _MOVES * top), ("still", 1, size < _STILL * top)):
        chance = seen * chosen
        if not chance.any():
            continue
        rows = rng.choice(len(chance), count, p=chance / chance.sum())
        for k, row in enumerate(rows):
            yield Sensor(f"{name} {k}", "sphere", (*(float(x) for x in scene.means[row]), _RADIUS))


def _at(frequencies: np.ndarray, phasors: np.ndarray) -> Iterator[tuple[float, np.ndarray]]:
    """Every true frequency and the sum of the phasors [K, …] that have it."""
    for hz in np.unique(frequencies):
        yield float(hz), phasors[frequencies == hz].sum(0)


def _nearest(hz: float, found: Sequence[tuple[float, float]], duration_s: float) -> int | None:
    """Index of the line (Hz, its ±) that is nearest, within 1 / duration or 3 of its ±."""
    near = [k for k, (f, d) in enumerate(found) if abs(f - hz) < max(1 / duration_s, 3 * d)]
    return min(near, key=lambda k: abs(found[k][0] - hz), default=None)


def _of_run(reading: ResultSources, truth: Truth, exact: np.ndarray, what: Drawn) -> Score:
    out, named = Score(), result_from(reading).vibrations
    lines, used = [(v.hz, v.deviation_hz) for v in named], set()
    for hz, phasors in _at(truth.freqs_hz, exact):
        size = reading.seen.pixels(phasors) or 0.0
        best = _nearest(hz, lines, KINDS[what.kind][1] / FPS)
        out.found.append((size, best is not None))
        if best is None:
            continue
        used.add(best)
        own = named[best]
        out.frequencies.append((own.hz - hz) / own.deviation_hz)
        if own.pixels is not None and own.pixels.is_bound:
            out.marked += 1  # a lower bound
        elif own.pixels is not None and own.pixels.deviation:
            out.amplitudes.append((own.pixels.value - size) / own.pixels.deviation)
        _compare_damping(out, hz, what, own.damping, own.damping_deviation)
    out.false = [f"{v.hz:.3f} Hz" for k, v in enumerate(named) if k not in used]
    return out


def _compare_damping(
    out: Score, hz: float, what: Drawn, ratio: float | None, deviation: float | None
) -> None:
    if what.decay_s is None or ratio is None or not deviation:
        return
    true = 1 / np.hypot(1, 2 * np.pi * hz * what.decay_s)
    out.dampings.append((ratio - true) / deviation)


def _of_sensor(
    out: Score,
    result: SensorResult,
    scene: Prepared,
    truth: Truth,
    exact: np.ndarray,
    what: Drawn,
    dataset: Path,
) -> None:
    """Adds a sensor's samples, peaks and dampings; phasors [K, 3] of its middle are exact."""
    weights = result.body.weights * scene.seen
    mean = np.einsum("n,knc->kc", weights / weights.sum(), exact)
    offsets = _offsets(dataset)
    for series in result.all_series:
        times = series.times_s + offsets.get(series.clock, 0.0)
        gains = np.exp(2j * np.pi * truth.freqs_hz * times[:, None])
        if what.decay_s is not None:
            gains = gains * np.exp(-times / what.decay_s)[:, None]
        error = series.displacement - np.real(gains @ (mean @ series.axes.T))
        error = (error - error.mean(0)) / series.deviation
        out.samples += error[:, series.is_resolved].ravel().tolist()
    peaks, used = result.spectrum.peaks, set()
    lines = [(p.frequency_hz, p.frequency_deviation_hz) for p in peaks]
    for hz, phasor in _at(truth.freqs_hz, mean @ result.axes.T):
        best = _nearest(hz, lines, float(np.ptp(result.times_s)))
        if best is not None:
            used.add(best)
        resolved = peaks[best].is_resolved if best is not None else result.series.is_resolved
        size = float(peak_displacement(np.where(resolved, phasor, 0)))
        if size * result.px_per_unit > LEAST_PX / 4:
            _compare_peak(out, result, best, hz, size, what)
    for k, (peak, orbit) in enumerate(zip(peaks, result.orbits, strict=True)):
        if k not in used:
            is_sure = main_is_above(peak, orbit) and peak.harmonic is None and peak.sideband is None
            out.false += [f"{result.name} {peak.frequency_hz:.3f} Hz"] if is_sure else []
            out.marked += not is_sure


def _compare_peak(
    out: Score, result: SensorResult, best: int | None, hz: float, size: float, what: Drawn
) -> None:
    """A true vibration of a sensor with the peak that is nearest, or none."""
    out.found.append((size * result.px_per_unit, best is not None))
    if best is None:
        return
    peak, orbit, damping = result.spectrum.peaks[best], result.orbits[best], result.damping[best]
    out.frequencies.append((peak.frequency_hz - hz) / peak.frequency_deviation_hz)
    decay = 0.0 if what.decay_s is None else 1 / what.decay_s
    if (peak.line is not None and peak.line.damping is not None) == bool(decay):
        size *= float(np.exp(-decay * peak.line.from_s)) if peak.line is not None and decay else 1.0
        found, deviation = before_compression(orbit.amplitude, orbit.deviation, result.loss_of(best))
        out.amplitudes.append((found - size) / deviation)
    if damping is not None:
        _compare_damping(out, hz, what, damping.ratio, damping.deviation)


def _offsets(dataset: Path) -> dict[str, float]:
    """Seconds by which each camera's clock is behind the scene's; {} where all are one."""
    file = dataset / "truth" / "cameras.json"
    cameras = json.loads(file.read_text())["cameras"] if file.exists() else {}
    return {name: float(own["clock_offset_s"]) for name, own in cameras.items()}
