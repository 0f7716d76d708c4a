"""A run as files for other programs: one splat file with its motion, or numbered static ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tg4mm.capture import load_capture
from tg4mm.errors import RunError, Tg4mmError
from tg4mm.gaussians import Gaussians
from tg4mm.motion.animate import animate
from tg4mm.motion.mode_selection import mode_deviations, worth_keeping
from tg4mm.motion.modes import ModalMotion
from tg4mm.progress import progress
from tg4mm.runs import Run
from tg4mm.splatfile import SplatFile, write_splat

if TYPE_CHECKING:
    from tg4mm.render.sequence import RenderRequest


def to_splat(
    gaussians: Gaussians,
    motion: ModalMotion | None,
    unit_scale_m: float | None = None,
    deviation: np.ndarray | None = None,
) -> SplatFile:
    """The Gaussians, and their motion if any, as a splat file holds them (docs/conventions.md, "Splat file").

    deviation [K, N]: standard deviation of each mode's amplitude, scene units.
    Raises SplatFileError for values that such a file cannot hold, RunError where the two do not fit.
    """
    means, quats, scales, opacities, sh = (
        tensor.detach().cpu().numpy().astype(np.float32)
        for tensor in (gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh)
    )
    if motion is None:
        return SplatFile.static(means, quats, scales, opacities, sh, unit_scale_m)
    if motion.displacement.shape[1] != len(means):
        raise RunError(
            f"the motion is of {motion.displacement.shape[1]} Gaussians, the scene has {len(means)}"
        )
    return SplatFile(
        means=means,
        quats=quats,
        scales=scales,
        opacities=opacities,
        sh=sh,
        freqs_hz=np.asarray(motion.freqs_hz, np.float64),
        displacement=np.asarray(motion.displacement, np.complex64),
        rotation=np.asarray(motion.rotation, np.complex64),
        fps=float(motion.fps),
        n_timesteps=int(motion.n_timesteps),
        unit_scale_m=unit_scale_m,
        deviation=deviation,
    )


def unit_scale_of(run: Run) -> float | None:
    """Metres per scene unit of the run's dataset; None if unknown or the dataset is gone."""
    if not run.dataset.is_dir():
        return None
    return load_capture(run.dataset).unit_scale_m


def export_ply(run: Run, out: Path) -> Path:
    """Write the run as one splat file that any viewer opens at rest, and ours plays.

    Of a `paper` run it holds timestep 0 and, as phasors of all DFT bins (0 Hz for the mean offset from it), every
    timestep's position and rotation. Modes that hold nothing but noise are left out (`mode_selection.py`); the standard
    deviation of the others rides along where the run says it. Lost is what the decoder changes in scale, opacity and
    colour over time, and of a `modal` run the light that changes.
    Raises Tg4mmError for an `out` that is a folder, a file of another kind or named like one, RunError for a run
    without a space stage.
    """
    if out.is_dir():
        raise Tg4mmError(f"--out {out}: is a folder; expected a file such as {out / 'splat.ply'}")
    if out.exists() and not _is_ply(out):
        raise Tg4mmError(f"--out {out}: exists, and is no PLY file; choose another name")
    if out.suffix.lower() != ".ply":
        named = f"{out.with_suffix('.ply')}" if out.suffix else f"{out}.ply, or {out / 'splat.ply'}"
        raise Tg4mmError(
            f"--out {out}: --format ply writes a PLY; expected a name that ends in .ply, such as {named}"
        )
    gaussians, motion = run.load_space(), run.load_motion()
    if motion is not None and run.preset == "modal":
        gaussians, motion = _from_its_zero(gaussians, motion)
    deviation = None
    if motion is not None:
        motion, deviation = _told(motion, run)
    splat = to_splat(gaussians, motion, unit_scale_of(run), deviation)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_splat(out, splat)
    return out


def _from_its_zero(gaussians: Gaussians, motion: ModalMotion) -> tuple[Gaussians, ModalMotion]:
    """The Gaussians at the motion's own zero and the motion from there, without a mode of 0 Hz: nothing to magnify."""
    still = motion.freqs_hz == 0
    if not still.any():
        return gaussians, motion
    motion = replace(motion, appearance=None)  # of which a splat file holds nothing
    return animate(gaussians, motion.selected(still), 0.0), motion.selected(~still)


def _told(motion: ModalMotion, run: Run) -> tuple[ModalMotion, np.ndarray | None]:
    """The modes that hold more than noise, and the standard deviations [K, N] of their amplitudes if the run says."""
    in_all, noise = run.load_uncertainty(), run.load_noise()
    keep = worth_keeping(motion, noise)
    deviation = None if in_all is None or noise is None else mode_deviations(motion, in_all, noise)[keep]
    return motion.selected(keep), deviation


def _is_ply(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(3) == b"ply"


def export_ply_sequence(
    run: Run,
    out: Path,
    alpha: float = 0.0,
    band: tuple[float, float] | None = None,
    timesteps: Sequence[int] | None = None,
    request: RenderRequest | None = None,
) -> Path:
    """Write OUT/frame_0000.ply …, one static splat file per timestep with the motion magnified by `alpha`.

    `request`: alpha and band, or several bands, with a method, in place of `alpha` and `band`.
    Raises Tg4mmError for an `out` that is a file or a timestep that does not exist, and what rendering with
    this alpha and band would.
    """
    from tg4mm.render.sequence import RenderRequest, pose_of

    request = request or RenderRequest(alpha=alpha, band=band)
    if out.exists() and not out.is_dir():
        raise Tg4mmError(f"--out {out}: is a file; expected a folder for numbered files")
    if out.suffix.lower() == ".ply":
        raise Tg4mmError(
            f"--out {out}: a sequence is a folder of numbered files; expected a name such as {out.stem}"
        )
    pose, n_timesteps, _ = pose_of(run, request)
    wanted = range(n_timesteps) if timesteps is None else timesteps
    for t in wanted:
        if not 0 <= t < n_timesteps:
            raise Tg4mmError(f"timestep {t} is outside 0 … {n_timesteps - 1}")
    scale = unit_scale_of(run)
    out.mkdir(parents=True, exist_ok=True)
    with progress("export", len(wanted), unit="files") as update:
        for i, t in enumerate(wanted):
            write_splat(out / f"frame_{t:04d}.ply", to_splat(pose(float(t)), None, scale))
            update(i + 1)
    return out
