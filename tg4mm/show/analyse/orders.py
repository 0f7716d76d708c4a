"""Order tracking: how a channel moves at multiples of a machine's speed, which may change during the record.

The speed gives the shaft's angle θ at every sample. In each segment cosines and sines of k θ, for all orders k
together, are fitted by least squares with a constant and a trend. This also resolves orders that a changing speed
smears over a spectrum. The residual counts as noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import PchipInterpolator

from tg4mm.show.analyse.channel import Channel
from tg4mm.show.analyse.quantities import Value
from tg4mm.show.analyse.tables import AnalyseError, read_table
from tg4mm.show.analyse.transfer import Averaging

_HIGHEST = 0.45  # of the frame rate: orders beyond it are left out
_TURNS = 3.0  # in a segment, at least
_USUAL = 6  # orders by default
_PULSES = 4  # at least
_ABSURD = 1e7  # revolutions per minute


@dataclass(frozen=True)
class Speed:
    """A shaft's speed over a record."""

    source: str  # its origin, in words
    angle: np.ndarray  # [T] rad, rising
    turns_hz: np.ndarray  # [T]


@dataclass(frozen=True)
class OrderTrack:
    """One order of one channel; amplitudes zero to peak, nan where the order is too fast for the frame rate."""

    channel: str
    unit: str
    order: float
    amplitude: Value  # over the complete record
    phase: Value  # rad, of a cosine of the shaft's angle, which is 0 at the record's start or a pulse
    times_s: np.ndarray  # [S] middles of segments
    speed_rpm: np.ndarray  # [S]
    amplitudes: np.ndarray  # [S]
    deviations: np.ndarray  # [S]


def speed_of(channel: Channel, text: str | None, tacho: Path | None) -> Speed:
    """Return the speed from revolutions per minute, `auto` (the channel's strongest line), or a tachometer's CSV file.

    The file has the film's times. Raises AnalyseError if there is no speed for the complete record.
    """
    times = channel.times_s
    if tacho is not None:
        return _of_tacho(tacho, times)
    if text == "auto":
        if not channel.lines:
            raise AnalyseError(
                f"--speed auto: no line exceeds the noise of {channel.name}; give revolutions per minute"
            )
        hz, source = channel.lines[0].hz, f"the strongest line of {channel.name}"
    else:
        try:
            rpm = float(text or "")
        except ValueError:
            raise AnalyseError(f"--speed {text!r}, expected revolutions per minute, or auto") from None
        if not 0 < rpm < _ABSURD:
            raise AnalyseError(f"--speed {text}, expected revolutions per minute above 0")
        hz, source = rpm / 60, "--speed"
    return Speed(source, 2 * np.pi * hz * (times - times[0]), np.full(len(times), hz))


def _of_tacho(path: Path, times: np.ndarray) -> Speed:
    """Read a file with the column pulse_s, or time_s and speed_rpm."""
    head, table = read_table(path)
    head = [name.strip().lower() for name in head]
    if head not in (["pulse_s"], ["time_s", "speed_rpm"]):
        raise AnalyseError(
            f"{path}: columns are {', '.join(head)}; expected pulse_s, a time for each turn, or time_s and speed_rpm"
        )
    if not np.isfinite(table).all():
        row = int(np.argwhere(~np.isfinite(table))[0, 0])
        raise AnalyseError(f"{path}, value {row + 1} of {len(table)}: is missing; leave its row out")
    own = table[:, 0]
    if len(own) < _PULSES or not (np.diff(own) > 0).all():
        raise AnalyseError(f"{path}: expected {_PULSES} or more times that increase")
    if own[0] > times[0] or own[-1] < times[-1]:
        raise AnalyseError(
            f"{path}: covers {own[0]:.4g} to {own[-1]:.4g} s, but the film runs from {times[0]:.4g} to "
            f"{times[-1]:.4g} s; the file must cover all of it"
        )
    if head[0] == "pulse_s":  # one a turn
        angle = PchipInterpolator(own, 2 * np.pi * np.arange(len(own)))
        return Speed(f"{path}, a pulse a turn", angle(times), angle(times, 1) / (2 * np.pi))
    rpm = np.interp(times, own, table[:, 1])
    if not (rpm > 0).all() or rpm.max() > _ABSURD:
        raise AnalyseError(
            f"{path}: revolutions per minute are {rpm.min():g} to {rpm.max():g}, expected above 0"
        )
    return Speed(str(path), 2 * np.pi * cumulative_trapezoid(rpm / 60, times, initial=0), rpm / 60)


def orders_of(
    channel: Channel, speed: Speed, orders: Sequence[float], averaging: Averaging | None = None
) -> list[OrderTrack]:
    """Track the orders; (): 1 to 6. Raises AnalyseError if segments hold too few turns to separate them."""
    length, shared = (averaging or Averaging()).cut(channel)
    wanted = np.array(sorted(orders) or range(1, _USUAL + 1), float)
    if not (wanted > 0).all() or (np.diff(wanted) <= 0).any():
        raise AnalyseError(
            f"--order {', '.join(f'{o:g}' for o in wanted)}: expected different numbers above 0"
        )
    apart = float(np.diff(np.concatenate([[0.0], wanted])).min())
    turns = float(np.ptp(speed.angle[:length])) / (2 * np.pi)
    if turns * apart < _TURNS:
        raise AnalyseError(
            f"{channel.name}: a segment of {length / channel.rate:.3g} s holds {turns:.3g} turns, expected "
            f"{_TURNS / apart:.3g} or more to separate the orders: give a longer --segment SECONDS"
        )
    highest, lowest = _HIGHEST * channel.rate, wanted[0] * speed.turns_hz.min()
    if lowest > highest:
        raise AnalyseError(
            f"{channel.name}: order {wanted[0]:g} lies at {lowest:.4g} Hz or above, beyond the {highest:.4g} Hz that "
            f"{channel.rate:.4g} pictures a second show"
        )
    phasors, deviations = _fit(channel, speed, wanted, slice(None), highest)
    parts = [slice(k, k + length) for k in range(0, len(channel.values) - length + 1, length - shared)]
    fits = [_fit(channel, speed, wanted, part, highest) for part in parts]
    times = np.array([channel.times_s[p].mean() for p in parts])
    rpm = 60 * np.array([speed.turns_hz[p].mean() for p in parts])
    out = []
    for k, order in enumerate(wanted.tolist()):
        amplitude = Value(float(abs(phasors[k])), float(deviations[k]))
        phase_error = float(min(amplitude.deviation / max(amplitude.value, 1e-300), np.pi))
        phase = Value(float(np.angle(phasors[k])), phase_error)
        tracked = np.array([[abs(p[k]), d[k]] for p, d in fits])
        out.append(OrderTrack(channel.name, channel.unit, order, amplitude, phase, times, rpm, *tracked.T))
    return out


def _fit(
    channel: Channel, speed: Speed, orders: np.ndarray, part: slice, highest_hz: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return phasors [K] and their deviations, nan for an order that exceeds `highest_hz` there."""
    t, angle, y = channel.times_s[part], speed.angle[part], channel.values[part]
    shown = orders * speed.turns_hz[part].max() <= highest_hz
    turned = np.outer(angle, orders[shown])
    middle = t - t.mean()
    design = np.column_stack([np.ones(len(t)), middle, np.cos(turned), np.sin(turned)])
    solution, *_ = np.linalg.lstsq(design, y, rcond=None)
    left = y - design @ solution
    noise = float(left @ left) / max(len(y) - design.shape[1], 1)
    noise = max(noise, float(np.nan_to_num(channel.noise)) ** 2)
    covariance = noise * np.linalg.pinv(design.T @ design)
    n = int(shown.sum())
    cosine, sine = solution[2 : 2 + n], solution[2 + n :]
    variance = np.diag(covariance)[2 : 2 + n], np.diag(covariance)[2 + n :]
    phasors, deviations = np.full(len(orders), np.nan + 0j), np.full(len(orders), np.nan)
    phasors[shown] = cosine - 1j * sine
    own = np.hypot(cosine, sine)
    along = (cosine**2 * variance[0] + sine**2 * variance[1]) / np.maximum(own**2, 1e-300)
    deviations[shown] = np.sqrt(along + (channel.share * own) ** 2)
    return phasors, deviations
