"""Preparation of fixed cameras: one pass through their pictures, and the nuisance columns that they need.

The columns are those of the settings, or what the pictures need. Pictures with a background come from a real camera:
their exposure is always removed, and they are tested for shake. A cut-out object has no part that is known to be at
rest: its exposure is removed if it shows, and only several synchronous cameras can be tested for shake.

For that test the picture is cut into 8 × 8 blocks. Each block's shift in every frame is the least-squares solution of
its pixels by the picture's slopes (Lucas & Kanade 1981). A shaking camera moves every block, by a shift, a roll and a
zoom of the complete picture; a scene that moves before a fixed camera leaves some blocks at rest. So the blocks that
move least decide: they must move by more than noise, and as one shift, roll and zoom of all blocks does.

A scene that moves as a whole looks the same to one camera. Several cameras with the same times distinguish the two: one
rigid motion of the scene, six numbers for each timestep, must explain all of them (`own_rotations`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tg4mm.core.choices import Clock
from tg4mm.core.errors import RunError
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.checkpoints import Checkpoint
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.jacobian.view import PosedView, ViewJacobian, view_jacobian
from tg4mm.fit.motion.large.registration import stabilised
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
    pseudo_inverse,
)
from tg4mm.fit.motion.observation_model import ObservationModel
from tg4mm.fit.motion.observations import Observations, watched
from tg4mm.fit.motion.solver.problem import Problem
from tg4mm.fit.motion.split_half import chessboard

BLOCKS = 8  # along each side
_TEXTURE = 0.05  # of the mean block's: less resolves no shift
_STILLEST = 0.25  # of the blocks with texture
LEAST_PX = 0.01  # rms; less is none
_EXPLAINED = 0.7  # of the stillest blocks' power must be that of one pose
_IRLS_STEPS = 5  # of one pose for the blocks
_TINY = 1e-9  # of the largest eigenvalue: below it a column says nothing new
# Of what moves pictures of several cameras as wholes. Still cameras: .05 to .20 in three scenes, since a motion that
# bends things is no rigid one. Thirty cameras that shake by twice the motion: .95, six .7, three .44. Two: .1, of six
# numbers that two cameras' turns have, six of the common motion explain nearly all.
_OWN_SHARE = 0.35


@dataclass
class BlockShifts:
    """Sums over one view's frames: products of slopes with changes."""

    slopes: np.ndarray  # [2, H, W, 3] float32: what a shift right, down by a pixel changes
    gram: np.ndarray  # [B, B, 2, 2]
    products: np.ndarray  # [B, B, 2, F]
    energy: np.ndarray  # [B, B] of the changes

    @staticmethod
    def of(picture: np.ndarray, n_frames: int) -> "BlockShifts":
        """picture [H, W, 3]: at rest."""
        down, right = np.gradient(picture, axis=(0, 1))
        slopes = -np.stack([right, down]).astype(np.float32)
        gram = np.zeros((BLOCKS, BLOCKS, 2, 2))
        for i, j, (tall, wide) in _blocks(picture.shape[:2]):
            flat = slopes[:, tall, wide].reshape(2, -1)
            gram[i, j] = flat @ flat.T
        return BlockShifts(slopes, gram, np.zeros((BLOCKS, BLOCKS, 2, n_frames)), np.zeros((BLOCKS, BLOCKS)))

    def add(self, rows: slice, changes: np.ndarray) -> None:
        """A strip of changes [F, rows, W, 3]."""
        for i, j, (tall, wide) in _blocks(self.slopes.shape[1:3]):
            top, bottom = max(tall.start, rows.start), min(tall.stop, rows.stop)
            if top >= bottom:
                continue
            part = changes[:, top - rows.start : bottom - rows.start, wide].reshape(len(changes), -1)
            self.products[i, j] += self.slopes[:, top:bottom, wide].reshape(2, -1) @ part.T
            self.energy[i, j] += float((part**2).sum())

    def shake(self) -> tuple[float, bool]:
        """Shift of the blocks that move least (pixels, rms over frames), and whether one pose explains it."""
        texture = np.linalg.eigvalsh(self.gram)[..., 0]
        has_texture = texture > _TEXTURE * max(float(texture.mean()), 1e-30)
        if has_texture.sum() < 8:
            return 0.0, False
        gram, products = self.gram[has_texture], self.products[has_texture]
        shifts = np.linalg.solve(gram, products)  # [b, 2, F]
        n = self.slopes[0].size / BLOCKS**2
        residual = self.energy[has_texture] - np.einsum("bcf,bcf->b", shifts, products)
        of_pixel = np.maximum(residual, 0) / n  # sum over frames
        noise = of_pixel * np.trace(np.linalg.inv(gram), axis1=1, axis2=2)
        power = np.maximum((shifts**2).sum((1, 2)) - noise, 0)
        places = np.argwhere(has_texture) / (BLOCKS - 1) - 0.5
        deviations = shifts - _one_pose(places, shifts, texture[has_texture])
        unexplained = np.maximum((deviations**2).sum((1, 2)) - noise, 0)
        stillest = np.argsort(power)[: max(int(_STILLEST * len(power)), 2)]
        moved = float(np.sqrt(power[stillest].mean() / shifts.shape[2]))
        share = 1 - unexplained[stillest].sum() / max(power[stillest].sum(), 1e-30)
        return moved, bool(moved > LEAST_PX and share > _EXPLAINED)


def _blocks(size: tuple[int, ...]) -> Iterator[tuple[int, int, tuple[slice, slice]]]:
    rows, columns = (np.linspace(0, n, BLOCKS + 1).round().astype(int) for n in size)
    for i in range(BLOCKS):
        for j in range(BLOCKS):
            yield i, j, (slice(rows[i], rows[i + 1]), slice(columns[j], columns[j + 1]))


def _one_pose(places: np.ndarray, shifts: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return [b, 2, F]: the shift, roll and zoom that most blocks follow, at blocks `places` [b, 2] (down, right).

    Iteratively reweighted least squares, so that blocks which move by themselves count little.
    """
    y, x = places.T
    one, zero = np.ones_like(x), np.zeros_like(x)
    design = np.stack([np.stack([one, zero, -y, x], 1), np.stack([zero, one, x, y], 1)], 1)  # [b, 2, 4]
    trust = weights / weights.max()
    fitted = shifts
    for _ in range(_IRLS_STEPS):
        root = np.sqrt(trust)[:, None, None]
        flat = (root * design).reshape(-1, 4)
        coefficients = np.linalg.lstsq(flat, (root * shifts).reshape(len(flat), -1), rcond=None)[0]
        fitted = design @ coefficients
        error = np.sqrt(((shifts - fitted) ** 2).mean((1, 2)))
        trust = weights / weights.max() / (1 + (error / max(float(np.median(error)), 1e-12)) ** 2)
    return fitted


@dataclass(frozen=True)
class PoseSums:
    """Inner products of the nuisance columns of V cameras, summed over all pixels or over half of them."""

    grams: list[np.ndarray]  # V of [12, 12]: of the columns with each other, 0 for inactive ones
    products: list[np.ndarray]  # V of [12, F]: of the columns with the changes of F frames

    def without(self, other: "PoseSums") -> "PoseSums":
        """The sums over the pixels that `other` leaves out."""
        grams = [a - b for a, b in zip(self.grams, other.grams, strict=True)]
        return PoseSums(grams, [a - b for a, b in zip(self.products, other.products, strict=True)])


def own_rotations(cameras: Sequence[PosedView], sums: PoseSums, half: PoseSums) -> tuple[float, float]:
    """Return the shift of synchronous cameras' pictures beyond one rigid scene motion: pixels (rms), and its share.

    sums: over all pixels; half: over half of them, one colour of a chessboard. The share is the part of the energy that
    a common rigid motion and rotations of each camera by itself explain together and the common motion alone does not;
    exposure is fitted first. It is near 0 for a scene that moves as a whole, near 1 for many cameras that shake.

    What noise adds is left out: the coefficients of one half of the pixels count by what they explain of the other
    half, with which they share no noise, however that is spread over pixels and channels.
    """
    gram, side = _normal_equations(cameras, sums)
    n_cameras, n_frames = len(cameras), side.shape[1]
    column = np.tile(np.arange(9), n_cameras)
    kind = np.concatenate(
        [np.where(column < 6, 0, 1), np.full(6, 2)]
    )  # exposure, own rotations, common motion
    subsets = kind == 0, kind != 1, kind >= 0
    exposure, common, everything = (_solved(gram, side, k) for k in subsets)
    at_first, by_common, by_all = (float((side * n).sum()) for n in (exposure, common, everything))
    halves = [_normal_equations(cameras, part) for part in (half, sums.without(half))]
    common_shared, all_shared = (_shared_energy(halves, k) for k in subsets[1:])
    excess = max(all_shared - common_shared, 0)
    residual = side - gram @ np.where((kind == 2)[:, None], common, 0)
    rotations = _solved(gram, residual, kind < 2)[kind == 1].reshape(n_cameras, 3, n_frames)
    pixels = np.stack([np.diag(c.K)[:2, None] * r[1::-1] for c, r in zip(cameras, rotations, strict=True)])
    share = excess / max(by_all - at_first, 1e-30)
    kept = min(excess / max(by_all - by_common, 1e-30), 1.0)
    return float(np.sqrt(kept * (pixels**2).sum(1).mean())), share


def _shared_energy(halves: Sequence[tuple[np.ndarray, np.ndarray]], active: np.ndarray) -> float:
    """Return the energy that two halves of the pixels agree on: each one's solution by the other's right-hand side."""
    (gram_a, side_a), (gram_b, side_b) = halves
    a, b = _solved(gram_a, side_a, active), _solved(gram_b, side_b, active)
    return float((a * side_b).sum() + (b * side_a).sum())


def _normal_equations(cameras: Sequence[PosedView], sums: PoseSums) -> tuple[np.ndarray, np.ndarray]:
    """Return products [9 V + 6, 9 V + 6] and [9 V + 6, F] of all exposures, rotations and the rigid motion."""
    columns = np.r_[EXPOSURE, ROTATION]
    n = len(columns) * len(cameras)
    gram, side = np.zeros((n + 6, n + 6)), np.zeros((n + 6, sums.products[0].shape[1]))
    for v, (camera, g, p) in enumerate(zip(cameras, sums.grams, sums.products, strict=True)):
        here, seen_as = slice(len(columns) * v, len(columns) * (v + 1)), _as_pose(camera.viewmat)
        gram[here, here] = g[np.ix_(columns, columns)]
        gram[here, n:] = g[columns, POSE] @ seen_as
        gram[n:, here] = gram[here, n:].T
        gram[n:, n:] += seen_as.T @ g[POSE, POSE] @ seen_as
        side[here] = p[columns]
        side[n:] += seen_as.T @ p[POSE]
    return gram, side


def _as_pose(viewmat: np.ndarray) -> np.ndarray:
    """Return the matrix [6, 6] from a rigid motion of the scene to the coefficients of a camera's six pose columns.

    The motion is a rotation about the world's origin and a translation. The columns turn and shift the scene about the
    camera's centre and along its axes.
    """
    axes = viewmat[:3, :3].astype(np.float64)
    x, y, z = -axes.T @ viewmat[:3, 3]
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = axes
    out[3:, :3] = axes @ [[0, z, -y], [-z, 0, x], [y, -x, 0]]  # rotation × centre
    return out


def _solved(gram: np.ndarray, side: np.ndarray, active: np.ndarray) -> np.ndarray:
    """Least squares of the active unknowns, 0 for the others: as `side`."""
    out = np.zeros_like(side)
    out[active] = pseudo_inverse(gram[np.ix_(active, active)], _TINY) @ side[active]
    return out


@dataclass(frozen=True)
class PictureSums:
    """Sums over one pass through the pictures of fixed cameras."""

    grams: list[np.ndarray]  # V of [F, F]: products of the changes of a camera's frames
    total: np.ndarray  # [V, H, W] energy of the changes, mean over channels
    mean: np.ndarray  # [V, H, W, 3]
    columns: list[np.ndarray]  # V of [12, F]: products of the nuisance columns with the changes
    pose_sums: PoseSums | None  # of the columns, where each camera's own shake is looked for
    pose_half: PoseSums | None  # the same over half of the pixels
    shake: tuple[float, bool]  # of the cameras: pixels (rms), and whether it is one


@dataclass(frozen=True)
class FixedCameras:
    """Fixed cameras ready to be fitted: the scene at rest, its views, what was seen, and what is no motion of it."""

    gaussians: Gaussians
    observations: Observations
    views: list[ViewJacobian]
    sums: PictureSums
    nuisances: list[Nuisance]
    figures: dict[str, Any]
    notes: list[str]

    def model(self, v: int) -> ObservationModel:
        """Return the observation model of camera v, all pixels of weight 1."""
        return ObservationModel.of(self.observations.frames[v], self.nuisances[v], self.sums.mean[v])

    def problem(self, config: MotionConfig, device: str) -> Problem:
        """The motion problem that they pose."""
        problem = Problem.of(self.views, self.gaussians, config, device)
        return replace(problem, nuisances=self.nuisances, means=self.sums.mean)


def prepare_fixed_cameras(
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
    seen, shake_px = _read_once(observations, views, gaussians, config)
    if not shake_px:
        return seen
    gaussians, observations, shake_px = stabilised(
        gaussians, observations, config, device, checkpoint, refines
    )
    views, active = rest_views(gaussians, observations), seen.nuisances[0].active
    nuisances = nuisances_of(views, observations.frames, gaussians.means.numpy(), active)
    sums = picture_sums(observations, nuisances)
    shake_px *= observations.factor
    figures, notes = seen.figures | {"shake_px": round(shake_px, 4)}, _notes(observations, active, shake_px)
    return FixedCameras(gaussians, observations, views, sums, nuisances, figures, notes)


def rest_views(gaussians: Gaussians, observations: Observations) -> list[ViewJacobian]:
    """The Jacobian of every camera's picture at rest. Raises RunError where none sees a Gaussian."""
    views = [view_jacobian(gaussians, frames, observations.size) for frames in observations.frames]
    if not any(view.bins.n_visible for view in views):
        raise RunError(
            f"none of the {len(gaussians):,} Gaussians is seen by a camera whose pictures show motion"
        )
    return views


def _read_once(
    observations: Observations, views: list[ViewJacobian], gaussians: Gaussians, config: MotionConfig
) -> tuple[FixedCameras, float]:
    """Return the result of one pass, and the cameras' shake (pixels, rms; 0 if none)."""
    # whether several cameras film at the same times, so that the scene's motion is one to all of them
    several = observations.clock == Clock.synchronous and len(observations.frames) > 1
    looks = config.nuisance in ("auto", "all") and (observations.is_opaque or several)
    possible = np.zeros(COLUMNS, bool)
    possible[EXPOSURE] = config.nuisance != "none"
    possible[POSE] = looks or config.nuisance == "all"
    nuisances = nuisances_of(views, observations.frames, gaussians.means.numpy(), possible)
    board = chessboard(observations.size) if looks and several else None
    sums = picture_sums(observations, nuisances, looks and observations.is_opaque, board)
    gain, offset, share = exposure(nuisances, list(sums.mean), sums.columns, sums.grams)
    figures: dict[str, Any] = {
        "exposure_gain_percent": round(gain, 4),
        "exposure_offset_percent": round(offset, 4),
        "exposure_share": round(share, 6),
    }
    pixels, is_shaking = sums.shake
    if sums.pose_sums is not None and sums.pose_half is not None:
        pixels, own_share = own_rotations(observations.frames, sums.pose_sums, sums.pose_half)
        is_shaking = (
            pixels > LEAST_PX and own_share > _OWN_SHARE and (is_shaking or not observations.is_opaque)
        )
        figures["shake_own_share"] = round(own_share, 4)
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
    chosen = [replace(n, active=active) for n in nuisances]
    notes = _notes(observations, active, shake_px * observations.factor)
    return FixedCameras(gaussians, observations, views, sums, chosen, figures, notes), shake_px


def picture_sums(
    observations: Observations,
    nuisances: Sequence[Nuisance],
    looks_for_shake: bool = False,
    board: np.ndarray | None = None,
) -> PictureSums:
    """One pass through the pictures. Of the nuisances' pose columns only active ones have products, else 0.

    board [H, W] of 0 and 1: which pixels are one half of them; None: no sums over halves.
    """
    width, height = observations.size
    n = len(observations.frames)
    total, mean = np.empty((n, height, width), np.float32), np.empty((n, height, width, 3), np.float32)
    grams, columns = [], []
    column_grams, half = [], PoseSums([], [])
    shakes = []
    for v, frames, pictures in watched("pictures, first pass", observations):
        blocks = BlockShifts.of(nuisances[v].view.over_white, len(frames.rows)) if looks_for_shake else None
        n_frames = len(frames.rows)
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
        grams.append(gram)
        columns.append(products)
        if board is not None:
            column_grams.append(_column_gram(nuisances[v], mean[v]))
            half.grams.append(_column_gram(nuisances[v], mean[v], board))
            half.products.append(of_half)
        nuisances[v].release()
        if blocks is not None:
            shakes.append(blocks.shake())
    pixels = float(np.sqrt(np.mean([p**2 for p, _ in shakes]))) if shakes else 0.0
    shake = pixels, bool(shakes and np.mean([s for _, s in shakes]) > 0.5)
    sums = None if board is None else PoseSums(column_grams, columns)
    return PictureSums(grams, total, mean, columns, sums, None if board is None else half, shake)


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
