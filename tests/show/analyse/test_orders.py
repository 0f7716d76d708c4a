"""Orders of a machine's speed: amplitudes and phases of a run-up whose truth is known, and what gives no speed."""

import csv
import re

import numpy as np
import pytest

from tests.show.analyse.systems import channel, inside
from tg4mm.cli.program import main
from tg4mm.show.analyse import AnalyseError, Averaging, orders_of, speed_of

RATE, SECONDS = 120.0, 12.0
T = np.arange(int(RATE * SECONDS)) / RATE
HZ = 8 + 10 * T / SECONDS  # of the shaft, running up
ANGLE = 2 * np.pi * (8 * T + 5 * T**2 / SECONDS)
TRUE = {1.0: (1.0, 0.3), 2.0: (0.4, -1.1), 2.5: (0.2, 2.0)}  # amplitude, phase


def running_up():
    return sum(a * np.cos(k * ANGLE + p) for k, (a, p) in TRUE.items())


def pulses(path):
    turn = np.arange(-1, int(ANGLE[-1] / 2 / np.pi) + 3)
    a, b, c = 5 / SECONDS, 8.0, -turn  # a t² + b t + c = 0
    times = (-b + np.sqrt(b * b - 4 * a * c)) / (2 * a)
    path.write_text("pulse_s\n" + "".join(f"{t:.9f}\n" for t in times))
    return path


def table(path, low=-0.5, high=SECONDS + 0.5):
    times = np.linspace(low, high, 60)
    rows = "".join(f"{t:.6f},{60 * (8 + 10 * t / SECONDS):.6f}\n" for t in times)
    path.write_text("time_s,speed_rpm\n" + rows)
    return path


def test_a_run_up_by_pulses_has_its_amplitudes_and_phases_by_their_deviations(tmp_path):
    file, sizes, phases = pulses(tmp_path / "tacho.csv"), [], []
    for seed in range(40):
        c = channel(running_up(), RATE, 0.2, seed)
        for track in orders_of(c, speed_of(c, None, file), tuple(TRUE)):
            size, phase = TRUE[track.order]
            sizes.append((track.amplitude.value - size) / track.amplitude.deviation)
            # the file's first pulse is a turn before the record begins
            off = track.phase.value - phase + 2 * np.pi * track.order
            phases.append(np.angle(np.exp(1j * off)) / track.phase.deviation)
    for scores in (sizes, phases):
        assert 0.6 < inside(scores) < 0.78
        assert np.abs(scores).max() < 4


def test_a_segment_has_the_speed_and_the_amplitude_of_its_time(tmp_path):
    growing = running_up() * HZ / 8
    c = channel(growing, RATE, 0.01, 0)
    averaging = Averaging(segment_s=1.5)
    (track,) = orders_of(c, speed_of(c, None, table(tmp_path / "t.csv")), [1.0], averaging)
    hz = track.speed_rpm / 60
    assert np.allclose(hz, np.interp(track.times_s, T, HZ), rtol=1e-3)
    expected = hz / 8 * TRUE[1.0][0]
    assert np.abs(track.amplitudes / expected - 1).max() < 0.1
    assert np.corrcoef(track.amplitudes, expected)[0, 1] > 0.98


def test_the_strongest_line_is_a_found_speed():
    c = channel(np.cos(2 * np.pi * 9.7 * T) + 0.3 * np.cos(2 * np.pi * 29.1 * T + 1), RATE, 0.1, 0)
    found = {t.order: t for t in orders_of(c, speed_of(c, "auto", None), [1.0, 3.0])}
    assert found[1.0].speed_rpm.mean() == pytest.approx(60 * 9.7, rel=1e-4)
    assert abs(found[3.0].amplitude.value - 0.3) < 3 * found[3.0].amplitude.deviation


def test_orders_beyond_the_frame_rate_are_left_out_where_they_are(tmp_path):
    c = channel(running_up(), RATE, 0.01, 0)
    speed = speed_of(c, None, table(tmp_path / "t.csv"))
    (_, fifth) = orders_of(c, speed, [1.0, 5.0])
    assert np.isfinite(fifth.amplitudes[0])
    assert np.isnan(fifth.amplitudes[-1])
    with pytest.raises(AnalyseError, match="order 9 lies at 72 Hz or above, beyond the 54 Hz"):
        orders_of(c, speed, [9.0])


def test_the_command_writes_and_prints_them(tmp_path, capsys):
    film = tmp_path / "film.csv"
    np.savetxt(film, np.stack([T, running_up()], 1), delimiter=",", header="time_s,bearing_mm", comments="")
    out = tmp_path / "out"
    words = ["analyse", str(film), "--out", str(out), "--tacho", str(table(tmp_path / "t.csv"))]
    assert main([*words, "--order", "1", "--order", "2"]) == 0
    assert re.search(r"bearing +1 +54\d\S* to 10\d\d", capsys.readouterr().out)
    rows = list(csv.DictReader((out / "orders.csv").open()))
    assert {r["order"] for r in rows} == {"1", "2"}
    assert {r["unit"] for r in rows} == {"mm"}
    assert (out / "plots" / "orders_bearing.png").exists()


@pytest.mark.parametrize(
    ("text", "words", "message"),
    [
        ("pulse_s\n0\n1\n", [], "4 or more times"),
        ("pulse_s\n0\n2\n1\n20\n", [], "4 or more times that increase"),
        (
            "time_s,speed_rpm\n1,600\n2,600\n3,600\n4,600\n",
            [],
            "covers 1 to 4 s, but the film runs from 0 to 11.99 s",
        ),
        ("time_s,speed_rpm\n-1,600\n2,-5\n3,600\n14,600\n", [], "expected above 0"),
        ("a,b\n1,2\n", [], "columns are a, b; expected pulse_s"),
        ("pulse_s\nx\n", [], "no rows below a header"),
        ("pulse_s\n", [], "no rows below a header"),
        (None, ["--speed", "fast"], "--speed 'fast', expected revolutions per minute, or auto"),
        (None, ["--speed", "0"], "--speed 0, expected revolutions per minute above 0"),
        (None, ["--speed", "auto"], "no line exceeds the noise"),
        (None, ["--order", "2"], "--order belongs to --speed or --tacho"),
        (None, ["--speed", "600", "--order", "-1"], "different numbers above 0"),
        (None, ["--speed", "600", "--order", "1", "--order", "1.01"], "turns, expected 300 or more"),
        (None, ["--speed", "6"], "holds 0.266 turns, expected 3 or more"),
    ],
)
def test_what_gives_no_speed_is_one_line(tmp_path, capsys, text, words, message):
    film = tmp_path / "film.csv"
    noise = np.random.default_rng(0).normal(size=len(T))
    np.savetxt(film, np.stack([T, noise], 1), delimiter=",", header="time_s,bearing_mm", comments="")
    if text is not None:
        (tmp_path / "t.csv").write_text(text)
        words = ["--tacho", str(tmp_path / "t.csv")]
    out = tmp_path / "out"
    assert main(["analyse", str(film), "--out", str(out), *words]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert not out.exists()
