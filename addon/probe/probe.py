"""The motion of a point or a region in numbers: mean phasor, ellipse of each frequency, series, CSV.

It is the motion that was measured: not magnified (α = 0), at every frequency, in scene units and the axes of the
file. x(t) = Σ_k Re[m_k exp(i 2π f_k t / fps)] (docs/conventions.md).
"""

from dataclasses import dataclass, replace

import numpy as np

from ..units import Unit

IN_COLUMN = 64  # samples that say how far a column of a long recording reaches
_APART = (np.sqrt(5) - 1) / 2  # timesteps; the number that fractions come least near to
# A second axis shorter than this part of the first is rounding of float32, and has no direction.
_FLAT = 1e-5


@dataclass(frozen=True)
class Ellipse:
    """The path of a point at one frequency: amplitude·cos(2πft + phase)·direction, and at right angles to it
    second·sin(2πft + phase)·second_direction."""

    frequency_hz: float
    amplitude: float  # scene units, half the long axis
    phase_deg: float  # 0 to 360: at −phase the point is at the end of `direction`
    direction: tuple[float, float, float]  # unit vector; zeros where nothing moves
    second: float  # scene units, half the short axis; 0 for a motion along a line
    second_direction: tuple[float, float, float]  # unit vector; zeros for a motion along a line
    deviation: float | None = None  # standard deviation of the amplitude, scene units; None: not known


@dataclass(frozen=True, eq=False)
class Probe:
    """The reading at a point, or the mean over a region."""

    label: str  # "Point 12", "34 points"
    freqs_hz: np.ndarray  # [M]
    phasors: np.ndarray  # [M, 3] complex128, scene units
    axes: np.ndarray  # [M, 3] the unit vector of each mode against which its phases are measured
    fps: float  # Hz
    n_timesteps: int
    # [M] standard deviation of each amplitude, scene units; None: not known
    deviations: np.ndarray | None = None
    place: tuple[float, ...] = ()  # x, y, z at rest in the file's axes, of a region the mean; (): not known

    @property
    def duration_s(self) -> float:
        """Return the duration of the recording in seconds."""
        return self.n_timesteps / self.fps


def mean_phasor(phasors: np.ndarray, opacities: np.ndarray) -> np.ndarray:
    """Σ w m / Σ w, [M, 3] complex128, of phasors [M, n, 3] with opacities [n]; of see-through ones the mean."""
    return np.einsum("n,mnc->mc", _weights(opacities), np.asarray(phasors, np.complex128))


def mean_deviation(deviations: np.ndarray, opacities: np.ndarray) -> np.ndarray:
    """[M] standard deviation of the mean amplitude, of deviations [M, n] with opacities [n].

    Neighbours are fitted to move alike, so their errors are alike too and do not average out: the mean of the
    deviations, which is what the deviation of a mean is at most.
    """
    return np.einsum("n,mn->m", _weights(opacities), np.asarray(deviations, np.float64))


def _weights(opacities: np.ndarray) -> np.ndarray:
    weights = np.asarray(opacities, np.float64)
    if weights.sum() <= 0:
        weights = np.ones_like(weights)
    return weights / weights.sum()


def ellipses(probe: Probe) -> list[Ellipse]:
    """Return the elliptical path at each frequency."""
    found = [
        ellipse(float(f), m, axis)
        for f, m, axis in zip(probe.freqs_hz, probe.phasors, probe.axes, strict=True)
    ]
    if probe.deviations is None:
        return found
    return [replace(e, deviation=float(sd)) for e, sd in zip(found, probe.deviations, strict=True)]


def ellipse(frequency_hz: float, phasor: np.ndarray, axis: np.ndarray) -> Ellipse:
    """The ellipse that Re[m exp(iωt)] runs round. Of its two ends the one on the side of `axis` is meant.

    With ψ = arg(m·m)/2, m exp(−iψ) = p + iq has p·q = 0 and |p| ≥ |q|, so that
    Re[m exp(iωt)] = p cos(ωt + ψ) − q sin(ωt + ψ).
    """
    m = np.asarray(phasor, np.complex128)
    psi = np.angle((m * m).sum()) / 2
    turned = m * np.exp(-1j * psi)
    if turned.real @ axis < 0:
        psi, turned = psi + np.pi, -turned
    long, short = turned.real, -turned.imag
    amplitude, second = float(np.linalg.norm(long)), float(np.linalg.norm(short))
    flat = second <= _FLAT * amplitude
    return Ellipse(
        frequency_hz,
        amplitude,
        float(np.degrees(psi) % 360.0) if amplitude > 0 else 0.0,
        _unit(long, amplitude),
        0.0 if flat else second,
        _unit(short, 0.0 if flat else second),
    )


def displacement_at(probe: Probe, seconds: np.ndarray) -> np.ndarray:
    """[T, 3] scene units, away from the rest position, at times [T] in seconds from timestep 0."""
    waves = np.exp(2j * np.pi * np.asarray(seconds, float)[:, None] * probe.freqs_hz)
    return (waves @ probe.phasors).real


def series(probe: Probe, per_timestep: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Times [S] in seconds and displacements [S, 3] in scene units of the recording, first timestep to last."""
    steps = (probe.n_timesteps - 1) * per_timestep + 1
    seconds = np.arange(steps) / (per_timestep * probe.fps)
    return seconds, displacement_at(probe, seconds)


def envelope(probe: Probe, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Times [2·columns] and, for each column in turn, the least and the largest displacement [2·columns, 3] in it.

    Of a column of a long recording the first IN_COLUMN samples tell, at a distance that is in step with no frequency.
    """
    first = np.linspace(0, probe.n_timesteps - 1, columns, endpoint=False)
    apart = min(_APART, (probe.n_timesteps - 1) / (columns * IN_COLUMN))
    steps = first[:, None] + apart * np.arange(IN_COLUMN)
    moved = displacement_at(probe, steps.ravel() / probe.fps).reshape(*steps.shape, 3)
    both = np.stack([moved.min(axis=1), moved.max(axis=1)], axis=1)
    return np.repeat(first / probe.fps, 2), both.reshape(-1, 3)


def series_csv(probe: Probe, unit: Unit, source: str, per_timestep: int = 1) -> str:
    """Return CSV text with a row per time: displacement along the file's axes."""
    seconds, moved = series(probe, per_timestep)
    rows = np.column_stack([seconds, moved * unit.per_scene_unit])
    columns = ["time_s", *(f"{axis}_{unit.column}" for axis in "xyz")]
    about = "displacement from the rest position over time, not magnified, axes of the file"
    return _csv(_head(probe, unit, source, about), columns, rows)


def phasor_csv(probe: Probe, unit: Unit, source: str) -> str:
    """Return CSV text with a row per frequency."""
    factor = unit.per_scene_unit
    rows = [
        [
            *(e.frequency_hz, e.amplitude * factor, e.phase_deg, *e.direction),
            *(e.second * factor, *e.second_direction),
            *(part * factor for value in m for part in (value.real, value.imag)),
            *(() if e.deviation is None else (e.deviation * factor,)),
        ]
        for e, m in zip(ellipses(probe), probe.phasors, strict=True)
    ]
    columns = [
        *("frequency_hz", f"amplitude_{unit.column}", "phase_deg"),
        *(f"direction_{axis}" for axis in "xyz"),
        f"second_axis_{unit.column}",
        *(f"second_direction_{axis}" for axis in "xyz"),
        *(f"{part}_{axis}_{unit.column}" for axis in "xyz" for part in ("re", "im")),
    ]
    if probe.deviations is not None:
        columns.append(f"amplitude_standard_deviation_{unit.column}")
    about = (
        "displacement = sum over rows of Re[(re + i im) exp(i 2 pi frequency time)], time_s from timestep 0"
    )
    return _csv(_head(probe, unit, source, about), columns, np.array(rows))


def _head(probe: Probe, unit: Unit, source: str, about: str) -> list[str]:
    return [
        f"tg4mm probe: {source}, {probe.label}",
        about,
        f"units: Hz, s, degrees, lengths in {unit.name}; {probe.n_timesteps} timesteps at {probe.fps:g} Hz",
    ]


def _csv(head: list[str], columns: list[str], rows: np.ndarray) -> str:
    # A line break in an object's name would end the comment.
    lines = [f"# {' '.join(line.split())}" for line in head]
    lines += [",".join(columns), *(",".join(f"{value:.9g}" for value in row) for row in rows)]
    return "\n".join(lines) + "\n"


def _unit(vector: np.ndarray, length: float) -> tuple[float, float, float]:
    x, y, z = (float(c) / length if length > 0 else 0.0 for c in vector)
    return x, y, z
