"""Exports a run as one splat file with its motion, or numbered static ones."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture import load_capture
from tg4mm.core.errors import RunError, Tg4mmError
from tg4mm.core.progress import progress
from tg4mm.core.splatfile import SplatFile, write_splat
from tg4mm.core.work_folder import WorkFolder
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.animate import animate
from tg4mm.fit.motion.mode_selection import worth_keeping
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.run import Run
from tg4mm.show.export.linear import fitted_to_linear
from tg4mm.show.export.lowpass import BAKED_PX2, smoothing_of, widened
from tg4mm.show.render.sequence import RenderRequest, pose_of, record
from tg4mm.show.result.model import mode_deviations

RECORD = "export.json"  # request, in the folder of a sequence
_LOG = logging.getLogger("tg4mm")


def to_splat(
    gaussians: Gaussians,
    motion: ModalMotion | None,
    unit_scale_m: float | None = None,
    deviation: np.ndarray | None = None,
    smoothing: np.ndarray | None = None,
) -> SplatFile:
    """Return the Gaussians and their motion as a splat file (docs/conventions.md, "Splat file").

    Args:
        gaussians: at rest.
        motion: of these Gaussians; `None`: a static file.
        unit_scale_m: metres per scene unit; `None` if unknown.
        deviation: [K, N] standard deviation of each mode's amplitude, scene units; `None`: not known.
        smoothing: [N] variance to add to the scales, scene units² (`lowpass.py`), which the file records; `None`: none.

    Returns:
        What `write_splat` writes.

    Raises:
        SplatFileError: a value that such a file cannot hold.
        RunError: the motion is of another number of Gaussians.
    """
    means, quats, scales, opacities, sh = (
        tensor.detach().cpu().numpy().astype(np.float32)
        for tensor in (gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh)
    )
    baked = None
    if smoothing is not None:
        scales, baked = widened(scales, smoothing).astype(np.float32), BAKED_PX2
    if motion is None:
        still = SplatFile.static(means, quats, scales, opacities, sh, unit_scale_m)
        return replace(still, low_pass_px2=baked)
    if motion.n_gaussians != len(means):
        raise RunError(f"the motion is of {motion.n_gaussians} Gaussians, the scene has {len(means)}")
    return SplatFile(
        means=means,
        quats=quats,
        scales=scales,
        opacities=opacities,
        sh=sh,
        freqs_hz=np.asarray(motion.freqs_hz, np.float64),
        displacement=motion.displacement,
        rotation=motion.rotation,
        fps=float(motion.fps),
        n_timesteps=int(motion.n_timesteps),
        unit_scale_m=unit_scale_m,
        deviation=deviation,
        low_pass_px2=baked,
    )


def unit_scale_of(run: Run) -> float | None:
    """Return metres per scene unit of the run's dataset; None if unknown or the dataset is gone."""
    if not run.dataset.is_dir():
        return None
    return load_capture(run.dataset).unit_scale_m


def export_ply(run: Run, out: Path, low_pass: bool = True, linear: bool = False) -> Path:
    """Write the run as one splat file that any viewer opens at rest, and ours plays: `splat_of` says what it holds.

    Raises Tg4mmError for an `out` that is a folder, a file of another kind or named like one, RunError for a run
    without a space stage.
    """
    check_file(out, ".ply", b"ply")
    splat = splat_of(run, low_pass, linear)
    out.parent.mkdir(parents=True, exist_ok=True)
    with progress("writing", 1, "file", brief=True):
        write_splat(out, splat)
    return out


def check_file(out: Path, suffix: str, magic: bytes) -> None:
    """Raises Tg4mmError for an `out` that is a folder, named like another kind of file, or holds one.

    `magic`: the first bytes of a file that may be replaced.
    """
    kind = suffix[1:].upper()
    if out.is_dir():
        raise Tg4mmError(f"--out {out}: is a folder; expected a file such as {out / f'splat{suffix}'}")
    if out.exists() and not _begins(out, magic):
        raise Tg4mmError(f"--out {out}: exists, and is no {kind} file; choose another name")
    if out.suffix.lower() != suffix:
        named = f"{out.with_suffix(suffix)}" if out.suffix else f"{out}{suffix}, or {out / f'splat{suffix}'}"
        raise Tg4mmError(
            f"--out {out}: the format is a {kind} file; expected a name that ends in {suffix}, such as {named}"
        )


def splat_of(run: Run, low_pass: bool = True, linear: bool = False) -> SplatFile:
    """The run as one splat with its motion.

    Of a `paper` run it holds timestep 0 and, as phasors of all DFT bins (0 Hz for the mean offset from it), every
    timestep's position and rotation. Modes that hold nothing but noise are left out (`mode_selection.py`); the standard
    deviation of the others rides along where the run says it. Scales hold the low-pass (`lowpass.py`), or without
    `low_pass` are as trained; with `linear` they, opacities and colours are fitted (`linear.py`). Lost is what the
    decoder changes in scale, opacity and colour over time, and of a `modal` run the light that changes. Raises RunError
    for a run without a space stage, and with `linear` for one without its dataset.
    """
    gaussians, motion = run.load_space(), run.load_motion()
    if motion is not None and run.preset == "modal":
        gaussians, motion = _from_its_zero(gaussians, motion)
    deviation = None
    if motion is not None:
        motion, deviation = _above_noise(motion, run)
    if linear:
        if not run.dataset.is_dir():
            raise RunError(
                f"{run.dataset}, the dataset, is gone: --low-pass linear fits to its cameras; use baked"
            )
        gaussians = fitted_to_linear(gaussians, load_capture(run.dataset))
        splat = to_splat(gaussians, motion, unit_scale_of(run), deviation)
        return replace(splat, low_pass_px2=BAKED_PX2, linear=True)
    return to_splat(gaussians, motion, unit_scale_of(run), deviation, smoothing_of(run) if low_pass else None)


def _from_its_zero(gaussians: Gaussians, motion: ModalMotion) -> tuple[Gaussians, ModalMotion]:
    """Return the Gaussians at the motion's zero and the motion from there, without a mode of 0 Hz."""
    still = motion.freqs_hz == 0
    if not still.any():
        return gaussians, motion
    motion = replace(motion, appearance=None)  # not in a splat file
    return animate(gaussians, motion.selected(still), 0.0), motion.selected(~still)


def _above_noise(motion: ModalMotion, run: Run) -> tuple[ModalMotion, np.ndarray | None]:
    """Return the modes above noise, and the standard deviations [K, N] of their amplitudes if known."""
    in_all, noise = run.load_uncertainty(), run.load_noise()
    keep = worth_keeping(motion, noise)
    deviation = None if in_all is None or noise is None else mode_deviations(motion, in_all, noise)[keep]
    return motion.selected(keep), deviation


def _begins(path: Path, magic: bytes) -> bool:
    with path.open("rb") as file:
        return file.read(len(magic)) == magic


def export_ply_sequence(
    run: Run, out: Path, request: RenderRequest, timesteps: Sequence[int] | None = None, low_pass: bool = True
) -> Path:
    """Write OUT/frame_0000.ply …, a static splat file for every timestep asked for (default: all).

    Raises Tg4mmError for an `out` that is a file, a timestep that does not exist, and what rendering the request would.
    """
    check_folder(out, ".ply")
    write_frames(out, ".ply", write_splat, frames_of(run, request, timesteps, low_pass))
    return out


def check_folder(out: Path, suffix: str) -> None:
    """Raise Tg4mmError for an `out` that cannot be a folder of numbered files."""
    if out.exists() and not out.is_dir():
        raise Tg4mmError(f"--out {out}: is a file; expected a folder for numbered files")
    if out.suffix.lower() == suffix:
        raise Tg4mmError(
            f"--out {out}: a sequence is a folder of numbered files; expected a name such as {out.stem}"
        )


@dataclass(frozen=True)
class Frames:
    """The magnified scene at chosen timesteps, made on demand."""

    timesteps: tuple[int, ...]
    fps: float  # Hz
    at: Callable[[int], SplatFile]  # timestep
    request: Mapping[str, Any]  # everything that determines them, in JSON's types

    def __iter__(self) -> Iterator[tuple[int, SplatFile]]:
        """Yield (timestep, Gaussians) in order, with a line of progress."""
        return self._made(self.timesteps)

    def missing(self, out: Path, suffix: str) -> Iterator[tuple[int, SplatFile]]:
        """Return the timesteps without a file in OUT."""
        return self._made([t for t in self.timesteps if not (out / f"frame_{t:04d}{suffix}").exists()])

    def _made(self, timesteps: Sequence[int]) -> Iterator[tuple[int, SplatFile]]:
        done = len(self.timesteps) - len(timesteps)
        with progress("export", len(self.timesteps), unit="timesteps", start=done) as update:
            for i, t in enumerate(timesteps, done):
                yield t, self.at(t)
                update(i + 1)


def frames_of(
    run: Run, request: RenderRequest, timesteps: Sequence[int] | None = None, low_pass: bool = True
) -> Frames:
    """Return the run at `timesteps` (default: all), magnified as requested, with the scales of `splat_of`.

    Raises Tg4mmError for a timestep that does not exist, and what rendering this request would.
    """
    pose, n_timesteps, fps = pose_of(run, request)
    wanted = tuple(range(n_timesteps) if timesteps is None else timesteps)
    for t in wanted:
        if not 0 <= t < n_timesteps:
            raise Tg4mmError(f"timestep {t} is outside 0 … {n_timesteps - 1}")
    scale, smoothing = unit_scale_of(run), smoothing_of(run) if low_pass else None
    request_record = {**record(run, request, (), "splats"), "low_pass": low_pass}
    return Frames(
        wanted, fps, lambda t: to_splat(pose(float(t)), None, scale, smoothing=smoothing), request_record
    )


def write_frames(out: Path, suffix: str, write: Callable[[Path, SplatFile], None], frames: Frames) -> None:
    """Write OUT/frame_0000<suffix> …, one static file for each timestep; those that a killed call finished are kept.

    Raises RunError where the folder holds another sequence, or another process writes one there.
    """
    others = {"timesteps": "of other timesteps", "model": "of another model"}
    folder = WorkFolder(out, RECORD, foreign_files="frame_*", others=others)
    with folder.locked("writes a sequence there"):
        folder.claim({**frames.request, "suffix": suffix, "timesteps": list(frames.timesteps)})
        for t, splat in frames.missing(out, suffix):
            write(out / f"frame_{t:04d}{suffix}", splat)
