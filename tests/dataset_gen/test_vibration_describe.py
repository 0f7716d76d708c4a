"""Motion descriptions: what a person writes, its round trip, and every mistake as one line."""

import json

import pytest

from dataset_gen.errors import GenerateError
from dataset_gen.vibration import DampedSinusoid, MotionDescription, Ramp, read_motion
from dataset_gen.vibration.describe import KINDS
from dataset_gen.vibration.structures import BallRegion

COMMON = {"frequency": 5, "amplitude": 0.005}
EVERY_KIND = {
    "translate": {"direction": [1, 0, 0]},
    "rock": {"pivot": [0, 0, 0], "axis": [0, 1, 0]},
    "twist": {"pivot": [0, 0, 0], "axis": [0, 1, 0], "length": 2},
    "bending": {"base": [0, 0, 0], "tip": [0, 0, 1], "direction": [1, 0, 0], "order": 2},
    "membrane": {"centre": [0, 0, 0], "normal": [0, 0, 1], "radius": 0.5, "nodes": [1, 2], "thickness": 0.1},
    "plate": {"centre": [0, 0, 0], "normal": [0, 0, 1], "x": [1, 0, 0], "size": [1, 2], "nodes": [2, 3]},
    "wave": {
        "direction": [1, 0, 0], "wavelength": 0.3, "polarisation": "rayleigh", "decay_length": 1, "level": -0.2,
        "region": {"centre": [0, 0, 0], "radius": 2},
    },
    "jiggle": {"held": -0.5, "reach": 0.3, "direction": "random", "seed": 3},
    "group": {"group": "lid", "direction": [0, 0, 1]},
    "drift": {"direction": [0, 0, 1]},
}  # fmt: skip
SWAY = {"name": "sway", "kind": "bending", **COMMON, **EVERY_KIND["bending"]}


def mode(kind, **changes):
    common = {"rate": 0.1} if kind == "drift" else COMMON
    return {"name": kind, "kind": kind, **common, **EVERY_KIND[kind], **changes}


def read(tmp_path, text, name="motion.yaml"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return read_motion(path)


def message(data):
    with pytest.raises(GenerateError) as caught:
        MotionDescription.from_json(data, "x.yaml")
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith("x.yaml: ")
    return text.removeprefix("x.yaml: ")


def test_every_kind_reads_and_comes_back_the_same():
    assert set(EVERY_KIND) == set(KINDS)
    modes = [mode("bending", phase=-30, phases={"leaf_*": 40}, decay=1.5, parts=["a", "b*"], magnified=False)]
    modes += [mode(kind) for kind in EVERY_KIND if kind != "bending"]
    description = MotionDescription.from_json({"modes": modes})
    again = MotionDescription.from_json(json.loads(json.dumps(description.to_json())))
    assert again == description
    assert hash(again) == hash(description)
    assert [m.kind for m in again.modes][1:] == [kind for kind in EVERY_KIND if kind != "bending"]
    first = again.modes[0]
    assert first.law == DampedSinusoid(5.0, 1.5)
    assert (first.phase, first.phases) == (-30.0, (("leaf_*", 40.0),))
    assert (first.parts, first.magnified) == (("a", "b*"), False)
    assert again.modes[-1].law == Ramp()
    assert again.modes[-1].amplitude == 0.1
    assert again.modes[6].field.region == BallRegion((0.0, 0.0, 0.0), 2.0)


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("m.json", "{", "line 1 is not JSON: Expecting property name"),
        ("m.json", '{"modes": [], "modes": []}', "key 'modes' is there twice"),
        ("m.yaml", "modes: [", " is not YAML: "),
        ("m.yaml", "modes:\n - a\n  b: 1\n", "line 3 is not YAML: "),
        ("m.yaml", "modes:\n - {name: a, name: b}", "key 'name' is there twice"),
        ("m.yaml", "1: 2", "key 1 is not text"),
        ("m.yaml", "modes: &x [*x]", "is not YAML: found unconstructable recursive node"),
        ("m.yaml", "modes: !!python/object:os.system {}", "has the tag tag:yaml.org,2002:python/object:os"),
        ("m.yaml", "modes: [{frequency: !!bool foo}]", "line 1 has the tag tag:yaml.org,2002:bool"),
        ("m.yaml", "[" * 60000, "is nested more than 64 deep"),
        ("m.yaml", "# " + "x" * (64 << 10), "has more than 65536 bytes"),
        ("m.yaml", "", "None is not a mapping of keys to values"),
        ("m.json", "[" * 100000, "is nested more than 64 deep"),
    ],
)
def test_text_that_cannot_be_read_is_one_line(tmp_path, name, text, expected):
    if name.endswith("yaml"):
        pytest.importorskip("yaml")
    with pytest.raises(GenerateError) as caught:
        read(tmp_path, text, name)
    assert expected in str(caught.value)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_cannot_be_read_are_one_line(tmp_path):
    with pytest.raises(GenerateError, match=r"nowhere\.yaml cannot be read: No such file"):
        read_motion(tmp_path / "nowhere.yaml")
    with pytest.raises(GenerateError, match="cannot be read: Is a directory"):
        read_motion(tmp_path)
    (tmp_path / "latin.yaml").write_bytes(b"# \xe9")
    with pytest.raises(GenerateError, match=r"latin\.yaml: is not UTF-8 text"):
        read_motion(tmp_path / "latin.yaml")
    (tmp_path / "large.json").write_bytes(b" " * (2 << 20))
    with pytest.raises(GenerateError, match=r"large\.json: has more than 1048576 bytes"):
        read_motion(tmp_path / "large.json")


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        ([], "[] is not a mapping of keys to values"),
        ({}, "modes None is not a list"),
        ({"modes": {}}, "modes {} is not a list"),
        ({"modes": []}, "modes is empty: nothing would move"),
        ({"modes": [SWAY], "fps": 30}, "key 'fps' is not one of a motion description: modes"),
        ({"modes": ["sway"]}, "mode 1: 'sway' is not a mapping of keys to values"),
        ({"modes": [SWAY, {"kind": "rock"}]}, "mode 2: name is missing"),
        ({"modes": [SWAY, SWAY]}, "two modes have the name 'sway'"),
        ({"modes": [mode("drift")]}, "mode 'drift' is the first, which needs a frequency; its kind is drift"),
    ],
)
def test_a_broken_frame_is_one_line(data, expected):
    assert message(data) == expected


@pytest.mark.parametrize(
    ("kind", "change", "expected"),
    [
        ("bending", {"kind": "bend"}, "kind 'bend' is not one of translate, rock, twist, bending, "),
        ("bending", {"kind": None}, "kind is missing"),
        ("bending", {"freq": 3}, "key 'freq' is not one of a mode of kind bending: name, kind, parts, "),
        ("drift", {"frequency": 3}, "key 'frequency' is not one of a mode of kind drift: "),
        ("bending", {"frequency": None}, "frequency is missing"),
        ("bending", {"frequency": 0}, "frequency: 0 is not a positive number"),
        ("bending", {"frequency": "5e-3"}, "frequency: '5e-3' is text, not a number (YAML writes"),
        ("bending", {"frequency": float("nan")}, "frequency: nan is not a finite number"),
        ("bending", {"amplitude": 1e-300}, "amplitude: 1e-300 is not a positive number ≥ 1e-9"),
        ("bending", {"amplitude": None}, "amplitude is missing: amplitude (scene units) or amplitude_px"),
        ("bending", {"amplitude_px": 2}, "amplitude 0.005 and amplitude_px 2 cannot both be given"),
        ("bending", {"phases": 3}, "phases: 3 is neither 'random' nor a mapping of parts to degrees"),
        ("bending", {"parts": []}, "parts: [] is not a list of names"),
        ("bending", {"magnified": "no"}, "magnified: 'no' is neither true nor false"),
        ("bending", {"base": None}, "base is missing: a mode of kind bending needs it"),
        ("bending", {"base": [0, 0]}, "base: [0, 0] is not a list of 3 numbers"),
        ("bending", {"direction": [0, 0, 0]}, "direction: [0, 0, 0] has no direction: it is zero"),
        ("bending", {"direction": [0, 0, 1]}, "direction (0.0, 0.0, 1.0) is parallel to it"),
        ("bending", {"tip": [0, 0, 0]}, "tip (0.0, 0.0, 0.0) is the base: the beam has no length"),
        ("bending", {"order": 4}, "order: 4 is not a whole number in 1 … 3"),
        ("membrane", {"nodes": [0, 0]}, "nodes: 0 is not a whole number in 1 … 20"),
        ("membrane", {"nodes": 3}, "nodes: 3 is not a pair of whole numbers"),
        ("membrane", {"x": [0, 0, 2]}, "x (0.0, 0.0, 2.0) is parallel to it"),
        ("plate", {"size": [1]}, "size: [1] is not a list of 2 numbers"),
        ("wave", {"polarisation": "up"}, "polarisation: 'up' is neither three numbers nor 'rayleigh'"),
        ("wave", {"direction": [1, 0, 1]}, "direction (1.0, 0.0, 1.0) of a Rayleigh wave must lie in the"),
        ("wave", {"region": {"centre": [0, 0, 0]}}, "region: {'centre': [0, 0, 0]} is not of the form {"),
    ],
)
def test_every_mistake_in_a_mode_is_one_line_with_mode_key_and_value(kind, change, expected):
    text = message({"modes": [SWAY | {"name": "main"}, mode(kind) | change]})
    assert text.startswith(f"mode '{kind}': ")
    assert expected in text
