"""The deformation field: nothing at first, motion after training, and settings that will not do."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from tests.research.bench.conftest import MODAL
from tg4mm.core.errors import Tg4mmError
from tg4mm.research.bench.measure import Plan
from tg4mm.research.bench.methods.tracking import HexPlane, checked_settings, tracking
from tg4mm.research.bench.sets import open_set
from tg4mm.run import Run


def test_nothing_moves_before_training_and_every_parameter_gets_a_gradient() -> None:
    field = HexPlane(4, 2, 5, 3, 8, seed=0)
    points = torch.rand(20, 3) * 2 - 1
    assert not field(points, 0.3).any()
    torch.nn.init.normal_(field.head.weight)
    field(points, 0.3).square().sum().backward()
    assert all(p.grad is not None and p.grad.any() for p in field.parameters())


def test_before_training_time_changes_nothing_and_then_it_does() -> None:
    field = HexPlane(4, 1, 5, 3, 8, seed=0)
    torch.nn.init.normal_(field.head.weight)
    points = torch.rand(20, 3) * 2 - 1
    assert torch.equal(field(points, -1.0), field(points, 0.5))
    with torch.no_grad():
        field.planes[2][:, :, 0] = 2.0  # of x and t: the first timestep
    assert not torch.allclose(field(points, -1.0), field(points, 0.5))


def test_roughness_is_that_of_the_planes() -> None:
    field = HexPlane(3, 1, 4, 2, 8, seed=0)
    with torch.no_grad():
        for plane in field.planes:
            plane.fill_(1.0)
    assert [v.item() for v in field.roughness()] == [0.0, 0.0]
    with torch.no_grad():
        field.planes[2][:, :, 1] = 2.0
    space, time = field.roughness()
    assert space.item() == 0.0
    assert time.item() > 0.0


@pytest.mark.slow
def test_training_finds_the_motion_and_a_second_call_does_not_train(data: Path, tmp_path: Path) -> None:
    method = tracking(MODAL, {"tracking.iterations": "400", "tracking.resolution": "16"})
    first = method.fit(open_set(data, "sway"), tmp_path, Plan(alphas=(5.0,)))
    assert first["displacement"]["per_frequency"][0]["mac"] > 0.3
    assert first["rows"]["5"]["tracking"]["change_gain"] > 0.2
    assert Run.open(tmp_path / "run").log()["motion"]["iterations"] == 400
    given = {"tracking.iterations": "400", "tracking.resolution": "16"}
    assert method.training.overrides == {**MODAL, **given}
    assert method.fit(open_set(data, "sway"), tmp_path, Plan(alphas=(5.0,))) == first


@pytest.mark.parametrize(
    ("name", "value"), [("colour", "1"), ("iterations", "0"), ("mlp_rate", "fast"), ("seed", "-1")]
)
def test_settings_that_will_not_do(name: str, value: str) -> None:
    with pytest.raises(Tg4mmError, match=f"tracking.{name}"):
        checked_settings({f"tracking.{name}": value})
