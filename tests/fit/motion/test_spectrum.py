"""Functions of time and shapes in space become phasors, and give the motion back.

Sinusoids between the bins, and drifts, are found in functions of time; noise and whole periods have none.
"""

import numpy as np
import pytest

from tg4mm.fit.motion.spectrum import FrameClock, find_sinusoids, modes_of

FPS = 30.0
CAPTURES = [(30, 2.5), (37, 2.5), (30, 5.2), (60, 4.71), (100, 4.71), (300, 4.71)]


def phasors(basis, fields, fps):
    """Frequencies [K] and phasors [K, N, D] of Σ_r a_r(t) fields[r]."""
    freqs, series = modes_of(basis, fields, fps)
    return freqs, np.tensordot(series, fields, axes=1)


def synthesis(freqs, values, t):
    """Σ_k Re[m_k exp(i 2π f_k t / fps)] at every t: [T, N, D]. Written out, not the code's."""
    return np.stack(
        [
            sum((m * np.exp(2j * np.pi * f * s / FPS)).real for f, m in zip(freqs, values, strict=True))
            for s in t
        ]
    )


def zero_mean_basis(n, n_timesteps, seed=0):
    a = np.random.default_rng(seed).normal(size=(n_timesteps, n))
    q, _ = np.linalg.qr(a - a.mean(0))
    return q.T


class TestPhasors:
    @pytest.mark.parametrize("n_timesteps", [2, 3, 8, 9, 30, 31])
    def test_they_give_the_motion_back_at_every_timestep(self, n_timesteps):
        """Even T has a Nyquist bin, odd T has none."""
        rng = np.random.default_rng(1)
        basis = zero_mean_basis(min(3, n_timesteps - 1), n_timesteps)
        shapes = rng.normal(size=(len(basis), 4, 6))
        freqs, values = phasors(basis, shapes, FPS)
        assert values.shape == (n_timesteps // 2, 4, 6)
        expected = np.einsum("rt,rnd->tnd", basis, shapes)
        found = synthesis(freqs, values, np.arange(n_timesteps))
        np.testing.assert_allclose(found, expected, atol=3e-6)
        # the comparison can fail: a Nyquist bin counted twice, or a wrong sign of time
        if n_timesteps % 2 == 0:
            values[-1] *= 2
            assert np.abs(synthesis(freqs, values, np.arange(n_timesteps)) - expected).max() > 1e-2

    def test_a_sine_lands_in_its_bin_with_its_phase(self):
        """0.3 cos(2π 5 t/30 + 0.7): one bin, phasor 0.3 exp(0.7i)."""
        t = np.arange(30)
        basis = np.stack([np.cos(2 * np.pi * 5 * t / 30), np.sin(2 * np.pi * 5 * t / 30)]) / np.sqrt(15)
        shape = np.array([np.cos(0.7), -np.sin(0.7)])[:, None, None] * 0.3 * np.sqrt(15)
        freqs, values = phasors(basis, shape, FPS)
        np.testing.assert_allclose(freqs, np.arange(1, 16))
        np.testing.assert_allclose(values[4, 0, 0], 0.3 * np.exp(0.7j), rtol=1e-6)
        assert np.abs(np.delete(values, 4, 0)).max() < 1e-7

    def test_the_mean_over_time_is_left_out(self):
        basis = zero_mean_basis(2, 10)
        shapes = np.ones((2, 1, 1))
        shifted, own = (phasors(of, shapes, FPS)[1] for of in (basis + 3.0, basis))
        np.testing.assert_allclose(shifted, own, atol=1e-6)


def video_of(n_timesteps, parts, drift=None):
    """Principal functions of time [R, T] and shapes [R, N, 6] of sinusoids (Hz → phasors [N, 6]) and drift."""
    t = np.arange(n_timesteps)
    video = sum(np.real(np.exp(2j * np.pi * f * t / FPS)[:, None, None] * m) for f, m in parts.items())
    if drift is not None:
        video = video + (t / FPS)[:, None, None] * drift
    flat = (video - video.mean(0)).reshape(n_timesteps, -1)
    left, strength, right = np.linalg.svd(flat, full_matrices=False)
    rank = int((strength > 1e-9 * strength[0]).sum())
    return left[:, :rank].T, (strength[:rank, None] * right[:rank]).reshape(rank, *video.shape[1:])


def shape(seed):
    """[5, 6] complex phasors."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(5, 6)) + 1j * rng.normal(size=(5, 6))


class TestBetweenBins:
    @pytest.mark.parametrize(("n_timesteps", "frequency"), CAPTURES)
    def test_a_sinusoid_is_one_mode(self, n_timesteps, frequency):
        true = shape(0)
        freqs, values = phasors(*video_of(n_timesteps, {frequency: true}), FPS)
        strength = np.linalg.norm(values, axis=(1, 2))
        oscillates = np.flatnonzero(freqs > 0)
        k = oscillates[strength[oscillates].argmax()]
        assert freqs[k] == pytest.approx(frequency, abs=1e-4)
        np.testing.assert_allclose(values[k], true, atol=2e-3)
        others = np.delete(strength, [0, k])
        assert freqs[0] == 0
        assert others.max(initial=0) < 2e-3 * strength[k]

    @pytest.mark.parametrize(("n_timesteps", "frequency"), CAPTURES)
    def test_its_zero_is_found(self, n_timesteps, frequency):
        """0 Hz leads from the mean over time, where the Gaussians lie, to where the motion is zero."""
        true = shape(0)
        freqs, values = phasors(*video_of(n_timesteps, {frequency: true}), FPS)
        mean = np.exp(2j * np.pi * frequency * np.arange(n_timesteps) / FPS).mean()
        assert freqs[0] == 0
        np.testing.assert_allclose(values[0].real, -(mean * true).real, atol=2e-3)
        np.testing.assert_allclose(values[0].imag, 0, atol=1e-7)

    def test_the_motion_comes_back_at_every_timestep(self):
        for n_timesteps, drift in [(30, None), (37, shape(2).real), (64, shape(2).real)]:
            basis, shapes = video_of(n_timesteps, {2.5: shape(0), 11.3: 0.2 * shape(1)}, drift)
            freqs, values = phasors(basis, shapes, FPS)
            found = synthesis(freqs, values, np.arange(n_timesteps))
            np.testing.assert_allclose(found, np.einsum("rt,rnd->tnd", basis, shapes), atol=2e-5)


def test_of_frames_that_lack_the_phasors_are_those_of_the_motion():
    """Five of 120 frames are missing: the sinusoid as it is, and in the bins beside it little."""
    kept = np.delete(np.arange(120), [17, 18, 60, 61, 99])
    true = shape(0)
    basis, shapes = video_of(120, {4.71: true})
    motion = np.einsum("rt,rnd->tnd", basis, shapes)[kept]
    flat = (motion - motion.mean(0)).reshape(len(kept), -1)
    left, strength, right = np.linalg.svd(flat, full_matrices=False)
    functions, fields = left[:, :2].T, (strength[:2, None] * right[:2]).reshape(2, *true.shape)
    freqs, series = modes_of(functions, fields, FPS, times_s=kept / FPS)
    values = np.tensordot(series, fields, axes=1)
    k = int(np.linalg.norm(values[1:], axis=(1, 2)).argmax()) + 1
    assert freqs[k] == pytest.approx(4.71, abs=1e-4)
    np.testing.assert_allclose(values[k], true, atol=2e-3)
    freqs, series = modes_of(functions, fields, FPS)  # as if they were even
    values = np.tensordot(series, fields, axes=1)
    k = int(np.linalg.norm(values[1:], axis=(1, 2)).argmax()) + 1
    assert np.linalg.norm(values[k] - true) > 0.1 * np.linalg.norm(true)


@pytest.mark.parametrize("hz", [11.37, 12.0])
def test_a_small_part_s_own_frequency_is_a_mode_where_it_is_known(hz):
    """One of 400 Gaussians moves at it, by .05 of the others: 6 in 10⁶ of the power, which the bins would drop."""
    t, rng = np.arange(100) / FPS, np.random.default_rng(3)
    one, other = np.zeros((400, 6)), rng.normal(size=(400, 6))
    one[7, :3], other[7] = 0.05, 0
    turns = 2 * np.pi * t[:, None, None]
    motion = np.cos(4.71 * turns) * other + np.sin(hz * turns) * one
    flat = (motion - motion.mean(0)).reshape(100, -1)
    left, strength, right = np.linalg.svd(flat, full_matrices=False)
    rank = int((strength > 1e-9 * strength[0]).sum())
    basis, fields = left[:, :rank].T, (strength[:rank, None] * right[:rank]).reshape(rank, 400, 6)
    for known, error in (((), 0.9), ((hz,), 1e-3)):
        freqs, series = modes_of(basis, fields, FPS, known_hz=known)
        own = np.abs(freqs - hz) < 1e-6
        found = np.tensordot(series, fields, axes=1)[own, 7, 0].sum()
        assert (abs(found - -0.05j) / 0.05 < error) == bool(known)


class TestBands:
    """What a band holds is a mode as a whole, and nothing of what lies outside."""

    def in_band(self, freqs, values, low, high, t):
        inside = (freqs >= low) & (freqs <= high)
        return synthesis(freqs[inside], values[inside], t)

    @pytest.mark.parametrize("n_timesteps", [30, 37, 60, 300])
    @pytest.mark.parametrize("frequency", [5.0, 4.71])
    def test_drift_and_a_distractor_stay_out(self, n_timesteps, frequency):
        """5 Hz among 11.3 Hz as strong, and a drift of ten times the amplitude a second."""
        t, true = np.arange(n_timesteps), shape(0)
        basis, shapes = video_of(n_timesteps, {frequency: true, 11.3: shape(1)}, 10 * shape(2).real)
        found = self.in_band(*phasors(basis, shapes, FPS), 4, 6, t)
        wanted = synthesis(np.array([frequency]), true[None], t)
        error = np.sqrt(((found - wanted) ** 2).mean() / (wanted**2).mean())
        assert error < 0.02
        plain = np.fft.rfft(np.einsum("rt,rnd->tnd", basis, shapes), axis=0)  # what bins alone do
        freqs = np.fft.rfftfreq(n_timesteps, 1 / FPS)
        plain[(freqs < 4) | (freqs > 6)] = 0
        by_bins = np.fft.irfft(plain, n_timesteps, axis=0)
        assert np.sqrt(((by_bins - wanted) ** 2).mean() / (wanted**2).mean()) > 5 * error


def functions(n_timesteps, cycles, drift=0.0, noise=0.0, seed=0, n_pixels=400, decay=0.0):
    """[R, T]: principal functions of time of many pixels that swing with every tone, by their strength.

    `drift`: rms of what a pixel drifts over the capture; `noise`: standard deviation; `decay`: cycles to 1/e.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(n_timesteps) / n_timesteps
    video = drift * np.outer(t, rng.normal(size=n_pixels)) + noise * rng.normal(size=(n_timesteps, n_pixels))
    for c in cycles:
        law = np.exp(-t * c / decay) if decay else 1
        for wave in (np.sin, np.cos):
            video += np.outer(wave(2 * np.pi * c * t) * law, rng.normal(size=n_pixels))
    left, strength, _ = np.linalg.svd(video - video.mean(0), full_matrices=False)
    return (left * strength)[:, : min(16, int((strength > 1e-6 * strength[0]).sum()))].T


class TestFrequencies:
    @pytest.mark.parametrize(
        ("n_timesteps", "cycles"),
        [
            (30, (2.5,)),
            (37, (2.5 * 37 / 30,)),
            (30, (1.4,)),
            (12, (3.3,)),
            (30, (5.3, 11.3)),
            (60, (4.5, 5.7, 20.2)),
            (300, (25.4, 113.1)),
            (31, (13.6,)),  # 0.9 of half the frame rate
        ],
    )
    @pytest.mark.parametrize("drift", [0.0, 1.0])
    def test_of_clean_motion_they_are_exact(self, n_timesteps, cycles, drift):
        found = find_sinusoids(functions(n_timesteps, cycles, drift))
        np.testing.assert_allclose(found.cycles, cycles, atol=2e-3 if drift else 1e-4)
        assert found.trend == bool(drift)

    @pytest.mark.parametrize("seed", range(4))
    @pytest.mark.parametrize("cycles", [(2.5,), (5.3, 11.3)])
    def test_of_noisy_motion_they_are_as_near_as_noise_lets(self, cycles, seed):
        """Four standard deviations of the Cramér–Rao bound, √(6 σ² / (π² T Σ a² / 2)) … in cycles per capture."""
        noise, n_timesteps, n_pixels = 0.3, 30, 400
        found = find_sinusoids(functions(n_timesteps, cycles, noise=noise, seed=seed, n_pixels=n_pixels))
        bound = np.sqrt(6 * noise**2 / (np.pi**2 * n_timesteps * 2 * n_pixels))  # Σ a² = 2 for each pixel
        np.testing.assert_allclose(found.cycles, cycles, atol=4 * bound)
        assert not found.trend


@pytest.mark.parametrize("jitter", [0.0, 0.2])
@pytest.mark.parametrize("cycles", [(2.5,), (5.3, 41.3)])
def test_of_frames_that_lack_or_come_late_they_are_exact(cycles, jitter):
    """Seven of 100 frames are missing; the others come up to a fifth of a frame early or late."""
    rng = np.random.default_rng(3)
    times = np.delete(np.arange(100), [9, 10, 11, 40, 77, 78, 90]) + jitter * rng.uniform(-1, 1, 93)
    times -= times[0]
    angles = 2 * np.pi * np.outer(cycles, times / 100)
    series = rng.normal(size=(5, 2 * len(cycles))) @ np.concatenate([np.cos(angles), np.sin(angles)])
    found = find_sinusoids(series, FrameClock.of(times))
    np.testing.assert_allclose(found.cycles, cycles, atol=1e-3)


class TestNone:
    @pytest.mark.parametrize("noise", [0.0, 0.1])
    @pytest.mark.parametrize("cycles", [(5.0,), (1.0,), (3.0, 7.0, 12.0)])
    def test_of_whole_periods(self, cycles, noise):
        found = find_sinusoids(functions(30, cycles, noise=noise))
        assert not len(found.cycles)
        assert not found.trend

    @pytest.mark.parametrize("seed", range(6))
    @pytest.mark.parametrize(("n_timesteps", "n_pixels"), [(30, 400), (300, 400), (30, 1), (64, 2)])
    def test_of_noise(self, n_timesteps, n_pixels, seed):
        found = find_sinusoids(functions(n_timesteps, (), noise=1.0, n_pixels=n_pixels, seed=seed))
        assert not len(found.cycles)
        assert not found.trend

    def test_of_less_than_one_cycle(self):
        """It cannot be distinguished from a drift and an offset."""
        assert not len(find_sinusoids(functions(30, (0.6,))).cycles)

    @pytest.mark.parametrize("series", [np.zeros((2, 30)), np.zeros((0, 30)), np.ones((1, 30)), np.eye(3, 6)])
    def test_of_nothing_or_too_little(self, series):
        assert not len(find_sinusoids(series).cycles)


def test_a_drift_alone_is_a_trend():
    found = find_sinusoids(functions(30, (), drift=1.0, noise=0.05))
    assert found.trend
    assert not len(found.cycles)


def test_of_a_mode_that_rings_down_the_tone_lies_at_its_peak():
    """To 1/e in half the capture: what the tone leaves goes to the bins."""
    found = find_sinusoids(functions(60, (10.4,), decay=5.2))
    assert len(found.cycles) in (0, 1)
    np.testing.assert_allclose(found.cycles, 10.4, atol=0.1)
