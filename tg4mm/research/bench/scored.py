"""Scores of a folder of pictures against the truth, and by metrics of other programs.

MD-VQA and FAST-VQA measure video quality without a reference, and are not part of this program: the authors'
`test_video.py` and `vqa.py` print the score as the last number of their last line.
"""

import re
import subprocess
import tempfile
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture import Capture, ImageStack
from tg4mm.core.metrics import SSIM_BORDER, decibels, flip, has_flip, psnr, ssim_map
from tg4mm.core.pictures.decode import decode
from tg4mm.core.progress import progress
from tg4mm.research.bench import BenchError
from tg4mm.research.evaluate.scores import BACKGROUND, Metric, closure, content_key, regressed
from tg4mm.show.render.video import loops_to_last, write_mp4

MOVES = 8 / 255  # a moving pixel's ground truth differs by more from its mean over time, in any colour
_THREADS = 2
# {key: (title, format)}, in the order of the tables
METRICS: dict[str, tuple[str, str]] = {
    "ssim": ("SSIM", "{:.4f}"),
    "psnr_db": ("PSNR, dB", "{:.2f}"),
    "ssim_moving": ("SSIM where it moves", "{:.4f}"),
    "psnr_moving_db": ("PSNR where it moves, dB", "{:.2f}"),
    "flip": ("FLIP", "{:.4f}"),
    "lpips": ("LPIPS", "{:.4f}"),
    "gain": ("gain", "{:.2f}"),
    "residual": ("residual", "{:.2f}"),
    "closure": ("closure", "{:.2f}"),
    "ssim_gap": ("SSIM below the ceiling", "{:.4f}"),
    "md_vqa": ("MD-VQA", "{:.2f}"),
    "fast_vqa": ("FAST-VQA", "{:.4f}"),
}
_SECONDS = 4.0  # duration of a video, by repetition
_MINUTES = 30  # time limit of a program
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
# {metric: arguments before the video's name, run by Python in the checkout's folder}
PROGRAMS = {"md_vqa": ("test_video.py", "-i"), "fast_vqa": ("vqa.py", "-m", "FAST-VQA", "-v")}
OPTIONS = {"md_vqa": "--md-vqa", "fast_vqa": "--fast-vqa"}


@dataclass
class _Sums:
    pictures: list[dict[str, float]] = field(default_factory=list)
    moving: list[dict[str, float]] = field(default_factory=list)  # of pictures in which something moves
    products: np.ndarray = field(default_factory=lambda: np.zeros(3))  # a·a, a·c, c·c
    n_moving: int = 0  # pixels of all cameras
    n_pixels: int = 0


def score_pictures(
    capture: Capture, folder: Path, lpips: Metric | None = None, label: str = "scores"
) -> dict[str, float | int | None]:
    """Return mean scores of the pictures in `folder`, which have the names of the ground truth `capture`'s.

    Progress appears as `label`.

    ssim, psnr_db, flip, lpips     of whole pictures over white; flip None without its package, lpips without weights
    ssim_moving, psnr_moving_db    over the pixels that move (`MOVES`), None where none does: the mean of the SSIM map;
                                   the PSNR of the mean over the pictures of their mean squared error there, as a mean
                                   of decibels is ruled by the moments at which the motion passes through rest. Pixels
                                   within five of the edge are left out, as of SSIM
    moving_share                   of all pixels, those that move
    gain, residual                 with a and c the deviation of the pictures and of the ground truth from their mean
                                   over time, per camera: g = Σ a·c / Σ c², rms(a − g c) / rms(c); None where
                                   nothing changes
    n_images

    Raises BenchError for a picture that is missing or of another size, CaptureError for one that is torn.
    """
    sums = _Sums()
    cache: dict[bytes, dict[str, float]] = {}
    with progress(label, len(capture), unit="images", brief=True) as update:
        for rows in cameras_of(capture):
            _score_camera(video_of(capture, rows), video_of(capture, rows, folder), lpips, sums, cache)
            update(len(sums.pictures))
    gain, residual = regressed(sums.products)
    mse = _mean(sums.moving, "mse_moving")
    return {
        "n_images": len(sums.pictures),
        **{k: _mean(sums.pictures, k) for k in ("ssim", "psnr_db", "flip", "lpips")},
        "ssim_moving": _mean(sums.moving, "ssim_moving"),
        "psnr_moving_db": None if mse is None else decibels(mse),
        "moving_share": sums.n_moving / sums.n_pixels,
        "gain": gain,
        "residual": residual,
    }


def moving_pixels(truth: np.ndarray) -> np.ndarray:
    """Return [H, W] bool: pixels of a video [T, H, W, 3] that differ from their mean over time by more than `MOVES`."""
    return np.asarray((np.abs(truth - truth.mean(0)) > MOVES).any((0, 3)))


def _score_camera(
    truth: np.ndarray,
    made: np.ndarray,
    lpips: Metric | None,
    sums: _Sums,
    cache: dict[bytes, dict[str, float]],
) -> None:
    mask = moving_pixels(truth)
    a, c = (v.astype(np.float64) - v.mean(0, dtype=np.float64) for v in (made, truth))
    sums.products += [(a * a).sum(), (a * c).sum(), (c * c).sum()]
    sums.n_moving += int(mask.sum())
    sums.n_pixels += mask.size
    # equal pictures, of motion within its period, score alike
    keys = [content_key(m, t, mask) for m, t in zip(made, truth, strict=True)]
    todo = {key: i for i, key in enumerate(keys) if key not in cache}
    with ThreadPoolExecutor(_THREADS) as pool:
        found = pool.map(lambda i: _score(made[i], truth[i], mask, lpips), todo.values())
        cache |= dict(zip(todo, found, strict=True))
    sums.pictures += [cache[key] for key in keys]
    sums.moving += [cache[key] for key in keys if "ssim_moving" in cache[key]]


def _score(made: np.ndarray, truth: np.ndarray, mask: np.ndarray, lpips: Metric | None) -> dict[str, float]:
    similar = ssim_map(made, truth)
    b = SSIM_BORDER
    scores = {"ssim": float(similar[b:-b, b:-b].mean()), "psnr_db": psnr(made, truth)}
    if has_flip():
        scores["flip"] = flip(made, truth)
    if lpips is not None:
        scores["lpips"] = lpips(made, truth)
    inside = np.zeros_like(mask)
    inside[b:-b, b:-b] = mask[b:-b, b:-b]
    if inside.any():
        scores["ssim_moving"] = float(similar[inside].mean())
        scores["mse_moving"] = float(((made[inside].astype(np.float64) - truth[inside]) ** 2).mean())
    return scores


def _mean(scores: list[dict[str, float]], key: str) -> float | None:
    known = [s[key] for s in scores if key in s]
    return float(np.mean(known)) if known else None


def with_closure(rows: Mapping[str, dict[str, Any]], still: str, ceiling: str) -> None:
    """Add `closure` and `ssim_gap` to every row's scores of one set and α.

    `closure` is SSIM on a scale from the row `still` (0) to the row `ceiling` (1); `ssim_gap` is the SSIM of `ceiling`
    less that of the row.
    """
    rest, best = (rows.get(name, {}).get("ssim") for name in (still, ceiling))
    for scores in rows.values():
        ours = scores.get("ssim")
        if ours is None or rest is None or best is None:
            scores["closure"] = scores["ssim_gap"] = None
        else:
            scores["closure"], scores["ssim_gap"] = closure(ours, rest, best), best - ours


def cameras_of(capture: Capture) -> list[np.ndarray]:
    """Return the indices of each camera's images in order of time."""
    found = []
    for camera in np.unique(capture.camera_ids):
        rows = np.flatnonzero(capture.camera_ids == camera)
        found.append(rows[np.argsort(capture.timesteps[rows], kind="stable")])
    return found


def most_changing(capture: Capture) -> tuple[np.ndarray, np.ndarray]:
    """Return indices in order of time, and video, of the camera with the most variable pictures."""
    videos = ((rows, video_of(capture, rows)) for rows in cameras_of(capture))
    return max(videos, key=lambda found: float(found[1].var(0).mean()))


def picture_name(capture: Capture, image: int) -> Path:
    """Return the path of a method's picture in its folder: that of the image in the dataset, as PNG."""
    return capture.paths[image].relative_to(capture.root).with_suffix(".png")


def video_of(capture: Capture, rows: np.ndarray, root: Path | None = None) -> np.ndarray:
    """Load the images `rows`, or a method's pictures of them in `root`, as [T, H, W, 3] float32 in 0..1 over white.

    Raises BenchError for a file that is missing, leads out of `root` or has another size, CaptureError for a truncated
    one.
    """
    frames = []
    for i in rows.tolist():
        path = capture.paths[i]
        if root is not None:
            path = root / picture_name(capture, i)
            if not path.is_file():
                raise BenchError(f"{path} does not exist: every picture of the test split is needed")
            if not path.resolve().is_relative_to(root.resolve()):
                raise BenchError(f"{path} leads out of its folder, to {path.resolve()}")
        image = decode(path)
        if image.shape[:2] != (capture.height, capture.width):
            size = f"{image.shape[1]}×{image.shape[0]}"
            raise BenchError(f"{path}: is {size} pixels, expected {capture.width}×{capture.height}")
        frames.append(ImageStack(image[None]).rgb(0, background=BACKGROUND))
    return np.stack(frames)


@dataclass(frozen=True)
class Checkout:
    """A metric's program in the user's checkout."""

    metric: str  # of PROGRAMS
    folder: Path
    python: str = "python3"  # of an environment with the checkout's requirements

    @property
    def program(self) -> Path:
        return self.folder / PROGRAMS[self.metric][0]

    def checked(self) -> "Checkout":
        """Return itself. Raises BenchError if the program does not exist."""
        if not self.program.is_file():
            raise BenchError(f"{OPTIONS[self.metric]} {self.folder}: holds no {self.program.name}")
        return self

    def __call__(self, video: np.ndarray, fps: float) -> float:
        """Score a video [T, H, W, 3] uint8. Raises BenchError if the program fails or prints no number."""
        with tempfile.TemporaryDirectory(prefix="tg4mm-") as folder:
            path = Path(folder) / "video.mp4"
            write_mp4(path, list(video), fps, loops_to_last(len(video), fps, _SECONDS), 1, quality=12)
            return self._run(path)

    def _run(self, path: Path) -> float:
        command = [self.python, *PROGRAMS[self.metric], str(path)]
        where = f"{OPTIONS[self.metric]} {self.folder}"
        try:
            done = subprocess.run(
                command,
                cwd=self.folder,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=60 * _MINUTES,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise BenchError(f"{where}: {' '.join(command[:2])} did not run: {error}") from None
        if done.returncode != 0:
            message = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()[-1]
            raise BenchError(f"{where}: ended with status {done.returncode}: {message[:200]}")
        last = (done.stdout.strip().splitlines() or [""])[-1]
        found = _NUMBER.findall(last)
        if not found:
            raise BenchError(
                f"{where}: the last line that it printed is {last[:200]!r}, expected one with the score"
            )
        return float(found[-1].rstrip("."))


def checkouts(folders: Mapping[str, Path | None], python: str) -> tuple[Checkout, ...]:
    """Return the checkouts of the given folders. Raises BenchError for a folder without the program."""
    return tuple(Checkout(m, f.resolve(), python).checked() for m, f in folders.items() if f is not None)
