"""Every file of the set comes from exactly one shot, and equal states are rendered once."""

from dataset_gen.options import parser, request_from
from dataset_gen.plan import RESEEDED, shots
from dataset_gen.prepare import builtin_bodies, motion_of


def plan(arguments=""):
    settings = request_from(parser().parse_args(["mic", *arguments.split(), "--out", "x"])).sets[0]
    every = shots(settings, motion_of(settings, builtin_bodies("mic")))
    return settings, [s for s in every if not s.seed_offset], [s for s in every if s.seed_offset]


def test_the_demo_set_costs_155_renders_and_7_for_the_noise():
    _, every, again = plan()
    assert sum(shot.split == "train" for shot in every) == 90
    assert sum(shot.split == "test" for shot in every) == 65
    assert sum(len(shot.pictures) for shot in every) == 30 * 30 + 30 * 5 * 6
    assert len(again) == 7  # α = 0, the five, and rest


def test_the_noise_is_measured_where_the_motion_is_largest():
    _, _, again = plan()
    assert {picture.alpha for shot in again for picture in shot.pictures} == {-1, 0, 5, 10, 20, 50, 100}
    assert all(picture.path.startswith(RESEEDED) for shot in again for picture in shot.pictures)
    assert [shot.state.at_rest for shot in again].count(True) == 1  # what "nothing moves" is scored by
