"""Which nuisance columns a capture of fixed cameras needs: found from its pictures, unless they were named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tg4mm.gaussians import Gaussians
from tg4mm.motion.config import MotionConfig
from tg4mm.motion.jacobian.view import ViewJacobian
from tg4mm.motion.nuisance import (
    EXPOSURE,
    EXPOSURE_SHARE,
    POSE,
    ROTATION,
    Nuisance,
    exposure,
    nuisances_of,
)
from tg4mm.motion.observations import Observations
from tg4mm.motion.shake import LEAST_PX, own_turns
from tg4mm.motion.temporal import FirstLook, first_look

# Of what moves pictures of several cameras as wholes. Still cameras: .05 to .20 in three scenes, since a motion that
# bends things is no rigid one. Thirty cameras that shake by twice the motion: .95, six .7, three .44. Two: .1, of six
# numbers that two cameras' turns have, six of the common motion explain nearly all.
_OWN_SHARE = 0.35


@dataclass(frozen=True)
class Seen:
    """One pass through the pictures, and the nuisance columns that were chosen from it."""

    look: FirstLook
    nuisances: list[Nuisance]
    figures: dict[str, Any]
    notes: list[str]
    is_shaking: bool


def look_at(
    observations: Observations, views: Sequence[ViewJacobian], gaussians: Gaussians, config: MotionConfig
) -> Seen:
    """Read all pictures once; exposure and shake of the cameras as the settings say, or as the pictures show.

    Pictures with a background are a real camera's: their exposure is always taken out, and a shake is looked for. Of a
    cut-out object no part is known to stand still: its exposure is taken out where it shows, and a shake is looked for
    only where several synchronous cameras can disagree.
    """
    several = _are_several(observations)
    looks = config.nuisance in ("auto", "all") and (observations.is_opaque or several)
    possible = np.zeros(12, bool)
    possible[EXPOSURE] = config.nuisance != "none"
    possible[POSE] = looks or config.nuisance == "all"
    nuisances = nuisances_of(views, observations.frames, gaussians.means.numpy(), possible)
    look = first_look(observations, nuisances, looks and observations.is_opaque)
    gain, offset, share = exposure(nuisances, list(look.mean), look.columns, look.grams)
    figures: dict[str, Any] = {
        "exposure_gain_percent": round(gain, 4),
        "exposure_offset_percent": round(offset, 4),
        "exposure_share": round(share, 6),
    }
    pixels, is_shaking = look.shake
    if looks and several:
        pixels, own = _own_shake(observations, look)
        is_shaking = pixels > LEAST_PX and own > _OWN_SHARE and (is_shaking or not observations.is_opaque)
        figures["shake_own_share"] = round(own, 4)
    active = possible.copy()
    if config.nuisance == "auto":
        active[EXPOSURE] = observations.is_opaque or share > EXPOSURE_SHARE
        # six columns of every camera would hold every rigid motion of the scene
        active[POSE] = False
        active[ROTATION if several else POSE] = is_shaking
    if looks:
        figures["shake_px"] = round(pixels, 4)
    figures["nuisance"] = [n for n, s in (("exposure", EXPOSURE), ("pose", POSE)) if active[s].any()]
    chosen = [n.with_active(active) for n in nuisances]
    return Seen(
        look, chosen, figures, _notes(observations, active, pixels if is_shaking else 0.0), is_shaking
    )


def look_again(
    observations: Observations,
    views: Sequence[ViewJacobian],
    gaussians: Gaussians,
    seen: Seen,
    shake_px: float,
) -> Seen:
    """What `seen` chose, with a pass through registered pictures, which a shake of `shake_px` was taken out of."""
    active = seen.nuisances[0].active
    nuisances = nuisances_of(views, observations.frames, gaussians.means.numpy(), active)
    look = first_look(observations, nuisances)
    figures = seen.figures | {"shake_px": round(shake_px, 4)}
    return Seen(look, nuisances, figures, _notes(observations, active, shake_px), True)


def _are_several(observations: Observations) -> bool:
    """Whether several cameras film at the same times, so that the scene's motion is one to all of them."""
    return observations.clock == "synchronous" and len(observations.frames) > 1


def _own_shake(observations: Observations, look: FirstLook) -> tuple[float, float]:
    width, height = observations.size
    energy = float(sum(np.trace(g) for g in look.grams))
    return own_turns(observations.frames, look.column_grams, look.columns, energy, width * height)


def _notes(observations: Observations, active: np.ndarray, pixels: float) -> list[str]:
    """pixels: 0 for a shake that was not found, but is taken out all the same."""
    if not active[POSE].any():
        return []
    if len(observations.frames) == 1:
        found = f"the camera shakes by {pixels:.2g} px (rms), which" if pixels else "camera shake"
        return [f"{found} is taken out; a motion of the whole picture as one cannot be told from it"]
    return [
        "camera shake is taken out" + (f": {pixels:.2g} px (rms), each camera by itself" if pixels else "")
    ]
