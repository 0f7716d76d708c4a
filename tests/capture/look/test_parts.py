"""Cells, floors and knocks against what is known exactly."""

import numpy as np
import pytest

from benchmarks.calibration.film import FilmMode, Layer, texture
from tg4mm.capture.look.reading import BETWEEN, FORWARD, INTRA, CellSeries, knocks
from tg4mm.capture.look.scene import find_masks
from tg4mm.capture.look.spectra import noise_floor, spectrum, tones_of
from tg4mm.capture.tracking.template import Grid, Template, slope

FPS = 30.0


def test_slopes_are_exact_and_cells_lie_where_they_are():
    wave = np.sin(2 * np.pi * np.arange(60) / 12 + 0.4)  # pixels
    expected = 2 * np.pi / 12 * np.cos(2 * np.pi * np.arange(60) / 12 + 0.4)
    assert slope(np.stack([wave] * 3), 1)[1, 4:-4] == pytest.approx(expected[4:-4], abs=1e-4)
    grid = Grid(4, 5, 16, edge=3)
    assert grid.centres()[[0, 6]].tolist() == [[11, 11], [27, 27]]
    assert grid.box(np.array([0, 6])) == (3, 3, 35, 35)


def test_shifts_of_cells_are_exact_up_to_a_quarter_of_a_pixel():
    cloth = texture(64, 64, np.random.default_rng(0), 0.3, 0.4, (1.6, 4.0))
    shape = np.broadcast_to([1.0, -0.5], (64, 64, 2))
    t = np.arange(60) / FPS
    light = 1 + 0.2 * np.sin(2 * np.pi * 4 * t)
    for size in (0.01, 0.1, 0.28):
        layer = Layer(
            cloth, None, [FilmMode(shape, lambda t, a=size: a * float(np.cos(2 * np.pi * 3 * t)))], 0.6
        )
        drawn = np.stack([255 * g * layer.drawn(k, np.zeros(2))[0] for k, g in zip(t, light, strict=True)])
        drawn = drawn.astype(np.float32)
        template = Template(drawn.mean(0), Grid.of(64, 64, 16))
        shift, gain, misfit, _ = template.solved(*template.products(drawn))
        true = size * np.cos(2 * np.pi * 3 * t)
        inner = [5, 6, 9, 10]
        assert shift[inner, :, 0].mean(0) == pytest.approx(true, abs=0.002 * size)
        assert shift[inner, :, 1].mean(0) == pytest.approx(-0.5 * true, abs=0.0006 * size)
        assert gain[inner] == pytest.approx(np.tile(light, (4, 1)), abs=0.001)
        assert misfit[inner].max() < 0.1


def test_a_cell_with_hardly_any_texture_is_not_said_to_be_unlike_itself():
    """Its instruments may mislead by hundreds of pixels; no shift is the better answer."""
    rng = np.random.default_rng(11)
    for seed in range(5):
        mean = 40 + 0.02 * rng.normal(size=(64, 64)).astype(np.float32)
        mean[:, 30:] += 0.3 * np.linspace(0, 1, 34, dtype=np.float32) ** 2
        noisy = (mean + 0.3 * np.random.default_rng(seed).standard_normal((40, 64, 64))).astype(np.float32)
        found = Template(mean, Grid.of(64, 64, 16))
        _, _, misfit, change = found.solved(*found.products(noisy))
        assert (misfit < 2.1 * change).all()
        assert (found.covariance[:, 0, 0] < 100).all()


def test_the_covariance_of_a_shift_is_what_noise_does():
    rng = np.random.default_rng(1)
    fine = texture(32, 32, rng, 0.3, 0.4, (1.6,))
    mean = (255 * fine.reshape(32, 3, 32, 3).mean((1, 3))).astype(np.float32)
    template = Template(mean, Grid.of(32, 32, 16))
    light = 20 * np.sin(np.arange(800))[:, None, None]
    noisy = (mean + light + 2 * rng.standard_normal((800, 32, 32))).astype(np.float32)
    shift, _, misfit, change = template.solved(*template.products(noisy))
    assert misfit.mean() == pytest.approx(4, rel=0.005)
    assert change.mean() == pytest.approx(4, rel=0.005)
    for cell in range(4):
        assert np.cov(shift[cell].T) == pytest.approx(4 * template.covariance[cell], rel=0.2, abs=3e-5)


def test_a_floor_is_the_noises_mean_power_and_lines_do_not_raise_it():
    rng, t = np.random.default_rng(2), np.arange(300) / FPS
    noise = rng.normal(size=(300, 60)) * np.linspace(1, 3, 60)
    floor, freedom = noise_floor(np.abs(spectrum(noise, t)[1]) ** 2)
    expected = 4 / 300 * np.linspace(1, 3, 60) ** 2
    assert (floor[20:-20].mean(0) / expected).mean() == pytest.approx(1, abs=0.05)
    assert freedom.min() > 3
    strong = noise + 5 * np.cos(2 * np.pi * 6.1 * t)[:, None]
    raised, _ = noise_floor(np.abs(spectrum(strong, t)[1]) ** 2)
    assert np.median(raised[20:-20] / floor[20:-20]) == pytest.approx(1, abs=0.1)


def test_lines_of_noise_are_seldom_and_a_tone_is_one():
    rng, t = np.random.default_rng(3), np.arange(240) / FPS
    flat = np.stack([np.ones(240), t], 1)
    assert sum(bool(tones_of(rng.normal(size=240), t, flat)) for _ in range(60)) <= 1
    ((hz, deviation, size),) = tones_of(rng.normal(size=240) + 1.5 * np.cos(2 * np.pi * 4.44 * t), t, flat)
    assert abs(hz - 4.44) < 3 * deviation
    assert size == pytest.approx(1.5, abs=0.3)


def test_a_knock_is_a_step_that_stays():
    rng = np.random.default_rng(4)
    still = 0.02 * rng.normal(size=(200, 2))
    assert knocks(still) == []
    assert knocks(still + (np.arange(200) >= 77)[:, None] * [0.9, 0.0]) == [77]
    bumped = still.copy()
    bumped[50:54] += 3
    assert knocks(bumped) == []


def test_key_frames_with_more_noise_do_not_look_like_something_that_passes():
    rng, (frames, rows, columns) = np.random.default_rng(6), (120, 6, 8)
    kinds = np.where(np.arange(frames) % 3 == 0, FORWARD, BETWEEN)
    kinds[::12] = INTRA
    noise = np.select([kinds == INTRA, kinds == FORWARD], [30.0, 20.0], 10.0)
    misfit = noise[:, None] * rng.chisquare(200, (frames, rows * columns)) / 200
    empty = np.zeros((frames, rows * columns))
    series = CellSeries(
        *(np.arange(frames) / FPS, kinds, np.zeros((*empty.shape, 2)), empty + 1, misfit, misfit),
        *(np.tile(np.eye(2), (rows * columns, 1, 1)), np.zeros(frames, int), Grid(rows, columns, 16)),
        *((128, 96), np.zeros((96, 128), np.uint8), np.ones((frames, 96)), np.zeros(rows * columns, bool)),
    )
    assert find_masks(series).hidden.mean() < 0.01
    misfit[40:50, :6] *= 4
    assert find_masks(series).hidden[42:48, :6].all()
