"""The extension, registered in pip's Blender, and a small splat file that moves."""

import importlib

import numpy as np
import pytest

from tg4mm.core.splatfile import SplatFile, write_splat


@pytest.fixture
def extension(monkeypatch):
    """addon/, registered in an empty scene. Imports draw ellipsoids."""
    bpy = pytest.importorskip("bpy", reason="needs pip's Blender: pip install '.[generate]'")
    module = importlib.import_module("addon")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    module.register()
    monkeypatch.setattr(module.preferences.TG4MM_defaults, "draw_as", "Ellipsoids")
    yield module
    module.unregister()
    bpy.ops.wm.read_factory_settings(use_empty=True)


def some_splat(n=23, freqs_hz=(3.0, 5.0, 7.5), degree=1):
    """Random Gaussians that move and turn at several frequencies, fps 24."""
    rng = np.random.default_rng(4)
    m = len(freqs_hz)

    def phasors(size):
        return (size * (rng.normal(size=(m, n, 3)) + 1j * rng.normal(size=(m, n, 3)))).astype(np.complex64)

    quats = rng.normal(size=(n, 4))
    means, quats = rng.normal(size=(n, 3)), quats / np.linalg.norm(quats, axis=1, keepdims=True)
    scales, opacities = rng.uniform(0.01, 0.2, (n, 3)), rng.uniform(0.0, 1.0, n)
    rest = (means, quats, scales, opacities, rng.normal(size=(n, (degree + 1) ** 2, 3)))
    moving = (np.array(freqs_hz, dtype=np.float64), phasors(0.05), phasors(0.1))
    return SplatFile(*(part.astype(np.float32) for part in rest), *moving, fps=24.0, n_timesteps=48)


@pytest.fixture
def splat_path(tmp_path):
    """`some_splat`, written."""
    write_splat(tmp_path / "bell.ply", some_splat())
    return tmp_path / "bell.ply"
