"""Still films whose wall is plain: shade, hardly any texture, and one to three textured boxes before it."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from benchmarks.calibration.draw import Draw, Truth, read_truth
from benchmarks.calibration.film import FINE, Film, Layer, texture, write_video

_SEEDS = 50_000  # of these films on
_CONTRAST = 0.0003, 0.05  # of the wall
_MOST = 240  # pictures


def make_plain_film(seed: int, folder: Path) -> Truth:
    """folder/SEED.mp4 and SEED.json; those there are kept. Nothing vibrates: every line is false."""
    video, notes = folder / f"{seed:04d}.mp4", folder / f"{seed:04d}.json"
    if video.exists() and notes.exists():
        return read_truth(notes)
    folder.mkdir(parents=True, exist_ok=True)
    draw = Draw(_SEEDS + seed)
    draw.frames = draw.truth.frames = min(draw.frames, _MOST)
    draw.duration = draw.frames / draw.fps
    write_video(video, _film(draw).pictures(), draw.fps, draw.coding)
    notes.write_text(json.dumps(asdict(draw.truth), indent=1))
    return draw.truth


def _film(draw: Draw) -> Film:
    rng, w, h = draw.rng, draw.width, draw.height
    contrast = float(np.exp(rng.uniform(*np.log(_CONTRAST))))
    sizes = rng.uniform(0.08, 0.5), np.array([1.3, 3.0, 9.0]) * rng.uniform(0.9, 2.2)
    wall = texture(h, w, rng, contrast, *sizes)
    y, x = np.mgrid[: h * FINE, : w * FINE] / FINE
    shade = [rng.uniform(-0.3, 0.3) * (share - 0.5) for share in (x / w, y / h)]
    layers = [Layer(wall * (1 + shade[0] + shade[1]), None, [], draw.blur)]
    boxes = [draw.box() for _ in range(rng.integers(1, 4))]
    layers += [Layer(draw.surface(), box, [], draw.blur) for box in boxes]
    light, sway = draw.light(), draw.sway()
    return Film(layers, draw.fps, draw.frames, draw.truth.noise, light, sway, [], draw.seed)
