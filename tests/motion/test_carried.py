"""What pictures show of motion beyond the rendered derivative: errors that move along, slopes pale by motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from tests.motion.test_linear import SCENES, motion_of, view_of
from tests.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture, load_images
from tg4mm.gaussians import Gaussians
from tg4mm.motion import MotionConfig
from tg4mm.motion import train as stage
from tg4mm.motion.carried import carried as module
from tg4mm.motion.carried.carried import Carried
from tg4mm.motion.carried.flow import flow
from tg4mm.motion.train import train_motion
from tg4mm.rasterize.buffers import Buffers
from tg4mm.rasterize.kernels.layout import MX, MY
from tg4mm.rasterize.reference import rasterize_dense
from tg4mm.runs import Run

T, SIZE = 30, 40
INNER = (slice(None), slice(4, -4), slice(4, -4))  # away from the edges, where derivatives are one-sided


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
    moves = np.zeros((len(basis), SIZE, SIZE, 3), np.float32)
    moves[..., :2] = (basis @ u)[:, None, None]
    monkeypatch.setattr(module, "flow", lambda *_: moves)
    black = SimpleNamespace(
        image=np.zeros((SIZE, SIZE, 4), np.float32), transmittance=np.zeros((SIZE, SIZE), np.float32)
    )
    views: Any = [black]
    return Carried(views, mean[None].astype(np.float32), basis).of(0, np.zeros(0, np.float32))


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(found[INNER] - expected[INNER]) / np.linalg.norm(expected[INNER]))


@pytest.mark.parametrize("second", [0.0, 0.25])  # pixels of another direction and frequency
@pytest.mark.parametrize("amplitude", [0.1, 0.4, 0.7])
def test_component_images_of_a_texture_are_foretold_to_the_third_order(
    amplitude: float, second: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Slopes of the mean alone foretell a tenth of the square of the amplitude too little; without that, .5 %."""
    t = np.arange(T) / T
    u = amplitude * np.cos(2 * np.pi * 5 * t + 0.3)[:, None] * [0.8, 0.6]
    u += second * np.cos(2 * np.pi * 3 * t)[:, None] * [0.6, -0.8]
    count = 2 if second else 1
    mean, basis, images = seen(u, count)
    found = predicted(monkeypatch, mean, basis, u)
    right, down = np.gradient(mean, axis=1), np.gradient(mean, axis=0)
    plain = np.stack([-(a * right + b * down) for a, b in basis @ u])
    assert relative(found, images) < 0.006 + 0.015 * amplitude**2
    if amplitude >= 0.4:
        assert relative(found, images) < 0.3 * relative(plain, images)


def test_the_flow_is_how_far_splats_move_by_blending_weight() -> None:
    """Against the dense twin that blends the shifts of the projected means, by central differences, as colours."""
    scene = SCENES["ordinary"]
    view, motion = view_of(scene), motion_of(scene, slice(0, 6))
    ends = [
        view_of(replace(scene, means=scene.means + sign * 1e-3 * torch.from_numpy(motion[:, :3]).double()))
        for sign in (1, -1)
    ]
    shift = (ends[0].splats[:, [MX, MY]] - ends[1].splats[:, [MX, MY]]) / 2e-3
    colours = torch.zeros_like(scene.colors)
    small = 0.4 / np.abs(shift).max()  # colours are 0.5 and that much, which no clamping reaches
    colours[:, 0, :2] = torch.from_numpy(small * shift).double() / 0.28209479177387814
    image, alpha = rasterize_dense(
        scene.means, scene.quats, scene.scales, scene.opacities, colours, scene.viewmats[0], scene.Ks[0],
        scene.width, scene.height,
    )  # fmt: skip
    found = flow(view, motion[None], Buffers())[0]
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
    monkeypatch.setattr(
        stage.Carried, "of", lambda _, v, shapes: np.zeros((len(shapes), 48, 48, 3), np.float32)
    )
    plain = amplitude_of(data, tmp_path / "plain", pale)
    assert plain > 1.05 * true
    assert abs(carried - true) < 0.5 * abs(plain - true)
