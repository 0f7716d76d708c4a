"""Gaussians as a mesh of loose vertices with attributes, and the collection that receives them.

The last four vertices are no Gaussians but references for Apply Transform (applied.py). Their opacity is −1, so that no
threshold draws them. Who reads a mesh's rows leaves them out by `values` or `gaussians`.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import bmesh
import numpy as np

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.splatfile import SplatFile

from .. import names
from . import colours

# A thinner ellipsoid cannot be inverted in float32, which the splat material needs.
THINNEST = 1e-4  # of the longest axis
SMALLEST = 1e-7  # scene units
# Of the attributes' data: the field that holds a value, and how many numbers that is.
_FIELDS = {
    "FLOAT": ("value", 1),
    "FLOAT_VECTOR": ("vector", 3),
    "FLOAT_COLOR": ("color", 4),
    "QUATERNION": ("value", 4),
}


def fill_mesh(mesh: Any, splat: SplatFile, references: bool = True) -> None:
    """Fill an empty mesh."""
    fill = _Rows(mesh, len(splat), 4 if references else 0)
    # Sums and maxima by columns: numpy reduces an axis of three or four ten times as slowly.
    quats = splat.quats / np.sqrt(np.einsum("nk,nk->n", splat.quats, splat.quats))[:, None]
    scales = drawable_scales(splat.scales)
    # References have a size that is there anyway: Blender packs sizes between the smallest and the largest.
    fill(names.SCALE, "FLOAT_VECTOR", scales, scales[:1])
    fill(names.ROTATION, "QUATERNION", quats, (1.0, 0.0, 0.0, 0.0))
    fill(names.COLOUR, "FLOAT_COLOR", colours.rest_colours(splat.sh))
    fill(names.OPACITY, "FLOAT", splat.opacities, -1.0)
    mesh.color_attributes.active_color = mesh.color_attributes[names.COLOUR]
    # Colours are cut to what a screen shows; an export needs what they were.
    for name, rows in native_attributes(splat).items():
        fill(name, "FLOAT_COLOR" if name == names.NATIVE_BASE else "FLOAT_VECTOR", rows)
    for k in range(splat.n_modes):
        part, d, r = names.phasor(k), splat.displacement[k], splat.rotation[k]
        for key, values in (("re", d.real), ("im", d.imag), ("re_r", r.real), ("im_r", r.imag)):
            fill(part[key], "FLOAT_VECTOR", values)
        amplitude, phase = strength(d, main_axis(d))
        fill(names.amplitude(k), "FLOAT", amplitude)
        fill(names.phase(k), "FLOAT", phase)
        if splat.deviation is not None:
            fill(names.deviation(k), "FLOAT", splat.deviation[k])
    middle, size = splat.means.mean(axis=0), splat.means.std() or 1.0
    steps = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    number = names.modes_number(splat.freqs_hz.tolist(), splat.fps)
    fill.finish(splat.means, (middle + size * steps)[: fill.extra], number)


def fill_references(mesh: Any) -> None:
    """Fill a mesh with the four reference points only, for a sequence, whose points are in other meshes."""
    fill = _Rows(mesh, 0, 4)
    steps = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    fill.finish(np.zeros((0, 3)), steps, names.modes_number((), 0.0))


def gaussians(mesh: Any) -> np.ndarray:
    """Return a mask [V] of the vertices that are Gaussians: `rows[gaussians(mesh)]` drops the reference points.

    In Edit Mode a mesh's attributes cannot be read: pass a copy.
    """
    marks = mesh.attributes.get(names.REFERENCE)
    numbers = np.zeros(len(mesh.vertices), np.int32)
    if marks is not None:
        marks.data.foreach_get("value", numbers)
    return numbers == 0


def _rows_of_gaussians(mesh: Any) -> slice | np.ndarray:
    """Return `gaussians`, as a slice, which copies nothing, where the references are the last four as imported."""
    mask = gaussians(mesh)
    last = len(mask) - 4
    return slice(0, last) if last >= 0 and mask[:last].all() and not mask[last:].any() else mask


def values(mesh: Any, name: str) -> np.ndarray:
    """[N] or [N, width] float32 of an attribute ("position" too) of the N Gaussians of a mesh, without the references.

    Raises Tg4mmError where the attribute is gone. Not in Edit Mode: give a copy.
    """
    if (found := mesh.attributes.get(name)) is None:
        raise Tg4mmError(f"Attribute {name!r} of the points is gone; import the file again")
    field, width = _FIELDS[found.data_type]
    rows = np.empty(width * len(mesh.vertices), np.float32)
    found.data.foreach_get(field, rows)
    return (rows if width == 1 else rows.reshape(-1, width))[_rows_of_gaussians(mesh)]


def world(obj: Any, mesh: Any) -> np.ndarray:
    """Return the rest positions [N, 3], float64, in world space."""
    matrix = np.array(obj.matrix_world)
    return values(mesh, "position") @ matrix[:3, :3].T + matrix[:3, 3]


class ImportedPart(NamedTuple):
    """The Gaussians of one import, and the transform that Apply Transform gave them."""

    rows: np.ndarray  # [n] their numbers among all Gaussians of the mesh
    applied: np.ndarray | None  # [4, 4] float64: place = applied · place in the file; None: references lost


def parts(mesh: Any) -> list[ImportedPart]:
    """Return the parts of a joined mesh (one if it was never joined), as applied.py's nodes do. Not in Edit Mode."""
    numbers, rest = np.zeros(len(mesh.vertices), np.int32), np.zeros(3 * len(mesh.vertices), np.float32)
    now = np.empty(3 * len(mesh.vertices), np.float32)
    for name, field, into in (
        (names.REFERENCE, "value", numbers),
        (names.REFERENCE_REST, "vector", rest),
        ("position", "vector", now),
    ):
        if (found := mesh.attributes.get(name)) is not None:
            found.data.foreach_get(field, into)
    is_gaussian = numbers == 0
    one = np.count_nonzero(~is_gaussian) == 4
    ended = np.zeros(len(numbers), int) if one else np.cumsum(numbers == 4) - (numbers == 4)
    places = [flat.reshape(-1, 3).astype(np.float64) for flat in (rest, now)]
    found_parts = []
    for part in range(ended.max(initial=0) + 1):
        rows = np.flatnonzero(ended[is_gaussian] == part)
        marked = np.flatnonzero((ended == part) & ~is_gaussian)
        if len(rows) or len(marked):
            found_parts.append(ImportedPart(rows, _affine(*(flat[marked] for flat in places))))
    return found_parts


def _affine(rest: np.ndarray, now: np.ndarray) -> np.ndarray | None:
    """Return the affine map [4, 4] of four points [4, 3] to four others, or None if they are degenerate."""
    if len(rest) != 4:
        return None
    before, after = (np.eye(4) for _ in range(2))
    for frame, four in ((before, rest), (after, now)):
        frame[:3, :3], frame[:3, 3] = (four[1:] - four[0]).T, four[0]
    if 0.0 in (np.linalg.det(before), np.linalg.det(after)):
        return None
    return after @ np.linalg.inv(before)


def applied(mesh: Any) -> np.ndarray | None:
    """Return what Apply Transform did to a mesh, [4, 4] from its file's axes to its own; None: references lost."""
    return _affine(*_last_four(mesh))


def growth(mesh: Any) -> float:
    """Return the mean length factor of Apply Transform: the cube root of its volume factor."""
    affine = applied(mesh)
    return 1.0 if affine is None else float(abs(np.linalg.det(affine[:3, :3])) ** (1 / 3))


def shown_size(obj: Any) -> float:
    """Return the mean displayed size of one file unit in scene units, from object scale and Apply Transform."""
    linear = np.array(obj.matrix_world)[:3, :3]
    return float(abs(np.linalg.det(linear)) ** (1 / 3)) * growth(obj.data)


def _last_four(mesh: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the original and current reference points [4, 3], in Edit Mode too; [0, 3] if there are none."""
    if mesh.is_editmode:
        edited = bmesh.from_edit_mesh(mesh)
        edited.verts.ensure_lookup_table()
        layers = edited.verts.layers
        mark, rest = layers.int.get(names.REFERENCE), layers.float_vector.get(names.REFERENCE_REST)
        last = edited.verts[-4:] if mark and rest else []
        rows = [(v[mark], v[rest], v.co) for v in last]
    else:
        marks, rest = (mesh.attributes.get(name) for name in (names.REFERENCE, names.REFERENCE_REST))
        last = range(max(len(mesh.vertices) - 4, 0), len(mesh.vertices)) if marks and rest else range(0)
        rows = [(marks.data[i].value, rest.data[i].vector, mesh.vertices[i].co) for i in last]
    if [row[0] for row in rows] != [1, 2, 3, 4]:
        rows = []
    places = np.array([(row[1], row[2]) for row in rows], np.float64).reshape(-1, 2, 3)
    return places[:, 0], places[:, 1]


def native_attributes(splat: SplatFile) -> dict[str, np.ndarray]:
    """Colours under the names that Blender 5.3's own splats read: [N, 4] raw f_dc and opacity, and [N, 3] for each
    further coefficient, as in the file.

    Blender's own import writes the first as FLOAT4. It draws FLOAT_COLOR alike, which nodes can write too."""
    base = np.concatenate([splat.sh[:, 0], splat.opacities[:, None]], axis=1)
    n, count = splat.sh.shape[:2]
    further = splat.sh[:, 1:].transpose(1, 0, 2)  # a PLY is read in this order
    if not further.flags.c_contiguous:
        further = np.empty((count - 1, n, 3), np.float32)
        # one pass over the file's order, not one for each coefficient
        for start in range(0, n, colours.IN_CACHE):
            rows = slice(start, start + colours.IN_CACHE)
            further[:, rows] = splat.sh[rows, 1:].transpose(1, 0, 2)
    return {names.NATIVE_BASE: base} | {names.native_sh(k): further[k - 1] for k in range(1, count)}


def drawable_scales(scales: np.ndarray) -> np.ndarray:
    """Return the scales [N, 3] clamped to the smallest that can be drawn."""
    longest = np.maximum(np.maximum(scales[:, 0], scales[:, 1]), scales[:, 2])
    return np.maximum(scales, np.maximum(longest * np.float32(THINNEST), np.float32(SMALLEST))[:, None])


def main_axis(phasors: np.ndarray) -> np.ndarray:
    """Return the unit vector [3] of largest motion of phasors [N, 3]; its largest component is positive."""
    axis = np.linalg.eigh((phasors.T @ phasors.conj()).real.astype(np.float64))[1][:, -1]
    return axis * np.sign(axis[np.argmax(np.abs(axis))])


def strength(phasors: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest displacement [N] (scene units) and phase [N] (turns, 0 to 1) of complex phasors [N, 3].

    Re[m exp(iωt)] runs round an ellipse; its long half is the amplitude, √((|m|² + |m·m|) / 2), reached in
    the direction Re[m exp(−iψ)], ψ = arg(m·m)/2. Of the two ends the one on the side of `axis` is meant, so
    that two points have the same phase when they move to the same side at the same time.
    """
    amplitude, phase = (np.empty(len(phasors), np.float32) for _ in range(2))
    for start in range(0, len(phasors), colours.IN_CACHE):
        rows = slice(start, start + colours.IN_CACHE)
        amplitude[rows], phase[rows] = _strength(phasors[rows], axis)
    return amplitude, phase


def _strength(phasors: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # Rows of x, y and z in float32, as they are kept: five times as fast.
    re, im = (np.ascontiguousarray(part.T, np.float32) for part in (phasors.real, phasors.imag))
    rr, ii, ri = ((a * b).sum(axis=0) for a, b in ((re, re), (im, im), (re, im)))
    amplitude = np.sqrt((rr + ii + np.hypot(rr - ii, 2 * ri)) / 2)
    psi = np.arctan2(2 * ri, rr - ii) / 2
    along = np.asarray(axis, np.float32)
    away = np.cos(psi) * (along @ re) + np.sin(psi) * (along @ im) < 0
    return amplitude, (psi / (2 * np.pi) + 0.5 * away) % 1.0


class _Rows:
    """Writer of a mesh's vertices: `count` Gaussians, then `extra` reference points."""

    def __init__(self, mesh: Any, count: int, extra: int) -> None:
        mesh.vertices.add(count + extra)
        self.mesh, self.count, self.extra = mesh, count, extra
        self._scratch: dict[tuple[int, int], np.ndarray] = {}

    def __call__(self, name: str, data_type: str, rows: np.ndarray, other: Any = 0.0) -> None:
        """Add an attribute: rows [N] or [N, k] for the Gaussians, `other` for each reference point."""
        field, width = _FIELDS[data_type]
        data = self.mesh.attributes.new(name, data_type, "POINT").data
        data.foreach_set(field, self._flat(np.reshape(rows, (-1, width)), other))

    def finish(self, places: np.ndarray, references: np.ndarray, modes: int) -> None:
        """Set all positions and deselect all vertices, because the probe reads the user's selection."""
        # As attributes: `vertices.foreach_set` goes through them one by one.
        self.mesh.attributes["position"].data.foreach_set("vector", self._flat(places, references))
        if self.extra:
            for name, data_type, field, of_each in (  # Blender makes new attributes 0
                (names.REFERENCE_REST, "FLOAT_VECTOR", "vector", references),
                (names.REFERENCE, "INT", "value", range(1, 1 + self.extra)),
                (names.REFERENCE_MODES, "INT", "value", [modes] * self.extra),
            ):
                data = self.mesh.attributes.new(name, data_type, "POINT").data
                for i, value in enumerate(of_each, self.count):
                    setattr(data[i], field, value)
        if (selected := self.mesh.attributes.get(".select_vert")) is not None:  # new vertices are selected
            self.mesh.attributes.remove(selected)
        self.mesh.update()

    def _flat(self, rows: np.ndarray, other: Any) -> np.ndarray:
        """[(N + extra)·k] float32, valid until the next of that width."""
        size = (self.count + self.extra, rows.shape[1])
        if size not in self._scratch:
            self._scratch[size] = np.empty(size, np.float32)
        every = self._scratch[size]
        every[: self.count], every[self.count :] = rows, other
        return every.ravel()


def receiving(context: Any) -> Any:
    """Return the active collection or, if it is excluded, hidden or linked, its nearest usable ancestor.

    The scene's own collection if there is no such, or if the collection is not in the view layer.
    """
    context.view_layer.update()  # Blender may not have worked out yet what is visible
    wanted = context.collection
    ways = [way for way in _ways(context.view_layer.layer_collection) if way[-1].collection == wanted]
    for way in ways:  # a collection may be in several others, and be seen in one of them alone
        if _takes(way[-1]):
            return wanted
    for way in ways:
        for layer in reversed(way):
            if _takes(layer):
                return layer.collection
    return context.scene.collection


def choose_alone(context: Any, obj: Any) -> None:
    """Make an object the active one and the only one that is selected."""
    for other in context.selected_objects:
        other.select_set(False)
    obj.select_set(True)
    context.view_layer.objects.active = obj


def _takes(layer: Any) -> bool:
    """Return whether objects linked to a layer collection are visible."""
    if layer.exclude or not layer.is_visible:
        return False
    return layer.collection.library is None and layer.collection.override_library is None


def _ways(layer: Any, above: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    way = (*above, layer)
    yield way
    for child in layer.children:
        yield from _ways(child, way)
