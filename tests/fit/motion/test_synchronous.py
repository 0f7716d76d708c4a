"""Functions of time: sinusoids where they stand out of the noise, principal components of what is left.

From pictures over time to target images: components of time, and sinusoids of known frequencies.
"""

from dataclasses import replace

import numpy as np
import pytest

from tests.fit.space.scenes import capture_of
from tests.helpers.motion_temporal import components, moving_pictures, no_nuisance
from tg4mm.fit.motion import observations as observations_module
from tg4mm.fit.motion.nuisance.fixed_cameras import picture_sums
from tg4mm.fit.motion.observations import observe
from tg4mm.fit.motion.temporal.independent import sinusoid_targets
from tg4mm.fit.motion.temporal.synchronous import kept_components, orthonormal, sinusoidal_courses

FPS, PIXELS = 30.0, 1500


def zero_mean_basis(n, n_timesteps, seed=0):
    a = np.random.default_rng(seed).normal(size=(n_timesteps, n))
    q, _ = np.linalg.qr(a - a.mean(0))
    return q.T


def spectrum(video):
    """Energies of [T, P] less its mean over time, falling."""
    return np.linalg.svd(video - video.mean(0), compute_uv=False) ** 2


def filmed(courses, strengths, seed, n_timesteps):
    """Products [T, T] of pictures in which courses [K, T] have so many times the energy of noise in one direction."""
    rng = np.random.default_rng(seed)
    video = rng.normal(size=(n_timesteps, PIXELS))
    for course, strength in zip(courses, strengths, strict=True):
        own = course - course.mean()
        video += np.sqrt(strength) * np.outer(own / np.linalg.norm(own), rng.normal(size=PIXELS))
    video -= video.mean(0)
    return video @ video.T


def at(n_timesteps):
    return np.arange(n_timesteps) / FPS


def found_in(gram):
    return sinusoidal_courses(gram, PIXELS, at(len(gram)))


def swing(hz, times_s, phase=0.0, decay=0.0):
    """At times [T], or as many even ones."""
    t = at(times_s) if np.isscalar(times_s) else times_s
    return np.exp(-decay * t) * np.cos(2 * np.pi * hz * t + phase)


def explained(courses, true):
    """What part of the true course, less its mean, functions [K, T] hold."""
    own = true - true.mean()
    span = orthonormal(courses, np.eye(len(own)))
    return float(np.linalg.norm(span @ own) / np.linalg.norm(own))


def first_component(gram):
    return np.linalg.eigh(gram)[1][:, -1:].T


class TestSinusoids:
    @pytest.mark.parametrize("seed", range(5))
    @pytest.mark.parametrize(("hz", "n_timesteps"), [(3.7, 15), (5.0, 15), (4.4, 30), (11.0, 30)])
    def test_in_noise_a_vibration_has_its_exact_course(self, hz, n_timesteps, seed):
        """Both phases of a wave that travels; the weaker one lies below the noise, and no component holds it."""
        waves = [swing(hz, n_timesteps, p) for p in (0.4, 0.4 + np.pi / 2)]
        gram = filmed(waves, (0.6, 0.3), seed, n_timesteps)
        found = found_in(gram)
        assert found.shape == (2, n_timesteps)
        assert min(explained(found, wave) for wave in waves) > 0.98
        assert explained(first_component(gram), waves[1]) < 0.5

    @pytest.mark.parametrize("seed", range(5))
    @pytest.mark.parametrize("n_timesteps", [12, 15, 30, 60])
    def test_noise_has_none(self, n_timesteps, seed):
        assert found_in(filmed([], [], seed, n_timesteps)) is None

    @pytest.mark.parametrize("seed", range(5))
    def test_two_vibrations_are_two(self, seed):
        waves = [swing(3.0, 30), swing(7.3, 30, 1.0)]
        found = found_in(filmed(waves, (2.0, 1.5), seed, 30))
        assert found.shape == (4, 30)
        assert min(explained(found, wave) for wave in waves) > 0.98

    @pytest.mark.parametrize("seed", range(5))
    def test_what_rings_down_keeps_its_envelope(self, seed):
        wave = swing(6.0, 60, decay=4.0)
        found = found_in(filmed([wave], [20.0], seed, 60))
        assert explained(found, wave) > 0.99

    @pytest.mark.parametrize("seed", range(5))
    def test_frames_that_lack_change_nothing(self, seed):
        """Fourteen of forty."""
        kept = np.sort(np.random.default_rng(seed).choice(40, 26, replace=False)) / FPS
        waves = [swing(5.3, kept, p) for p in (0.4, 0.4 + np.pi / 2)]
        found = sinusoidal_courses(filmed(waves, (0.8, 0.4), seed, len(kept)), PIXELS, kept)
        assert min(explained(found, wave) for wave in waves) > 0.98

    def test_motion_without_a_frequency_is_left_to_the_components(self):
        """Steps to and fro, in two directions."""
        steps = np.sign(np.random.default_rng(5).normal(size=(2, 30)))
        assert found_in(filmed(steps, (20.0, 10.0), 0, 30)) is None

    def test_too_few_timesteps_resolve_none(self):
        assert found_in(filmed([swing(5.0, 11)], [5.0], 0, 11)) is None


class TestKeptComponents:
    def test_without_noise_all_of_the_rank_and_no_rounding_is_kept(self):
        signal = zero_mean_basis(3, 30).T @ np.random.default_rng(0).normal(size=(3, 5000))
        assert kept_components(spectrum(signal.astype(np.float32).astype(float))) == 3

    @pytest.mark.parametrize(
        ("energy", "kept"),
        [
            ([10.0, 9, 8, 7, 6, 5, 0, 0], 6),  # most of a short capture is signal
            ([100.0] * 20 + [1.0] * 9 + [0.0], 20),  # broadband motion above noise
            ([10.0, 9, 0.001, 0], 3),  # T = 4: too few to tell noise
            ([1.0] * 29 + [0.0], 1),  # nothing but noise
        ],
    )
    def test_the_weakest_tell_the_noise(self, energy, kept):
        assert kept_components(np.array(energy)) == kept

    @pytest.mark.parametrize("rank", [14, 28])
    def test_where_pictures_repeat_those_that_are_not_empty_tell(self, rank):
        energy = np.array([100.0, 50] + [1.0] * (rank - 2) + [0.0] * (30 - rank))
        assert kept_components(energy, rank) == 2
        assert kept_components(energy) == (rank if rank == 14 else 2)  # the empty ones would tell of no noise

    @pytest.mark.parametrize("seed", range(5))
    @pytest.mark.parametrize(("n_timesteps", "pixels"), [(30, 20_000), (100, 20_000), (9, 2_000)])
    def test_spread_over_many_pixels_a_weaker_signal_is_kept(self, n_timesteps, pixels, seed):
        """Noise alone stays noise; what adds seven tenths to a component's noise stands out where pixels are many."""
        rng = np.random.default_rng(seed)
        noise = rng.normal(size=(n_timesteps, pixels))
        assert kept_components(spectrum(noise), pixels=pixels) == 1
        two = zero_mean_basis(2, n_timesteps).T @ rng.normal(size=(2, pixels)) * np.array(0.7**0.5)
        assert kept_components(spectrum(noise + two), pixels=pixels) == 2
        assert kept_components(spectrum(noise + two)) == 1  # less than twice the noise


def changes(images, frames):
    """[T, H, W, 3]: pictures less their mean, written out."""
    video = np.stack([images.rgb(int(row)) for row in frames.rows]).astype(float)
    return video - video.mean(0)


class TestComponents:
    @pytest.fixture
    def stack(self):
        """Two cameras, nine timesteps, two patterns that swing with two frequencies, some noise."""
        data, ids, times = moving_pictures(2, 9, size=(12, 15))
        rng, t = np.random.default_rng(3), np.asarray(times)
        patterns = rng.normal(size=(2, 2, 12, 15, 3))
        swing = np.stack([np.sin(2 * np.pi * t / 9), 0.5 * np.cos(4 * np.pi * t / 9)])
        pictures = 128 + 30 * np.einsum("kc,kchwx->chwx", swing, patterns[:, ids])
        pictures += rng.normal(size=(18, 12, 15, 3))
        data[..., :3] = pictures.clip(0, 255).round()
        capture, images = capture_of(ids, times, data)
        return images, observe(capture, images)

    def test_two_patterns_are_two_components(self, stack):
        """They span the two swings."""
        found = components(stack[1])
        assert len(found.basis) == 2
        t = np.arange(9)
        swing = np.stack([np.sin(2 * np.pi * t / 9), np.cos(4 * np.pi * t / 9)]) / np.sqrt(4.5)
        np.testing.assert_allclose(np.linalg.svd(found.basis @ swing.T, compute_uv=False), 1, atol=0.01)

    def test_target_images_are_the_weighted_sums_of_the_pictures(self, stack):
        images, observations = stack
        found = components(observations)
        assert found.images.shape == (2, 2, 12, 15, 3)
        for v, frames in enumerate(observations.frames):
            for r, a in enumerate(found.basis):
                brute = np.zeros((12, 15, 3))
                for t in range(9):
                    brute += a[t] * (images.data[frames.rows[t], ..., :3] / 255.0)
                np.testing.assert_allclose(found.images[v, r], brute, atol=1e-5)

    def test_what_was_not_kept_is_the_residual(self, stack):
        images, observations = stack
        found = components(observations)
        for v, frames in enumerate(observations.frames):
            video = changes(images, frames)
            left = video - np.einsum("rt,rs,shwc->thwc", found.basis, found.basis, video)
            np.testing.assert_allclose(found.residual_energy[v], (left**2).sum(0).mean(-1), rtol=0.02)
        total = found.energy.sum() - found.energy[: len(found.basis)].sum()
        np.testing.assert_allclose(3 * found.residual_energy.sum(), total, rtol=1e-3)

    @pytest.mark.parametrize("strip", [1, 1 << 20])
    def test_the_size_of_strips_changes_nothing(self, stack, strip, monkeypatch):
        expected = components(stack[1])
        monkeypatch.setattr(observations_module, "STRIP_VALUES", strip)
        found = components(stack[1])
        signs = np.sign((found.basis * expected.basis).sum(1))
        np.testing.assert_allclose(found.images, expected.images * signs[:, None, None, None], atol=1e-5)
        np.testing.assert_allclose(found.residual_energy, expected.residual_energy, atol=1e-6)
        np.testing.assert_allclose(found.mean, expected.mean, atol=1e-6)


class TestSinusoidTargets:
    HZ = np.array([3.1, 7.4])

    @pytest.fixture
    def stack(self):
        """Two cameras, each with its own times and a dropped frame; phasors [V, K, H, W, 3] of the pictures."""
        rng, kept = np.random.default_rng(8), [[*range(7), *range(8, 40)], [*range(20), *range(21, 40)]]
        phasors = 0.05 * (rng.normal(size=(2, 2, 12, 15, 3)) + 1j * rng.normal(size=(2, 2, 12, 15, 3)))
        ids = [c for c in (0, 1) for _ in kept[c]]
        steps = [t for c in (0, 1) for t in kept[c]]
        times = np.array(steps) / 30 + np.array([0.0, 0.011])[ids]
        turn = np.exp(2j * np.pi * self.HZ * times[:, None])
        pictures = (
            0.5 + np.einsum("ik,ikhwc->ihwc", turn, phasors[ids]).real + 0.05 * times[:, None, None, None]
        )
        data = np.full((len(ids), 12, 15, 4), 65535, np.uint16)
        data[..., :3] = (pictures * 65535).round()
        capture, images = capture_of(ids, steps, data)
        return observe(replace(capture, times_s=times), images), phasors

    def test_target_images_are_the_mixture_of_the_phasors(self, stack):
        """y = C x with x the real and imaginary parts, on each camera's own clock; constant and trend taken out."""
        observations, phasors = stack
        nuisances = no_nuisance(observations)
        found, mixing = sinusoid_targets(
            observations, picture_sums(observations, nuisances), nuisances, self.HZ
        )
        scale = np.sqrt(2 / 39)
        for v in range(2):
            x = np.stack([phasors[v].real, phasors[v].imag], 1).reshape(4, *phasors[v].shape[1:]) / scale
            expected = np.tensordot(mixing[v], x, 1)
            np.testing.assert_allclose(found.images[v], expected, atol=0.01 * np.abs(expected).max())
        changes = sum(float(np.trace(gram)) for gram in picture_sums(observations, nuisances).grams)
        left = changes - (found.images.astype(float) ** 2).sum()  # the trend
        assert 3 * found.residual_energy.sum() == pytest.approx(left, rel=1e-3)


def test_a_vibration_of_few_pixels_is_held_by_its_own_course_alone():
    """Twelve of 20,000 pixels swing by as much as their noise: no principal component, but two known functions."""
    n, hz = 60, 3.3
    rng, t = np.random.default_rng(0), np.arange(n) / 30
    data = np.full((n, 100, 200, 4), 255, np.uint8)
    noise = rng.normal(0, 8, (n, 100, 200, 3))
    noise[:, 40:43, 60:64] += 8 * np.cos(2 * np.pi * hz * t + 0.4)[:, None, None, None]
    data[..., :3] = (128 + noise).round()
    capture, images = capture_of([0] * n, list(range(n)), data)
    observed = observe(capture, images)
    courses = np.stack([np.cos(2 * np.pi * hz * t), np.sin(2 * np.pi * hz * t)])
    truth = courses - courses.mean(1, keepdims=True)
    alone, known = components(observed), components(replace(observed, time_courses=courses))
    share = [np.linalg.norm(truth @ f.basis.T) ** 2 / np.linalg.norm(truth) ** 2 for f in (alone, known)]
    assert share[0] < 0.5
    assert share[1] == pytest.approx(1)
    assert known.n_known == 2
    assert np.allclose(known.basis @ known.basis.T, np.eye(len(known.basis)), atol=1e-6)
    shown = np.sqrt((known.images[0, :2] ** 2).sum(0).mean(-1))
    assert shown[40:43, 60:64].mean() > 3 * np.median(shown)


def test_courses_that_are_one_are_one():
    n = 40
    rng, t = np.random.default_rng(1), np.arange(n) / 30
    data, _, _ = moving_pictures(1, n)
    capture, images = capture_of([0] * n, list(range(n)), data)
    courses = np.stack([np.cos(2 * np.pi * f * t + p) for f in (4.0, 4.001) for p in (0, 1.5)])
    found = components(
        replace(observe(capture, images), time_courses=courses + rng.normal(0, 1e-4, courses.shape))
    )
    assert found.n_known == 2
