"""Functions of time: sinusoids where they stand out of the noise, principal components of what is left."""

import numpy as np
import pytest

from tg4mm.fit.motion.temporal.time_courses import kept_components, orthonormal, sinusoidal_courses

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
