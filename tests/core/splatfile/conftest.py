"""Splat files of random content, and PLY files put together by hand."""

from dataclasses import fields

import numpy as np

from tg4mm.core.splatfile import SplatFile

NAMES = [*"xyz", *(f"f_dc_{i}" for i in range(3)), "opacity"]


def random_splat(seed=0, n=5, k=4, m=2, fps=30.0, n_timesteps=30, unit_scale_m=0.5, deviation=False):
    """A moving scene of N Gaussians and M modes."""
    rng = np.random.default_rng(seed)

    def normal(*shape):
        return rng.normal(size=shape).astype(np.float32)

    def phasors():
        return (normal(m, n, 3) + 1j * normal(m, n, 3)).astype(np.complex64)

    return SplatFile(
        means=normal(n, 3),
        quats=normal(n, 4),
        scales=np.exp(normal(n, 3) - 4),
        opacities=rng.uniform(0.01, 0.99, n).astype(np.float32),
        sh=normal(n, k, 3),
        freqs_hz=rng.uniform(0.5, 14, m),
        displacement=phasors(),
        rotation=phasors() * np.float32(0.1),
        fps=fps,
        n_timesteps=n_timesteps,
        unit_scale_m=unit_scale_m,
        time_origin_s=0.25,
        deviation=np.abs(normal(m, n)) if deviation and m else None,
    )


def assert_same(a, b):
    """Every field equal: to the bit, but scales to 1e-5 of their size and opacities to 1e-7."""
    for name in (field.name for field in fields(SplatFile)):
        one, other = getattr(a, name), getattr(b, name)
        if name == "scales":
            np.testing.assert_allclose(one, other, rtol=1e-5, atol=0, err_msg=name)
        elif name == "opacities":
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-7, err_msg=name)
        elif isinstance(one, np.ndarray):
            assert one.dtype == other.dtype, name
            np.testing.assert_array_equal(one, other, err_msg=name)
        else:
            assert one == other, name


NAMES += [*(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]


def plain_ply(properties=None, count=2, data=None, before=(), after=(), head="binary_little_endian 1.0"):
    """A PLY by hand: vertex properties {name: (type, numpy type)}, header lines `before` and `after` them."""
    if properties is None:
        properties = dict.fromkeys(NAMES, ("float", "<f4"))
    if data is None:
        data = np.zeros(count, [(name, kind) for name, (_, kind) in properties.items()])
        for i, name in enumerate(properties):
            if data[name].dtype.kind == "f":
                data[name] = 0.25 * (i + 1) + np.arange(len(data))
        data = data.tobytes()
    lines = ["ply", f"format {head}", *before, f"element vertex {count}"]
    lines += [f"property {kind} {name}" for name, (kind, _) in properties.items()]
    return "\n".join([*lines, *after, "end_header\n"]).encode("latin-1") + data
