"""The findings of each method for a film."""

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.calibration.draw import FilmTruth, TrueVibration
from benchmarks.calibration.film import Region
from benchmarks.calibration.score import Named, Score, score
from tg4mm.capture.look import LookSummary, look
from tg4mm.core.lines import Line, find_lines

_INSIDE = 0.45  # of a region's shorter side: the radius of a sensor in it


def look_stage(video: Path, truth: FilmTruth, python: str) -> dict[str, Score]:
    """One pass over the video."""
    began = time.process_time()
    found = look(video)
    return {"look": score(truth, named_by_look(found), time.process_time() - began)}


def named_by_look(found: LookSummary) -> list[Named]:
    """Its lines."""
    return [
        Named(
            *(line.hz, line.hz_deviation, line.amplitude_px, line.amplitude_deviation_px),
            *(line.damping, line.damping_deviation, line.from_s, line.centre_px, bool(line.mark)),
            lower_bound=bool(line.lost),
        )
        for line in found.lines
    ]


def whole_stage(video: Path, truth: FilmTruth, python: str) -> dict[str, Score]:
    """sfm, train, and measure with a sensor in every region that vibrates: its samples, peaks and what train names."""
    from tg4mm.capture.sfm.reconstruct import reconstruct
    from tg4mm.run.train import train
    from tg4mm.show.measure import Sensor, measure
    from tg4mm.show.result import result_of

    folder = video.with_suffix("")
    began = time.process_time()
    if not (folder / "set").exists():
        reconstruct(video, folder / "set")
    run = train(folder / "set", folder / "run")
    result = result_of(run)
    regions = list(dict.fromkeys(v.region for v in truth.vibrations))
    sensors = [_sensor(Sensor, k, region, video.stem) for k, region in enumerate(regions)]
    measured = measure(run, sensors) if sensors else None
    seconds = time.process_time() - began
    named = []
    for v in (*result.vibrations, *result.beside):
        size, deviation = (None, None) if v.pixels is None else (v.pixels.value, v.pixels.deviation)
        damped = v.damping, v.damping_deviation, v.begins_s or 0.0, v.position_px
        lower_bound = v.pixels is not None and v.pixels.is_bound
        named.append(Named(v.hz, v.deviation_hz, size, deviation, *damped, bool(v.doubt), lower_bound))
    out, peaks = score(truth, named, seconds), list[Named]()
    for region, sensor in zip(regions, measured.sensors if measured is not None else (), strict=True):
        own, px = sensor.series, sensor.px_per_unit
        errors = px * own.displacement * [1, -1] - _truth_in(region, truth, own.times_s)
        errors -= errors.mean(0)
        out.samples += (errors / (px * own.deviation)).ravel().tolist()
        out.errors += np.sqrt((errors**2).mean(0)).tolist()
        peaks += _peaks(sensor, region)
    return {"sfm, train, measure": out, "peaks of measure": score(truth, peaks, seconds)}


def _peaks(sensor: Any, region: Region) -> Iterator[Named]:
    """Return the peaks of a sensor, as `measure.json` has them; marked: what its table marks."""
    from tg4mm.capture.codec import before_compression
    from tg4mm.show.measure.spectrum import main_is_above

    left, upper, right, lower = region
    each = zip(sensor.spectrum.peaks, sensor.orbits, sensor.damping, strict=True)
    for k, (peak, orbit, damping) in enumerate(each):
        loss, px = sensor.loss_of(k), sensor.px_per_unit
        size, deviation = before_compression(orbit.amplitude, orbit.deviation, loss)
        is_marked = bool(
            peak.harmonic or peak.sideband or (loss and loss.why) or not main_is_above(peak, orbit)
        )
        yield Named(  # type: ignore[call-arg]
            *(peak.frequency_hz, peak.frequency_deviation_hz, px * size, px * deviation),
            *((damping.ratio, damping.deviation) if damping else (None, None)),
            0.0 if peak.line is None else peak.line.from_s,
            ((left + right) / 2, (upper + lower) / 2),
            is_marked,
        )


def _sensor(kind: type, k: int, region: Region, camera: str) -> object:
    left, upper, right, lower = region
    radius = _INSIDE * min(right - left, lower - upper)
    return kind(f"region {k}", "pixel", ((left + right) / 2, (upper + lower) / 2, radius), camera)


def _truth_in(region: Region, truth: FilmTruth, times_s: np.ndarray) -> np.ndarray:
    """[F, 2] pixels right and down in the middle of a region."""
    return np.sum([_moved(v, times_s) for v in truth.vibrations if v.region == region], axis=0)


def _moved(vibration: TrueVibration, times_s: np.ndarray) -> np.ndarray:
    """[F, 2] right and down in the middle of its region."""
    motion, (_, upper, _, lower) = vibration.motion(), vibration.region
    share = vibration.at((upper + lower) / 2)
    return np.array([motion(float(t)) for t in times_s])[:, None] * share * np.array(vibration.amplitude_px)


def baselines_stage(video: Path, truth: FilmTruth, python: str) -> dict[str, Score]:
    """Lines (`tg4mm.core.lines`) in what two other estimators say of the regions that vibrate, or of the middle."""
    regions = list(dict.fromkeys(v.region for v in truth.vibrations))
    w, h = truth.width, truth.height
    regions = regions or [(w // 2 - 30, h // 2 - 30, w // 2 + 30, h // 2 + 30)]
    with tempfile.TemporaryDirectory() as folder:
        wanted, out = Path(folder) / "regions.json", Path(folder) / "out.json"
        wanted.write_text(json.dumps(regions))
        script = Path(__file__).with_name("baselines.py")
        clean = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
        subprocess.run([python, str(script), str(video), str(wanted), str(out)], check=True, env=clean)
        found = json.loads(out.read_text())
    seconds, scores = found.pop("seconds"), dict[str, Score]()
    for name, series in ((name, np.array(own)) for name, own in found.items()):
        scores[name] = score(truth, _named(series, regions, truth.fps), seconds[name])
        for region, own in zip(regions, series, strict=True) if truth.vibrations else ():
            errors = own - _truth_in(region, truth, np.arange(len(own)) / truth.fps)
            scores[name].errors += np.sqrt(((errors - errors.mean(0)) ** 2).mean(0)).tolist()
    return scores


def _named(series: np.ndarray, regions: Sequence[Region], fps: float) -> list[Named]:
    times = np.arange(series.shape[1]) / fps
    out = []
    for own, (left, upper, right, lower) in zip(series, regions, strict=True):
        for line in find_lines(own, times).lines:
            amplitude, deviation = _along(line)
            damped = (line.damping, line.damping_deviation, line.from_s)
            centre = ((left + right) / 2, (upper + lower) / 2)
            out.append(Named(line.hz, line.hz_deviation, amplitude, deviation, *damped, centre))
    return out


def _along(line: Line) -> tuple[float, float]:
    """Amplitude and ± of a line of two components along the direction of its largest motion."""
    phase = 0.5 * np.angle((line.phasor**2).sum())
    along = np.real(line.phasor * np.exp(-1j * phase))
    size = float(np.linalg.norm(along)) or 1e-12
    return size, float(np.sqrt(((along / size) ** 2 * line.amplitude_deviation**2).sum()))
