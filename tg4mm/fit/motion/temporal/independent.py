"""Fixed cameras with independent clocks: clips filmed one after another, or an unsynchronised rig.

A steady vibration looks the same from every place but for its phase: θ_{c,k} of clip c at frequency k is unknown
(frequency-domain triangulation: Gorjup, Slavič & Boltežar 2019). The frequencies come from all clips' region shifts.
Every clip's pictures are projected on the sinusoids; the fields m_k and the phases are then found in alternation:
fields for given phases by least squares, phases as θ = arg⟨J_c m, C_c⟩ with C_c the clip's complex picture. They
start from the same alternation on region shifts alone, which costs nothing and is tried from many random phases.

The first camera's clock is the common one. Cameras of a rig have one offset of their clock for all frequencies,
which follows from the phases.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.checkpoints import Arrays, Checkpoint, Step, no_checkpoint
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.hyperparameters import Hyperparameters
from tg4mm.fit.motion.linear_fit import LinearFit
from tg4mm.fit.motion.nuisance.fixed_cameras import PictureSums, prepare_fixed_cameras
from tg4mm.fit.motion.nuisance.projection import Nuisance
from tg4mm.fit.motion.observations import Observations
from tg4mm.fit.motion.solver.operator import Fold
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.spectrum import constant_and_trend, sinusoids
from tg4mm.fit.motion.split_half import folds_of, wiener_shrink
from tg4mm.fit.motion.targets import TargetImages, projected
from tg4mm.fit.motion.temporal.sinusoidal import (
    LEAST,
    RegionSeries,
    SinusoidalModel,
    frequencies_of,
    frequency_figures,
    no_targets,
    region_series,
)

_ALTERNATIONS = 2  # between fields and phases on the pictures themselves
_OF_ITERATIONS = 4  # times fewer iterations than the fit: enough for phases
_STARTS = 24  # random phases to start from on region shifts
_REGION_ALTERNATIONS = 40


@dataclass(frozen=True)
class IndependentClocks(SinusoidalModel):
    """`TemporalModel` of cameras whose clocks, or starts of the vibration, differ."""

    unphased: Sequence[np.ndarray]  # C_v for phases of 0
    phases: np.ndarray  # [C, K] radians, of the first camera 0
    min_reliability: ClassVar[float] = 0.5

    @staticmethod
    def of(
        gaussians: Gaussians,
        observations: Observations,
        config: MotionConfig,
        device: str,
        checkpoint: Checkpoint,
    ) -> "IndependentClocks":
        """Frequencies from region shifts, sinusoids of these, and phases from region shifts."""
        seen = prepare_fixed_cameras(gaussians, observations, config, device, checkpoint)
        observations = seen.observations
        problem = seen.problem(config, device)
        series = region_series(seen, problem, checkpoint)
        frequencies, of_band = frequencies_of(observations, series, LEAST, 0.0, config)
        figures = {**seen.figures, **frequency_figures(frequencies), **of_band}
        targets, mixing = no_targets(observations), list[np.ndarray]()
        phases = np.zeros((len(series), 0))
        if len(frequencies.hz):
            targets, mixing = sinusoid_targets(observations, seen.sums, seen.nuisances, frequencies.hz)
            phases = region_phases(series, frequencies.hz, config.seed)
        folds = folds_of(len(seen.views), observations.size, False, config.split_half)
        model = IndependentClocks(
            seen.gaussians, observations, problem, targets, folds, config, figures, seen.notes,
            np.arange(targets.images.shape[1]), frequencies, scale_of(observations), mixing, phases,
        )  # fmt: skip
        return model.with_phases(phases)

    @property
    def n_frames(self) -> int:
        """The mean over cameras."""
        return round(float(np.mean([len(f.rows) for f in self.observations.frames])))

    def with_phases(self, phases: np.ndarray) -> "IndependentClocks":
        """C_v holds phases [C, K]."""
        mixing = [m @ rotations(p) for m, p in zip(self.unphased, phases, strict=False)]
        return replace(self, phases=phases, problem=self.problem.changed(mixing=mixing))

    def strongest(self) -> tuple[np.ndarray, Problem, Sequence[Fold]]:
        """The strongest frequency: others, more than 1 / duration away, hardly show in its sinusoids."""
        mixing = [m[:2, :2] for m in self.problem.mixing or ()]
        return self.targets.images[:, :2], self.problem.changed(mixing=mixing), self.folds

    def completed(self, hyper: Hyperparameters, checkpoint: Checkpoint) -> "IndependentClocks":
        """Every camera's phases, in alternation with the fields."""
        model = self
        few = max(self.config.iterations // _OF_ITERATIONS, 2)
        for k in range(_ALTERNATIONS):

            def compute(model: IndependentClocks = model) -> Arrays:
                linear = LinearFit(
                    model.problem, model.targets, hyper, model.folds, model.config, no_checkpoint
                )
                fields, _ = wiener_shrink(np.stack([f["fields"] for f in linear.first_pass(few)]))
                return {"phases": model.phases_for(fields)}

            model = model.with_phases(checkpoint(Step.phases.numbered(k), compute)["phases"])
        return model

    def phases_for(self, fields: np.ndarray) -> np.ndarray:
        """θ = arg⟨J m, C⟩ [C, K] of every camera's pictures, less the first camera's."""
        out = np.zeros((len(self.problem.views), len(self.hz)))
        for v, view in enumerate(self.problem.views):
            shown = self.problem.without_nuisance(v, np.array(view.jvp(fields)))
            data = np.tensordot(np.linalg.inv(self.unphased[v]), self.targets.of(v), 1)
            for k in range(len(self.hz)):
                a, b = shown[2 * k : 2 * k + 2], data[2 * k : 2 * k + 2]
                real = float((a * b).sum(dtype=np.float64))
                imaginary = float((a[0] * b[1] - a[1] * b[0]).sum(dtype=np.float64))
                out[v, k] = np.arctan2(imaginary, real)
        return out - out[:1]

    def settled(self, folds: np.ndarray) -> "tuple[IndependentClocks, np.ndarray]":
        """Drop noise like all models; log the phases of the other frequencies, and note the clock offsets of a rig."""
        model, kept = super().settled(folds)
        phases = self.phases[:, np.isin(self.hz, model.hz)]
        figures = _phase_figures(self.observations, phases, model.hz) if len(model.hz) else {}
        notes = [*model.notes]
        if offsets := figures.get("clock_offsets_s"):
            named = ", ".join(f"{name} {seconds:+.4g} s" for name, seconds in offsets.items())
            notes.append(
                f"the cameras' clocks are not synchronous; their offsets, found from the vibration: {named}"
            )
        return replace(model, phases=phases, figures=model.figures | figures, notes=notes), kept


def scale_of(observations: Observations) -> float:
    """Factor of cosines and sines whose squares sum to 1 over a camera's frames."""
    return float(np.sqrt(2 / np.mean([len(f.rows) for f in observations.frames])))


def sinusoid_targets(
    observations: Observations, sums: PictureSums, nuisances: Sequence[Nuisance], freqs_hz: np.ndarray
) -> tuple[TargetImages, list[np.ndarray]]:
    """Cosines and sines of K frequencies in every camera's own time, with a constant and a trend taken out; and C_v.

    Functions 2k and 2k + 1 are √(2/F) cos and −√(2/F) sin of frequency k, F the mean number of frames, so that a field
    pair is the real and imaginary part of √(F/2) times the phasor.
    """
    frames, scale = observations.frames, scale_of(observations)
    bases, mixing = zip(*(_orthonormal(f.times_s, freqs_hz, scale) for f in frames), strict=True)
    images, residual = projected(observations, sums, nuisances, bases)
    shared = sinusoids(np.arange(observations.n_timesteps) / observations.fps, freqs_hz) * scale
    energy = np.zeros(observations.n_timesteps)
    energy[: 2 * len(freqs_hz)] = np.sort((images.astype(np.float64) ** 2).sum((0, 2, 3, 4)))[::-1]
    rank = round(float(np.mean([len(f.rows) for f in frames]))) - 2
    return TargetImages(shared, energy, images, residual, max(rank, 1), sums.mean), list(mixing)


def _orthonormal(times_s: np.ndarray, freqs_hz: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal functions [2K, F] that span the sinusoids less a constant and a trend, and the mixing [2K, 2K]."""
    design = np.concatenate([constant_and_trend(times_s), scale * sinusoids(times_s, freqs_hz)]).T
    q, r = np.linalg.qr(design)
    return q[:, 2:].T, r[2:, 2:].astype(np.float32)


def region_phases(series: Sequence[RegionSeries], hz: np.ndarray, seed: int) -> np.ndarray:
    """Return phases [C, K] in radians, 0 for the first clock, alternating with the regions' phasors, best of many."""
    phasors = np.stack([s.phasors(sinusoids(s.times_s, hz)) for s in series])  # [C, K, G, 2] of b
    normals = np.stack([s.normals[0] for s in series])  # [C, G, 2, 2]
    axes = np.stack([s.axes[0] for s in series])  # [C, 2, 3]
    lifted = np.einsum("cia,cgij,cjb->cgab", axes, normals, axes)
    ridge = 1e-3 * np.trace(lifted, axis1=2, axis2=3).sum(0).mean() * np.eye(3)
    inverse = np.linalg.inv(lifted.sum(0) + ridge)  # [G, 3, 3]
    out = np.zeros((len(series), len(hz)))
    rng = np.random.default_rng(seed)
    for k in range(len(hz)):
        sides = np.einsum("cia,cgi->cga", axes, phasors[:, k])  # Eᵀ b
        best = -1.0
        for _ in range(_STARTS):
            angle = rng.uniform(0, 2 * np.pi, len(series))
            for _ in range(_REGION_ALTERNATIONS):
                m = np.einsum("gab,cgb,c->ga", inverse, sides, np.exp(-1j * angle))
                z = np.einsum("ga,cga->c", m.conj(), sides)
                angle = np.angle(z)
            if (score := float(np.abs(z).sum())) > best:
                best, out[:, k] = score, angle
    return out - out[:1]


def rotations(phases: np.ndarray) -> np.ndarray:
    """Return [2K, 2K]: what phases [K] do to pairs (real, imaginary) of phasors."""
    out = np.zeros((2 * len(phases),) * 2, np.float32)
    for k, angle in enumerate(phases):
        c, s = np.cos(angle), np.sin(angle)
        out[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[c, -s], [s, c]]
    return out


def _phase_figures(observations: Observations, phases: np.ndarray, hz: np.ndarray) -> dict[str, Any]:
    """Phases of every camera in degrees by frequency; of a rig also the offset of its clock that they make."""
    names = [f.name for f in observations.frames]
    degrees = {
        name: {f"{f:.3f}": round(float(np.degrees(p) % 360), 2) for f, p in zip(hz, values, strict=True)}
        for name, values in zip(names, phases, strict=True)
    }
    figures: dict[str, Any] = {"clip_phases_deg": degrees}
    if observations.kind.together:
        figures["clock_offsets_s"] = {
            name: round(clock_offset(values, hz), 5) for name, values in zip(names, phases, strict=True)
        }
    return figures


def clock_offset(phases: np.ndarray, hz: np.ndarray) -> float:
    """The offset Δ (s) nearest to 0 with θ_k = 2π f_k Δ for all k; for one frequency, modulo a period."""
    span = min(1 / (2 * hz.min()) * (1 if len(hz) == 1 else 8), 2.0)
    grid = np.arange(-span, span, 1 / (64 * hz.max()))
    score = np.cos(phases[None] - 2 * np.pi * grid[:, None] * hz).sum(1) - 1e-3 * np.abs(grid) / span
    return float(grid[score.argmax()])
