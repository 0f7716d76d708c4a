"""3DGS files of other programs: any order, float or double, any degree, further properties and elements."""

import random
import re

import numpy as np
import pytest

from tests.core.splatfile.conftest import NAMES, plain_ply
from tg4mm.core.errors import SplatFileError
from tg4mm.core.splatfile import read_splat


def rows(*values):
    return [[v + i for v in values] for i in range(2)]


def check_plain(splat):
    """The content `plain_ply` writes: property i of vertex j is (i + 1)/4 + j, in its default order."""
    assert splat.means.tolist() == rows(0.25, 0.5, 0.75)
    assert splat.sh[:, 0].tolist() == rows(1.0, 1.25, 1.5)
    np.testing.assert_allclose(splat.opacities, 1 / (1 + np.exp([-1.75, -2.75])), rtol=1e-6)
    np.testing.assert_allclose(splat.scales, np.exp(rows(2.0, 2.25, 2.5)), rtol=1e-6)
    assert splat.quats.tolist() == rows(2.75, 3.0, 3.25, 3.5)
    assert (splat.n_modes, splat.fps, splat.n_timesteps, splat.unit_scale_m) == (0, 0.0, 1, None)
    assert {a.dtype for a in (splat.means, splat.quats, splat.scales, splat.opacities, splat.sh)} == {
        np.dtype(np.float32)
    }


@pytest.fixture
def read(tmp_path):
    def read_bytes(data):
        (tmp_path / "a.ply").write_bytes(data)
        return read_splat(tmp_path / "a.ply")

    return read_bytes


def in_order(order, kinds, extra=()):
    """The default content with its properties in another order and of other types, and further properties."""
    values = {name: 0.25 * (i + 1) + np.arange(2) for i, name in enumerate(NAMES)}
    properties = {name: kinds[i % len(kinds)] for i, name in enumerate(order)} | dict(extra)
    data = np.zeros(2, [(name, kind) for name, (_, kind) in properties.items()])
    for name in order:
        data[name] = values[name]
    return plain_ply(properties, data=data.tobytes())


@pytest.mark.parametrize("seed", range(5))
def test_any_order_of_float_and_double_among_other_properties(read, seed):
    order = list(NAMES)
    random.Random(seed).shuffle(order)
    kinds = [("float", "<f4"), ("double", "<f8"), ("float32", "<f4")]
    extra = {
        "red": ("uchar", "u1"),
        "nx": ("float", "<f4"),
        "id": ("int", "<i4"),
        "mode_name": ("short", "<i2"),
    }
    check_plain(read(in_order(order, kinds, extra)))


@pytest.mark.parametrize(("count", "degree"), [(0, 0), (9, 1), (24, 2), (45, 3)])
def test_every_degree_is_channel_major(read, count, degree):
    names = [*NAMES, *(f"f_rest_{i}" for i in range(count))]
    data = np.zeros(1, [(name, "<f4") for name in names])
    data["rot_0"] = 1
    for i in range(count):
        data[f"f_rest_{i}"] = i
    splat = read(plain_ply(dict.fromkeys(names, ("float", "<f4")), count=1, data=data.tobytes()))
    assert splat.sh_degree == degree
    per_channel = count // 3
    for channel in range(3):
        assert splat.sh[0, 1:, channel].tolist() == [channel * per_channel + i for i in range(per_channel)]


def test_comments_and_windows_line_ends(read):
    data = plain_ply(before=["comment Exported by ä", "comment", "obj_info n 3", ""])
    check_plain(read(data))
    head, _, body = data.partition(b"end_header\n")
    check_plain(read(head.replace(b"\n", b"\r\n") + b"end_header\r\n" + body))


def test_elements_before_and_after_are_skipped(read):
    before = ["element chunk 3", "property float a", "property uchar b"]
    after = [
        "element face 0",
        "property list uchar int vertex_indices",
        "element extra 1",
        "property double c",
    ]
    data = plain_ply(before=before, after=after)
    head, _, body = data.partition(b"end_header\n")
    check_plain(read(head + b"end_header\n" + b"\xff" * 15 + body + b"\xff" * 8))


@pytest.mark.parametrize(
    ("names", "kind"),
    [
        (["t", "scale_t", "rot_r_0"], "4D Gaussian splatting"),
        (["trbf_center", "trbf_scale", "motion_0", "omega_0"], "Spacetime Gaussians"),
        (["motion_8"], "Spacetime Gaussians"),
        (["f_offset_0", "f_anchor_feat_0"], "Scaffold-GS"),
        (["mu_t", "cov_t"], "Gaussians that come and go"),
        (["timestamp"], "Gaussians that come and go"),
        (["t_start", "t_end"], "Gaussians that come and go"),
        (["velocity_x", "velocity_y"], "Gaussians that move"),
        (["xyz_motion_0"], "Gaussians that move"),
    ],
)
def test_gaussians_that_are_not_at_rest_are_refused_by_their_kind(read, names, kind):
    for known in (NAMES, [name for name in NAMES if not name.startswith("f_dc")]):
        said = f"is of {kind}.*not read; export the Gaussians of one moment"
        with pytest.raises(SplatFileError, match=said):
            read(plain_ply(dict.fromkeys([*known, *names], ("float", "<f4"))))


@pytest.mark.parametrize(
    "place", [(456_789.0, 5_432_100.0, 210.0), (-2_700_000.0, 0.0, 4_200_000.0), (0.0, 0.0, 0.0)]
)
def test_double_places_far_from_the_origin_are_shifted_before_they_are_rounded(read, place):
    rng = np.random.default_rng(0)
    data = np.zeros(200, [(name, "<f8" if name in "xyz" else "<f4") for name in NAMES])
    local = rng.uniform(-2, 2, (200, 3))
    for k, name in enumerate("xyz"):
        data[name] = local[:, k] + place[k]
    for k in range(3):
        data[f"scale_{k}"] = np.log(0.01)
    data["rot_0"] = 1
    kinds = {name: ("double", "<f8") if name in "xyz" else ("float", "<f4") for name in NAMES}
    splat = read(plain_ply(kinds, count=200, data=data.tobytes()))
    np.testing.assert_allclose(splat.means - splat.means[0], local - local[0], atol=2e-6)
    is_far = any(place)
    assert bool(splat.notes) == is_far
    if is_far:
        start = [float(x) for x in re.search(r"from \((.*)\) on", splat.notes[0])[1].split(",")]
        np.testing.assert_allclose(splat.means + start, local + place, atol=2e-6)


def test_positions_that_a_file_rounded_far_from_its_origin_are_said(read):
    names = dict.fromkeys(NAMES, ("float", "<f4"))
    data = np.zeros(9, [(name, "<f4") for name in NAMES])
    data["rot_0"] = 1
    for k in range(3):
        data[f"scale_{k}"] = np.log(0.01)
    data["x"] = 456_789
    (note,) = read(plain_ply(names, count=9, data=data.tobytes())).notes
    assert "rounded to 0.031, Gaussians are 0.01" in note
    data["x"] = 400
    assert not read(plain_ply(names, count=9, data=data.tobytes())).notes


def test_properties_that_are_not_read_are_said(read):
    names = [*NAMES, "nx", *(f"semantic_{k}" for k in range(7))]
    (note,) = read(plain_ply(dict.fromkeys(names, ("float", "<f4")))).notes
    assert note.endswith("not read: semantic_0, semantic_1, semantic_2, semantic_3, semantic_4 and 2 more")


@pytest.mark.parametrize("comment", ["comment SplatRenderMode: mip", "comment rasterize_mode antialiased"])
def test_files_of_anti_aliased_renderers_are_said(read, comment):
    assert "was trained anti-aliased" in read(plain_ply(before=[comment])).notes[0]
    assert not read(plain_ply(before=["comment amid a mipmap"])).notes
