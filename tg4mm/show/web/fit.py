"""A scene made small enough for a page: what no camera saw is left out, then fine colours, then what counts least."""

from dataclasses import replace

import numpy as np
import torch

from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import AppearanceModes
from tg4mm.show.web.pack import MotionFields, Packed, pack

_SEEN = 0.25  # pixels of blending weight over all pictures: less is seen by no camera
_COARSEST = 1  # degree of the spherical harmonics: without it, colours would not change with the viewpoint
_MARGIN = 0.98  # of the bytes that are aimed at, as not all Gaussians compress alike


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
