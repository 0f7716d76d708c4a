"""Writing a splat file."""

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tg4mm.core.splatfile import model

from .. import temporary
from ..errors import SplatFileError, system_says
from .model import SplatFile

ROWS_AT_ONCE = 8192  # keeps the block being interleaved in the processor's cache


def write_splat(path: str | Path, splat: SplatFile) -> None:
    """Write a binary 3DGS PLY with the modes as further properties. Needs numpy alone.

    All values are float32: means, quats, sh and phasors that are float32 come back exactly, scales to 1e-5 of their
    size (log), opacities to 1e-7 (logit). Scales under 1e-12 are written as that, opacities of 0 and 1 as 2⁻²⁴ and
    1 − 2⁻²⁴.

    Args:
        path: replaced in one step, so that a kill leaves the old file whole.
        splat: what to write.

    Raises:
        SplatFileError: the file cannot be written.
    """
    with replacing(Path(path)) as name, name.open("wb") as file:
        file.write(_header(splat))
        for block in _blocks(splat):
            file.write(block.tobytes())


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Like `temporary.replacing`, but raise SplatFileError naming the file for errors of system or writer."""
    try:
        with temporary.replacing(path, path.suffix) as name:
            yield name
    except OSError as error:
        raise SplatFileError(f"{path}: cannot be written: {system_says(error)}") from error
    except SplatFileError as error:
        raise SplatFileError(f"{path}: {error}") from error


def _names(splat: SplatFile) -> list[str]:
    rest = model.f_rest(3 * (splat.sh.shape[1] - 1))
    modes = [name for k in range(splat.n_modes) for name in model.mode(k)]
    if splat.deviation is not None:
        modes += [model.deviation(k) for k in range(splat.n_modes)]
    fixed = (model.POSITION, model.NORMAL, model.F_DC, rest, model.OPACITY, model.SCALE, model.ROTATION)
    return [name for names in fixed for name in names] + modes


def _header(splat: SplatFile) -> bytes:
    about = {
        "format_version": model.FORMAT_VERSION,
        "fps": splat.fps or None,
        "n_timesteps": int(splat.n_timesteps),
        "frequencies_hz": [float(f) for f in splat.freqs_hz],
        "unit_scale_m": splat.unit_scale_m,
        "time_origin_s": splat.time_origin_s,
    }
    if splat.low_pass_px2 is not None:
        about["low_pass_px2"] = splat.low_pass_px2
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        model.MARK + json.dumps(about, allow_nan=False),
        f"element vertex {len(splat)}",
        *(f"property float {name}" for name in _names(splat)),
        "end_header",
    ]
    return ("\n".join(lines) + "\n").encode("ascii")


def _blocks(splat: SplatFile) -> Iterator[np.ndarray]:
    """The vertices as [rows, properties] float32, a block of rows at a time."""
    n, k = splat.sh.shape[:2]
    for start in range(0, n, ROWS_AT_ONCE):
        rows = slice(start, start + ROWS_AT_ONCE)
        means = splat.means[rows]
        parts = [
            means,
            np.zeros_like(means),
            splat.sh[rows, 0],
            splat.sh[rows, 1:].transpose(0, 2, 1).reshape(len(means), 3 * (k - 1)),
            model.logit(splat.opacities[rows])[:, None],
            model.log_scale(splat.scales[rows]),
            splat.quats[rows],
        ]
        for displacement, rotation in zip(splat.displacement, splat.rotation, strict=True):
            for phasor in (displacement[rows], rotation[rows]):
                parts += [phasor.real, phasor.imag]
        if splat.deviation is not None:
            parts.append(splat.deviation[:, rows].T)
        with np.errstate(over="ignore"):
            block = np.concatenate(parts, axis=1).astype("<f4")
        if not np.isfinite(block).all():
            size = max(np.abs(part).max(initial=0) for part in parts)
            raise SplatFileError(f"a value of size {size:g} is past float32's range, 3.4e38")
        yield block
