"""Blending weights against the compositing formula, computed pixel by pixel."""

from pathlib import Path

import numpy as np
import pytest
import torch

from tg4mm.capture import Capture
from tg4mm.fit.gaussians import Gaussians
from tg4mm.show.weights import blending_weights

SIZE, FOCAL, DISTANCE = 32, 40.0, 4.0
EPS2D = 0.3  # pixels², the low-pass that gsplat adds


def balls(means: list[list[float]], scale: float, opacities: list[float]) -> Gaussians:
    n = len(means)
    quats = torch.tensor([[1.0, 0, 0, 0]]).expand(n, 4)
    # A dark colour: weights must not depend on it.
    return Gaussians(
        torch.tensor(means), quats, torch.full((n, 3), scale), torch.tensor(opacities), -torch.ones(n, 1, 3)
    )


def capture(n_images: int, camera_ids: list[int]) -> Capture:
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


def alpha_image(scale: float, opacity: float, depth: float) -> np.ndarray:
    """Opacity of a centred ball in each pixel: o exp(−r² / 2σ²), nothing below 1/255."""
    variance = (FOCAL * scale / depth) ** 2 + EPS2D
    offsets = np.arange(SIZE) + 0.5 - SIZE / 2
    alpha = opacity * np.exp(-(offsets[:, None] ** 2 + offsets**2) / (2 * variance))
    return np.where(alpha >= 1 / 255, alpha, 0.0)


def test_one_behind_another_gets_what_the_first_lets_through() -> None:
    front, back = alpha_image(0.2, 0.6, DISTANCE), alpha_image(0.2, 0.8, DISTANCE + 1)
    weights = blending_weights(balls([[0, 0, 1.0], [0, 0, 0.0]], 0.2, [0.8, 0.6]), capture(1, [0]))
    assert weights.shape == (2,)
    np.testing.assert_allclose(weights, [(back * (1 - front)).sum(), front.sum()], rtol=2e-3)
    assert weights[0] < 0.75 * back.sum()  # without the front one it would weigh this much more


def test_each_image_counts_also_where_a_camera_took_several() -> None:
    gaussians = balls([[0, 0, 0.0]], 0.2, [0.6])
    near, far = (alpha_image(0.2, 0.6, DISTANCE * k).sum() for k in (1, 2))
    weights = blending_weights(gaussians, capture(5, [0, 1, 0, 0, 1]))
    np.testing.assert_allclose(weights, [3 * near + 2 * far], rtol=2e-3)


def test_what_no_camera_sees_weighs_nothing() -> None:
    weights = blending_weights(
        balls([[0, 0, 0], [0, 0, -10.0], [50.0, 0, 0]], 0.2, [0.6] * 3), capture(1, [0])
    )
    assert weights[0] > 1
    np.testing.assert_array_equal(weights[1:], 0)


@pytest.mark.parametrize("grad", [False, True])
def test_its_input_is_left_alone(grad) -> None:
    gaussians = balls([[0, 0, 0.0]], 0.2, [0.6])
    gaussians.sh.requires_grad_(grad)
    blending_weights(gaussians, capture(1, [0]))
    assert gaussians.sh.grad is None
