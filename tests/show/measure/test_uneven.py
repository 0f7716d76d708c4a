"""Regions whose parts move differently: by how much their motion as one body differs from the mean over their area."""

from fractions import Fraction

import numpy as np
import pytest

from tests.capture.sfm.videos import write_video
from tg4mm.show.measure import Sensor, measure
from tg4mm.show.measure.flat import unevenness
from tg4mm.show.measure.video import prepare_video

pytest.importorskip("av", reason="needs the extra sfm")
HZ, FPS, PIXELS = 3.0, 20, 0.3


@pytest.mark.parametrize("seed", range(5))
def test_the_share_is_that_of_the_parts_and_noise_adds_nothing(seed):
    rng, t = np.random.default_rng(seed), np.arange(60) / FPS
    wave = np.stack([np.cos(2 * np.pi * HZ * t), 0 * t, 0 * t], 1)

    def shown(size, noise):
        return size * wave + noise * rng.normal(size=(2, 60, 3))

    # Mean over the area: 1.025; so many pixels that none is uneven within.
    areas, sizes = [1e4, 3e4], [1.4, 0.9]
    found = unevenness(shown(1, 0), [shown(s, 0) for s in sizes], areas)
    assert found.share == pytest.approx(0.025, rel=0.01)
    assert found.spread == pytest.approx(np.sqrt(0.25 * 0.375**2 + 0.75 * 0.125**2))
    found = unevenness(shown(1, 0.05), [shown(s, 0.05) for s in (1.4, 1.4)], areas)
    assert found.share == pytest.approx(0.4, abs=0.05)
    assert found.spread < 0.1
    assert unevenness(shown(1, 0.05), [shown(1, 0.05)] * 2, areas).share < 0.03
    assert unevenness(shown(1, 0), [], []).share == 0


@pytest.mark.slow
def test_the_mean_over_an_uneven_region_lies_within_its_deviation(tmp_path):
    """A bump of motion on random textures: amplitude falls to half of it within a region."""
    x, y = np.meshgrid(2 * np.pi * np.arange(96) / 96, 2 * np.pi * np.arange(72) / 72)
    part, scores = np.exp(-((x - 3) ** 2 + (y - 3) ** 2) / 2), []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        waves = [(*rng.integers(-12, 13, 2), *rng.uniform(0, 2 * np.pi, 2)) for _ in range(30)]
        frames = []
        for k in range(40):
            moved = x - PIXELS * np.cos(2 * np.pi * HZ * k / FPS) * part * 2 * np.pi / 96
            grey = 128 + 12 * sum(np.cos(u * moved + v * y + phase) for u, v, phase, _ in waves)
            noisy = grey[..., None] + rng.normal(0, 2, (72, 96, 3))
            frames.append(np.clip(noisy, 0, 255).astype(np.uint8))
        scene = prepare_video(write_video(tmp_path / f"v{seed}.mp4", frames, Fraction(FPS), crf=0))
        for u, v in ((46.0, 46.0), (58.0, 40.0), (36.0, 36.0)):
            spot = Sensor("spot", "pixel", (u, v, 12.0), f"v{seed}")
            peak = measure(scene, [spot])["spot"].spectrum.peaks[0]
            true = PIXELS * part[np.hypot(x * 96 / (2 * np.pi) - u, y * 72 / (2 * np.pi) - v) < 12].mean()
            scores.append((peak.amplitude[0] - true) / peak.deviation[0])
    assert np.mean(np.abs(scores) < 2) > 0.8
    assert np.abs(scores).max() < 4
