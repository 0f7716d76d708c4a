"""The 2D baselines and the deformation field: what moves in the band moves as it should, all else stays."""

from pathlib import Path

import numpy as np
import pytest
import torch

from tg4mm.fit.magnify import PhaseMagnifier, half_octave_bands
from tg4mm.research.bench.methods.tracking import HexPlane
from tg4mm.research.bench.methods.video import Linear2D, Phase2D, SmoothedPhase, band_response
from tg4mm.research.bench.request import BenchPlan
from tg4mm.research.bench.sets import BenchSet

T, FPS, HZ = 30, 30.0, 5.0


def band_set(low, high):
    return BenchSet("a", Path("a"), 64, 64, T, 1, FPS, HZ, 0.2, (low, high), (5,), "rig", "0")


def moving(shift, hz=HZ, noise=0.0):
    """[T, 64, 64, 3] grey blobs that swing by `shift` pixels along x."""
    y, x = np.mgrid[:64, :64].astype(np.float64)
    frames = []
    for t in range(T):
        at = x - shift * np.sin(2 * np.pi * hz * t / FPS)
        frames.append(0.5 + 0.2 * np.sin(2 * np.pi * at / 16) * np.sin(2 * np.pi * y / 32))
    video = np.repeat(np.stack(frames)[..., None], 3, -1)
    return (video + np.random.default_rng(1).normal(0, noise, video.shape)).astype(np.float32)


def gain(made, wanted, of):
    """How far the change of `made` goes along the change that is wanted."""
    a, c = (v[..., 0].astype(np.float64) - of[..., 0] for v in (made, wanted))
    return float((a * c).sum() / (c * c).sum())


# linear-2d leaves the finest and the coarsest level as they are, as published, so a part of the motion is missing
@pytest.mark.parametrize(
    ("method", "alpha", "least"),
    [(Phase2D(), 10.0, 0.9), (Phase2D(), 4.0, 0.95), (Linear2D(cutoff=4.0), 4.0, 0.7)],
)
def test_motion_in_the_band_grows_by_one_plus_alpha(method, alpha, least):
    video = moving(0.1)
    response = band_response(band_set(3.5, 6.5), alpha, BenchPlan())
    made = method.magnified(video, response, alpha)
    assert least < gain(made, moving(0.1 * (1 + alpha)), video) < 1.05


@pytest.mark.parametrize("method", [Phase2D(), Linear2D(cutoff=4.0)])
def test_motion_outside_the_band_stays(method):
    video = moving(0.1, hz=12.0)
    made = method.magnified(video, band_response(band_set(3.5, 6.5), 10.0, BenchPlan()), 10.0)
    assert abs(gain(made, moving(1.1, hz=12.0), video)) < 0.03


def texture(shift):
    """[T, 64, 64] of all wavelengths, swinging by `shift` pixels along x."""
    k = np.fft.fftfreq(64)[None]
    spectrum = np.fft.fft2(np.random.default_rng(0).random((64, 64))) * np.exp(-20 * (k**2 + k.T**2))
    swing = shift * np.sin(2 * np.pi * HZ * np.arange(T) / FPS)
    return np.stack([np.fft.ifft2(spectrum * np.exp(-2j * np.pi * k * s)).real for s in swing]).astype(
        np.float32
    )


def test_the_smoothing_takes_noise_out_of_the_motion():
    response = band_response(band_set(3.5, 6.5), 10.0, BenchPlan())
    still, wanted = texture(0.05), texture(0.55)
    video = still + np.random.default_rng(3).normal(0, 0.01, still.shape).astype(np.float32)
    off, on = (SmoothedPhase((64, 64), response, sigma)(video) for sigma in (0.0, 2.0))
    plain = PhaseMagnifier((64, 64), response, half_octave_bands((64, 64)))(video)
    assert np.abs(off - plain).max() < 1e-5
    errors = [np.square(made - video - (wanted - still)).mean() for made in (off, on)]
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.parametrize(("chroma", "share"), [(True, 1.0), (False, 0.0)])
def test_colour_moves_along_unless_only_luma_is_asked_for(chroma, share):
    def coloured(shift):
        video = moving(shift)
        video[..., 2] = 0.5  # so that there is chroma, which moves
        return video

    response = band_response(band_set(3.5, 6.5), 10.0, BenchPlan())
    made = Phase2D(chroma=chroma).magnified(coloured(0.1), response, 10.0)
    signal = np.array([[0.596, -0.274, -0.322]]).T
    videos = (v.astype(np.float64) @ signal for v in (made, coloured(1.1), coloured(0.1)))
    assert gain(*videos) == pytest.approx(share, abs=0.1)


@pytest.mark.parametrize("band", [(0.0, 3.5), (1.5, 4.5), (3.5, 6.5)])
@pytest.mark.parametrize("method", [Phase2D(), Linear2D()])
def test_a_still_video_stays(method, band):
    """A filter of one second leaves some of 0 Hz in a low band, which α would multiply."""
    video = np.repeat(moving(0.0)[:1], T, axis=0)
    made = method.magnified(video, band_response(band_set(*band), 50.0, BenchPlan()), 50.0)
    assert np.abs(made - video).max() < 1e-4


def test_nothing_moves_before_training_and_every_parameter_gets_a_gradient():
    field = HexPlane(4, 2, 5, 3, 8, seed=0)
    points = torch.rand(20, 3) * 2 - 1
    assert not field(points, 0.3).any()
    torch.nn.init.normal_(field.head.weight)
    field(points, 0.3).square().sum().backward()
    assert all(p.grad is not None and p.grad.any() for p in field.parameters())
