"""Cameras with clocks of their own: frequency, phases and 3D motion of a steady vibration."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fit.motion.filmed import FPS, clips, error_of, scene
from tg4mm.fit.motion.checkpoints import no_checkpoint
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.jacobian.pixels import pixels_moved
from tg4mm.fit.motion.jacobian.view import view_jacobian
from tg4mm.fit.motion.pipeline import fit_motion, without_motion
from tg4mm.fit.motion.temporal.independent import IndependentClocks, clock_offset

FREQUENCY = 3.4  # Hz: between the DFT bins of these clips
STARTS = (0.0, 3.0, 11.0, 6.0, 1.5, 8.0)  # timesteps


@pytest.fixture(scope="module")
def fitted():
    gaussians, motion = scene(FREQUENCY)
    fit = fit_motion(gaussians, clips(gaussians, motion, STARTS, 40), MotionConfig(appearance=False))
    return fit, motion.displacement[0], gaussians.opacities.numpy()


def test_the_frequency_is_found_and_nothing_else(fitted):
    (hz,) = fitted[0].motion.freqs_hz
    assert hz == pytest.approx(FREQUENCY, abs=0.03)


def test_the_phases_of_the_clips_are_found(fitted):
    figures = fitted[0].figures["clip_phases_deg"]
    found = np.array([next(iter(own.values())) for own in figures.values()])
    true = 360 * FREQUENCY * np.array(STARTS) / FPS
    assert np.abs((found - true + 180) % 360 - 180).max() < 5


def test_the_motion_is_found_in_3d(fitted):
    fit, true, opacities = fitted
    # the same pictures as of one clock give 0.30: the ball is plain
    assert error_of(fit.motion.displacement[0], true, opacities) < 0.4
    assert error_of(0 * true, true, opacities) == 1


def test_a_rig_is_told_the_offsets_of_its_clocks():
    gaussians, motion = scene(FREQUENCY)
    starts = (0.0, 1.0, 2.0, -1.0, 0.5, -2.0)
    fit = fit_motion(gaussians, clips(gaussians, motion, starts, 40, "rig"), MotionConfig(appearance=False))
    offsets = np.array(list(fit.figures["clock_offsets_s"].values()))
    assert np.abs(offsets - np.array(starts) / FPS).max() < 0.005
    (note,) = [note for note in fit.notes if "offsets" in note]
    for name, seconds in fit.figures["clock_offsets_s"].items():
        assert f"{name} {seconds:+.4g} s" in note


def test_a_flat_video_with_missing_frames_shows_what_it_shows_with_all():
    gaussians, motion = scene(FREQUENCY)
    whole = clips(gaussians, motion, [0.0], 60, "flat")
    whole = replace(whole, clock="synchronous")
    (camera,) = whole.frames
    kept = np.delete(np.arange(60), [20, 21, 41])
    camera = replace(camera, rows=camera.rows[kept], times_s=camera.times_s[kept])
    with_all = fit_motion(gaussians, whole, MotionConfig(appearance=False)).motion
    fit = fit_motion(gaussians, replace(whole, frames=[camera]), MotionConfig(appearance=False))
    fields = []
    for own in (with_all, fit.motion):
        at = np.argmin(np.abs(own.freqs_hz - FREQUENCY))
        assert own.freqs_hz[at] == pytest.approx(FREQUENCY, abs=0.01)
        fields.append(own.displacement[at])
    assert np.linalg.norm(fields[1] - fields[0]) < 0.05 * np.linalg.norm(fields[0])
    along = fit.motion.displacement @ camera.viewmat[2, :3]
    assert np.abs(along).max() < 1e-6 * np.abs(fit.motion.displacement).max()
    assert any("only motion across the line of sight" in note for note in fit.notes)
    assert fit.figures["duration_s"] == pytest.approx(2.0)


@pytest.mark.parametrize("amplitude", [0.0005, 0.01])
def test_the_pixels_that_things_move_by_are_told_of_any_motion(amplitude):
    gaussians, motion = scene(FREQUENCY, amplitude)
    seen = replace(clips(gaussians, motion, [0.0] * 6, 40, "rig"), clock="synchronous")
    views = [view_jacobian(gaussians, frames, seen.size) for frames in seen.frames]
    true = pixels_moved(views, np.abs(motion.displacement).astype(np.float32)).max()
    fit = fit_motion(gaussians, seen, MotionConfig(appearance=False))
    assert fit.figures["pixels_moved"] == pytest.approx(true, rel=0.5)


def test_noise_alone_is_no_motion():
    gaussians, motion = scene(FREQUENCY, amplitude=1e-9)
    fit = fit_motion(gaussians, clips(gaussians, motion, STARTS, 24), MotionConfig(appearance=False))
    assert len(fit.motion.freqs_hz) == 0
    assert "no frequency" in fit.notes[-1]


def test_a_band_that_is_given_holds_a_frequency_of_one_period():
    """Clips of 20 frames at 1.5 Hz: a second and less, in which nothing is looked for."""
    gaussians, motion = scene(1.5)
    seen = clips(gaussians, motion, STARTS, round(FPS / 1.5))
    assert not len(fit_motion(gaussians, seen, MotionConfig(appearance=False)).motion.freqs_hz)
    fit = fit_motion(gaussians, seen, MotionConfig(appearance=False, band="1.2 1.8"))
    (hz,) = fit.motion.freqs_hz
    assert 1.2 <= hz <= 1.8
    assert fit.figures["asked_share"] > 0.05
    assert error_of(fit.motion.displacement[0], motion.displacement[0], gaussians.opacities.numpy()) < 0.7


def test_an_offset_is_the_one_nearest_to_zero():
    hz = np.array([3.4, 7.0])
    assert clock_offset(2 * np.pi * hz * 0.021, hz) == pytest.approx(0.021, abs=2e-3)
    assert clock_offset(-2 * np.pi * hz * 0.05, hz) == pytest.approx(-0.05, abs=2e-3)


@pytest.mark.parametrize(
    ("hz", "said"),
    [
        ([], "no frequency stands out"),
        ([3.4], "the motion at 3.4 Hz: the halves of the record disagree"),
    ],
)
def test_a_run_without_motion_says_why(hz, said):
    gaussians, motion = scene(3.4)
    observations = clips(gaussians, motion, [0.0], 12)
    clock = IndependentClocks.of(gaussians, observations, MotionConfig(), "cpu", no_checkpoint)
    fit = without_motion(replace(clock, figures={"frequencies_hz": hz}, notes=[]))
    assert len(fit.motion.freqs_hz) == 0
    assert said in fit.notes[0]
