"""Gaussians as a mesh of loose vertices: rest positions, and all else as attributes the node tree names."""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import compat, names
from ..core.splatfile import SplatFile
from . import colours

# A thinner ellipsoid cannot be inverted in float32, which the splat material needs.
THINNEST = 1e-4  # of the longest axis
SMALLEST = 1e-7  # scene units


def fill_mesh(mesh: Any, splat: SplatFile) -> None:
    """Fill an empty mesh; the view-dependent coefficients only where there are any."""
    mesh.vertices.add(len(splat))
    mesh.vertices.foreach_set("co", _flat(splat.means))
    quats = splat.quats / np.linalg.norm(splat.quats, axis=1, keepdims=True)
    _attribute(mesh, names.SCALE, "FLOAT_VECTOR", "vector", drawable_scales(splat.scales))
    _attribute(mesh, names.ROTATION, "QUATERNION", "value", quats)
    _attribute(mesh, names.COLOUR, "FLOAT_COLOR", "color", colours.rest_colours(splat.sh))
    _attribute(mesh, names.OPACITY, "FLOAT", "value", splat.opacities)
    mesh.color_attributes.active_color = mesh.color_attributes[names.COLOUR]
    for k in range(splat.sh.shape[1] if splat.sh_degree else 0):
        _attribute(mesh, names.sh(k), "FLOAT_VECTOR", "vector", splat.sh[:, k])
    if compat.native_splats():
        for name, values in native_attributes(splat).items():
            kind, field = (
                ("FLOAT_COLOR", "color") if name == names.NATIVE_BASE else ("FLOAT_VECTOR", "vector")
            )
            _attribute(mesh, name, kind, field, values)
    for k in range(splat.n_modes):
        part, d, r = names.phasor(k), splat.displacement[k], splat.rotation[k]
        for key, values in (("re", d.real), ("im", d.imag), ("re_r", r.real), ("im_r", r.imag)):
            _attribute(mesh, part[key], "FLOAT_VECTOR", "vector", values)
        amplitude, phase = strength(d, main_axis(d))
        _attribute(mesh, names.amplitude(k), "FLOAT", "value", amplitude)
        _attribute(mesh, names.phase(k), "FLOAT", "value", phase)
        if splat.deviation is not None:
            _attribute(mesh, names.deviation(k), "FLOAT", "value", splat.deviation[k])
    # New points come selected; the probe reads what a person selects.
    mesh.vertices.foreach_set("select", np.zeros(len(splat), bool))
    mesh.update()


def native_attributes(splat: SplatFile) -> dict[str, np.ndarray]:
    """What Blender 5.3's own splats read besides position, scale and rotation: [N, 4] raw f_dc and opacity, and
    [N, 3] for each further coefficient, as in the file.

    Blender's own import writes the first as FLOAT4. It draws FLOAT_COLOR alike, which nodes can write too."""
    base = np.concatenate([splat.sh[:, 0], splat.opacities[:, None]], axis=1)
    return {names.NATIVE_BASE: base} | {
        names.native_sh(k): splat.sh[:, k] for k in range(1, splat.sh.shape[1])
    }


def drawable_scales(scales: np.ndarray) -> np.ndarray:
    """[N, 3] scales with none thinner than can be drawn."""
    return np.maximum(scales, np.maximum(scales.max(axis=1, keepdims=True) * THINNEST, SMALLEST))


def main_axis(phasors: np.ndarray) -> np.ndarray:
    """[3] unit vector along which phasors [N, 3] move most; its largest component is positive."""
    parts = np.concatenate([phasors.real, phasors.imag]).astype(np.float64)
    axis = np.linalg.eigh(parts.T @ parts)[1][:, -1]
    return axis * np.sign(axis[np.argmax(np.abs(axis))])


def strength(phasors: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest displacement [N] (scene units) and phase [N] (turns, 0 to 1) of complex phasors [N, 3].

    Re[m exp(iωt)] runs round an ellipse; its long half is the amplitude, √((|m|² + |m·m|) / 2), reached in
    the direction Re[m exp(−iψ)], ψ = arg(m·m)/2. Of the two ends the one on the side of `axis` is meant, so
    that two points have the same phase when they move to the same side at the same time.
    """
    m = phasors.astype(np.complex128)
    square = (m * m).sum(axis=1)
    amplitude = np.sqrt(((np.abs(m) ** 2).sum(axis=1) + np.abs(square)) / 2)
    psi = np.angle(square) / 2
    away = (m * np.exp(-1j * psi)[:, None]).real @ axis < 0
    return amplitude, (psi / (2 * np.pi) + 0.5 * away) % 1.0


def _attribute(mesh: Any, name: str, data_type: str, field: str, values: np.ndarray) -> None:
    mesh.attributes.new(name, data_type, "POINT").data.foreach_set(field, _flat(values))


def _flat(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=np.float32).ravel()
