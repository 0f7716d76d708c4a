"""Films made of real photographs: two parts of each vibrate, stored without loss and at three qualities.

A part either bends (the photograph is warped, smoothly into what stands around it) or is a body cut from a second
photograph, whose edge covers and uncovers the first. Film n is seeds 4 n to 4 n + 3, the same pictures coded in turn
without loss, at crf 12, 18 and 23. The photographs are those that scikit-image brings along: films 0 to 499 take the
first half of them, those from 500 on the second, so that what was worked out on one half is judged on the other.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import skimage
from PIL import Image, ImageOps
from scipy import ndimage

from benchmarks.calibration.draw import Draw, FilmTruth, TrueVibration, kept_film
from benchmarks.calibration.film import Coding, Region, area_means

NAMES = (
    *("astronaut.png", "camera.png", "coffee.png", "grass.png", "motorcycle_left.png", "moon.png"),
    *("brick.png", "chelsea.png", "coins.png", "gravel.png", "rocket.jpg", "hubble_deep_field.jpg"),
)
QUALITIES = (0, 12, 18, 23)  # crf of x264; 0 is qp 0, without loss
_SEEDS, _HALVES = 90_000, 500  # of these films on; of films, from which on the second half
_SIZE = 256, 192  # width and height, pixels
_FINE = 2  # pixels of a photograph a pixel
_LEAST_PX, _MOST_PX = 0.02, 3.0
_NOISE = 0.5, 3.0  # grey levels
_MOST = 240  # pictures


def make_photograph_film(seed: int, folder: Path) -> FilmTruth:
    """Film seed // 4 at quality seed % 4."""
    return kept_film(seed, folder, lambda: _drawn(seed))


@dataclass(frozen=True)
class _Part:
    """A vibrating part: the pixels where its motion is 1, and its opacity in front of the photograph."""

    vibration: TrueVibration
    box: tuple[slice, slice]  # pixels
    share: np.ndarray  # [h, w] of the motion, at pixels' centres
    light: np.ndarray  # spline coefficients [2 h, 2 w] of what it shows
    opacity: np.ndarray | None  # of a body; None: it bends


def _drawn(seed: int) -> tuple[np.ndarray, Coding, FilmTruth]:
    shown, truth = _film(seed // len(QUALITIES))
    crf = QUALITIES[seed % len(QUALITIES)]
    truth = replace(truth, codec=f"libx264 crf {crf}", bits_per_pixel=0.0)
    return shown, Coding("libx264", 0, crf=crf), truth


@lru_cache(1)
def _film(number: int) -> tuple[np.ndarray, FilmTruth]:
    draw = Draw(_SEEDS + number)
    rng, (width, height), frames = draw.rng, _SIZE, min(draw.frames, _MOST)
    draw.duration = frames / draw.fps
    names = NAMES[: len(NAMES) // 2] if number < _HALVES else NAMES[len(NAMES) // 2 :]
    blur = float(rng.uniform(0, 0.7))
    first = number % len(names)
    behind = _photograph(names[first], rng, blur)
    other = _photograph(names[(first + int(rng.integers(1, len(names)))) % len(names)], rng, blur)
    parts = []
    for left in (6, width // 2 + 6):
        w, h = int(rng.integers(36, 88)), int(rng.integers(40, 110))
        x, y = left + int(rng.integers(0, width // 2 - 11 - w)), int(rng.integers(6, height - 5 - h))
        is_body = bool(rng.random() < 0.5)
        vibration = _vibration(draw, (x, y, x + w, y + h), is_body and bool(rng.random() < 0.5))
        draw.truth.vibrations.append(vibration)
        parts.append(_part(vibration, other if is_body else behind, is_body, float(rng.uniform(10, 24))))
    light = draw.light()
    noise = float(rng.uniform(*_NOISE))
    rest = area_means(behind, _FINE)
    shown = np.empty((frames, height, width), np.uint8)
    for k in range(frames):
        picture, t = rest.copy(), k / draw.fps
        for part in parts:
            _paint(picture, part, t)
        picture = picture * light(t) + noise * rng.standard_normal(picture.shape)
        shown[k] = np.clip(np.round(picture), 0, 255)
    truth = replace(draw.truth, width=width, height=height, frames=frames, noise=noise)
    return shown, truth


def _vibration(draw: Draw, region: Region, is_tilted: bool) -> TrueVibration:
    rng, drawn = draw.rng, draw.vibration(region, is_tilted, 1.0)
    size = float(np.exp(rng.uniform(np.log(_LEAST_PX), np.log(_MOST_PX)))) / drawn.size_px
    return replace(drawn, amplitude_px=(size * drawn.amplitude_px[0], size * drawn.amplitude_px[1]))


def _photograph(name: str, rng: np.random.Generator, blur_px: float) -> np.ndarray:
    """Grey levels [2 H, 2 W] of a photograph, cut to the film's sides."""
    with Image.open(Path(skimage.__file__).parent / "data" / name) as file:
        photograph = file.convert("L")
    width, height = (_FINE * n for n in _SIZE)
    where = (float(rng.random()), float(rng.random()))
    fine = ImageOps.fit(photograph, (width, height), Image.Resampling.LANCZOS, centering=where)
    return ndimage.gaussian_filter(np.asarray(fine, np.float32), blur_px * _FINE)


def _part(vibration: TrueVibration, fine: np.ndarray, is_body: bool, reach: float) -> _Part:
    left, upper, right, lower = vibration.region
    width, height = _SIZE
    margin = 8 if is_body else int(reach) + 8
    rows = slice(max(upper - margin, 0), min(lower + margin, height))
    columns = slice(max(left - margin, 0), min(right + margin, width))
    y, x = np.mgrid[rows, columns] + 0.5
    rise = np.clip((lower - y) / (lower - upper), 0, 1) if vibration.tilted else np.ones_like(y)
    beside = np.maximum(np.maximum(left - x, x - right), np.maximum(upper - y, y - lower)) / reach
    share = rise if is_body else rise * _smooth(1 - beside)
    rows_fine, columns_fine = (slice(_FINE * s.start, _FINE * s.stop) for s in (rows, columns))
    light = ndimage.spline_filter(fine[rows_fine, columns_fine], 3, output=np.float32, mode="mirror")
    opacity = None
    if is_body:
        fy, fx = (np.mgrid[rows_fine, columns_fine] + 0.5) / _FINE
        across = np.abs((fx - (left + right) / 2) / ((right - left) / 2))
        along = np.abs((fy - (upper + lower) / 2) / ((lower - upper) / 2))
        beyond = ((across**6 + along**6) ** (1 / 6) - 1) * min(right - left, lower - upper) / 2
        opacity = ndimage.spline_filter(np.clip(0.5 - beyond, 0, 1), 3, output=np.float32, mode="mirror")
    return _Part(vibration, (rows, columns), share, light, opacity)


def _smooth(x: np.ndarray) -> np.ndarray:
    x = np.clip(x, 0, 1)
    return np.asarray(x * x * (3 - 2 * x))


def _paint(picture: np.ndarray, part: _Part, time_s: float) -> None:
    """Moves a part to where it is at a time, in the picture itself."""
    motion = part.vibration.motion()(time_s) * np.array(part.vibration.amplitude_px)
    h, w = part.light.shape
    y, x = (np.mgrid[:h, :w] + 0.5) / _FINE - 0.5
    right, down = np.zeros_like(x), np.zeros_like(y)
    for _ in range(1 if np.abs(motion).max() < 0.05 else 5):  # where a point that is here now is at rest
        share = ndimage.map_coordinates(part.share, [y - down, x - right], order=1, mode="nearest")
        right, down = motion[0] * share, motion[1] * share
    at = [(y - down + 0.5) * _FINE - 0.5, (x - right + 0.5) * _FINE - 0.5]
    shown = _seen(part.light, at)
    if part.opacity is not None:
        opacity = np.clip(_seen(part.opacity, at), 0, 1)
        shown = picture[part.box] * (1 - opacity) + shown * opacity
    picture[part.box] = shown


def _seen(spline: np.ndarray, at: list[np.ndarray]) -> np.ndarray:
    return area_means(ndimage.map_coordinates(spline, at, order=3, prefilter=False, mode="mirror"), _FINE)
