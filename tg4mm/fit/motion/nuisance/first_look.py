"""One pass through the pictures of fixed cameras, and the nuisance columns that they need.

Which columns: as the settings say, or as the pictures show. Pictures with a background are a real camera's: their
exposure is always taken out, and a shake is looked for. Of a cut-out object no part is known to stand still: its
exposure is taken out where it shows, and a shake is looked for only where several synchronous cameras can disagree.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tg4mm.core.choices import Clock
from tg4mm.core.errors import RunError
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.checkpoints import Checkpoint
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.jacobian.view import ViewJacobian, view_jacobian
from tg4mm.fit.motion.nuisance.projection import (
    COLUMNS,
    EXPOSURE,
    EXPOSURE_SHARE,
    POSE,
    ROTATION,
    Nuisance,
    exposure,
    inner_products,
    nuisances_of,
)
from tg4mm.fit.motion.nuisance.registration import stabilised
from tg4mm.fit.motion.nuisance.shake import LEAST_PX, BlockShifts, PoseSums, own_rotations
from tg4mm.fit.motion.observation_model import ObservationModel
from tg4mm.fit.motion.observations import Observations, watched
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.split_half import chessboard

CACHE_BYTES = 128 << 20  # of differences, kept from this look for the next; what is more is composited again
# Of what moves pictures of several cameras as wholes. Still cameras: .05 to .20 in three scenes, since a motion that
# bends things is no rigid one. Thirty cameras that shake by twice the motion: .95, six .7, three .44. Two: .1, of six
# numbers that two cameras' turns have, six of the common motion explain nearly all.
_OWN_SHARE = 0.35


@dataclass(frozen=True)
class FirstLook:
    """Sums over one pass through the pictures of fixed cameras."""

    grams: list[np.ndarray]  # V of [F, F]: products of the changes of a camera's frames
    total: np.ndarray  # [V, H, W] energy of the changes, mean over channels
    mean: np.ndarray  # [V, H, W, 3]
    columns: list[np.ndarray]  # V of [12, F]: products of the nuisance columns with the changes
    sums: PoseSums | None  # of the columns, where each camera's own shake is looked for
    half: PoseSums | None  # the same over half of the pixels
    cache: dict[int, list[tuple[slice, np.ndarray]]]  # of some views the changes, by strips
    shake: tuple[float, bool]  # of the cameras: pixels (rms), and whether it is one


@dataclass(frozen=True)
class FixedCameras:
    """Fixed cameras ready to be fitted: the scene at rest, its views, what was seen, and what is no motion of it."""

    gaussians: Gaussians
    observations: Observations
    views: list[ViewJacobian]
    look: FirstLook
    nuisances: list[Nuisance]
    figures: dict[str, Any]
    notes: list[str]

    def model(self, v: int) -> ObservationModel:
        """What camera v shows, its pixels all of weight 1."""
        return ObservationModel.of(self.observations.frames[v], self.nuisances[v], self.look.mean[v])

    def problem(self, config: MotionConfig, device: str) -> Problem:
        """The motion problem that they pose."""
        problem = Problem.of(self.views, self.gaussians, config, device)
        return replace(problem, nuisances=self.nuisances, means=self.look.mean)


def look_at(
    gaussians: Gaussians,
    observations: Observations,
    config: MotionConfig,
    device: str,
    checkpoint: Checkpoint,
    refines: bool = True,
) -> FixedCameras:
    """Read all pictures once, and again, turned back to one pose, where cameras shake.

    Of shaken pictures the scene at rest is blurred, too: with `refines` it is fitted to the registered ones.
    Raises RunError where no camera sees a Gaussian.
    """
    views = rest_views(gaussians, observations)
    seen, shake_px = _looked_at(observations, views, gaussians, config)
    if not shake_px:
        return seen
    gaussians, observations, shake_px = stabilised(
        gaussians, observations, config, device, checkpoint, refines
    )
    views, active = rest_views(gaussians, observations), seen.nuisances[0].active
    nuisances = nuisances_of(views, observations.frames, gaussians.means.numpy(), active)
    look = first_look(observations, nuisances)
    shake_px *= observations.factor
    figures, notes = seen.figures | {"shake_px": round(shake_px, 4)}, _notes(observations, active, shake_px)
    return FixedCameras(gaussians, observations, views, look, nuisances, figures, notes)


def rest_views(gaussians: Gaussians, observations: Observations) -> list[ViewJacobian]:
    """The Jacobian of every camera's picture at rest. Raises RunError where none sees a Gaussian."""
    views = [view_jacobian(gaussians, frames, observations.size) for frames in observations.frames]
    if not any(view.bins.n_visible for view in views):
        raise RunError(
            f"none of the {len(gaussians):,} Gaussians is seen by a camera whose pictures show motion"
        )
    return views


def _looked_at(
    observations: Observations, views: list[ViewJacobian], gaussians: Gaussians, config: MotionConfig
) -> tuple[FixedCameras, float]:
    """After one pass; and the cameras' shake (pixels, rms), 0 where they do not."""
    # whether several cameras film at the same times, so that the scene's motion is one to all of them
    several = observations.clock == Clock.synchronous and len(observations.frames) > 1
    looks = config.nuisance in ("auto", "all") and (observations.is_opaque or several)
    possible = np.zeros(COLUMNS, bool)
    possible[EXPOSURE] = config.nuisance != "none"
    possible[POSE] = looks or config.nuisance == "all"
    nuisances = nuisances_of(views, observations.frames, gaussians.means.numpy(), possible)
    board = chessboard(observations.size) if looks and several else None
    look = first_look(observations, nuisances, looks and observations.is_opaque, board)
    gain, offset, share = exposure(nuisances, list(look.mean), look.columns, look.grams)
    figures: dict[str, Any] = {
        "exposure_gain_percent": round(gain, 4),
        "exposure_offset_percent": round(offset, 4),
        "exposure_share": round(share, 6),
    }
    pixels, is_shaking = look.shake
    if look.sums is not None and look.half is not None:
        pixels, own = own_rotations(observations.frames, look.sums, look.half)
        is_shaking = pixels > LEAST_PX and own > _OWN_SHARE and (is_shaking or not observations.is_opaque)
        figures["shake_own_share"] = round(own, 4)
    active = possible.copy()
    if config.nuisance == "auto":
        active[EXPOSURE] = observations.is_opaque or share > EXPOSURE_SHARE
        # six columns of every camera would hold every rigid motion of the scene
        active[POSE] = False
        active[ROTATION if several else POSE] = is_shaking
    if looks:
        figures["shake_px"] = round(pixels * observations.factor, 4)
    figures["nuisance"] = [n for n, s in (("exposure", EXPOSURE), ("pose", POSE)) if active[s].any()]
    shake_px = pixels if is_shaking else 0.0
    chosen = [n.with_active(active) for n in nuisances]
    notes = _notes(observations, active, shake_px * observations.factor)
    return FixedCameras(gaussians, observations, views, look, chosen, figures, notes), shake_px


def first_look(
    observations: Observations,
    nuisances: Sequence[Nuisance],
    looks_for_shake: bool = False,
    board: np.ndarray | None = None,
) -> FirstLook:
    """One pass through the pictures. Of the nuisances' pose columns only active ones have products, else 0.

    board [H, W] of 0 and 1: which pixels are one half of them; None: no sums over halves.
    """
    width, height = observations.size
    n = len(observations.frames)
    total, mean = np.empty((n, height, width), np.float32), np.empty((n, height, width, 3), np.float32)
    grams, columns = [], []
    column_grams, half = [], PoseSums([], [])
    cache: dict[int, list[tuple[slice, np.ndarray]]] = {}
    free = CACHE_BYTES
    shakes = []
    for v, frames, pictures in watched("pictures, first pass", observations):
        blocks = BlockShifts.of(nuisances[v].view.over_white, len(frames.rows)) if looks_for_shake else None
        free -= len(frames.rows) * height * width * 12
        n_frames, kept = len(frames.rows), []
        gram, products = np.zeros((n_frames, n_frames)), np.zeros((COLUMNS, n_frames))
        of_half = np.zeros_like(products)
        for rows, strip in pictures:
            mean[v, rows] = strip.mean(0, dtype=np.float64)
            strip -= mean[v, rows]
            if blocks is not None:
                blocks.add(rows, strip)
            flat = strip.reshape(len(strip), -1)
            gram += flat @ flat.T
            products += inner_products(nuisances[v], mean[v], rows, flat)
            if board is not None:
                masked = (strip * board[rows, :, None]).reshape(len(strip), -1)
                of_half += inner_products(nuisances[v], mean[v], rows, masked)
            total[v, rows] = np.einsum("fhwc,fhwc->hw", strip, strip) / 3
            if free >= 0:
                kept.append((rows, strip))
        grams.append(gram)
        columns.append(products)
        if board is not None:
            column_grams.append(_column_gram(nuisances[v], mean[v]))
            half.grams.append(_column_gram(nuisances[v], mean[v], board))
            half.products.append(of_half)
        nuisances[v].release()
        if kept:
            cache[v] = kept
        if blocks is not None:
            shakes.append(blocks.shake())
    pixels = float(np.sqrt(np.mean([p**2 for p, _ in shakes]))) if shakes else 0.0
    shake = pixels, bool(shakes and np.mean([s for _, s in shakes]) > 0.5)
    sums = None if board is None else PoseSums(column_grams, columns)
    return FirstLook(grams, total, mean, columns, sums, None if board is None else half, cache, shake)


def _column_gram(nuisance: Nuisance, mean: np.ndarray, mask: np.ndarray | None = None) -> np.ndarray:
    out = np.zeros((COLUMNS, COLUMNS))
    out[np.ix_(nuisance.active, nuisance.active)] = nuisance.gram(mean, mask=mask)
    return out


def _notes(observations: Observations, active: np.ndarray, pixels: float) -> list[str]:
    """pixels: 0 for a shake that was not found, but is taken out all the same."""
    if not active[POSE].any():
        return []
    if len(observations.frames) == 1:
        size = f" of {pixels:.2g} px (rms)" if pixels else ""
        return [f"common motion of the complete picture, which is removed as camera shake{size}"]
    return [
        "camera shake is removed" + (f": {pixels:.2g} px (rms), for each camera separately" if pixels else "")
    ]
