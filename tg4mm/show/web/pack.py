"""The numbers of a page: the Gaussians, their motion and their light as one compressed block.

A block is a zlib stream of two tables, one after the other (docs/web.md):
    [4, N] float32            x, y, z in scene units, opacity
    [V, N] float16            what `PackLayout` lists
each with its bytes taken apart, all first bytes, then all second ones …: like bytes beside each other compress better.

What is too large for a page is reduced first: what no camera saw, then fine colours, then what counts least.
"""

import zlib
from dataclasses import asdict, dataclass, replace

import numpy as np
import torch

from tg4mm.core.errors import RunError
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import AppearanceModes, ModalMotion, fields_of

SH_STEP = 2.0**-9  # coefficients above degree 0 are rounded to this: half a step is a quarter of a grey level
MOST_FIELDS = 96  # of motion; WebGL 2 guarantees as many uniforms and texture layers
_HALF = 65504.0  # float16's largest number
_SEEN = 0.25  # pixels of blending weight over all pictures; less is invisible
_COARSEST = 1  # least degree of spherical harmonics, for colours that change with the viewpoint
_MARGIN = 0.98  # of the intended bytes, since compression differs between Gaussians
TOLERANCE = 1e-4  # of the motion's rms: weaker fields are left out


@dataclass(frozen=True)
class PackLayout:
    """The number of float16 values per Gaussian, in this order.

    3 logarithms of the scales; 4 of the quaternion, xyzw; 3 · `sh_count` of the spherical harmonics, 3 channels of one
    coefficient together; 6 · `n_fields` of the motion, over the fields' sizes; 3 · `light_count` · `n_lights` of the
    changes of light, over their sizes.
    """

    n_gaussians: int
    sh_count: int
    n_fields: int = 0
    n_lights: int = 0
    light_count: int = 0

    @property
    def n_values(self) -> int:
        """V."""
        return 7 + 3 * self.sh_count + 6 * self.n_fields + 3 * self.light_count * self.n_lights

    def as_json(self) -> dict[str, int]:
        return asdict(self)


@dataclass(frozen=True)
class Packed:
    """A block, its layout, and the factors of its light."""

    block: bytes
    layout: PackLayout
    light_sizes: np.ndarray  # [R] largest coefficient of each change of light


def pack(gaussians: Gaussians, motion: "MotionFields", light: AppearanceModes | None = None) -> Packed:
    """The block of a scene.

    Positions and opacities are kept as float32. float16 keeps 11 bits: scales to 0.4 % (e⁻⁸ … e⁸), quaternions to
    5e-4, colours of degree 0 to 5e-4 of themselves, motion to 5e-4 of itself where it is above 1e-4 of the field's
    largest, else to 6e-8 of that; further spherical harmonics to SH_STEP / 2. RunError for a colour past float16, and
    for a motion of more than MOST_FIELDS fields.
    """
    means, quats, scales, opacities, sh = (
        tensor.detach().cpu().numpy().astype(np.float32)
        for tensor in (gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh)
    )
    n = len(means)
    sh[:, 1:] = np.round(sh[:, 1:] / SH_STEP) * SH_STEP
    if np.abs(sh).max(initial=0) > _HALF:
        raise RunError(f"a coefficient of colour is {np.abs(sh).max():g}; a page holds up to {_HALF:g}")
    if len(motion.fields) > MOST_FIELDS:
        raise RunError(
            f"the motion has {len(motion.fields)} independent fields; a page holds up to {MOST_FIELDS}"
        )
    changes, sizes = _light(light, n)
    layout = PackLayout(n, sh.shape[1], len(motion.fields), len(sizes), changes.shape[2])
    wxyz = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    columns = [
        np.log(np.maximum(scales, 1e-12)),
        wxyz[:, [1, 2, 3, 0]],
        sh.reshape(n, -1),
        motion.fields.transpose(1, 0, 2).reshape(n, -1),
        changes.transpose(1, 0, 2, 3).reshape(n, -1),
    ]
    values = np.concatenate(columns, axis=1).astype("<f2")
    exact = np.concatenate([means, opacities[:, None]], axis=1).astype("<f4")
    return Packed(_compressed(_apart(exact) + _apart(values)), layout, sizes)


def unpack(block: bytes, layout: PackLayout) -> tuple[np.ndarray, np.ndarray]:
    """Return [N, 4] float32 and [N, V] float16 of a block, as the page's program reads them."""
    data = zlib.decompress(block)
    n, first = layout.n_gaussians, 16 * layout.n_gaussians
    exact = np.frombuffer(data[:first], np.uint8).reshape(4, 4 * n).T.copy().view("<f4")
    values = np.frombuffer(data[first:], np.uint8).reshape(2, layout.n_values * n).T.copy().view("<f2")
    return exact.reshape(4, n).T, values.reshape(layout.n_values, n).T


def _apart(table: np.ndarray) -> bytes:
    """Return the bytes of [N, V] values, column after column, all first bytes before all second ones."""
    flat = np.ascontiguousarray(table.T)
    return flat.view(np.uint8).reshape(-1, flat.itemsize).T.tobytes()


def _compressed(data: bytes) -> bytes:
    """Return a zlib stream. Only runs of zeros repeat here; a search for others costs time and saves nothing."""
    compressor = zlib.compressobj(9, strategy=zlib.Z_RLE)
    return compressor.compress(data) + compressor.flush()


def _light(light: AppearanceModes | None, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return changes of light [R, N, K, 3] over their sizes, and the sizes [R]."""
    if light is None or not len(light.shapes):
        return np.zeros((0, n, 0, 3), np.float32), np.zeros(0)
    sizes = np.abs(light.shapes).max(axis=(1, 2, 3)).astype(np.float64)
    unit = np.where(sizes > 0, sizes, 1).astype(np.float32)
    return light.shapes / unit[:, None, None, None], sizes


@dataclass(frozen=True)
class MotionFields:
    """m_k = Σ_r series[k, r] fields[r], real fields: the phasors of K modes by R ≤ 2K fields.

    At a time and magnification the motion is Σ_r c_r fields[r], c_r = Σ_k Re[series[k, r] g_k] with the modes' gains
    g_k. Each field's displacement and rotation have a largest size of 1 once divided by `sizes[r]`.
    """

    fields: (
        np.ndarray
    )  # [R, N, 6] float32: displacement in scene units, rotation vector in radians; over `sizes`
    sizes: np.ndarray  # [R, 2] float64: scene units, radians; 0 where a field does not move or not turn
    series: np.ndarray  # [K, R] complex128


def motion_fields(motion: ModalMotion, tolerance: float = TOLERANCE) -> MotionFields:
    """Return the motion's strongest fields; each omitted one has at most `tolerance` times the motion's rms.

    A motion that a fit found to have few components comes back with as many fields, whatever the number of its modes;
    parts that do not move are no field (`fields_of`).
    """
    fields, series = fields_of(motion, tolerance)
    sizes = np.abs(fields.reshape(len(fields), fields.shape[1], 2, 3)).max(axis=(1, 3), initial=0)
    unit = np.where(sizes > 0, sizes, 1).repeat(3, axis=1)
    return MotionFields(fields / unit[:, None], sizes.astype(np.float64), series)


def packed_within(
    gaussians: Gaussians,
    fields: MotionFields,
    light: AppearanceModes | None,
    weights: np.ndarray,
    most_bytes: int,
) -> Packed:
    """Return the scene in a block of at most `most_bytes`.

    weights [N]: blending weights summed over the training pictures, pixels. Where the whole scene does not fit, what
    is not seen is left out; where that is too much still, the degree of the colours falls to 1; then the Gaussians
    with the least weight are left out until it fits.
    """
    found = pack(gaussians, fields, light)
    if len(found.block) <= most_bytes:
        return found
    kept = np.flatnonzero(weights > _SEEN)
    for degree in range(gaussians.sh_degree, min(_COARSEST, gaussians.sh_degree) - 1, -1):
        found = _pack_some(gaussians, fields, light, kept, degree)
        if len(found.block) <= most_bytes:
            return found
    by_weight = kept[np.argsort(-weights[kept], kind="stable")]
    while len(found.block) > most_bytes and len(by_weight) > 1:
        share = _MARGIN * most_bytes / len(found.block)
        by_weight = by_weight[: max(1, int(share * len(by_weight)))]
        found = _pack_some(gaussians, fields, light, np.sort(by_weight), degree)
    return found


def _pack_some(
    gaussians: Gaussians, fields: MotionFields, light: AppearanceModes | None, rows: np.ndarray, degree: int
) -> Packed:
    which = torch.from_numpy(rows)
    some = Gaussians(
        means=gaussians.means[which],
        quats=gaussians.quats[which],
        scales=gaussians.scales[which],
        opacities=gaussians.opacities[which],
        sh=gaussians.sh[which][:, : (degree + 1) ** 2],
    )
    own = None if light is None else replace(light, shapes=light.shapes[:, rows])
    return pack(some, replace(fields, fields=fields.fields[:, rows]), own)
