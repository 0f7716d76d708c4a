"""Universal files as modal analysis programs write them, by pyuff, and ours."""

import numpy as np
import pytest

from tg4mm.show.analyse import read_channels
from tg4mm.show.analyse.channel import ACCELERATION, DISPLACEMENT, FORCE
from tg4mm.show.analyse.tables import AnalyseError

pyuff = pytest.importorskip("pyuff")
TIMES = np.arange(300) / 1024
VALUES = -0.5 + np.sin(2 * np.pi * 40 * TIMES)


def write(path, kind=12, unit="m/s2", data_type=4, even=1, binary=0, factor=None, times=TIMES):
    sets = []
    if factor is not None:
        units = {"units_code": 5, "units_description": "mm", "length": factor, "force": 1.0}
        sets.append(pyuff.prepare_164(**units, temp_mode=1, temp=1.0, temp_offset=0.0))
    for node, direction in ((3, 1), (3, 1 if binary else -2)):  # pyuff writes all binary ones but the first
        sets.append(
            pyuff.prepare_58(
                binary=binary, id1="Response", id2="NONE", id3="NONE", id4="NONE", id5="NONE", func_type=1, ver_num=0,
                load_case_id=0, rsp_ent_name="NONE", rsp_node=node, rsp_dir=direction, ref_ent_name="NONE", ref_node=0,
                ref_dir=0, ord_data_type=data_type, num_pts=len(times), abscissa_spacing=even,
                abscissa_min=float(times[0]), abscissa_inc=float(times[1] - times[0]), z_axis_value=0.0,
                abscissa_spec_data_type=17, abscissa_axis_units_lab="s", abscissa_len_unit_exp=0,
                abscissa_force_unit_exp=0, abscissa_temp_unit_exp=0, ordinate_spec_data_type=kind,
                ordinate_len_unit_exp=0, ordinate_force_unit_exp=0, ordinate_temp_unit_exp=0,
                ordinate_axis_units_lab=unit, orddenom_spec_data_type=0, orddenom_len_unit_exp=0,
                orddenom_force_unit_exp=0, orddenom_temp_unit_exp=0, orddenom_axis_units_lab="NONE",
                z_axis_spec_data_type=0, z_axis_len_unit_exp=0, z_axis_force_unit_exp=0, z_axis_temp_unit_exp=0,
                z_axis_axis_units_lab="NONE", data=direction * VALUES, x=times,
            )
        )  # fmt: skip
    pyuff.UFF(str(path)).write_sets(sets, mode="overwrite")
    return path


@pytest.mark.parametrize("data_type", [2, 4])
@pytest.mark.parametrize(("even", "binary"), [(1, 0), (0, 0), (1, 1)])
def test_every_form_of_dataset_58(tmp_path, data_type, even, binary):
    a, *rest = read_channels(write(tmp_path / "a.uff", data_type=data_type, even=even, binary=binary))
    assert [a.name, *(b.name for b in rest)] == ["Response/x", "Response/-y"][: 2 - binary]
    assert (a.quantity, a.unit) == (ACCELERATION, "mm/s²")
    tolerance = 1e-9 if data_type == 4 else 1e-5
    np.testing.assert_allclose(a.values, 1000 * VALUES, rtol=0, atol=1000 * tolerance)
    for b in rest:
        np.testing.assert_allclose(b.values, -2000 * VALUES, rtol=0, atol=2000 * tolerance)
    np.testing.assert_allclose(a.times_s, TIMES, atol=1e-5)
    assert a.rate == pytest.approx(1024, rel=1e-4)


def test_a_file_is_known_by_its_content_and_may_be_big_endian(tmp_path):
    data = write(tmp_path / "a.uff", binary=1).read_bytes()
    at = data.index(b"58b     1     2")
    head, begin = data[at : at + 80].replace(b"58b     1", b"58b     2", 1), at
    for _ in range(12):
        begin = data.index(b"\n", begin) + 1
    end = begin + 8 * len(TIMES)
    swapped = np.frombuffer(data[begin:end], "<f8").astype(">f8").tobytes()
    path = tmp_path / "a.txt"
    path.write_bytes(data[:at] + head + data[at + 80 : begin] + swapped + data[end:])
    np.testing.assert_allclose(read_channels(path)[0].values, 1000 * VALUES, atol=1e-6)


@pytest.mark.parametrize(
    ("kind", "unit", "factor", "expected", "scale"),
    [
        (12, "g", None, (ACCELERATION, "mm/s²"), 9806.65),
        (8, "NONE", 1000.0, (DISPLACEMENT, "mm"), 1.0),
        (8, "NONE", None, (DISPLACEMENT, "mm"), 1000.0),
        (8, "pixels", 1.0, (DISPLACEMENT, "px"), 1.0),
        (9, "NONE", None, (FORCE, "N"), 1.0),
    ],
)
def test_units_are_those_of_the_label_else_of_dataset_164(tmp_path, kind, unit, factor, expected, scale):
    a, _ = read_channels(write(tmp_path / "a.unv", kind=kind, unit=unit, factor=factor))
    assert (a.quantity, a.unit) == expected
    np.testing.assert_allclose(a.values, scale * VALUES, rtol=1e-9)


@pytest.mark.parametrize("share", [0.2, 0.45, 0.9])
@pytest.mark.parametrize("binary", [0, 1])
def test_a_damaged_file_is_one_line(tmp_path, share, binary):
    path = write(tmp_path / "a.uff", binary=binary)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(AnalyseError, match=r"a\.uff "):
        read_channels(path)
    path.write_bytes(data.replace(b"E-", b"Q-").replace(b"       300", b"       299"))
    with pytest.raises(AnalyseError, match=r"a\.uff "):
        read_channels(path)
