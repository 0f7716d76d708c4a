"""Plates that move by .05 to 3 px in one film: found over true amplitude, by the linear answer and iterated.

python -m benchmarks whole_pixels DIR --codec libx264    # keeps the film, its dataset and its run in DIR
"""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from benchmarks.calibration.film import FINE, Coding, texture, write_video
from tg4mm.capture.sfm.reconstruct import reconstruct
from tg4mm.run.train import train
from tg4mm.show.measure import Sensor, SensorResult, prepare
from tg4mm.show.measure.linearity import iterated
from tg4mm.show.measure.measurement import measure_one

OPTIONS: dict[str, Any] = {"out": Path, "--codec": "libx264", "--seed": 0}
WIDTH, HEIGHT, FPS, FRAMES, BITS_PER_S, NOISE = 480, 270, 30, 160, 8_000_000, 2.5
SIZES_PX, HZ = (0.05, 0.2, 0.5, 1.0, 2.0, 3.0), (9.7, 7.9, 6.1, 4.7, 3.3, 2.1)
DIRECTION = np.array([0.8, -0.6])  # right and down
_HALF, _RADIUS = 48, 28  # pixels, of a plate's window, and of the sensor in it
_CENTRES = [(82 + 158 * (i % 3), 68 + 136 * (i // 3)) for i in range(len(SIZES_PX))]


def moves(k: int, times_s: np.ndarray) -> np.ndarray:
    """[F, 2] pixels right and down of plate k."""
    return SIZES_PX[k] * np.cos(2 * np.pi * HZ[k] * times_s + 0.7)[:, None] * DIRECTION


def pictures(seed: int) -> np.ndarray:
    """[F, H, W] uint8: band-limited textures, shifted exactly (Fourier) behind windows that stand still."""
    rng = np.random.default_rng(seed)
    back = _pixels(texture(HEIGHT, WIDTH, rng, 0.25, 0.35, [2.0, 6.0, 20.0]))
    side = 2 * _HALF + 32
    fine = [texture(side, side, rng, 0.4, 0.4, [1.3, 3.0, 9.0]) for _ in SIZES_PX]
    spectra = [np.fft.rfft2(gaussian_filter(own, 0.55 * FINE, mode="wrap")) for own in fine]
    down, right = np.fft.fftfreq(side * FINE)[:, None], np.fft.rfftfreq(side * FINE)[None]
    window = gaussian_filter(np.pad(np.ones((side - 32, side - 32)), 16), 1.0)
    out = np.empty((FRAMES, HEIGHT, WIDTH), np.uint8)
    for f in range(FRAMES):
        picture = back.copy()
        for k, (x, y) in enumerate(_CENTRES):
            u = FINE * moves(k, np.array([f / FPS]))[0]
            turned = spectra[k] * np.exp(-2j * np.pi * (right * u[0] + down * u[1]))
            box = slice(y - side // 2, y + side // 2), slice(x - side // 2, x + side // 2)
            picture[box] += window * (_pixels(np.fft.irfft2(turned, (side * FINE,) * 2)) - picture[box])
        light = 255 * np.clip(picture, 0, 1) ** (1 / 2.2)
        out[f] = np.clip(np.rint(light + NOISE * rng.normal(size=light.shape)), 0, 255)
    return out


def _pixels(fine: np.ndarray) -> np.ndarray:
    """Means over squares."""
    height, width = (n // FINE for n in fine.shape)
    return np.asarray(fine.reshape(height, FINE, width, FINE).mean((1, 3)))


def figures(result: SensorResult, k: int) -> str:
    """Amplitude over the true one, and the series' rms error over the motion's rms."""
    times = result.series.times_s
    found = result.series.displacement * result.px_per_unit * [1, -1]
    true = moves(k, times)
    found, true = found - found.mean(0), true - true.mean(0)
    waves = np.stack([f(2 * np.pi * HZ[k] * times) for f in (np.cos, np.sin)], 1)
    size = float(np.linalg.norm(np.linalg.lstsq(waves, found, rcond=None)[0]) / SIZES_PX[k])
    error = float(np.sqrt(((found - true) ** 2).sum() / (true**2).sum()))
    return f"{size:.2f} ({error:.2f})"


def run(options: Any) -> None:
    """Prints a table."""
    options.out.mkdir(parents=True, exist_ok=True)
    video, data = options.out / f"{options.codec}.mp4", options.out / "set"
    if not video.exists():
        write_video(video, pictures(options.seed), FPS, Coding(options.codec, BITS_PER_S, None))
    reconstruct(video, data)
    scene = prepare(train(data, options.out / "run"), is_once=True)
    print("| true, px | linear | iterated |\n|---:|---:|---:|")
    for k, (x, y) in enumerate(_CENTRES):
        linear = measure_one(scene, Sensor(f"{SIZES_PX[k]} px", "pixel", (x, y, _RADIUS), video.stem))
        again = iterated(scene, linear)
        print(
            f"| {SIZES_PX[k]} | {figures(linear, k)} | {'as it is' if again is linear else figures(again, k)} |"
        )
