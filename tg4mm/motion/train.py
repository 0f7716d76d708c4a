"""The motion stage, preset `modal`: one fit for all timesteps, with checkpoints and progress.

For every temporal component of the images' changes, a displacement field that explains it (least squares, by
conjugate gradients). The result is one phasor per Gaussian and DFT bin.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import numpy as np
from torch import Tensor

from tg4mm.capture import Capture, ImageStack
from tg4mm.capture.pictures import FilePictures
from tg4mm.device import gpu_figures, reset_gpu_peak
from tg4mm.errors import RunError
from tg4mm.gaussians import Gaussians
from tg4mm.memory import peak_memory_mib
from tg4mm.motion.appearance_modes import AppearanceModes
from tg4mm.motion.beyond import Beyond
from tg4mm.motion.certainty.doubt import doubt
from tg4mm.motion.certainty.found import Found, of_halves
from tg4mm.motion.certainty.halves import agreed_fields, halves
from tg4mm.motion.config import MotionConfig, resolved
from tg4mm.motion.fit import TOGETHER, Fit, Solver
from tg4mm.motion.jacobian.view import view_jacobian
from tg4mm.motion.light.fit import LOOK
from tg4mm.motion.modes import ModalMotion
from tg4mm.motion.pictures.differences import temporal_components
from tg4mm.motion.pictures.video import fixed_cameras
from tg4mm.motion.posing.noise import pixel_weights
from tg4mm.motion.posing.pose import Findings, Problems, posed
from tg4mm.motion.posing.weight import CANDIDATES
from tg4mm.motion.rounds.rounds import ABOVE_PX, Rounds
from tg4mm.motion.rounds.where import usable
from tg4mm.motion.solver.problem import MotionProblem
from tg4mm.motion.spectrum import apply_series, modes_of
from tg4mm.progress import progress
from tg4mm.runs import UNCERTAINTY, Run

CHECKPOINT_EVERY_S = 20.0
_STATE = 9  # of a checkpoint: one of another version is begun anew, as its fields are of other parameters
_STAGE, ROUNDS = "motion", "rounds"  # checkpoints


class _Stage:
    """The data of one run of the stage, and its loop over components and iterations."""

    def __init__(
        self,
        run: Run,
        capture: Capture,
        images: ImageStack | FilePictures,
        gaussians: Gaussians,
        config: MotionConfig,
        began: float,
        device: str = "cpu",
        known: Findings | None = None,
    ) -> None:
        self.run, self.config, self.device = run, config, device
        self.fps, self.n_timesteps = capture.fps, capture.n_timesteps
        self.cameras = fixed_cameras(capture)
        self.are_all = len(self.cameras) == len(np.unique(capture.camera_ids))
        self.components = temporal_components(images, self.cameras, config.components)
        size = (capture.width, capture.height)
        views = [view_jacobian(gaussians, camera, size) for camera in self.cameras]
        if not any(view.bins.n_visible for view in views):
            seeing = f"is seen by a camera of {capture.root} that stays put"
            raise RunError(f"{run.path}: none of its {len(gaussians):,} Gaussians {seeing}")
        self.parts = (halves(len(views)) if config.halves else []) or [np.arange(len(views))]
        problems = Problems(views, gaussians, config, device)
        self.findings, whole, begun = posed(problems, self.parts, self.components, TOGETHER, known)
        self.at_rest, self.images, self.gaussians = problems.views, images, gaussians
        self.graph = problems.graph
        of_parts = [whole.of_views(rows) for rows in self.parts]
        self.signal = np.flatnonzero(~self.findings.is_noise)
        self.basis = self.components.basis[self.signal]
        shown = self.components.images
        has_joints = len(self.parts) == 2 and self.findings.neighbours > CANDIDATES[0]
        graph = self.graph if has_joints else None
        self.solver = Solver(of_parts, self.parts, shown, self.signal, config, device, begun, graph)
        of_views = views, self.cameras, self.components, self.findings, self.signal
        self.beyond = Beyond(*of_views, gaussians, self.graph, self.parts, config.light)
        self.saved = time.monotonic()
        self.began = began  # what log.json does not hold yet

    def agreed(self, found: Found) -> tuple[np.ndarray, dict[str, Tensor], dict[str, Any]]:
        """The final fields [R, N, DOF], `UNCERTAINTY` if it was asked for, figures for the log."""
        shapes = found.shapes
        if len(found.fields) == 2:
            tensors, figures = of_halves(found, self.cameras, self.n_timesteps)
            gain = agreed_fields(found.fields)[1]
            return shapes, tensors, {"gain_of_components": [round(float(g), 4) for g in gain], **figures}
        if not self.config.halves:
            return shapes, {}, {}
        problems = Problems(found.views, found.gaussians, self.config, "cpu")
        weights = pixel_weights(self.components, self.findings.is_noise)
        (problem,) = problems.of(weights, [self.findings.neighbours])
        assert isinstance(problem, MotionProblem)
        pictures = np.stack([found.explained(v) for v in range(len(found.views))])
        of_run = self.cameras, self.n_timesteps, self.config.seed
        doubted = doubt(problem, pictures, shapes, found.gaussians, *of_run)
        return shapes, dict(doubted.tensors), dict(doubted.figures)

    def motion(self, shapes: np.ndarray, light: np.ndarray | None) -> ModalMotion:
        """From the fields [R, N, DOF] and `light`."""
        freqs, series = modes_of(self.basis, shapes, self.fps, light)
        values = apply_series(series, shapes)
        of_time = self.fps, self.n_timesteps
        shown = None
        if light is not None and (rows := np.flatnonzero(light.any((1, 2, 3)))).size:
            shown = AppearanceModes(light[rows], series[:, rows])
        return ModalMotion(freqs, values[..., :3], values[..., 3:], *of_time, light=shown)

    @cached_property
    def _rounds(self) -> Rounds:
        of_capture = self.images, self.cameras, self.components, self.findings
        return Rounds(*of_capture, self.parts, self.config, self.device, self.are_all)

    def light(self, shapes: np.ndarray, fit: Fit) -> tuple[np.ndarray | None, dict[str, Any]]:
        """Changes of colour [R, N, K, 3] that go with the fields [R, N, DOF] of the linear fit, figures."""
        if self.beyond.lighting is None:
            return None, {}
        asked = np.arange(len(shapes)) if fit.lit is None else np.array(fit.lit, np.int64)
        if not len(asked):
            return None, {"gain_of_light": [0.0] * len(shapes)}
        with progress("light", len(asked), "components") as update:
            found = self.beyond.light(shapes, fit.is_small, asked, update)
        assert found is not None
        return found[0], {"gain_of_light": [round(float(g), 4) for g in found[1]]}

    def fit(self, fit: Fit) -> Fit:
        """Solve for every component that is not solved yet, in two turns."""
        if len(fit.strain):
            self.solver = self.solver.loosened(fit.strain)
        with progress("motion stage", self.solver.units, start=self.solver.done(fit)) as update:
            if not fit.turn:
                self.solver.run(fit, update, self._keep)
                self._turn(fit)
            self.solver.run(fit, update, self._keep)
        fit.left, fit.strain = fit.left[:0].copy(), fit.strain[:0].copy()  # nobody asks for them any more
        self._keep(fit)  # what follows takes its time, too
        return fit

    def _turn(self, fit: Fit) -> None:
        """From the first turn to the second: take from what is left what the motion shows beyond the derivative, and
        loosen edges of the prior."""
        fields = fit.shapes.reshape(len(self.parts), -1, *fit.shapes.shape[1:])
        pixels = self._rounds.begun(
            self.gaussians, self.at_rest, fields, self.findings.neighbours, None
        ).pixels
        fit.turn, fit.component, fit.is_small = 1, 0, pixels <= ABOVE_PX
        if fit.is_small and self.solver.iterations(1):
            self._take_beyond(fit, fields)
            self._loosen(fit)
        fit.fields = fit.fields[:0].copy()  # a slice would hold it all

    def _take_beyond(self, fit: Fit, fields: np.ndarray) -> None:
        every = np.arange(fields.shape[1])
        light = self.beyond.light(agreed_fields(fields)[0], True, every, iterations=LOOK)
        changes = None if light is None else light[0]
        fit.lit = None if light is None else np.flatnonzero(light[1]).tolist()
        for part, own in enumerate(fields):
            self.solver.take_away(fit, part, partial(self.beyond.pictures, part, own, changes))

    def _loosen(self, fit: Fit) -> None:
        fit.strain, before = self.solver.strained(fit), self.solver
        if len(fit.strain):
            self.solver = before.loosened(fit.strain)
            self.solver.take_over(fit, before)

    def _keep(self, fit: Fit) -> None:
        if time.monotonic() - self.saved > CHECKPOINT_EVERY_S:
            self._save_fit(fit)

    def _save_fit(self, fit: Fit) -> None:
        self._save(_STAGE, fit.tensors(), fit.state() | {"version": _STATE, **self.findings.state()})

    def _save(self, name: str, tensors: dict[str, Tensor], state: dict[str, Any]) -> None:
        self.run.save_checkpoint(name, tensors, state)
        self.saved = time.monotonic()
        self.run.record(_STAGE, {"seconds": self.saved - self.began})
        self.began = self.saved

    def _outcome(self, fit: Fit) -> Found:
        """Of the linear fit."""
        fields = fit.shapes.reshape(len(self.parts), -1, *fit.shapes.shape[1:])
        shapes, _ = agreed_fields(fields)

        def explained(v: int) -> np.ndarray:
            pictures = self.components.images[v, self.signal]
            return pictures - self.beyond.carried.of(v, shapes) if fit.is_small else pictures

        return Found(fields, shapes, self.gaussians, self.at_rest, self.graph.knn, explained)

    def after_rounds(self, fit: Fit) -> tuple[Found, dict[str, Any]]:
        """After the rounds, which start where motion is not small; and figures."""
        fields = fit.shapes.reshape(len(self.parts), -1, *fit.shapes.shape[1:])
        rounds = self._rounds
        checkpoint = usable(self.run.load_checkpoint(ROUNDS))
        where = rounds.begun(self.gaussians, self.at_rest, fields, self.findings.neighbours, checkpoint)
        figures: dict[str, Any] = {"pixels_moved": where.pixels, "rounds": 0}
        if not self.config.rounds or where.pixels <= ABOVE_PX:
            return self._outcome(fit), figures
        if checkpoint is None:
            self._save_fit(fit)  # whatever happens now, the linear fit is done

        def keep(tensors: Callable[[], dict[str, Tensor]], state: Callable[[], dict[str, Any]]) -> None:
            if time.monotonic() - self.saved > CHECKPOINT_EVERY_S:
                self._save(ROUNDS, tensors(), state())

        evidence = rounds.evidence(where.states)
        total = self.config.rounds * rounds.units
        with progress("motion rounds", total, start=where.round * rounds.units) as update:
            where = rounds.run(where, evidence, keep, update)
        self._save(ROUNDS, where.tensors(), where.state())  # before the scene at rest is another
        figures |= {"rounds": where.round, "misfit_of_rounds": where.misfits}
        if not where.round:  # the linear fit stands, with its own components
            return self._outcome(fit), figures
        figures["neighbours"] = where.neighbours
        self.basis = rounds.basis
        return rounds.outcome(where, evidence), figures


def train_motion(
    run: Run, capture: Capture, images: ImageStack | FilePictures, config: MotionConfig, device: str = "cpu"
) -> ModalMotion:
    """Fit the motion of the run's Gaussians to a capture of T > 1 timesteps and save it in the run.

    Works with the cameras that stay put over all timesteps. The run's log gets seconds, peak_memory_mib, iterations (at
    most, for so many Gaussians), components, views, n_frequencies and the share of the images' changes that the kept
    components hold. With six cameras or more (and `config.halves`) noise is shrunk by what two halves of them agree on
    (`halves.py`); the log then holds `gain_of_components`. From them and from what all get wrong alike (`alike.py`), or
    with fewer cameras from samples (`posterior.py`), the run gets RUN/uncertainty.safetensors, and the log
    `noise_to_motion` (rms), from halves `uncertainty_to_motion` and from samples `freedom`. One camera alone is warned
    of; the log then holds `guess_along_sight_percent`. The log's `pixels_moved` is how far the linear fit moves things.
    Where 1 % of what is seen moves by more than 0.7 pixels the fit is repeated (`rounds.py`), so many `rounds`, after
    each of which `misfit_of_rounds` tells what is left of the pictures. If the capture has no cameras but the fixed
    ones, six or more, rounds sharpen the run's Gaussians, too.
    Without rounds, and with halves, what motion leaves of the pictures is fitted by changes of colour (`light/`, if
    `config.light`): `gain_of_light` in the log is what the halves agree on of each component, 0 for what is dropped.
    Of motion below 0.7 pixels the linear fit's second turn takes out that light and what pictures show of motion beyond
    their derivative (`fit.py`, `carried/`). With halves, and neighbours that count more than the least candidate, it
    also loosens what both halves find strained (`prior/joints.py`).
    On CUDA the iterations run there (`device.py`); reading the images, their components, the neighbourhoods, one
    projection of each view, light and what goes beyond the derivative are left to the CPU. Rounds choose the weight of
    the neighbours and project the moved views there in each round, and the uncertainty of few cameras is found there
    altogether.
    Raises CaptureError where no camera stays put, RunError where none of those sees a Gaussian, Tg4mmError on settings
    out of range or where the device's memory is too small.
    """
    began = time.monotonic()
    gaussians = run.load_space()
    config = resolved(config, len(gaussians))
    reset_gpu_peak(device)
    checkpoint = run.load_checkpoint(_STAGE)
    if checkpoint and checkpoint[1].get("version") != _STATE:
        checkpoint = None
    if checkpoint is None:
        run.drop_checkpoint(ROUNDS)  # of another linear fit
    known = Findings.of(checkpoint[1]) if checkpoint else None
    stage = _Stage(run, capture, images, gaussians, config, began, device, known)
    begun = Fit.begun(stage.solver.n_fields, len(gaussians))
    fit = stage.fit(Fit.restored(checkpoint, device) if checkpoint else begun)
    found, round_figures = stage.after_rounds(fit)
    shapes, uncertainty, agreement_figures = stage.agreed(found)
    light, light_figures = (None, {}) if round_figures["rounds"] else stage.light(shapes, fit)
    motion = stage.motion(shapes, light)
    energy = stage.components.energy
    figures = {
        "seconds": time.monotonic() - stage.began,
        "peak_memory_mib": peak_memory_mib(),
        **gpu_figures(device),
        "components": len(stage.signal),
        "components_of_noise": int(stage.findings.is_noise.sum()),
        "iterations": config.iterations,
        "neighbours": stage.findings.neighbours,
        "views": len(stage.cameras),
        "n_frequencies": len(motion.freqs_hz),
        "explained_by_components": float(energy[stage.signal].sum() / max(energy.sum(), 1e-30)),
        **agreement_figures,
        **round_figures,
        **light_figures,
    }
    if found.gaussians is not gaussians:
        run.save_space(found.gaussians, {})
    if uncertainty:  # before the motion, which tells that the stage is done
        run.save_part(UNCERTAINTY, uncertainty)
    run.save_motion(motion, figures)
    for name in (ROUNDS, _STAGE):
        run.drop_checkpoint(name)
    return motion
