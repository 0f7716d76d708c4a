"""Reading a splat file, or any plain binary 3DGS PLY."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import SplatFileError
from . import layout
from .header import Element, Header, read_header
from .model import SH_COUNTS, SplatFile

ROWS_AT_ONCE = 8192  # keeps the block being taken apart in the processor's cache
MODE_NAME = re.compile(r"mode_[0-9]+_(re|im)_r?[xyz]")
GROUPS = (layout.POSITION, layout.F_DC, layout.OPACITY, layout.SCALE, layout.ROTATION)
REQUIRED = tuple(name for names in GROUPS for name in names)


def read_splat(path: str | Path) -> SplatFile:
    """Read a splat file, or a plain 3DGS PLY of degree 0 to 3. Needs numpy alone.

    Properties may come in any order, as float or double; unknown ones are ignored.

    Args:
        path: a binary little-endian PLY (docs/conventions.md, "Splat file").

    Returns:
        N Gaussians and their modes; of a plain 3DGS PLY no modes and fps 0 (unknown).

    Raises:
        SplatFileError: the file is truncated or too long, ASCII or big-endian, a property is missing, a count does not
            fit, a value is NaN or infinite, or the format version is unknown. One line with file and value.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            header = read_header(file)
            vertex = _check_size(header, os.fstat(file.fileno()).st_size)
            k, m = _check_properties(vertex, header.about)
            deviations = _deviations(vertex, m)
            file.seek(_offset(header, vertex))
            rest, modes = layout.f_rest(3 * (k - 1)), [layout.mode(i) for i in range(m)]
            *tables, deviation = _tables(file, vertex, [*GROUPS, rest, *modes, deviations])
        return _splat(tables, k, header.about or {}, deviation.T if deviations else None)
    except OSError as error:
        raise SplatFileError(f"{path}: cannot be read: {error.strerror or error}") from error
    except SplatFileError as error:
        raise SplatFileError(f"{path}: {error}") from error.__cause__


def _check_size(header: Header, actual: int) -> Element:
    """The vertex element, if the file is exactly as long as its header says."""
    vertices = [element for element in header.elements if element.name == "vertex"]
    if len(vertices) != 1:
        raise SplatFileError(f"header has {len(vertices)} vertex elements; expected 1")
    for element in header.elements:
        lists = [name for name, kind in element.properties.items() if kind == "list"]
        if lists and (element.count or element is vertices[0]):
            raise SplatFileError(
                f"element {element.name} has a list property, {lists[0]}; splat files have none"
            )
    if vertices[0].count == 0:
        raise SplatFileError("element vertex has 0 entries; expected at least one Gaussian")
    expected = header.nbytes + sum(element.nbytes for element in header.elements if element.count)
    if actual != expected:
        problem = "truncated" if actual < expected else "too long"
        raise SplatFileError(
            f"is {problem}: {actual} bytes, expected {expected} for {vertices[0].count} vertices"
        )
    return vertices[0]


def _check_properties(vertex: Element, about: dict | None) -> tuple[int, int]:
    """K, the SH coefficients a channel, and M, the modes, if every property they need is there."""
    names = vertex.properties
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        packed = " (compressed splats: export them uncompressed)" if "packed_position" in names else ""
        raise SplatFileError(f"property {missing[0]} is missing, {len(missing)} in all{packed}")
    n_rest = sum(name.startswith("f_rest_") for name in names)
    counts = [3 * (k - 1) for k in SH_COUNTS]
    if n_rest not in counts or any(name not in names for name in layout.f_rest(n_rest)):
        raise SplatFileError(f"has {n_rest} f_rest properties; expected f_rest_0 on, {counts} of them")
    n_mode = sum(MODE_NAME.fullmatch(name) is not None for name in names)
    m = 0 if about is None else len(about["frequencies_hz"])
    wanted = [name for k in range(m) for name in layout.mode(k)]
    if about is None and n_mode:
        raise SplatFileError(
            f"has {n_mode} mode properties but no 'comment tg4mm' line to give their frequencies"
        )
    if n_mode != len(wanted) or any(name not in names for name in wanted):
        raise SplatFileError(
            f"has {n_mode} mode properties; {m} frequencies_hz need {len(wanted)}, mode_0_re_x on"
        )
    used = (*REQUIRED, *layout.f_rest(n_rest), *wanted)
    whole = [name for name in used if names[name] not in ("<f4", "<f8")]
    if whole:
        raise SplatFileError(f"property {whole[0]} is a whole number type; expected float or double")
    return 1 + n_rest // 3, m


def _deviations(vertex: Element, m: int) -> tuple[str, ...]:
    """The properties that hold the modes' standard deviations, () if there are none."""
    names = tuple(layout.deviation(k) for k in range(m))
    there = [name for name in names if name in vertex.properties]
    if there and len(there) != m:
        missing = next(name for name in names if name not in there)
        raise SplatFileError(f"has {there[0]} but no {missing}; expected one for each of {m} modes, or none")
    whole = [name for name in there if vertex.properties[name] not in ("<f4", "<f8")]
    if whole:
        raise SplatFileError(f"property {whole[0]} is a whole number type; expected float or double")
    return names if there else ()


def _offset(header: Header, vertex: Element) -> int:
    before = header.elements[: header.elements.index(vertex)]
    return header.nbytes + sum(element.nbytes for element in before if element.count)


def _tables(file: BinaryIO, vertex: Element, groups: list[tuple[str, ...]]) -> list[np.ndarray]:
    """For each group of properties [N, len(group)] float32; SplatFileError naming a value that is not finite.

    One pass over the file, a block of vertices at a time.
    """
    tables = [np.empty((vertex.count, len(names)), np.float32) for names in groups]
    for start in range(0, vertex.count, ROWS_AT_ONCE):
        rows = min(ROWS_AT_ONCE, vertex.count - start)
        raw = np.fromfile(file, vertex.dtype, rows)
        if len(raw) != rows:
            raise SplatFileError(f"is truncated: {start + len(raw)} vertices, expected {vertex.count}")
        for names, table in zip(groups, tables, strict=True):
            block = table[start : start + rows]
            with np.errstate(over="ignore"):  # a double past float32's range is reported below
                for j, name in enumerate(names):
                    block[:, j] = raw[name]
            if not np.isfinite(block).all():
                i, j = np.argwhere(~np.isfinite(block))[0]
                value = raw[names[j]][i]
                raise SplatFileError(f"vertex {start + i}: {names[j]} is {value}; expected a finite number")
    return tables


def _splat(tables: list[np.ndarray], k: int, about: dict, deviation: np.ndarray | None) -> SplatFile:
    """The activated values of what `_tables` read: GROUPS, f_rest, twelve columns a mode; deviations [M, N]."""
    means, f_dc, logits, scale_logs, quats, f_rest, *modes = tables
    n, m = len(means), len(modes)
    with np.errstate(over="ignore"):
        scales = np.exp(scale_logs.astype(np.float64)).astype(np.float32)
    sh = np.empty((n, k, 3), np.float32)
    sh[:, 0] = f_dc
    sh[:, 1:] = f_rest.reshape(n, 3, k - 1).transpose(0, 2, 1)
    displacement, rotation = (np.empty((m, n, 3), np.complex64) for _ in range(2))
    for i, parts in enumerate(modes):
        displacement[i].real, displacement[i].imag = parts[:, 0:3], parts[:, 3:6]
        rotation[i].real, rotation[i].imag = parts[:, 6:9], parts[:, 9:12]
    return SplatFile(
        means=means,
        quats=quats,
        scales=scales,
        opacities=layout.sigmoid(logits[:, 0]).astype(np.float32),
        sh=sh,
        freqs_hz=np.array(about.get("frequencies_hz", []), dtype=np.float64),
        displacement=displacement,
        rotation=rotation,
        fps=float(about.get("fps") or 0.0),
        n_timesteps=1 if about.get("n_timesteps") is None else int(about["n_timesteps"]),
        unit_scale_m=None if about.get("unit_scale_m") is None else float(about["unit_scale_m"]),
        time_origin_s=float(about.get("time_origin_s") or 0.0),
        deviation=None if deviation is None else np.ascontiguousarray(deviation),
        low_pass_px2=None if about.get("low_pass_px2") is None else float(about["low_pass_px2"]),
    )
