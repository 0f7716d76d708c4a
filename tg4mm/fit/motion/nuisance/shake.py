"""Whether fixed cameras shake: does what moves least in their pictures move as one, and in each camera by itself?

The picture is cut into 8 × 8 blocks. Each block's shift in every frame is the least-squares solution of its pixels by
the picture's slopes (Lucas & Kanade 1981). A camera that shakes moves every block, by a shift, a roll and a zoom of the
whole picture; a scene that moves before a camera that does not leaves some blocks where they are. So the blocks that
move least decide: they must move by more than noise, and by what one shift, roll and zoom makes of all of them.

A scene that moves as a whole looks the same to one camera. Several that film at the same times tell the two apart: one
rigid motion of the scene, six numbers for each timestep, must look right in all of them (`own_rotations`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tg4mm.fit.motion.jacobian.view import PosedView
from tg4mm.fit.motion.nuisance.projection import EXPOSURE, POSE, ROTATION, pseudo_inverse

BLOCKS = 8  # along each side
_TEXTURE = 0.05  # of the mean block's: less tells no shift
_STILLEST = 0.25  # of the blocks with texture
LEAST_PX = 0.01  # rms; less is none
_EXPLAINED = 0.7  # of the stillest blocks' power must be that of one pose
_IRLS_STEPS = 5  # of one pose for the blocks
_TINY = 1e-9  # of the largest eigenvalue: below it a column says nothing new


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
            own = changes[:, top - rows.start : bottom - rows.start, wide].reshape(len(changes), -1)
            self.products[i, j] += self.slopes[:, top:bottom, wide].reshape(2, -1) @ own.T
            self.energy[i, j] += float((own**2).sum())

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
    """[b, 2, F]: the shift, roll and zoom that most blocks follow, at blocks `places` [b, 2] (down, right).

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
    own = np.tile(np.arange(9), n_cameras)
    kind = np.concatenate([np.where(own < 6, 0, 1), np.full(6, 2)])  # exposure, own rotations, common motion
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
    """[9 V + 6, 9 V + 6] and [9 V + 6, F]: every camera's exposure and rotation, the scene's common rigid motion."""
    own = np.r_[EXPOSURE, ROTATION]
    n = len(own) * len(cameras)
    gram, side = np.zeros((n + 6, n + 6)), np.zeros((n + 6, sums.products[0].shape[1]))
    for v, (camera, g, p) in enumerate(zip(cameras, sums.grams, sums.products, strict=True)):
        here, seen_as = slice(len(own) * v, len(own) * (v + 1)), _as_pose(camera.viewmat)
        gram[here, here] = g[np.ix_(own, own)]
        gram[here, n:] = g[own, POSE] @ seen_as
        gram[n:, here] = gram[here, n:].T
        gram[n:, n:] += seen_as.T @ g[POSE, POSE] @ seen_as
        side[here] = p[own]
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
