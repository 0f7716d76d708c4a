"""Splat files that are refused: one line with file and value, and nothing large allocated."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from tests.core.splatfile.conftest import NAMES, plain_ply, random_splat
from tg4mm.core.errors import SplatFileError
from tg4mm.core.splatfile import read_splat, write_splat


@pytest.fixture
def refused(tmp_path):
    def check(data, *parts):
        path = tmp_path / "bad.ply"
        path.write_bytes(data)
        with pytest.raises(SplatFileError) as caught:
            read_splat(path)
        message = str(caught.value)
        assert message.startswith(f"{path}: ")
        assert "\n" not in message
        for part in parts:
            assert part in message, message

    return check


@pytest.fixture
def good(tmp_path):
    """The bytes of a file with two modes."""
    write_splat(tmp_path / "good.ply", random_splat())
    return (tmp_path / "good.ply").read_bytes()


def header_edit(data, change):
    """The file with another `comment tg4mm`."""
    line = re.search(rb"comment tg4mm (.*)\n", data)
    values = json.loads(line[1])
    change(values)
    return data.replace(line[0], b"comment tg4mm " + json.dumps(values).encode() + b"\n")


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(SplatFileError, match=r"none\.ply: cannot be read: No such file"):
        read_splat(tmp_path / "none.ply")
    with pytest.raises(SplatFileError, match="cannot be read: Is a directory"):
        read_splat(tmp_path)


@pytest.mark.parametrize("count", ["6", "4", "99999999999", "999999999999999999"])
def test_wrong_counts(refused, good, count):
    refused(
        good.replace(b"vertex 5", b"vertex " + count.encode()), "bytes, expected", f"for {count} vertices"
    )


@pytest.mark.parametrize("count", ["-5", "5.0", "1e9", "9" * 30, "0x5", "٣"])
def test_counts_that_are_no_counts(refused, good, count):
    refused(good.replace(b"vertex 5", b"vertex " + count.encode()), "no usable count")


@pytest.mark.parametrize("form", ["text 1.0", "binary_little_endian 2.0", ""])
def test_other_formats(refused, form):
    refused(plain_ply(head=form), form or "no format line", "expected format binary_little_endian")


@pytest.mark.parametrize(
    ("data", "part"),
    [
        (b"", "is not a PLY"),
        (b"plyx\nend_header\n", "is not a PLY"),
        (b"\x89PNG\r\n\x1a\n" + bytes(99), "is not a PLY"),
        (b"ply\nend_header\n", "has no format line"),
        (b"ply\nformat binary_little_endian 1.0\nelement vertex 3\n", "no end_header line"),
        (b"ply\n" + b"x" * 3_000_000, "no end_header line"),
        (b"ply\n" + b"comment x\n" * 300_000, "no end_header line"),
        (b"ply\nformat binary_little_endian 1.0\nend_header\n", "header has 0 vertex elements"),
        (
            b"ply\nformat binary_little_endian 1.0\nproperty float x\nend_header\n",
            "'property float x' is not understood",
        ),
        (b"ply\nformat binary_little_endian 1.0\nhello\nend_header\n", "'hello' is not understood"),
    ],
)
def test_headers_that_are_none(refused, data, part):
    refused(data, part)


def test_properties(refused):
    plain = dict.fromkeys(NAMES, ("float", "<f4"))
    without = {name: kind for name, kind in plain.items() if name not in ("scale_2", "rot_0")}
    refused(plain_ply(without), "property scale_2 is missing, 2 in all")
    refused(plain_ply({"packed_position": ("uint", "<u4")}), "is compressed, but has no element chunk")
    refused(plain_ply({**plain, "opacity": ("uchar", "u1")}), "property opacity is a whole number type")
    refused(plain_ply({**plain, "opacity": ("half", "<f2")}), "'property half opacity' has no type")
    refused(plain_ply(after=["property float x"]), "property x appears twice")
    refused(plain_ply(after=["property list uchar int i"]), "element vertex has a list property, i")
    face = ["element face 2", "property list uchar int vertex_indices"]
    refused(plain_ply(after=face), "element face has a list property, vertex_indices")
    refused(plain_ply(after=["element vertex 2", "property float x"]), "header has 2 vertex elements")


@pytest.mark.parametrize(
    "indices", [range(3), range(8), range(46), range(1, 10), [0, 1, 2, 3, 4, 5, 6, 7, 9]]
)
def test_f_rest_counts(refused, indices):
    names = [*NAMES, *(f"f_rest_{i}" for i in indices)]
    refused(
        plain_ply(dict.fromkeys(names, ("float", "<f4"))), f"has {len(indices)} f_rest properties; expected"
    )


def test_frequencies_and_modes_that_do_not_match(refused, good):
    refused(
        header_edit(good, lambda v: v["frequencies_hz"].append(9.0)),
        "24 mode properties; 3 frequencies_hz need 36",
    )
    refused(
        header_edit(good, lambda v: v["frequencies_hz"].pop()), "24 mode properties; 1 frequencies_hz need 12"
    )
    refused(good.replace(b"mode_1_re_x", b"mode_2_re_x"), "24 mode properties; 2 frequencies_hz need 24")


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"format_version": 2}, "format_version is 2; this reader knows 1"),
        ({"frequencies_hz": ["5", 6]}, "frequencies_hz is ['5', 6]"),
        ({"frequencies_hz": [float("nan"), 6]}, "frequencies_hz is [nan, 6]"),
        ({"frequencies_hz": [-1, 6]}, "freqs_hz reach down to -1"),
        ({"fps": None}, "fps is 0; expected a finite number above 0"),
        ({"fps": 0}, "fps is 0"),
        ({"fps": 10**400}, "a whole number of 401 digits"),
        ({"n_timesteps": 0}, "n_timesteps is 0"),
        ({"unit_scale_m": 0}, "unit_scale_m is 0"),
        ({"time_origin_s": float("nan")}, "time_origin_s is nan"),
    ],
)
def test_bad_values_in_the_header_line(refused, good, change, part):
    refused(header_edit(good, lambda v: v.update(change)), part)


@pytest.mark.parametrize(
    ("text", "part"),
    [("{", "is not valid JSON"), ("[1]", "holds [1]; expected an object"), ("[" * 50_000, "not valid")],
)
def test_a_header_line_that_is_no_object(refused, good, text, part):
    refused(re.sub(rb"comment tg4mm .*\n", f"comment tg4mm {text}\n".encode(), good), part)


def test_two_header_lines(refused, good):
    line = re.search(rb"comment tg4mm .*\n", good)[0]
    refused(good.replace(line, line + line), "two 'comment tg4mm' lines")


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"means": np.zeros((4, 3))}, r"quats has shape \(5, 4\), expected \(4, 4\)"),
        ({"displacement": np.zeros((2, 5, 2))}, r"displacement has shape \(2, 5, 2\), expected \(2, 5, 3\)"),
        ({"freqs_hz": np.ones(3)}, r"displacement has shape \(2, 5, 3\), expected \(3, 5, 3\)"),
        ({"sh": np.zeros((5, 5, 3))}, r"sh has shape \(5, 5, 3\), expected \(5, 1 \| 4 \| 9 \| 16, 3\)"),
        ({"means": np.full((5, 3), np.nan)}, r"means\[0, 0\] is nan"),
        ({"rotation": np.full((2, 5, 3), 1j * np.inf)}, r"rotation\[0, 0, 0\] is"),
        ({"scales": np.full((5, 3), -1.0)}, "scales reach down to -1"),
        ({"opacities": np.full(5, 1.5)}, "opacities span 1.5 to 1.5; expected 0 to 1"),
        ({"quats": np.zeros((5, 4))}, r"quats\[0\] is zero, as 5 are"),
        ({"unit_scale_m": float("nan")}, "unit_scale_m is nan"),
    ],
)
def test_a_splat_that_could_not_be_read_back_cannot_be_made(change, part):
    with pytest.raises(SplatFileError, match=part):
        replace(random_splat(), **change)


def test_deviations_of_some_modes_only_are_refused(tmp_path):
    path = tmp_path / "a.ply"
    write_splat(path, random_splat(m=2, deviation=True))
    path.write_bytes(path.read_bytes().replace(b"mode_1_sd", b"mode_9_sd"))
    said = r"has mode_0_sd but no mode_1_sd; expected one for each of 2 modes"
    with pytest.raises(SplatFileError, match=said):
        read_splat(path)
    write_splat(path, random_splat(m=1, deviation=True))
    path.write_bytes(path.read_bytes().replace(b"float mode_0_sd", b"int32 mode_0_sd"))
    with pytest.raises(SplatFileError, match="property mode_0_sd is a whole number type"):
        read_splat(path)
