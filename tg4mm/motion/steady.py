"""Fixed cameras with clocks of their own: clips that one camera filmed from place after place, or an unsynchronised
rig.

A steady vibration looks the same from every place but for its phase: θ_{c,k} of clip c at frequency k is unknown
(frequency-domain triangulation: Gorjup, Slavič & Boltežar 2019). The frequencies come from all clips' region shifts.
Every clip's pictures are projected on the sinusoids; the fields m_k and the phases are then found by turns: fields for
given phases by least squares, phases as θ = arg⟨J_c m, C_c⟩ with C_c the clip's complex picture. They begin from the
same turns on region shifts alone, which cost nothing and are begun from many random phases.

The first camera's clock is the common one. Cameras of a rig have one offset of their clock for all frequencies,
which is told from the phases.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tg4mm.capture.pictures import over_white
from tg4mm.gaussians import Gaussians
from tg4mm.motion.checkpoints import Arrays, Parts
from tg4mm.motion.coarse import coarser
from tg4mm.motion.config import MotionConfig
from tg4mm.motion.frequencies import LEAST as LEAST_POWER
from tg4mm.motion.frequencies import Frequencies, find_frequencies
from tg4mm.motion.hyperparameters import Hyperparameters, pixel_weights, select_smoothness
from tg4mm.motion.jacobian.pixels import pixels_moved
from tg4mm.motion.jacobian.view import ViewJacobian
from tg4mm.motion.limits import frequency_notes
from tg4mm.motion.linear_fit import LinearFit
from tg4mm.motion.modes import ModalMotion
from tg4mm.motion.nuisance import Projection, without
from tg4mm.motion.nuisance_choice import Seen
from tg4mm.motion.observations import Observations, PosedFrames
from tg4mm.motion.problem import Problem
from tg4mm.motion.regions import RegionSeries, fixed_camera_series, labels_of
from tg4mm.motion.result import MotionFit
from tg4mm.motion.split_half import LEAST, folds_of, wiener_shrink
from tg4mm.motion.temporal import TargetImages, sinusoid_targets, sinusoids
from tg4mm.motion.uncertainty import Found, Uncertainty, of_few_views, of_halves
from tg4mm.progress import progress

_TURNS = 2  # of fields and phases on the pictures themselves
_STARTS = 24  # random phases that the region shifts' turns begin from
_REGION_TURNS = 40
_HIGHEST = 0.98  # of half the frame rate
_AGREED = 0.5  # reliability below which a frequency is noise
_FRAMES = 8  # that share a pass
_LINEAR_PX = 0.7


def fit_independent_clocks(
    gaussians: Gaussians,
    observations: Observations,
    views: Sequence[ViewJacobian],
    seen: Seen,
    config: MotionConfig,
    device: str,
    parts: Parts,
) -> MotionFit:
    """`fit_motion` where every camera has a clock of its own."""
    problem = Problem.of(views, gaussians, config, device)
    series = region_series(observations, views, seen, problem, parts)
    found = frequencies_of(observations, series)
    figures = {
        **seen.figures,
        **_frequency_figures(found),
        "views": len(views),
        "iterations": config.iterations,
    }
    if not len(found.hz):
        return without_motion(gaussians, observations, figures, seen.notes)
    targets = sinusoid_targets(observations, seen.look, seen.nuisances, found.hz)
    problem = replace(problem, nuisances=seen.nuisances, means=targets.mean, _kept={})
    phases = region_phases(series, found.hz, config.seed)
    fit = _SteadyFit(problem, observations, targets, found.hz, config, parts)
    for turn in range(_TURNS):
        phases, is_agreed = fit.updated(phases, turn)
    if not is_agreed.any():
        return without_motion(gaussians, observations, figures, seen.notes)
    if not is_agreed.all():
        found, phases = found.selected(is_agreed), phases[:, is_agreed]
        figures |= _frequency_figures(found)
        targets = sinusoid_targets(observations, seen.look, seen.nuisances, found.hz)
        fit = replace(fit, targets=targets, hz=found.hz)
    fields = fit.fields(phases, "steady")
    shapes, gains = wiener_shrink(fields.folds)
    figures |= {
        "smoothness_weight": fields.hyper.smoothness_weight,
        "reliability": [round(float(g), 4) for g in gains],
        "pixels_moved": float(np.hypot(*pixels_moved(views, shapes[:2, :, :3] * np.float32(fit.scale)))),
        **_phase_figures(observations, phases, found.hz),
    }
    uncertain = fit.uncertainty(phases, fields, shapes) if len(fields.folds) == 2 else None
    own = [*_notes(observations, figures), *frequency_notes(found.hz, observations)]
    notes = [*seen.notes, *own, *([] if uncertain is None else uncertain.notes)]
    if uncertain is not None:
        figures |= uncertain.figures
    motion = motion_of(shapes, found.hz, fit.scale, observations)
    arrays = {} if uncertain is None else uncertain.arrays
    return MotionFit(gaussians, motion, arrays, figures | {"n_frequencies": len(found.hz)}, notes)


def region_series(
    observations: Observations, views: Sequence[ViewJacobian], seen: Seen, problem: Problem, parts: Parts
) -> list[RegionSeries]:
    """Every camera's region shifts."""
    labels, out = labels_of(problem.aggregates), []
    with progress("region shifts", len(views), "cameras") as update:
        for v, (frames, view) in enumerate(zip(observations.frames, views, strict=True)):

            def compute(v: int = v, frames: PosedFrames = frames, view: ViewJacobian = view) -> Arrays:
                mean, nuisance = seen.look.mean[v], seen.nuisances[v]
                projection = Projection.of(nuisance, mean, None) if nuisance.active.any() else None
                changes = changes_of(observations, frames, mean)
                own = fixed_camera_series(view, frames, projection, labels, changes, frames.times_s)
                return {"sides": own.sides, "normals": own.normals, "axes": own.axes}

            kept = parts(f"regions_{v}", compute)
            out.append(RegionSeries(frames.times_s, kept["sides"], kept["normals"], kept["axes"]))
            update(v + 1)
    return out


def changes_of(observations: Observations, frames: PosedFrames, mean: np.ndarray) -> Iterator[np.ndarray]:
    """A few frames at a time, [f, H, W, 3] less their mean over time."""
    for first in range(0, len(frames.rows), _FRAMES):
        rows = frames.rows[first : first + _FRAMES].tolist()
        raw = observations.pictures.strips(rows)
        yield over_white(raw(slice(None)), observations.pictures.maximum) - mean


def frequencies_of(
    observations: Observations,
    series: Sequence[RegionSeries],
    least: float = LEAST_POWER,
    lowest_hz: float = 0.0,
) -> Frequencies:
    """From all clocks' region shifts, between two periods in the record (or `lowest_hz`) and half the frame rate.

    Those whose power is at least `least` times that of the noise.
    """
    lowest_hz = max(lowest_hz, observations.lowest_hz)
    highest = _HIGHEST * observations.fps / 2
    shifts, times = [s.whitened() for s in series], [s.times_s for s in series]
    return find_frequencies(shifts, times, lowest_hz, highest, least)


def region_phases(series: Sequence[RegionSeries], hz: np.ndarray, seed: int) -> np.ndarray:
    """[C, K] radians, 0 for the first clock: by turns with each region's 3D phasor, the best of many random starts."""
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
            for _ in range(_REGION_TURNS):
                m = np.einsum("gab,cgb,c->ga", inverse, sides, np.exp(-1j * angle))
                z = np.einsum("ga,cga->c", m.conj(), sides)
                angle = np.angle(z)
            if (score := float(np.abs(z).sum())) > best:
                best, out[:, k] = score, angle
    return out - out[:1]


def rotations(phases: np.ndarray) -> np.ndarray:
    """[2K, 2K]: what phases [K] do to pairs (real, imaginary) of phasors."""
    out = np.zeros((2 * len(phases),) * 2, np.float32)
    for k, angle in enumerate(phases):
        c, s = np.cos(angle), np.sin(angle)
        out[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[c, -s], [s, c]]
    return out


def motion_of(shapes: np.ndarray, hz: np.ndarray, scale: float, observations: Observations) -> ModalMotion:
    """From pairs of fields [2K, N, 6], of which `scale` times makes phasors; by ascending frequency."""
    values = (scale * (shapes[0::2] + 1j * shapes[1::2])).astype(np.complex64)
    order = np.argsort(hz)
    of_time = observations.fps, observations.n_timesteps
    return ModalMotion(
        np.asarray(hz, np.float64)[order], values[order, :, :3], values[order, :, 3:], *of_time
    )


def without_motion(
    gaussians: Gaussians, observations: Observations, figures: dict[str, Any], notes: Sequence[str]
) -> MotionFit:
    """Where no frequency stands out of the noise, or the two halves of the data agree on no motion."""
    empty = np.zeros((0, len(gaussians), 3), np.complex64)
    motion = ModalMotion(np.zeros(0), empty, empty, observations.fps, observations.n_timesteps)
    note = "no frequency stands out of the noise: the run holds no motion"
    if hz := figures["frequencies_hz"]:
        named = ", ".join(f"{f:.4g}" for f in hz)
        moving = observations.clock == "moving"
        better = (
            "a fixed camera and a sweep (docs/capture-guide.md, tripod) tell"
            if moving
            else "longer clips tell"
        )
        note = (
            f"how things move at {named} Hz: two halves of the record do not agree on it, so that the run holds no "
            f"motion; {better}"
        )
    return MotionFit(gaussians, motion, {}, figures | {"n_frequencies": 0}, [*notes, note])


@dataclass(frozen=True)
class _Fields:
    folds: np.ndarray  # [P, 2K, N, 6]
    x: np.ndarray  # [2K, 4N, 3] displacement and its gradient, of the first pass, mean of the folds
    hyper: Hyperparameters


@dataclass(frozen=True)
class _SteadyFit:
    """Fields for given phases, and phases for given fields."""

    problem: Problem
    observations: Observations
    targets: TargetImages
    hz: np.ndarray
    config: MotionConfig
    parts: Parts

    @property
    def scale(self) -> float:
        """Of the shared functions of time (`sinusoid_targets`)."""
        return float(np.sqrt(2 / np.mean([len(f.rows) for f in self.observations.frames])))

    def with_phases(self, phases: np.ndarray) -> tuple[TargetImages, Problem]:
        """The problem whose mixing holds phases [C, K]."""
        assert self.targets.mixing is not None
        mixing = [m @ rotations(p) for m, p in zip(self.targets.mixing, phases, strict=True)]
        return replace(self.targets, mixing=mixing), replace(self.problem, mixing=mixing, _kept={})

    def fields(self, phases: np.ndarray, name: str, iterations: int | None = None) -> _Fields:
        """Of the folds."""
        targets, problem = self.with_phases(phases)
        folds = folds_of(len(problem.views), self.observations.size, False, self.config.split_half)

        def select() -> Arrays:
            # the strongest frequency alone: others, more than 1 / duration away, hardly show in its sinusoids
            mixing = [m[:2, :2] for m in targets.mixing or []]
            strongest = replace(targets, basis=targets.basis[:2], images=targets.images[:, :2], mixing=mixing)
            alone = replace(problem, mixing=mixing, _kept={})
            few = pixel_weights(strongest, np.zeros(2, bool))
            weight = select_smoothness(strongest, few, alone, folds, self.config)
            return {"smoothness_weight": np.array(weight)}

        weight = float(self.parts("smoothness", select)["smoothness_weight"])
        hyper = Hyperparameters(np.zeros(len(targets.basis), bool), weight)
        weights = pixel_weights(targets, hyper.is_noise)
        config = self.config if iterations is None else replace(self.config, iterations=iterations)
        linear = LinearFit(problem, targets, hyper, weights, folds, config, _named(self.parts, name))
        first = linear.first_pass()
        x = np.mean([f["x"] for f in first], axis=0)
        if iterations is not None:
            return _Fields(np.stack([f["fields"] for f in first]), x, hyper)
        return _Fields(linear.second_pass(first, None), x, hyper)

    def updated(self, phases: np.ndarray, turn: int) -> tuple[np.ndarray, np.ndarray]:
        """θ = arg⟨J m, C⟩ [C, K] of every camera's pictures, less the first camera's; [K]: do the halves agree?"""

        def compute() -> Arrays:
            few = max(self.config.iterations // 2, 6)
            shapes, gains = wiener_shrink(self.fields(phases, f"turn_{turn}", few).folds)
            return {"phases": self._phases(shapes), "gains": gains.reshape(-1, 2).max(1)}

        kept = self.parts(f"phases_{turn}", compute)
        return kept["phases"], kept["gains"] >= _AGREED

    def _phases(self, shapes: np.ndarray) -> np.ndarray:
        assert self.targets.mixing is not None
        out = np.zeros((len(self.problem.views), len(self.hz)))
        for v, view in enumerate(self.problem.views):
            shown = without(self.problem.nuisances[v], self.targets.mean[v], np.array(view.jvp(shapes)))
            own = self.targets.of(v)
            data = np.tensordot(np.linalg.inv(self.targets.mixing[v]), own, 1)
            for k in range(len(self.hz)):
                a, b = shown[2 * k : 2 * k + 2], data[2 * k : 2 * k + 2]
                real = float((a * b).sum(dtype=np.float64))
                imaginary = float((a[0] * b[1] - a[1] * b[0]).sum(dtype=np.float64))
                out[v, k] = np.arctan2(imaginary, real)
        return out - out[:1]

    def uncertainty(self, phases: np.ndarray, fields: _Fields, shapes: np.ndarray) -> Uncertainty:
        """As of synchronous cameras."""
        targets, problem = self.with_phases(phases)
        assert targets.mixing is not None
        mixing = targets.mixing
        residuals = (
            without(
                problem.nuisances[v],
                targets.mean[v],
                targets.of(v) - view.jvp(np.tensordot(mixing[v], shapes, 1)),
            )
            for v, view in enumerate(problem.views)
        )
        frames = self.observations.frames
        found = Found(
            fields.folds, shapes, problem.gaussians, problem.graph.knn, problem.views, frames, residuals
        )
        n_timesteps = round(float(np.mean([len(f.rows) for f in frames])))
        if len(problem.views) >= LEAST:
            return of_halves(found, n_timesteps)
        small, weights = coarser(problem, frames, pixel_weights(targets, fields.hyper.is_noise))
        alone = replace(small.on_cpu(small.everything, weights, fields.hyper.smoothness_weight), mixing=None)
        return of_few_views(found, alone, fields.x, n_timesteps, self.config.seed)


def _named(parts: Parts, name: str) -> Parts:
    return lambda part, compute: parts(f"{name}_{part}", compute)


def _frequency_figures(found: Frequencies) -> dict[str, Any]:
    return {
        "frequencies_hz": [round(float(f), 4) for f in found.hz],
        "frequency_deviation_hz": [round(float(f), 5) for f in found.deviation_hz],
    }


def _phase_figures(observations: Observations, phases: np.ndarray, hz: np.ndarray) -> dict[str, Any]:
    """Phases of every camera in degrees by frequency; of a rig also the offset of its clock that they make."""
    names = [f.name for f in observations.frames]
    degrees = {
        name: {f"{f:.3f}": round(float(np.degrees(p) % 360), 2) for f, p in zip(hz, own, strict=True)}
        for name, own in zip(names, phases, strict=True)
    }
    figures: dict[str, Any] = {"clip_phases_deg": degrees}
    if observations.kind == "rig":
        figures["clock_offsets_s"] = {
            name: round(clock_offset(own, hz), 5) for name, own in zip(names, phases, strict=True)
        }
    return figures


def clock_offset(phases: np.ndarray, hz: np.ndarray) -> float:
    """The offset Δ (s) nearest to 0 with θ_k = 2π f_k Δ for all k; of one frequency it is told modulo a period."""
    span = min(1 / (2 * hz.min()) * (1 if len(hz) == 1 else 8), 2.0)
    grid = np.arange(-span, span, 1 / (64 * hz.max()))
    score = np.cos(phases[None] - 2 * np.pi * grid[:, None] * hz).sum(1) - 1e-3 * np.abs(grid) / span
    return float(grid[score.argmax()])


def _notes(observations: Observations, figures: dict[str, Any]) -> list[str]:
    notes = []
    if figures["pixels_moved"] > _LINEAR_PX:
        notes.append(
            f"the motion is {figures['pixels_moved']:.2g} px, more than the {_LINEAR_PX} px that cameras with clocks "
            "of their own are fitted for: amplitudes come out too small"
        )
    if observations.kind == "rig":
        notes.append("the cameras' clocks are not synchronous: their offsets were found from the vibration")
    return notes
