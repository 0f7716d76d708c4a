"""A run as files of formats that other tools read (docs/export.md): glTF, SPZ, USD.

`low_pass` in all of them: scales hold the rasteriser's low-pass (`lowpass.py`), else they are as trained.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.progress import progress
from tg4mm.core.splatfile.spz import write_spz
from tg4mm.run import Run
from tg4mm.show.export.gltf import write_glb
from tg4mm.show.export.splat import check_file, check_folder, frames_of, splat_of, unit_scale_of, write_frames
from tg4mm.show.export.usd import SUFFIXES, usd_modules, write_usd

if TYPE_CHECKING:
    from tg4mm.core.magnification import Magnification
    from tg4mm.show.render.sequence import RenderRequest

_LOG = logging.getLogger("tg4mm")
_USD_MAGIC = {".usda": b"#usda", ".usdc": b"PXR-USDC", ".usd": b"PXR-USDC"}


def export_gltf(run: Run, out: Path, plan: Magnification, low_pass: bool = True) -> Path:
    """Write one .glb: the scene at rest and its motion, magnified as planned, as an animation.

    Raises Tg4mmError for an `out` that cannot be one, a plan that names a method, and a magnification of a run
    without motion.
    """
    check_file(out, ".glb", b"glTF")
    splat = splat_of(run, low_pass)
    if not splat.n_modes and not plan.is_identity:
        raise Tg4mmError(f"{run.path} has no motion: only --alpha 0 can be exported")
    alphas = plan.checked(splat.fps).ideal(splat.freqs_hz) if splat.n_modes else np.zeros(0)
    alphas[splat.freqs_hz == 0] = 0  # offset of a paper run's mean, which is not magnified
    out.parent.mkdir(parents=True, exist_ok=True)
    with progress("writing", 1, "file", brief=True):
        write_glb(out, splat, alphas)
    warn_of_scale(run)
    return out


def export_spz(run: Run, out: Path, low_pass: bool = True, linear: bool = False) -> Path:
    """Write one .spz, the scene at rest. Raises Tg4mmError for an `out` that cannot be one."""
    check_file(out, ".spz", b"\x1f\x8b")
    splat = splat_of(run, low_pass, linear)
    out.parent.mkdir(parents=True, exist_ok=True)
    with progress("writing", 1, "file", brief=True):
        write_spz(out, splat)
    return out


def export_spz_sequence(
    run: Run, out: Path, request: RenderRequest, timesteps: Sequence[int] | None = None, low_pass: bool = True
) -> int:
    """Write OUT/frame_0000.spz …, a file for every timestep asked for, else for one period of the motion; their number.

    Raises Tg4mmError for an `out` that is a file, a timestep that does not exist, and what rendering the request would.
    """
    check_folder(out, ".spz")
    wanted = one_period(run) if timesteps is None else timesteps
    write_frames(out, ".spz", write_spz, frames_of(run, request, wanted, low_pass))
    return len(wanted)


def warn_of_scale(run: Run) -> None:
    """Warn that lengths are a guess in a format with a fixed unit, if the run's scale is unknown."""
    if unit_scale_of(run) is None:
        _LOG.warning("the scale is not known: one scene unit is written as one metre")


def one_period(run: Run) -> range:
    """Return the timesteps of one period of the run's strongest vibration, rounded up, at most all."""
    motion = run.load_motion()
    if motion is None:
        return range(1)
    power = motion.powers() * motion.is_magnified()
    if not power.any():
        return range(1)
    hz = float(motion.freqs_hz[int(power.argmax())])
    return range(min(motion.n_timesteps, math.ceil(motion.fps / hz - 1e-6)))


def export_usd(
    run: Run, out: Path, request: RenderRequest, timesteps: Sequence[int] | None = None, low_pass: bool = True
) -> Path:
    """Write one USD stage with a sample at every timestep (default: all).

    Raises Tg4mmError for an `out` that cannot be one, a timestep that does not exist, an OpenUSD without the schema,
    and what rendering the request would.
    """
    suffix = out.suffix.lower() if out.suffix.lower() in SUFFIXES else SUFFIXES[0]
    check_file(out, suffix, _USD_MAGIC[suffix])
    usd_modules()
    frames = frames_of(run, request, None if timesteps is None else sorted(set(timesteps)), low_pass)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_usd(out, frames, frames.fps)
    warn_of_scale(run)
    return out
