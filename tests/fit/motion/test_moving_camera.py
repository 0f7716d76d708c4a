"""A camera that moves all the time: its poses are corrected, motion before it is found, and what stands still."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.fit.motion.filmed import error_of, scene, walk
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.nuisance.poses import CameraPath, corrected_poses
from tg4mm.fit.motion.pipeline import fit_motion

FREQUENCY = 3.4  # Hz
FPS, N_FRAMES, HZ = 30.0, 150, 3.4
TIMES = np.arange(N_FRAMES) / FPS
MEANS = np.random.default_rng(0).normal(size=(400, 3))
MOVES = np.arange(400) < 160  # two fifths of what is seen
SHIFT, TURN = np.array([0.01, 0.0, 0.005]), np.array([0.0, 0.004, 0.0])
FIELD = np.where(MOVES[:, None], SHIFT + np.cross(TURN, MEANS), 0.0).astype(complex)


@pytest.mark.slow
def test_the_motion_of_the_scene_is_found_though_poses_are_off():
    gaussians, motion = scene(FREQUENCY)
    fit = fit_motion(gaussians, walk(gaussians, motion, 90, tremor=1e-3), MotionConfig(appearance=False))
    nearest = int(np.abs(fit.motion.freqs_hz - FREQUENCY).argmin())
    assert fit.motion.freqs_hz[nearest] == pytest.approx(FREQUENCY, abs=0.05)
    found, true = fit.motion.displacement[nearest], motion.displacement[0]
    opacities = gaussians.opacities.numpy()
    # A third of what is seen moves, by 0.17 px, and each half of 45 pictures is fitted by itself. Motion that looks
    # like the camera's own is found late: with exact poses, all pictures and the true support 0.62, 0.79 and 0.84 of
    # it are there after 14, 28 and 56 iterations. Over ten seeds, mean ± standard deviation: error 0.60 ± 0.04,
    # MAC 0.67 ± 0.05, ratio 0.51 ± 0.04; the bounds lie four deviations away.
    assert error_of(found, true, opacities) < 0.75
    mac = np.abs(np.vdot(found, true)) ** 2 / (np.vdot(found, found) * np.vdot(true, true)).real
    assert mac > 0.5
    assert np.vdot(true, found).real > 0.35 * np.vdot(true, true).real
    assert any("looks like motion of the camera" in note for note in fit.notes)


@pytest.mark.slow
def test_motion_of_which_nothing_tells_what_stands_still_is_let_go(monkeypatch):
    real = CameraPath.reading
    monkeypatch.setattr(CameraPath, "reading", lambda *own: replace(real(*own), is_determined=False))
    gaussians, motion = scene(FREQUENCY)
    fit = fit_motion(gaussians, walk(gaussians, motion, 90), MotionConfig(appearance=False))
    assert len(fit.motion.freqs_hz) == 0
    assert fit.undetermined_hz[0] == pytest.approx(FREQUENCY, abs=0.05)
    assert fit.figures["frequencies_hz"][0] == pytest.approx(FREQUENCY, abs=0.05)
    assert not any("two halves" in note for note in fit.notes)
    assert any("nor the camera's path separates it" in note for note in fit.notes)


def test_poses_that_are_off_are_corrected():
    gaussians, _ = scene(FREQUENCY)
    off, exact = walk(gaussians, None, 8, tremor=2e-3), walk(gaussians, None, 8)
    corrected, exposures, pixels = corrected_poses(gaussians, off, 0)
    before = max(np.abs(a.viewmat - b.viewmat).max() for a, b in zip(off.frames, exact.frames, strict=True))
    after = max(np.abs(a.viewmat - b.viewmat).max() for a, b in zip(corrected, exact.frames, strict=True))
    assert after < 0.2 * before
    assert pixels > 0.02
    assert np.abs(exposures).max() < 0.02


@pytest.mark.parametrize(("seed", "n_frames"), [(0, 40), (1, 40), (2, 90)])
def test_a_still_scene_has_no_motion(seed, n_frames):
    gaussians, _ = scene(FREQUENCY)
    observations = walk(gaussians, None, n_frames, seed=seed)
    fit = fit_motion(gaussians, observations, MotionConfig(appearance=False))
    assert len(fit.motion.freqs_hz) == 0


def viewmats(tremor, line, seed=0):
    """[F, 4, 4] of a walk around the scene with `tremor` of white noise; the scene seems to move by `line` · FIELD.

    The noise is of turns and shifts before the camera, at every frequency alike.
    """
    rng, out = np.random.default_rng(seed), []
    for t in TIMES:
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("y", 0.3 * np.sin(0.5 * t)).as_matrix()
        pose[:3, 3] = 0, 0, 4
        scene, hand = np.eye(4), np.eye(4)
        scene[:3, :3] = Rotation.from_rotvec(line * TURN * np.cos(2 * np.pi * HZ * t)).as_matrix()
        scene[:3, 3] = line * SHIFT * np.cos(2 * np.pi * HZ * t)
        hand[:3, :3] = Rotation.from_rotvec(tremor * rng.normal(size=3)).as_matrix()
        hand[:3, 3] = 4 * tremor * rng.normal(size=3)
        out.append(hand @ pose @ scene)
    return np.array(out)


def path_of(poses):
    return CameraPath.of(TIMES, poses, np.zeros((N_FRAMES, 6)), MEANS, np.ones(400))


def reading(poses, hz=HZ, others=()):
    path = path_of(poses)
    return path.reading(path.moved, FIELD, MOVES, hz, np.array(others), 1.0)


@pytest.mark.parametrize("seed", range(3))
def test_a_hand_without_a_line_at_the_frequency_says_that_the_rest_stands_still(seed):
    found = reading(viewmats(1e-4, 0.0, seed))
    assert found.rigid is None
    assert found.doubt < 0.01
    assert found.is_determined
    assert found.moving_share == pytest.approx(0.4)


@pytest.mark.parametrize("seed", range(3))
def test_a_line_in_the_path_says_that_what_was_found_to_move_stands_still(seed):
    found = reading(viewmats(1e-4, -1.0, seed))
    assert found.doubt < 0.01
    assert found.is_determined
    assert found.moving_share == pytest.approx(0.6)
    np.testing.assert_allclose(found.rigid[MOVES, :3], FIELD[MOVES], atol=1e-9)
    away = SHIFT + np.cross(TURN, MEANS[~MOVES])
    np.testing.assert_allclose(found.rigid[~MOVES, :3], away, atol=1e-9)
    np.testing.assert_allclose(found.rigid[:, 3:], np.broadcast_to(TURN, (400, 3)), atol=1e-9)


def test_a_hand_that_shakes_more_than_the_scene_leaves_the_share_of_what_moves():
    found = [reading(viewmats(0.15, 0.0, seed)) for seed in range(12)]
    assert np.median([r.doubt for r in found]) == pytest.approx(0.4, abs=0.1)
    assert sum(r.is_determined for r in found) < 4


def test_a_line_that_neither_reading_explains_is_not_reported():
    """The scene seems to move as a whole, across what moves in it."""
    poses = viewmats(1e-4, 0.0)
    poses[:, 1, 3] += 0.02 * np.cos(2 * np.pi * HZ * TIMES)
    found = reading(poses)
    assert not found.is_determined
    assert np.sqrt(np.median(found.squares)) == pytest.approx(0.02, rel=0.1)


def test_where_no_frequencies_are_around_one_the_share_is_left():
    found = reading(viewmats(1e-4, 0.0), HZ, (1.0, 1.8, 2.4, 4.2, 4.8, 5.4))
    assert found.doubt == pytest.approx(0.4)
    assert not found.is_determined


def test_the_path_is_that_of_poses_and_of_what_the_residual_still_holds_of_them():
    """Half of a motion in the poses, half in the pose columns' coefficients, is the whole."""
    still, half = path_of(viewmats(0.0, 0.0)), viewmats(0.0, 0.5)
    left = np.einsum("fab,fb->fa", np.linalg.inv(still.to_world), path_of(half).moved - still.moved)
    both = CameraPath.of(TIMES, half, left, MEANS, np.ones(400)).moved - still.moved
    whole = path_of(viewmats(0.0, 1.0)).moved - still.moved
    scale = np.abs(whole).max()
    np.testing.assert_allclose(both - both[0], whole - whole[0], atol=0.03 * scale)


def test_the_doubt_is_as_often_right_as_it_says():
    """For hands that shake from a hundredth of the motion to ten times it, at random, wrong as often as said."""
    rng, still = np.random.default_rng(0), path_of(viewmats(0.0, 0.0))
    wave = np.cos(2 * np.pi * HZ * TIMES)[:, None] * np.concatenate([TURN, SHIFT])
    said, right = [], []
    for _ in range(600):
        is_other = rng.random() < 0.4
        mixed = rng.normal(size=(6, 6)) * np.concatenate([TURN, SHIFT]).max()
        shakes = np.exp(rng.uniform(np.log(0.01), np.log(10))) * rng.normal(size=(N_FRAMES, 6)) @ mixed
        found = still.reading(shakes - is_other * wave, FIELD, MOVES, HZ, np.zeros(0), 1.0)
        said.append(found.doubt)
        right.append((found.rigid is not None) == is_other)
    doubt, wrong = np.array(said), ~np.array(right)
    for low, high in ((0.0, 0.1), (0.1, 0.5)):
        own = (doubt >= low) & (doubt <= high)
        deviation = np.sqrt(np.mean(doubt[own] * (1 - doubt[own])) / own.sum())
        assert own.sum() > 20
        assert abs(wrong[own].mean() - doubt[own].mean()) < 3 * deviation + 0.005
