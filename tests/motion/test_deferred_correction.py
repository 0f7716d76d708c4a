"""What pictures show of motion beyond the derivative: the second-order Taylor term, and the optical flow it takes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from tests.motion.scenes import SCENES, motion_of, view_of
from tg4mm.motion import deferred_correction as module
from tg4mm.motion.deferred_correction import TaylorTerms
from tg4mm.motion.jacobian.pixels import optical_flow
from tg4mm.rasterize.buffers import Buffers
from tg4mm.rasterize.kernels.layout import MX, MY
from tg4mm.rasterize.reference import rasterize_dense

T, SIZE = 30, 40
INNER = (slice(None), slice(2, -2), slice(2, -2))  # away from the edges, where derivatives are one-sided
ALONG = np.array([0.8, 0.6])


def texture(shift: np.ndarray) -> np.ndarray:
    """[H, W, 3]: waves of 9 to 16 pixels, moved by `shift` pixels."""
    y, x = np.mgrid[0:SIZE, 0:SIZE].astype(np.float64)
    x, y = x - shift[0], y - shift[1]
    waves = np.sin(0.6 * x + 0.3 * y), np.cos(0.4 * x - 0.5 * y), np.sin(0.3 * x) * np.sin(0.6 * y)
    return 0.5 + 0.3 * np.stack(waves, -1)


def slopes(u: np.ndarray) -> np.ndarray:
    """[H, W, 3]: what moving the texture by u [2] changes to first order."""
    return (texture(1e-3 * u) - texture(-1e-3 * u)) / 2e-3


def seen(u: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of a texture that moves by u [T, 2]: mean [H, W, 3], basis [R, T] and target images [R, H, W, 3]."""
    pictures = np.stack([texture(now) for now in u])
    flat = (pictures - pictures.mean(0)).reshape(len(u), -1)
    basis = np.linalg.eigh(flat @ flat.T)[1][:, ::-1].T[:most]
    return pictures.mean(0), basis, (basis @ flat).reshape(most, SIZE, SIZE, 3)


def terms(monkeypatch: pytest.MonkeyPatch, mean: np.ndarray, basis: np.ndarray, u: np.ndarray) -> np.ndarray:
    """By `TaylorTerms`, of a motion by u [T, 2] everywhere."""
    moves = np.zeros((len(basis), SIZE, SIZE, 3), np.float32)
    moves[..., :2] = (basis @ u)[:, None, None]
    monkeypatch.setattr(module, "optical_flow", lambda *_: moves)
    views: Any = [SimpleNamespace()]
    return TaylorTerms(views, mean[None].astype(np.float32), basis).of(0, np.zeros(0, np.float32))


def swing(hz: float, n: int = T, phase: float = 0.3) -> np.ndarray:
    return np.cos(2 * np.pi * hz * np.arange(n) / n + phase)


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(found[INNER] - expected[INNER]) / np.linalg.norm(expected[INNER]))


@pytest.mark.parametrize("amplitude", [0.1, 0.4, 0.7])
def test_twice_the_frequency_is_no_motion(amplitude: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sinusoid's pictures have a second component, that nothing moves by: its squares."""
    u = amplitude * swing(5)[:, None] * ALONG
    mean, basis, images = seen(u, 2)
    assert np.abs(basis[1] @ u).max() < 0.02 * np.abs(basis[0] @ u).max()
    assert relative(terms(monkeypatch, mean, basis, u)[1:], images[1:]) < 0.1


def test_two_frequencies_an_octave_apart_change_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Target images are the slopes by the motion and this, to a tenth of what this is."""
    u = 0.4 * swing(5)[:, None] * ALONG + 0.25 * swing(10, phase=0.0)[:, None] * [0.6, -0.8]
    mean, basis, images = seen(u, 2)
    beyond = images - np.stack([slopes(a) for a in basis @ u])
    found = terms(monkeypatch, mean, basis, u)
    assert relative(found, beyond) < 0.2
    for r in range(2):
        assert np.linalg.norm(beyond[r]) > 0.015 * np.linalg.norm(images[r])


def test_frequencies_of_their_own_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Five and eleven cycles: no sum of two of them, or difference, is either."""
    u = 0.3 * swing(5)[:, None] * ALONG + 0.2 * swing(11)[:, None] * [0.6, -0.8]
    basis = np.stack([swing(5), swing(11)]) * np.sqrt(2 / T)
    mean = np.stack([texture(now) for now in u]).mean(0)
    images = np.stack([slopes(a) for a in basis @ u])
    assert np.linalg.norm(terms(monkeypatch, mean, basis, u)) < 1e-3 * np.linalg.norm(images)


def test_squares_of_weak_components_do_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of six, the fifth alone moves: its square is in the sixth, but it is not among the four that count."""
    t = 120
    basis = np.stack([swing(hz, t) for hz in (7, 11, 23, 31, 13, 26)]) * np.sqrt(2 / t)
    mean = texture(np.zeros(2))
    for hz, counts in ((13, False), (7, True)):
        other = basis.copy()
        if counts:
            other[5] = swing(14, t, 0.6) * np.sqrt(2 / t)
        found = terms(monkeypatch, mean, other, 0.5 * swing(hz, t)[:, None] * ALONG)
        assert found[5].any() == counts


def test_what_is_mistaken_by_many_pixels_does_not_grow_with_its_square(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mean, basis, _ = seen(0.4 * swing(5)[:, None] * ALONG, 2)
    sizes = [
        float(np.linalg.norm(terms(monkeypatch, mean, basis, a * swing(5)[:, None] * ALONG)))
        for a in (0.5, 1.0, 5.0, 20.0)
    ]
    assert sizes[1] == pytest.approx(4 * sizes[0], rel=1e-3)
    assert sizes[3] == pytest.approx(sizes[2], rel=1e-3)


def test_a_ramp_that_moves_has_none_up_to_its_edges(monkeypatch: pytest.MonkeyPatch) -> None:
    ramp = np.mgrid[0:SIZE, 0:SIZE].sum(0)[..., None] * np.full(3, 0.01)
    u = 0.5 * swing(5)[:, None] * ALONG
    _, basis, _ = seen(u, 2)
    curved = np.linalg.norm(terms(monkeypatch, texture(np.zeros(2)), basis, u))
    assert np.abs(terms(monkeypatch, ramp, basis, u)).max() < 1e-5 * curved


def test_what_does_not_move_has_none() -> None:
    view = view_of(SCENES["ordinary"])
    still = np.zeros((2, len(view.splats), 6), np.float32)
    noise = np.random.default_rng(0).uniform(size=(1, *view.transmittance.shape, 3)).astype(np.float32)
    basis = np.stack([swing(5), swing(10)]) * np.sqrt(2 / T)
    assert not TaylorTerms([view], noise, basis).of(0, still).any()


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
