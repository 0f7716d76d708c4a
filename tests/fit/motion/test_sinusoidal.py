"""Cameras with clocks of their own: frequency, phases and 3D motion of a steady vibration.

Frequencies are found between bins, with frames dropped, from clocks of their own; and in noise there are none.

A region's shift in the pictures is the one that it moved by, and its noise that of the pictures.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.fit.motion.filmed import FPS, K_of, clips, error_of, scene
from tests.fit.motion.scenes import Camera
from tests.helpers.synthetic import _gaussians, _parts, _viewmats
from tg4mm.fit.motion.checkpoints import no_checkpoint
from tg4mm.fit.motion.config import MotionConfig
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import ViewJacobian, pixels_moved, view_jacobian
from tg4mm.fit.motion.nuisance.projection import Projection, nuisances_of
from tg4mm.fit.motion.observation_model import ObservationModel
from tg4mm.fit.motion.observations import PosedFrames
from tg4mm.fit.motion.pipeline import fit_motion, without_motion
from tg4mm.fit.motion.spectrum import sinusoids
from tg4mm.fit.motion.temporal.independent import IndependentClocks, clock_offset
from tg4mm.fit.motion.temporal.sinusoidal import find_frequencies, moving_camera_series, shift_series

FREQUENCY = 3.4  # Hz: between the DFT bins of these clips
STARTS = (0.0, 3.0, 11.0, 6.0, 1.5, 8.0)  # timesteps
SERIES = 80
HZ = (3.437, 7.113)
BAND = (0.7, 13.5)
SIZE, POST = 64, 1
SHIFTS = 0.01 * np.random.default_rng(0).normal(size=(7, 2))


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


def test_the_offsets_of_a_rigs_clocks_are_reported():
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
def test_the_pixels_that_things_move_by_are_reported_for_any_motion(amplitude):
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


def times(n_frames=90, dropped=6, seed=0):
    """Seconds, of a phone: some frames are missing, steps are not quite even."""
    rng = np.random.default_rng(seed)
    kept = np.sort(rng.choice(np.arange(1, n_frames - 1), n_frames - 2 - dropped, replace=False))
    return (np.array([0, *kept, n_frames - 1]) + 0.02 * rng.normal(size=n_frames - dropped)) / FPS


def moving(t, seed, hz=HZ, strength=1.0, noise=1.0):
    """[F, S]: noise of variance 1; half of the series move with the first frequency, a tenth with the second."""
    rng = np.random.default_rng(seed)
    y = noise * rng.normal(size=(len(t), SERIES))
    for k, f in enumerate(hz):
        own = rng.permutation(SERIES) < SERIES * (0.5, 0.1)[k]
        amplitude = strength * own * rng.uniform(0.5, 1.5, SERIES)
        y += amplitude * np.cos(2 * np.pi * f * t[:, None] + rng.uniform(0, 2 * np.pi, SERIES))
    return y


def check(found, hz):
    """These, within three of the deviations that it states, which are small; and nothing else."""
    assert len(found.hz) == len(hz)
    for f in hz:
        k = int(np.argmin(np.abs(found.hz - f)))
        assert abs(found.hz[k] - f) < 3 * found.deviation_hz[k]
        assert found.deviation_hz[k] < 0.1


def test_two_between_bins_are_found_and_nothing_else():
    """Three seconds: bins are a third of a Hz apart.

    Of 60 draws, 57 had both and nothing else, two a third and one the first alone: of twelve, nine or more in 99.8 %.
    """
    counts = []
    for seed in range(12):
        t = times(seed=seed)
        found = find_frequencies([moving(t, seed)], [t], *BAND)
        assert abs(found.hz[0] - HZ[0]) < 4 * found.deviation_hz[0] < 0.1  # the strongest first
        counts.append(len(found.hz))
    assert counts.count(2) >= 9


@pytest.mark.parametrize("seed", range(6))
def test_in_noise_there_are_none(seed):
    t = times(seed=seed)
    y = np.random.default_rng(seed).normal(size=(len(t), SERIES)) * np.geomspace(1, 100, SERIES)
    assert not len(find_frequencies([y], [t], *BAND).hz)


def test_clips_with_phases_of_their_own_are_put_together():
    """Four clips, of which no one series is like another's."""
    clocks = [times(60, 3, seed) + 17.3 * seed for seed in range(4)]
    series = [moving(t, seed, strength=0.6) for seed, t in enumerate(clocks)]
    check(find_frequencies(series, clocks, 1.1, 13.5), HZ)


def test_a_drift_is_no_frequency():
    t = times()
    y, drift = moving(t, 0), 10 * t + 4 * (t - 1.2) ** 2
    without = find_frequencies([y], [t], *BAND)
    np.testing.assert_allclose(find_frequencies([y + drift[:, None]], [t], *BAND).hz, without.hz, atol=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_noise_that_rises_to_low_frequencies_is_no_frequency(seed):
    """Six tenths of the noise stay from frame to frame."""
    rng, t = np.random.default_rng(seed), times()
    y = rng.normal(size=(len(t), SERIES))
    for k in range(1, len(t)):
        y[k] += 0.6 * y[k - 1]
    assert not len(find_frequencies([y], [t], *BAND).hz)


def test_the_deviation_is_that_of_the_errors():
    """Rms over twelve draws of error over deviation: about 1."""
    ratios = []
    for seed in range(12):
        t = times(seed=seed)
        found = find_frequencies([moving(t, 100 + seed, HZ[:1], strength=0.4)], [t], *BAND)
        ratios.append((found.hz[0] - HZ[0]) / found.deviation_hz[0])
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 1.6


def test_a_loud_one_in_a_short_record_is_found_in_spite_of_its_side_lobes():
    """Shifts of 25 regions of the microphone, generated at 3.4 Hz, before eight cameras with clocks of their own."""
    stored = np.load(Path(__file__).parent / "data/rig_shifts.npz")
    series = list(stored["shifts"].astype(np.float64))
    found = find_frequencies(series, [stored["times_s"].astype(np.float64)] * 8, 1.02, 14.7)
    assert found.hz[0] == pytest.approx(3.4, abs=0.005)


@pytest.mark.parametrize("lag", [0.0, 0.05])
def test_errors_of_clips_are_within_two_deviations(lag):
    """At least 17 of 20 draws: five clips, whose phase lags by `lag` radians more after the first half second."""
    t = np.arange(75) / FPS
    within, stated = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        series = []
        for _ in range(5):
            phase = rng.uniform(0, 2 * np.pi) - lag * (1 - np.exp(-t / 0.3))
            wave = np.cos(2 * np.pi * 3.4 * t + phase)
            series.append(wave[:, None] * rng.normal(0, 4, 24) + rng.normal(size=(len(t), 24)))
        found = find_frequencies(series, [t] * 5, 0.8, 14.7)
        within.append(abs(found.hz[0] - 3.4) < 2 * found.deviation_hz[0])
        stated.append(found.deviation_hz[0])
    assert sum(within) >= 17
    assert np.median(stated) < 0.01


class Scene:
    """Floor, post and ball, each a region, before one camera."""

    def __init__(self):
        parts = _parts(1)
        self.gaussians = _gaussians(parts, 1)
        self.labels = np.repeat(np.arange(3), [len(p.vertices) for p in parts])
        self.camera = Camera(_viewmats(5, 0.0)[1].astype(np.float32), K_of(SIZE))
        self.view: ViewJacobian = view_jacobian(self.gaussians, self.camera, (SIZE, SIZE))

    @property
    def axes(self):
        return self.camera.viewmat[:2, :3]

    def shown(self, shifts, region=POST):
        """[F, H, W, 3]: what a region's shifts [F, 2] to the right and down, in scene units, change."""
        motions = np.zeros((len(shifts), len(self.labels), DOF), np.float32)
        motions[:, self.labels == region, :3] = (shifts @ self.axes)[:, None]
        return self.view.jvp(motions)

    def model(self, times_s, projection=None):
        frames = PosedFrames("", self.camera.viewmat, self.camera.K, np.arange(len(times_s)), times_s)
        return ObservationModel(frames, self.view, projection)

    def series(self, changes, projection=None):
        model = self.model(np.arange(len(changes)) / 30, projection)
        by_three = (changes[k : k + 3] for k in range(0, len(changes), 3))
        return shift_series(model, self.labels, by_three)


@pytest.fixture(scope="module")
def regions():
    return Scene()


def shifts_of(series):
    """[F, G, 2] regions units."""
    return np.linalg.solve(
        np.broadcast_to(series.normals, (*series.sides.shape, 2)), series.sides[..., None]
    )[..., 0]


@pytest.mark.parametrize("region", [0, 1, 2], ids=["floor", "post", "ball"])
def test_a_regions_shift_comes_out(regions, region):
    """And of those that stand still a little, where pixels show two of them."""
    found = shifts_of(regions.series(regions.shown(SHIFTS, region)))
    size = np.linalg.norm(SHIFTS)
    assert found.shape == (7, 3, 2)
    assert np.linalg.norm(found[:, region] - SHIFTS) < 0.1 * size
    others = [k for k in range(3) if k != region]
    assert np.linalg.norm(found[:, others]) < 0.4 * size


def test_what_nuisance_does_shifts_nothing(regions):
    """Exposure that varies by all of it, beside the shift: as without, if it is projected out."""
    active = np.arange(12) < 6
    (nuisance,) = nuisances_of([regions.view], [regions.camera], regions.gaussians.means.numpy(), active)
    mean = regions.view.over_white
    projection = Projection.of(nuisance, mean, None)
    drift = np.random.default_rng(1).normal(size=(7, 1, 1, 1))
    changes = (regions.shown(SHIFTS) + drift * mean).astype(np.float32)
    size = np.linalg.norm(SHIFTS)
    clean, taken_out = (
        shifts_of(regions.series(c, projection))[:, POST] for c in (regions.shown(SHIFTS), changes)
    )
    assert np.linalg.norm(taken_out - clean) < 0.01 * size
    assert np.linalg.norm(clean - SHIFTS) < 0.15 * size
    assert np.linalg.norm(shifts_of(regions.series(changes))[:, POST] - SHIFTS) > 0.3 * size


def test_a_region_that_is_not_seen_says_nothing(regions):
    """Ten Gaussians of the floor behind the camera."""
    unseen = Scene()
    means, behind = unseen.gaussians.means.clone(), np.arange(10)
    means[behind] -= torch.from_numpy(10 * unseen.camera.viewmat[2, :3])
    unseen.gaussians = replace(unseen.gaussians, means=means)
    unseen.view = view_jacobian(unseen.gaussians, unseen.camera, (SIZE, SIZE))
    unseen.labels = unseen.labels.copy()
    unseen.labels[behind] = 3
    noise = np.random.default_rng(2).normal(size=(5, SIZE, SIZE, 3)).astype(np.float32)
    whitened = unseen.series(noise).whitened().reshape(5, 4, 2)
    assert not whitened[:, 3].any()
    assert whitened[:, :3].any()


def test_phasors_are_those_of_the_shifts(regions):
    """With a drift beside them, too."""
    t, hz = np.arange(40) / 30, np.array([3.3, 7.9])
    phasors = np.array([[0.01 + 0.02j, -0.01j], [0.005, 0.01 - 0.004j]])  # [K, 2]
    swing = (phasors[:, None] * np.exp(2j * np.pi * hz[:, None] * t)[..., None]).real.sum(0)
    series = regions.series(regions.shown(swing + np.outer(t, [0.02, -0.01])))
    found = np.linalg.solve(series.normals, series.phasors(sinusoids(t, hz))[..., None])[:, POST, :, 0]
    assert np.linalg.norm(found - phasors) < 0.1 * np.linalg.norm(phasors)


def test_a_camera_that_moves_by_nothing_is_a_fixed_one(regions):
    changes = regions.shown(SHIFTS)
    fixed = regions.series(changes)
    n = len(changes)
    models = [regions.model(fixed.times_s[k : k + 1]) for k in range(n)]
    moving = moving_camera_series(models, iter(changes), regions.labels)
    np.testing.assert_array_equal(moving.times_s, fixed.times_s)
    np.testing.assert_allclose(moving.sides, fixed.sides, atol=1e-4 * np.abs(fixed.sides).max())
    for k in range(n):
        np.testing.assert_allclose(moving.normals[k], fixed.normals[0], rtol=1e-4)
        np.testing.assert_allclose(moving.axes[k], fixed.axes[0])
