"""Plots of the engineering quantities: each maker yields names and figures of one quantity's results."""

from collections.abc import Iterator, Sequence
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from tg4mm.core.pages.charts import COLOURS
from tg4mm.show.analyse.channel import Channel
from tg4mm.show.analyse.modal import Modes
from tg4mm.show.analyse.orders import OrderTrack
from tg4mm.show.analyse.quantities import ThirdOctave, converted
from tg4mm.show.analyse.record import AnalysedRecord
from tg4mm.show.analyse.transfer import Averaging, Curve, Density, Transfer, waterfall_of

Figures = Iterator[tuple[str, Any]]


def _chart(plt: Any, title: str, **labels: Any) -> tuple[Any, Any]:
    """Return a figure and its axes with a title and labels."""
    figure, axes = plt.subplots(figsize=(9, 4), layout="constrained")
    axes.set_title(title, loc="left")
    axes.set(**labels)
    return figure, axes


def spectra(plt: Any, record: AnalysedRecord, found: Sequence[Density]) -> Figures:
    """Yield each channel's spectrum, and the orbit of each pair of one sensor's axes."""
    for channel, density in zip(record.channels, found, strict=True):
        yield channel.name, _spectrum(plt, channel, density, record.averaging)
    for a, b in pairwise(record.channels):
        sensor = a.name.rpartition("/")[0]
        if sensor and sensor == b.name.rpartition("/")[0]:
            yield f"orbit {sensor} {a.name[-5:]} {b.name[-5:]}", _orbit(plt, a, b)


def third_octaves(plt: Any, record: AnalysedRecord, found: Sequence[ThirdOctave]) -> Figures:
    """Yield the bands of each channel in its quantity."""
    own = {c.name: c.quantity for c in record.channels}
    for name, group in groupby((b for b in found if b.quantity == own[b.channel]), lambda b: b.channel):
        bands = list(group)
        title = f"{name}: 1/3-octave bands; bars: one standard deviation"
        figure, axes = _chart(plt, title, xlabel="frequency, Hz", ylabel=f"rms, {bands[0].unit}")
        hz, rms, deviation = np.array([(b.midband_hz, b.rms.value, b.rms.deviation) for b in bands]).T
        low, high = np.array([b.band_hz for b in bands]).T
        axes.bar(low, rms, high - low, align="edge", color=COLOURS[0], alpha=0.6)
        axes.errorbar(hz, rms, np.nan_to_num(deviation), fmt="none", color=COLOURS[1], lw=1, capsize=3)
        axes.set(xscale="log")
        yield f"third octaves {name}", figure


def transfers(plt: Any, record: AnalysedRecord, found: Sequence[Transfer]) -> Figures:
    """Yield size, phase and coherence of each transfer function."""
    for t in found:
        figure, parts = plt.subplots(3, 1, figsize=(9, 7), sharex=True, layout="constrained")
        (size, phase, coherence), h1 = parts, np.abs(t.h1)
        size.set_title(f"{t.response} over {t.reference}", loc="left")
        size.semilogy(t.freqs_hz, h1, color=COLOURS[0], label="H1")
        size.semilogy(t.freqs_hz, np.abs(t.h2), color=COLOURS[1], lw=0.8, label="H2")
        low = np.maximum(h1 - t.deviation, 1e-3 * h1)
        size.fill_between(t.freqs_hz, low, h1 + t.deviation, color=COLOURS[0], alpha=0.25)
        size.set(ylabel=t.unit)
        size.legend()
        angle, sure = np.degrees(np.angle(t.h1)), np.degrees(t.phase_deviation)
        phase.errorbar(t.freqs_hz, angle, sure, fmt=".", ms=3, lw=0.6)
        phase.set(ylabel="phase, deg", ylim=(-190, 190))
        coherence.plot(t.freqs_hz, t.coherence)
        coherence.set(ylabel="coherence", xlabel="frequency, Hz", ylim=(0, 1.05))
        yield f"transfer {t.response}", figure


def curves(plt: Any, record: AnalysedRecord, found: Sequence[Curve]) -> Figures:
    """Yield each instrument's curve with the channel's."""
    for c in found:
        title = f"{c.band_hz[0]:.3g} to {c.band_hz[1]:.4g} Hz; band: one standard deviation"
        figure, axes = _chart(plt, title, xlabel="time, s", ylabel=c.unit)
        axes.plot(c.times_s, c.instrument, color=COLOURS[1], lw=1.6, label=c.reference)
        axes.plot(c.times_s, c.values, color=COLOURS[0], lw=0.8, label=c.channel)
        if np.isfinite(c.deviation):
            sides = c.values - c.deviation, c.values + c.deviation
            axes.fill_between(c.times_s, *sides, color=COLOURS[0], alpha=0.2, lw=0)
        axes.legend()
        yield f"reference {c.channel}", figure


def stabilisation(plt: Any, record: AnalysedRecord, found: Sequence[Modes]) -> Figures:
    """Yield the stabilisation diagram of each method."""
    for m in found:
        labels = {"xlabel": "frequency, Hz", "ylabel": "order of the model"}
        figure, axes = _chart(plt, f"stabilisation, {m.method}", **labels)
        for stable, colour, text in ((0, "#bbbbbb", "not stable"), (1, COLOURS[2], "stable")):
            own = m.diagram[m.diagram[:, 2] == stable]
            axes.plot(own[:, 1], own[:, 0], ".", color=colour, label=text)
        for mode in m.modes:
            axes.axvline(mode.frequency_hz.value, color=COLOURS[0], lw=0.8)
        axes.legend()
        yield f"stabilisation {m.method}", figure


def orders(plt: Any, record: AnalysedRecord, found: Sequence[OrderTrack]) -> Figures:
    """Yield the amplitudes of each channel's orders."""
    for name in dict.fromkeys(o.channel for o in found):
        yield f"orders {name}", _orders(plt, [o for o in found if o.channel == name])


def _orders(plt: Any, tracks: Sequence[OrderTrack]) -> Any:
    """Draw amplitudes over the speed if it changes, else over time."""
    first = tracks[0]
    is_steady = np.ptp(first.speed_rpm) < 0.01 * first.speed_rpm.mean()
    figure, axes = _chart(
        plt, first.channel, xlabel="time, s" if is_steady else "speed, rpm", ylabel=first.unit
    )
    for k, track in enumerate(tracks):
        x, label = track.times_s if is_steady else track.speed_rpm, f"order {track.order:g}"
        style = {"marker": ".", "lw": 0.8, "color": COLOURS[k % len(COLOURS)], "label": label}
        axes.errorbar(x, track.amplitudes, track.deviations, **style)
    axes.legend()
    return figure


def _spectrum(plt: Any, channel: Channel, own: Density, averaging: Averaging) -> Any:
    figure, (top, below) = plt.subplots(2, 1, figsize=(9, 6), layout="constrained")
    keep = own.freqs_hz > 0
    top.semilogy(own.freqs_hz[keep], own.density[keep], color=COLOURS[0])
    top.fill_between(own.freqs_hz[keep], own.low[keep], own.high[keep], color=COLOURS[0], alpha=0.25)
    if np.isfinite(own.noise):
        top.axhline(own.noise, color=COLOURS[0], ls=(0, (4, 3)), lw=1)
    top.set(xlabel="frequency, Hz", ylabel=f"({channel.unit})²/Hz")
    top.set_title(f"{channel.name}: {own.averages} averages, 95 % confidence; dashed: noise", loc="left")
    freqs, times, amplitude = waterfall_of(channel, averaging)
    floor = max(float(amplitude.max()) * 1e-4, 1e-300)
    level = 20 * np.log10(np.maximum(amplitude, floor))
    shown = below.pcolormesh(times, freqs, level, shading="nearest", cmap="viridis", rasterized=True)
    figure.colorbar(shown, ax=below, label=f"dB re 1 {channel.unit}")
    below.set(xlabel="time, s", ylabel="frequency, Hz")
    return figure


def _orbit(plt: Any, a: Channel, b: Channel) -> Any:
    figure, axes = plt.subplots(figsize=(5, 5), layout="constrained")
    x, y = (converted(c, c.quantity, None, 4)[0] for c in (a, b))
    axes.plot(x, y, lw=0.7, color=COLOURS[0])
    axes.set(xlabel=f"{a.name}, {a.unit}", ylabel=f"{b.name}, {b.unit}")
    axes.set_aspect("equal", adjustable="datalim")
    return figure
