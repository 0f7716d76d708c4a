"""What `tg4mm analyse` prints."""

import numpy as np

from tg4mm.core.digits import aligned, value_with_deviation
from tg4mm.show.analyse.analysis import Analysis
from tg4mm.show.analyse.orders import OrderTrack
from tg4mm.show.analyse.quantities import Value


def format_analysis(found: Analysis) -> str:
    """Tables of levels, zones, phases, transfer functions, modes and changes, each where there is one."""
    parts = [
        _table(
            ("channel", "", "peak", "peak to peak", "rms", "crest factor", "Hz", ""),
            [
                (v.channel, v.quantity, _both(v.peak), _both(v.peak_to_peak),
                 f"{_both(v.rms)} {v.unit}".removesuffix(" 1"),
                 _both(v.crest), f"{v.band_hz[0]:.3g} to {v.band_hz[1]:.4g}",
                 f"{_both(v.rms_g)} g rms" if v.rms_g is not None
                 else "" if np.isnan(v.db.value) else f"{_both(v.db)} dB re {v.db_reference}".removesuffix(" 1"))
                for v in found.levels
            ],
        ),
        _table(
            ("channel", "velocity, mm/s rms", "class", "zone (ISO 20816-1)"),
            [(z.channel, _both(z.rms), z.machine, z.zone) for z in found.zones],
        ),
        _table(
            ("channel", "against", "Hz", "ratio", "phase, deg"),
            [
                (p.channel, p.reference, _both(p.frequency_hz), _both(p.ratio),
                 f"{np.degrees(p.phase.value):+.1f} ± {np.degrees(p.phase.deviation):.1f}")
                for p in found.phases
            ],
        ),
        _table(
            ("response", "input", "lag, s", "averages", "largest |H1|", "at, Hz", "coherence there"),
            [
                (t.response, t.reference, _both(t.lag_s), str(t.averages),
                 f"{_both(Value(float(abs(t.h1[k])), float(t.deviation[k])))} {t.unit}", f"{t.freqs_hz[k]:.4g}",
                 f"{t.coherence[k]:.3f}")
                for t in found.transfers for k in [int(np.abs(t.h1).argmax())]
            ],
        ),
        _table(
            ("channel", "instrument", "Hz", "channel / instrument", "difference, rms", "correlation"),
            [
                (c.channel, c.reference, f"{c.band_hz[0]:.3g} to {c.band_hz[1]:.4g}", _both(c.ratio),
                 f"{c.difference_rms:.3g} {c.unit}", f"{c.correlation:.4f}")
                for c in found.curves
            ],
        ),
        _table(
            ("modes by", "frequency, Hz", "damping, %", "MAC with FDD"),
            [
                (m.method, _both(mode.frequency_hz),
                 _both(Value(100 * mode.damping.value, 100 * mode.damping.deviation)),
                 "" if mode.mac is None else f"{mode.mac:.3f}")
                for m in found.modes for mode in m.modes
            ],
        ),
        _table(
            ("channel", "order", "rpm", "amplitude", "phase, deg", "largest in a segment", "at rpm"),
            [
                (o.channel, f"{o.order:g}", _range(o.speed_rpm), f"{_both(o.amplitude)} {o.unit}",
                 f"{np.degrees(o.phase.value):+.1f} ± {np.degrees(o.phase.deviation):.1f}",
                 *(_largest(o) if np.isfinite(o.amplitudes).any() else ("–", "–")))
                for o in found.orders
            ],
        ),
        _table(
            ("changed", "", "before", "after", "difference / ±", ""),
            [
                (c.where, c.figure, _both(c.before), f"{_both(c.after)} {c.unit if c.unit != '1' else ''}".rstrip(),
                 f"{c.score:+.1f}", "changed" if c.changed else "")
                for c in found.changes
            ],
        ),
        "".join(f"note: {note}\n" for note in found.notes),
    ]  # fmt: skip
    return "\n".join(part for part in parts if part)


def _range(values: np.ndarray) -> str:
    low, high = f"{values.min():.5g}", f"{values.max():.5g}"
    return low if low == high else f"{low} to {high}"


def _largest(track: OrderTrack) -> tuple[str, str]:
    k = int(np.nanargmax(track.amplitudes))
    largest = Value(float(track.amplitudes[k]), float(track.deviations[k]))
    return f"{_both(largest)} {track.unit}", f"{track.speed_rpm[k]:.5g}"


def _both(value: Value) -> str:
    if np.isnan(value.value):
        return "–"
    if not np.isfinite(value.deviation):
        return f"{value.value:.4g}"
    return value_with_deviation(value.value, value.deviation)


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    return "".join(f"{line}\n" for line in aligned([head, *rows])) if rows else ""
