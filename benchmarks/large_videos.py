"""The cost of large, long videos: processor seconds and GiB of look, sfm and train, by pixels and pictures.

A plate, a quarter of the picture wide, sways by 0.2 px at 5.7 Hz before a still wall; noise of 1.5 grey levels, H.264
of 8 Mbit/s at 1920×1080 and in proportion at others.
"""

import json
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.calibration.film import Coding, Film, FilmMode, Layer, texture, write_video
from benchmarks.common import cost, machine
from tg4mm.capture import load_capture
from tg4mm.fit.motion.animate import animate
from tg4mm.run import Run
from tg4mm.run.stages import look_of

FPS, HZ, AMPLITUDE = 60, 5.7, 0.2  # pictures a second, Hz, pixels to the right
FULL_HD, BITS = 1920 * 1080, 8_000_000

OPTIONS = {
    "out": {"type": Path, "metavar": "DIR"},
    "--sizes": {
        "nargs": "*",
        "default": ["640x360x240", "1280x720x300", "1920x1080x300", "1920x1080x600"],
        "metavar": "WIDTHxHEIGHTxPICTURES",
    },
}


def run(options: Any) -> None:
    """Prints a table."""
    print(machine())
    print("| pictures | step | processor s | s by the clock | GiB | found |\n|---|---|---:|---:|---:|---|")
    for size in options.sizes:
        width, height, pictures = (int(n) for n in size.split("x"))
        folder = options.out / size
        folder.mkdir(parents=True, exist_ok=True)
        video = folder / "film.mp4"
        if not video.exists():
            _make(video, width, height, pictures)
        for made in ("set", "run"):
            shutil.rmtree(folder / made, ignore_errors=True)
        steps = {
            "look": ["look", video],
            "sfm": ["sfm", video, "--out", folder / "set"],
            "train": ["train", folder / "set", "--out", folder / "run"],
        }
        for name, words in steps.items():
            used = cost([sys.executable, "-m", "tg4mm", *map(str, words)])
            cells = f"{used.processor_s:.0f} | {used.clock_s:.0f} | {used.gib:.1f}"
            found = _found(folder / "run") if name == "train" else ""
            print(f"| {size} | {name} | {cells} | {found} |", flush=True)


def _make(video: Path, width: int, height: int, pictures: int) -> None:
    rng = np.random.default_rng(0)
    plate = (width * 3 // 8, height * 3 // 8, width * 5 // 8, height * 5 // 8)
    shape = np.broadcast_to([AMPLITUDE, 0.0], (height, width, 2))
    sway = FilmMode(shape, lambda t: float(np.cos(2 * np.pi * HZ * t)))
    cloths = [texture(height, width, rng, 0.3, 0.3, (1.5, 4.0)) for _ in range(2)]
    layers = [Layer(cloths[0], None, [], 0.6), Layer(cloths[1], plate, [sway], 0.6)]
    film = Film(layers, FPS, pictures, 1.5)
    write_video(video, film.pictures(), FPS, Coding("libx264", int(BITS * width * height / FULL_HD)))


def _found(path: Path) -> str:
    """Return the plate's sway by region and by fitted motion, each as a share of the truth."""
    run = Run.open(path)
    look, fit, capture = look_of(run), run.load_fit(), load_capture(run.dataset)
    K, viewmat = capture.Ks[0], capture.viewmats[0]
    times = np.arange(0, fit.motion.n_timesteps, 3)
    seen = []
    for t in times.tolist():
        at = animate(fit.gaussians, fit.motion, float(t), np.zeros(len(fit.motion.freqs_hz))).means.numpy()
        camera = at @ viewmat[:3, :3].T + viewmat[:3, 3]
        seen.append(camera[:, :2] / camera[:, 2:] * K[[0, 1], [0, 1]] + K[:2, 2])
    places = np.stack(seen)
    centre = np.array([capture.width, capture.height]) / 2
    is_plate = (np.abs(places[0] - centre) < 0.1 * np.array([capture.width, capture.height])).all(1)
    course = AMPLITUDE * np.cos(2 * np.pi * HZ * times / fit.motion.fps)
    course -= course.mean()
    moved = places[:, is_plate, 0] - places[:, is_plate, 0].mean(0)
    share = float(np.median(course @ moved / (course @ course)))
    line = look.vibrations[0] if look is not None and look.vibrations else None
    region = (
        "no line" if line is None else f"{line.hz:.3f} Hz, {line.amplitude_px / AMPLITUDE:.2f} of the truth"
    )
    reduced = json.loads((path / "log.json").read_text())["motion"].get("reduced", 1)
    return re.sub(r"\s+", " ", f"region: {region}; field {share:.2f}, pixels {reduced}×{reduced}")
