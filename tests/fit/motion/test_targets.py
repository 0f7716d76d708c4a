"""From pictures over time to target images: components of time, and sinusoids of known frequencies."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fit.space.scenes import capture_of
from tests.helpers.motion_temporal import components, moving_pictures, no_nuisance
from tg4mm.fit.motion import observations as observations_module
from tg4mm.fit.motion.nuisance import first_look as first_look_module
from tg4mm.fit.motion.nuisance.first_look import first_look
from tg4mm.fit.motion.observations import observe
from tg4mm.fit.motion.temporal.independent import sinusoid_targets


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

    @pytest.mark.parametrize("cached", [0, 9 * 12 * 15 * 12, 1 << 30])  # bytes: none, one camera, all
    @pytest.mark.parametrize("strip", [1, 1 << 20])
    def test_neither_cache_nor_strips_change_anything(self, stack, cached, strip, monkeypatch):
        expected = components(stack[1])
        monkeypatch.setattr(first_look_module, "CACHE_BYTES", cached)
        monkeypatch.setattr(observations_module, "STRIP_VALUES", strip)
        found = components(stack[1])
        signs = np.sign((found.basis * expected.basis).sum(1))
        np.testing.assert_allclose(found.images, expected.images * signs[:, None, None, None], atol=1e-5)
        np.testing.assert_allclose(found.residual_energy, expected.residual_energy, atol=1e-6)
        np.testing.assert_allclose(found.mean, expected.mean, atol=1e-6)


class TestSinusoids:
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
            observations, first_look(observations, nuisances), nuisances, self.HZ
        )
        scale = np.sqrt(2 / 39)
        for v in range(2):
            x = np.stack([phasors[v].real, phasors[v].imag], 1).reshape(4, *phasors[v].shape[1:]) / scale
            expected = np.tensordot(mixing[v], x, 1)
            np.testing.assert_allclose(found.images[v], expected, atol=0.01 * np.abs(expected).max())
        changes = sum(float(np.trace(gram)) for gram in first_look(observations, nuisances).grams)
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
    alone, known = components(observed), components(replace(observed, courses=courses))
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
        replace(observe(capture, images), courses=courses + rng.normal(0, 1e-4, courses.shape))
    )
    assert found.n_known == 2
