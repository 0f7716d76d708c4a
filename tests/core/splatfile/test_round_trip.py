"""A file read back is what was written; other programs read it as a plain 3DGS PLY."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plyfile import PlyData

from tests.core.splatfile.conftest import assert_same, random_splat
from tg4mm.core.splatfile import header, read_splat, write_splat


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("splat") / "a.ply"


def cases():
    return st.tuples(
        st.integers(0, 2**32 - 1), st.integers(1, 20), st.sampled_from([1, 4, 9, 16]), st.integers(0, 4)
    )


@settings(deadline=None)
@given(
    case=cases(), scale=st.none() | st.floats(1e-6, 1e6), origin=st.floats(-1e9, 1e9), deviation=st.booleans()
)
def test_a_file_read_back_is_the_file_written(path, case, scale, origin, deviation):
    seed, n, k, m = case
    splat = random_splat(seed, n, k, m, unit_scale_m=scale, deviation=deviation)
    splat = replace(splat, time_origin_s=origin)
    write_splat(path, splat)
    assert_same(read_splat(path), splat)


def test_deviations_are_further_properties_which_a_reader_without_them_skips(tmp_path):
    """They come after all that version 1 had, so a file with them is version 1 as well."""
    splat = random_splat(n=3, m=2, deviation=True)
    write_splat(tmp_path / "with.ply", splat)
    write_splat(tmp_path / "without.ply", replace(splat, deviation=None))
    with_them, without = (PlyData.read(str(tmp_path / f"{n}.ply"))["vertex"] for n in ("with", "without"))
    names = [p.name for p in without.properties]
    assert [p.name for p in with_them.properties] == [*names, "mode_0_sd", "mode_1_sd"]
    np.testing.assert_array_equal(with_them["mode_1_sd"], splat.deviation[1])
    assert all((with_them[name] == without[name]).all() for name in names)
    assert read_splat(tmp_path / "without.ply").deviation is None


def test_another_reader_sees_the_3dgs_layout(tmp_path):
    splat = random_splat(n=7, k=16, m=2)
    write_splat(tmp_path / "a.ply", splat)
    ply = PlyData.read(str(tmp_path / "a.ply"))
    names = [p.name for p in ply["vertex"].properties]
    rest = [f"f_rest_{i}" for i in range(45)]
    plain = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *rest, "opacity"]
    plain += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    kinds = [f"{part}_{turn}{axis}" for turn in ("", "r") for part in ("re", "im") for axis in "xyz"]
    assert names == plain + [f"mode_{k}_{kind}" for k in range(2) for kind in kinds]
    assert not ply.text
    assert ply.byte_order == "<"
    v = ply["vertex"].data
    for i, axis in enumerate("xyz"):
        np.testing.assert_array_equal(v[axis], splat.means[:, i])
        np.testing.assert_array_equal(v[f"n{axis}"], 0)
        np.testing.assert_array_equal(v[f"f_dc_{i}"], splat.sh[:, 0, i])
        np.testing.assert_allclose(v[f"scale_{i}"], np.log(splat.scales[:, i]), rtol=1e-6)
        np.testing.assert_array_equal(v[f"mode_1_re_{axis}"], splat.displacement[1, :, i].real)
        np.testing.assert_array_equal(v[f"mode_1_im_{axis}"], splat.displacement[1, :, i].imag)
        np.testing.assert_array_equal(v[f"mode_0_re_r{axis}"], splat.rotation[0, :, i].real)
        np.testing.assert_array_equal(v[f"mode_0_im_r{axis}"], splat.rotation[0, :, i].imag)
        for coefficient in range(15):  # channel-major: red's fifteen, then green's, then blue's
            np.testing.assert_array_equal(
                v[f"f_rest_{15 * i + coefficient}"], splat.sh[:, 1 + coefficient, i]
            )
    for i in range(4):
        np.testing.assert_array_equal(v[f"rot_{i}"], splat.quats[:, i])
    np.testing.assert_allclose(1 / (1 + np.exp(-v["opacity"].astype(float))), splat.opacities, atol=1e-7)


def test_the_header_line_says_what_the_modes_mean(tmp_path):
    splat = random_splat()
    write_splat(tmp_path / "a.ply", splat)
    (comment,) = PlyData.read(str(tmp_path / "a.ply")).comments
    assert comment.startswith("tg4mm {")
    assert json.loads(comment.removeprefix("tg4mm ")) == {
        "format_version": 1,
        "fps": 30.0,
        "n_timesteps": 30,
        "frequencies_hz": splat.freqs_hz.tolist(),
        "unit_scale_m": 0.5,
        "time_origin_s": 0.25,
    }


def test_the_ends_of_opacity_and_scale_survive(tmp_path):
    splat = replace(
        random_splat(n=3),
        opacities=np.array([0, 1, 0.5], np.float32),
        scales=np.array([[0, 1e-30, 1e-12], [1, 1e30, 1e-6], [1, 1, 1]], np.float32),
    )
    write_splat(tmp_path / "a.ply", splat)
    read = read_splat(tmp_path / "a.ply")
    np.testing.assert_allclose(read.opacities, [2**-24, 1 - 2**-24, 0.5], rtol=1e-6)
    np.testing.assert_allclose(read.scales, [[1e-12, 1e-12, 1e-12], [1, 1e30, 1e-6], [1, 1, 1]], rtol=1e-5)
    assert_same(read, replace(splat, scales=np.maximum(splat.scales, np.float32(1e-12))))


def test_a_file_is_read_block_by_block(tmp_path, monkeypatch):
    splat = random_splat(n=5)
    write_splat(tmp_path / "a.ply", splat)
    monkeypatch.setattr(header, "ROWS_AT_ONCE", 2)
    assert_same(read_splat(tmp_path / "a.ply"), splat)
