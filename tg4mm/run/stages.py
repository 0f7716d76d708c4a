"""The stages of a run of the preset `modal`, look, space and motion, each with its files in the run folder."""

import dataclasses
import hashlib
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch

from tg4mm.capture import Capture, ImageStack, SurfacePoints
from tg4mm.capture.look import GreyPicture, LookLine, LookSummary, look_at_pictures
from tg4mm.capture.look.compression import with_losses
from tg4mm.capture.look.reading import FEWEST, INTRA
from tg4mm.capture.look.record import from_record, to_record
from tg4mm.capture.look.rows import with_rows
from tg4mm.capture.pictures import FilePictures, grey_over_white
from tg4mm.capture.scene import between_frames, picture_kinds, video_file
from tg4mm.core.choices import Clock
from tg4mm.core.errors import RunError
from tg4mm.core.memory import peak_memory_mib, reset_peak_memory
from tg4mm.core.progress import progress
from tg4mm.core.work_folder import StageCheckpoint
from tg4mm.fit.device import gpu_figures, reset_gpu_peak
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.checkpoints import Arrays, arrays_of, gaussians_of
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.fit.motion.observations import PosedFrames, fixed_cameras, masked, note_on, observe, window_on
from tg4mm.fit.motion.pipeline import fit_motion
from tg4mm.fit.space.config import SpaceConfig
from tg4mm.fit.space.plane import fit_plane
from tg4mm.fit.space.targets import RestViews
from tg4mm.fit.space.train import fit_space
from tg4mm.run import UNCERTAINTY, Run

_SCENE = "scene"
_VERSION = 19  # of a checkpoint; steps of another version are repeated
_RESOLVED = 4.0  # noise of the worst over that of the best determined combination of vibrations, at most
_LOG = logging.getLogger("tg4mm")


def courses(
    lines: Sequence[LookLine], times_s: np.ndarray, b_frames: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return [C, F]: courses of vibrations as the pictures show them, and the vibrations' own.

    B-frames keep a share of a small motion, another one at each place: where the other frames resolve the vibrations,
    B-frames get courses of their own, which are no motion.
    """
    own = np.concatenate([line.course(times_s) for line in lines])
    lossy = np.repeat([line.between_share < 1 for line in lines], 2)
    if b_frames is None or not lossy.any():
        return own, own
    apart = own[:, ~b_frames] - own[:, ~b_frames].mean(1, keepdims=True)
    if np.linalg.cond(apart / np.linalg.norm(apart, axis=1, keepdims=True)) > _RESOLVED:
        shares = np.repeat([line.between_share for line in lines], 2)[:, None]
        return own * np.where(b_frames, shares, 1), own
    between = own[lossy] * b_frames
    shown = own.copy()
    shown[lossy] -= between
    return np.concatenate([shown, between]), np.concatenate([own, np.zeros_like(between)])


def with_shares(
    frames: PosedFrames, shown: np.ndarray, own: np.ndarray, b_frames: np.ndarray | None
) -> PosedFrames:
    """Return the frames with `courses` that they show, and what B-frames and the others show of each."""
    if b_frames is None or shown is own:
        return frames
    carriers = own[own.any(1)]
    if len(carriers) < len(shown):  # B-frames have courses of their own
        lossy = (shown[: len(carriers)] != carriers).any(1)
        carriers = np.concatenate([carriers, carriers[lossy]])
    shares = np.ones(shown.shape)
    for kind in (b_frames, ~b_frames):
        of_kind = carriers[:, kind]
        # 0 where no frame is of that kind
        squares = np.maximum((of_kind**2).sum(1), np.finfo(np.float64).tiny)
        shares[:, kind] = ((shown[:, kind] * of_kind).sum(1) / squares)[:, None]
    return dataclasses.replace(frames, carriers=carriers, shares=shares)


def train_motion(
    run: Run,
    capture: Capture,
    images: ImageStack | FilePictures,
    config: MotionConfig,
    device: str = "cpu",
    mask: np.ndarray | None = None,
    moves: np.ndarray | None = None,
    found: LookSummary | None = None,
) -> ModalMotion:
    """Fit the motion of the run's Gaussians to a capture of T > 1 timesteps and save it in the run (`fit_motion`).

    mask [H, W] bool: excluded pixels of one fixed camera, in which objects move independently. moves [H, W] bool:
    pixels that may move; no others are read. found: result of the look at the regions.
    The run gets motion.safetensors, uncertainty.safetensors if it is known, and in its log the figures that
    docs/conventions.md lists; large motion also sharpens space.safetensors. Quantities that cannot be determined give
    a warning each. Raises CaptureError for too few pictures to show motion, RunError if none of them sees a Gaussian,
    Tg4mmError on settings out of range or if the device has too little memory.
    """
    kept = StageCheckpoint(run, "motion")
    reset_peak_memory()
    reset_gpu_peak(device)
    window = window_on(capture, config, moves)
    observations = observe(capture, images, window)
    if moves is not None and config.nuisance == "auto":
        config = dataclasses.replace(config, nuisance="exposure")  # too little is left to show a shake
    if mask is not None and mask.any():
        excluded = mask if window is None else window.any_of(mask)
        observations = masked(observations, excluded[None])
    if found is not None and found.vibrations and observations.clock == Clock.synchronous:
        times = observations.frames[0].times_s
        lines = {
            line.hz: line for line in found.vibrations
        }.values()  # parts of one frequency share its course
        b_frames = between_frames(capture.root, len(times))
        shown, own = courses(list(lines), times, b_frames)
        steady = tuple(line.hz for line in lines if line.start_s is None and not line.decay_per_s)
        frames = [with_shares(each, shown, own, b_frames) for each in observations.frames]
        observations = dataclasses.replace(
            observations, frames=frames, time_courses=shown, own_courses=own, steady_hz=steady
        )
    checkpoint = RunCheckpoint(run, kept, capture.rows_s)
    gaussians = checkpoint.gaussians
    try:
        fit = fit_motion(gaussians, observations, config, device, checkpoint)
    except RunError as error:
        raise RunError(f"{run.path}: {error}") from None
    notes = list(fit.notes)
    if window is not None and window.factor > 1:
        notes.append(note_on(capture, images, window))
    figures = {
        "seconds": kept.unrecorded_s,
        "peak_memory_mib": peak_memory_mib(),
        **gpu_figures(device),
        **fit.figures,
        **({"readout_s": capture.rows_s} if capture.rows_s else {}),
        **({"reduced": window.factor} if window is not None and window.factor > 1 else {}),
        "notes": notes,
    }
    for note in notes:
        _LOG.warning(note)
    if fit.gaussians is not gaussians:
        checkpoint.expect_scene(fit.gaussians)
        run.save_space(fit.gaussians, {})
    if fit.uncertainty:  # before the motion, which completes the stage
        run.save_part(UNCERTAINTY, {k: torch.from_numpy(v) for k, v in fit.uncertainty.items()})
    run.save_motion(fit.motion, figures)
    kept.drop()
    return fit.motion


class RunCheckpoint:
    """A `Checkpoint` in the run, and the Gaussians of its steps."""

    def __init__(self, run: Run, kept: StageCheckpoint, readout_s: float = 0.0) -> None:
        self._kept, self._readout_s = kept, readout_s
        self.gaussians = run.load_space()
        self._scene = _digest(arrays_of(self.gaussians))
        self._arrays: Arrays = {}
        stored = kept.load()
        if stored is None or stored[1].get("version") != _VERSION:
            return
        tensors, state = stored
        if state.get("readout_s", 0.0) != readout_s:
            return
        if self._scene not in (state.get("scene"), state.get("expected_scene")):
            return
        if self._scene != state.get("scene"):  # stopped between saving the sharper Gaussians and the motion
            names = arrays_of(self.gaussians)
            self.gaussians = gaussians_of({n: tensors[f"{_SCENE}/{n}"].numpy() for n in names})
            self._scene = state["scene"]
        self._arrays = {k: v.numpy() for k, v in tensors.items()}

    def __call__(self, name: str, compute: Callable[[], Arrays]) -> Arrays:
        """Return a step's arrays from the checkpoint, or compute and store them."""
        kept = {k.partition("/")[2]: v for k, v in self._arrays.items() if k.partition("/")[0] == name}
        if kept:
            return kept
        arrays = compute()
        self._arrays = {k: v for k, v in self._arrays.items() if k.partition("/")[0] != name}
        self._arrays |= {f"{name}/{k}": np.asarray(v, order="C") for k, v in arrays.items()}
        self._save()
        return arrays

    def expect_scene(self, gaussians: Gaussians) -> None:
        """Announce the run's next Gaussians; the checkpoint keeps those of its steps."""
        self._arrays |= {f"{_SCENE}/{k}": v for k, v in arrays_of(self.gaussians).items()}
        self._save(expected_scene=_digest(arrays_of(gaussians)))

    def _save(self, **more: str) -> None:
        tensors = {k: torch.from_numpy(v) for k, v in self._arrays.items()}
        state = {"version": _VERSION, "scene": self._scene, "readout_s": self._readout_s, **more}
        self._kept.save(tensors, state)


def _digest(arrays: Mapping[str, np.ndarray]) -> str:
    digest = hashlib.blake2b(digest_size=16)
    for name in sorted(arrays):
        array = np.asarray(arrays[name], order="C")
        digest.update(f"{name} {array.dtype} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def train_space(
    run: Run, views: RestViews, points: SurfacePoints | None, config: SpaceConfig, device: str = "cpu"
) -> Gaussians:
    """Run `fit_space` with RUN/checkpoint_space.safetensors, and save RUN/space.safetensors.

    Returns the Gaussians (on the CPU). The run's log gets the figures of `SpaceFit`. Raises the errors of `fit_space`.
    """
    reset_peak_memory()
    kept = StageCheckpoint(run, "space")
    fit = fit_space(views, points, config, device, kept)
    run.save_space(fit.gaussians, fit.figures)
    kept.drop()
    return fit.gaussians


def train_plane(run: Run, views: RestViews, config: SpaceConfig, device: str = "cpu") -> Gaussians:
    """Run `fit_plane` and save it in the run with its figures. Returns the Gaussians (on the CPU)."""
    reset_peak_memory()
    fit = fit_plane(views, config, device)
    run.save_space(fit.gaussians, fit.figures)
    return fit.gaussians


def look_at_capture(run: Run, capture: Capture, images: ImageStack | FilePictures) -> LookSummary | None:
    """Look at the recording of a single fixed camera; return None for several cameras or too few pictures."""
    if len(fixed_cameras(capture)) != 1 or capture.n_timesteps < FEWEST:
        return None
    if (kept := look_of(run)) is None:
        kept = look_at_pictures(_pictures(capture, images), str(capture.root))
        if (video := video_file(capture.root)) is not None:
            lines = with_losses(kept, video.path, kept.rate, video.from_s, video.repeats)
            kept = replace(kept, lines=lines)
        kept = with_rows(kept, capture.rows_s)
        run.record("look", to_record(kept))
    return kept


def look_of(run: Run) -> LookSummary | None:
    """Return the look stored in the run's log."""
    values = run.log().get("look")
    return None if not values else from_record(values)


def _pictures(capture: Capture, images: ImageStack | FilePictures) -> Iterator[GreyPicture]:
    (frames,) = fixed_cameras(capture)[:1]
    kinds = picture_kinds(capture.root, len(frames.rows)) or [INTRA] * len(frames.rows)
    with progress("regions", len(frames.rows), "pictures") as update:
        for k, (row, time) in enumerate(zip(frames.rows, frames.times_s, strict=True)):
            grey = grey_over_white(images.stored(int(row)), images.maximum)
            yield GreyPicture(grey, float(time), kinds[k])
            update(k + 1)
