"""Regions drawn on a picture: the file is what was written, the scale is the plane's own, bad input is one line."""

import json

import numpy as np
import pytest

from tg4mm.cli import main
from tg4mm.core.errors import RegionError
from tg4mm.core.regions import Region, Regions, Scale, read_regions, write_regions

SIZE = (480, 272)
A_BOX = {"name": "a", "box": [10, 10, 60, 50]}
SQUARE = {"corners": [[0, 0], [90, 0], [90, 90], [0, 90]], "metres": [1, 1]}
LENGTH = {"points": [[0, 0], [90, 0]]}


def _far(x, y, tilt):
    """The pixel of a place (metres) on a plane turned about the picture's vertical, 2 m away."""
    depth = 2 + x * np.sin(tilt)
    return np.array([240 + 500 * x * np.cos(tilt) / depth, 136 + 500 * y / depth])


@pytest.mark.parametrize("tilt", [0.1, 0.7, -0.9])
def test_a_rectangle_tells_metres_wherever_on_its_tilted_plane(tilt):
    corners = [(-0.2, -0.1), (0.2, -0.1), (0.2, 0.1), (-0.2, 0.1)]
    scale = Scale((), tuple(tuple(_far(*c, tilt)) for c in corners), (0.4, 0.2))
    for place in ((0.0, 0.0), (0.15, -0.2), (-0.3, 0.1)):
        step = 1e-5 * np.eye(2)
        moved = [(_far(*(place + s), tilt) - _far(*(place - s), tilt)) / 2e-5 for s in step]
        metres = scale.metres_at(tuple(_far(*place, tilt))) @ np.stack(moved, 1)
        np.testing.assert_allclose(metres, np.eye(2), atol=1e-6)


def test_a_file_read_back_is_what_was_written(tmp_path):
    box, point = Region("a", "box", (10, 20, 60, 50)), Region("b", "point", (100, 100, 8), "cam_00")
    polygon = Region("c", "polygon", (10, 100, 60, 100, 30, 150))
    regions = Regions(SIZE, (box, point, polygon), Scale((((0, 0), (100, 0), 0.2),)))
    write_regions(tmp_path / "r.json", regions)
    assert read_regions(tmp_path / "r.json") == regions
    assert regions["a"].mask(SIZE).sum() == 50 * 30
    assert regions["c"].centre == pytest.approx((100 / 3, 350 / 3))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"kind": "look"}, "expected 'regions'"),
        ({"size": [480]}, "size: 1 given, expected 2"),
        ({"regions": [{"name": "a"}]}, "has 0 shapes"),
        ({"scale": {"metres": 1}}, "unknown entry 'scale', expected format, kind"),
        ({"regions": [A_BOX | {"boxes": []}]}, "region 'a': unknown entry 'boxes'"),
        ({"regions": [{"name": "a", "box": [1, 2, 3]}]}, "a box of 3 numbers"),
        ({"regions": [{"name": "a", "box": [60, 10, 10, 50]}]}, "has no area"),
        ({"regions": [{"name": "a", "box": [500, 10, 600, 50]}]}, "outside the picture of 480×272"),
        ({"regions": [{"name": "a", "polygon": [[1, 1], [9, 9], [20, 20]]}]}, "on one line"),
        ({"regions": [{"name": "a", "point": [20, 20, 0]}]}, "radius 0"),
        ({"regions": [A_BOX, A_BOX | {"name": "A"}]}, "two regions are called"),
        ({"lengths": [{"points": [[5, 5], [5, 5]], "metres": 1}]}, "ends are one point"),
        ({"lengths": [{"points": [[0, 0], [9, 0]], "metres": -1}]}, "expected a finite number above 0"),
        ({"lengths": [{"points": [[0, 0], [k, 90]], "metres": k} for k in (1, 2)]}, "two lengths disagree"),
        ({"rectangle": SQUARE | {"corners": [[0, 0], [0, 9], [9, 9], [9, 0]]}}, "upper left, upper right"),
        ({"rectangle": SQUARE, "lengths": [LENGTH | {"metres": 1.5}]}, "times what the rectangle says"),
    ],
)
def test_what_cannot_be_is_one_line_with_the_files_name(tmp_path, changes, said):
    path = tmp_path / "r.json"
    whole = {"format": "tg4mm", "kind": "regions", "version": 1, "size": list(SIZE), "regions": [A_BOX]}
    path.write_text(json.dumps(whole | changes))
    with pytest.raises(RegionError) as raised:
        read_regions(path)
    assert said in str(raised.value)
    assert str(raised.value).startswith(f"{path}: ")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (["--only", "a"], "give --regions FILE"),
        (["--only", "b", "--regions", "r.json"], "no region 'b'; there are: a"),
        (["--regions", "gone.json"], "gone.json: cannot be read"),
    ],
)
def test_process_refuses_regions_that_are_not_there(tmp_path, monkeypatch, capsys, asked, said):
    pytest.importorskip("torch")
    monkeypatch.chdir(tmp_path)
    write_regions(tmp_path / "r.json", Regions(SIZE, (Region("a", "box", (10, 20, 60, 50)),)))
    assert main(["process", "film.mp4", "--out", "out", *asked]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
