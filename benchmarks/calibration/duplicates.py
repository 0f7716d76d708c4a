"""Small films with and without duplicate frames: are duplicates found, and nothing else taken for one?

Half of the films have none, the others every fifth (24 in 30), every sixth (25 in 30) or every second frame, or some at
random, as screen recorders make them. A photograph or a texture vibrates as a whole, in part or not at all, by 0.1 to
2 px at 0.3 to 14 Hz, with noise of 0 to 6 grey levels, by x264 or x265 at crf 14 to 28.
"""

import json
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from benchmarks.calibration.film import Coding, write_video
from tg4mm.capture.duplicates import DuplicateMeter, Duplicates
from tg4mm.capture.video import grey_frames

WIDTH, HEIGHT, MARGIN = 160, 120, 32
PATTERNS = {"every fifth": Fraction(4, 5), "every sixth": Fraction(5, 6), "every second": Fraction(1, 2)}
KINDS = ("none",) * 4 + (*PATTERNS, "irregular")
_OWN = ("camera", "coins", "moon", "page", "text", "clock")  # scikit-image's pictures


@dataclass(frozen=True)
class Outcome:
    """One film, and what was found of its duplicates."""

    kind: str
    codec: str
    crf: int
    noise: float
    duplicates: int
    found: int  # of them
    false: int  # new pictures that were taken for duplicates

    @property
    def is_clear(self) -> bool:
        """Return whether the codec leaves the noise of most pictures."""
        return self.crf <= 20 and self.noise >= 3


def duplicates_outcome(seed: int, folder: Path, photographs: Path | None = None) -> Outcome:
    """Return the outcome for the film `seed`, made in `folder` where it is not there.

    Photographs: a folder of JPEG or PNG files.
    """
    notes = folder / f"{seed:04d}.duplicates.json"
    if not notes.exists():
        folder.mkdir(parents=True, exist_ok=True)
        video = notes.with_suffix(".mp4")
        kind, codec, crf, noise, is_new = _film(seed, video, photographs)
        found = found_in(video)
        again = np.zeros(len(is_new), bool) if found is None else ~found.is_new
        counts = (int(x.sum()) for x in (~is_new, again & ~is_new, again & is_new))
        notes.write_text(json.dumps(asdict(Outcome(kind, codec, crf, noise, *counts))))
    return Outcome(**json.loads(notes.read_text()))


def found_in(video: Path) -> Duplicates | None:
    """The duplicates that are found in a video."""
    meter = DuplicateMeter()
    for frame in grey_frames(video):
        meter.add(frame.grey, frame.is_alone, frame.is_between)
    return meter.found()


def duplicates_table(outcomes: list[Outcome]) -> str:
    """A row for each kind of films."""
    rows = ["| films | number | with duplicates found | frames found | new pictures lost |\n|-|-|-|-|-|"]
    for kind in dict.fromkeys(KINDS):
        for name, chosen in ((kind, False), (f"{kind}, noise ≥ 3 and crf ≤ 20", True)):
            own = [one for one in outcomes if one.kind == kind and one.is_clear >= chosen]
            total = sum(one.duplicates for one in own)
            share = f"{sum(one.found for one in own) / total:.0%}" if total else "–"
            hit, lost = sum(one.found + one.false > 0 for one in own), sum(one.false for one in own)
            rows.append(f"| {name} | {len(own)} | {hit} | {share} | {lost} |")
    return "\n".join(rows)


def _film(seed: int, path: Path, photographs: Path | None) -> tuple[str, str, int, float, np.ndarray]:
    rng = np.random.default_rng([77, seed])
    kind, fps = KINDS[seed % len(KINDS)], int(rng.choice([24, 25, 30, 30, 50, 60]))
    shown = _shown(rng, kind, int(rng.integers(90, 241)))
    is_new = np.diff(shown, prepend=-1) > 0
    share = PATTERNS.get(kind)
    times = np.flatnonzero(is_new) / fps if share is None else np.arange(shown[-1] + 1) / (fps * float(share))
    noise, crf = float(rng.choice([0.5, 1, 2, 3, 4, 5, 6])), int(rng.integers(14, 29))
    pictures = _moving(rng, _surface(rng, photographs), times, fps)
    pictures = [_noisy(rng, picture, noise) for picture in pictures]
    codec = str(rng.choice(["libx264", "libx265"]))
    preset, keys = str(rng.choice(["ultrafast", "veryfast", "medium"])), int(rng.choice([12, 30, 250]))
    write_video(path, np.stack(pictures)[shown], fps, Coding(codec, 0, keys, crf=crf, preset=preset))
    return kind, codec, crf, noise, is_new


def _shown(rng: np.random.Generator, kind: str, frames: int) -> np.ndarray:
    """[frames]: which picture each frame shows."""
    if kind == "irregular":
        again = rng.random(frames) < rng.uniform(0.05, 0.4)
        return np.cumsum(~again) - (not again[0])
    return np.floor(np.arange(frames) * float(PATTERNS.get(kind, 1)) + 1e-9).astype(int)


def _surface(rng: np.random.Generator, photographs: Path | None) -> np.ndarray:
    """Grey levels of a picture with a margin: one of the folder's, scikit-image's, or a texture."""
    size = np.array([HEIGHT, WIDTH]) + 2 * MARGIN
    files = sorted(photographs.glob("*.[jp][pn]g")) if photographs is not None else []
    choice = rng.integers(0 if files else 1, 3)
    if choice == 2:
        noise = sum(s * gaussian_filter(rng.normal(size=size), s) for s in (rng.uniform(1, 2), 3, 8))
        return np.clip(128 + rng.uniform(10, 50) * noise / noise.std(), 5, 250)
    if choice == 1:
        from skimage import data

        image = Image.fromarray(getattr(data, str(rng.choice(_OWN)))())
    else:
        image = Image.open(files[rng.integers(len(files))])
    grey = image.convert("L")
    least = float(max(size / np.array(grey.size[::-1])))  # its smallest scale
    scale = float(np.exp(rng.uniform(np.log(least), np.log(max(1.0, least)))))
    shape = [max(int(np.ceil(n * scale)), int(m)) for n, m in zip(grey.size, size[::-1], strict=True)]
    whole = np.asarray(grey.resize(shape), float)
    top, left = (int(rng.integers(0, n - m + 1)) for n, m in zip(whole.shape, size, strict=True))
    return whole[top : top + size[0], left : left + size[1]]


def _moving(rng: np.random.Generator, surface: np.ndarray, times: np.ndarray, fps: int) -> list[np.ndarray]:
    """The picture at these times, moved by phase, exactly."""
    count, is_still, is_whole = int(rng.integers(1, 3)), rng.random() < 0.25, rng.random() < 0.4
    hz = np.exp(rng.uniform(np.log(0.3), np.log(min(14, 0.48 * fps)), count))
    size = 0.0 if is_still else np.exp(rng.uniform(np.log(0.1), np.log(2), count))
    phase, angle = rng.uniform(0, 2 * np.pi, (2, count))
    swing = size * np.sin(2 * np.pi * hz * times[:, None] + phase)
    shifts = np.stack([(swing * np.cos(angle)).sum(1), (swing * np.sin(angle)).sum(1)], 1)
    spectrum = np.fft.rfft2(surface)
    down, right = np.fft.fftfreq(surface.shape[0])[:, None], np.fft.rfftfreq(surface.shape[1])[None]
    inside = (slice(MARGIN, MARGIN + HEIGHT), slice(MARGIN, MARGIN + WIDTH))
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    centre, half = rng.uniform([30, 25], [130, 95]), rng.uniform(15, 40)
    outside = np.maximum(abs(x - centre[0]), abs(y - centre[1])) - half
    mask = 1.0 if is_whole else 1 / (1 + np.exp(np.clip(2 * outside, -50, 50)))
    rest, out = surface[inside], []
    for across, along in shifts:
        moved = np.fft.irfft2(spectrum * np.exp(-2j * np.pi * (right * across + down * along)), surface.shape)
        out.append(rest + mask * (moved[inside] - rest))
    return out


def _noisy(rng: np.random.Generator, picture: np.ndarray, noise: float) -> np.ndarray:
    return np.clip(np.rint(picture + noise * rng.normal(size=picture.shape)), 0, 255).astype(np.uint8)
