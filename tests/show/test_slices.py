"""Space-time slices, difference maps, spectra, and blending weights against the compositing formula."""

from pathlib import Path

import numpy as np
import pytest
import torch

from tg4mm.capture import Capture
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.show.maps import amplitude_spectrum, blending_weights, difference_maps, space_time_slice

T, H, W, FPS, FREQ = 30, 12, 64, 30.0, 3.0
ROW = 7
SIZE, FOCAL, DISTANCE = 32, 40.0, 4.0
EPS2D = 0.3  # pixels², the low-pass that gsplat adds


@pytest.fixture
def video():
    """A soft vertical edge in rows 6 to 8, strongest in row 7, that swings at 3 Hz by 4 pixels."""
    x, t = np.arange(W) + 0.5, np.arange(T)
    centre = 32 + 4 * np.sin(2 * np.pi * FREQ * t / FPS)
    edge = 1 / (1 + np.exp(-(x - centre[:, None]) / 2))
    video = np.full((T, H, W, 3), 0.25)
    for row, strength in ((6, 0.2), (ROW, 0.7), (8, 0.2)):
        video[:, row] = 0.25 + strength * edge[..., None]
    return video


def test_a_row_slice_shows_the_sinusoid_and_its_frequency(video):
    picture = space_time_slice(video, "row", ROW)
    assert picture.shape == (T, W, 3)
    np.testing.assert_array_equal(picture[5], video[5, ROW])
    position = -(picture[..., 0] - 0.25).sum(1) / 0.7  # the edge's place, up to a constant
    amplitude = np.abs(np.fft.rfft(position - position.mean())) * 2 / T
    frequencies = np.fft.rfftfreq(T, 1 / FPS)
    assert frequencies[amplitude.argmax()] == pytest.approx(FREQ)
    assert amplitude.max() == pytest.approx(4.0, rel=0.01)


def test_difference_maps_are_equation_17(video):
    maps, scale = difference_maps(video, 6)
    assert maps.shape == (6, H, W)
    np.testing.assert_allclose(maps[2], np.abs(video[3] - video[2]).mean(-1))
    assert scale == maps.max() > 0
    assert len(difference_maps(video)[0]) == T - 1


def test_the_spectrum_is_the_weighted_mean_amplitude():
    displacement = np.zeros((2, 3, 3), np.complex64)
    displacement[0, 0] = [0, 3e-3j, 4e-3]  # length 5e-3
    displacement[1] = 1e-3
    motion = ModalMotion.of_phasors(np.array([5.0, 3.0]), displacement, np.zeros_like(displacement), FPS, T)
    frequencies, amplitude = amplitude_spectrum(motion, np.array([1.0, 3.0, 0.0]))
    np.testing.assert_array_equal(frequencies, [3.0, 5.0])
    np.testing.assert_allclose(amplitude, [np.sqrt(3) * 1e-3, 5e-3 / 4], rtol=1e-6)
    np.testing.assert_allclose(amplitude_spectrum(motion)[1][1], 5e-3 / 3, rtol=1e-6)


def balls(means, scale, opacities):
    n = len(means)
    quats = torch.tensor([[1.0, 0, 0, 0]]).expand(n, 4)
    # A dark colour: weights must not depend on it.
    return Gaussians(
        torch.tensor(means), quats, torch.full((n, 3), scale), torch.tensor(opacities), -torch.ones(n, 1, 3)
    )


def capture(n_images, camera_ids):
    """Cameras on the z axis looking along +z; camera 1 stands twice as far away."""
    viewmats = np.stack([np.eye(4)] * n_images)
    viewmats[:, 2, 3] = [DISTANCE * (1 + c) for c in camera_ids]
    k = np.array([[FOCAL, 0, SIZE / 2], [0, FOCAL, SIZE / 2], [0, 0, 1]])
    return Capture(
        root=Path(),
        split="train",
        width=SIZE,
        height=SIZE,
        fps=30.0,
        n_timesteps=n_images,
        viewmats=viewmats,
        Ks=np.stack([k] * n_images),
        timesteps=np.arange(n_images),
        camera_ids=np.array(camera_ids),
        paths=(Path("x.png"),) * n_images,
    )


def alpha_image(scale, opacity, depth):
    """Opacity of a centred ball in each pixel: o exp(−r² / 2σ²), nothing below 1/255."""
    variance = (FOCAL * scale / depth) ** 2 + EPS2D
    offsets = np.arange(SIZE) + 0.5 - SIZE / 2
    alpha = opacity * np.exp(-(offsets[:, None] ** 2 + offsets**2) / (2 * variance))
    return np.where(alpha >= 1 / 255, alpha, 0.0)


def test_one_behind_another_gets_what_the_first_lets_through():
    front, back = alpha_image(0.2, 0.6, DISTANCE), alpha_image(0.2, 0.8, DISTANCE + 1)
    weights = blending_weights(balls([[0, 0, 1.0], [0, 0, 0.0]], 0.2, [0.8, 0.6]), capture(1, [0]))
    assert weights.shape == (2,)
    np.testing.assert_allclose(weights, [(back * (1 - front)).sum(), front.sum()], rtol=2e-3)
    assert weights[0] < 0.75 * back.sum()  # without the front one it would weigh this much more
