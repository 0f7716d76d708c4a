"""Sensors from options and YAML, and what is wrong with them in one line."""

from types import SimpleNamespace

import numpy as np
import pytest

from tg4mm.core.errors import Tg4mmError
from tg4mm.show.measure import locate
from tg4mm.show.measure.sensors import STILL, Sensor, parse_sensor, read_sensors


@pytest.mark.parametrize(
    ("text", "sensor"),
    [
        ("all", Sensor("all", "all")),
        ("tip=box:0,0,1,.5,1,2", Sensor("tip", "box", (0, 0, 1, 0.5, 1, 2))),
        ("tip=sphere:-1,2e-1,0,.3", Sensor("tip", "sphere", (-1, 0.2, 0, 0.3))),
        ("nose=pixel:cam_00,300,420,14", Sensor("nose", "pixel", (300, 420, 14), "cam_00")),
        ("nose=pixel:cam_00,300,420", Sensor("nose", "pixel", (300, 420, 4), "cam_00")),
        ("a=cluster:2", Sensor("a", "cluster", (2,))),
        ("a=cluster:still", Sensor("a", "cluster", (STILL,))),
    ],
)
def test_an_option_is_a_sensor_and_its_text_is_the_option_again(text, sensor):
    assert parse_sensor(text) == sensor
    assert parse_sensor(str(sensor)) == sensor


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("tip=cube:1,2,3", "'cube' is no region"),
        ("tip=sphere:1,2,x,3", "'x' is not a number"),
        ("tip=sphere:1,2,3", "expected sphere:X,Y,Z,RADIUS"),
        ("tip=sphere:1,2,3,-1", "radius -1 must be above 0"),
        ("tip=sphere:1,2,3,1e300", "1e+300 is beyond 1e+09"),
        ("tip=sphere:1,2,nan,1", "expected sphere"),
        ("tip=box:1,0,0,0,1,1", "each of X0, Y0, Z0 must be below X1, Y1, Z1"),
        ("../tip=all", "sensor name '../tip'"),
        ("tip=pixel:", "expected pixel:CAMERA,X,Y"),
        ("tip=cluster:1.5", "cluster number 1.5 must be a whole number"),
        ("", "is no region"),
    ],
)
def test_what_is_none_is_refused_with_its_value(text, words):
    with pytest.raises(Tg4mmError) as caught:
        parse_sensor(text)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_of_sensors(tmp_path):
    file = tmp_path / "sensors.yaml"
    file.write_text(
        "sensors:\n- {name: tip, sphere: [0, 0, 1.2, 0.1]}\n- {name: wall, pixel: [cam_00, 320, 96, 12]}\n"
        "- {name: rest, cluster: still}\n- {name: whole, all: true}\n"
    )
    shown = "tip=sphere:0,0,1.2,0.1 wall=pixel:cam_00,320,96,12 rest=cluster:still whole=all"
    assert " ".join(map(str, read_sensors(file))) == shown


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("sensors: 3", "expected a list"),
        ("- {name: tip}", "has 0 regions"),
        ("- {name: tip, sphere: [1, 2, 3, 4], colour: red}", "'colour' is unknown"),
        ("- [1, 2]", "is no mapping"),
        ("- {name: a, all: true}\n- {name: A, all: true}", "two sensors are called 'A'"),
        ("- {name: tip, sphere: [1, 2", "is not YAML"),
        ("- !!python/object/apply:os.getcwd []", "tag"),
        ('- {name: tip, all: !!bool "foo"}', "tag"),
        (f"- {'[' * 3000}{']' * 3000}", "nested more than"),
        (f"- [{', '.join(['long'] * 3000)}]", "… is no mapping"),
    ],
)
def test_a_file_that_is_wrong_says_where(tmp_path, text, words):
    file = tmp_path / "sensors.yaml"
    file.write_text(text)
    with pytest.raises(Tg4mmError, match=words) as caught:
        read_sensors(file)
    assert str(file) in str(caught.value)


def test_large_haze_in_front_of_a_region_does_not_hide_its_surface(monkeypatch):
    """A hundred Gaussians of the surface at depth 2 lie in the region; one large one in front lies mostly outside."""
    inside, whole = np.full(101, 9.0), np.full(101, 10.0)
    inside[-1], whole[-1] = 400.0, 2400.0
    monkeypatch.setattr(locate, "blend_sum", lambda view, maps: np.stack([inside, whole, inside], -1))
    means = np.zeros((101, 3))
    means[:, 2] = np.append(np.full(100, 2.0), 0.5)
    frames = SimpleNamespace(name="cam", viewmat=np.eye(4), K=np.diag([60.0, 60.0, 1.0]))
    view = SimpleNamespace(frames=frames, mean=np.zeros((48, 64, 3)), view=None)
    scene = SimpleNamespace(
        observations=SimpleNamespace(frames=[frames], size=(64, 48)), views=[view], means=means
    )
    found = locate._of_pixel(parse_sensor("a=pixel:cam,32,24,9"), scene)
    assert (found[:100] == 1).all()
    assert found[100] == 0
