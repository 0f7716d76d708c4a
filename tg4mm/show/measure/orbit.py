"""The ellipse that a sensor traces at one frequency, in the directions that the cameras resolve.

One camera hardly resolves its line of sight, and cameras that stand together hardly their common one. Such a direction
would fill the ellipse's main axis with its noise and hide what is well resolved. So the covariance's eigenvectors are
left out from the least certain one on: each that is within twice its deviation of 0, as long as it is more than twice
as uncertain as the others together, or the main axis does not exceed twice its deviation. `hidden` has these.
"""

from dataclasses import dataclass

import numpy as np

from tg4mm.show.measure.spectrum import Peak

TWICE = 2.0  # deviations: a smaller amplitude is not significant


@dataclass(frozen=True)
class Hidden:
    """A direction that is not resolved."""

    direction: np.ndarray  # [A] unit vector
    amplitude: float  # scene units, zero to peak
    deviation: float


@dataclass(frozen=True)
class Orbit:
    """The ellipse of Re[m exp(iωt)]: m = exp(iφ) (major + i minor), with major ⟂ minor."""

    major: np.ndarray  # [A] scene units: half axis, its largest component positive
    minor: np.ndarray  # [A]
    phase: float  # radians, φ: the major axis is passed at ωt = −φ
    deviation: float = 0.0  # of the half axis, scene units
    hidden: tuple[Hidden, ...] = ()

    @property
    def direction(self) -> np.ndarray:
        """Unit vector [A] along the major axis."""
        return self.major / max(float(np.linalg.norm(self.major)), 1e-300)

    @property
    def amplitude(self) -> float:
        """Amplitude along the major axis, scene units, zero to peak."""
        return float(np.linalg.norm(self.major))

    @property
    def stands_out(self) -> bool:
        """Whether the half axis exceeds twice its deviation."""
        return self.amplitude > TWICE * self.deviation


def orbit_of(peak: Peak) -> Orbit:
    """Return the orbit of a peak, in the resolved directions."""
    return orbit_in(peak.phasor, peak.deviation, peak.is_resolved, peak.correlation)


def orbit_in(
    phasor: np.ndarray, deviation: np.ndarray, some: np.ndarray, correlation: np.ndarray | None = None
) -> Orbit:
    """Return the orbit of a phasor [A] along the axes `some` [A], with deviations [A] of correlation [A, A] or none."""
    error = np.where(some, deviation, 0.0)
    covariance = np.diag(error**2) if correlation is None else correlation * np.outer(error, error)
    covariance[~some] = covariance[:, ~some] = 0
    own = np.flatnonzero(some)
    values, vectors = np.linalg.eigh(covariance[np.ix_(own, own)])
    directions = np.zeros((len(phasor), len(own)))
    directions[own] = vectors
    variances, along = np.maximum(values, 0), directions.T @ phasor
    hidden: list[Hidden] = []
    found = _ellipse(directions @ along, covariance)
    for k in range(len(own) - 1, 0, -1):
        size, sure = float(np.abs(along[k])), float(np.sqrt(variances[k]))
        is_worse = variances[k] > TWICE**2 * variances[:k].sum()
        if size > TWICE * sure or not (is_worse or not found.stands_out):
            break
        hidden.append(Hidden(directions[:, k], size, sure))
        kept = directions[:, :k]
        found = _ellipse(kept @ along[:k], kept * variances[:k] @ kept.T)
    return Orbit(found.major, found.minor, found.phase, found.deviation, tuple(hidden))


def _ellipse(m: np.ndarray, covariance: np.ndarray) -> Orbit:
    """Turn the phasor m [A] so that its real and imaginary part are perpendicular."""
    phase = 0.5 * float(np.angle((m**2).sum()))
    turned = m * np.exp(-1j * phase)
    major, minor = turned.real, turned.imag
    if major[np.abs(major).argmax()] < 0:
        major, minor, phase = -major, -minor, phase + np.pi
    direction = major / max(float(np.linalg.norm(major)), 1e-300)
    deviation = float(np.sqrt(max(direction @ covariance @ direction, 0.0)))
    return Orbit(major, minor, float((phase + np.pi) % (2 * np.pi) - np.pi), deviation)


def main_is_above(peak: Peak, orbit: Orbit) -> bool:
    """Whether a peak is a line, requested, or above the floor, and its main axis above twice its deviation."""
    is_resolved = peak.line is not None or peak.asked is not None or bool(peak.is_above.any())
    return is_resolved and orbit.stands_out
