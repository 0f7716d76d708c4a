"""Drawn regions as sensors, and a scale that is marked in the picture."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.look import found
from tests.show.measure.filmed import of_parts, run_of, sine
from tg4mm.capture.look.record import to_record
from tg4mm.cli import main
from tg4mm.core.regions import Scale
from tg4mm.show.measure import MeasureError, measure, parse_sensor, prepare

CORNERS = ((10.0, 12.0), (38.0, 8.0), (40.0, 42.0), (9.0, 36.0))


@pytest.fixture(scope="module")
def flat(tmp_path_factory):
    sway = sine(4.0, [0.02, 0.0, 0.01])
    move = of_parts(post=sway, ball=sway)
    return run_of(tmp_path_factory.mktemp("flat"), move, n_views=1, n_timesteps=40, kind="flat")


def test_a_tilted_planes_motion_is_the_pictures_by_its_slope(flat):
    scene, sensor, scale = prepare(flat, keep=False), parse_sensor("all"), Scale((), CORNERS, (0.3, 0.2))
    plain, found = (measure(scene, [sensor], scale=s) for s in (None, scale))
    body, frames = plain["all"].body, scene.observations.frames[0]
    x, y, depth = frames.K @ (frames.viewmat[:3, :3] @ body.centre + frames.viewmat[:3, 3])
    slope = scale.metres_at((x / depth, y / depth)) * [[1, -1], [-1, 1]]  # right and up
    pixels = plain["all"].displacement * plain["all"].px_per_unit
    metres = found["all"].displacement * found.unit_scale_m
    size = np.abs(metres).max()
    np.testing.assert_allclose(metres, pixels @ slope.T, atol=2e-3 * size)
    assert (found["all"].deviation > 0).all()


def test_before_one_fixed_camera_what_a_region_showed_is_a_sensor_too(tmp_path):
    """In a scene with depth: after its clusters a disc at the region."""
    sway = sine(4.0, [0.02, 0.0, 0.01])
    run = run_of(tmp_path, of_parts(post=sway, ball=sway), n_views=1, n_timesteps=40)
    region = np.zeros((3, 3), bool)
    region[1, 1] = True
    seen = found(hz=4.0)
    line = replace(seen.lines[0], centre_px=(24.0, 24.0), cells=region, region=region)
    seen = replace(seen, lines=(line,), movers=(), moves_by_itself=region & ~region, size=(48, 48))
    run.record("look", to_record(seen))
    measured = measure(run)
    names = [s.name for s in measured.sensors]
    assert names[-1] == "4 Hz"
    assert "all" in names
    assert measured.reference == names[0] != "4 Hz"
    assert measured["4 Hz"].sensor.values[:2] == (24.0, 24.0)
    assert measured["4 Hz"].spectrum.peaks[0].frequency_hz == pytest.approx(4.0, abs=0.05)


def regions(path, size, **more):
    entries = [{"name": "part", "box": [12, 10, 36, 38]}]
    values = {"format": "tg4mm", "kind": "regions", "version": 1, "size": list(size), "regions": entries}
    path.write_text(json.dumps(values | more))
    return str(path)


def test_a_file_of_regions_is_measured_in_millimetres(flat, tmp_path):
    size = prepare(flat, keep=False).observations.size
    file = regions(tmp_path / "r.json", size, lengths=[{"points": [[5, 5], [35, 5]], "metres": 0.06}])
    out = tmp_path / "out"
    assert main(["measure", str(flat.path), "--regions", file, "--no-animate", "--out", str(out)]) == 0
    content = json.loads((out / "measure.json").read_text())
    assert content["printed_unit"] == "mm"
    assert content["unit_scale_m"] / content["sensors"][0]["px_per_unit"] == pytest.approx(0.002, rel=0.05)
    assert [s["name"] for s in content["sensors"]] == ["part"]
    assert "% by its marks" in content["notes"][-1]


def test_regions_of_another_picture_are_refused_and_nothing_is_written(flat, tmp_path, capsys):
    file = regions(tmp_path / "r.json", (64, 99))
    assert main(["measure", str(flat.path), "--regions", file, "--out", str(tmp_path / "out")]) == 2
    assert "regions are of pictures of 64×99 pixels" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_scale_in_space_takes_its_depth_from_the_model(tmp_path):
    run = run_of(tmp_path, of_parts(post=sine(4.0, [0.02, 0, 0])), n_views=1, n_timesteps=30, kind="tripod")
    scene = prepare(run, keep=False)
    own = scene.capture.unit_scale_m
    frames, means = scene.views[0].frames, scene.means
    seen = np.flatnonzero(scene.seen > np.quantile(scene.seen, 0.9))
    x = (means[seen] @ frames.viewmat[:3, :3].T + frames.viewmat[:3, 3]) @ frames.K.T
    at = x[:, :2] / x[:, 2:]
    a, b = int(at[:, 1].argmin()), int(at[:, 1].argmax())
    metres = float(np.linalg.norm(means[seen[a]] - means[seen[b]])) * (own or 0.1)
    found = measure(scene, [parse_sensor("all")], scale=Scale(((tuple(at[a]), tuple(at[b]), metres),)))
    assert found.unit_scale_m == pytest.approx(own or 0.1, rel=0.1)
    with pytest.raises(MeasureError, match="a rectangle gives the scale of flat captures only"):
        measure(scene, [parse_sensor("all")], scale=Scale((), CORNERS, (0.3, 0.2)))
