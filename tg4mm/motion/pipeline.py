"""The motion of a scene's Gaussians from observations: every step of the method, in order (docs/method.md)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tg4mm.errors import RunError
from tg4mm.gaussians import Gaussians
from tg4mm.motion.appearance.fit import LOOK, AppearanceFit, Remainder
from tg4mm.motion.appearance_modes import AppearanceModes
from tg4mm.motion.checkpoints import Arrays, Parts, computed
from tg4mm.motion.coarse import coarser
from tg4mm.motion.config import MotionConfig, resolved
from tg4mm.motion.gauge import in_plane
from tg4mm.motion.gauss_newton import ABOVE_PX, GaussNewton, states_moved
from tg4mm.motion.higher_order import TaylorTerms
from tg4mm.motion.hyperparameters import (
    Hyperparameters,
    pixel_weights,
    select_noise,
    select_smoothness,
)
from tg4mm.motion.jacobian.view import ViewJacobian, view_jacobian
from tg4mm.motion.limits import frequency_notes, peaks
from tg4mm.motion.linear_fit import LinearFit
from tg4mm.motion.modes import ModalMotion
from tg4mm.motion.moving_camera import fit_moving_camera
from tg4mm.motion.nuisance import without
from tg4mm.motion.nuisance_choice import Seen, look_again, look_at
from tg4mm.motion.observations import Observations
from tg4mm.motion.problem import Problem
from tg4mm.motion.registration import stabilised
from tg4mm.motion.result import MotionFit
from tg4mm.motion.solver.operator import Fold
from tg4mm.motion.spectrum import apply_series, modes_of
from tg4mm.motion.split_half import LEAST, folds_of, wiener_shrink
from tg4mm.motion.steady import fit_independent_clocks
from tg4mm.motion.temporal import TargetImages, principal_components
from tg4mm.motion.uncertainty import Found, Uncertainty, of_few_views, of_halves
from tg4mm.progress import progress

_JUDGED = 10  # views in which it is told what is left of the pictures


def fit_motion(
    gaussians: Gaussians,
    observations: Observations,
    config: MotionConfig | None = None,
    device: str = "cpu",
    parts: Parts = computed,
) -> MotionFit:
    """The modal motion of `gaussians` (at rest, on the CPU) that explains the observations.

    `parts` keeps what is worth keeping of a long fit (`checkpoints.py`). On CUDA the iterations run there; reading the
    pictures, their components, the neighbourhoods, one projection of each view, appearance and higher-order terms are
    left to the CPU. Raises RunError where no camera sees a Gaussian, Tg4mmError on settings out of range or where the
    device's memory is too small.
    """
    asked = config or MotionConfig()
    fit = _fitted(gaussians, observations, resolved(asked, len(gaussians)), device, parts)
    return replace(fit, config=asked)


def _fitted(
    gaussians: Gaussians, observations: Observations, config: MotionConfig, device: str, parts: Parts
) -> MotionFit:
    if observations.clock == "moving":
        return fit_moving_camera(gaussians, observations, config, device, parts)
    views = rest_views(gaussians, observations)
    seen = look_at(observations, views, gaussians, config)
    if seen.is_shaking:
        gaussians, observations, pixels = stabilised(gaussians, observations, config, device, parts)
        views = rest_views(gaussians, observations)
        seen = look_again(observations, views, gaussians, seen, pixels)
    if observations.clock == "independent":
        return fit_independent_clocks(gaussians, observations, views, seen, config, device, parts)
    return _Synchronous(gaussians, observations, views, seen, config, device, parts).fit()


def rest_views(gaussians: Gaussians, observations: Observations) -> list[ViewJacobian]:
    """The Jacobian of every camera's picture at rest. Raises RunError where none sees a Gaussian."""
    views = [view_jacobian(gaussians, frames, observations.size) for frames in observations.frames]
    if not any(view.bins.n_visible for view in views):
        raise RunError(
            f"none of the {len(gaussians):,} Gaussians is seen by a camera whose pictures show motion"
        )
    return views


@dataclass(frozen=True)
class _Synchronous:
    """Fixed cameras on one regular clock: time separates from space, one field for each temporal component."""

    gaussians: Gaussians
    observations: Observations
    views: list[ViewJacobian]
    seen: Seen
    config: MotionConfig
    device: str
    parts: Parts

    def fit(self) -> MotionFit:
        """Components, hyperparameters, two passes, Gauss-Newton where motion is large, shrinkage, uncertainty."""
        first = self._first
        shapes, _ = wiener_shrink(np.stack([f["fields"] for f in first]))
        _, pixels = states_moved(self.views, self.basis, shapes, self.observations.size)
        is_small = pixels <= ABOVE_PX
        changes = self._appearance(shapes, True, LOOK) if is_small else None
        folds = self.linear.second_pass(first, self._correction(changes) if is_small else None)
        if self.observations.kind == "flat":
            folds = in_plane(folds, self.observations.frames[0].viewmat[2, :3])
        shapes, gains = wiener_shrink(folds)
        _, pixels = states_moved(self.views, self.basis, shapes, self.observations.size)
        figures: dict[str, Any] = {"pixels_moved": pixels, "gauss_newton": 0, **self._figures()}
        if pixels > ABOVE_PX and self.config.gauss_newton and self.observations.kind != "flat":
            return self._by_gauss_newton(folds, figures)
        if len(folds) == 2:
            figures["reliability"] = [round(float(g), 4) for g in gains]
        uncertain = self._uncertainty(
            folds, shapes, self._residuals(shapes, is_small), self.gaussians, self.views
        )
        appearance = self._appearance(shapes, is_small)
        if appearance is not None:
            figures["appearance_reliability"] = [round(float(g), 4) for g in appearance[1]]
        motion = self._motion(self.basis, shapes, None if appearance is None else appearance[0])
        return self._result(self.gaussians, motion, uncertain, figures)

    @cached_property
    def targets(self) -> TargetImages:
        most = self.config.components
        return principal_components(self.observations, self.seen.look, self.seen.nuisances, most)

    @cached_property
    def problem(self) -> Problem:
        problem = Problem.of(self.views, self.gaussians, self.config, self.device)
        return replace(problem, nuisances=self.seen.nuisances, means=self.targets.mean)

    @cached_property
    def folds(self) -> list[Fold]:
        return folds_of(len(self.views), self.observations.size, False, self.config.split_half)

    @cached_property
    def is_noise(self) -> np.ndarray:
        """[R] bool, of temporal components."""
        kept = self.parts("noise", lambda: {"is_noise": select_noise(self.targets, self.problem, self.folds)})
        return kept["is_noise"].astype(bool)

    @cached_property
    def weights(self) -> np.ndarray | None:
        return pixel_weights(self.targets, self.is_noise)

    @cached_property
    def hyper(self) -> Hyperparameters:
        def select() -> Arrays:
            own = self.targets, self.weights, self.problem, self.folds, self.config
            return {"smoothness_weight": np.array(select_smoothness(*own))}

        return Hyperparameters(self.is_noise, float(self.parts("smoothness", select)["smoothness_weight"]))

    @cached_property
    def linear(self) -> LinearFit:
        return LinearFit(
            self.problem, self.targets, self.hyper, self.weights, self.folds, self.config, self.parts
        )

    @cached_property
    def _first(self) -> list[Arrays]:
        return self.linear.first_pass()

    @property
    def basis(self) -> np.ndarray:
        """[R, T]: the functions of time that are fitted."""
        return self.targets.basis[self.hyper.signal]

    @cached_property
    def _terms(self) -> TaylorTerms:
        return TaylorTerms(self.views, self.targets.mean, self.basis)

    @cached_property
    def _appearance_fit(self) -> AppearanceFit | None:
        """None where it was not asked for, and where cameras are too few to tell it from noise."""
        if not self.config.appearance or len(self.views) < LEAST or len(self.folds) < 2:
            return None
        graph, frames = self.problem.graph, self.observations.frames
        return AppearanceFit.of(self.views, frames, self.gaussians, self.weights, graph, self.folds)

    def _appearance(
        self, shapes: np.ndarray, is_small: bool, iterations: int | None = None
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Changes of colour [R, N, K, 3] that go with fields [R, N, 6], and gains [R]."""
        if self._appearance_fit is None:
            return None
        asked = np.arange(len(shapes))
        left = Remainder(
            self.views, self.targets.images, self.hyper.signal, shapes, self._terms if is_small else None, asked,
            self.seen.nuisances, self.targets.mean,
        )  # fmt: skip
        if iterations is not None:
            return self._appearance_fit.fitted(left, None, iterations)
        with progress("appearance", len(asked), "components") as update:
            return self._appearance_fit.fitted(left, update)

    def _correction(self, changes: tuple[np.ndarray, np.ndarray] | None) -> Any:
        """What goes beyond the derivative, for `LinearFit.second_pass`."""

        def pictures(p: int, fields: np.ndarray, some: slice) -> Iterator[np.ndarray]:
            for v in self.folds[p].views:
                own = self._terms.of(int(v), fields)[some]
                if changes is not None and self._appearance_fit is not None and changes[0][some].any():
                    own = own + self._appearance_fit.shown(int(v), changes[0][some])
                yield own

        return pictures

    def _residuals(self, shapes: np.ndarray, is_small: bool) -> Iterator[np.ndarray]:
        """Of the judged views what the shapes leave of the target images, [R, H, W, 3] each."""
        for v in self._judged:
            left = self.targets.of(v, self.hyper.signal)
            left -= self.views[v].jvp(shapes)
            if is_small:
                left -= self._terms.of(v, shapes)
            yield without(self.seen.nuisances[v], self.targets.mean[v], left)

    @property
    def _judged(self) -> list[int]:
        n = len(self.views)
        return np.linspace(0, n - 1, min(n, _JUDGED)).round().astype(int).tolist()

    def _uncertainty(
        self,
        folds: np.ndarray,
        shapes: np.ndarray,
        residuals: Iterable[np.ndarray],
        gaussians: Gaussians,
        views: Sequence[ViewJacobian],
    ) -> Uncertainty | None:
        if len(folds) < 2:
            return None
        cameras = [self.observations.frames[v] for v in self._judged]
        own = [views[v] for v in self._judged]
        found = Found(folds, shapes, gaussians, self.problem.graph.knn, own, cameras, residuals)
        if len(views) >= LEAST or self.observations.kind == "flat":
            return of_halves(found, self.observations.n_timesteps)
        small, weights = coarser(self.problem, self.observations.frames, self.weights)
        operator = small.on_cpu(small.everything, weights, self.hyper.smoothness_weight)
        x = np.mean([f["x"] for f in self._first], axis=0)
        return of_few_views(found, operator, x, self.observations.n_timesteps, self.config.seed)

    def _by_gauss_newton(self, folds: np.ndarray, figures: dict[str, Any]) -> MotionFit:
        loop = GaussNewton(
            self.observations,
            self.targets,
            self.hyper,
            self.folds,
            self.seen.nuisances,
            self.config,
            self.device,
        )
        weight = self.hyper.smoothness_weight
        state, misfits, evidence = loop.run(self.gaussians, self.views, folds, weight, self.parts)
        shapes, gains = wiener_shrink(state.fields)
        views = loop.at_rest(state.gaussians)
        figures |= {
            "gauss_newton": len(misfits) - 1,
            "misfits": misfits,
            "smoothness_weight": state.smoothness_weight,
        }
        if len(folds) == 2:
            figures["reliability"] = [round(float(g), 4) for g in gains]
        targets = enumerate(loop.targets_at_rest(views, state.gaussians, shapes, evidence))
        residuals = (own - views[v].jvp(shapes) for v, own in targets if v in self._judged)
        uncertain = self._uncertainty(state.fields, shapes, residuals, state.gaussians, views)
        return self._result(state.gaussians, self._motion(loop.basis, shapes, None), uncertain, figures)

    def _motion(self, basis: np.ndarray, shapes: np.ndarray, changes: np.ndarray | None) -> ModalMotion:
        """From fields [R, N, 6] and changes of colour [R, N, K, 3]."""
        freqs, series = modes_of(basis, shapes, self.observations.fps, changes)
        values = apply_series(series, shapes)
        shown = None
        if changes is not None and (rows := np.flatnonzero(changes.any((1, 2, 3)))).size:
            shown = AppearanceModes(changes[rows], series[:, rows])
        of_time = self.observations.fps, self.observations.n_timesteps
        return ModalMotion(freqs, values[..., :3], values[..., 3:], *of_time, appearance=shown)

    def _figures(self) -> dict[str, Any]:
        energy, signal = self.targets.energy, self.hyper.signal
        return {
            "components": len(signal),
            "components_of_noise": int(self.hyper.is_noise.sum()),
            "iterations": self.config.iterations,
            "smoothness_weight": self.hyper.smoothness_weight,
            "views": len(self.views),
            "explained_by_components": float(energy[signal].sum() / max(energy.sum(), 1e-30)),
            **self.seen.figures,
        }

    def _result(
        self,
        gaussians: Gaussians,
        motion: ModalMotion,
        uncertain: Uncertainty | None,
        figures: dict[str, Any],
    ) -> MotionFit:
        notes = [*self.seen.notes]
        if self.observations.kind == "flat":
            notes.append("a flat capture shows motion across the sight alone, in pixels of its picture")
        if self.observations.kind == "flat" and (pixels := figures["pixels_moved"]) > ABOVE_PX:
            notes.append(
                f"things move by {pixels:.2g} px, more than the {ABOVE_PX} px that a flat capture is fitted for: "
                "amplitudes come out too small"
            )
        if uncertain is not None:
            figures, notes = figures | uncertain.figures, [*notes, *uncertain.notes]
        hz = peaks(motion, self.observations.lowest_hz)
        figures |= {"n_frequencies": len(motion.freqs_hz), "frequencies_hz": [round(float(f), 4) for f in hz]}
        notes += frequency_notes(hz, self.observations)
        return MotionFit(gaussians, motion, {} if uncertain is None else uncertain.arrays, figures, notes)
