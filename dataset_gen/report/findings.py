"""What a finished dataset holds, read from its files: cameras, modes, motion in pixels, scores of a perfect method.

Two renders of the same truth with different seeds differ by noise alone. If each has noise of variance σ², their
squared error is 2σ²; a method that is exact and free of noise would have σ², so its PSNR lies 10 log₁₀ 2 = 3.01 dB
above that of the pair. The second renders lie in `report/reseeded/`.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tg4mm.capture import Capture, dataset_tree
from tg4mm.capture.truth_file import TRUTH_FILE, Truth, load_truth
from tg4mm.core.errors import CaptureError, MissingSplitError
from tg4mm.core.metrics import MAX_PSNR_DB, psnr
from tg4mm.core.pictures.decode import decode

from ..cameras.camera import project
from ..errors import GenerateError
from ..plan import RESEEDED, magnified_folder
from ..vibration import reach

MOVING = 0.01  # of the set's largest displacement: a vertex displaced by more counts as moving
_MOST_VERTICES = 20_000  # projected
_MOST_TIMES = 30  # timesteps projected


@dataclass(frozen=True)
class Mode:
    """One mode of truth/motion.npz."""

    name: str
    frequency_hz: float  # 0: a drift
    amplitude: float  # largest displacement of any vertex, scene units
    magnified: bool  # whether α applies to it
    parts: tuple[tuple[str, float], ...]  # objects that move and their largest displacement, largest first


@dataclass(frozen=True)
class ViewMotion:
    """Projected motion in one camera: of each moving vertex in the picture the largest over time, pixels."""

    name: str
    maximum: float
    p95: float
    median: float


@dataclass(frozen=True)
class Scores:
    """PSNR at one α, dB, averaged over pictures; None where there are none."""

    alpha: float
    still: float | None  # the rest picture, with noise of its own where that was rendered
    pair: float | None  # two renders of the truth

    @property
    def perfect(self) -> float | None:
        """PSNR of a method that is exact and free of noise."""
        return None if self.pair is None else min(MAX_PSNR_DB, self.pair + 10 * math.log10(2))


@dataclass(frozen=True)
class Findings:
    """All that was read and measured for a report."""

    root: Path
    train: Capture | None
    test: Capture | None
    alphas: tuple[float, ...]
    strength: (
        np.ndarray
    )  # [T] largest displacement of any vertex, scene units; empty without truth/motion.npz
    modes: tuple[Mode, ...]
    views: tuple[ViewMotion, ...]  # test cameras, or training cameras without any
    scores: tuple[Scores, ...]

    @property
    def any(self) -> Capture:
        """The training views, or the test views where there are none."""
        capture = self.train or self.test
        assert capture is not None
        return capture

    @property
    def amplitude(self) -> float:
        """Largest displacement over time, scene units; as described where the truth is absent."""
        described = self.any.scene.get("amplitude")
        if self.strength.size:
            return float(self.strength.max())
        return float(described) if isinstance(described, int | float) else 0.0

    @property
    def strongest(self) -> int:
        """The timestep farthest from rest, the first of several; 0 where that is not known."""
        return int(np.argmax((self.strength / (self.amplitude or 1)).round(4))) if self.strength.size else 0


def find(root: Path) -> Findings:
    """Reads and measures the dataset. Raises GenerateError with file and reason if it is none."""
    try:
        train, test = _load(root, "train"), _load(root, "test")
        capture = train or test
        if capture is None:
            raise GenerateError(f"{root}: holds neither training nor test views")
        truth = None
        if (root / TRUTH_FILE).is_file():
            truth = load_truth(root, capture.fps, capture.n_timesteps)
        alphas = tuple(a for a in capture.scene.get("alphas") or () if isinstance(a, int | float))
        strength = _strength(truth, capture.n_timesteps) if truth else np.zeros(0)
        modes = tuple(_modes(truth, capture)) if truth else ()
        views = tuple(_motions(truth, test or capture, float(strength.max()))) if truth else ()
        scores = tuple(_scores(root, test, alphas, strength)) if test else ()
    except (CaptureError, OSError) as error:
        raise GenerateError(str(error)) from error
    return Findings(root, train, test, alphas, strength, modes, views, scores)


def read_picture(path: Path) -> np.ndarray:
    """A picture over white, [H, W, 3] float32 in 0..1, display-referred. Raises GenerateError."""
    try:
        pixels = decode(path)
    except (CaptureError, OSError) as error:
        raise GenerateError(f"{path}: cannot be read: {error}") from error
    values = pixels.astype(np.float32) / np.float32(np.iinfo(pixels.dtype).max)
    return values[..., :3] * values[..., 3:] + 1 - values[..., 3:]


def magnified(root: Path, picture: Path, alpha: float) -> Path:
    """Where the ground truth of a test picture at α lies; the picture itself for α = 0."""
    return root / magnified_folder(alpha) / picture.relative_to(root) if alpha else picture


def _load(root: Path, split: str) -> Capture | None:
    if not root.is_dir():
        raise GenerateError(f"{root}: is not a folder")
    try:
        return dataset_tree.load(root, split, 0)
    except MissingSplitError:
        return None


def _gains(truth: Truth) -> np.ndarray:
    """[K, T] complex."""
    if truth.gains is not None:
        return truth.gains
    return np.exp(2j * np.pi * np.outer(truth.freqs_hz, np.arange(truth.n_timesteps)) / truth.fps)


def _displaced(truth: Truth, timestep: int) -> list[np.ndarray]:
    """Displacement [V, 3] of every object, scene units."""
    gains = _gains(truth)[:, timestep]
    return [np.tensordot(gains, body.modes, axes=1).real for body in truth.objects]


def _strength(truth: Truth, n_timesteps: int) -> np.ndarray:
    return np.array(
        [
            max(np.linalg.norm(d, axis=1).max(initial=0.0) for d in _displaced(truth, t))
            for t in range(n_timesteps)
        ]
    )


def _modes(truth: Truth, capture: Capture) -> Iterable[Mode]:
    described = capture.scene.get("modes") or []
    for k, frequency in enumerate(truth.freqs_hz):
        gain = float(np.abs(_gains(truth)[k]).max(initial=0.0))
        peaks = [(body.name, gain * float(reach(body.modes[k]).max(initial=0.0))) for body in truth.objects]
        peaks.sort(key=lambda named: -named[1])
        top = peaks[0][1]
        own = described[k] if k < len(described) and isinstance(described[k], dict) else {}
        name = str(own.get("name") or own.get("kind") or f"mode {k + 1}")
        alpha = truth.magnified is None or bool(truth.magnified[k])
        yield Mode(name, float(frequency), top, alpha, tuple(p for p in peaks if top and p[1] > 1e-6 * top))


def _motions(truth: Truth, capture: Capture, amplitude: float) -> Iterable[ViewMotion]:
    """Motion of every camera, by vertices inside its pictures, hidden ones too."""
    stride = max(1, sum(len(body.rest) for body in truth.objects) // _MOST_VERTICES)
    rest = np.concatenate([body.rest[::stride] for body in truth.objects])
    times = _evenly(capture.n_timesteps, _MOST_TIMES)
    displaced = {t: np.concatenate([d[::stride] for d in _displaced(truth, t)]) for t in times}
    largest = np.max([np.linalg.norm(d, axis=1) for d in displaced.values()], axis=0)
    moving = largest > MOVING * amplitude
    names: dict[str, dict[int, int]] = {}
    for i, path in enumerate(capture.paths):
        names.setdefault(path.stem, {})[int(capture.timesteps[i])] = i
    for name, rows in names.items():
        peak = np.full(int(moving.sum()), np.nan)
        for t in times:
            if t in rows:
                step = _step(rest[moving], displaced[t][moving], capture, rows[t])
                peak = np.fmax(peak, step)
        seen = peak[~np.isnan(peak)]
        p95, median = np.percentile(seen, [95, 50]) if seen.size else (0.0, 0.0)
        yield ViewMotion(name, float(seen.max(initial=0.0)), float(p95), float(median))


def _step(rest: np.ndarray, displaced: np.ndarray, capture: Capture, row: int) -> np.ndarray:
    """Pixels [V] between where points are and where they are at rest, NaN outside the picture."""
    pose = np.linalg.inv(capture.viewmats[row]) @ np.diag([1.0, -1.0, -1.0, 1.0])
    K = capture.Ks[row]
    intrinsics = (K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    still, depth = project(rest, pose, intrinsics)
    moved, _ = project(rest + displaced, pose, intrinsics)
    with np.errstate(invalid="ignore"):
        inside = (depth > 1e-9) & ((still >= 0) & (still < (capture.width, capture.height))).all(-1)
    return np.where(inside, np.linalg.norm(moved - still, axis=-1), np.nan)


def _scores(root: Path, test: Capture, alphas: tuple[float, ...], strength: np.ndarray) -> Iterable[Scores]:
    """At α = 0 and each α, over the pictures that were rendered twice, else over one at the largest motion."""
    strongest = int(np.argmax(strength)) if strength.size else 0
    for alpha in (0.0, *sorted(alphas)):
        every = [(i, magnified(root, path, alpha)) for i, path in enumerate(test.paths)]
        twice = [(i, path) for i, path in every if (root / RESEEDED / path.relative_to(root)).is_file()]
        shown = twice or [(i, p) for i, p in every if test.timesteps[i] == strongest and p.is_file()][:1]
        pair = _mean((path, root / RESEEDED / path.relative_to(root)) for _, path in twice)
        rests = [(path, _rest(root, test, i, strength)) for i, path in shown]
        yield Scores(alpha, _mean((path, rest) for path, rest in rests if rest not in (None, path)), pair)


def _rest(root: Path, test: Capture, i: int, strength: np.ndarray) -> Path | None:
    """The rest picture of the same camera with noise of its own, else the set's picture nearest to rest."""
    path = test.paths[i]
    own = root / RESEEDED / "rest" / f"{test.timesteps[i]:03d}" / "test" / path.name
    if own.is_file():
        return own
    nearest = int(np.argmin(strength.round(12))) if strength.size else 0
    same = (test.camera_ids == test.camera_ids[i]) & (test.timesteps == nearest)
    return test.paths[int(np.argmax(same))] if same.any() else None


def _mean(pairs: Iterable[tuple[Path, Path | None]]) -> float | None:
    values = [psnr(read_picture(a), read_picture(b)) for a, b in pairs if b is not None]
    return float(np.mean(values)) if values else None


def _evenly(count: int, most: int) -> list[int]:
    return sorted({i * count // min(count, most) for i in range(min(count, most))})
