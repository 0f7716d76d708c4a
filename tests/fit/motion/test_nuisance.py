"""What changes a whole picture is projected out: gain and offset exactly, the camera's own pose to first order.

A camera that shakes is distinguished from a scene that moves and from noise.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tests.fit.motion.filmed import FPS, K_of, at_hz, elsewhere, fitted, length
from tests.fit.motion.scenes import SCENES, Camera, camera_of, view_of
from tests.helpers import dense as reference
from tests.helpers.dense import rasterize_dense
from tests.helpers.synthetic import _at, _gaussians, _motion, _parts, _viewmats
from tg4mm.capture import ImageStack
from tg4mm.core.choices import Kind
from tg4mm.fit.motion.jacobian.view import ALPHA_MIN_LINEAR, view_jacobian
from tg4mm.fit.motion.nuisance.fixed_cameras import BlockShifts
from tg4mm.fit.motion.nuisance.projection import (
    EXPOSURE,
    POSE,
    Projection,
    inner_products,
    nuisances_of,
    without,
)
from tg4mm.fit.motion.observations import Observations, PosedFrames

SHAKE_SIZE, SHAKE_T = (96, 128), 20
STEADY = np.zeros((SHAKE_T, 2))
VIEWS, T, SIZE, HZ = 6, 12, 32, 5.0


def plain(scene):
    """Gaussians of one colour from all sides: a camera that turns sees the same colours."""
    colors = scene.colors.clone()
    colors[:, 1:] = 0
    return replace(scene, colors=colors)


def nuisance_of(scene, active):
    chosen = np.zeros(12, bool)
    chosen[active] = True
    means = scene.means.float().numpy()
    return nuisances_of([view_of(scene)], [camera_of(scene)], means, chosen)[0]


def seen(scene, turn, shift):
    """[H, W, 3] of the dense twin over white, its points turned about the camera's axes and shifted."""
    moved = torch.eye(4, dtype=torch.float64)
    moved[:3, :3] = torch.from_numpy(Rotation.from_rotvec(turn).as_matrix())
    moved[:3, 3] = torch.from_numpy(shift)
    image, alpha = rasterize_dense(
        scene.means, scene.quats, scene.scales, scene.opacities, scene.colors, moved @ scene.viewmats[0],
        scene.Ks[0], scene.width, scene.height,
    )  # fmt: skip
    return (image + 1 - alpha[..., None]).numpy()


def differences(scene, way):
    """Central differences of `seen` along a pose [6], [H, W, 3], and which pixels [H, W, 1] cross no threshold."""
    found = [
        (seen(scene, h * way[:3], h * way[3:]) - seen(scene, -h * way[:3], -h * way[3:])) / (2 * h)
        for h in (1e-6, 3e-6)
    ]
    # a step is worth its height over 2 h: three times less at three times the step
    apart = np.abs(found[0] - found[1]).max(-1, keepdims=True)
    return found[0], apart < 1e-4 * np.abs(found[0]).max()


@pytest.mark.parametrize("axis", range(6), ids=["pitch", "yaw", "roll", "right", "down", "along"])
def test_columns_of_the_pose_are_what_a_camera_that_moves_sees(axis, monkeypatch):
    """Against the dense twin; of another column, or a thousandth more, the comparison would tell."""
    monkeypatch.setattr(reference, "ALPHA_MIN", ALPHA_MIN_LINEAR)
    scene = plain(SCENES["ordinary"])
    expected, safe = differences(scene, np.eye(6)[axis])
    assert safe.mean() > 0.97
    assert length(expected) > 1
    columns = nuisance_of(scene, POSE).columns(np.zeros((scene.height, scene.width, 3), np.float32))
    off = [length((column - expected) * safe) / length(expected * safe) for column in columns]
    assert off[axis] < 1e-3
    assert sorted(off)[1] > 0.1


def changed(scene, size):
    """Mean picture, and changes of two frames: exposure and a pose that differ by `size` of a pixel or so."""
    mean = seen(scene, np.zeros(3), np.zeros(3))
    rng, frames = np.random.default_rng(3), []
    for _ in range(2):
        turn, shift = 0.01 * size * rng.normal(size=3), 0.02 * size * rng.normal(size=3)
        gain, offset = 1 + 0.05 * rng.normal(size=3), 0.02 * rng.normal(size=3)
        frames.append(seen(scene, turn, shift) * gain + offset - mean)
    return mean.astype(np.float32), np.stack(frames).astype(np.float32)


def test_exposure_is_projected_out_of_a_picture_exactly():
    scene = plain(SCENES["ordinary"])
    mean, changes = changed(scene, 0.0)
    left = without(nuisance_of(scene, EXPOSURE), mean, changes)
    assert length(left) < 1e-5 * length(changes)


@pytest.mark.parametrize("size", [0.1, 0.4])
def test_a_small_motion_of_the_camera_is_projected_out_to_first_order(size, monkeypatch):
    """What stays goes by the square; without the columns of the pose nearly all of it stays."""
    monkeypatch.setattr(reference, "ALPHA_MIN", ALPHA_MIN_LINEAR)
    scene = plain(SCENES["ordinary"])
    mean, changes = changed(scene, size)
    of_pose = without(nuisance_of(scene, EXPOSURE), mean, changes)
    left = without(nuisance_of(scene, slice(0, 12)), mean, changes)
    assert length(left) < 1.2 * size * length(of_pose)
    assert length(of_pose) > 0.3 * size * length(changes)


def test_columns_that_say_the_same_are_one():
    """Before a mean of one grey, gain and offset are the same; nothing is divided by zero."""
    scene = SCENES["ordinary"]
    mean = np.full((scene.height, scene.width, 3), 0.5, np.float32)
    noise = np.random.default_rng(0).normal(size=(1, *mean.shape)).astype(np.float32)
    left = without(nuisance_of(scene, EXPOSURE), mean, noise)
    expected = noise - noise.mean((1, 2), keepdims=True)
    np.testing.assert_allclose(left, expected, atol=1e-4)
    assert len(Projection.of(nuisance_of(scene, EXPOSURE), mean, None).root) == 3


def test_products_by_strips_are_those_with_the_columns():
    scene = SCENES["ordinary"]
    mean, changes = changed(scene, 0.4)
    nuisance = nuisance_of(scene, slice(0, 12))
    found = np.zeros((12, 2))
    for rows in (slice(0, 10), slice(10, scene.height)):
        found += inner_products(nuisance, mean, rows, changes[:, rows].reshape(2, -1))
    columns = nuisance.columns(mean).reshape(12, -1).astype(np.float64)
    expected = columns @ changes.reshape(2, -1).T
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())
    left = without(nuisance, mean, changes).reshape(2, -1).astype(np.float64)
    flat = changes.reshape(2, -1).astype(np.float64)
    np.testing.assert_allclose(
        nuisance.explained_gram(mean, found), flat @ flat.T - left @ left.T, atol=1e-4 * (flat**2).sum()
    )


def smooth(gaussians, viewmat):
    """[H, W, 3] over white, rendered down to faint alphas: their cut-off at 1/255 would flicker where things move."""
    view = view_jacobian(gaussians, Camera(viewmat.astype(np.float32), K_of(SIZE)), (SIZE, SIZE))
    return view.over_white


def filmed(frame, gaussians, motion):
    """`frame` gets a picture [H, W, 3] in 0..1, the camera and the timestep."""
    frames, pictures = [], []
    for v, viewmat in enumerate(_viewmats(VIEWS, 0.0)):
        rows = np.arange(len(pictures), len(pictures) + T)
        for t in range(T):
            shown = smooth(_at(gaussians, motion, t, 0), viewmat)
            raw = np.full((SIZE, SIZE, 4), 65535, np.uint16)
            raw[..., :3] = (frame(shown, v, t).clip(0, 1) * 65535).round()
            pictures.append(raw)
        frames.append(PosedFrames(f"{v}", viewmat.astype(np.float32), K_of(SIZE), rows, np.arange(T) / FPS))
    stack = ImageStack(np.stack(pictures))
    return Observations(Kind.rig, "synchronous", frames, stack, FPS, T, True)


@pytest.fixture(scope="module")
def moving():
    """A post and a ball sway at 5 Hz by an eighth of a pixel; two periods in twelve timesteps."""
    parts = _parts(1)
    return _gaussians(parts, 1), _motion(parts, (HZ,), 0.012, FPS, T)


def test_drift_of_exposure_changes_no_motion(moving):
    """A drift of 5 %, another in each camera and channel. Not projected out, it is taken for motion."""
    gaussians, motion = moving
    rng = np.random.default_rng(4)
    drift = 0.8 + 0.05 * np.cumsum(rng.normal(size=(VIEWS, T, 3)), 1) / np.sqrt(T / 2)
    offset = 0.01 * rng.normal(size=(VIEWS, T, 3))
    steady = fitted(gaussians, filmed(lambda p, v, t: 0.8 * p, gaussians, motion), "auto")
    drifting = filmed(lambda p, v, t: drift[v, t] * p + offset[v, t], gaussians, motion)
    taken_out, left_in = (fitted(gaussians, drifting, n) for n in ("auto", "none"))
    size = length(at_hz(steady, HZ))
    off = [length(at_hz(f, HZ) - at_hz(steady, HZ)) / size for f in (taken_out, left_in)]
    assert off[0] < 0.08
    assert off[1] > 3 * off[0]
    assert elsewhere(taken_out, HZ) < 0.1
    assert elsewhere(left_in, HZ) > 3 * elsewhere(taken_out, HZ)
    assert taken_out.figures["nuisance"] == ["exposure"]
    assert 2 < taken_out.figures["exposure_gain_percent"] < 10
    assert left_in.figures["nuisance"] == []


def texture(right, down):
    """[H, W, 3] at pixels moved by [H, W] each."""
    y, x = np.mgrid[: SHAKE_SIZE[0], : SHAKE_SIZE[1]].astype(float)
    x, y = x - right, y - down
    waves = np.sin(0.5 * x + 0.3 * y), np.cos(0.4 * x - 0.6 * y), np.sin(0.35 * x) * np.sin(0.5 * y)
    return 0.5 + 0.3 * np.stack(waves, -1)


def shake_filmed(right, down, noise=0.005):
    """Frames whose pixels are moved by [SHAKE_T, H, W] each, less their mean."""
    rng = np.random.default_rng(0)
    frames = np.stack([texture(r, d) for r, d in zip(right, down, strict=True)])
    frames += noise * rng.normal(size=frames.shape)
    found = BlockShifts.of(texture(np.zeros(SHAKE_SIZE), np.zeros(SHAKE_SIZE)).astype(np.float32), SHAKE_T)
    changes = (frames - frames.mean(0)).astype(np.float32)
    for top in range(0, SHAKE_SIZE[0], 29):  # by strips that are not the blocks'
        rows = slice(top, min(top + 29, SHAKE_SIZE[0]))
        found.add(rows, changes[:, rows])
    return found


def everywhere(shifts):
    """[SHAKE_T, H, W] each, of shifts [SHAKE_T, 2]."""
    right, down = (np.broadcast_to(s[:, None, None], (SHAKE_T, *SHAKE_SIZE)) for s in shifts.T)
    return right.copy(), down.copy()


def random_shifts(size, seed=1):
    """[SHAKE_T, 2] pixels, each axis of so much rms; mean 0."""
    shifts = np.random.default_rng(seed).normal(size=(SHAKE_T, 2))
    shifts -= shifts.mean(0)
    return size * shifts / np.sqrt((shifts**2).mean(0))


@pytest.mark.parametrize("size", [0.05, 0.2, 0.4])
def test_a_camera_that_shakes_is_found_with_its_pixels(size):
    """Both axes together: √2 of what each has."""
    pixels, is_shaking = shake_filmed(*everywhere(random_shifts(size))).shake()
    assert is_shaking
    assert pixels == pytest.approx(np.sqrt(2) * size, rel=0.15)


@pytest.mark.parametrize("what", ["roll", "zoom"])
def test_a_camera_that_rolls_or_comes_nearer_shakes_too(what):
    y, x = np.mgrid[: SHAKE_SIZE[0], : SHAKE_SIZE[1]].astype(float)
    x, y = x - SHAKE_SIZE[1] / 2, y - SHAKE_SIZE[0] / 2
    way = (-y, x) if what == "roll" else (x, y)
    amount = 0.01 * np.random.default_rng(2).normal(size=(SHAKE_T, 1, 1))
    assert shake_filmed(amount * way[0], amount * way[1]).shake()[1]


@pytest.mark.parametrize("side", [40, 80])
def test_an_object_that_moves_before_what_stands_still_is_no_shake(side):
    """Up to more than half of the picture, by more than any shake."""
    right, down = everywhere(random_shifts(1.0))
    mask = np.zeros(SHAKE_SIZE, bool)
    mask[8 : 8 + side, 10 : 10 + side] = True
    pixels, is_shaking = shake_filmed(right * mask, down * mask).shake()
    assert not is_shaking
    assert pixels < 0.02


def test_an_object_that_moves_before_a_camera_that_shakes_is_a_shake():
    right, down = everywhere(random_shifts(0.2))
    mask = np.zeros(SHAKE_SIZE, bool)
    mask[20:60, 20:60] = True
    own = random_shifts(1.0, seed=7)
    pixels, is_shaking = shake_filmed(right + mask * own[:, :1, None], down + mask * own[:, 1:, None]).shake()
    assert is_shaking
    assert pixels == pytest.approx(np.sqrt(2) * 0.2, rel=0.2)


@pytest.mark.parametrize("noise", [0.0, 0.005, 0.05])
def test_noise_is_no_shake(noise):
    pixels, is_shaking = shake_filmed(*everywhere(STEADY), noise).shake()
    assert not is_shaking
    assert pixels < 0.01
