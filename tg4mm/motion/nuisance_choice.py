"""Which nuisance columns a capture of fixed cameras needs: found from its pictures, unless they were named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tg4mm.gaussians import Gaussians
from tg4mm.motion.config import MotionConfig
from tg4mm.motion.jacobian.view import ViewJacobian
from tg4mm.motion.nuisance import EXPOSURE, EXPOSURE_SHARE, POSE, Nuisance, exposure, nuisances_of
from tg4mm.motion.observations import Observations
from tg4mm.motion.temporal import FirstLook, first_look


@dataclass(frozen=True)
class Seen:
    """One pass through the pictures, and the nuisance columns that were chosen from it."""

    look: FirstLook
    nuisances: list[Nuisance]
    figures: dict[str, Any]
    notes: list[str]


def look_at(
    observations: Observations, views: Sequence[ViewJacobian], gaussians: Gaussians, config: MotionConfig
) -> Seen:
    """Read all pictures once; exposure and shake of the cameras as the settings say, or as the pictures show.

    Pictures with a background are a real camera's: their exposure is always taken out, and a shake is looked for. Of a
    cut-out object no part is known to stand still, and its exposure is taken out where it shows.
    """
    looks = config.nuisance == "auto" and observations.is_opaque
    possible = np.zeros(12, bool)
    possible[EXPOSURE] = config.nuisance != "none"
    possible[POSE] = looks or config.nuisance == "all"
    nuisances = nuisances_of(views, observations.frames, gaussians.means.numpy(), possible)
    look = first_look(observations, nuisances, looks)
    gain, offset, share = exposure(nuisances, list(look.mean), look.columns, look.grams)
    pixels, is_shaking = look.shake
    active = possible.copy()
    if config.nuisance == "auto":
        active[EXPOSURE] = observations.is_opaque or share > EXPOSURE_SHARE
        active[POSE] = is_shaking and not _may_drift(observations)
    figures = {
        "exposure_gain_percent": round(gain, 4),
        "exposure_offset_percent": round(offset, 4),
        "exposure_share": round(share, 6),
        "nuisance": [n for n, s in (("exposure", EXPOSURE), ("pose", POSE)) if active[s].any()],
    }
    if looks:
        figures["shake_px"] = round(pixels, 4)
    return Seen(
        look, [n.with_active(active) for n in nuisances], figures, _notes(observations, active, pixels)
    )


def _may_drift(observations: Observations) -> bool:
    """Whether a shift of whole pictures may be the scene's: several synchronous cameras tell its motion as one."""
    return observations.clock == "synchronous" and len(observations.frames) > 1


def _notes(observations: Observations, active: np.ndarray, pixels: float) -> list[str]:
    if not active[POSE].any():
        return []
    shake = (
        f"the camera shakes by {pixels:.2g} px (rms), which is taken out"
        if pixels
        else "camera shake is taken out"
    )
    if len(observations.frames) == 1:
        shake += "; a motion of the whole picture as one cannot be told from it"
    return [shake]
