"""A dataset read back from its files: description, cameras, pictures, exact motion; words and units of them."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture.cameras import read_intrinsics, read_pose
from tg4mm.capture.confine import inside
from tg4mm.capture.scene import read_scene
from tg4mm.capture.truth_file import TRUTH_FILE, TruthObject, load_truth
from tg4mm.core.errors import CaptureError
from tg4mm.core.pages.svg import number
from tg4mm.core.pictures import exr
from tg4mm.core.pictures.decode import decode, image_header
from tg4mm.core.records import Record, read_record

from ..errors import GenerateError
from ..pictures import straight, to_display
from ..plan import magnified_folder

SUFFIXES = (".png", ".jpg", ".jpeg", ".exr")
SPLITS = ("train", "test")


@dataclass(frozen=True)
class View:
    """One picture of the dataset: where it lies, when and from where it was taken."""

    split: str
    timestep: int
    name: str  # "r_000"
    image: Path
    camera_to_world: np.ndarray  # [4, 4], OpenGL axes
    intrinsics: tuple[float, float, float, float]  # fx, fy, cx, cy, pixels
    size: tuple[int, int]  # width, height, pixels


@dataclass(frozen=True)
class MotionTruth:
    """The exact motion: displacement(t) = Re Σ_k mode_k g_k(t), with g_k the gains."""

    frequencies_hz: np.ndarray  # [K]
    gains: np.ndarray  # [T, K] complex
    bodies: tuple[TruthObject, ...]
    magnified: np.ndarray  # [K] bool, whether α applies to the mode

    def largest(self) -> float:
        """Largest displacement of any vertex at any timestep, scene units."""
        return float(max((self.size(t) for t in range(len(self.gains))), default=0.0))

    def size(self, timestep: int) -> float:
        """Largest displacement of any vertex at a timestep, scene units."""
        moved = (displacement_of(body.modes, self.gains[timestep]) for body in self.bodies)
        return float(max((np.linalg.norm(d, axis=1).max(initial=0.0) for d in moved), default=0.0))


def displacement_of(modes: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """Displacement [V, 3] of modes [K, V, 3] with gains [K]."""
    return np.tensordot(gains, modes, axes=1).real


@dataclass(frozen=True)
class Dataset:
    """What a finished folder holds."""

    root: Path
    scene: dict[str, Any]
    fps: float
    n_timesteps: int
    views: dict[str, list[View]]  # per split, by timestep, then in the order of the files
    motion: MotionTruth | None
    unit_scale_m: float | None = None
    alphas: tuple[float, ...] = ()
    strength: tuple[float, ...] = field(default=())  # [T] largest displacement per timestep, () if unknown

    def at(self, split: str, timestep: int) -> list[View]:
        """Views of a split at a timestep."""
        return [view for view in self.views[split] if view.timestep == timestep]

    def by_camera(self, split: str) -> dict[str, list[View]]:
        """Views of a split by their file's name, each list in order of time."""
        found: dict[str, list[View]] = {}
        for view in self.views[split]:
            found.setdefault(view.name, []).append(view)
        return found

    def truth_file(self, view: View) -> Path:
        """Where the truth of a view at α = 0 lies, if it was asked for."""
        return self.root / "truth" / view.split / f"{view.timestep:03d}" / f"{view.name}.exr"

    def magnified(self, view: View, alpha: float) -> Path:
        """The ground truth picture at α of a test view."""
        relative = view.image.relative_to(self.root)
        return self.root / magnified_folder(alpha) / relative

    @property
    def amplitude(self) -> float:
        """Largest displacement over all timesteps, scene units; as described where the truth is absent."""
        return max(self.strength) if self.strength else float(self.scene.get("amplitude") or 0.0)

    def timesteps_by_strength(self) -> list[int]:
        """Timesteps, those that lie farthest from rest first; in order of time where that is not known."""
        order = range(self.n_timesteps)
        if not self.strength:
            return list(order)
        # Rounded, so that of timesteps that differ by rounding alone the earliest comes first.
        return sorted(order, key=lambda t: -round(self.strength[t] / (self.amplitude or 1.0), 4))

    def nearest_to_rest(self) -> int:
        """The timestep whose pictures are nearest to the rest pose; 0 where that is not known."""
        return min(range(self.n_timesteps), key=lambda t: round(self.strength[t], 12)) if self.strength else 0


def read_dataset(root: Path) -> Dataset:
    """Reads the folder. Raises GenerateError with file and reason if it is no dataset tree."""
    try:
        described = read_scene(root, needs_fps=True)
    except CaptureError as error:
        raise GenerateError(str(error)) from error
    scene, fps = described.values, described.fps
    folders = sorted(
        (p for p in root.iterdir() if re.fullmatch(r"[0-9]+", p.name)), key=lambda p: int(p.name)
    )
    if not folders:
        raise GenerateError(f"{root}: holds no timestep folders 000, 001, …")
    views = {split: [v for folder in folders for v in _views(root, folder, split)] for split in SPLITS}
    motion = _motion(root, len(folders), fps)
    alphas = tuple(a for a in scene.get("alphas") or () if isinstance(a, int | float))
    return Dataset(
        root=root, scene=scene, fps=fps, n_timesteps=len(folders), views=views, motion=motion,
        unit_scale_m=described.unit_scale_m, alphas=alphas,
        strength=tuple(motion.size(t) for t in range(len(folders))) if motion else (),
    )  # fmt: skip


def read_picture(path: Path) -> np.ndarray:
    """A picture over white, [H, W, 3] float32 in 0..1, display-referred. Raises GenerateError."""
    try:
        if path.suffix == ".exr":
            return _read_exr_picture(path)
        pixels = decode(path)
    except (CaptureError, OSError) as error:
        raise GenerateError(f"{path}: cannot be read: {error}") from error
    values = pixels.astype(np.float32) / np.float32(np.iinfo(pixels.dtype).max)
    return values[..., :3] * values[..., 3:] + 1 - values[..., 3:]


def _read_exr_picture(path: Path) -> np.ndarray:
    """Scene-linear RGBA, alpha multiplied in as OpenEXR has it: encoded as sRGB, then over white."""
    image_header(path)
    colour, alpha = straight(exr.linear(path))
    return to_display(colour) * alpha[..., None] + 1 - alpha[..., None]


def _views(root: Path, folder: Path, split: str) -> list[View]:
    path = folder / f"transforms_{split}.json"
    if not path.is_file():
        return []
    try:
        file = read_record(path)
        frames = file.values.get("frames", [])
        if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
            raise file.error("frames", "a list of objects")
        return [_view(root, path, split, Record(f"{path}: frame {i}", v), file) for i, v in enumerate(frames)]
    except (CaptureError, OSError) as error:
        raise GenerateError(str(error)) from error


def _view(root: Path, path: Path, split: str, frame: Record, file: Record) -> View:
    stem = path.parent / frame.text("file_path")
    named = [stem] if stem.suffix in SUFFIXES else [stem.with_name(stem.name + s) for s in SUFFIXES]
    image = next((p for p in named if inside(root, p, "file_path").is_file()), named[0])
    width, height = ((frame if frame.has(key) else file).whole(key, 1) for key in "wh")
    K = read_intrinsics(frame, file, width, height)
    intrinsics = float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])
    return View(
        split, int(path.parent.name), image.stem, image, read_pose(frame), intrinsics, (width, height)
    )


def _motion(root: Path, n_timesteps: int, fps: float) -> MotionTruth | None:
    if not (root / TRUTH_FILE).is_file():
        return None
    try:
        truth = load_truth(root, fps, n_timesteps)
    except CaptureError as error:
        raise GenerateError(str(error)) from error
    gains, magnified = truth.gains, truth.magnified
    if gains is None:
        gains = np.exp(2j * np.pi * np.outer(truth.freqs_hz, np.arange(n_timesteps)) / fps)
    if magnified is None:
        magnified = np.ones(len(truth.freqs_hz), bool)
    return MotionTruth(truth.freqs_hz, gains.T, truth.objects, magnified)


def evenly(items: Sequence[Any], most: int) -> list[Any]:
    """At most `most` of the items, evenly spread, the first among them."""
    if len(items) <= most:
        return list(items)
    return [items[i * len(items) // most] for i in range(most)]


def length(value: float, unit_scale_m: float | None) -> str:
    """A length in scene units, and in metres where the scale is known."""
    text = f"{number(value)} units"
    return text if unit_scale_m is None else f"{text} ({metres(value * unit_scale_m)})"


def metres(value: float) -> str:
    """Metres as m, mm or µm."""
    for unit, factor in (("m", 1.0), ("mm", 1e-3)):
        if abs(value) >= factor:
            return f"{number(value / factor)} {unit}"
    return f"{number(value / 1e-6)} µm"


def unit_of(dataset: Dataset) -> tuple[str, float]:
    """Unit of lengths in charts, and the factor that scene units are multiplied with."""
    if dataset.unit_scale_m is None:
        return "scene units", 1.0
    largest = dataset.amplitude * dataset.unit_scale_m
    for unit, factor in (("m", 1.0), ("mm", 1e-3)):
        if largest >= factor:
            return unit, dataset.unit_scale_m / factor
    return "µm", dataset.unit_scale_m / 1e-6


def hertz(frequencies: Sequence[float]) -> str:
    """Different frequencies as "3 Hz and 5 Hz"."""
    words = [f"{number(f)} Hz" for f in sorted(set(frequencies))]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def percent(share: float) -> str:
    """A share of 1 in per cent."""
    return f"{number(100 * share)} %"


def decibel(value: float | None) -> str:
    """A PSNR with two decimals, a dash if there is none; equal pictures have the largest there is."""
    if value is None:
        return "–"
    return "equal" if value >= 100 else f"{value:.2f}"


def similarity(value: float | None) -> str:
    """An SSIM with four decimals."""
    return "–" if value is None else f"{value:.4f}"


def plural(count: int, word: str) -> str:
    """ "1 camera", "2 cameras"."""
    return f"{count:,} {word}{'' if count == 1 else 's'}"
