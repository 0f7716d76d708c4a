"""Changes of the pictures in few temporal components, and the noise in them."""

from __future__ import annotations

import numpy as np
import pytest

from tests.space.scenes import capture_of
from tg4mm.capture import ImageStack
from tg4mm.motion.pictures import differences as differences_module
from tg4mm.motion.pictures import video as video_module
from tg4mm.motion.pictures.differences import kept_components, project, temporal_components
from tg4mm.motion.pictures.video import FixedCamera, fixed_cameras


def zero_mean_basis(n: int, n_timesteps: int, seed: int = 0) -> np.ndarray:
    a = np.random.default_rng(seed).normal(size=(n_timesteps, n))
    q, _ = np.linalg.qr(a - a.mean(0))
    return q.T


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

    @pytest.mark.parametrize("rank", [14, 28])
    def test_where_pictures_repeat_those_that_are_not_empty_tell(self, rank: int) -> None:
        energy = np.array([100.0, 50] + [1.0] * (rank - 2) + [0.0] * (30 - rank))
        assert kept_components(energy, rank) == 2
        assert kept_components(energy) == (rank if rank == 14 else 2)  # the empty ones would tell of no noise

    def test_fewer_than_seven_are_no_sample(self) -> None:
        assert kept_components(np.array([9.0, 1, 1, 1, 1, 1] + [0.0] * 24), 6) == 6

    @pytest.mark.parametrize("seed", range(5))
    @pytest.mark.parametrize(("n_timesteps", "pixels"), [(30, 20_000), (100, 20_000), (9, 2_000)])
    def test_spread_over_many_pixels_a_weaker_signal_is_kept(
        self, n_timesteps: int, pixels: int, seed: int
    ) -> None:
        """Noise alone stays noise; what adds seven tenths to a component's noise stands out where pixels are many."""
        rng = np.random.default_rng(seed)
        noise = rng.normal(size=(n_timesteps, pixels))
        assert kept_components(spectrum(noise), pixels=pixels) == 1
        two = zero_mean_basis(2, n_timesteps).T @ rng.normal(size=(2, pixels)) * np.array(0.7**0.5)
        assert kept_components(spectrum(noise + two), pixels=pixels) == 2
        assert kept_components(spectrum(noise + two)) == 1  # less than twice the noise

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


def differences(images: ImageStack, camera: FixedCamera) -> np.ndarray:
    """[T, H, W, 3]: pictures less their mean, written out."""
    video = np.stack([images.rgb(int(row)) for row in camera.rows]).astype(float)
    return video - video.mean(0)


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
        video = np.concatenate([differences(images, c).reshape(9, -1) for c in cameras], 1)
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

    def test_what_was_not_kept_is_the_residual(self, stack) -> None:
        images, cameras = stack
        components = temporal_components(images, cameras, 6)
        for v, camera in enumerate(cameras):
            video = differences(images, camera)
            left = video - np.einsum("rt,rs,shwc->thwc", components.basis, components.basis, video)
            np.testing.assert_allclose(components.residual[v], (left**2).sum(0).mean(-1), rtol=0.02)
        total = components.energy.sum() - components.energy[: len(components.basis)].sum()
        np.testing.assert_allclose(3 * components.residual.sum(), total, rtol=1e-3)

    @pytest.mark.parametrize("cached", [0, 100, 1 << 30])  # bytes: none, some of one camera, all
    @pytest.mark.parametrize("strip", [1, 1 << 20])
    def test_neither_cache_nor_strips_change_anything(
        self, stack, cached: int, strip: int, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        expected = temporal_components(*stack, 6)
        monkeypatch.setattr(differences_module, "CACHE_BYTES", cached)
        monkeypatch.setattr(video_module, "STRIP_VALUES", strip)
        found = temporal_components(*stack, 6)
        signs = np.sign((found.basis * expected.basis).sum(1))
        np.testing.assert_allclose(found.images, expected.images * signs[:, None, None, None], atol=1e-5)
        np.testing.assert_allclose(found.residual, expected.residual, atol=1e-6)
        np.testing.assert_allclose(found.mean, expected.mean, atol=1e-6)

    def test_with_a_cache_pictures_are_composited_once(self, stack, monkeypatch: pytest.MonkeyPatch) -> None:
        composited = []
        whole = video_module.over_white
        monkeypatch.setattr(
            video_module, "over_white", lambda rows, most: composited.append(rows) or whole(rows, most)
        )
        temporal_components(*stack, 6)
        assert len(composited) == 2  # cameras
        monkeypatch.setattr(differences_module, "CACHE_BYTES", 0)
        temporal_components(*stack, 6)
        assert len(composited) == 2 + 4

    def test_states_that_repeat_are_as_good_as_pictures_of_their_own(self, stack) -> None:
        """Timesteps 0 … 8 and then 3, 5, 3 again; of the same video written to other pictures bit for bit."""
        images, cameras = stack
        again = np.array([*range(9), 3, 5, 3])
        repeated = [FixedCamera(c.viewmat, c.K, c.rows[again]) for c in cameras]
        components = temporal_components(images, repeated, 6)
        assert components.rank == 8
        video = np.concatenate([differences(images, c).reshape(12, -1) for c in repeated], 1)
        np.testing.assert_allclose(components.energy, spectrum(video), rtol=1e-4, atol=1e-4)
        for v, camera in enumerate(repeated):
            brute = np.einsum("rt,thwc->rhwc", components.basis, differences(images, camera))
            np.testing.assert_allclose(components.images[v], brute, atol=1e-5)

    def test_cameras_may_repeat_at_other_times(self, stack) -> None:
        """Each camera has four pictures, but together nine moments differ."""
        images, cameras = stack
        one = FixedCamera(cameras[0].viewmat, cameras[0].K, cameras[0].rows[[0, 0, 0, 1, 1, 1, 2, 2, 2]])
        two = FixedCamera(cameras[1].viewmat, cameras[1].K, cameras[1].rows[[0, 1, 2, 0, 1, 2, 0, 1, 2]])
        components = temporal_components(images, [one, two], 6)
        video = np.concatenate([differences(images, c).reshape(9, -1) for c in (one, two)], 1)
        np.testing.assert_allclose(components.energy, spectrum(video), rtol=1e-4, atol=1e-4)
        assert components.rank == 4  # two planes, each of rank two
