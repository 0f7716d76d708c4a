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
    return SplatFile(
        means=rng.normal(size=(n, 3)).astype(np.float32),
        quats=(quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        scales=rng.uniform(0.01, 0.2, (n, 3)).astype(np.float32),
        opacities=rng.uniform(0.0, 1.0, n).astype(np.float32),
        sh=rng.normal(size=(n, (degree + 1) ** 2, 3)).astype(np.float32),
        freqs_hz=np.array(freqs_hz, dtype=np.float64),
        displacement=phasors(0.05),
        rotation=phasors(0.1),
        fps=24.0,
        n_timesteps=48,
    )


@pytest.fixture
def splat_path(tmp_path):
    """`some_splat`, written."""
    write_splat(tmp_path / "bell.ply", some_splat())
    return tmp_path / "bell.ply"
