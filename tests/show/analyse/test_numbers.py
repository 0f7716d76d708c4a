"""Levels, spectra, zones, lags, transfer functions, modes and comparisons of systems whose answer is known."""

import json

import numpy as np
import pytest

from tests.show.analyse.systems import DAMPING, MASS_HZ, channel, driven, inside, receptance, two_masses
from tg4mm.show.analyse import (
    AnalyseError,
    Averaging,
    Value,
    compared,
    converted,
    curve_of,
    density_of,
    from_transfers,
    lag_of,
    levels_of,
    mac,
    operational,
    phases_of,
    read_channels,
    transfer_of,
    waterfall_of,
    zone_of,
)
from tg4mm.show.analyse.record import _of_channel

RATE, T = 60.0, np.arange(600) / 60.0
BAND = 1.0, 20.0
HALF = Value(0.5 / 960, 0.0)
TONES = ((1.0, 3.3, 0.4), (0.3, 11.7, 1.0))  # amplitude, Hz, phase


def tones(times, order=0, filtered=False):
    """The tones' order-th derivative; as the band's filter leaves it."""
    out = np.zeros(len(times))
    for a, f, p in TONES:
        gain = 1 / (1 + (BAND[0] / f) ** 8) / (1 + (f / BAND[1]) ** 8) if filtered else 1.0
        out += (gain * a * (2j * np.pi * f) ** order * np.exp(1j * (2 * np.pi * f * times + p))).real
    return out


@pytest.mark.slow
@pytest.mark.parametrize(("quantity", "order"), [("displacement", 0), ("velocity", 1), ("acceleration", 2)])
def test_levels_are_the_true_ones_and_scatter_by_their_deviations(quantity, order):
    """Over 50 records; the truth is that of the part that is judged: the ends are left out."""
    inner = converted(channel(tones(T), RATE), quantity, BAND, 4)[2]
    true = tones(np.arange(4 * len(T))[inner] / RATE / 4, order, True)
    expected = {"peak": np.abs(true).max(), "peak_to_peak": np.ptp(true), "rms": np.sqrt((true**2).mean())}
    scores: dict[str, list[float]] = {name: [] for name in expected}
    for seed in range(50):
        found = levels_of(channel(tones(T), RATE, 0.05, seed), quantity, BAND)
        for name, value in expected.items():
            own = getattr(found, name)
            scores[name].append((own.value - value) / own.deviation)
    for name, own_scores in scores.items():
        assert inside(own_scores) > 0.55, name
        assert abs(np.mean(own_scores)) < 1, name
        assert np.abs(own_scores).max() < 4.5, name


@pytest.mark.parametrize("seed", range(4))
def test_noise_alone_has_no_decibels_and_no_crest_factor(seed):
    found = levels_of(channel(np.zeros(len(T)), RATE, 0.05, seed), "acceleration", BAND)
    assert found.rms.value <= 2 * found.rms.deviation
    assert np.isnan([found.db.value, found.db.deviation, found.crest.value]).all()


def test_a_sine_has_its_rms_crest_factor_and_decibels_in_every_quantity():
    omega = 2 * np.pi * 7.3
    c = channel(0.1 * np.cos(omega * T), RATE)
    for order, quantity in enumerate(("displacement", "velocity", "acceleration")):
        found = levels_of(c, quantity)
        assert found.rms.value == pytest.approx(0.1 * omega**order / np.sqrt(2), rel=2e-3)
        assert found.crest.value == pytest.approx(np.sqrt(2), rel=0.01)
        assert np.isnan(found.rms.deviation)
        reference = (1e-9, 1e-6, 1e-3)[order]
        assert found.db.value == pytest.approx(20 * np.log10(found.rms.value / reference))
        assert found.db_reference == f"{reference:g} mm{('', '/s', '/s²')[order]}"
    assert found.rms_g.value == pytest.approx(0.1 * omega**2 / np.sqrt(2) / 9806.65, rel=2e-3)
    acceleration = channel(-0.1 * omega**2 * np.cos(omega * T), RATE, quantity="acceleration")
    levels = levels_of(acceleration, "displacement", (2, 20))
    assert levels.rms.value == pytest.approx(0.1 / np.sqrt(2), rel=5e-3)
    with pytest.raises(AnalyseError, match="begins above 0 Hz"):
        levels_of(acceleration, "velocity", (0, 20))


def test_noise_alone_is_no_vibration():
    scores = [levels_of(channel(0 * T, RATE, 0.1, seed), "velocity", BAND).rms for seed in range(50)]
    assert np.mean([v.value > 2 * v.deviation for v in scores]) < 0.08  # 2.3 % by the normal distribution


def test_a_density_lies_in_its_interval_in_95_records_of_100():
    found = [density_of(channel(0 * T, RATE, 1.0, seed)) for seed in range(100)]
    inner = slice(2, -2)
    share = np.mean([(d.low[inner] < 2 / RATE) & (d.high[inner] > 2 / RATE) for d in found])
    assert 0.93 < share < 0.97
    values = np.array([d.density[inner] for d in found])
    assert 2 * values.mean() ** 2 / values.var(0).mean() == pytest.approx(found[0].freedom, rel=0.12)
    assert found[0].noise == pytest.approx(2 / RATE)


def test_zones_are_those_of_the_class_and_say_what_is_not_covered():
    times, omega = np.arange(4000) / 4000, 2 * np.pi * 50
    known = (1.0, "I", "B"), (1.0, "III", "A"), (5.0, "II", "C"), (8.0, "II", "D"), (1.8, "I", "B or C")
    for rms, machine, zone in known:
        size = rms * np.sqrt(2) / omega
        found = zone_of(channel(size * np.cos(omega * times), 4000, 1e-4), machine)
        assert (found.zone, found.notes) == (zone, ())
        assert abs(found.rms.value - rms) < 3 * found.rms.deviation
    slow = zone_of(channel(0.1 * np.cos(2 * np.pi * 15 * T), RATE, 1e-4), "I")
    assert "ends at 30 Hz of 10 to 1000 Hz" in slow.notes[0]
    for bad, words in (
        (channel(T, RATE, base="px"), "needs millimetres"), (channel(T[:100], 19.0), "below the band of a zone"),
    ):  # fmt: skip
        with pytest.raises(AnalyseError, match=words):
            zone_of(bad, "I")


@pytest.mark.slow
def test_an_accelerometers_lag_is_found_within_its_deviation():
    """Over 50 pairs of records, film at 60 Hz, accelerometer at 1000 Hz, both with a clock of its own."""
    scores = []
    for seed in range(50):
        rng = np.random.default_rng(seed)
        f, p, lag = rng.uniform(2, 20, 30), rng.uniform(0, 6.28, 30), rng.uniform(-2, 2)
        a, fast = rng.normal(size=30) / f**2, np.arange(0, 12, 1e-3)
        shift = (a[:, None] * np.cos(2 * np.pi * f[:, None] * (T - lag) + p[:, None])).sum(0)
        push = (-a * (2 * np.pi * f) ** 2)[:, None] * np.cos(2 * np.pi * f[:, None] * fast + p[:, None])
        y = channel(shift, RATE, 0.02 * shift.std(), seed)
        x = channel(push.sum(0), 1000.0, 0.02 * push.sum(0).std(), seed + 99, quantity="acceleration")
        found = lag_of(y, x)
        scores.append((found.value - lag) / found.deviation)
    assert inside(scores) > 0.55
    assert np.abs(scores).max() < 4.5
    tone, noise = channel(np.cos(50 * T), RATE, 0.1, 3), channel(0 * T, RATE, 1.0, 1)
    for a, b in ((noise, channel(0 * T, RATE, 1.0, 2)), (tone, channel(np.cos(50 * T), RATE, 0.1, 4))):
        with pytest.raises(AnalyseError, match="fits as well"):
            lag_of(a, b)


def forced(seed, noise):
    """Film at 60 Hz of the mass, and its force at 960 Hz, held from sample to sample: half of one late; 40 s."""
    rng = np.random.default_rng(seed)
    force = np.repeat(rng.normal(size=40 * 120), 8)
    moved = driven(force, 960.0)
    own = channel(moved[::16], RATE, noise * moved.std(), seed)
    return own, channel(force, 960.0, quantity="force", base="N", name="f")


def test_a_transfer_function_is_that_of_the_mass_within_its_deviation():
    scores, turns = [], []
    for seed in range(12):
        found = transfer_of(*forced(seed, 0.05), Averaging(segment_s=6), HALF)
        keep = (found.freqs_hz > 3) & (found.freqs_hz < 14) & (np.abs(found.freqs_hz - MASS_HZ) > 0.6)
        true = receptance(found.freqs_hz[keep])
        scores += list((np.abs(found.h1[keep]) - np.abs(true)) / found.deviation[keep])
        turns += list(np.angle(found.h1[keep] / true) / found.phase_deviation[keep])
        assert found.coherence[keep].mean() > 0.9
    assert found.unit == "mm/N"
    assert inside(scores) > 0.55
    assert inside(turns) > 0.55
    assert np.abs(found.h2[keep]) == pytest.approx(np.abs(true), rel=0.5)


def test_lscf_of_transfer_functions_finds_the_mass():
    pytest.importorskip("sdypy.EMA", reason="the extra `modal` is not installed")
    found = transfer_of(*forced(3, 0.02), Averaging(segment_s=8), HALF)
    modes = from_transfers([found], (3.0, 16.0))
    (mode,) = [m for m in modes.modes if abs(m.frequency_hz.value - MASS_HZ) < 0.5]
    assert mode.frequency_hz.value == pytest.approx(MASS_HZ, abs=max(0.05, 3 * mode.frequency_hz.deviation))
    assert mode.damping.value == pytest.approx(DAMPING, abs=max(0.008, 3 * mode.damping.deviation))


@pytest.mark.slow
def test_operational_modes_of_two_masses_scatter_by_their_deviations():
    scores: list[float] = []
    for seed in range(10):
        pytest.importorskip("pyoma2", reason="the extra `modal` is not installed")
        values, hz, ratios, shapes = two_masses(3000, RATE, seed)
        both = [channel(v, RATE, 0.02, seed + k, name=str(k)) for k, v in enumerate(values.T)]
        found = operational(both, (1, 20))
        assert len(found.modes) >= 2
        for k in (0, 1):
            mode = min(found.modes, key=lambda m: abs(m.frequency_hz.value - hz[k]))
            scores.append((mode.frequency_hz.value - hz[k]) / mode.frequency_hz.deviation)
            scores.append((mode.damping.value - ratios[k]) / mode.damping.deviation)
            assert mac(mode.shape, shapes[:, k]) > 0.98
            assert mode.mac > 0.9
    assert inside(scores) > 0.55
    assert np.abs(scores).max() < 5
    assert found.diagram.shape[1] == 3


def test_a_region_ahead_of_another_has_its_phase():
    a = channel(tones(T), RATE, 0.02, 1)
    b = channel(2 * np.cos(2 * np.pi * 3.3 * T + 1.0), RATE, 0.02, 2, name="b")
    found = phases_of([a, b], a)
    strongest = next(p for p in found if abs(p.frequency_hz.value - 3.3) < 0.05)
    assert strongest.phase.value == pytest.approx(0.6, abs=4 * strongest.phase.deviation)
    assert strongest.ratio.value == pytest.approx(2.0, abs=4 * strongest.ratio.deviation)


def test_what_changed_is_named_and_what_did_not_is_not():
    def machine(size, seed):
        return _of_channel(channel(size * tones(T), RATE, 0.05, seed))

    false = [any(c.changed for c in compared(machine(1, s), machine(1, s + 100))[0]) for s in range(30)]
    assert np.mean(false) < 0.1
    changes, alone = compared(machine(1, 0), machine(1.2, 7))
    assert {(c.figure, c.changed) for c in changes} == {("frequency", False), ("amplitude", True)}
    assert not alone
    slower = channel(np.cos(2 * np.pi * 3.25 * T + 0.4), RATE, 0.05, 3)
    changes, alone = compared(machine(1, 0), _of_channel(slower))
    assert [c.figure for c in changes if c.changed] == ["frequency"]
    assert alone == ["x: 11.7 Hz is in the first record only"]


def test_an_instruments_curve_lies_on_the_films_and_the_ratio_tells_a_wrong_scale():
    rng, fast = np.random.default_rng(5), np.arange(0, 12, 1e-3)
    f, p, lag = rng.uniform(2, 20, 6), rng.uniform(0, 6.28, 6), 0.4
    a, scores = rng.normal(size=6) / f**2, []
    push = (-a * (2 * np.pi * f) ** 2)[:, None] * np.cos(2 * np.pi * f[:, None] * fast + p[:, None])
    x = channel(push.sum(0), 1000.0, name="acc", quantity="acceleration")
    shift = (a[:, None] * np.cos(2 * np.pi * f[:, None] * (T - lag) + p[:, None])).sum(0)
    for seed in range(12):
        y = channel(1.05 * shift, RATE, 0.02 * shift.std(), seed)
        found = curve_of(y, x, Value(lag, 1e-5), (1.0, 22.0))
        scores.append((found.ratio.value - 1.05) / found.ratio.deviation)
    assert inside(scores) > 0.5
    assert np.abs(scores).max() < 3.5
    assert found.ratio.deviation < 0.03
    assert (found.unit, found.correlation > 0.98) == ("mm/s²", True)
    assert np.std(found.values - 1.05 * found.instrument) == pytest.approx(found.deviation, rel=0.3)


def test_a_waterfall_shows_each_segments_amplitude_at_its_time():
    swept = np.cos(2 * np.pi * (5 * T + 0.5 * T**2))  # 5 Hz + 1 Hz a second
    freqs, times, amplitude = waterfall_of(channel(swept, RATE), Averaging(segment_s=1.5, overlap=0.75))
    assert freqs[amplitude.argmax(0)] == pytest.approx(5 + times, abs=freqs[1])
    steady = waterfall_of(channel(0.7 * np.cos(2 * np.pi * 8 * T), RATE), Averaging(segment_s=1.5))[2]
    assert steady.max(0) == pytest.approx(0.7, rel=0.01)


def test_modes_of_a_free_decay_are_those_of_the_system():
    pytest.importorskip("pyoma2", reason="the extra `modal` is not installed")
    true, shapes = ((6.3, 0.012), (17.9, 0.008)), np.array([[1, 0.6, 0.3], [0.7, -0.8, 0.5]])
    t = T[:480]
    for seed in range(3):
        rings = [
            np.exp(-2 * np.pi * f * z * t) * np.cos(2 * np.pi * f * np.sqrt(1 - z * z) * t + seed)
            for f, z in true
        ]
        values = np.einsum("kc,kt->ct", shapes, rings)
        every = [channel(v, RATE, 0.01, 9 * seed + k, name=str(k)) for k, v in enumerate(values)]
        found = operational(every, (1, 25))
        for (f, z), shape in zip(true, shapes, strict=True):
            mode = min(found.modes, key=lambda m: abs(m.frequency_hz.value - f))
            assert abs(mode.frequency_hz.value - f) < 3 * mode.frequency_hz.deviation < 0.05
            assert abs(mode.damping.value - z) < 3 * mode.damping.deviation < 0.005
            assert mac(mode.shape, shape) > 0.99


@pytest.mark.parametrize(("amplitude", "kept"), [(0.0, ["a/right"]), (0.05, ["a/right", "a/up"])])
def test_a_noisy_axis_is_left_out_unless_it_moves(tmp_path, amplitude, kept):
    noise = np.array([0.001, 0.011])
    moved = noise * np.random.default_rng(0).normal(size=(len(T), 2))
    moved[:, 1] += amplitude * np.sin(2 * np.pi * 4 * T)
    series = {
        "axes": {"right": 0, "up": 0}, "clock": "", "times_s": T.tolist(), "displacement": moved.tolist(),
        "noise": noise.tolist(), "model_share": [0, 0],
    }  # fmt: skip
    sensor = {"name": "a", "px_per_unit": 1, "peaks": [], "series": [series]}
    content = {"printed_unit": "px", "unit_scale_m": None, "sensors": [sensor]}
    (tmp_path / "measure.json").write_text(json.dumps(content), encoding="utf-8")
    assert [c.name for c in read_channels(tmp_path)] == kept
    without_scale = content | {"printed_unit": "units", "sensors": [sensor | {"px_per_unit": 50.0}]}
    (tmp_path / "measure.json").write_text(json.dumps(without_scale), encoding="utf-8")
    first = read_channels(tmp_path)[0]
    assert (first.base, first.values.std()) == ("px", pytest.approx(50 * moved[:, 0].std()))
