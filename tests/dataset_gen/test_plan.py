"""Every file of the set comes from exactly one shot, and equal states are rendered once."""

import pytest

from dataset_gen.plan import shots
from dataset_gen.run import scene_of
from dataset_gen.settings import Settings


def plan(**changes):
    settings = Settings(**changes)
    return settings, shots(settings, scene_of(settings).motion(settings.fps))


def test_the_demo_set_costs_145_renders():
    _, every = plan()
    assert sum(shot.split == "train" for shot in every) == 90
    assert sum(shot.split == "test" for shot in every) == 55
    assert sum(len(shot.images) for shot in every) == 30 * 30 + 30 * 5 * 5


def test_every_file_is_named_once():
    _, every = plan(timesteps=12, views=3, test_views=2, alphas=(5, 100), truth="all", frequency=3.7)
    names = [name for shot in every for name in (*shot.images, *shot.truth)]
    assert len(set(names)) == len(names)
    expected = {f"{t:03d}/train/r_{i:03d}.png" for t in range(12) for i in range(3)}
    expected |= {f"truth/train/{t:03d}/r_{i:03d}.exr" for t in range(12) for i in range(3)}
    for t in range(12):
        for i in (0, 5):
            expected |= {f"{t:03d}/test/r_{i:03d}.png", f"truth/test/{t:03d}/r_{i:03d}.exr"}
            expected |= {f"magnified/x{a:03d}/{t:03d}/test/r_{i:03d}.png" for a in (5, 100)}
    assert set(names) == expected


@pytest.mark.parametrize(
    ("truth", "splits"), [("none", set()), ("test", {"test"}), ("all", {"test", "train"})]
)
def test_truth_is_planned_for_the_splits_asked_for(truth, splits):
    _, every = plan(truth=truth)
    assert {shot.split for shot in every if shot.truth} == splits


def test_the_rest_state_comes_first_and_serves_every_alpha():
    _, every = plan()
    assert every[0].state.at_rest
    rest = [shot for shot in every if shot.split == "test" and shot.state.at_rest]
    assert len(rest) == 5
    assert "magnified/x050/000/test/r_000.png" in rest[0].images
