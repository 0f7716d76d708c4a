"""The result of a run, as numbers and as a dozen lines of text."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from tg4mm.capture import Capture
from tg4mm.core.choices import Kind
from tg4mm.core.digits import value_with_deviation
from tg4mm.core.lines import FEWEST, CodecChange, Line, Lines, find_lines, fit_lines, projected
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.observations import CLEAR_PERIODS

Band = tuple[float, float]  # low and high, Hz, both ends inside
_SURE = 2.0  # deviations that a frequency is from 0 Hz, else it is a drift
_FREE = 8  # samples that a fit needs beside four for each line
_MOST = 4  # vibrations
_INDENT = "  "
_WIDTH = 20
WHY_NO_DAMPING = {
    "steady": "the amplitude stays constant during the record",
    "grows": "the amplitude grows during the record",
    "varies": "the amplitude rises and falls during the record",
}


@dataclass(frozen=True)
class Length:
    """A length and its standard deviation, None if unknown."""

    value: float
    deviation: float | None = None
    is_bound: bool = False  # a lower bound, because of compression or the fit: shown as > value

    def times(self, factor: float) -> "Length":
        """Return the length in another unit."""
        deviation = None if self.deviation is None else self.deviation * factor
        return Length(self.value * factor, deviation, self.is_bound)


@dataclass(frozen=True)
class Vibration:
    """A frequency and the largest motion at it."""

    hz: float
    deviation_hz: float
    amplitude: Length  # scene units: the largest displacement from the middle, 99th percentile of the visible
    position: tuple[float, float, float]  # its position at rest, scene units
    pixels: Length | None  # the same in the pictures, 99th percentile of the visible; None without a dataset
    why_no_damping: str  # "" with a damping
    band: Band  # suggested for --band
    damping: float | None = None  # ratio to the critical; None: not determined
    damping_deviation: float | None = None
    position_px: tuple[float, float] | None = None  # in the picture of a flat capture, right and down
    begins_s: float | None = None  # its start in the record; None: before it
    doubt: str = ""  # why it may not be a vibration


@dataclass(frozen=True, kw_only=True)
class Result:
    """Findings of a run, quantities that it cannot determine, and the next command. Vibrations fall in strength."""

    run: Path
    kind: Kind | None  # of the capture; None: its dataset is gone
    n_cameras: int  # poses that show motion; 0 if the dataset is gone
    n_timesteps: int
    fps: float  # Hz
    unit_scale_m: float | None  # metres per scene unit
    vibrations: tuple[Vibration, ...] = ()
    beside: tuple[Vibration, ...] = ()  # found in regions, but not in the model
    shapeless_hz: tuple[Length, ...] = ()  # frequencies without a known motion
    noise: float | None = (
        None  # scene units: amplitude of a motion as large as the noise, median of the visible
    )
    noise_px: float | None = None  # the same in the pictures
    agreement: tuple[float, ...] = ()  # 0 … 1: agreement of two halves of the data, for each function of time
    cannot: tuple[str, ...]  # a line for each quantity that cannot be determined
    alpha: float  # suggested for --alpha
    next_command: str

    @property
    def is_flat(self) -> bool:
        """Return whether lengths are pixels of one picture and nothing else."""
        return self.kind is not None and not self.kind.sees_depth

    @property
    def band(self) -> Band | None:
        """The band of `--band auto`, around the strongest vibration; None without one."""
        return self.vibrations[0].band if self.vibrations else None

    @property
    def duration_s(self) -> float:
        """The duration of the record."""
        return self.n_timesteps / self.fps


def lines_of(result: Result) -> list[str]:
    """Return the findings, their deviations, what cannot be determined, and the next command as lines."""
    lines = [_head(result)]
    for vibration in result.vibrations[:_MOST]:
        lines += _vibration(vibration, result)
    if more := result.vibrations[_MOST:]:
        lines.append(_INDENT + f"and {', '.join(f'{v.hz:.4g}' for v in more)} Hz")
    for vibration in result.beside[:_MOST]:
        first, *rest = _vibration(vibration, result)
        lines += [
            first,
            *rest,
            _row("", "(seen only in its region, not by the model of the complete picture)"),
        ]
    if result.n_timesteps > 1 and not result.vibrations and not result.beside:
        lines.append(_INDENT + _nothing(result))
    if result.vibrations:
        lines.append(_row("", "(99th percentile: 1 % of the visible scene moves further)"))
    lines += _noise(result)
    lines += [_row("cannot tell" if i == 0 else "", line) for i, line in enumerate(result.cannot)]
    if result.band is not None:
        others = ", ".join(_band(v) for v in result.vibrations[1:_MOST])
        more_bands = f"; the others: {others}" if others else ""
        lines.append(_row("band", f"{_band(result.vibrations[0])}, which --band auto takes{more_bands}"))
    return [*lines, _row("next", result.next_command)]


def _head(result: Result) -> str:
    if result.n_timesteps == 1:
        return f"{result.run}: a still scene"
    is_moving = result.kind is not None and result.kind.moving
    seen = f"{result.n_cameras} {'poses of one camera' if is_moving else 'fixed cameras'}"
    seen = "one fixed camera" if result.n_cameras == 1 else seen
    seen = f"{seen}, " if result.n_cameras else ""
    return f"{result.run}: {seen}{result.n_timesteps} timesteps at {result.fps:.4g} Hz, {result.duration_s:.3g} s"


def _nothing(result: Result) -> str:
    if not result.shapeless_hz:
        return (
            "no vibration was found: no frequency exceeds the noise around it; --band LO HI selects a band "
            "anyway"
        )
    named = ", ".join(with_deviation(hz) for hz in result.shapeless_hz)
    return f"something changes at {named} Hz, but its amplitude and direction cannot be determined"


def _vibration(v: Vibration, result: Result) -> list[str]:
    lengths = [] if v.pixels is None else [f"{with_deviation(v.pixels)} px"]
    if not (result.is_flat and lengths):
        lengths.append(f"{with_deviation(v.amplitude)} scene units")
    if result.unit_scale_m is not None:
        lengths.append(" ".join(amount(v.amplitude, result.unit_scale_m)))
    where = ", ".join(f"{c:.3g}" for c in v.position)
    near = f"({where})" if v.position_px is None else f"pixel {v.position_px[0]:.0f}, {v.position_px[1]:.0f}"
    damping = f"not determined: {v.why_no_damping}"
    if v.damping is not None:
        damping = f"ratio {percent(v.damping, v.damping_deviation)}"
    if v.begins_s is not None:
        damping += f"; begins {v.begins_s:.3g} s into the record"
    return [
        _row(f"{with_deviation(Length(v.hz, v.deviation_hz))} Hz", f"{', '.join(lengths)} near {near}"),
        _row("", f"damping {damping}"),
        *([_row("", f"in doubt: {v.doubt}")] if v.doubt else []),
    ]


def _noise(result: Result) -> list[str]:
    lines = []
    if result.noise is not None:
        sizes = [] if result.noise_px is None else [f"{result.noise_px:.2g} px"]
        sizes += [] if result.is_flat and sizes else [f"{result.noise:.2g} scene units"]
        lines.append(_row("noise floor", f"{', '.join(sizes)}: at this amplitude, motion equals noise"))
    if result.agreement:
        shown = ", ".join(f"{r:.4g}" for r in result.agreement[:_MOST])
        more = " …" if len(result.agreement) > _MOST else ""
        lines.append(_row("reliability", f"{shown}{more}: agreement of two halves of the data, at most 1"))
    return lines


def _band(v: Vibration) -> str:
    return f"--band {v.band[0]:g} {v.band[1]:g}"


def _row(name: str, text: str) -> str:
    return f"{_INDENT}{name:<{_WIDTH}}{'' if len(name) < _WIDTH else ' '}{text}"


def with_deviation(length: Length) -> str:
    """Return `0.223 ± 0.008`, or `> 0.223 ± 0.008` for a bound."""
    return ("> " if length.is_bound else "") + value_with_deviation(length.value, length.deviation)


def amount(length: Length, unit_scale_m: float | None) -> tuple[str, str]:
    """Return (value ± deviation, unit): mm or µm if the scale is known, otherwise scene units."""
    if unit_scale_m is None:
        return with_deviation(length), "scene units"
    millimetres = length.times(1000.0 * unit_scale_m)
    if 0 < millimetres.value < 0.1:
        return with_deviation(millimetres.times(1000.0)), "µm"
    return with_deviation(millimetres), "mm"


def percent(ratio: float | None, deviation: float | None) -> str:
    """Return a damping ratio in percent, or a dash."""
    if ratio is None:
        return "–"
    return f"{with_deviation(Length(100 * ratio, None if deviation is None else 100 * deviation))} %"


def unit_of(capture: Capture | None) -> tuple[str, float]:
    """Return unit and factor of shown lengths: pixels of a flat capture, mm if the scale is known."""
    if capture is None:
        return "scene units", 1.0
    pixels, scale = capture.scene.get("pixels_per_unit"), capture.unit_scale_m
    if pixels and not capture.kind.sees_depth:
        return "px", float(pixels)
    return ("scene units", 1.0) if scale is None else ("mm", scale * 1000.0)


def title_of(train: Capture) -> str:
    """Return the name that the scene states, otherwise the dataset folder's."""
    return str(train.scene.get("scene") or train.root.resolve().name)


def line_near(
    series: np.ndarray,
    fps: float,
    hz: float,
    others: Sequence[float],
    noise: float,
    b_frames: np.ndarray | None = None,
    codec: CodecChange | None = None,
) -> Line | None:
    """Return the line of a series [T] to which a mode at `hz` belongs; None if the record is too short.

    others: frequencies of other vibrations. noise: standard deviation of the series' noise over its rms, at least.
    b_frames [T] bool and codec: as for `find_lines`.
    """
    n = len(series)
    times = np.arange(n) / fps
    least = noise * float(np.sqrt((series**2).mean()))
    if n < max(FEWEST, 4 * (1 + len(others)) + _FREE):
        return None
    marks = None if b_frames is None else tuple(b_frames.tolist())
    near = [
        (abs(line.hz - hz), line)
        for line in _lines_of(tuple(series.tolist()), fps, least, marks, codec).lines
        if abs(line.hz - hz) < max(fps / n, abs(line.decay_per_s) / np.pi)
    ]
    if near:
        return min(near, key=lambda pair: pair[0])[1]
    return fit_lines(series, times, [hz, *others], least, codec).lines[0]


@lru_cache(16)  # the result of a run is read for each of its pages and tables
def _lines_of(
    series: tuple[float, ...],
    fps: float,
    noise: float,
    b_frames: tuple[bool, ...] | None,
    codec: CodecChange | None,
) -> Lines:
    times = np.arange(len(series)) / fps
    return find_lines(
        np.array(series), times, noise, b_frames=None if b_frames is None else np.array(b_frames), codec=codec
    )


def phasors_at(motion: ModalMotion, line: Line, b_frames: np.ndarray | None = None) -> np.ndarray:
    """Return every Gaussian's phasors [N, 3] at the line's maximum, scene units, from a fit to the modes' series."""
    some = np.arange(motion.n_timesteps)
    some = some if b_frames is None else some[~b_frames]
    gains = np.stack([motion.gains_at(int(t)) for t in some])  # [T, K]
    real, imaginary = np.split(
        projected([line], np.hstack([gains.real, gains.imag]), some / motion.fps)[0], 2
    )
    factors = real @ motion.series.real - imaginary @ motion.series.imag
    return np.asarray(np.tensordot(factors.astype(np.complex64), motion.fields[..., :3], axes=1))


def why_no_damping(line: Line | None) -> str:
    """Return the reason in words; "" with a damping ratio."""
    if line is None:
        return "the record is too short"
    if line.damping is not None:
        return ""
    begins = {"begins": "the vibration begins during the record and lasts"}
    return (WHY_NO_DAMPING | begins).get(
        line.change, "noise hides whether the amplitude decays during the record"
    )


def mode_deviations(motion: ModalMotion, deviation: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return the standard deviation of each mode's amplitude at each Gaussian, [K, N] float32 scene units.

    deviation, noise [N]: of the displacement, rms over time, root of the sum over x, y, z, in all and by noise alone
    (RUN/uncertainty.safetensors). The spectrum of an error is unknown. All noise is assumed at this frequency, its
    upper bound; errors of the model, which grow with the motion, by the mode's share of the motion's power. A
    sinusoid's amplitude is √2 times its rms.
    """
    power = motion.powers()
    total = float(power[np.asarray(motion.freqs_hz) > 0].sum())
    share = np.clip(power / total, 0, 1) if total > 0 else np.zeros_like(power)
    by_noise = np.asarray(noise, np.float64) ** 2
    by_model = np.maximum(np.asarray(deviation, np.float64) ** 2 - by_noise, 0)
    return np.sqrt(2 * (by_noise + share[:, None] * by_model)).astype(np.float32)


def series_of(motion: ModalMotion, phasors: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the motion over time [T] along a mode's shape, in units of its largest displacement at each Gaussian.

    The shape is the real part of the phasors [N, 3] at the time of their maximum; weights [N].
    """
    turned = phasors * np.exp(-0.5j * np.angle(np.einsum("nc,nc,n->", phasors, phasors, weights)))
    shape = weights[:, None] * turned.real
    along = np.einsum("rnc,nc->r", motion.fields[..., :3], shape) / max(
        float((shape * turned.real).sum()), 1e-30
    )
    gains = np.stack([motion.gains_at(t) for t in range(motion.n_timesteps)])
    return np.asarray((gains @ (motion.series @ along)).real)


@dataclass(frozen=True)
class ModePeak:
    """A peak of the modes, and its line."""

    mode_hz: float
    hz: float
    deviation_hz: float
    line: Line | None  # None: the record is too short, or the fit is of steady lines alone
    is_steady: bool = False

    def half_width_hz(self, duration_s: float) -> float:
        """Return the half-width in Hz: 1 / duration, or that of a line that rings down."""
        return max(1 / duration_s, 0.0 if self.line is None else abs(self.line.decay_per_s) / np.pi)


def is_drift(found: ModePeak, duration_s: float) -> bool:
    """Return whether the record holds too little of a frequency to tell it from a slow drift."""
    return found.mode_hz * duration_s < CLEAR_PERIODS or found.hz < _SURE * found.deviation_hz


def drift_line(drifts: list[ModePeak], duration_s: float) -> list[str]:
    """A line on the strongest peak that is taken for a drift."""
    return [
        f"whether something vibrates at {with_deviation(Length(v.hz, v.deviation_hz))} Hz or drifts: the record holds "
        f"{v.hz * duration_s:.2g} periods of it; a longer one decides"
        for v in drifts[:1]
    ]
