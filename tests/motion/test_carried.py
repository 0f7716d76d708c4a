"""What pictures show of motion beyond the rendered derivative: errors that move along, slopes pale by motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from tests.motion.test_view_jacobian import SCENES, motion_of, view_of
from tests.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture, load_images
from tg4mm.gaussians import Gaussians
from tg4mm.motion import MotionConfig
from tg4mm.motion.carried import carried as module
from tg4mm.motion.carried.carried import Carried
from tg4mm.motion.carried.steady import trust
from tg4mm.motion.jacobian.flow import optical_flow
from tg4mm.motion.train import train_motion
from tg4mm.rasterize.buffers import Buffers
from tg4mm.rasterize.kernels.layout import MX, MY
from tg4mm.rasterize.reference import rasterize_dense
from tg4mm.runs import Run

T, SIZE = 30, 40
INNER = (slice(None), slice(2, -2), slice(2, -2))  # away from the edges, where derivatives are one-sided


def texture(shift: np.ndarray) -> np.ndarray:
    """[H, W, 3]: waves of 9 to 16 pixels, moved by `shift` pixels."""
    y, x = np.mgrid[0:SIZE, 0:SIZE].astype(np.float64)
    x, y = x - shift[0], y - shift[1]
    waves = np.sin(0.6 * x + 0.3 * y), np.cos(0.4 * x - 0.5 * y), np.sin(0.3 * x) * np.sin(0.6 * y)
    return 0.5 + 0.3 * np.stack(waves, -1)


def seen(u: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of a texture that moves by u [T, 2]: mean [H, W, 3], basis [R, T] and component images [R, H, W, 3]."""
    pictures = np.stack([texture(now) for now in u])
    flat = (pictures - pictures.mean(0)).reshape(len(u), -1)
    basis = np.linalg.eigh(flat @ flat.T)[1][:, ::-1].T[:most]
    return pictures.mean(0), basis, (basis @ flat).reshape(most, SIZE, SIZE, 3)


def predicted(
    monkeypatch: pytest.MonkeyPatch, mean: np.ndarray, basis: np.ndarray, u: np.ndarray
) -> np.ndarray:
    """By `Carried` where nothing at all is rendered: then all of the mean is error, and moves along."""
    assert np.allclose(basis @ basis.T, np.eye(len(basis)), atol=1e-6)
    moves = np.zeros((len(basis), SIZE, SIZE, 3), np.float32)
    moves[..., :2] = (basis @ u)[:, None, None]
    monkeypatch.setattr(module, "optical_flow", lambda *_: moves)
    black = SimpleNamespace(
        image=np.zeros((SIZE, SIZE, 4), np.float32), transmittance=np.zeros((SIZE, SIZE), np.float32)
    )
    views: Any = [black]
    return Carried(views, mean[None].astype(np.float32), basis).of(0, np.zeros(0, np.float32))


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(found[INNER] - expected[INNER]) / np.linalg.norm(expected[INNER]))


@pytest.mark.parametrize("other", [0.0, 3.0, 10.0])  # Hz; twice the first couples with it, 0: none
@pytest.mark.parametrize("amplitude", [0.1, 0.4, 0.7])
def test_component_images_of_a_texture_are_foretold_to_the_third_order(
    amplitude: float, other: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Slopes of the mean alone foretell a tenth of the square of the amplitude too little; without that, .5 %."""
    t = np.arange(T) / T
    u = amplitude * np.cos(2 * np.pi * 5 * t + 0.3)[:, None] * [0.8, 0.6]
    if other:
        u += 0.25 * np.cos(2 * np.pi * other * t)[:, None] * [0.6, -0.8]
    mean, basis, images = seen(u, 2 if other else 1)
    found = predicted(monkeypatch, mean, basis, u)
    right, down = np.gradient(mean, axis=1), np.gradient(mean, axis=0)
    plain = np.stack([-(a * right + b * down) for a, b in basis @ u])
    assert relative(found, images) < 0.006 + 0.02 * amplitude**2
    if amplitude >= 0.4:
        assert relative(found, images) < 0.35 * relative(plain, images)


def test_twice_the_frequency_is_no_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sinusoid's pictures have a second component, that nothing moves by: its squares."""
    u = 0.5 * np.cos(2 * np.pi * 5 * np.arange(T) / T + 0.3)[:, None] * [0.8, 0.6]
    mean, basis, images = seen(u, 2)
    found = predicted(monkeypatch, mean, basis, u)
    assert np.abs(basis[1] @ u).max() < 0.02 * np.abs(basis[0] @ u).max()
    assert np.linalg.norm(images[1]) > 0.05 * np.linalg.norm(images[0])
    assert relative(found[1:], images[1:]) < 0.05


def test_weak_motion_of_its_own_frequency_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a strong one and four others; what blurs the mean blurs the instant as well."""
    t = np.arange(120) / 120
    u = 0.6 * np.cos(2 * np.pi * 7 * t)[:, None] * [0.8, 0.6]
    for k, frequency in enumerate((11, 23, 31, 41, 59)):
        u += (0.05 - 0.007 * k) * np.sin(2 * np.pi * frequency * t)[:, None] * [0.6, -0.8]
    mean, _, _ = seen(u, 1)
    basis = np.stack([u @ [0.8, 0.6], *(np.sin(2 * np.pi * f * t) for f in (11, 23, 31, 41, 59))])
    basis /= np.linalg.norm(basis, axis=1, keepdims=True)
    images = np.tensordot(basis, np.stack([texture(now) for now in u]), 1)
    found = predicted(monkeypatch, mean, basis, u)
    for r in (4, 5):
        share = (found[r][INNER[1:]] * images[r][INNER[1:]]).sum() / (images[r][INNER[1:]] ** 2).sum()
        assert share == pytest.approx(1, abs=0.02)


def test_what_is_mistaken_by_many_pixels_does_not_grow_with_its_cube(monkeypatch: pytest.MonkeyPatch) -> None:
    t = np.arange(T) / T
    mean, basis, _ = seen(0.4 * np.cos(2 * np.pi * 5 * t)[:, None] * [0.8, 0.6], 1)
    sizes = []
    for wrong in (5.0, 20.0):
        u = wrong * np.cos(2 * np.pi * 5 * t)[:, None] * [0.8, 0.6]
        sizes.append(float(np.linalg.norm(predicted(monkeypatch, mean, basis, u))))
    assert sizes[1] < 4.5 * sizes[0]


def test_a_ramp_that_moves_is_a_ramp_up_to_its_edges(monkeypatch: pytest.MonkeyPatch) -> None:
    ramp = np.mgrid[0:SIZE, 0:SIZE].sum(0)[..., None] * np.full(3, 0.01)
    u = 0.5 * np.cos(2 * np.pi * 5 * np.arange(T) / T)[:, None] * [1.0, 0.0]
    basis = (u[:, 0] / np.linalg.norm(u[:, 0]))[None]
    found = predicted(monkeypatch, ramp, basis, u)
    np.testing.assert_allclose(found, -0.01 * float(basis[0] @ u[:, 0]), rtol=1e-3)


def test_the_flow_is_how_far_splats_move_by_blending_weight() -> None:
    """Against the dense twin that blends the shifts of the projected means, by central differences, as colours."""
    scene = SCENES["ordinary"]
    view, motion = view_of(scene), motion_of(scene, slice(0, 6))
    ends = [
        view_of(replace(scene, means=scene.means + sign * 1e-3 * torch.from_numpy(motion[:, :3]).double()))
        for sign in (1, -1)
    ]
    shift = np.zeros((len(motion), 2))
    visible = view.bins.order[: view.bins.n_visible]  # of the others nothing is written in `splats`
    shift[visible] = (ends[0].splats[visible][:, [MX, MY]] - ends[1].splats[visible][:, [MX, MY]]) / 2e-3
    colours = torch.zeros_like(scene.colors)
    small = 0.4 / np.abs(shift).max()  # colours are 0.5 and that much, which no clamping reaches
    colours[:, 0, :2] = torch.from_numpy(small * shift).double() / 0.28209479177387814
    image, alpha = rasterize_dense(
        scene.means, scene.quats, scene.scales, scene.opacities, colours, scene.viewmats[0], scene.Ks[0],
        scene.width, scene.height,
    )  # fmt: skip
    found = optical_flow(view, motion[None], Buffers())[0]
    assert found.shape == (*view.transmittance.shape, 3)
    assert not found[..., 2].any()
    expected = (image - 0.5 * alpha[..., None]).numpy()[..., :2] / small
    assert np.abs(expected).max() > 1
    np.testing.assert_allclose(found[..., :2], expected, atol=0.02 * np.abs(expected).max())


def test_what_does_not_move_carries_nothing() -> None:
    view = view_of(SCENES["ordinary"])
    still = np.zeros((2, len(view.splats), 6), np.float32)
    noise = np.random.default_rng(0).uniform(size=(1, *view.transmittance.shape, 3)).astype(np.float32)
    assert not Carried([view], noise, np.eye(2, 9)).of(0, still).any()


def amplitude_of(data: Path, path: Path, gaussians: Gaussians) -> float:
    run = Run.create(path, data, "modal", {})
    run.save_space(gaussians, {})
    capture = load_capture(data)
    found = train_motion(run, capture, load_images(capture), MotionConfig(light=False, neighbours=100.0))
    return float(np.linalg.norm(found.displacement[int(np.argmin(np.abs(found.freqs_hz - 3)))]))


def test_a_pale_scene_moves_no_further_for_that(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Eight cameras see a post sway by a third of a pixel; the run's Gaussians show too little contrast."""
    data = tmp_path / "data"
    sharp, _ = make_synthetic_dataset(data, n_views=8, n_timesteps=10, size=48, alphas=(), n_test=0)
    pale = replace(sharp, sh=0.85 * sharp.sh)
    true = amplitude_of(data, tmp_path / "sharp", sharp)
    carried = amplitude_of(data, tmp_path / "pale", pale)
    monkeypatch.setattr(Carried, "of", lambda _, v, shapes: np.zeros((len(shapes), 48, 48, 3), np.float32))
    plain = amplitude_of(data, tmp_path / "plain", pale)
    assert plain > 1.05 * true
    assert abs(carried - true) < 0.5 * abs(plain - true)


def noise(level: float) -> np.ndarray:
    return np.random.default_rng(3).normal(0, level, (SIZE, SIZE, 3))


def test_noise_that_stands_still_is_not_carried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Alone, and a little of it beside a texture, whose slopes are .13 a pixel."""
    u = 0.2 * np.cos(2 * np.pi * 5 * np.arange(T) / T)[:, None] * [0.8, 0.6]
    mean, basis, images = seen(u, 1)
    both = predicted(monkeypatch, mean + noise(0.02), basis, u)
    assert (both[INNER] * images[INNER]).sum() / (images[INNER] ** 2).sum() == pytest.approx(1, abs=0.05)
    alone = predicted(monkeypatch, 0.5 + noise(0.3), basis, u)
    monkeypatch.setattr(module, "trust", lambda *_: np.ones((SIZE, SIZE), np.float32))
    taken = predicted(monkeypatch, 0.5 + noise(0.3), basis, u)
    assert np.linalg.norm(alone[INNER]) < 0.35 * np.linalg.norm(taken[INNER])


def test_slopes_are_trusted_by_what_they_are_more_than_noise() -> None:
    everywhere = np.ones((SIZE - 4, SIZE - 4), bool)
    smooth, rough = texture(np.zeros(2)), noise(0.1)
    assert trust(smooth, everywhere).min() > 0.9
    assert trust(rough, everywhere).mean() < 0.15
    assert 0.3 < trust(smooth + rough, everywhere).mean() < 0.9
    half = np.where(np.arange(SIZE)[:, None, None] < SIZE // 2, smooth, smooth + rough)
    quiet = everywhere & (np.arange(SIZE - 4)[:, None] < SIZE // 2 - 4)
    assert trust(half, quiet).min() > 0.9  # noise is looked for where something is shown
    assert (trust(rough, ~everywhere) == 1).all()
    assert (trust(np.full((SIZE, SIZE, 3), 0.5), everywhere) == 1).all()
