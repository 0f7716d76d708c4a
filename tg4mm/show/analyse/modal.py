"""Modal parameters by libraries: SSI-cov and FDD (pyOMA-2) from responses, LSCF (sdypy-EMA) from transfer functions."""

import contextlib
import io
import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tg4mm.core.extras import install
from tg4mm.show.analyse.channel import AnalyseError, Channel
from tg4mm.show.analyse.quantities import Value
from tg4mm.show.analyse.transfer import Transfer

_ORDERS = 30  # of the models, at most
_LAGS = 20  # block rows
_SHARE = 1 / 3  # of the orders that can hold a mode: so often it must be stable
_NEAR = 0.03  # of a frequency: nearer poles belong to one mode
_STABLE_HZ, _STABLE_DAMPING = 0.01, 0.10  # of a pole from one order to the next
_MOST_DAMPING = 0.2
_SURE = 0.02  # of a frequency: a less certain mode is dropped
_END = 0.1  # of the frequencies, the last ones
_DRAWS = 24


@dataclass(frozen=True)
class FittedMode:
    """A mode: `shape` is 1 at its largest channel, `mac` compares it with the other method's shape, if there is one."""

    frequency_hz: Value
    damping: Value
    shape: np.ndarray  # [C] complex
    mac: float | None = None


@dataclass(frozen=True)
class Modes:
    """The modes found by a method; the diagram's poles are rows (order, Hz, 1 if stable)."""

    method: str
    channels: tuple[str, ...]
    modes: tuple[FittedMode, ...]
    diagram: np.ndarray  # [P, 3]


def mac(a: np.ndarray, b: np.ndarray) -> float:
    """Return the modal assurance criterion of two shapes [C]: 1 if they differ only by a factor."""
    return float(abs(np.vdot(a, b)) ** 2 / max(np.vdot(a, a).real * np.vdot(b, b).real, 1e-300))


def operational(channels: Sequence[Channel], band: tuple[float, float] | None = None) -> Modes:
    """Identify modes by SSI-cov from channels on one clock, with its uncertainties; compare shapes with FDD's."""
    with _library("pyOMA-2"):
        from pyoma2.algorithms import FDD, SSI
        from pyoma2.setup import SingleSetup
    first = channels[0]
    if any(not np.array_equal(c.times_s, first.times_s) for c in channels):
        raise AnalyseError(
            "--modes: the channels were not sampled at the same times; choose channels of one recording with --channel"
        )
    if len(first.values) < 20 * _LAGS:
        raise AnalyseError(f"--modes: {len(first.values)} samples, expected {20 * _LAGS} or more")
    lo, hi = band or (2 / first.duration_s, first.rate / 2)
    values = np.stack([c.values - c.values.mean() for c in channels], 1)
    values = values / np.maximum(values.std(0), 1e-300)
    scale = np.array([c.values.std() for c in channels])
    order = min(_ORDERS, _LAGS * len(channels) - 1)
    with _quiet():
        setup = SingleSetup(values, fs=first.rate)
        ssi: Any = SSI(name="ssi", br=_LAGS, ordmax=order, calc_unc=True, method="cov")
        fdd: Any = FDD(name="fdd", nxseg=min(1024, len(values) // 4))
        setup.add_algorithms(ssi, fdd)
        setup.run_all()
    r = ssi.result
    number = np.broadcast_to(np.arange(r.Fn_poles.shape[1]), r.Fn_poles.shape)
    known = np.isfinite(r.Fn_poles) & (r.Fn_poles >= lo) & (r.Fn_poles <= hi)
    good = known & (r.Lab == 1) & (r.Fn_poles_std < _SURE * r.Fn_poles)
    diagram = np.stack([number[known], r.Fn_poles[known], good[known]], 1)
    modes = []
    for own in _clusters(r.Fn_poles[good], number[good]):
        f, z, shape = r.Fn_poles[good][own], r.Xi_poles[good][own], r.Phi_poles[good][own]
        sure, sure_z = r.Fn_poles_std[good][own], r.Xi_poles_std[good][own]
        k = int(np.argsort(f)[len(f) // 2])
        hz = Value(float(np.median(f)), float(np.hypot(np.median(sure), f.std())))
        damping = Value(float(np.median(z)), float(np.hypot(np.median(sure_z), z.std())))
        with _quiet():
            fdd.mpe(sel_freq=[hz.value], DF=max(0.05 * hz.value, 2 * first.rate / fdd.run_params.nxseg))
        other = fdd.result.Phi[:, 0]
        modes.append(FittedMode(hz, damping, _scaled(shape[k] * scale), mac(shape[k], other)))
    names = tuple(c.name for c in channels)
    return Modes("SSI-cov", names, tuple(sorted(modes, key=lambda m: m.frequency_hz.value)), diagram)


def from_transfers(transfers: Sequence[Transfer], band: tuple[float, float] | None = None) -> Modes:
    """Identify modes by LSCF from transfer functions to one input; deviations from draws of the functions' errors.

    A mode in the last tenth of the frequencies has no deviation.
    """
    with _library("sdypy-EMA"):
        from sdypy import EMA
    first = transfers[0]
    hz = first.freqs_hz
    lo, hi = band or (float(hz[0]), float(hz[-1]))
    h, sure = (np.stack([getattr(t, name) for t in transfers]) for name in ("h1", "deviation"))
    sure = np.where(np.isfinite(sure), np.minimum(sure, np.abs(h)), np.abs(h)) / np.sqrt(2)
    order = min(_ORDERS, len(hz) // 4)
    if order < 4:
        raise AnalyseError(
            f"--modes: {len(hz)} frequencies in the band, expected 16 or more: longer segments have more"
        )

    def fitted(values: np.ndarray) -> tuple:
        with _quiet():
            model = EMA.Model(
                values, hz, lower=lo, upper=float(hz[-1]), pol_order_high=order, frf_form="receptance"
            )
            model.get_poles("lscf", show_progress=False)
        return model, *_stable(model.pole_freq, model.pole_xi, lo, hi)

    model, diagram, poles = fitted(h)
    rng, draws = np.random.default_rng(0), []
    for _ in range(_DRAWS if poles else 0):
        noise = sure * (rng.normal(size=h.shape) + 1j * rng.normal(size=h.shape))
        draws.append(fitted(h + noise)[2])
    modes = []
    for f, z, *scatter in poles:
        near = [min(d, key=lambda p: abs(p[0] - f)) for d in draws if d]
        own = np.array([p for p in near if abs(p[0] - f) < _NEAR * f])
        spread = own.std(0, ddof=1) if len(own) > _DRAWS // 2 else np.array([np.nan, np.nan])
        with _quiet():
            model.select_closest_poles([f], f_window=max(1, round(0.05 * f / (hz[1] - hz[0]))))
            constants = model.get_constants()[1]
        shape = _scaled(np.asarray(constants)[:, 0])
        if f > (1 - _END) * hz[-1]:  # modes beyond the range bias it, which no draw shows
            spread = np.array([np.nan, np.nan])
        sure, sure_z = np.hypot(spread[:2], scatter).tolist()
        modes.append(FittedMode(Value(f, sure), Value(z, sure_z), shape))
    return Modes("LSCF", tuple(t.response for t in transfers), tuple(modes), diagram)


def _stable(hz: list, xi: list, lo: float, hi: float) -> tuple[np.ndarray, list[tuple[float, ...]]]:
    """Return the diagram's poles, and frequency, damping and their scatter of poles that stay as the order grows."""
    rows, before = [], np.zeros((0, 2))
    for order, (f, z) in enumerate(zip(hz, xi, strict=True), 1):
        f, z = np.asarray(f), np.asarray(z)
        real = (f >= lo) & (f <= hi) & (z > 0) & (z < _MOST_DAMPING)
        own = np.stack([f[real], z[real]], 1)
        for pole in own:
            near = (np.abs(before - pole) < np.array([_STABLE_HZ, _STABLE_DAMPING]) * pole).all(1)
            rows.append((order, pole[0], float(near.any()), pole[1]))
        before = own
    table = np.array(rows, float).reshape(-1, 4)
    good = table[table[:, 2] > 0]
    found = [good[own][:, [1, 3]] for own in _clusters(good[:, 1], good[:, 0])]
    return table[:, :3], [(*np.median(own, axis=0).tolist(), *own.std(0).tolist()) for own in found]


def _clusters(hz: np.ndarray, order: np.ndarray) -> list[np.ndarray]:
    """Return the indices of each mode's poles: near each other, at many orders from their first one on."""
    if not len(hz):
        return []
    rows = np.argsort(hz)
    groups = np.split(rows, 1 + np.flatnonzero(np.diff(hz[rows]) > _NEAR * hz[rows][:-1]))
    least = [max(3, _SHARE * (order.max() - order[own].min() + 1)) for own in groups]
    return [own for own, n in zip(groups, least, strict=True) if len(np.unique(order[own])) >= n]


def _scaled(shape: np.ndarray) -> np.ndarray:
    return np.asarray(shape / shape[int(np.abs(shape).argmax())])


@contextlib.contextmanager
def _library(name: str) -> Iterator[None]:
    try:
        yield
    except ModuleNotFoundError:
        raise AnalyseError(f"--modes needs {name}: {install('modal')}") from None


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Suppress the libraries' progress bars, prints and log."""
    import warnings

    logging.getLogger("pyoma2").setLevel(logging.WARNING)
    with (
        contextlib.redirect_stderr(io.StringIO()),
        contextlib.redirect_stdout(io.StringIO()),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        yield
