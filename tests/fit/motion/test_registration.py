"""Pictures of cameras that shake are turned back; those of a scene that moves as a whole, and of none, are not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from tests.fit.motion.filmed import FPS, K_of, at_hz, elsewhere, fitted, length
from tests.helpers.synthetic import _at, _gaussians, _motion, _parts, _viewmats
from tg4mm.capture import ImageStack
from tg4mm.capture.pictures import over_white
from tg4mm.core.choices import Kind
from tg4mm.fit.motion import MotionConfig
from tg4mm.fit.motion.jacobian.view import view_jacobian
from tg4mm.fit.motion.large.registration import camera_rotations, homographies
from tg4mm.fit.motion.large.resampling import RegisteredPictures
from tg4mm.fit.motion.nuisance.fixed_cameras import _read_once, rest_views
from tg4mm.fit.motion.observations import Observations, PosedFrames

T, HZ, SHAKE_PX = 12, 5.0, 0.5
SIZE, FINER, BLUR = 64, 2, 1.6
WIDE = (64, 96)
K_WIDE = np.array([[110, 0, 50], [0, 110, 30], [0, 0, 1]], np.float32)


def texture(x, y):
    """[…, 3] in 0..1 at places in pixels."""
    waves = np.sin(0.5 * x + 0.3 * y), np.cos(0.4 * x - 0.6 * y), np.sin(0.35 * x) * np.sin(0.5 * y)
    return 0.5 + 0.3 * np.stack(waves, -1)


def through(back, size):
    """Places of the common pose, x and y [H, W], that a picture's pixels show; `back` [3, 3] goes the other way."""
    y, x = np.mgrid[: size[0], : size[1]] + 0.5
    at = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(back).T
    return at[..., 0] / at[..., 2], at[..., 1] / at[..., 2]


def random_turns(n, size, focal, seed=0):
    """[n, 3] radians of mean 0, so that the picture's middle shifts by `size` pixels rms."""
    turns = np.random.default_rng(seed).normal(size=(n, 3))
    turns -= turns.mean(0)
    return size / focal * turns / np.sqrt((turns[:, :2] ** 2).sum(1).mean())


def stored(pictures):
    """[n, H, W, 4] uint16, opaque, of [n, H, W, 3]."""
    out = np.full((*pictures.shape[:3], 4), 65535, np.uint16)
    out[..., :3] = (pictures.clip(0, 1) * 65535).round()
    return out


def turned_textures(turns):
    back = homographies(K_WIDE, turns)
    pictures = np.stack([texture(*through(h, WIDE)) for h in back])
    return RegisteredPictures(ImageStack(stored(pictures)), back)


def test_a_turned_picture_is_turned_back():
    """To a thousandth, but for what lay beyond its edges, by turns of more than a pixel and a roll."""
    y, x = np.mgrid[: WIDE[0], : WIDE[1]] + 0.5
    pictures = turned_textures(np.array([[0.01, -0.02, 0.03], [0, 0, 0.0], [-0.013, 0.004, -0.05]]))
    shown = pictures.strips([0, 1, 2])(slice(None))[..., :3]
    error = np.abs(shown - texture(x, y))[:, 12:-12, 12:-12]
    assert error.max() < 1e-3
    raw = over_white(pictures.pictures.strips([0, 2])(slice(None)), 65535)
    assert np.abs(raw - texture(x, y)).max() > 0.3


@pytest.mark.parametrize("moves", [0.0, 1.0])
def test_turns_are_found_beside_something_that_moves_by_itself(moves):
    """A fifth of the picture, by a pixel, to and fro."""
    n = 10
    turns = random_turns(n, SHAKE_PX, 110, seed=3)
    pictures = []
    for t, h in enumerate(homographies(K_WIDE, turns)):
        x, y = through(h, WIDE)
        inside = (np.abs(x - 40) < 18) & (np.abs(y - 32) < 18)
        pictures.append(texture(x - inside * moves * np.sin(1.3 * t), y) * (0.9 + 0.02 * np.cos(t)))
    noisy = np.stack(pictures) + 0.004 * np.random.default_rng(1).normal(size=(n, *WIDE, 3))
    frames = PosedFrames("0", np.eye(4, dtype=np.float32), K_WIDE, np.arange(n), np.arange(n) / FPS)
    stack = ImageStack(stored(noisy))
    found = camera_rotations(Observations(Kind.tripod, "synchronous", [frames], stack, FPS, n, False))
    off = 110 * np.sqrt(((found - turns)[:, :2] ** 2).sum(1).mean())
    assert off < (0.06 if moves else 0.01)
    assert np.abs(found - turns)[:, 2].max() < (2e-3 if moves else 5e-4)


@pytest.fixture(scope="module")
def moving():
    """A post and a ball, blurred, sway at 5 Hz by a quarter of a pixel; two periods in twelve timesteps."""
    parts = _parts(1)
    sharp = _gaussians(parts, 1)
    return replace(sharp, scales=BLUR * sharp.scales), _motion(parts, (HZ,), 0.012, FPS, T)


def filmed(at, n_views, shake_px, is_cut_out=False):
    """Fixed cameras that shake, each by itself; `at` gives the Gaussians at a timestep.

    Every picture is resampled from a finer one of the camera at rest: Gaussians rendered from a camera that turns pop,
    since their order in depth changes.
    """
    frames, pictures, K = [], [], K_of(SIZE)
    moments = [at(t) for t in range(T)]
    for v, viewmat in enumerate(_viewmats(n_views, 0.0)):
        rows = np.arange(len(pictures), len(pictures) + T)
        frames.append(PosedFrames(f"{v}", viewmat.astype(np.float32), K, rows, np.arange(T) / FPS))
        fine = replace(frames[-1], K=K_of(FINER * SIZE))
        turns = random_turns(T, shake_px, fine.K[0, 0] / FINER, seed=v)
        for moment, back in zip(moments, homographies(fine.K, turns), strict=True):
            # down to faint alphas: their cut-off at 1/255 would flicker where things move
            view = view_jacobian(moment, fine, (FINER * SIZE, FINER * SIZE))
            blended = np.concatenate([view.image[..., :3], 1 - view.transmittance[..., None]], -1)
            x, y = through(back, blended.shape[:2])
            moved = np.stack(
                [map_coordinates(c, [y - 0.5, x - 0.5]) for c in np.moveaxis(blended, -1, 0)], -1
            )
            colour, alpha = np.split(moved.reshape(SIZE, FINER, SIZE, FINER, 4).mean((1, 3)), [3], -1)
            values = colour / np.maximum(alpha, 1e-3) if is_cut_out else colour + 1 - alpha
            picture = stored(values[None])[0]
            if is_cut_out:
                picture[..., 3:] = (alpha.clip(0, 1) * 65535).round()
            pictures.append(picture)
    stack = ImageStack(np.stack(pictures))
    return Observations(Kind.rig, "synchronous", frames, stack, FPS, T, False)


def but_for_a_rigid_motion(field, means):
    """A field [N, 3] less the rigid motion of all Gaussians that is nearest to it."""
    turns = np.stack([np.cross(axis, means) for axis in np.eye(3)], -1)
    rigid = np.concatenate([np.tile(np.eye(3), (len(means), 1, 1)), turns], 2).reshape(-1, 6)
    return field - (rigid @ np.linalg.lstsq(rigid, field.ravel(), rcond=None)[0]).reshape(field.shape)


def apart(fit, other):
    """At the true frequency, but for a rigid motion, rms over that of the other."""
    left = but_for_a_rigid_motion(at_hz(fit, HZ) - at_hz(other, HZ), other.gaussians.means.numpy())
    return length(left) / length(at_hz(other, HZ))


def test_motion_before_cameras_that_shake_is_that_before_still_ones(moving):
    """By half a pixel, twice the motion. Left in, it is taken for motion."""
    gaussians, motion = moving
    steady, shaken = (filmed(lambda t: _at(gaussians, motion, t, 0), 6, px) for px in (0.0, SHAKE_PX))
    before, after, left_in = (
        fitted(gaussians, o, n) for o, n in ((steady, "auto"), (shaken, "auto"), (shaken, "exposure"))
    )
    assert apart(after, before) < 0.1
    assert elsewhere(after, HZ) < 0.15
    assert after.figures["shake_px"] == pytest.approx(SHAKE_PX, rel=0.1)
    assert sum("camera shake is removed: 0." in note for note in after.notes) == 1
    assert not any("shake" in note for note in before.notes)
    assert apart(left_in, before) > 0.5
    assert elsewhere(left_in, HZ) > 1


def test_a_shake_is_found_of_cameras_that_see_a_cut_out_object_alone(moving):
    """By what they disagree in."""
    gaussians, motion = moving
    shaken = filmed(lambda t: _at(gaussians, motion, t, 0), 6, SHAKE_PX, True)
    seen, shake_px = _read_once(shaken, rest_views(gaussians, shaken), gaussians, MotionConfig())
    assert shake_px > 0
    assert seen.figures["shake_own_share"] > 0.5
    assert "pose" in seen.figures["nuisance"]


def with_noise(observations, size, seed):
    """Noise of so much rms (0..1) on the object, alike in its three channels, as a renderer of few samples has it."""
    data = observations.pictures.data.astype(float)
    noise = 65535 * size * np.random.default_rng(seed).normal(size=(*data.shape[:3], 1))
    data[..., :3] += noise * (data[..., 3:] > 0)
    return replace(observations, pictures=ImageStack(data.clip(0, 65535).round().astype(np.uint16)))


@pytest.mark.parametrize("shake_px", [0.0, SHAKE_PX])
def test_noise_of_a_cut_out_object_is_no_shake_and_hides_none(moving, shake_px):
    """The object fills a part of the pictures; the noise on it changes them more than its motion does."""
    gaussians, motion = moving
    clean = filmed(lambda t: _at(gaussians, motion, t, 0), 6, shake_px, True)
    for seed in range(5):
        noisy = with_noise(clean, 0.1, seed)
        seen, found_px = _read_once(noisy, rest_views(gaussians, noisy), gaussians, MotionConfig())
        if shake_px:
            assert found_px == pytest.approx(shake_px, rel=0.3)
        else:
            assert found_px == 0
            assert seen.figures["shake_own_share"] < 0.25


@pytest.mark.parametrize("is_cut_out", [False, True])
def test_a_scene_that_moves_as_a_whole_is_not_stabilised(moving, is_cut_out):
    """It shifts by half a pixel and turns; four still cameras see the same motion."""
    gaussians, _ = moving
    rng = np.random.default_rng(0)
    shifts, turns = 0.03 * rng.normal(size=(T, 3)), 0.01 * rng.normal(size=(T, 3))

    def at(t):
        moved = Rotation.from_rotvec(turns[t]).apply(gaussians.means.numpy()) + shifts[t]
        return replace(gaussians, means=gaussians.means.new_tensor(moved))

    observations = filmed(at, 4, 0.0, is_cut_out)
    seen, shake_px = _read_once(observations, rest_views(gaussians, observations), gaussians, MotionConfig())
    assert shake_px == 0
    assert seen.figures["shake_own_share"] < 0.2
    assert "pose" not in seen.figures["nuisance"]
