"""What the methods that are only compared are made of, and that each shows more of a motion than nothing that moves."""

import numpy as np
import pytest
import torch
from torch.nn.functional import grid_sample

from tests.helpers.synthetic import make_synthetic_dataset
from tests.research.bench.conftest import MODAL
from tg4mm.capture import load_capture, load_images
from tg4mm.fit.motion.animate import moved
from tg4mm.research.bench.jobs import run_job
from tg4mm.research.bench.methods.control_points import ControlConfig, ControlPoints, spread
from tg4mm.research.bench.methods.eulerian import magnified
from tg4mm.research.bench.methods.known import methods_of
from tg4mm.research.bench.methods.planes import CELLS, Place, PlaneField, place_of, rays_of, sample
from tg4mm.research.bench.request import BenchPlan
from tg4mm.research.bench.sets import open_set
from tg4mm.research.paper.space import views_at
from tg4mm.run import Run

BOX = np.array([[-1.0] * 3, [1.0] * 3], np.float32)
_FEW = {
    "tracking": {"iterations": "400", "resolution": "16"},
    "4dgs": {"iterations": "200", "resolution": "16"},
    "sc-gs": {"iterations": "200", "points": "100", "width": "32", "layers": "2"},
    "per-frame": {"iterations": "40"},
    "3dmm": {"iterations": "250", "motion_iterations": "60", "rays": "256", "resolution": "32"},
}


def test_planes_are_read_as_grid_sample_reads_them_and_gradients_go_back():
    draw = torch.Generator().manual_seed(0)
    planes = torch.rand(3, 8, 8, 5, generator=draw).requires_grad_()
    points = torch.rand(40, 3, generator=draw)
    weights = torch.rand(40, 15, generator=draw)
    parts = []
    for k, (a, b) in enumerate(((0, 1), (0, 2), (1, 2))):
        where = torch.stack([points[:, b], points[:, a]], 1)[None, None] * 2 - 1
        parts.append(grid_sample(planes[k].permute(2, 0, 1)[None], where, align_corners=True)[0, :, 0].T)
    plain, fast = torch.cat(parts, 1), sample(planes, points)
    gradients = [torch.autograd.grad((x * weights).sum(), planes)[0] for x in (plain, fast)]
    assert torch.allclose(plain, fast, atol=1e-6)
    assert torch.allclose(*gradients, atol=1e-5)


@pytest.mark.parametrize("filled", [1.0, 0.5])
def test_what_shines_through_falls_with_the_length_of_the_way_inside(filled):
    cells = np.zeros((CELLS,) * 3, bool)
    cells[: int(filled * CELLS)] = True
    field = PlaneField(Place(BOX, cells), 8, 2, torch.Generator().manual_seed(0)).requires_grad_(False)
    field.density[2].weight.zero_()
    field.density[2].bias[0] = 0.0  # density 1 everywhere
    rays = torch.tensor([[-3.0, 0.1, 0.2]]), torch.tensor([[1.0, 1e-9, 1e-9]])
    black, white = (
        field.render(field.planes, rays, behind, torch.full((1,), 0.5))
        for behind in (torch.zeros(1, 3), torch.ones(1, 3))
    )
    assert (white - black).numpy() == pytest.approx(np.exp(-2 * filled), rel=0.03)


def test_rays_go_through_the_centres_of_their_pixels(data):
    capture = load_capture(data)
    origins, directions = rays_of(capture.viewmats[:2], capture.Ks[:2], (capture.width, capture.height))
    at = (origins + 2.5 * directions)[-capture.width :]  # the last row of the second picture
    seen = at @ capture.viewmats[1, :3, :3].T + capture.viewmats[1, :3, 3]
    pixels = seen @ capture.Ks[1].T
    wanted = np.arange(capture.width) + 0.5, np.full(capture.width, capture.height - 0.5)
    assert np.abs(pixels[:, :2] / pixels[:, 2:] - np.stack(wanted, 1)).max() < 1e-3


def test_the_hull_holds_what_is_there_and_leaves_out_most_of_the_box(data):
    capture = load_capture(data)
    place = place_of(views_at(capture, load_images(capture), 0), margin=2)
    points = np.array([[0.5, 0.1, 0.37], [-0.35, 0.0, 1.0]])  # in the ball, in the post
    cells = ((points - place.box[0]) / (place.box[1] - place.box[0]) * CELLS).astype(int)
    assert place.filled[tuple(cells.T)].all()
    assert place.filled.mean() < 0.6


@pytest.mark.parametrize("way", ["linear", "phase"])
def test_planes_in_which_something_moves_are_magnified(way):
    t, x = np.arange(30)[:, None, None], np.arange(32)[None, :, None]

    def swinging(by):
        wave = np.sin(2 * np.pi * (x - by * np.sin(2 * np.pi * 5 * t / 30)) / 8)
        return np.ascontiguousarray(
            np.broadcast_to(wave[:, None, :, :, None], (30, 3, 32, 32, 1)), np.float32
        )

    response = np.where(np.arange(16) == 5, 4.0, 0.0)
    still, made, wanted = swinging(0.05), magnified(swinging(0.05), response, way), swinging(0.25)
    gain = ((made - still) * (wanted - still)).sum() / np.square(wanted - still).sum()
    assert gain == pytest.approx(1, abs=0.05)


def test_control_points_that_turn_as_one_carry_the_gaussians_rigidly(data):
    gaussians, _ = make_synthetic_dataset(data.parent / "rest", n_views=1, n_timesteps=1, size=8, n_test=0)
    points = ControlPoints(gaussians, ControlConfig(points=40, layers=1, width=8))
    assert not points(gaussians.means, 0.3).any()  # before training nothing moves
    turn, shift = torch.tensor([0.0, 0.0, 0.02]), torch.tensor([0.1, 0.0, 0.0])
    whole = torch.cat(
        [torch.linalg.cross(turn.expand_as(points.at), points.at) + shift, turn.expand_as(points.at)], 1
    )
    points.moves = lambda time: whole
    now = moved(gaussians, points(gaussians.means, 0.3))
    wanted = gaussians.means + torch.linalg.cross(turn.expand_as(gaussians.means), gaussians.means) + shift
    assert (now.means - wanted).abs().max() < 2e-3 * 0.1
    assert points.stretch(0.3) < 1e-6


def test_points_are_spread_as_far_as_they_go():
    line = torch.stack([torch.arange(9.0), torch.zeros(9), torch.zeros(9)], 1)
    assert sorted(spread(line, 3).tolist()) == [0, 4, 8]


@pytest.mark.slow
@pytest.mark.parametrize("name", _FEW)
def test_training_finds_the_motion_and_a_second_call_does_not_train(name, data, tmp_path):
    given = {f"{name}.{k}": v for k, v in _FEW[name].items()}
    (method,) = methods_of([name], {"modal": MODAL, name: given})
    plan = BenchPlan(alphas=(5.0,))
    figures, lines = run_job(method, open_set(data, "sway"), tmp_path, plan)
    gains = {line.row: line.alphas["5"]["gain"] for line in lines}
    for row in {"3dmm": ("3dmm: phase", "3dmm: linear")}.get(name, (name,)):
        assert gains[row] > 0.1, gains
    run = Run.open(tmp_path / "runs" / "sway" / name / "run")
    log = run.log()
    assert run_job(method, open_set(data, "sway"), tmp_path, plan) == (figures, lines)
    assert run.log() == log
    if name != "3dmm":
        assert method.training.overrides == {**MODAL, **given}
