"""Phase-based magnification: a known shift grows as it should, and nothing else changes.

Phase magnification stays within the memory that tg4mm/fit/magnify.py states, whatever T is.
"""

import os
import subprocess
import sys
from collections import OrderedDict

import numpy as np
import pytest
import torch

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.magnification import TemporalFilter, apply_response, bins
from tg4mm.fit.magnify import PhaseMagnifier, PyramidConfig, _give, crop, pyramid, sub_bands, turn

FPS, T, SIZE = 30.0, 30, 64
BAND = (3.5, 6.5)
WAVELENGTH = 16.0  # cells
SMOOTH = PyramidConfig(twidth=1.0)
PHASE_SIZE = 128
# A process of its own: one that has run other tests may take memory that it holds already.
MAGNIFY = """
import sys
import numpy as np
import torch
from tg4mm.core.magnification import TemporalFilter, bins
from tg4mm.fit.magnify import PhaseMagnifier
from tg4mm.core.memory import peak_memory_mib, reset_peak_memory
torch.set_num_threads(1)
n, size = int(sys.argv[1]), int(sys.argv[2])
magnify = PhaseMagnifier((size, size), 20 * TemporalFilter().response((3.5, 6.5), bins(n, 30.0), 30.0))
if not reset_peak_memory():
    sys.exit("no reset")
before = peak_memory_mib()
out = magnify(np.random.default_rng(0).standard_normal((n, size, size), np.float32))
assert out.shape == (n, size, size)
print(peak_memory_mib() - before)
"""


def response(alpha, kind="ideal", n=T):
    return alpha * TemporalFilter(kind).response(BAND, bins(n, FPS), FPS)


def shift(amplitude, frequency=5.0, n=T):
    """[T] cells, zero at timestep 0."""
    return amplitude * np.sin(2 * np.pi * frequency * np.arange(n) / FPS)


def pattern(dx, oblique=False):
    """[T, SIZE, SIZE] float32: a grating within a Gaussian window, moved along x by dx [T] cells."""
    y, x = np.mgrid[:SIZE, :SIZE] - SIZE / 2
    moved = x[None] - dx[:, None, None]
    wave = np.cos(2 * np.pi * (moved + (y if oblique else 0)) / WAVELENGTH)
    return (np.exp(-(moved**2 + y[None] ** 2) / (2 * 12.0**2)) * wave).astype(np.float32)


def linear(video, factors):
    return video + apply_response(video - video[:1], factors)


def error(video, truth, rest):
    """rms/rms of the change since rest."""
    return float(np.linalg.norm(video - truth) / np.linalg.norm(truth - rest))


@pytest.mark.parametrize("config", [PyramidConfig(), SMOOTH], ids=["published", "smooth"])
def test_sub_bands_are_the_pyramid_of_plenoptic(config):
    image = torch.from_numpy(np.random.default_rng(0).standard_normal((1, 1, 32, 32)).astype(np.float32))
    made = pyramid((32, 32), config)
    expected = made(image)
    spectrum = torch.fft.fft2(image[0, 0])
    bands = list(sub_bands((32, 32), config))
    assert [(b.scale, b.orientation) for b in bands] == [(s, o) for s in range(3) for o in range(8)]
    total = torch.zeros(32, 32)
    for b in bands:
        coefficients = torch.fft.ifft2(crop(spectrum, b.analysis.shape) * b.analysis)
        torch.testing.assert_close(coefficients, expected[b.scale][0, 0, b.orientation], atol=1e-5, rtol=0)
        half = torch.zeros(1, 32, 17, dtype=torch.complex64)
        _give(half, (torch.fft.fft2(coefficients) * b.synthesis)[None])
        total += torch.fft.irfft2(half[0], s=(32, 32))
    oriented = OrderedDict((k, v if isinstance(k, int) else torch.zeros_like(v)) for k, v in expected.items())
    torch.testing.assert_close(total, made.recon_pyr(oriented)[0, 0], atol=1e-4, rtol=0)


def test_streamed_is_the_same_as_whole_pyramids_of_plenoptic():
    """The twin: every coefficient of every frame at once, with plenoptic's own forward and inverse."""
    video, factors = pattern(shift(0.3)), response(4.0)
    made = pyramid((SIZE, SIZE), PyramidConfig())
    whole = made(torch.from_numpy(video)[:, None])
    for key, value in whole.items():
        if isinstance(key, int):
            flat = value.reshape(T, -1).clone()
            turn(flat, torch.from_numpy(factors.astype(np.complex64)))
            whole[key] = value + flat.reshape(value.shape)
    expected = made.recon_pyr(whole)[:, 0].numpy()
    np.testing.assert_allclose(PhaseMagnifier((SIZE, SIZE), factors)(video), expected, atol=2e-4)


@pytest.mark.parametrize("oblique", [False, True])
@pytest.mark.parametrize("alpha", [-1.0, -0.5, 5.0, 20.0])
def test_a_shift_grows_by_one_plus_alpha(alpha, oblique):
    small = shift(0.1)
    out = PhaseMagnifier((SIZE, SIZE), response(alpha))(pattern(small, oblique))
    truth, rest = pattern((1 + alpha) * small, oblique), pattern(0 * small, oblique)
    if alpha == -1:
        assert np.linalg.norm(out - rest) < 0.15 * np.linalg.norm(pattern(small, oblique) - rest)
    else:
        assert error(out, truth, rest) < 0.15  # what is left: a window that moves changes amplitudes too


def test_phase_is_better_than_linear_where_linear_fails():
    """α · shift of a quarter wavelength and more: values cannot be extrapolated along a line, phases can."""
    small, rest = shift(0.1), pattern(0 * shift(0.1))
    for alpha, bound in ((40.0, 0.1), (70.0, 0.12)):  # 4 and 7 cells: 1/4 and 0.44 of a wavelength
        truth = pattern((1 + alpha) * small)
        phase = PhaseMagnifier((SIZE, SIZE), response(alpha))(pattern(small))
        along_a_line = linear(pattern(small), response(alpha))
        assert error(phase, truth, rest) < bound < error(along_a_line, truth, rest)


def test_what_is_suppressed_does_not_move_and_the_band_moves_by_one_plus_alpha():
    alpha, small, other = 9.0, shift(0.1), shift(0.2, 12.0)
    factors = response(alpha + 1)
    out = PhaseMagnifier((SIZE, SIZE), factors, suppressed=True)(pattern(small + other))
    rest = pattern(0 * small)
    assert error(out, pattern((1 + alpha) * small), rest) < 0.15
    still = PhaseMagnifier((SIZE, SIZE), 0 * factors, suppressed=True)(pattern(small + other))
    assert np.linalg.norm(still - rest) < 0.15 * np.linalg.norm(pattern(small + other) - rest)


def test_what_is_weak_keeps_its_phase_where_a_percentile_says_so():
    video = pattern(shift(0.1)) + np.random.default_rng(0).normal(0, 3e-3, (T, SIZE, SIZE)).astype(np.float32)
    truth, rest = pattern(shift(1.0)), pattern(0 * shift(1.0))
    changes = []
    for percentile in (0.0, 50.0):
        out = PhaseMagnifier((SIZE, SIZE), response(9.0), amplitude_percentile=percentile)(video)
        assert error(out, truth, rest) < 0.2
        changes.append(np.linalg.norm((out - video)[:, :6]))  # the edge, where there is noise alone
    assert changes[1] < 0.5 * changes[0]


def test_no_magnification_is_the_identity():
    video = pattern(shift(0.3))
    assert np.array_equal(PhaseMagnifier((SIZE, SIZE), response(0.0))(video), video)
    still = np.repeat(pattern(np.zeros(1)), T, 0)
    assert np.array_equal(PhaseMagnifier((SIZE, SIZE), response(50.0))(still), still)


def test_what_does_not_fit_is_refused():
    with pytest.raises(Tg4mmError, match="planes of 48×64 cells, expected powers of two of at least 16"):
        PhaseMagnifier((48, 64), response(1.0))
    with pytest.raises(ValueError, match=r"video has shape \(30, 32, 64\), expected frames of"):
        PhaseMagnifier((SIZE, SIZE), response(1.0))(np.zeros((T, 32, SIZE), np.float32))


def peak_mib(n):
    """Above what the filters hold, the video itself included."""
    command = [sys.executable, "-c", MAGNIFY, str(n), str(PHASE_SIZE)]
    # glibc keeps freed blocks of up to 32 MB unless its threshold is fixed; the stated size has larger ones only.
    environment = os.environ | {"MALLOC_MMAP_THRESHOLD_": "65536"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if "no reset" in done.stderr:
        pytest.skip("this system cannot reset the peak of memory")
    assert done.returncode == 0, done.stderr
    return float(done.stdout)


@pytest.mark.slow
def test_peak_memory_is_within_20_bytes_a_cell_and_100_mb():
    few, many = 100, 300
    cells = many * PHASE_SIZE**2
    bound = (20 * cells + 100e6) / 2**20
    whole = 8 * 8 * 4 / 3 * cells / 2**20  # complex coefficients of whole pyramids, eight orientations
    assert whole > 2 * bound  # else the bound would not tell streaming from holding everything
    peaks = peak_mib(few), peak_mib(many)
    assert peaks[1] < bound
    per_cell = (peaks[1] - peaks[0]) * 2**20 / ((many - few) * PHASE_SIZE**2)
    assert 4 < per_cell < 21  # the video alone is 4; a half-spectrum has W/2 + 1 columns, not W/2
