"""The Jacobian as a list of contributions, on a torch device: the same products as the kernels'."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.fit.motion.scenes import COLUMNS, SCENES, motion_of, view_of
from tests.fit.rasterize.oracle import assert_close, make_scene
from tests.helpers.cuda import needs_cuda
from tg4mm.fit.motion.jacobian import contributions
from tg4mm.fit.motion.jacobian.contributions import DeviceViewJacobian, device_view_jacobian
from tg4mm.fit.motion.jacobian.packed import DOF
from tg4mm.fit.motion.jacobian.view import ViewJacobian

EVERY_SCENE = {
    **SCENES,
    "light spent": make_scene(19, n=250, spread=0.3, scale=(0.1, 0.4), opacity=(0.3, 0.95)),
    "nearly opaque": make_scene(6, opacity=(0.9995, 1.0), scale=(0.05, 0.5)),
}
EXACT, HALF = 2e-5, 2e-3  # of the largest entry: float32 sums in another order; entries of 11 bits


def shown(view: DeviceViewJacobian, motion: np.ndarray) -> torch.Tensor:
    return view.jvp(torch.from_numpy(motion).to(view.means.device)).cpu()


def gathered(view: ViewJacobian | DeviceViewJacobian, picture: np.ndarray, n: int) -> torch.Tensor:
    if isinstance(view, ViewJacobian):
        total = np.zeros((n, DOF), np.float32)
        view.vjp(picture[None], total[None])
        return torch.from_numpy(total)
    place = view.means.device
    there = torch.zeros(n, DOF, device=place)
    view.vjp(torch.from_numpy(picture).to(place), there)
    return there.cpu()


def compare(name: str, columns: str, where: str, storage: torch.dtype, tolerance: float) -> None:
    """`jvp` and `vjp` of both kinds of view, and that a thousandth more would be noticed at EXACT."""
    scene = EVERY_SCENE[name]
    view, motion = view_of(scene), motion_of(scene, COLUMNS[columns])
    other = device_view_jacobian(view, where, storage)
    expected = torch.from_numpy(view.jvp(motion[None])[0])
    assert expected.abs().max() > 0.1
    assert_close("jvp", shown(other, motion), expected, tolerance)
    shape = (scene.height, scene.width, 3)
    picture = np.random.default_rng(1).normal(size=shape).astype(np.float32)
    back = gathered(view, picture, len(motion))
    assert_close("vjp", gathered(other, picture, len(motion)), back, tolerance)
    with pytest.raises(AssertionError):
        assert_close("jvp", 1.001 * expected, expected, EXACT)


@pytest.mark.parametrize("name", EVERY_SCENE)
@pytest.mark.parametrize("columns", COLUMNS)
def test_its_products_are_the_kernels(name: str, columns: str) -> None:
    compare(name, columns, "cpu", torch.float32, EXACT)


@pytest.mark.parametrize("name", EVERY_SCENE)
def test_half_precision_storage_costs_no_more_than_its_digits(name: str) -> None:
    compare(name, "both", "cpu", torch.float16, HALF)


@needs_cuda
@pytest.mark.parametrize(("storage", "tolerance"), [(torch.float32, 1e-4), (torch.float16, HALF)])
@pytest.mark.parametrize("name", EVERY_SCENE)
def test_on_cuda_its_products_are_the_kernels(name: str, storage: torch.dtype, tolerance: float) -> None:
    compare(name, "both", "cuda", storage, tolerance)


def test_working_in_parts_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = SCENES["crowded"]
    view, motion = view_of(scene), motion_of(scene, COLUMNS["both"])
    whole = device_view_jacobian(view, "cpu", torch.float32)
    monkeypatch.setattr(contributions, "_AT_ONCE", 1000)  # less than one tile's list
    parts = device_view_jacobian(view, "cpu", torch.float32)
    assert len(parts.pixel) == len(whole.pixel) > 5 * 1000
    assert_close("jvp", shown(parts, motion), shown(whole, motion), 1e-5)
    picture = np.ones((scene.height, scene.width, 3), np.float32)
    assert_close("vjp", gathered(parts, picture, 120), gathered(whole, picture, 120), 1e-5)


def test_a_view_that_sees_nothing_says_nothing() -> None:
    scene = make_scene(0, distance=-20.0)
    view = device_view_jacobian(view_of(scene), "cpu", torch.float16)
    assert len(view.pixel) == 0
    assert not shown(view, motion_of(scene, COLUMNS["both"])).any()
    assert not gathered(view, np.ones((scene.height, scene.width, 3), np.float32), 40).any()
