"""Plates that move by .05 to 3 px in one film: found over true amplitude by `look` and `measure`.

python -m benchmarks whole_pixels DIR --codec libx264    # keeps the film in DIR
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.calibration.film import Coding, Film, Layer, sliding, texture, write_video
from tg4mm.capture.look import look
from tg4mm.show.measure import Sensor, SensorResult, prepare_video
from tg4mm.show.measure.measurement import measure_one

OPTIONS: dict[str, Any] = {"out": Path, "--codec": "libx264", "--seed": 0}
WIDTH, HEIGHT, FPS, FRAMES, BITS_PER_S, NOISE = 480, 270, 30, 160, 8_000_000, 2.5
SIZES_PX, HZ = (0.05, 0.2, 0.5, 1.0, 2.0, 3.0), (9.7, 7.9, 6.1, 4.7, 3.3, 2.1)
DIRECTION = np.array([0.8, -0.6])  # right and down
_HALF, _RADIUS = 48, 28  # pixels, of a plate's window, and of the sensor in it
_CENTRES = [(82 + 158 * (i % 3), 68 + 136 * (i // 3)) for i in range(len(SIZES_PX))]


def moves(k: int, times_s: float | np.ndarray) -> np.ndarray:
    """[..., 2] pixels right and down of plate k."""
    return SIZES_PX[k] * np.cos(2 * np.pi * HZ[k] * np.asarray(times_s) + 0.7)[..., None] * DIRECTION


def film(seed: int) -> Film:
    """Band-limited textures, shifted exactly behind windows that stand still."""
    rng, side = np.random.default_rng(seed), 2 * _HALF + 32
    back = texture(HEIGHT, WIDTH, rng, 0.25, 0.35, [2.0, 6.0, 20.0])
    plates = [
        sliding(texture(side, side, rng, 0.4, 0.4, [1.3, 3.0, 9.0]), centre, partial(moves, k))
        for k, centre in enumerate(_CENTRES)
    ]
    return Film([Layer(back, None, [], 0.55)], FPS, FRAMES, NOISE, painters=plates, seed=seed)


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
    video = options.out / f"{options.codec}.mp4"
    if not video.exists():
        write_video(video, film(options.seed).pictures(), FPS, Coding(options.codec, BITS_PER_S, None))
    lines = look(video).lines
    scene = prepare_video(video)
    print("| true, px | look | measure |\n|---:|---:|---:|")
    for k, (x, y) in enumerate(_CENTRES):
        own = [n.amplitude_px / SIZES_PX[k] for n in lines if abs(n.hz - HZ[k]) < 0.5 * FPS / FRAMES]
        found = measure_one(scene, Sensor(f"{SIZES_PX[k]} px", "pixel", (x, y, _RADIUS), video.stem))
        print(f"| {SIZES_PX[k]} | {own[0] if own else np.nan:.2f} | {figures(found, k)} |")
