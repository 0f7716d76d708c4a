"""The subject of an evaluation: a run's Gaussians with their estimated and exact motion."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from tg4mm.capture import Capture
from tg4mm.capture.truth_file import TRUTH_FILE, load_truth
from tg4mm.core.magnification import Magnification, check_bands
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.research.evaluate.displacement import displacement_figures, mean_squares
from tg4mm.research.evaluate.scores import Candidate, Posing
from tg4mm.research.evaluate.truth import exact_motion
from tg4mm.run import Run
from tg4mm.run.checks import check_times
from tg4mm.run.poses import method_of, poses_of
from tg4mm.run.tensor_file import model_hash
from tg4mm.show.maps import blending_weights

STATIC, OURS, CEILING = "nothing moves", "ours", "ceiling"


@dataclass(frozen=True)
class Subject:
    """A run's Gaussians with their estimated and exact motion."""

    gaussians: Gaussians
    estimated: ModalMotion | None
    exact: ModalMotion | None
    uncertainty: (
        np.ndarray | None
    )  # [N] standard deviation of the displacement, scene units, if the run says it
    magnified: Magnification  # by each α that is evaluated in place of its own
    from_zero: bool  # a mode of 0 Hz is the way to the motion's own zero, from which the truth counts
    posing: Posing | None  # None: modal, by the estimated motion

    @property
    def methods(self) -> list[Candidate]:
        found = [Candidate(STATIC, None)]
        if self.estimated is not None:
            found.append(Candidate(OURS, self.estimated, self.magnified, self.posing))
        if self.exact is not None:
            found.append(Candidate(CEILING, self.exact))
        return found


def subject_of(
    run: Run, capture: Capture, magnified: Magnification, absent: dict[str, str], device: str
) -> Subject:
    gaussians = run.load_space()
    estimated = run.load_motion()
    if estimated is None:
        absent["ours"] = (
            f"{run.path} has no motion: its motion stage is not finished, or the capture is one timestep"
        )
    else:
        check_times(
            run.path, run.dataset, (estimated.fps, estimated.n_timesteps), (capture.fps, capture.n_timesteps)
        )
    exact = None
    if (run.dataset / TRUTH_FILE).is_file() and capture.n_timesteps > 1:
        truth = load_truth(run.dataset, capture.fps, capture.n_timesteps)
        exact = exact_motion(truth, gaussians.means.numpy())
    else:
        absent["ceiling"] = (
            f"{run.dataset / TRUTH_FILE} does not exist: no exact motion, no displacement error"
        )
    check_bands(magnified.limits, capture.fps)
    posing = None if estimated is None else _posing(run, magnified, device)
    from_zero = run.preset == "modal"
    said = run.load_uncertainty()
    return Subject(gaussians.to(device), estimated, exact, said, magnified, from_zero, posing)


def _posing(run: Run, magnified: Magnification, device: str) -> Posing | None:
    """Return the run's method of posing and magnification, or None if its modes are sufficient."""
    if method_of(run, magnified) == "modal":
        return None

    @lru_cache(maxsize=1)
    def at(alpha: float) -> Callable[[float], Gaussians]:
        return poses_of(run, magnified.times(alpha), device).at

    return Posing(at, repr((method_of(run, magnified), magnified.times(1.0), model_hash(run.path))))


def unresolved(exact: ModalMotion) -> dict[str, str]:
    """Return what of the exact motion the record does not resolve, and why: less than one period of it."""
    duration = exact.n_timesteps / exact.fps
    return {
        f"the motion at {hz:g} Hz": (
            f"the record of {exact.n_timesteps} timesteps at {exact.fps:g} Hz holds {hz * duration:.2g} of its period, "
            f"so that errors and closure do not judge a method; it takes {math.ceil(exact.fps / hz)} timesteps or more"
        )
        for hz in exact.freqs_hz.tolist()
        if 0 < hz * duration < _ONE_PERIOD
    }


def displacement_of(subject: Subject, capture: Capture, absent: dict[str, str]) -> dict[str, Any] | None:
    """`displacement_figures` of the run's motion, also of the part in the band, if both motions are there.

    `uncertainty` holds `uncertainty_figures` where the run says how sure it is.
    """
    estimated, exact = subject.estimated, subject.exact
    if estimated is None or exact is None:
        return None
    weights = blending_weights(subject.gaussians, capture)
    if not weights.sum() > 0:
        absent["displacement error"] = "no training camera sees any Gaussian"
        return None
    if subject.from_zero:
        estimated = estimated.selected(estimated.freqs_hz > 0)
    absent |= unresolved(exact)
    figures = displacement_figures(estimated, exact, weights, capture.unit_scale_m)
    if subject.uncertainty is not None:
        figures["uncertainty"] = uncertainty_figures(estimated, exact, weights, subject.uncertainty)
    if subject.magnified.bands:
        inside = [m.selected(subject.magnified.inside(m.freqs_hz)) for m in (estimated, exact)]
        figures["in_band"] = displacement_figures(inside[0], inside[1], weights, capture.unit_scale_m)
    return figures


def notes_of(subject: Subject) -> list[str]:
    """What "ours" magnifies and the ground truth does not, or the other way round."""
    exact, bands = subject.exact, subject.magnified.limits
    if exact is None:
        return []
    moving, magnified = exact.displacement.any(axis=(1, 2)), exact.is_magnified()
    inside = subject.magnified.inside(exact.freqs_hz)
    notes = []
    if bands and (outside := exact.freqs_hz[moving & magnified & ~inside]).size:
        notes.append(
            f"The ground truth also magnifies motion at {_hertz(outside)}, "
            f"outside the band {' and '.join(f'{low:g} to {high:g}' for low, high in bands)} Hz."
        )
    if (left := exact.freqs_hz[moving & ~magnified & inside]).size:
        where = "without a band, ours does" if not bands else "which lies inside the band"
        notes.append(f"The ground truth does not magnify motion at {_hertz(left)}, {where}.")
    return notes


def _hertz(frequencies: np.ndarray) -> str:
    return ", ".join(f"{f:g}" for f in frequencies) + " Hz"


_TIMES = 2.0  # of the standard deviation that is said: beyond it an error was not foreseen
_ONE_PERIOD = 0.99  # of a period in the record: with less a frequency is not resolved


def uncertainty_figures(
    estimated: ModalMotion, true: ModalMotion, weights: np.ndarray, said: np.ndarray
) -> dict[str, float]:
    """Figures of `said` [N], the standard deviation of each Gaussian's displacement (rms over time, scene units).

    `said`, `error`: rms over Gaussians, weighted by `weights` [N], scene units. `within_two`: the part of the weight
    whose true error, rms over time, is at most twice what is said. Raises ValueError where `said` is for another
    number of Gaussians.
    """
    if said.shape != weights.shape:
        raise ValueError(f"the uncertainty is of {len(said)} Gaussians, the weights of {len(weights)}")
    error2, said2 = mean_squares(estimated, true)[0], said.astype(np.float64) ** 2
    total = weights.sum()
    return {
        "said": float(np.sqrt((said2 * weights).sum() / total)),
        "error": float(np.sqrt((error2 * weights).sum() / total)),
        "within_two": float(weights[error2 <= _TIMES**2 * said2].sum() / total),
    }
