"""Systems of known answer: sums of sinusoids as channels, and one or two masses on springs."""

import numpy as np
from scipy.linalg import expm

from tg4mm.show.analyse import Channel

MASS_HZ, DAMPING = 8.0, 0.02  # of the one mass, 1 kg


def channel(values, rate, noise=0.0, seed=0, **how):
    """With white noise added and stated; displacement in mm unless said otherwise."""
    rng = np.random.default_rng(seed)
    named = {"name": "x", "quantity": "displacement", "base": "mm", "noise": noise or float("nan"), **how}
    times = how.pop("times_s", np.arange(len(values)) / rate)
    return Channel(times_s=times, values=values + noise * rng.normal(size=len(values)), **{**named, **how})


def receptance(hz):
    """mm / N of the one mass."""
    w, w0 = 2 * np.pi * hz, 2 * np.pi * MASS_HZ
    return 1000 / (w0**2 - w**2 + 2j * DAMPING * w0 * w)


def driven(force, rate):
    """[T] mm of the one mass under a force [T] N held from sample to sample, exactly."""
    w0 = 2 * np.pi * MASS_HZ
    return _run(np.array([[w0**2]]), np.array([[2 * DAMPING * w0]]), force[:, None], rate)[:, 0] * 1000


def two_masses(n, rate, seed):
    """Responses [n, 2] to white forces, frequencies [2] Hz, damping ratios [2] and shapes [2, 2] in columns."""
    stiffness = np.array([[2.0, -1.0], [-1.0, 1.0]]) * (2 * np.pi * 6) ** 2
    squares, shapes = np.linalg.eigh(stiffness)
    w, ratios = np.sqrt(squares), np.array([0.01, 0.02])
    damping = shapes @ np.diag(2 * ratios * w) @ shapes.T
    up, rng = 4, np.random.default_rng(seed)
    out = _run(stiffness, damping, rng.normal(size=((n + 600) * up, 2)), rate * up)[600 * up :: up]
    return out / out.std(), w / 2 / np.pi, ratios, shapes


def _run(stiffness, damping, forces, rate):
    n = len(stiffness)
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping]])
    step = expm(a / rate)
    inputs = np.linalg.solve(a, (step - np.eye(2 * n)) @ np.vstack([np.zeros((n, n)), np.eye(n)]))
    x, out = np.zeros(2 * n), np.empty_like(forces)
    for k, pushed in enumerate(forces @ inputs.T):
        out[k] = x[:n]
        x = step @ x + pushed
    return out


def inside(scores):
    """Share within one deviation."""
    return float((np.abs(scores) < 1).mean())
