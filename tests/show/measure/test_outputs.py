"""What a measurement leaves behind: JSON, CSV, UFF that another program reads, plots, and what is refused."""

import csv
import json

import numpy as np
import pytest
from PIL import Image

from tests.show.measure.filmed import BALL, BALL_SPHERE, PARTS, modes, of_parts, run_of, sine
from tg4mm.cli.program import main
from tg4mm.show.analyse import read_channels
from tg4mm.show.measure import measure, parse_sensor, sep005
from tg4mm.show.measure.plots import parts_picture
from tg4mm.show.measure.shapes import _write_gif
from tg4mm.show.measure.tables import _cell

AMPLITUDE = np.array([0.008, 0.0, 0.006])


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A ball at 5 Hz, with its modes."""
    phasors = np.zeros((sum(PARTS), 3), complex)
    phasors[BALL] = AMPLITUDE
    root = tmp_path_factory.mktemp("run")
    return run_of(
        root, of_parts(ball=sine(5.0, AMPLITUDE)), modes({5.0: phasors}, 24), n_timesteps=24, noise=0.004
    )


@pytest.fixture(scope="module")
def out(run, tmp_path_factory):
    """The folder that the command wrote."""
    folder = tmp_path_factory.mktemp("out") / "measured"
    words = ["measure", str(run.path), "--out", str(folder), "--sensor", BALL_SPHERE, "--sensor", "all"]
    assert main(words) == 0
    return folder


def test_json_and_tidy_csv_say_the_same_in_their_units(out):
    found = json.loads((out / "measure.json").read_text())
    ball = found["sensors"][0]
    assert ball["peaks"][0]["frequency_hz"] == pytest.approx(5.0, abs=0.03)
    rows = list(csv.DictReader((out / "series.csv").open()))
    assert len(rows) == 2 * 24 * 3
    own = [r for r in rows if r["sensor"] == "ball" and r["axis"] == "x"]
    millimetres = [float(r["displacement_mm"]) for r in own]
    assert millimetres == pytest.approx(
        [100 * d[0] for d in ball["series"][0]["displacement"]], rel=1e-4, abs=1e-4
    )
    peaks = list(csv.DictReader((out / "peaks.csv").open()))
    assert float(peaks[0]["amplitude_mm"]) == pytest.approx(0.8, rel=0.1)


def test_analyse_reads_the_universal_file_as_it_reads_the_folder(out):
    own, found = ({c.name: c for c in read_channels(path)} for path in (out, out / "measure.uff"))
    common = own.keys() & found.keys()
    assert "ball/x" in common
    for name in common:
        a, b = own[name], found[name]
        assert (a.quantity, a.unit) == (b.quantity, b.unit)
        np.testing.assert_allclose(b.values, a.values, rtol=5.1e-6)  # measure.json has six digits
        np.testing.assert_allclose(b.times_s, a.times_s, atol=1e-4)


def test_an_animation_has_the_colours_of_all_its_pictures(tmp_path):
    """A photograph's range of colours, and a part that brightens: palettes of their own leave 5.9 grey levels, rms."""
    y, x = np.mgrid[:64, :96] / 96
    ground = 255 * np.stack([x, y, 0.5 + 0.4 * np.sin(9 * x)], 2)
    waves = np.cos(2 * np.pi * np.arange(16) / 16)[:, None, None, None]
    part = ((x > 0.3) & (x < 0.6))[None, :, :, None]
    pictures = np.where(part, ground * (0.7 + 0.2 * waves), ground).astype(np.uint8)
    _write_gif(list(pictures), tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as gif:
        assert gif.n_frames == 16
        for k, wanted in enumerate(pictures):
            gif.seek(k)
            found = np.asarray(gif.convert("RGB").resize((96, 64), Image.Resampling.BOX), float)
            assert np.sqrt(((found - wanted) ** 2).mean()) < 9
            assert np.abs((found - wanted).mean()) < 2


def test_another_program_reads_geometry_shapes_and_waveforms(out):
    import pyuff

    file = pyuff.UFF(str(out / "measure.uff"))
    kinds = file.get_set_types().tolist()
    assert set(kinds) == {15, 55, 58, 82, 164}
    nodes = file.read_sets(kinds.index(15))
    at = dict(
        zip(
            np.asarray(nodes["node_nums"], int),
            zip(nodes["x"], nodes["y"], nodes["z"], strict=True),
            strict=True,
        )
    )
    assert at[1] == pytest.approx(
        [0.05, 0.01, 0.037], abs=0.012
    )  # metres: 0.1 a unit; the upper side is seen more
    assert len(at) > 100
    lines = file.read_sets(kinds.index(82))
    assert {int(n) for n in lines["nodes"]} - {0} <= set(at)
    shape = file.read_sets(kinds.index(55))
    own = list(np.asarray(shape["node_nums"], int)).index(1)
    values = [abs(shape[f"r{k}"][own]) for k in (1, 2, 3)]
    assert values == pytest.approx(0.1 * AMPLITUDE, abs=1e-4)
    assert shape["freq"] == pytest.approx(5.0, abs=0.03)
    waveform = file.read_sets(kinds.index(58))
    assert (waveform["rsp_node"], waveform["rsp_dir"], len(waveform["data"])) == (1, 1, 24)
    assert np.abs(waveform["data"]).max() == pytest.approx(0.0008, rel=0.15)


def test_a_kept_pass_gives_the_same_and_needs_no_pictures(run, out, tmp_path, monkeypatch):
    assert run.has_part("residuals")

    def read(*_):
        raise AssertionError("the pictures were read again")

    monkeypatch.setattr("tg4mm.show.measure.prepared.weighed", read)
    again = tmp_path / "again"
    sensors = ["--sensor", BALL_SPHERE, "--sensor", "all"]
    assert main(["measure", str(run.path), "--out", str(again), *sensors, "--no-animate"]) == 0
    assert (again / "series.csv").read_text() == (out / "series.csv").read_text()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--sensor", "tip=sphere:9,9,9,0.1"], "holds no Gaussian"),
        (["--sensor", "tip=cube:1"], "is no region"),
        (["--sensor", "tip=pixel:nowhere,1,2"], "is not a camera"),
        (["--sensor", "tip=pixel:r_000,999,2"], "outside the picture"),
        (["--sensor", "tip=cluster:9"], "no such cluster"),
        (["--sensor", "tip=all", "--reference", "tap"], "is not a sensor"),
    ],
)
def test_what_cannot_be_measured_is_one_line(run, tmp_path, capsys, words, message):
    assert main(["measure", str(run.path), "--out", str(tmp_path / "out"), *words]) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert line.startswith("tg4mm: ")
    assert message in line


def test_every_format_holds_the_same_numbers_with_their_units_and_deviations(run, out):
    import h5py
    import openpyxl
    import pyuff
    from scipy.io import loadmat

    rows = [
        r for r in csv.DictReader((out / "series.csv").open()) if (r["sensor"], r["axis"]) == ("ball", "x")
    ]
    lines = [
        r for r in csv.DictReader((out / "peaks.csv").open()) if (r["sensor"], r["axis"]) == ("ball", "x")
    ]
    columns = {
        "displacement": ("displacement_mm", "mm"),
        "displacement_deviation": ("deviation_mm", "mm"),
        "velocity": ("velocity_mm_per_s", "mm/s"),
        "velocity_deviation": ("velocity_deviation_mm_per_s", "mm/s"),
        "acceleration_deviation": ("acceleration_deviation_mm_per_s2", "mm/s²"),
    }
    mat = loadmat(out / "measure.mat", simplify_cells=True)
    ball = mat["sensors"][0]  # scipy makes a cell array of one the one
    book = openpyxl.load_workbook(out / "measure.xlsx", read_only=True)
    head, *below = book["series"].iter_rows(values_only=True)
    sheet = [dict(zip(head, row, strict=True)) for row in below]
    own = [r for r in sheet if (r["sensor"], r["axis"]) == ("ball", "x")]
    with h5py.File(out / "measure.h5") as file:
        series = file["sensors/1/series/1"]
        assert (file["sensors/1"].attrs["name"], list(series.attrs["axes"])) == ("ball", ["x", "y", "z"])
        for name, (column, unit) in columns.items():
            csv_values = np.array([float(r[column]) for r in rows])
            assert np.isfinite(csv_values).all()
            assert series[name].attrs["unit"] == unit
            assert mat["units"][name.removesuffix("_deviation")] == unit
            for others in (series[name][:, 0], ball["series"][name][:, 0], [r[column] for r in own]):
                np.testing.assert_allclose(others, csv_values, rtol=1e-5)
        found = file["sensors/1/lines"]
        for name, column in (
            ("frequency", "frequency_hz"),
            ("frequency_deviation", "frequency_deviation_hz"),
        ):
            np.testing.assert_allclose(found[name], [float(r[column]) for r in lines], rtol=6e-3)
        assert found["amplitude"][0, 0] == pytest.approx(float(lines[0]["amplitude_mm"]), rel=1e-5)
        assert np.atleast_2d(ball["lines"]["phase_deviation"])[0, 0] == pytest.approx(
            float(lines[0]["phase_deviation_rad"]), rel=6e-3
        )
    assert book.sheetnames == ["series", "spectrum", "lines", "settings"]
    settings = {row[0]: row[1:] for row in book["settings"].iter_rows(values_only=True)}
    assert settings["sampling_rate"] == (pytest.approx(30), "Hz")
    sets = pyuff.UFF(str(out / "measure.uff")).read_sets()
    stored = {
        s["id2"]: s["data"] for s in reversed(sets) if s["type"] == 58 and s["rsp_node"] == s["rsp_dir"] == 1
    }
    metres = np.array([float(r["deviation_mm"]) for r in rows]) / 1000
    np.testing.assert_allclose(stored["displacement, standard deviation"], metres, rtol=1e-4)


def test_every_waveform_and_spectrum_of_the_universal_file_is_that_of_the_csv_in_metres(out):
    import pyuff

    tables = {name: list(csv.DictReader((out / f"{name}.csv").open())) for name in ("series", "spectra")}
    content = json.loads((out / "measure.json").read_text())
    columns = {
        "displacement": ("series", "displacement_mm", "s", 1 / 30),
        "displacement, standard deviation": ("series", "deviation_mm", "s", 1 / 30),
        "amplitude spectrum, Hann, zero to peak": (
            "spectra",
            "amplitude_mm",
            "Hz",
            content["sensors"][0]["spectrum"]["step_hz"],
        ),
    }
    seen = set()
    for s in pyuff.UFF(str(out / "measure.uff")).read_sets():
        if s["type"] == 164:
            assert (s["length"], s["units_description"].strip()) == (1.0, "metres")
        if s["type"] == 15:
            at = list(np.asarray(s["node_nums"], int)).index(2)
            place = 0.1 * np.array(content["sensors"][1]["centre"])
            assert [s["x"][at], s["y"][at], s["z"][at]] == pytest.approx(place, rel=1e-4, abs=1e-6)
        if s["type"] == 58:
            table, column, unit, step = columns[s["id2"]]
            sensor, axis = ("ball", "all")[int(s["rsp_node"]) - 1], "xyz"[int(s["rsp_dir"]) - 1]
            own = [float(r[column]) for r in tables[table] if (r["sensor"], r["axis"]) == (sensor, axis)]
            np.testing.assert_allclose(s["data"], np.array(own) / 1000, rtol=1e-4, atol=1e-12)
            assert (s["ordinate_axis_units_lab"], s["abscissa_axis_units_lab"]) == ("metres", unit)
            assert s["abscissa_inc"] == pytest.approx(step, rel=1e-4)
            seen.add((s["id2"], sensor, axis))
    assert len(seen) == 3 * 2 * 3


def test_sep005_is_what_the_standards_own_check_accepts(run, out):
    standard = pytest.importorskip("sdypy_sep005", reason="the extra `dev` is not installed")
    found = measure(run, [parse_sensor(BALL_SPHERE)])
    signals = sep005(found)
    assert len(signals) == 9
    for signal in signals:
        assert standard.Sep005Data.model_validate(signal).fs == pytest.approx(30)
    first = signals[0]
    assert (first["name"], first["unit_str"], first["quantity"]) == ("ball/x/displacement", "mm", "d")
    np.testing.assert_allclose(first["data"], 100 * found["ball"].displacement[:, 0])
    rows = [
        r for r in csv.DictReader((out / "series.csv").open()) if (r["sensor"], r["axis"]) == ("ball", "z")
    ]
    for name, unit in (("velocity", "mm/s"), ("acceleration", "mm/s²")):
        (own,) = (s for s in signals if s["name"] == f"ball/z/{name}")
        column = f"{name}_{unit.replace('/', '_per_').replace('²', '2')}"
        np.testing.assert_allclose(own["data"], [float(r[column]) for r in rows], rtol=1e-5)
        assert own["unit_str"] == unit


def test_a_measurement_is_analysed_in_its_unit(out, tmp_path, capsys):
    words = ["analyse", str(out), "--out", str(tmp_path / "a"), "--channel", "ball/x", "--against", str(out)]
    assert main([*words, "--machine-class", "I", "--band", "2", "12"]) == 0
    found = json.loads((tmp_path / "a" / "analysis.json").read_text())
    (level,) = [v for v in found["levels"] if v["quantity"] == "velocity"]
    assert level["unit"] == "mm/s"
    true = 2 * np.pi * 5 * 100 * AMPLITUDE[0] / np.sqrt(2)
    assert abs(level["rms"]["value"] - true) < 4 * level["rms"]["deviation"] < true
    assert not any(c["changed"] for c in found["changes"])
    assert "ends at 15 Hz of 10 to 1000 Hz" in capsys.readouterr().out


def test_a_sheets_cells_are_numbers_where_numbers_are_and_names_stay_texts():
    cells = [
        ("1.5", False),
        ("nan", False),
        ("", False),
        ("=1+1", False),
        ("1e3", True),
        ("nan", True),
        ("-a", True),
    ]
    assert [_cell(*cell) for cell in cells] == [1.5, None, "", "'=1+1", "1e3", "nan", "'-a"]


def test_what_compression_may_have_taken_is_in_the_levels(out, tmp_path, capsys):
    content = json.loads((out / "measure.json").read_text())
    sure = {}
    for name, fields in (
        ("plain", {}),
        ("lossy", {"codec_gain": 0.8, "codec_gain_deviation": 0.05, "codec_mark": "too much"}),
        (
            "made",
            {"codec_gain": 2.0, "codec_gain_deviation": 0.08, "codec_mark": "added", "codec_is_made": True},
        ),
    ):
        for peak in content["sensors"][0]["peaks"]:
            peak.update(fields)
        (tmp_path / name).mkdir()
        (tmp_path / name / "measure.json").write_text(json.dumps(content))
        words = ["analyse", str(tmp_path / name), "--out", str(tmp_path / f"{name}-a"), "--channel", "ball/x"]
        assert main(words) == 0
        level = json.loads((tmp_path / f"{name}-a" / "analysis.json").read_text())["levels"][0]
        sure[name] = level["rms"]["deviation"] / level["rms"]["value"]
    assert sure["lossy"] == pytest.approx(np.hypot(sure["plain"], np.hypot(0.25, 0.05 / 0.64)), rel=0.02)
    assert sure["made"] == pytest.approx(np.hypot(sure["plain"], np.hypot(0.5, 0.02)), rel=0.02)
    said = capsys.readouterr().out
    assert "Hz: too much; its levels are lower bounds" in said
    assert "Hz: added; its levels are upper bounds" in said


def test_a_picture_names_the_parts(run, out):
    from tg4mm.core.pictures.decode import read_png

    picture = read_png(out / "regions.png").astype(int)
    coloured = np.ptp(picture, axis=2) > 60  # the ball, named; the whole scene is no part
    assert 0.002 < coloured.mean() < 0.3
    found = measure(run, [parse_sensor("all")])
    assert parts_picture(found) is None
