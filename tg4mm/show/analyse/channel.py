"""Channels: one value on an even clock with its unit and noise, from a measurement's folder or from a CSV file."""

import logging
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from tg4mm.core.even_clock import LONGEST, is_filled, on_even_clock, unrounded
from tg4mm.core.lines import Line, find_lines
from tg4mm.core.untrusted import read_json
from tg4mm.show.analyse.tables import FEWEST, TIME_UNITS, AnalyseError, read_table, timed
from tg4mm.show.analyse.universal import is_universal, waveforms

G = 9806.65  # mm/s²
DISPLACEMENT, VELOCITY, ACCELERATION, FORCE, OTHER = (
    "displacement", "velocity", "acceleration", "force", "other",
)  # fmt: skip
ORDER = {DISPLACEMENT: 0, VELOCITY: 1, ACCELERATION: 2}  # times differentiated
_LENGTHS = {
    "m": ("mm", 1e3), "cm": ("mm", 10.0), "mm": ("mm", 1.0), "um": ("mm", 1e-3), "micron": ("mm", 1e-3),
    "microns": ("mm", 1e-3), "nm": ("mm", 1e-6), "in": ("mm", 25.4), "inch": ("mm", 25.4), "mil": ("mm", 0.0254),
    "mils": ("mm", 0.0254), "ft": ("mm", 304.8), "px": ("px", 1.0), "pixel": ("px", 1.0), "pixels": ("px", 1.0),
}  # fmt: skip
_OTHERS = {
    "g": (ACCELERATION, "mm", G), "mg": (ACCELERATION, "mm", G / 1000), "ug": (ACCELERATION, "mm", G / 1e6),
    "ips": (VELOCITY, "mm", 25.4), "n": (FORCE, "N", 1.0), "kn": (FORCE, "N", 1e3), "v": (OTHER, "V", 1.0),
}  # fmt: skip
# what a column's unit says: quantity, unit of the program, how many of it
_UNITS = _OTHERS | {
    f"{length}{per}": (quantity, base, factor)
    for length, (base, factor) in _LENGTHS.items()
    for per, quantity in (("", DISPLACEMENT), ("/s", VELOCITY), ("/s2", ACCELERATION))
}
_LOG = logging.getLogger("tg4mm")
_RESOLVED = 10.0  # times as uncertain as the best axis: beyond it an axis is left out
_PLAIN = {"²": "2", "⁻": "-", "¹": "1", "^": "", "*": "", "µ": "u", "μ": "u", "·": " ", "sec": "s"}
_KINDS = {8: DISPLACEMENT, 9: FORCE, 11: VELOCITY, 12: ACCELERATION}  # specific data types of dataset 58


@dataclass(frozen=True)
class Channel:
    """One value on an even clock.

    `noise` is the standard deviation of each sample's independent noise, `share` that of errors over the motion.
    """

    name: str
    quantity: str
    base: str  # mm, px, units, N, V: the unit of a displacement
    times_s: np.ndarray  # [T] even
    values: np.ndarray  # [T]
    noise: float = float("nan")  # nan: not stated
    share: float = 0.0

    @property
    def rate(self) -> float:
        """Samples a second."""
        return float((len(self.times_s) - 1) / np.ptp(self.times_s))

    @property
    def duration_s(self) -> float:
        """Duration including the last sample's step."""
        return len(self.times_s) / self.rate

    @property
    def unit(self) -> str:
        """The unit of the values."""
        return unit_of(self.quantity, self.base)

    @cached_property
    def lines(self) -> tuple[Line, ...]:
        """The channel's lines, at most eight, strongest first."""
        arrays = (np.ascontiguousarray(a, np.float64).tobytes() for a in (self.values, self.times_s))
        return _lines_of(*arrays, float(np.nan_to_num(self.noise)))


@lru_cache(maxsize=8)
def _lines_of(values: bytes, times_s: bytes, noise: float) -> tuple[Line, ...]:
    """Return the lines of a record; an instrument's are found once, whatever it is compared with."""
    return find_lines(np.frombuffer(values), np.frombuffer(times_s), noise).lines


def unit_of(quantity: str, base: str) -> str:
    """Return the unit of a quantity: mm, mm/s, mm/s², and so on."""
    return base + ("", "/s", "/s²")[ORDER.get(quantity, 0)]


def read_channels(path: Path, names: Sequence[str] = ()) -> list[Channel]:
    """Read the channels of a folder of `tg4mm measure`, a CSV file with a column of times, or a universal file.

    names: only these. Channels of a measurement are called SENSOR/AXIS. An axis ten times as uncertain as the best one
    and without significant motion is left out unless named. Raises AnalyseError for anything else, and for an unknown
    name.
    """
    if not path.exists():
        raise AnalyseError(f"{path} does not exist")
    if path.is_file():
        found = _of_uff(path) if is_universal(path) else _of_csv(path)
    else:
        found = _of_folder(path, bool(names))
    by_name = {c.name: c for c in found}
    for name in names:
        if name not in by_name:
            raise AnalyseError(f"--channel {name!r} is not in {path}; channels: {', '.join(by_name)}")
    return [by_name[name] for name in names] if names else found


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Turn Python's errors about a damaged measure.json into AnalyseError."""
    try:
        yield
    except (AttributeError, IndexError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise AnalyseError(f"{path / 'measure.json'} is not a readable measurement: {error!r}") from None


def _of_folder(path: Path, every: bool) -> list[Channel]:
    if not (path / "measure.json").is_file():
        raise AnalyseError(f"{path} is neither a CSV file nor a folder of tg4mm measure")
    with readable(path):
        content = read_json(path / "measure.json")
        out = [
            channel for sensor in content["sensors"] for s in sensor["series"]
            for channel in _of_series(content, sensor, s, every)
        ]  # fmt: skip
    if not out:
        raise AnalyseError(
            f"{path}: no sensor could measure motion in any direction; choose sensors on visible, textured surfaces "
            "and measure again"
        )
    return out


def length_of(content: Any, sensor: Any) -> tuple[str, float]:
    """Return the unit of a sensor's lengths and its number per scene unit: mm, or pixels of the best view."""
    if str(content["printed_unit"]) == "mm":
        return "mm", 1000.0 * float(content["unit_scale_m"] or 0)
    return "px", float(sensor["px_per_unit"])


def _of_series(content: Any, sensor: Any, series: Any, every: bool) -> list[Channel]:
    base, factor = length_of(content, sensor)
    noise = np.array([np.inf if v is None else v for v in series["noise"]], float)
    values = np.array([[0 if v is None else v for v in row] for row in series["displacement"]], float)
    # of noise alone the mean power scatters by √(2/T)
    moves = values.var(axis=0) > noise**2 * (1 + 5 * np.sqrt(2 / max(len(values), 1)))
    keep = np.isfinite(noise) & (every | moves | (noise <= _RESOLVED * noise.min()))
    clock, out = series["clock"], []
    for k in np.flatnonzero(keep):
        name = "/".join(filter(None, [sensor["name"], clock, list(series["axes"])[k]]))
        times, own = _even(np.array(series["times_s"], float), values[:, k] * factor, name)
        share = float(np.hypot(series["model_share"][k], _taken(sensor["peaks"], k)))
        out.append(Channel(name, DISPLACEMENT, base, times, own, noise[k] * factor, share))
    return out


def _taken(peaks: Any, axis: int) -> float:
    """Return the share of motion along an axis that compression may have changed, averaged by the peaks' power."""
    known = [
        (p["codec_gain"], p["codec_gain_deviation"], p["amplitude"][axis], p.get("codec_is_made", False))
        for p in peaks
        if p.get("codec_gain")
    ]
    gain, sure, size, is_made = np.array(known, float).reshape(-1, 4).T
    power = size**2
    missing = np.where(is_made, 1 / gain - 1, np.maximum(1 / gain - 1, 0)) ** 2 + (sure / gain**2) ** 2
    return float(np.sqrt(power @ missing / power.sum())) if power.sum() > 0 else 0.0


def doubts_of(path: Path) -> list[str]:
    """Return a line for each peak in a measurement's folder that compression changed by an unknown amount."""
    if path.is_file():
        return []
    with readable(path):
        peaks = [(s["name"], p) for s in read_json(path / "measure.json")["sensors"] for p in s["peaks"]]
    return [
        f"{name} at {p['frequency_hz']:.4g} Hz: {p['codec_mark']}; its levels are "
        f"{'upper' if p.get('codec_is_made') else 'lower'} bounds"
        for name, p in peaks
        if p.get("codec_mark")
    ]


def _of_csv(path: Path) -> list[Channel]:
    names, table = read_table(path)
    head = [_column(text) for text in names]
    plain = [(name, _plain_unit(unit)) for name, unit in head]
    noise = {
        name.removesuffix(" deviation"): k for k, (name, _) in enumerate(head) if name.endswith(" deviation")
    }
    out, said = list[Channel](), set[str]()
    for k, (own_times, own) in timed(path, plain, table).items():
        name, unit = head[k]
        if name.endswith(" deviation"):
            continue
        times, values = _even(own_times, own, str(path))
        if values is not own and (why := _resampling(own_times, times, len(table))) not in said:
            _LOG.warning(f"{path}: {why}")
            said.add(why)
        quantity, base, factor = _UNITS.get(plain[k][1], (OTHER, unit or "1", 1.0))
        sure = (
            float(np.sqrt(np.nanmean(table[:, noise[name]] ** 2)) * factor) if name in noise else float("nan")
        )
        out.append(Channel(name or f"column {k + 1}", quantity, base, times, values * factor, sure))
    if not out:
        raise AnalyseError(f"{path} has a column of times and no other")
    return out


def _resampling(own: np.ndarray, even: np.ndarray, rows: int) -> str:
    """Return the warning for a column with uneven times, or with values missing in some rows."""
    rate = (len(even) - 1) / float(np.ptp(even))
    lacks = f"{rows - len(own)} of {rows} values are missing" if len(own) < rows else "its times are not even"
    return (
        f"{lacks}; steps are {np.diff(own).min():.4g} to {np.diff(own).max():.4g} s: resampled at {rate:.6g} Hz "
        f"by cubic splines, which are good up to {rate / 3:.4g} Hz"
    )


def _of_uff(path: Path) -> list[Channel]:
    found = waveforms(path)
    deviations = {one.name: one.values for one in found if one.is_deviation}
    out: list[Channel] = []
    for one in found:
        if one.is_deviation or not np.ptp(one.values) > 0:
            continue
        kind = _KINDS.get(one.kind, OTHER)
        known = _UNITS.get("m" if one.unit == "metres" else _plain_unit(one.unit))
        if known is None and one.unit in ("", "NONE") and kind != OTHER:
            known = (kind, "N", 1.0) if kind == FORCE else (kind, "mm", 1e3 * one.metres)
        quantity, base, factor = known or (
            kind,
            "units" if kind in ORDER else one.unit.replace("NONE", "") or "1",
            1.0,
        )
        times, values = _even(one.times_s, one.values, f"{path}: {one.name}")
        sure = deviations.get(one.name)
        noise = float("nan") if sure is None else float(np.sqrt((sure**2).mean())) * factor
        count = sum(c.name.partition(" (")[0] == one.name for c in out)
        name = f"{one.name} ({count + 1})" if count else one.name
        out.append(Channel(name, quantity, base, times, values * factor, noise))
    if not out:
        raise AnalyseError(f"{path}: all waveforms are constant")
    return out


def _plain_unit(text: str) -> str:
    """Return a unit in small letters, m/s2 for m/s^2, m/s/s, m·s⁻² and m s-2."""
    text = text.strip().lower()
    for form, plain in _PLAIN.items():
        text = text.replace(form, plain)
    text = re.sub(r"/s/s$|[ .]?s-2$", "/s2", text)
    return re.sub(r"(?<=[a-z])[ .]?s-1$", "/s", text)


def _column(text: str) -> tuple[str, str]:
    """Return name and unit of "acc [m/s²]", "acc (g)", "acc_m_per_s2" or "time_s"."""
    text = text.strip()
    if found := re.fullmatch(r"(.*?)\s*[\[(]([^\])]*)[\])]\s*(deviation)?", text):
        name, unit = " ".join(filter(None, found.group(1, 3))), found.group(2)
    elif found := re.fullmatch(r"(.+?)_((?:[a-zA-Zµ]+_per_)?[a-zA-Zµ]+2?)(_deviation)?", text):
        name, unit = (
            found.group(1) + (found.group(3) or "").replace("_", " "),
            found.group(2).replace("_per_", "/"),
        )
        if unit.lower() not in {*_UNITS, *TIME_UNITS}:
            name, unit = text, ""
    else:
        name, unit = text, ""
    return name, unit.strip()


def _even(times: np.ndarray, values: np.ndarray, what: str) -> tuple[np.ndarray, np.ndarray]:
    """Return times and values [T, ...] with even steps; missing ones are interpolated."""
    if len(times) < FEWEST:
        raise AnalyseError(f"{what}: {len(times)} samples, expected {FEWEST} or more")
    if (even := unrounded(times)) is not None:
        return even, values
    steps = np.diff(times)
    if not (steps > 0).all():
        raise AnalyseError(f"{what}: times do not increase at {times[int(np.argmin(steps > 0))]:g} s")
    if not is_filled(times):
        raise AnalyseError(
            f"{what}: times have gaps, their steps are {steps.min():.4g} to {steps.max():.4g} s; expected "
            f"{LONGEST:g} times the usual one at most: cut the record there"
        )
    return on_even_clock(times, values)
