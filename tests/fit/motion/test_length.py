"""The whole motion stage on captures that hold no whole periods, with a second frequency and a drift beside it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.helpers.synthetic import CAMERA_ANGLE_X, _motion, _parts, make_synthetic_dataset
from tg4mm.capture import Capture, ImageStack, load_capture
from tg4mm.core.phasors import series_modes
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion import ModalMotion, MotionConfig
from tg4mm.fit.motion.animate import animate, displacement_at
from tg4mm.fit.rasterize import rasterization
from tg4mm.research.evaluate.displacement import displacement_figures
from tg4mm.run import Run
from tg4mm.run.stages.motion import train_motion

FPS, SIZE, VIEWS, T = 30.0, 48, 6, 23
FREQS = (4.7, 11.3)  # Hz, 3.6 and 8.7 cycles: the post's and the ball's
AMPLITUDE, RATE = 0.01, 0.02  # scene units, and of the drift per second along y
BAND = (3.5, 6.5)


def picture(gaussians: Gaussians, viewmat: np.ndarray) -> np.ndarray:
    """[SIZE, SIZE, 4] uint16, opaque on white."""
    focal = SIZE / (2 * math.tan(CAMERA_ANGLE_X / 2))
    K = torch.tensor([[[focal, 0, SIZE / 2], [0, focal, SIZE / 2], [0, 0, 1.0]]])
    g, view = gaussians, torch.as_tensor(viewmat, dtype=torch.float32)[None]
    args = (g.means, g.quats, g.scales, g.opacities, g.sh, view, K, SIZE, SIZE)
    rgb, alpha, _ = rasterization(*args, sh_degree=0)
    out = np.full((SIZE, SIZE, 4), 65535, np.uint16)
    out[..., :3] = ((rgb + 1 - alpha).clamp(0, 1) * 65535).round().numpy()[0]
    return out


def true_motion(drifts: bool, n_timesteps: int) -> ModalMotion:
    """The synthetic set's motion; everything drifts along y besides."""
    motion = _motion(_parts(1), FREQS, AMPLITUDE, FPS, n_timesteps)
    if not drifts:
        return motion
    t = np.arange(n_timesteps)
    gains = np.exp(2j * np.pi * np.array([*FREQS, 0.0])[:, None] * t / FPS)
    gains[2] = t / FPS
    drift = np.zeros_like(motion.displacement[:1])
    drift[..., 1] = RATE
    displacement = np.concatenate([motion.displacement, drift])
    return replace(
        motion,
        freqs_hz=np.array([*FREQS, 0.0]),
        displacement=displacement,
        rotation=0 * displacement,
        gains=gains,
    )


@pytest.fixture(scope="module", params=[False, True], ids=["still", "drifting"])
def fitted(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory):
    """(found, true, the post's Gaussians, the ball's), pictures rendered with the true motion."""
    root: Path = tmp_path_factory.mktemp("length")
    kinds = {"n_views": VIEWS, "n_timesteps": 1, "size": SIZE, "alphas": (), "n_test": 0}
    gaussians, _ = make_synthetic_dataset(root / "data", **kinds)
    true = true_motion(request.param, T)
    run = Run.create(root / "run", root / "data", "modal", {})
    run.save_space(gaussians, {})
    views = load_capture(root / "data")
    rows = [(t, v) for t in range(T) for v in range(VIEWS)]
    poses = [animate(gaussians, true, t) for t in range(T)]
    data = np.stack([picture(poses[t], views.viewmats[v]) for t, v in rows])
    times, cameras = np.array(rows).T
    capture = Capture(
        views.root, "train", SIZE, SIZE, FPS, T,
        views.viewmats[cameras], views.Ks[cameras], times, cameras, tuple(views.paths[v] for v in cameras),
    )  # fmt: skip
    # what moves everything before every camera at once would be taken for their shake
    found = train_motion(run, capture, ImageStack(data), MotionConfig(nuisance="exposure"))
    strength = np.abs(true.displacement[:2]).max(2)
    return found, true, strength[0] > 0.3 * AMPLITUDE, strength[1] > 0.3 * AMPLITUDE


def in_band(motion: ModalMotion, band: tuple[float, float] = BAND) -> ModalMotion:
    return motion.selected((motion.freqs_hz >= band[0]) & (motion.freqs_hz <= band[1]))


def series(motion: ModalMotion) -> np.ndarray:
    """[T, N, 3]."""
    return np.stack([displacement_at(motion, t) for t in range(T)])


def by_bins(motion: ModalMotion) -> ModalMotion:
    """The same motion, as the bins of a Fourier transform."""
    freqs, values = series_modes(series(motion), FPS)
    return replace(motion, freqs_hz=freqs, displacement=values, rotation=0 * values, appearance=None)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).sum(-1).mean()))


def test_both_frequencies_are_modes(fitted) -> None:
    found, _, post, ball = fitted
    for frequency, part in zip(FREQS, (post, ball), strict=True):
        strength = np.linalg.norm(found.displacement[:, part], axis=(1, 2)) * (found.freqs_hz > 1)
        assert found.freqs_hz[strength.argmax()] == pytest.approx(frequency, abs=0.05)


def test_a_band_holds_its_mode_and_nothing_else(fitted) -> None:
    """The ball, which only swings at 11.3 Hz and drifts, stays as it is; by bins a part of that lies in the band."""
    found, true, post, ball = fitted
    leak = rms(series(in_band(found))[:, ball]) / rms(series(true.selected(true.freqs_hz == 11.3))[:, ball])
    leak_of_bins = rms(series(in_band(by_bins(found)))[:, ball]) / rms(
        series(true.selected(true.freqs_hz == 11.3))[:, ball]
    )
    assert leak < 0.05
    assert leak_of_bins > 2 * leak
    weights = post.astype(float)
    error = displacement_figures(in_band(found), in_band(true), weights)["relative_error"]
    error_of_bins = displacement_figures(in_band(by_bins(found)), in_band(true), weights)["relative_error"]
    assert error < 0.75 * error_of_bins


def test_what_is_magnified_in_the_band_moves_nothing_else(fitted) -> None:
    """α = 20 adds twenty times the band's own motion: the ball's and the drift's way is what it was at α = 0."""
    found, true, _, ball = fitted
    change = np.stack([displacement_at(found, t, 20.0, BAND) - displacement_at(found, t) for t in range(T)])
    np.testing.assert_allclose(change, 20 * series(in_band(found)), atol=1e-5)
    assert rms(change[:, ball]) < 20 * 0.05 * rms(series(true.selected(true.freqs_hz == 11.3))[:, ball])


def test_the_motions_own_zero_is_found(fitted) -> None:
    """Without 0 Hz the motion is about its own zero. About the mean over time it lacks the true motion's mean, whose
    square the squared error is larger by; at least half of that is made good.
    """
    found, true, post, ball = fitted
    part = post | ball
    moving = found.selected(found.freqs_hz > 0)
    error = displacement_figures(moving, true, part.astype(float))["relative_error"]
    about_mean = displacement_figures(found, true, part.astype(float))["relative_error"]
    way = series(true)[:, part]
    assert about_mean**2 - error**2 > 0.5 * (rms(way.mean(0)) / rms(way)) ** 2
