"""A PLY of Gaussians: ours, with motion, and those of other programs (docs/conventions.md, "Splat file")."""

import contextlib
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tg4mm.core.errors import SplatFileError, system_says
from tg4mm.core.files import replacing as replacing_file
from tg4mm.core.splatfile import model, supersplat
from tg4mm.core.splatfile.header import ASCII, Element, Header, blocks, check_size, columns, read_header
from tg4mm.core.splatfile.model import ANTIALIASED, LINEAR, SH_COUNTS, Head, Options, SplatFile, drawable

MODE_NAME = re.compile(r"mode_[0-9]+_(re|im)_r?[xyz]")
RGB = ("red", "green", "blue")
FILTER = ("filter_3D",)  # of Mip-Splatting, scene units
PREFIX = "scalar_"  # of CloudCompare, before each property that it does not know
NEEDED = (*model.POSITION, *model.F_DC, *model.OPACITY, *model.SCALE, *model.ROTATION)
OF_SPLATS = (*model.OPACITY, *model.SCALE, *model.ROTATION)
# Properties by which files are recognised whose Gaussians are not at rest, or not there: what each is.
_KINDS = {
    r"(t|time|scale_t|t_scale|rot_r_[0-3])": "4D Gaussian splatting, whose Gaussians live in space and time",
    r"(trbf_(center|scale)|omega_[0-3]|motion_[0-9]+)": "Spacetime Gaussians, which move along polynomials",
    r"(f_offset|f_anchor_feat)_?[0-9]+": "Scaffold-GS, whose anchors become Gaussians by neural networks beside it",
    r"t_.*|.*_t|(.*_)?(time(stamp)?|[tT](center|scale)|lifespan|duration|birth)(_.*)?": "Gaussians that come and go",
    r"(.*_)?(velocity|vel|motion|flow|deform(ation)?)(_.*)?": "Gaussians that move",
}
_IGNORED = {
    *"xyz",
    "nx",
    "ny",
    "nz",
    *RGB,
    "alpha",
    *FILTER,
}  # properties that need no note where they are not used
_MOST_NAMED = 5  # properties
_ENOUGH = 20_000  # Gaussians, for a median
_FINE = 0.01  # of a Gaussian's median size, that float32 must tell at its place
DEGREES = (*SH_COUNTS, 25)  # coefficients a channel, degree 0 to 4

ROWS_AT_ONCE = 8192  # keeps the block being interleaved in the processor's cache


@dataclass(frozen=True)
class PlyColumns:
    """The properties that hold each quantity; () if there are none."""

    colour: tuple[str, ...]
    rest: tuple[str, ...]
    scale: tuple[str, ...]
    filter: tuple[str, ...]
    modes: int
    deviations: tuple[str, ...]
    about: dict[str, Any]
    notes: tuple[str, ...]


def head_of_ply(file: BinaryIO) -> Head:
    """Return the file's header."""
    header = read_header(file)
    vertex = _vertex(header)
    known = len((header.about or {}).get("frequencies_hz", []))
    return Head("PLY", vertex.count, known, 0 if known else _modes_of(vertex.properties))


def read_ply(file: BinaryIO, size: int, options: Options) -> SplatFile:
    """The Gaussians of a PLY of `size` bytes. SplatFileError without the file's name."""
    header = read_header(file)
    vertex = _vertex(header)
    if "packed_position" in vertex.properties:
        check_size(header, size)
        return supersplat.read(file, header, vertex)
    plan = _plan(vertex.properties, header.about, options)
    if header.is_antialiased and not plan.filter:
        plan = replace(plan, notes=(*plan.notes, ANTIALIASED))
    check_size(header, size)
    if header.form == ASCII and (file.seek(size - 1), file.read(1))[1] != b"\n":
        plan = replace(plan, notes=("its last line has no end: the last number may be cut off", *plan.notes))
    return _read(file, header, vertex, plan)


def _vertex(header: Header) -> Element:
    """The vertex element, its properties by the names that we know."""
    found = [element for element in header.elements if element.name == "vertex"]
    if len(found) != 1:
        raise SplatFileError(f"header has {len(found)} vertex elements; expected 1")
    if found[0].lists:
        raise SplatFileError(
            f"element vertex has a list property, {found[0].lists[0]}; splat files have none"
        )
    if found[0].count == 0:
        raise SplatFileError("element vertex has 0 entries; expected at least one Gaussian")
    names = found[0].properties
    for name in [n for n in names if n.startswith(PREFIX) and n.removeprefix(PREFIX) not in names]:
        _rename(names, name, name.removeprefix(PREFIX))
    return found[0]


def _rename(names: dict[str, str], old: str, new: str) -> None:
    """Rename a key, which stays in its place: the order is that of the data."""
    items = [(new if name == old else name, kind) for name, kind in names.items()]
    names.clear()
    names.update(items)


def _plan(names: dict[str, str], about: dict[str, Any] | None, options: Options) -> PlyColumns:
    notes: list[str] = []
    for pattern, kind in _KINDS.items():
        if (found := next((name for name in names if re.fullmatch(pattern, name)), None)) and about is None:
            raise SplatFileError(
                f"is of {kind} (property {found}): not read; export the Gaussians of one moment as a 3DGS PLY"
            )
    missing = [name for name in NEEDED if name not in names]
    colour: tuple[str, ...] = model.F_DC
    scale: tuple[str, ...] = model.SCALE
    if set(missing) >= set(OF_SPLATS) and not set(missing) & set(model.POSITION):
        raise SplatFileError(
            "is a point cloud, without opacity, scale and rotation: there are no splats in it"
        )
    if set(model.F_DC) <= set(missing) and all(names.get(name) == "<u1" for name in RGB):
        colour, missing = RGB, [name for name in missing if name not in model.F_DC]
    if missing == ["scale_2"]:
        scale, missing = model.SCALE[:2], []
        notes.append("2D Gaussian splatting: flat discs, read as Gaussians of no thickness")
    if missing:
        raise SplatFileError(f"property {missing[0]} is missing, {len(missing)} in all")
    n_rest = sum(name.startswith("f_rest_") for name in names)
    counts = [3 * (k - 1) for k in DEGREES]
    rest = model.f_rest(n_rest)
    if n_rest not in counts or any(name not in names for name in rest):
        raise SplatFileError(f"has {n_rest} f_rest properties; expected f_rest_0 on, {counts} of them")
    filter = FILTER if FILTER[0] in names else ()
    if filter:
        notes.append("Mip-Splatting's filter_3D is in the scales and opacities")
    about, m = _motion(names, about, options, notes)
    deviations = _deviations(names, m)
    known = {*NEEDED, *rest, *_IGNORED, *deviations}
    if others := [name for name in names if name not in known and not MODE_NAME.fullmatch(name)]:
        more = f" and {len(others) - _MOST_NAMED} more" if len(others) > _MOST_NAMED else ""
        notes.append(f"properties that are not read: {', '.join(others[:_MOST_NAMED])}{more}")
    modes = [name for k in range(m) for name in model.mode(k)]
    shape = (*model.POSITION, *scale, *model.OPACITY, *model.ROTATION)
    _check_floats(
        names, (*shape, *(colour if colour is not RGB else ()), *rest, *filter, *modes, *deviations)
    )
    if about.get("blending") == "linear":
        notes.append(LINEAR)
    return PlyColumns(colour, rest, scale, filter, m, deviations, about, tuple(notes))


def _check_floats(names: dict[str, str], used: Sequence[str]) -> None:
    whole = [name for name in used if names[name] not in ("<f4", "<f8")]
    if whole:
        raise SplatFileError(f"property {whole[0]} is a whole number type; expected float or double")


def _modes_of(names: dict[str, str]) -> int:
    """Modes of which all twelve properties are there, from mode_0 on."""
    m = 0
    while all(name in names for name in model.mode(m)):
        m += 1
    return m


def _motion(
    names: dict[str, str], about: dict[str, Any] | None, options: Options, notes: list[str]
) -> tuple[dict[str, Any], int]:
    """Return the motion's description, from the file or the caller, and the number of modes to read."""
    n_mode, there = sum(MODE_NAME.fullmatch(name) is not None for name in names), _modes_of(names)
    if about is not None:
        m = len(about["frequencies_hz"])
        if n_mode != 12 * m or there != m:
            raise SplatFileError(
                f"has {n_mode} mode properties; {m} frequencies_hz need {12 * m}, mode_0_re_x on"
            )
        return about, m
    if not n_mode:
        return {}, 0
    if not options.freqs_hz:
        notes.append(
            f"opened without motion: it has {n_mode} mode properties but no 'comment tg4mm' line with their "
            "frequencies; give the frequencies to play its motion"
        )
        return {}, 0
    if len(options.freqs_hz) != there or n_mode != 12 * there:
        raise SplatFileError(
            f"{len(options.freqs_hz)} frequencies were given, but the file has {n_mode} mode properties, twelve for "
            "each mode: give one frequency for each mode"
        )
    notes.append(f"frequencies as given: {', '.join(f'{f:g}' for f in options.freqs_hz)} Hz")
    frequencies = list(options.freqs_hz)
    slowest = min((f for f in frequencies if f > 0), default=options.fps)
    steps = max(1, round(options.fps / slowest)) if slowest else 1  # a period of the slowest
    return {"frequencies_hz": frequencies, "fps": options.fps, "n_timesteps": steps}, there


def _deviations(names: dict[str, str], m: int) -> tuple[str, ...]:
    """The properties that hold the modes' standard deviations, () if there are none."""
    wanted = tuple(model.deviation(k) for k in range(m))
    there = [name for name in wanted if name in names]
    if there and len(there) != m:
        missing = next(name for name in wanted if name not in there)
        raise SplatFileError(f"has {there[0]} but no {missing}; expected one for each of {m} modes, or none")
    return wanted if there else ()


def _read(file: BinaryIO, header: Header, vertex: Element, plan: PlyColumns) -> SplatFile:
    n, k, m = vertex.count, 1 + len(plan.rest) // 3, plan.modes
    is_double = any(vertex.properties[name] == "<f8" for name in model.POSITION)
    means = np.empty((n, 3), np.float64 if is_double else np.float32)
    quats = np.empty((n, 4), np.float32)
    scales, opacities = np.zeros((n, 3), np.float32), np.empty(n, np.float32)
    flat = ends = 0
    smooth = np.zeros(n, np.float32) if plan.filter else None
    sh = np.empty((k, n, 3), np.float32).transpose(1, 0, 2)  # as Blender takes it
    displacement, rotation = (np.empty((m, n, 3), np.complex64) for _ in range(2))
    deviation = np.empty((m, n), np.float32) if plan.deviations else None
    start = 0
    # a double past float32's range becomes infinity, which `drawable` counts
    with np.errstate(over="ignore"):
        for block in blocks(file, header, vertex):
            rows = slice(start, start := start + len(block))
            means[rows] = columns(block, model.POSITION)
            quats[rows] = columns(block, model.ROTATION)
            logs = columns(block, plan.scale).astype(np.float32, copy=False)
            logits = columns(block, model.OPACITY)[:, 0].astype(np.float32, copy=False)
            scales[rows, : len(plan.scale)], opacities[rows] = np.exp(logs), model.sigmoid(logits)
            flat, ends = flat + np.isneginf(logs).any(axis=1).sum(), ends + np.isinf(logits).sum()
            sh[rows, 0] = columns(block, plan.colour)
            sh[rows, 1:] = columns(block, plan.rest).reshape(len(block), 3, k - 1).transpose(0, 2, 1)
            if smooth is not None:
                smooth[rows] = columns(block, plan.filter)[:, 0]
            for i in range(m):
                parts = columns(block, model.mode(i))
                for phasors, at in ((displacement[i, rows], 0), (rotation[i, rows], 6)):
                    phasors.real, phasors.imag = parts[:, at : at + 3], parts[:, at + 3 : at + 6]
            if deviation is not None:
                deviation[:, rows] = columns(block, plan.deviations).T
    if plan.colour is RGB:
        sh[:, 0] = model.f_dc(sh[:, 0] / 255)
    notes = (*plan.notes, *_infinite(int(flat), int(ends), n))
    if smooth is not None:
        scales, opacities = _smoothed(scales, opacities, smooth)
    origin = _far_origin(means, scales)
    if origin.any() and not is_double:
        step = float(np.spacing(np.abs(origin).max().astype(np.float32)))
        notes = (
            *notes,
            f"lies far from its origin: its float positions are rounded to {step:.2g}, Gaussians are "
            f"{np.median(scales[np.isfinite(scales)]):.2g}; export it with doubles, or nearer to the origin",
        )
        origin = np.zeros(3, np.float32)
    elif origin.any():
        place = ", ".join(f"{x:.10g}" for x in origin)
        notes = (*notes, f"lies far from its origin: coordinates are from ({place}) on")
    fields: dict[str, Any] = {
        "means": means - origin,
        "quats": quats,
        "scales": scales,
        "opacities": opacities,
        "sh": sh,
    }
    if m:
        fields |= {"displacement": displacement, "rotation": rotation, "deviation": deviation}
    return drawable(fields | _said(plan.about, m), notes)


def _far_origin(means: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """[3] whole units to take off places [N, 3] that float32 would round; zeros where it tells them."""
    some = slice(None, None, max(1, len(means) // _ENOUGH))
    finite, scales = means[some][np.isfinite(means[some]).all(axis=1)], scales[some]
    if not len(finite):
        return np.zeros(3)
    centre, sizes = np.median(finite, axis=0), scales[np.isfinite(scales) & (scales > 0)]
    with np.errstate(over="ignore", invalid="ignore"):
        step = np.spacing(np.abs(centre).max().astype(np.float32))
    return np.round(centre) if len(sizes) and step > _FINE * np.median(sizes) else np.zeros(3)


def _said(about: dict[str, Any], m: int) -> dict[str, Any]:
    """The fields of SplatFile that the line `comment tg4mm` gives."""
    fields: dict[str, Any] = {
        "fps": float(about.get("fps") or 0.0),
        "n_timesteps": 1 if about.get("n_timesteps") is None else int(about["n_timesteps"]),
        "time_origin_s": float(about.get("time_origin_s") or 0.0),
    }
    for key in ("unit_scale_m", "low_pass_px2"):
        fields[key] = None if about.get(key) is None else float(about[key])
    fields["linear"] = about.get("blending") == "linear"
    return fields | ({"freqs_hz": np.array(about["frequencies_hz"], np.float64)} if m else {})


def _infinite(flat: int, ends: int, n: int) -> list[str]:
    """Return notes on Gaussians with valid but infinite values: log 0 and the logits of 0 and 1."""
    notes = []
    if flat:
        notes.append(f"{flat:,} of {n:,} Gaussians have a scale of log 0: read as flat")
    if ends:
        notes.append(f"{ends:,} of {n:,} Gaussians have an infinite logit: read as opacity 0 or 1")
    return notes


def _smoothed(scales: np.ndarray, opacities: np.ndarray, smooth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scales [N, 3] and opacities [N] with Mip-Splatting's 3D filter (Yu et al. 2024, Eq. 9)."""
    wide = np.sqrt(scales.astype(np.float64) ** 2 + smooth.astype(np.float64)[:, None] ** 2)
    with np.errstate(invalid="ignore", divide="ignore"):
        part = np.where(wide > 0, scales / wide, 1.0).prod(axis=1)
    return wide, opacities * part


def write_splat(path: str | Path, splat: SplatFile) -> None:
    """Write a binary 3DGS PLY with the modes as further properties. Needs numpy alone.

    All values are float32: means, quats, sh and phasors that are float32 come back exactly, scales to 1e-5 of their
    size (log), opacities to 1e-7 (logit). Scales under 1e-12 are written as that, opacities of 0 and 1 as 2⁻²⁴ and
    1 − 2⁻²⁴.

    Args:
        path: replaced in one step, so that a kill leaves the old file whole.
        splat: what to write.

    Raises:
        SplatFileError: the file cannot be written.
    """
    with replacing(Path(path)) as name, name.open("wb") as file:
        file.write(_header(splat))
        for block in _blocks(splat):
            file.write(block.tobytes())


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Like `files.replacing`, but raise SplatFileError naming the file for errors of system or writer."""
    try:
        with replacing_file(path, path.suffix) as name:
            yield name
    except OSError as error:
        raise SplatFileError(f"{path}: cannot be written: {system_says(error)}") from error
    except SplatFileError as error:
        raise SplatFileError(f"{path}: {error}") from error


def _names(splat: SplatFile) -> list[str]:
    rest = model.f_rest(3 * (splat.sh.shape[1] - 1))
    modes = [name for k in range(splat.n_modes) for name in model.mode(k)]
    if splat.deviation is not None:
        modes += [model.deviation(k) for k in range(splat.n_modes)]
    fixed = (model.POSITION, model.NORMAL, model.F_DC, rest, model.OPACITY, model.SCALE, model.ROTATION)
    return [name for names in fixed for name in names] + modes


def _header(splat: SplatFile) -> bytes:
    about: dict[str, Any] = {
        "format_version": model.FORMAT_VERSION,
        "fps": splat.fps or None,
        "n_timesteps": int(splat.n_timesteps),
        "frequencies_hz": [float(f) for f in splat.freqs_hz],
        "unit_scale_m": splat.unit_scale_m,
        "time_origin_s": splat.time_origin_s,
    }
    if splat.low_pass_px2 is not None:
        about["low_pass_px2"] = splat.low_pass_px2
    if splat.linear:
        about["blending"] = "linear"
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        model.MARK + json.dumps(about, allow_nan=False),
        f"element vertex {len(splat)}",
        *(f"property float {name}" for name in _names(splat)),
        "end_header",
    ]
    return ("\n".join(lines) + "\n").encode("ascii")


def _blocks(splat: SplatFile) -> Iterator[np.ndarray]:
    """The vertices as [rows, properties] float32, a block of rows at a time."""
    n, k = splat.sh.shape[:2]
    for start in range(0, n, ROWS_AT_ONCE):
        rows = slice(start, start + ROWS_AT_ONCE)
        means = splat.means[rows]
        parts = [
            means,
            np.zeros_like(means),
            splat.sh[rows, 0],
            splat.sh[rows, 1:].transpose(0, 2, 1).reshape(len(means), 3 * (k - 1)),
            model.logit(splat.opacities[rows])[:, None],
            model.log_scale(splat.scales[rows]),
            splat.quats[rows],
        ]
        for displacement, rotation in zip(splat.displacement, splat.rotation, strict=True):
            for phasor in (displacement[rows], rotation[rows]):
                parts += [phasor.real, phasor.imag]
        if splat.deviation is not None:
            parts.append(splat.deviation[:, rows].T)
        with np.errstate(over="ignore"):
            block = np.concatenate(parts, axis=1).astype("<f4")
        if not np.isfinite(block).all():
            size = max(np.abs(part).max(initial=0) for part in parts)
            raise SplatFileError(f"a value of size {size:g} is past float32's range, 3.4e38")
        yield block
