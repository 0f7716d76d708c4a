"""Tables of data loggers and of other programs: the same record, however it is written."""

import logging
import re
from datetime import datetime, timedelta

import numpy as np
import pytest

from tg4mm.cli.program import main
from tg4mm.show.analyse import read_channels
from tg4mm.show.analyse.channel import ACCELERATION, DISPLACEMENT, OTHER
from tg4mm.show.analyse.tables import AnalyseError

RATE, N = 200.0, 400
TIMES = np.arange(N) / RATE
VALUES = np.round(3 * np.sin(2 * np.pi * 7 * TIMES) + 0.25, 5)
HEAD = (
    "LabVIEW Measurement\t\nX_Columns\t{}\nDate\t2020/05/13\nTime\t12:30:05.1234\n***End_of_Header***\t\n\t"
)
PARTS = "Channels\t1\t\nSamples\t400\t\nY_Unit_Label\tm/s^2\t\nX0\t0.0E+0\t\nDelta_X\t0.005\t\n***End_of_Header***\t\t"
NOON = datetime(2024, 5, 3, 23, 59, 59)


def lines(times="{:.4f}", part=",", point="."):
    rows = zip(TIMES, VALUES, strict=True)
    return [f"{times.format(t)}{{}}{v:.5f}".replace(".", point).format(part) for t, v in rows]


FORMS = {
    "plain": ["time_s,acc [m/s²]", *lines()],
    "spaces": ["Time(s), acc (m/s^2)", *lines(part=", ")],
    "German": ["time_s;acc [m/s²]", *lines(part=";", point=",")],
    "semicolons with points": ["time [s];acc [m/s²];", *(line + ";" for line in lines(part=";"))],
    "tabs": ["time_s\tacc [m/s²]", *lines(part="\t", point=",")],
    "comments": ["# logger 3", "% serial 7", "time_s,acc [m/s2]", *lines()[:9], "# a remark", *lines()[9:]],
    "a head that is a comment": ["# logger 3", "# time_s,acc [m/s2]", *lines()],
    "a preamble": ["Device;A3", "Rate;200;Hz", "time_s;acc [m/s²]", *lines(part=";", point=",")],
    "a row of units": ["time,acc", "[s],[m/s²]", *lines()],
    "rounded": ["time_s,acc [m/s²]", *lines("{:.3f}")],  # of 200 Hz that is exact; see below
}  # fmt: skip


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
@pytest.mark.parametrize("form", FORMS)
def test_one_record_in_many_forms(tmp_path, form, encoding):
    path = tmp_path / "a.csv"
    path.write_bytes("\r\n".join(FORMS[form]).encode(encoding))
    (channel,) = read_channels(path)
    assert (channel.name, channel.quantity, channel.unit) == ("acc", ACCELERATION, "mm/s²")
    np.testing.assert_allclose(channel.values, 1000 * VALUES)
    np.testing.assert_allclose(channel.times_s, TIMES, atol=1e-9)


@pytest.mark.parametrize(
    ("rate", "decimals"),
    [(51200, 6), (30, 2), (30, 4), (29.97, 3), (25600, 5), (1000, 2), (12.5, 1), (240, 3)],
)
def test_rounded_times_are_even(tmp_path, rate, decimals):
    times = 0.3 + np.arange(3000) / rate
    path = tmp_path / "a.csv"
    path.write_text("time_s,a\n" + "".join(f"{t:.{decimals}f},{k % 7}\n" for k, t in enumerate(times)))
    (channel,) = read_channels(path)
    assert channel.rate == pytest.approx(rate, rel=0.1 * 10**-decimals / times[-1])
    np.testing.assert_allclose(channel.times_s, times, atol=0.51 * 10**-decimals)


def test_jittered_times_are_resampled_and_it_is_said(tmp_path, caplog):
    rng = np.random.default_rng(0)
    times = np.arange(2000) / 100 + rng.uniform(-0.004, 0.004, 2000)
    values = np.cos(2 * np.pi * 3 * times)
    path = tmp_path / "a.csv"
    path.write_text(
        "time_s,a_mm\n" + "".join(f"{t:.7f},{v:.7f}\n" for t, v in zip(times, values, strict=True))
    )
    with caplog.at_level(logging.WARNING, "tg4mm"):
        (channel,) = read_channels(path)
    assert "its times are not even" in caplog.text
    assert re.search(r"resampled at (98|99|100|101)\.?\d* Hz", caplog.text)
    np.testing.assert_allclose(channel.values, np.cos(2 * np.pi * 3 * channel.times_s), atol=5e-3)
    times[1000:] += 0.06
    path.write_text(
        "time_s,a_mm\n" + "".join(f"{t:.7f},{v:.7f}\n" for t, v in zip(times, values, strict=True))
    )
    with pytest.raises(AnalyseError, match="times have gaps"):
        read_channels(path)


@pytest.mark.parametrize(
    ("head", "quantity", "unit"),
    [
        ("pos", OTHER, "1"),
        ("shift (pixels)", DISPLACEMENT, "px"),
        ("strain [%]", OTHER, "%"),
        ("u [µm]", DISPLACEMENT, "mm"),
    ],
)
def test_every_quantity_has_levels(tmp_path, capsys, head, quantity, unit):
    path = tmp_path / "a.csv"
    path.write_text(f"time_s,{head}\n" + "\n".join(lines()))
    (channel,) = read_channels(path)
    assert (channel.quantity, channel.unit) == (quantity, unit)
    assert main(["analyse", str(path), "--out", str(tmp_path / "out")]) == 0
    row = next(line for line in capsys.readouterr().out.splitlines() if quantity in line)
    factor = 1e-3 if head.endswith("µm]") else 1
    peak = float(row.split(quantity)[1].split()[0])
    assert peak == pytest.approx(3 * factor, rel=0.01)


def of_times(form, part=","):
    return [f"{form(t)}{part}{v:.5f}" for t, v in zip(TIMES, VALUES, strict=True)]


def at(form):
    return lambda t: (NOON + timedelta(seconds=float(t))).strftime(form)


def thousands(t):
    return f"{1000 * t + 1000:,.1f}".replace(",", "X").replace(".", ",").replace("X", ".")


LOGGERS = {
    "LabVIEW": [HEAD.format("One"), PARTS, "X_Value\tacc\tComment", *of_times("{:.6f}".format, "\t")],
    "LabVIEW without times": [HEAD.format("No"), PARTS, "X_Value\tacc\tComment", *of_times(lambda t: "", "\t")],
    "ISO 8601": ["timestamp,acc [m/s²]", *of_times(at("%Y-%m-%dT%H:%M:%S.%fZ"))],
    "a date in America": ["Date/Time,acc (m/s^2)", *of_times(at("%m/%d/%Y %I:%M:%S.%f %p"))],
    "a date in Germany": ["Zeit;acc [m/s²]", *[s.replace(".", ",") for s in of_times(at("%H:%M:%S,%f"), ";")]],
    "date and time": ["Date,Time,acc [m/s²]", *of_times(at("%d.%m.%Y,%H:%M:%S.%f"))],
    "minutes and seconds": ["Time (mm:ss.0),acc [m/s²]", *of_times(at("%M:%S.%f"))],
    "milliseconds": ["Time [msec],acc [m/s/s]", *of_times(lambda t: f"{1000 * t:.0f}")],
    "nanoseconds since 1970": [
        "time,acc [m s-2]", *of_times(lambda t: 1714737600 * 10**9 + round(t * 1000) * 10**6),
    ],
    "another clock beside it": [
        "time,seconds_elapsed,acc [m·s⁻²]", *of_times(lambda t: f"{round(1714737600000 + 1000 * t)},{t:.6f}"),
    ],
    "thousands": [
        "Zeit [ms];acc [mm/s²]",
        *(f"{thousands(t)};{thousands(v - 1)}" for t, v in zip(TIMES, VALUES, strict=True)),
    ],
    "quoted commas": [
        '"Zeit [s]","acc [m/s²]"', *(f'"{s}"'.replace(".", ",") for s in of_times("{:.4f}".format, '"|"'))
    ],
    "blanks": ["# time[s]  acc[m/s2]", *of_times("  {:.7e}".format, "   ")],
    "numbered rows": ["Sample,Time (s),acc (m/s²)", *(f"{k},{s}" for k, s in enumerate(of_times("{:.4f}".format)))],
    "empty columns": ["time_s,acc [m/s²],,", *(f"{s},," for s in of_times("{:.4f}".format))],
    "a text, and lines below": [
        "time_s,acc [m/s²],status", *(f"{s},OK" for s in of_times("{:.4f}".format)), "End of data",
    ],
    "a slower channel": [
        "time_s,acc [m/s²],state",
        *(f"{s},{'1.5' if k % 50 == 0 else ''}" for k, s in enumerate(of_times("{:.4f}".format))),
    ],
}  # fmt: skip


@pytest.mark.parametrize("form", LOGGERS)
def test_tables_of_data_loggers(tmp_path, form):
    path = tmp_path / "a.txt"
    path.write_text("\n".join(LOGGERS[form]).replace('"|"', '","'), "utf-8")
    (channel,) = read_channels(path)
    assert (channel.name, channel.quantity, channel.unit) == ("acc", ACCELERATION, "mm/s²")
    np.testing.assert_allclose(channel.values, 1000 * VALUES, atol=60 if form == "thousands" else 1e-3)
    np.testing.assert_allclose(channel.times_s - channel.times_s[0], TIMES, atol=1e-6)


def test_each_channel_has_the_clock_before_it(tmp_path):
    path = tmp_path / "a.csv"
    rows = [f"{t:.4f},{v:.5f},{t + 0.001:.4f},{2 * v:.5f}" for t, v in zip(TIMES, VALUES, strict=True)]
    path.write_text("\n".join(["Time 1 (s),a (mm),Time 2 (s),b (mm)", *rows]))
    a, b = read_channels(path)
    np.testing.assert_allclose(b.times_s, a.times_s + 0.001, atol=1e-9)
    np.testing.assert_allclose(b.values, 2 * a.values, atol=2e-5)


def test_missing_values_are_interpolated_and_it_is_said(tmp_path, caplog):
    rows = lines("{:.4f}")
    rows[50], rows[200] = rows[50].split(",")[0] + ",", rows[200].split(",")[0] + ",NaN"
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["time_s,acc [m/s²]", *rows]))
    with caplog.at_level(logging.WARNING, "tg4mm"):
        (channel,) = read_channels(path)
    assert "2 of 400 values are missing" in caplog.text
    np.testing.assert_allclose(channel.values, 1000 * VALUES, atol=1)


def test_a_table_without_a_head_is_taken_by_its_first_column_and_it_is_said(tmp_path, caplog):
    path = tmp_path / "a.dat"
    path.write_text("\n".join(lines(part="  ")))
    with caplog.at_level(logging.WARNING, "tg4mm"):
        (channel,) = read_channels(path)
    assert "its first column, which rises evenly, is taken as times" in caplog.text
    assert (channel.name, channel.rate) == ("column 2", pytest.approx(RATE))
    path.write_text("\n".join(f"{k} {v}" for k, v in enumerate(VALUES)))
    with pytest.raises(AnalyseError, match="neither a header nor times"):
        read_channels(path)


@pytest.mark.parametrize(
    ("head", "row", "message"),
    [
        ("time_s;a [mm]", "0,5;0.25", r"row 203: '0\.25', while decimals of its column begin with ','"),
        ("time_s;a [mm]", "0,5;broken", r"row 203: ('broken' is no number|0,5, broken: is no row of numbers)"),
        ("time_s;a [mm]", "0,5", r"row 203: 1 values, expected 2"),
        ("time [fortnight];a [mm]", "1,0050;0,25", r"are in 'fortnight'; expected s, ms"),
    ],
)  # fmt: skip
def test_what_a_table_cannot_mean_is_refused(tmp_path, head, row, message):
    path = tmp_path / "a.csv"
    rows = lines(part=";", point=",")
    for at in (201, 150):
        path.write_text("\n".join([head, *rows[:at], row, *rows[at:]]))
        with pytest.raises(AnalyseError, match=message.replace("203", str(at + 2))):
            read_channels(path)
