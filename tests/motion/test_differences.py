"""Changes of the pictures in few temporal components, and back to phasors."""

from __future__ import annotations

import numpy as np
import pytest

from tests.space.scenes import capture_of
from tg4mm.capture import ImageStack
from tg4mm.errors import CaptureError
from tg4mm.motion.differences import (
    FixedCamera,
    camera_differences,
    fixed_cameras,
    kept_components,
    phasors,
    project,
    temporal_components,
)

FPS = 30.0


def synthesis(freqs: np.ndarray, values: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Σ_k Re[m_k exp(i 2π f_k t / fps)] at every t: [T, N, D]. Written out, not the code's."""
    return np.stack(
        [
            sum((m * np.exp(2j * np.pi * f * s / FPS)).real for f, m in zip(freqs, values, strict=True))
            for s in t
        ]
    )


def zero_mean_basis(n: int, n_timesteps: int, seed: int = 0) -> np.ndarray:
    a = np.random.default_rng(seed).normal(size=(n_timesteps, n))
    q, _ = np.linalg.qr(a - a.mean(0))
    return q.T


class TestPhasors:
    @pytest.mark.parametrize("n_timesteps", [2, 3, 8, 9, 30, 31])
    def test_they_give_the_motion_back_at_every_timestep(self, n_timesteps: int) -> None:
        """Even T has a Nyquist bin, odd T has none."""
        rng = np.random.default_rng(1)
        basis = zero_mean_basis(min(3, n_timesteps - 1), n_timesteps)
        shapes = rng.normal(size=(len(basis), 4, 6))
        freqs, values = phasors(basis, shapes, FPS)
        assert values.shape == (n_timesteps // 2, 4, 6)
        assert values.dtype == np.complex64
        expected = np.einsum("rt,rnd->tnd", basis, shapes)
        found = synthesis(freqs, values, np.arange(n_timesteps))
        np.testing.assert_allclose(found, expected, atol=3e-6)
        # the comparison can fail: a Nyquist bin counted twice, or a wrong sign of time
        if n_timesteps % 2 == 0:
            values[-1] *= 2
            assert np.abs(synthesis(freqs, values, np.arange(n_timesteps)) - expected).max() > 1e-2

    def test_a_sine_lands_in_its_bin_with_its_phase(self) -> None:
        """0.3 cos(2π 5 t/30 + 0.7): one bin, phasor 0.3 exp(0.7i)."""
        t = np.arange(30)
        basis = np.stack([np.cos(2 * np.pi * 5 * t / 30), np.sin(2 * np.pi * 5 * t / 30)]) / np.sqrt(15)
        shape = np.array([np.cos(0.7), -np.sin(0.7)])[:, None, None] * 0.3 * np.sqrt(15)
        freqs, values = phasors(basis, shape, FPS)
        np.testing.assert_allclose(freqs, np.arange(1, 16))
        np.testing.assert_allclose(values[4, 0, 0], 0.3 * np.exp(0.7j), rtol=1e-6)
        assert np.abs(np.delete(values, 4, 0)).max() < 1e-7

    def test_the_mean_over_time_is_left_out(self) -> None:
        basis = zero_mean_basis(2, 10)
        shapes = np.ones((2, 1, 1))
        np.testing.assert_allclose(
            phasors(basis + 3.0, shapes, FPS)[1], phasors(basis, shapes, FPS)[1], atol=1e-6
        )


class TestKeptComponents:
    @pytest.mark.parametrize("seed", range(5))
    def test_of_noise_alone_one_is_kept(self, seed: int) -> None:
        noise = np.random.default_rng(seed).normal(size=(30, 20_000))
        assert kept_components(spectrum(noise)) == 1

    @pytest.mark.parametrize("seed", range(5))
    def test_what_stands_out_of_noise_is_kept(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        signal = zero_mean_basis(2, 30).T @ rng.normal(size=(2, 20_000)) * 3.0 * 30**0.5
        assert kept_components(spectrum(signal + rng.normal(size=signal.shape))) == 2

    def test_without_noise_all_of_the_rank_and_no_rounding_is_kept(self) -> None:
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
    def test_the_weakest_tell_the_noise(self, energy: list[float], kept: int) -> None:
        assert kept_components(np.array(energy)) == kept

    @pytest.mark.parametrize("energy", [[0.0] * 5, [1.0, 0.0]])
    def test_one_is_always_kept(self, energy: list[float]) -> None:
        assert kept_components(np.array(energy)) == 1


def spectrum(video: np.ndarray) -> np.ndarray:
    """Energies of [T, P] less its mean over time, falling."""
    return np.linalg.svd(video - video.mean(0), compute_uv=False) ** 2


def moving_pictures(
    n_cameras: int, n_timesteps: int, seed: int = 0
) -> tuple[np.ndarray, list[int], list[int]]:
    """Noise, opaque, timestep by timestep: data [C, H, W, 4], camera ids, timesteps."""
    rng = np.random.default_rng(seed)
    data = rng.integers(0, 256, (n_cameras * n_timesteps, 4, 5, 4)).astype(np.uint8)
    data[..., 3] = 255
    ids = list(range(n_cameras)) * n_timesteps
    return data, ids, sorted(list(range(n_timesteps)) * n_cameras)


class TestFixedCameras:
    def test_rows_are_in_order_of_time(self) -> None:
        data, ids, times = moving_pictures(2, 4)
        capture, _ = capture_of(ids, times, data)
        cameras = fixed_cameras(capture)
        np.testing.assert_array_equal([c.rows for c in cameras], [[0, 2, 4, 6], [1, 3, 5, 7]])
        assert [c.viewmat[0, 3] for c in cameras] == [0.0, 1.0]

    def test_shuffled_rows_are_sorted(self) -> None:
        data, _, _ = moving_pictures(1, 4)
        capture, _ = capture_of([0, 0, 0, 0], [2, 0, 3, 1], data)
        np.testing.assert_array_equal(fixed_cameras(capture)[0].rows, [1, 3, 0, 2])

    def test_cameras_that_miss_or_double_a_timestep_are_left_out(self) -> None:
        data, _, _ = moving_pictures(1, 9)
        ids, times = [0, 1, 2, 0, 1, 2, 0, 2, 2], [0, 0, 0, 1, 1, 1, 2, 2, 2]
        cameras = fixed_cameras(capture_of(ids, times, data)[0])
        assert [list(c.rows) for c in cameras] == [[0, 3, 6]]

    def test_none_is_an_error_with_the_path_and_the_number_of_timesteps(self) -> None:
        data, _, _ = moving_pictures(1, 4)
        capture, _ = capture_of([0, 1, 2, 3], [0, 1, 2, 3], data)
        with pytest.raises(
            CaptureError, match=r"\A/data: no camera has one image at each of the 4 timesteps[^\n]*\Z"
        ):
            fixed_cameras(capture)


class TestComponents:
    @pytest.fixture
    def stack(self) -> tuple[ImageStack, list[FixedCamera]]:
        """Two cameras, nine timesteps, two patterns that swing with two frequencies, some noise."""
        data, ids, times = moving_pictures(2, 9)
        rng, t = np.random.default_rng(3), np.asarray(times)
        patterns = rng.normal(size=(2, 2, 4, 5, 3))
        swing = np.stack([np.sin(2 * np.pi * t / 9), 0.5 * np.cos(4 * np.pi * t / 9)])
        pictures = (
            128 + 30 * np.einsum("kc,kchwx->chwx", swing, patterns[:, ids]) + rng.normal(size=(18, 4, 5, 3))
        )
        data[..., :3] = pictures.clip(0, 255).round()
        capture, images = capture_of(ids, times, data)
        return images, fixed_cameras(capture)

    def test_differences_have_no_mean_and_nothing_else_is_lost(self, stack) -> None:
        images, cameras = stack
        video = images.data[cameras[1].rows, ..., :3] / 255
        found = camera_differences(images, cameras[1])
        np.testing.assert_allclose(found, video - video.mean(0), atol=1e-6)
        assert found.dtype == np.float32

    def test_the_basis_is_orthonormal_and_sums_to_zero(self, stack) -> None:
        basis = temporal_components(*stack, 6).basis
        np.testing.assert_allclose(basis @ basis.T, np.eye(len(basis)), atol=1e-6)
        np.testing.assert_allclose(basis.sum(1), 0, atol=1e-12)

    def test_two_patterns_are_two_components(self, stack) -> None:
        """They span the two swings."""
        components = temporal_components(*stack, 6)
        assert len(components.basis) == 2
        t = np.arange(9)
        swing = np.stack([np.sin(2 * np.pi * t / 9), np.cos(4 * np.pi * t / 9)]) / np.sqrt(4.5)
        np.testing.assert_allclose(np.linalg.svd(components.basis @ swing.T, compute_uv=False), 1, atol=0.01)

    def test_energies_are_the_squared_singular_values_of_all_cameras_together(self, stack) -> None:
        images, cameras = stack
        video = np.concatenate([camera_differences(images, c).reshape(9, -1) for c in cameras], 1)
        components = temporal_components(images, cameras, 6)
        np.testing.assert_allclose(components.energy, spectrum(video.astype(float)), rtol=1e-4, atol=1e-4)

    def test_component_images_are_the_weighted_sums_of_the_pictures(self, stack) -> None:
        images, cameras = stack
        components = temporal_components(images, cameras, 6)
        assert components.images.shape == (2, 2, 4, 5, 3)
        for v, camera in enumerate(cameras):
            for r, a in enumerate(components.basis):
                brute = np.zeros((4, 5, 3))
                for t in range(9):
                    brute += a[t] * (images.data[camera.rows[t], ..., :3] / 255.0)
                np.testing.assert_allclose(components.images[v, r], brute, atol=1e-5)

    def test_project_keeps_the_order_of_axes(self) -> None:
        video = np.random.default_rng(0).normal(size=(5, 2, 3, 3)).astype(np.float32)
        basis = np.eye(5)[[3, 1]]
        np.testing.assert_array_equal(project(video, basis), video[[3, 1]])

    def test_pictures_that_never_change_give_no_motion(self) -> None:
        data, ids, times = moving_pictures(1, 5)
        data[:] = data[:1]
        capture, images = capture_of(ids, times, data)
        components = temporal_components(images, fixed_cameras(capture), 6)
        assert np.abs(components.images).max() < 1e-6
        assert np.isfinite(components.basis).all()
