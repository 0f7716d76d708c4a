"""Sheets of points, open or closed, puffed up to bodies (buns, leaves); upholstery: outlines, tufts, mouldings."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..meshes import Mesh, join, revolve


def _quads(index: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles [F, 3] and their texture coordinates [F, 3, 2] of a grid of vertex numbers [R, S]; uv [R, S, 2]."""
    a, b, c, d = (
        (slice(0, -1), slice(0, -1)),
        (slice(0, -1), slice(1, None)),
        (slice(1, None), slice(1, None)),
        (slice(1, None), slice(0, -1)),
    )
    corners = [(index[k].ravel(), uv[k].reshape(-1, 2)) for k in (a, b, c, d)]
    pick = [(0, 1, 2), (0, 2, 3)]
    triangles = np.concatenate([np.column_stack([corners[k][0] for k in p]) for p in pick])
    coordinates = np.concatenate([np.stack([corners[k][1] for k in p], 1) for p in pick])
    return triangles, coordinates


def _clean(vertices: np.ndarray, triangles: np.ndarray, uv: np.ndarray) -> Mesh:
    """Remove triangles without area (poles, welded rims) and unused vertices."""
    p = vertices[triangles]
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    keep = area > 1e-12
    used, renumbered = np.unique(triangles[keep], return_inverse=True)
    return Mesh(vertices[used], renumbered.reshape(-1, 3).astype(np.int32), uv[keep])


def grid_uv(rows: int, columns: int) -> np.ndarray:
    """Return [R, S, 2]: u over the columns, v over the rows, both 0 to 1."""
    u, v = np.meshgrid(np.linspace(0.0, 1.0, columns), np.linspace(0.0, 1.0, rows))
    return np.stack([u, v], -1)


def sheet(points: np.ndarray, around: bool = False) -> Mesh:
    """Smooth sheet through points [R, S, 3]; u over the columns, v over the rows.

    The normal is (along the row) × (along the column). With `around` the last column is joined to the first; a row
    of equal points is welded to a pole.
    """
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    for r in (0, rows - 1):
        if np.ptp(points[r], axis=0).max() < 1e-9:
            index[r] = index[r, 0]
    if around:
        index = np.concatenate([index, index[:, :1]], axis=1)
    triangles, uv = _quads(index, grid_uv(rows, index.shape[1]))
    return _clean(points.reshape(-1, 3), triangles, uv)


def normals(points: np.ndarray) -> np.ndarray:
    """Unit normals [R, S, 3] of a grid of points: (along the row) × (along the column)."""
    across = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    return across / np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-12)


def puff(middle: np.ndarray, above: np.ndarray, below: np.ndarray, along: np.ndarray | None = None) -> Mesh:
    """A closed body: the sheet `middle` [R, S, 3] thickened by `above` and `below` [R, S] along its normal.

    Both sides are welded at the border, where the thickness counts as zero. The upper side has v in 0 … ½, the lower
    one ½ … 1 (mirrored, so that the texture is continuous over the border v = ½). `along` [R, S, 3] or [3] replaces
    the normal.
    """
    rows, columns = middle.shape[:2]
    direction = normals(middle) if along is None else np.broadcast_to(along, middle.shape)
    rim = np.zeros((rows, columns), bool)
    rim[[0, -1]] = rim[:, [0, -1]] = True
    up = middle + np.where(rim, 0.0, above)[..., None] * direction
    down = middle - np.where(rim, 0.0, below)[..., None] * direction
    index = np.arange(rows * columns).reshape(rows, columns)
    other = np.where(rim, index, index + rows * columns)
    uv = grid_uv(rows, columns)
    top = _quads(index, uv * [1.0, 0.5])
    bottom = _quads(other[:, ::-1], (uv * [1.0, -0.5] + [0.0, 1.0])[:, ::-1])
    triangles, coordinates = (np.concatenate(pair) for pair in zip(top, bottom, strict=True))
    return _clean(np.concatenate([up.reshape(-1, 3), down.reshape(-1, 3)]), triangles, coordinates)


def puff_points(
    middle: np.ndarray, above: np.ndarray, below: np.ndarray, along: np.ndarray | None = None
) -> np.ndarray:
    """Return the spatial positions [2R − 1, S, 3] of a puff's texture, rows from v = 0 to 1."""
    direction = normals(middle) if along is None else np.broadcast_to(along, middle.shape)
    up = middle + above[..., None] * direction
    down = middle - below[..., None] * direction
    return np.concatenate([up, down[-2::-1]])


def rounded(x: np.ndarray, power: float = 2.5) -> np.ndarray:
    """Profile of a rounded edge: 1 in the middle of x in −1 … 1, vertical fall to 0 at both ends."""
    return np.maximum(1.0 - np.abs(x) ** power, 0.0) ** (1.0 / power)


def edged(count: int, sharpness: float = 0.7) -> np.ndarray:
    """`count` values from −1 to 1, closer to each other towards both ends, where rounded edges need them."""
    even = np.linspace(-1.0, 1.0, count)
    return (1.0 - sharpness) * even + sharpness * np.sin(0.5 * np.pi * even)


def leaf(length: float, width: float, thickness: float, curl: float = 0.0, lobes: int = 5) -> Mesh:
    """A closed acanthus leaf in the xy plane from the origin along +y, its face to +z; `curl` lifts the tip."""
    t = 0.5 + 0.5 * edged(25, 0.4)
    c = edged(15, 0.6)
    outline = np.sin(np.pi * np.clip(0.04 + 0.94 * t, 0.0, 1.0)) ** 0.8 * (1.0 - 0.35 * t)
    outline = outline * (1.0 + 0.16 * np.cos(2.0 * np.pi * lobes * t))
    x = 0.5 * width * outline[:, None] * c[None]
    sweepback = 0.10 * length * np.abs(c[None]) ** 1.5 * np.sin(np.pi * t)[:, None]
    y = length * t[:, None] - sweepback
    z = curl * t[:, None] ** 2 - 0.35 * thickness * c[None] ** 2
    middle = np.stack(np.broadcast_arrays(x, y, z), -1)
    ribs = 0.72 + 0.28 * np.cos(2.0 * np.pi * (1.6 * c[None] ** 2 * 2.0 + lobes * t[:, None]))
    vein = 1.0 - 0.5 * np.exp(-((c[None] / 0.09) ** 2))
    above = thickness * rounded(c, 2.2)[None] * rounded(2.0 * t - 1.0, 4.0)[:, None] * ribs * vein
    return puff(middle, above, 0.5 * above)


def shell(radius: float, thickness: float, leaves: int = 7, spread: float = np.pi) -> Mesh:
    """A fan of leaves about +y in the xy plane, with a boss at the origin; its face to +z."""
    made = []
    for k, angle in enumerate(np.linspace(-spread / 2.0, spread / 2.0, leaves)):
        reach = radius * (0.78 + 0.22 * np.cos(1.3 * angle))
        one = leaf(reach, 0.5 * radius, thickness, 0.25 * thickness * (1 + k % 2))
        c, s = np.cos(angle), np.sin(angle)
        turn = np.eye(4)
        turn[:2, :2] = [[c, s], [-s, c]]
        turn[2, 3] = 0.12 * thickness * (k % 2)
        made.append(one.moved(turn))
    boss = [
        (0.0, -0.4), (0.9, -0.4), (1.0, 0.0), (0.85, 0.5), (0.62, 0.6), (0.5, 0.75), (0.3, 1.0), (0.0, 1.1),
    ]  # fmt: skip
    made.append(revolve([(0.24 * radius * r, 1.3 * thickness * z) for r, z in boss], 24))
    return join(made)


def volute(
    centre: tuple[float, float], radius: float, inner: float, turns: float, count: int = 60
) -> np.ndarray:
    """Spiral [count, 2] in the xz plane: starts above the centre towards +x, winds down and inwards."""
    t = np.linspace(0.0, 1.0, count)
    angle, reach = 2.0 * np.pi * turns * t, radius + (inner - radius) * t**0.8
    return np.column_stack([centre[0] + reach * np.sin(angle), centre[1] + reach * np.cos(angle)])


Surface3 = Callable[[np.ndarray], np.ndarray]  # plane points [..., 2] to points in space [..., 3]


@dataclass(frozen=True)
class Outline:
    """A star-shaped closed curve about the origin of a plane: a superellipse, wider at one side."""

    half_x: float
    half_y: float
    power: float = 3.5  # 2 is an ellipse; more has squarer corners
    taper: float = 0.0  # half_y grows by this share towards +x and shrinks towards −x
    shoulder: float = 0.0  # half_x grows by this share towards +y
    crest: float = 0.0  # a soft hump of this height in the middle of +y

    def radius(self, angle: np.ndarray) -> np.ndarray:
        """Distance of the curve from the origin at an angle from +x."""
        c, s = np.cos(angle), np.sin(angle)
        wide = self.half_y * (1.0 + self.taper * c)
        broad = self.half_x * (1.0 + self.shoulder * s)
        power = self.power
        reach = (np.abs(c / broad) ** power + np.abs(s / wide) ** power) ** (-1.0 / power)
        return reach + self.crest * np.exp(-((np.arctan2(c, s) / 0.33) ** 2))

    def rim(self, count: int, grow: float = 0.0) -> np.ndarray:
        """Return [count, 2] in equal steps along the curve, counter-clockwise from +x; `grow` pushes it outwards."""
        angle = np.linspace(0.0, 2.0 * np.pi, 2001)
        fine = (self.radius(angle) + grow)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))])
        even = np.linspace(0.0, lengths[-1], count, endpoint=False)
        return np.column_stack([np.interp(even, lengths, fine[:, k]) for k in range(2)])

    def disc(self, count: int, sharpness: float = 0.6) -> tuple[np.ndarray, np.ndarray]:
        """Points [count, count, 2] that fill the outline, and their share [count, count] of the way to it.

        A square grid bent to a disc; the border of the grid is the outline.
        """
        p = edged(count, sharpness)
        q = p[:, None] * np.sqrt(1.0 - 0.5 * p[None] ** 2)
        r = np.broadcast_to(q.T, (count, count))
        share = np.minimum(np.hypot(r, q), 1.0)
        reach = share * self.radius(np.arctan2(q, r))
        size = np.maximum(np.hypot(r, q), 1e-9)
        return np.stack([r / size * reach, q / size * reach], -1), share


def tufts(points: np.ndarray, buttons: np.ndarray, pull: float, width: float, crease: float) -> np.ndarray:
    """Return the depth [...] at points [..., 2] of a cushion's buttons [N, 2] and the creases between them."""
    gap = np.linalg.norm(buttons[:, None] - buttons[None], axis=2) + 9.0 * np.eye(len(buttons))
    depth = np.zeros(points.shape[:-1])
    for button in buttons:
        depth = np.maximum(depth, pull * np.exp(-np.linalg.norm(points - button, axis=-1) / width))
    for i, j in np.argwhere(np.triu(gap < 1.25 * gap.min())):
        along = buttons[j] - buttons[i]
        t = np.clip((points - buttons[i]) @ along / (along @ along), 0.0, 1.0)
        away = np.linalg.norm(points - buttons[i] - t[..., None] * along, axis=-1)
        depth = np.maximum(depth, crease * np.exp(-away / (0.35 * width)))
    return depth


def diamonds(
    rows: int, columns: int, spacing: tuple[float, float], middle: tuple[float, float]
) -> np.ndarray:
    """Buttons [N, 2] in staggered rows; every second row has one fewer."""
    made = []
    for r in range(rows):
        n = columns - r % 2
        across = (np.arange(n) - (n - 1) / 2.0) * spacing[1]
        made += [(middle[0] + (r - (rows - 1) / 2.0) * spacing[0], middle[1] + a) for a in across]
    return np.array(made)


def moulding(
    path: np.ndarray,  # [P, 3] a closed curve, its start not repeated
    outward: np.ndarray,  # [P, 3] unit directions of the section's x axis
    normal: np.ndarray,  # [P, 3] unit directions of the section's y axis
    section: np.ndarray,  # [S, 2] counter-clockwise
    swell: np.ndarray | None = None,  # [P] scale of the section
) -> Mesh:
    """A section carried round a closed curve with directions that are given. u around the section, v along."""
    tangent = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0)
    if (np.cross(outward, normal) * tangent).sum() < 0.0:
        section = section[::-1]
    size = np.ones(len(path)) if swell is None else swell
    rings = path[:, None] + size[:, None, None] * (
        section[None, :, :1] * outward[:, None] + section[None, :, 1:] * normal[:, None]
    )
    return sheet(np.concatenate([rings, rings[:1]]), around=True)


def frames_on(surface: Surface3, rim: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, outward directions and normals, each [P, 3], of a closed plane curve laid on a surface in space."""
    h = 1e-4
    point = surface(rim)
    step = np.roll(rim, -1, axis=0) - np.roll(rim, 1, axis=0)
    step /= np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-12)
    step = np.where(np.abs(step).max(1, keepdims=True) > 0.0, step, [0.0, 1.0])  # of a single point
    tangent = surface(rim + h * step) - surface(rim - h * step)
    a = surface(rim + [h, 0.0]) - point
    b = surface(rim + [0.0, h]) - point
    normal = np.cross(a, b)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    outward = np.cross(tangent, normal)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    return point, outward, normal


def bead_section(
    width: float, height: float, grooves: int = 0, depth: float = 0.0, count: int = 40
) -> np.ndarray:
    """Section [S, 2] of a carved rail: a soft rectangle, with grooves cut round it."""
    angle = 2.0 * np.pi * np.arange(count) / count
    c, s = np.cos(angle), np.sin(angle)
    reach = (np.abs(c) ** 3.5 + np.abs(s) ** 3.5) ** (-1.0 / 3.5)
    if grooves:
        reach = reach * (1.0 - depth * (0.5 - 0.5 * np.cos(grooves * angle)) ** 4)
    return 0.5 * reach[:, None] * np.column_stack([width * c, height * s])
