"""The measuring instrument, on speckle that moves exactly: small and large motion, light, rows, and what passes."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.calibration.film import FINE, texture
from tg4mm.capture.tracking.region import RowClock, TrackedRegion, _hidden, region_motions
from tg4mm.capture.tracking.row_times import row_delays

SIDE, FRAMES, FPS = 64, 60, 30.0
TIMES = np.arange(FRAMES) / FPS


def moving(motion, seed, finest=1.3, noise=2.0, light=0.02):
    """Frames [F, 64, 64], grey levels, of speckle that moves by [F, 64 or 1, 2] pixels, each row by its own."""
    rng = np.random.default_rng(seed)
    fine = np.fft.rfft2(texture(SIDE, SIDE, rng, 0.35, 0.4, (finest, 3.0)))
    down = 2 * np.pi * FINE * np.fft.fftfreq(fine.shape[0])[:, None]
    right = 2 * np.pi * FINE * np.fft.rfftfreq(SIDE * FINE)[None]
    frames = np.empty((FRAMES, SIDE, SIDE))
    for k, rows in enumerate(motion):
        for first in range(0, SIDE, SIDE // len(rows)):
            x, y = rows[first * len(rows) // SIDE]
            moved = np.fft.irfft2(fine * np.exp(-1j * (right * x + down * y)))
            part = slice(first, first + SIDE // len(rows))
            frames[k, part] = moved.reshape(SIDE, FINE, SIDE, FINE).mean((1, 3))[part]
    frames *= 1 + light * np.sin(np.arange(FRAMES))[:, None, None]
    return 255 * frames + rng.normal(size=frames.shape) * noise


def measured(frames, mask=None, readout_s=0.0):
    if mask is None:
        mask = np.zeros((SIDE, SIDE), np.float32)
        mask[12:-12, 12:-12] = 1
    chunks = [lambda box, k=k: frames[k : k + 16][:, *box].astype(np.float32) for k in range(0, FRAMES, 16)]
    return region_motions(chunks, [mask], TIMES, readout_s)[0]


def deviation(found):
    """Pixels: of one sample along one axis, by what is known of the region and the noise that is left."""
    inverse = np.linalg.inv(found.normals.sum(0))
    covariance = inverse @ found.noise.sum(0) @ inverse.T * np.median(found.misfit)
    return float(np.sqrt(np.trace(covariance[:2, :2]) / 2))


def wave(size_px, hz=3.3):
    return size_px * np.cos(2 * np.pi * hz * TIMES + 0.3)[:, None, None] * [0.8, -0.6]


@pytest.mark.parametrize("size_px", [0.02, 0.2, 0.5, 1.0, 3.0, 7.0])
@pytest.mark.parametrize("finest", [1.3, 3.0])
def test_motion_is_found_whatever_its_size(size_px, finest):
    for seed in range(3):
        motion = wave(size_px)
        found = measured(moving(motion, seed, finest))
        true = motion[:, 0] - motion[:, 0].mean(0)
        error = found.whole - true
        gain = (found.whole * true).sum() / (true**2).sum()
        noise = deviation(found)
        assert np.sqrt((error**2).mean()) < 1.3 * noise + 0.015 * size_px
        assert gain == pytest.approx(1, abs=0.015 + 3 * noise / size_px / np.sqrt(FRAMES / 2))
        assert found.is_iterated == (size_px > 0.45)


def test_what_is_known_of_a_motion_is_its_scatter():
    """The covariance A⁻¹ B A⁻ᵀ at the noise's variance is that of the answers of a part that stands still."""
    found = [measured(moving(wave(0.0), seed, light=0.0)) for seed in range(6)]
    expected = []
    for own in found:
        inverse = np.linalg.inv(own.normals)
        covariance = inverse @ own.noise @ np.swapaxes(inverse, 1, 2) * own.misfit.mean()
        expected += list(np.trace(covariance[:, :2, :2], axis1=1, axis2=2))
    scatter = np.mean([f.shift[..., :2].var(1).sum(-1) for f in found])
    assert scatter == pytest.approx(np.mean(expected), rel=0.1)


def test_a_turn_is_distinguished_from_a_shift():
    y, x = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    angle = 0.004 * np.sin(2 * np.pi * 3.3 * TIMES)
    rng = np.random.default_rng(0)
    k, phase = rng.uniform(0.4, 1.2, (40, 2)) * rng.choice([-1, 1], (40, 2)), rng.uniform(0, 2 * np.pi, 40)
    frames = [
        sum(
            np.cos(a * (x * np.cos(t) - y * np.sin(t)) + b * (x * np.sin(t) + y * np.cos(t)) + p)
            for (a, b), p in zip(k, phase, strict=True)
        )
        for t in angle
    ]
    found = measured(128 + 8 * np.array(frames))
    turn = found.shift[:, :, 2].mean(0) / found.radius_px
    assert turn - turn.mean() == pytest.approx(angle - angle.mean(), abs=1e-4)
    assert np.abs(found.whole - found.whole.mean(0)).max() < 0.01


@pytest.mark.parametrize("size_px", [0.2, 1.5])
def test_rows_read_in_turn_are_brought_to_the_regions_time(size_px):
    readout_s = 0.03
    delays = readout_s * ((np.arange(SIDE // 4) + 0.5) / (SIDE // 4) - 0.5)
    motion = np.stack([np.cos(2 * np.pi * 3.3 * (TIMES + d)) for d in delays], 1)
    frames = moving(size_px * motion[..., None] * [0.8, -0.6], 0)
    for rows in (slice(8, 24), slice(40, 56)):
        mask = np.zeros((SIDE, SIDE), np.float32)
        mask[rows, 12:-12] = 1
        region = TrackedRegion.of(mask)
        clock = RowClock.of(region, frames[0][*region.box][*region.inner], TIMES, readout_s, SIDE)
        expected = row_delays(readout_s, region.top + np.arange(len(clock.delays_s)), SIDE)
        assert clock.delays_s == pytest.approx(expected)
        found = measured(frames, mask, readout_s)
        middle = readout_s * ((rows.start + 8) / SIDE - 0.5)
        assert found.delay_s == pytest.approx(middle, abs=0.001)
        true = size_px * np.cos(2 * np.pi * 3.3 * (TIMES + found.delay_s))[:, None] * [0.8, -0.6]
        error = found.whole - found.whole.mean(0) - true + true.mean(0)
        assert np.sqrt((error[4:-4] ** 2).mean()) < 0.006 + 0.02 * size_px


def test_something_that_passes_is_no_motion():
    frames = moving(wave(0.3), 0)
    assert measured(frames).other_share < 0.1
    for k in range(20, 28):
        frames[k, :, 4 * (k - 20) + 10 : 4 * (k - 20) + 26] = 90
    found = measured(frames)
    assert found.other_share > 0.5
    short = replace(found, misfit=found.misfit[12:32], change=found.change[12:32])  # tenth: 2 frames
    assert short.other_share > 0.5
    assert not found.is_iterated


@pytest.mark.parametrize("size_px", [0.3, 2.0])
def test_frames_in_which_something_passes_are_left_out(size_px):
    motion = wave(size_px)
    frames = moving(motion, 0)
    for k in range(20, 28):
        frames[k, :, 5 * (k - 20) + 5 : 5 * (k - 20) + 21] = 90
    found = measured(frames)
    assert found.hidden[21:27].all()
    assert found.hidden.mean() < 0.3
    seen = ~found.hidden
    error = found.whole - motion[:, 0]
    error = (error - error[seen].mean(0))[seen]
    assert np.sqrt((error**2).mean()) < 1.3 * deviation(found) + 0.015 * size_px


def test_what_a_codec_leaves_of_a_ring_down_is_not_something_that_passes():
    """In three early frames it leaves a little more than half of what the motion changes; then something passes."""
    times = np.arange(120) / 30
    change = 2 + 60 * np.exp(-times) * np.cos(2 * np.pi * 4 * times) ** 2
    misfit = 1 + 0.3 * (change - 2)
    misfit[[4, 7, 15]] = 0.56 * change[[4, 7, 15]]
    assert not _hidden(misfit, change).any()
    misfit[60:70] = change[60:70] = 400
    assert np.flatnonzero(_hidden(misfit, change)).tolist() == list(range(58, 72))
