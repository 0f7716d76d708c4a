"""The CPU's own iteration beside the one that torch makes: gradients, steps, shares, and what it leaves alone."""

import numba
import pytest
import torch

from tests.fit.rasterize.oracle import assert_close
from tests.helpers.space_fused import SCENE, parameters, views_of
from tests.helpers.space_parameters import EXTENT, gradients, take_step
from tg4mm.fit.space import SpaceConfig
from tg4mm.fit.space import train as stage
from tg4mm.fit.space.fused import FusedAdam
from tg4mm.fit.space.parameters import ParameterAdam

LOSSES = [(0.0, 0.0), (10.0, 0.0), (10.0, 0.2)]


class Trained:
    """Some iterations over the cameras in turn, by one of the two optimisers."""

    def __init__(self, kind, steps, degree=3, loss=(10.0, 0.0)):
        cameras = stage._Views(views_of(), SpaceConfig(l2=loss[0], dssim=loss[1]), "cpu")
        generator, error = torch.Generator(), torch.zeros(len(SCENE.means))
        self.fit = stage._Fit(kind(parameters(), EXTENT), error, torch.zeros(()), generator, generator)
        self.mse = [cameras.iterate(self.fit, k % 3, degree, k / 10) for k in range(steps)]
        self.moments = {k: v.detach().clone() for k, v in self.fit.adam.moments().items()}
        self.parameters = {k: v.detach().clone() for k, v in self.fit.adam.parameters.items()}


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("degree", [0, 2, 3])
def test_one_step_has_torchs_gradients(degree, loss):
    """After the first step the first moments are a tenth of the gradient, the second a thousandth of its square."""
    expected, found = (Trained(kind, 1, degree, loss) for kind in (ParameterAdam, FusedAdam))
    assert found.moments["step"] == expected.moments["step"] == 1
    for name, value in expected.moments.items():
        if value.numel() > 1:
            assert value.any() == (name[:3] != "shn" or degree > 0)
            assert_close(name, found.moments[name], value, 2e-4)
    assert_close("shares", found.fit.error, expected.fit.error, 1e-4)
    assert found.fit.error.max() > 0
    assert float(found.mse[0]) == pytest.approx(float(expected.mse[0]), rel=1e-5)


@pytest.mark.parametrize("kind", [ParameterAdam, FusedAdam])
@pytest.mark.parametrize("spacing", [2, 3])
def test_the_grids_of_pixels_add_up_to_the_picture(kind, spacing):
    """Gradients and errors, of means over pixels each; shares are sums. The Gaussians are small: of one that reaches in
    from far outside a picture, gsplat limits the slant, by the picture's edge, and a grid's lies elsewhere.
    """
    small = parameters()
    small["log_scales"] -= 2.5

    def first(turn, spacing):
        cameras = stage._Views(views_of(), SpaceConfig(), "cpu", spacing=spacing)
        generator, error = torch.Generator(), torch.zeros(len(SCENE.means))
        iteration = len(cameras) * turn  # a round of all views goes by before view 0 has its next turn
        fit = stage._Fit(kind(small, EXTENT), error, torch.zeros(()), generator, generator, iteration)
        return float(cameras.iterate(fit, 0, 3, 0.0)), fit.error, fit.adam.moments()

    mse, shares, moments = first(0, 1)
    grids = [first(turn, spacing) for turn in range(spacing**2)]
    rows, columns = ([len(range(k, n, spacing)) for k in range(spacing)] for n in (SCENE.height, SCENE.width))
    weights = [r * c / SCENE.height / SCENE.width for r in rows for c in columns]
    assert sum(w * own[0] for w, own in zip(weights, grids, strict=True)) == pytest.approx(mse, rel=1e-5)
    assert_close("shares", sum(own[1] for own in grids), shares, 1e-4)
    for name in (name for name in moments if name.endswith(".m")):
        parts = sum(w * own[2][name] for w, own in zip(weights, grids, strict=True))
        assert_close(name, parts, moments[name], 2e-4)


def test_a_step_is_adams_for_given_gradients():
    """The gradients of torch's own iteration, taken from its moments, through float64 Adam: the formula in words."""
    first, second = Trained(FusedAdam, 1), Trained(FusedAdam, 2)
    for name, rate in stage_rates(0.1).items():
        g0 = first.moments[f"{name}.m"].double() / 0.1
        g1 = (second.moments[f"{name}.m"].double() - 0.9 * g0 * 0.1) / 0.1
        m, v = 0.09 * g0 + 0.1 * g1, 0.000999 * g0**2 + 0.001 * g1**2
        step = rate * (m / (1 - 0.9**2)) / ((v / (1 - 0.999**2)).sqrt() + 1e-15)
        certain = (second.moments[f"{name}.v"].double() / v.clamp_min(1e-300) - 1).abs() < 1e-3
        assert certain.double().mean() > 0.5
        actual = (first.parameters[name] - second.parameters[name]).double()
        assert_close(name, actual * certain, step * certain, 2e-3)


def stage_rates(progress):
    rates = {"quats": 2e-3, "log_scales": 2e-2, "logits": 4.5e-2, "sh0": 7.5e-3, "shn": 7.5e-4}
    return {"means": 1.6e-3 * EXTENT * 0.01**progress} | rates


@pytest.fixture
def _keep_thread_count():
    before = numba.get_num_threads()
    yield
    numba.set_num_threads(before)


@pytest.mark.usefixtures("_keep_thread_count")
def test_the_number_of_threads_does_not_change_a_bit():
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("numba has one thread here; comparing thread counts needs 2")
    found = []
    for threads in (1, 2):
        numba.set_num_threads(threads)
        found.append(Trained(FusedAdam, 4))
    one, two = found
    for name in one.moments:
        assert torch.equal(one.moments[name], two.moments[name]), name
    for name in one.parameters:
        assert torch.equal(one.parameters[name], two.parameters[name]), name
    assert torch.equal(one.fit.error, two.fit.error)


def test_an_optimiser_taken_up_from_a_checkpoint_goes_on_to_the_bit():
    """And either kind takes up the other's."""
    fit = Trained(FusedAdam, 4).fit
    tensors = fit.tensors()
    moments = {k.removeprefix("adam."): v for k, v in tensors.items() if k.startswith("adam.")}
    saved = {k: tensors[k] for k in fit.adam.parameters}
    again = FusedAdam(saved, EXTENT, moments)
    cameras = stage._Views(views_of(), SpaceConfig(), "cpu")
    for adam in (fit.adam, again):
        error = torch.zeros(len(SCENE.means))
        cameras.iterate(stage._Fit(adam, error, fit.psnr, fit.generator, fit.draws), 1, 3, 0.7)
    for name, p in fit.adam.parameters.items():
        assert torch.equal(p, again.parameters[name])
    other = ParameterAdam(saved, EXTENT, {k: v.clone() for k, v in moments.items()})
    take_step(other, gradients(other.parameters, 0))
    assert other.moments()["step"] == 5
    back = FusedAdam({k: v.detach() for k, v in other.parameters.items()}, EXTENT, other.moments())
    assert torch.equal(back.moments()["shn.v"], other.moments()["shn.v"])
