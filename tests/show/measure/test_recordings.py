"""Recordings of one fixed camera, the whole way: video, dataset, run, measurement."""

import json
import os
from pathlib import Path

import av
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from tg4mm.cli import main

SIZE, FPS, FRAMES = (96, 72), 60, 254
HZ, TIP_PX = 28.004, 0.55
# A folder with baby.mp4 and wrist.mp4 of Eulerian video magnification.
CLIPS = os.environ.get("TG4MM_CLIPS", "")


def tuning_fork(path):
    """A textured bar sways to the right and back, TIP_PX at its tip, before a still background."""
    rng, (width, height) = np.random.default_rng(2), SIZE
    y, x = np.mgrid[:height, :width].astype(float)
    wall, bar = (gaussian_filter(rng.normal(size=y.shape), sigma) for sigma in (2.5, 1.0))
    wall, bar = 150 + 6 * wall / wall.std(), 90 + 25 * bar / bar.std()
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=FPS)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.options = {"qp": "10"}
        for k in range(FRAMES):
            shift = TIP_PX * np.clip((60 - y) / 50, 0, 1) * np.sin(2 * np.pi * HZ * k / FPS)
            inside = (y < 64) / (1 + np.exp(-2 * (7 - np.abs(x - shift - 40))))
            moved = map_coordinates(bar, [y, x - shift], order=3, mode="nearest")
            seen = wall * (1 - inside) + moved * inside + rng.normal(0, 1.5, y.shape)
            grey = np.clip(seen, 0, 255).astype(np.uint8)
            frame = av.VideoFrame.from_ndarray(np.repeat(grey[..., None], 3, 2), "rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def run_of(video, folder, *settings):
    """The trained run of a video."""
    assert main(["sfm", str(video), "--out", str(folder / "set")]) == 0
    options = [word for setting in settings for word in ("--set", setting)]
    assert main(["train", str(folder / "set"), "--out", str(folder / "run"), *options]) == 0
    return folder / "run"


def measured(run, *sensors):
    """What `measure` leaves of each sensor, by name."""
    asked = [word for sensor in sensors for word in ("--sensor", sensor)]
    out = run.parent / "measured"
    assert main(["measure", str(run), *asked, "--no-animate", "--out", str(out)]) == 0
    return {s["name"]: s for s in json.loads((out / "measure.json").read_text())["sensors"]}


@pytest.mark.slow
def test_a_tuning_forks_tone_is_measured_whole(tmp_path):
    tuning_fork(tmp_path / "fork.mp4")
    run = run_of(tmp_path / "fork.mp4", tmp_path, "space.iterations=600", "space.max_gaussians=3000")
    found = measured(run, "tip=pixel:fork,40,14,5", "wall=pixel:fork,80,40,8")
    (tip, *others), wall = found["tip"]["peaks"], found["wall"]["peaks"]
    assert abs(tip["frequency_hz"] - HZ) < min(0.01, 3 * tip["frequency_deviation_hz"] + 1e-3)
    true = TIP_PX * 46 / 50  # at y = 14
    pixels = tip["main_amplitude"] * found["tip"]["px_per_unit"]
    assert pixels == pytest.approx(true, rel=0.1)
    assert tip["codec_gain"] == pytest.approx(1, abs=0.15)
    assert not wall
    assert all(p["harmonic_of_hz"] or p["sideband_of_hz"] for p in others)


@pytest.mark.slow
@pytest.mark.skipif(not CLIPS, reason="TG4MM_CLIPS names no folder with the clips")
def test_the_baby_breathes(tmp_path):
    """No truth but what is seen: about one breath in two seconds, some tenths of a pixel."""
    run = run_of(Path(CLIPS) / "baby.mp4", tmp_path)
    log = json.loads((run / "log.json").read_text())
    assert any(0.4 < hz < 0.7 for hz in log["motion"]["frequencies_hz"])
