"""Tables of data loggers and of other programs: the same record, however it is written."""

import logging
import re

import numpy as np
import pytest

from tg4mm.cli.program import main
from tg4mm.show.analyse import read_channels
from tg4mm.show.analyse.channel import ACCELERATION, DISPLACEMENT, OTHER
from tg4mm.show.analyse.tables import AnalyseError

RATE, N = 200.0, 400
TIMES = np.arange(N) / RATE
VALUES = np.round(3 * np.sin(2 * np.pi * 7 * TIMES) + 0.25, 5)


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
