"""A camera that shakes is told from a scene that moves, and from noise."""

import numpy as np
import pytest

from tg4mm.fit.motion.nuisance.shake import BlockShifts

SIZE, T = (96, 128), 20
STEADY = np.zeros((T, 2))


def texture(right, down):
    """[H, W, 3] at pixels moved by [H, W] each."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    x, y = x - right, y - down
    waves = np.sin(0.5 * x + 0.3 * y), np.cos(0.4 * x - 0.6 * y), np.sin(0.35 * x) * np.sin(0.5 * y)
    return 0.5 + 0.3 * np.stack(waves, -1)


def filmed(right, down, noise=0.005):
    """Frames whose pixels are moved by [T, H, W] each, less their mean."""
    rng = np.random.default_rng(0)
    frames = np.stack([texture(r, d) for r, d in zip(right, down, strict=True)])
    frames += noise * rng.normal(size=frames.shape)
    found = BlockShifts.of(texture(np.zeros(SIZE), np.zeros(SIZE)).astype(np.float32), T)
    changes = (frames - frames.mean(0)).astype(np.float32)
    for top in range(0, SIZE[0], 29):  # by strips that are not the blocks'
        rows = slice(top, min(top + 29, SIZE[0]))
        found.add(rows, changes[:, rows])
    return found


def everywhere(shifts):
    """[T, H, W] each, of shifts [T, 2]."""
    right, down = (np.broadcast_to(s[:, None, None], (T, *SIZE)) for s in shifts.T)
    return right.copy(), down.copy()


def random_shifts(size, seed=1):
    """[T, 2] pixels, each axis of so much rms; mean 0."""
    shifts = np.random.default_rng(seed).normal(size=(T, 2))
    shifts -= shifts.mean(0)
    return size * shifts / np.sqrt((shifts**2).mean(0))


@pytest.mark.parametrize("size", [0.05, 0.2, 0.4])
def test_a_camera_that_shakes_is_found_with_its_pixels(size):
    """Both axes together: √2 of what each has."""
    pixels, is_shaking = filmed(*everywhere(random_shifts(size))).shake()
    assert is_shaking
    assert pixels == pytest.approx(np.sqrt(2) * size, rel=0.15)


@pytest.mark.parametrize("what", ["roll", "zoom"])
def test_a_camera_that_rolls_or_comes_nearer_shakes_too(what):
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    x, y = x - SIZE[1] / 2, y - SIZE[0] / 2
    way = (-y, x) if what == "roll" else (x, y)
    amount = 0.01 * np.random.default_rng(2).normal(size=(T, 1, 1))
    assert filmed(amount * way[0], amount * way[1]).shake()[1]


@pytest.mark.parametrize("side", [40, 80])
def test_an_object_that_moves_before_what_stands_still_is_no_shake(side):
    """Up to more than half of the picture, by more than any shake."""
    right, down = everywhere(random_shifts(1.0))
    mask = np.zeros(SIZE, bool)
    mask[8 : 8 + side, 10 : 10 + side] = True
    pixels, is_shaking = filmed(right * mask, down * mask).shake()
    assert not is_shaking
    assert pixels < 0.02


def test_an_object_that_moves_before_a_camera_that_shakes_is_a_shake():
    right, down = everywhere(random_shifts(0.2))
    mask = np.zeros(SIZE, bool)
    mask[20:60, 20:60] = True
    own = random_shifts(1.0, seed=7)
    pixels, is_shaking = filmed(right + mask * own[:, :1, None], down + mask * own[:, 1:, None]).shake()
    assert is_shaking
    assert pixels == pytest.approx(np.sqrt(2) * 0.2, rel=0.2)


@pytest.mark.parametrize("noise", [0.0, 0.005, 0.05])
def test_noise_is_no_shake(noise):
    pixels, is_shaking = filmed(*everywhere(STEADY), noise).shake()
    assert not is_shaking
    assert pixels < 0.01
