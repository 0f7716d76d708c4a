"""The ellipse that a sensor runs through at one frequency."""

from dataclasses import dataclass

import numpy as np

from tg4mm.show.measure.spectrum import Peak


@dataclass(frozen=True)
class Orbit:
    """Of Re[m exp(iωt)]: m = exp(iφ) (major + i minor), with major ⟂ minor."""

    major: np.ndarray  # [A] scene units: half axis, its largest component positive
    minor: np.ndarray  # [A]
    phase: float  # radians, φ: the major axis is passed at ωt = −φ

    @property
    def direction(self) -> np.ndarray:
        """[A] unit vector along the major axis."""
        return self.major / max(float(np.linalg.norm(self.major)), 1e-300)

    @property
    def amplitude(self) -> float:
        """Scene units, zero to peak, along the major axis."""
        return float(np.linalg.norm(self.major))


def orbit_of(peak: Peak) -> Orbit:
    """The phasor turned so that its real and imaginary part are perpendicular; in the directions that are told."""
    m = np.where(peak.is_resolved, peak.phasor, 0)
    phase = 0.5 * float(np.angle((m**2).sum()))
    turned = m * np.exp(-1j * phase)
    major, minor = turned.real, turned.imag
    if major[np.abs(major).argmax()] < 0:
        major, minor, phase = -major, -minor, phase + np.pi
    return Orbit(major, minor, float((phase + np.pi) % (2 * np.pi) - np.pi))


def amplitude_deviation(peak: Peak, orbit: Orbit) -> float:
    """Of the half axis, scene units: the axes' deviations along it."""
    deviation = np.where(peak.is_resolved, peak.deviation, 0)
    return float(np.sqrt(((orbit.direction * deviation) ** 2).sum()))


def main_is_above(peak: Peak, orbit: Orbit) -> bool:
    """Whether a peak is a line, asked for, or above the floor, and its main axis above twice its own deviation."""
    is_resolved = peak.line is not None or peak.asked is not None or bool(peak.is_above.any())
    return is_resolved and orbit.amplitude > 2 * amplitude_deviation(peak, orbit)
