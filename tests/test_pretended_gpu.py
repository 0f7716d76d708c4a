"""All that runs with --device cuda, on a pretended GPU: everything on one device, and no transfer in an iteration."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.fit.rasterize.oracle import assert_close
from tests.helpers.adam import assert_same_steps, oblong, watch_paper, watch_space
from tests.helpers.pretend import NAME, pretended_gpu, register
from tests.helpers.space_cuda import spherical_harmonics
from tests.helpers.synthetic import make_synthetic_dataset, moving_run
from tg4mm.capture import load_capture, load_images
from tg4mm.core.magnification import Magnification
from tg4mm.core.pictures.decode import read_png
from tg4mm.fit.motion import MotionConfig
from tg4mm.fit.space import SpaceConfig, rest_views
from tg4mm.fit.space import train as stage
from tg4mm.research.bench.methods.deformed import fit_motion
from tg4mm.research.bench.methods.tracking import TrackingConfig, track, track_along
from tg4mm.research.paper import motion as paper_motion
from tg4mm.research.paper import space as paper_space
from tg4mm.research.paper.model import PaperConfig
from tg4mm.research.paper.motion import train_timesteps
from tg4mm.research.paper.space import first_views, train_triplane
from tg4mm.run import Run
from tg4mm.run.stages import train_motion, train_space
from tg4mm.show.render.cameras import capture_cameras
from tg4mm.show.render.sequence import RenderRequest, render_sequence

SHORT = SpaceConfig(iterations=12, max_gaussians=500, init_points=300, dssim=0.2)
# Small rates: Adam's first steps are as long for a gradient of rounding as for any other, and later gradients tell.
PAPER = PaperConfig(
    channels=4, resolution=32, iterations=12, warm_up=6, motion_iterations=10, shared=True,
    learning_rate=1e-5, motion_learning_rate=1e-5,
)  # fmt: skip
FEW = MotionConfig(components=2, iterations=4, tolerance=1e-6)


register()  # while tests are collected: before any backward pass


@pytest.fixture
def gpu(monkeypatch):
    for module in (stage, paper_space, paper_motion):
        for name in ("SHOW_EVERY_S", "CHECKPOINT_EVERY_S"):  # what is shown or saved is fetched
            monkeypatch.setattr(module, name, 1e9)
    with pretended_gpu(monkeypatch, spherical_harmonics) as there:
        yield there


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A dataset that moves, and a run with its exact Gaussians and motion."""
    root = tmp_path_factory.mktemp("pretended")
    run = moving_run(root, n_views=6, n_timesteps=6, size=32, freqs=(5.0,), alphas=(5,), n_test=2)
    return root / "data", run


def counted(gpu):
    found = dict(gpu.counts)
    gpu.counts.clear()
    return found


def trained_space(data, path, iterations, device):
    capture = load_capture(data)
    views = rest_views(capture, load_images(capture))
    config = replace(SHORT, iterations=iterations)
    return train_space(Run.create(path, data, "modal", {}), views, capture.points, config, device)


def test_the_space_stage(made, tmp_path, gpu, monkeypatch):
    watched = watch_space(monkeypatch)
    trained_space(made[0], tmp_path / "there", 12, NAME)
    of_twelve = counted(gpu)
    trained_space(made[0], tmp_path / "here", 12, "cpu")
    assert not counted(gpu)
    assert_same_steps(*watched)
    counted(gpu)  # what the comparison fetched
    trained_space(made[0], tmp_path / "longer", 24, NAME)
    assert counted(gpu) == of_twelve  # twice the iterations bring nothing more to the host, nor to the device


@pytest.mark.slow
def test_the_motion_stage(made, tmp_path, gpu):
    data, source = made
    capture = load_capture(data)
    images, found, crossed = load_images(capture), [], []
    # After 4 iterations folds agree on less, and other transfers follow than after 8 or 12.
    for place, iterations in ((NAME, 8), ("cpu", 8), (NAME, 12)):
        run = Run.create(tmp_path / f"{place}{iterations}", data, "modal", {})
        run.save_space(source.load_space(), {})
        counted(gpu)
        motion = train_motion(run, capture, images, replace(FEW, iterations=iterations), place)
        found.append(torch.view_as_real(torch.from_numpy(motion.displacement)))
        crossed.append(counted(gpu))
    assert_close("displacement", found[0], found[1], 1e-2)
    solved = 2 * int(
        Run.open(tmp_path / f"{NAME}8").log()["motion"]["components"]
    )  # by two halves of the cameras
    assert crossed[1] == {}
    sums = 2 * 4 * solved  # two of every step of conjugate gradients
    assert crossed[2] == crossed[0] | {"down": crossed[0]["down"] + sums}


@pytest.mark.slow
def test_motion_of_more_than_a_pixel(tmp_path, gpu):
    """One Gauss-Newton iteration: refining the scene at rest forks from the last digits."""
    gaussians, _ = make_synthetic_dataset(
        tmp_path / "data", n_views=6, n_timesteps=5, size=32, freqs=(6.0,), amplitude=0.2, alphas=(), n_test=0
    )
    capture = load_capture(tmp_path / "data")
    images, found = load_images(capture), []
    config = replace(FEW, components=1, smoothness_weight=300.0, gauss_newton=1)
    for place in ("cpu", NAME):
        run = Run.create(tmp_path / place, tmp_path / "data", "modal", {})
        run.save_space(gaussians, {})
        motion = train_motion(run, capture, images, config, place)
        assert run.log()["motion"]["gauss_newton"] == 1
        found.append(torch.view_as_real(torch.from_numpy(motion.displacement)))
    assert_close("displacement", found[1], found[0], 1e-2)


def test_pictures(made, tmp_path, gpu):
    data, run = made
    cameras = capture_cameras(load_capture(data, split="test"))
    request = RenderRequest(Magnification.of(5))
    here, there = (
        render_sequence(run, cameras, request, tmp_path / place, video=False, device=place)
        for place in ("cpu", NAME)
    )
    pictures = sorted(here.rglob("*.png"))
    assert len(pictures) == gpu.counts["down"] > 0  # a picture crosses once
    assert gpu.counts["waits"] == 0
    for path in pictures:
        a, b = read_png(path).astype(int), read_png(there / path.relative_to(here)).astype(int)
        assert np.abs(a - b).max() <= 1


def scattered(gaussians):
    """A little off their places: of two at the same depth, rounding would decide which is in front."""
    noise = torch.randn(gaussians.means.shape, generator=torch.Generator().manual_seed(2))
    return replace(gaussians, means=gaussians.means + 0.01 * noise)


def test_the_preset_paper(made, tmp_path, gpu, monkeypatch):
    data, source = made
    capture = load_capture(data)
    images, counts, base = load_images(capture), [], scattered(oblong(source.load_space()))
    watched = watch_paper(monkeypatch)
    for place, times in ((NAME, 1), ("cpu", 1), (NAME, 2)):
        run = Run.create(tmp_path / f"{place}{times}", data, "paper", {})
        config = replace(PAPER, iterations=6 + 6 * times, motion_iterations=PAPER.motion_iterations * times)
        counted(gpu)
        views = first_views(capture, images)
        run.save_space(base, {})
        model = train_triplane(run, base, views, config, place)
        train_timesteps(run, model, capture, images, config, place)
        counts.append(counted(gpu))
        if times == 1:
            out = render_sequence(
                run, capture_cameras(load_capture(data, split="test"))[:1], RenderRequest(Magnification.of(5)),
                tmp_path / f"pictures_{place}", video=False, device=place,
            )  # fmt: skip
            assert any(out.rglob("*.png"))
    assert counts[1] == {}
    n_fits = capture.n_timesteps  # phase 1, and phase 2 of each timestep but the first
    for found, expected in zip(watched[:n_fits], watched[n_fits : 2 * n_fits], strict=True):
        assert_same_steps(found, expected)
    assert counts[2] == counts[0]


@pytest.mark.parametrize("fit", [track, track_along])
def test_the_method_tracking(fit, made, tmp_path, gpu):
    data, source = made
    capture = load_capture(data)
    images, base, found = load_images(capture), scattered(oblong(source.load_space())), []
    config = TrackingConfig(iterations=5, resolution=8, levels=1, channels=4, width=8)
    for place in ("cpu", NAME):
        run = Run.create(tmp_path / place, data, "modal", {})
        run.save_space(base, {})
        fit_motion(run, capture, images, fit, config, place)
        found.append(torch.view_as_real(torch.from_numpy(run.load_motion().displacement)))
        assert bool(counted(gpu)) == (place == NAME)
    assert found[0].abs().max() > 0
    assert_close("displacement", found[1], found[0], 1e-2)
