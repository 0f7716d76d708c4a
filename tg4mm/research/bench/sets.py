"""Datasets of the benchmark: name, size, motion in pixels, and the band of the motion."""

import hashlib
import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.capture import Capture, load_capture
from tg4mm.capture.dataset_tree import magnified_alphas
from tg4mm.capture.truth_file import TRUTH_FILE, Truth, load_truth
from tg4mm.core.errors import CaptureError, RunError, Tg4mmError
from tg4mm.core.files import to_json
from tg4mm.core.phasors import peak_displacement
from tg4mm.core.work_folder import read_object
from tg4mm.research.bench import BenchError
from tg4mm.research.bench.folder import files_state

HALF_BAND_HZ = 1.5  # [TG4MM] §IV.B: 3.5 to 6.5 Hz for motion at 5 Hz, 1.5 to 4.5 Hz for 3 Hz
GOAL_AMPLITUDES_PX = (0.02, 0.2)  # amplitudes with a goal of displacement error
_SHOWN_ALPHA = 20
_SAME_AMPLITUDE = 3.0  # factor within which a set has one of those amplitudes


@dataclass(frozen=True)
class BenchSet:
    """One dataset with ground truth."""

    label: str  # unique among the sets of one benchmark, a folder's name
    root: Path
    width: int  # pixels
    height: int
    n_timesteps: int
    n_views: int  # training cameras
    fps: float  # Hz
    frequency_hz: float  # of the strongest mode
    amplitude_px: float  # its largest displacement in the first training camera, pixels
    band_hz: tuple[float, float]
    alphas: tuple[int, ...]  # with ground truth, above 0
    cameras: str  # the generator's kind of cameras, otherwise one of tg4mm.capture's KINDS
    digest: str  # of the set's description, so that figures of another set with that name are not used
    torn: Mapping[int, str] = field(default_factory=dict)  # α with incomplete ground truth: the reason
    scene: str = ""  # sets of one scene, with other seeds or motions, are similar

    @property
    def group(self) -> str:
        """Name of the group whose figures are averaged: one size, kind of capture and approximate amplitude."""
        return f"{self.width}×{self.height}, {self.cameras}, {amplitude_name(self.amplitude_px)}"

    def plain(self) -> dict[str, Any]:
        """Return the set in JSON's types, for results.json."""
        torn = {str(alpha): why for alpha, why in self.torn.items()}
        fields: dict[str, Any] = to_json({**asdict(self), "root": str(self.root), "torn": torn}, "set")
        return fields


def goal_amplitude(pixels: float) -> float | None:
    """Return the amplitude of `GOAL_AMPLITUDES_PX` near a motion of so many pixels, or None."""
    near = [
        a for a in GOAL_AMPLITUDES_PX if pixels > 0 and abs(math.log(pixels / a)) < math.log(_SAME_AMPLITUDE)
    ]
    return min(near, key=lambda a: abs(math.log(pixels / a)), default=None)


def amplitude_name(pixels: float) -> str:
    """Return the near goal's amplitude, such as `0.2 px`, otherwise the amplitude with one digit."""
    goal = goal_amplitude(pixels)
    return f"{goal:g} px" if goal is not None else f"{pixels:.1g} px"


def group_titles(sets: Sequence[BenchSet]) -> dict[str, str]:
    """Return {set's label: its group with its amplitudes}, such as `128×128, orbit, 0.15 to 0.27 px`."""
    titles = {}
    for data in sets:
        pixels = sorted(s.amplitude_px for s in sets if s.group == data.group)
        ends = " to ".join(dict.fromkeys(f"{p:.2g}" for p in (pixels[0], pixels[-1])))
        titles[data.label] = f"{data.width}×{data.height}, {data.cameras}, {ends} px"
    return titles


def open_sets(given: Sequence[Path]) -> list[BenchSet]:
    """Read the descriptions of datasets, each DIR or NAME=DIR.

    Raises BenchError or CaptureError for the first unusable one.
    """
    return [open_set(root, label) for label, root in labelled(given).items()]


def open_those_that_open(
    given: Sequence[Path], alphas: Sequence[float] | None = None
) -> tuple[list[BenchSet], list[dict[str, str]]]:
    """Return the usable datasets, and reasons against the others as [{set, method, why}].

    Raises BenchError for no dataset, the same twice or two of one name, and the first error if none is usable.
    """
    found, failed, first = [], [], None
    for label, root in labelled(given).items():
        try:
            data = open_set(root, label)
            check_alphas([data], alphas)
            found.append(data)
        except (Tg4mmError, OSError) as error:
            first = first or error
            failed.append({"set": label, "method": "", "why": str(error)})
    if first is not None and not found:
        raise first
    return found, failed


def labelled(given: Sequence[Path]) -> dict[str, Path]:
    """Return {name: dataset}, with the name of `NAME=DIR` or the folder's name of `DIR`, for tables and folders.

    A name depends on nothing else, so that a job of one dataset finds the folders of a call with many. Raises
    BenchError for no dataset, the same twice, two of one name, and an invalid folder name.
    """
    if not given:
        raise BenchError("no dataset is named: give at least one folder")
    found: dict[str, Path] = {}
    for one in given:
        name, sign, folder = str(one).partition("=")
        if sign and folder and not Path(one).exists():
            check_name(name, f"dataset {one}")
        else:
            name, folder = Path(one).resolve().name, str(one)
        if any(Path(folder).resolve() == other.resolve() for other in found.values()):
            raise BenchError(f"dataset {one} is named twice")
        if name in found:
            raise BenchError(
                f"datasets {found[name]} and {folder} are both called {name}: give one as NAME=DIR"
            )
        found[name] = Path(folder)
    return found


def check_name(name: str, where: str) -> None:
    """Raise BenchError for a name that no folder can have."""
    if not name or not all(c.isalnum() or c in "-_." for c in name) or name[0] in ".-":
        raise BenchError(
            f"{where}: the name may hold letters, digits and - _ . and must not begin with . or -"
        )


def check_alphas(sets: Sequence[BenchSet], alphas: Sequence[float] | None) -> None:
    """Raise BenchError for a set without ground truth for any requested α."""
    for data in sets:
        if alphas is not None and not set(alphas) & set(data.alphas):
            asked, there = (", ".join(f"{a:g}" for a in some) for some in (alphas, data.alphas))
            raise BenchError(f"--alphas {asked}: dataset {data.root} has ground truth for {there}")
        if missing := sorted(set(alphas or ()) - set(data.alphas) - {0}):
            lacks = ", ".join(f"{a:g}" for a in missing)
            warnings.warn(f"dataset {data.root} has no ground truth for α = {lacks}: left out", stacklevel=2)


def open_set(root: Path, label: str) -> BenchSet:
    """Read the description of a dataset. Raises CaptureError, and BenchError without ground truth."""
    root = Path(root)
    capture = load_capture(root)
    if capture.n_timesteps < 2:
        raise BenchError(f"dataset {root} has one timestep: there is no motion to measure")
    if not (root / TRUTH_FILE).is_file():
        raise BenchError(f"dataset {root} has no {TRUTH_FILE}: a benchmark needs ground truth")
    alphas = magnified_alphas(root)
    if not alphas:
        raise BenchError(f"dataset {root} has no magnified/x… folder: a benchmark needs ground truth")
    truth = load_truth(root, capture.fps, capture.n_timesteps)
    pixels = mode_pixels(truth, capture)
    magnified = np.ones(len(pixels), bool) if truth.magnified is None else truth.magnified
    moving = np.flatnonzero((pixels > 0) & magnified & (truth.freqs_hz > 0))
    if not len(moving):
        raise BenchError(f"dataset {root}: nothing that is magnified moves in it")
    strongest = moving[pixels[moving].argmax()]
    digest = _digest(root)
    torn = _torn(root.resolve(), digest, alphas)
    return BenchSet(
        label=label,
        root=root.resolve(),
        width=capture.width,
        height=capture.height,
        n_timesteps=capture.n_timesteps,
        n_views=int((capture.timesteps == 0).sum()),
        fps=capture.fps,
        frequency_hz=float(truth.freqs_hz[strongest]),
        amplitude_px=float(pixels[strongest]),
        band_hz=band_around(truth.freqs_hz[moving], capture.fps),
        alphas=tuple(a for a in alphas if a not in torn),
        cameras=_filmed(root, capture.kind),
        digest=digest,
        torn=torn,
        scene=_scene(root) or label,
    )


def _torn(root: Path, digest: str, alphas: Sequence[int]) -> dict[int, str]:
    """Return reasons why ground truth cannot be read, by α. Raises CaptureError for α = 0."""
    _captured(root, digest, 0)
    found = {}
    for alpha in alphas:
        try:
            _captured(root, digest, alpha)
        except (Tg4mmError, OSError) as error:
            found[alpha] = str(error)
    if len(found) == len(alphas):
        raise CaptureError(found[alphas[0]])
    return found


def torn_truth(sets: Iterable[BenchSet], alphas: Sequence[float] | None) -> list[dict[str, str]]:
    """Return [{set, method, why}] for the requested α with incomplete ground truth."""
    return [
        {"set": data.label, "method": "", "why": f"α = {alpha}: {why}"}
        for data in sets
        for alpha, why in data.torn.items()
        if alphas is None or alpha in alphas
    ]


def band_around(freqs_hz: np.ndarray, fps: float) -> tuple[float, float]:
    """Return the band of the frequencies and `HALF_BAND_HZ` on either side, inside 0 … fps/2, Hz."""
    low = max(float(freqs_hz.min()) - HALF_BAND_HZ, 0.0)
    return low, min(float(freqs_hz.max()) + HALF_BAND_HZ, fps / 2 - fps / 1000)


def mode_pixels(truth: Truth, capture: Capture) -> np.ndarray:
    """Return each mode's largest displacement [K], first-order pixels of the first training camera."""
    viewmat, k = capture.viewmats[0], capture.Ks[0]
    largest = np.zeros(len(truth.freqs_hz))
    for body in truth.objects:
        if not len(body.rest):
            continue
        x = body.rest @ viewmat[:3, :3].T + viewmat[:3, 3]
        seen = x[:, 2] > 1e-6
        if not seen.any():
            continue
        x, d = x[seen], body.modes[:, seen] @ viewmat[:3, :3].T  # [V, 3], [K, V, 3]
        across = (d[..., :2] - d[..., 2:] * (x[:, :2] / x[:, 2:])) / x[:, 2:]
        largest = np.maximum(largest, peak_displacement(across * np.array([k[0, 0], k[1, 1]])).max(1))
    return largest


def alpha_to_show(alphas: Iterable[int]) -> int:
    """Return the α of shown pictures, by its ratio the nearest to 20; 0 without any."""
    return min(alphas, key=lambda a: abs(math.log(a / _SHOWN_ALPHA)), default=0)


def _described(root: Path, key: str) -> Any:
    """Return an entry of scene.json, or None."""
    try:
        return read_object(root / "scene.json").get(key)
    except RunError:  # not from the generator
        return None


def _scene(root: Path) -> str:
    named = _described(root, "scene")
    return named if isinstance(named, str) else ""


def _filmed(root: Path, kind: str) -> str:
    """Return the kind of cameras; only the generator distinguishes an orbit from a rig."""
    from dataset_gen.cameras import KINDS

    cameras = _described(root, "cameras")
    named = cameras.get("kind") if isinstance(cameras, dict) else None
    return named if isinstance(named, str) and named in KINDS and named != "given" else kind


def truth_at(data: BenchSet, alpha: float) -> Capture:
    """Return the test split with the motion times 1 + α."""
    return _captured(data.root, data.digest, int(alpha))


@lru_cache(maxsize=8)  # every method and row of a set needs the same few
def _captured(root: Path, digest: str, alpha: int) -> Capture:
    return load_capture(root, split="test", magnification=alpha)


def truth_state(data: BenchSet, alpha: float) -> str:
    """Return a digest of names, sizes and modification times of the test pictures at α."""
    truth = truth_at(data, alpha)
    state = repr(files_state(truth.paths, truth.root))
    return hashlib.sha256(state.encode()).hexdigest()[:16]


def _digest(root: Path) -> str:
    digest = hashlib.sha256()
    for file in (root / "scene.json", root / TRUTH_FILE):
        digest.update(file.read_bytes() if file.is_file() else b"")
    return digest.hexdigest()[:16]
