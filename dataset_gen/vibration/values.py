"""Values of a motion description and their checks (ValueError says what is wrong with one); laws of time.

A reader takes what YAML or JSON gave and returns the typed value, or raises ValueError whose text says what is
wrong with the value ("-3 is not a positive number"); the caller puts file, mode and key before it.

The convention of phases. A mode of shape s (complex displacement field, scaled to its amplitude)
and phase φ moves the rest point x by

    Re[ −i · e^{iφ} · s(x) · g(t) ]      t in timesteps, timestep 0 is the reference frame

with g(t) = exp(i 2π f t/fps) · exp(−(t/fps)/decay) for a vibration: at phase 0 a real shape goes as s · sin(2π f
t/fps), at rest at t = 0; and g(t) = i · t/fps for a drift, which goes as s · t/fps. The product −i · e^{iφ} · s is
the stored mode shape m, so that every displacement is Re Σ_k m_k g_k(t), and (1 + α) times mode k if it is magnified.
"""

import reprlib
from dataclasses import dataclass
from typing import Annotated, Any, Protocol

import numpy as np

from tg4mm.core.values import Number

Triple = tuple[float, float, float]
_LARGEST, _SMALLEST = 1e9, 1e-9  # what a length, time or frequency can sensibly be; float32 holds all of it
SINE = -1j  # Re[−i s exp(iωt)] = s sin ωt


def shown(value: object) -> str:
    """A value in a message, cut if long."""
    return " ".join(reprlib.repr(value).split())


def number(value: Any) -> float:
    """A finite number."""
    if isinstance(value, str) and _is_numeral(value):
        raise ValueError(f"{shown(value)} is text, not a number (YAML writes powers of ten as 5.0e-3)")
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{shown(value)} is not a number")
    if not abs(value) <= _LARGEST:  # nor is NaN; a whole number may be too large for a float
        raise ValueError(f"{shown(value)} is not a finite number within ±{_LARGEST:g}")
    return float(value)


def positive(value: Any) -> float:
    """A number above 0."""
    checked = number(value)
    if not checked >= _SMALLEST:
        raise ValueError(f"{value!r} is not a positive number" + (" ≥ 1e-9" if checked > 0 else ""))
    return checked


def truth_value(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{shown(value)} is neither true nor false")
    return value


def text(value: Any) -> str:
    """One line of text, not empty."""
    if not isinstance(value, str) or not value.strip() or not value.isprintable():
        raise ValueError(f"{shown(value)} is not a line of text")
    return value


def texts(value: Any) -> tuple[str, ...]:
    """A list of texts, or one text alone."""
    values = [value] if isinstance(value, str) else value
    if not isinstance(values, list) or not values:
        raise ValueError(f"{shown(value)} is not a list of names")
    return tuple(text(v) for v in values)


def vector(value: Any) -> Triple:
    """Three numbers."""
    x, y, z = _numbers(value, 3)
    return x, y, z


def direction(value: Any) -> Triple:
    """Three numbers, not all 0; any length."""
    checked = vector(value)
    if not max(abs(c) for c in checked) >= _SMALLEST:
        raise ValueError(f"{shown(value)} has no direction: it is zero")
    return checked


def pair_of_positive(value: Any) -> tuple[float, float]:
    _numbers(value, 2)
    return positive(value[0]), positive(value[1])


def whole(value: Any, low: int, high: int) -> int:
    if not Number(low, high, whole=True).fits(value):
        raise ValueError(f"{shown(value)} is not a whole number in {low} … {high}")
    return value


def _numbers(value: Any, count: int) -> list[float]:
    if not isinstance(value, list | tuple) or len(value) != count:
        raise ValueError(f"{shown(value)} is not a list of {count} numbers")
    return [number(v) for v in value]


def _is_numeral(value: str) -> bool:
    try:
        float(value)
    except ValueError:
        return False
    return True


Real = Annotated[float, number]
Positive = Annotated[float, positive]
MaybePositive = Annotated[float | None, positive]
Point = Annotated[Triple, vector]
Direction = Annotated[Triple, direction]
Text = Annotated[str, text]


class TimeLaw(Protocol):
    """The gain over time of a mode."""

    @property
    def frequency_hz(self) -> float:
        """0 if it does not oscillate."""

    def gain(self, timesteps: np.ndarray, fps: float) -> np.ndarray:
        """g at the given timesteps [T], complex128 [T]."""


@dataclass(frozen=True)
class DampedSinusoid:
    """A sinusoid, ringing down by 1/e every `decay_s` seconds if that is given."""

    frequency_hz: float
    decay_s: float | None = None

    def gain(self, timesteps: np.ndarray, fps: float) -> np.ndarray:
        t = np.asarray(timesteps, np.float64)
        # Whole turns are taken off first, so that equal phases give equal numbers at any t.
        g = np.exp(2j * np.pi * ((self.frequency_hz * t / fps) % 1.0))
        return g if self.decay_s is None else g * np.exp(-t / (fps * self.decay_s))


@dataclass(frozen=True)
class Ramp:
    """A linear growth: the shape is the displacement after one second."""

    @property
    def frequency_hz(self) -> float:
        return 0.0

    def gain(self, timesteps: np.ndarray, fps: float) -> np.ndarray:
        return 1j * np.asarray(timesteps, np.float64) / fps
