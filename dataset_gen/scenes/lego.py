"""The scene "lego": a yellow toy bulldozer of studded bricks on a baseplate; its blade and arms rock."""

import numpy as np

from .. import meshes as m
from ..meshes import Mesh
from ..scene import AreaLight, Gradient, Part, Scene
from ..shapes import bricks as b
from ..shapes import solids as s
from . import lego_gear as gear
from . import lego_surfaces as paint

PITCH = 0.08  # scene units between studs
FORWARD = (np.cos(np.radians(115.0)), np.sin(np.radians(115.0)), 0.0)  # the bulldozer's x axis in the world


def place() -> np.ndarray:
    """Return [4, 4] from stud pitches to the world."""
    matrix = m.frame((0.0, 0.0, -0.46), (0.0, 0.0, 1.0), FORWARD)
    matrix[:3, :3] *= PITCH
    return matrix


def build() -> Scene:
    model = b.BrickModel(np.random.default_rng([2025, 100]))
    model.brick("base", (-13, -8, -0.5), (26, 16, 0.515))  # the treads stand on its studs
    _chassis(model)
    _hood(model)
    _engine(model)
    _cab(model)
    gear.running_gear(model)
    gear.blade(model)
    gear.arms(model)
    gear.ripper(model)
    matrix, surfaces = place(), paint.surfaces()
    follow = gear.follow_of_pistons
    parts = tuple(
        Part(name, mesh.moved(matrix), surfaces[name], follow(name, mesh.vertices))
        for name, mesh in model.parts().items()
    )
    return Scene(
        name="lego",
        parts=parts,
        lights=(AreaLight((2.6, 3.2, 3.8), 3.0, 190.0, (1.0, 0.95, 0.87), (0.0, 0.0, -0.1)),),
        sky=Gradient(((0.3, 0.28, 0.26), (0.55, 0.54, 0.54), (0.85, 0.95, 1.12))),
    )


def _chassis(model: b.BrickModel) -> None:
    beam = b.beam(16).moved(m.frame((-8.0, 2.5, 2.5), (0, 1, 0), (1, 0, 0)))
    gear.mirror(model, "chassis", beam)
    for x in (-8, -4, 0, 4):
        model.brick("frame", (x, -2, 1.9), (4, 4, 0.8), studs=False)
    for x, n in ((-8, 4), (-4, 6), (2, 6)):
        model.brick("chassis", (x, -3, 3.1), (n, 6, 0.4))
    for side in (-1, 1):
        y = 2 if side > 0 else -3
        for x in (-7, -4, -1, 1):
            model.brick("chassis", (x, y, 3.5), (2, 1, 1.2))
        model.brick("frame", (-7, y, 4.7), (10, 1, 0.4))
        y = 2 if side > 0 else -6
        for x, n in ((-8, 4), (-4, 4), (0, 3)):
            model.brick("fender", (x, y, 5.1), (n, 4, 0.4))
        model.add("fender", _mudguard(3.0, side))
        model.brick("lights", (-8, 4 * side - (side < 0), 5.5), (1, 1, 0.4))
    _tank(model)
    for x in (-5, -3, -2, 1, 2, 3, 4, 7):
        gear.mirror(model, "pins", b.pin().moved(m.frame((x, 2.988, 2.5), (0, 1, 0))))


def _mudguard(x: float, side: int) -> Mesh:
    outline = np.array([(0.0, 0.0), (1.6, 0.0), (1.6, 0.1), (0.25, 0.38), (0.0, 0.38)])
    mesh = s.prism(outline, -1.98, 1.98, 0.03)
    return mesh.moved(m.frame((x + 0.01, 4.0 * side, 5.1), (0, -1, 0), (1, 0, 0)))


def _tank(model: b.BrickModel) -> None:
    model.brick("body", (-8, -2, 3.5), (1, 2, 1.2))
    model.brick("body", (-8, 0, 3.5), (1, 2, 1.2))
    model.brick("body", (-8, -2, 4.7), (1, 4, 0.4))
    model.brick("grey", (-8, -2, 5.1), (1, 4, 0.4))
    for k in range(2):
        model.brick("body", (-8, -2 + 2 * k, 5.5), (2, 2, 1.2))
    model.brick("body", (-8, -2, 6.7), (2, 4, 0.4))
    model.add("label", _panel((-8.03, 1.8, 5.6), (0, -3.6, 0), (0, 0, 1.0)), mapped=True)
    for y in (-1.0, 1.0):
        cap = m.revolve([(0.42, 0.0), (0.42, 0.22), (0.36, 0.3), (0.15, 0.3), (0.15, 0.4), (0.0, 0.4)], 20)
        model.add("engine", cap.moved(m.frame((-7.0, y, 7.28), (0, 0, 1))))


def _panel(origin: tuple, right: tuple, up: tuple, thick: float = 0.05) -> Mesh:
    """A thin tile whose printed face spans `right` × `up` from `origin`; the print is the whole texture."""
    o, r, u = (np.asarray(v, float) for v in (origin, right, up))
    normal = np.cross(r, u) / np.linalg.norm(np.cross(r, u))
    low = np.array([o, o + r, o + r + u, o + u])
    high, inset = low + normal * thick, 0.03
    centre = high.mean(0)
    top = high + (centre - high) * inset
    walls = s.strip(low, top)
    face = s.facets([top])
    walls = Mesh(walls.vertices, walls.triangles, np.full((len(walls.triangles), 3, 2), 0.004))
    corner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return m.join([walls, Mesh(face.vertices, face.triangles, corner[face.triangles])])


def _hood(model: b.BrickModel) -> None:
    for x, n in ((2, 3), (5, 3)):
        model.brick("body", (x, -2, 6.3), (n, 2, 1.2))
        model.brick("body", (x, 0, 6.3), (n, 2, 1.2))
    model.brick("body", (2, -2, 7.5), (2, 4, 0.4))
    model.brick("grey", (4, -2, 7.5), (1, 4, 0.4))
    model.brick("body", (5, -2, 7.5), (2, 4, 0.4))
    slope = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 0.08), (0.35, 0.4), (0.0, 0.4)])
    nose = s.prism(slope, -1.98, 1.98, 0.03).moved(m.frame((7.01, 0, 7.5), (0, -1, 0), (1, 0, 0)))
    model.add("body", nose)
    for side in (-1, 1):
        start, right = (2.15, -2.0, 6.42), (5.7, 0.0, 0.0)
        if side > 0:
            start, right = (7.85, 2.0, 6.42), (-5.7, 0.0, 0.0)
        model.add("label", _panel(start, right, (0.0, 0.0, 0.96)), mapped=True)
    exhaust = [(5.5, 1.0, 7.7), (5.5, 1.0, 9.0), (5.5, 1.0, 10.2), (5.35, 1.0, 10.6), (4.9, 1.0, 10.85)]
    path = m.spline(exhaust, 8)
    model.add("chrome", m.sweep(path, m.circle(0.3, 18), up=(1, 0, 0)))
    muffler = [(0.0, 0.0), (0.36, 0.0), (0.55, 0.12), (0.55, 1.5), (0.36, 1.62), (0.0, 1.62)]
    model.add("engine", m.revolve(muffler, 24).moved(m.frame((5.5, 1.0, 8.25), (0, 0, 1))))
    intake = [
        (0.0, 0.0), (0.22, 0.0), (0.22, 0.9), (0.55, 0.92), (0.6, 1.0), (0.6, 1.45), (0.4, 1.7), (0.0, 1.75),
    ]  # fmt: skip
    model.add("engine", m.revolve(intake, 24).moved(m.frame((5.5, -1.0, 7.88), (0, 0, 1))))


def _engine(model: b.BrickModel) -> None:
    model.brick("engine", (2, -2, 3.5), (5, 4, 1.2), studs=False)
    model.brick("engine", (2, -2, 4.7), (5, 4, 1.6), studs=False)
    ribs = [(0.62, 0.0)]
    for k in range(5):
        z = 0.08 + 0.2 * k
        ribs += [(0.42, z), (0.42, z + 0.06), (0.62, z + 0.09), (0.62, z + 0.17)]
    outline = [*ribs[1:], (0.3, 1.1), (0.0, 1.1)]
    cylinder = m.revolve([(0.0, -0.1), (0.42, -0.1), *outline], 24)
    cap = m.revolve([(0.0, 1.06), (0.3, 1.06), (0.3, 1.24), (0.22, 1.3), (0.0, 1.3)], 16)
    for x in (2.8, 4.3, 5.8):
        at = m.frame((x, 1.98, 5.35), (0, 1, -0.35))
        gear.mirror(model, "engine", cylinder.moved(at))
        gear.mirror(model, "red", cap.moved(at))
    model.brick("grey", (7, -2, 3.5), (1, 4, 2.8), studs=False)
    for z in np.arange(3.75, 6.1, 0.42):
        model.add("engine", s.block((7.9, -1.6, z), (8.12, 1.6, z + 0.22), 0.04))
    lamp = m.revolve([(0.0, 0.0), (0.5, 0.0), (0.5, 0.3), (0.44, 0.36), (0.4, 0.36), (0.36, 0.25)], 24)
    glass = m.revolve([(0.4, 0.22), (0.4, 0.26), (0.3, 0.36), (0.15, 0.42), (0.0, 0.44)], 24)
    for y in (-1.3, 1.3):
        at = m.frame((7.98, y, 6.88), (1, 0, 0))
        model.add("engine", lamp.moved(at))
        model.add("lens", glass.moved(at))


def _cab(model: b.BrickModel) -> None:
    for x, y in ((0.5, 2.5), (0.5, -2.5), (-5.5, 2.5), (-5.5, -2.5)):
        post = b.beam(6, height=1.0).moved(m.frame((x, y, 5.5), (1, 0, 0), (0, 0, 1)))
        model.add("cab", post)
        for z in (6.5, 8.5, 10.5):
            model.add("cab_pins", b.pin().moved(m.frame((x + 0.488, y, z), (1, 0, 0))))
    rail = b.beam(5, height=1.0).moved(m.frame((-5.0, 2.5, 9.95), (0, 1, 0), (1, 0, 0)))
    gear.mirror(model, "cab", rail)
    for x, n in ((-6, 4), (-2, 3)):
        model.brick("cab", (x, -3, 11.5), (n, 3, 0.4))
        model.brick("cab", (x, 0, 11.5), (n, 3, 0.4))
    for y in (-3, 1):
        model.brick("cab_trim", (0, y, 11.9), (1, 2, 0.4))
    _roof_lamps(model)
    model.brick("body", (0, -2, 5.1), (1, 4, 1.2))
    model.brick("grey", (0, -2, 6.3), (1, 4, 0.4))
    for z in (7.3, 8.5, 9.7):
        bar = np.array([(-5.5, y, z) for y in np.linspace(-2.1, 2.1, 9)])
        model.add("cab_trim", m.sweep(bar, m.circle(0.16, 12)))
    _inside(model)


def _roof_lamps(model: b.BrickModel) -> None:
    for y in (-1.5, 1.5):
        model.add("cab_trim", s.block((0.75, y - 0.5, 10.55), (1.5, y + 0.5, 11.4), 0.08))
        dome = m.revolve([(0.36, 0.0), (0.36, 0.05), (0.25, 0.14), (0.0, 0.19)], 20)
        model.add("cab_lens", dome.moved(m.frame((1.49, y, 10.97), (1, 0, 0))))
    for y in (-0.9, 0.9):
        model.add("cab_trim", s.block((0.9, y - 0.12, 11.1), (1.1, y + 0.12, 11.52), 0.03))
    foot = m.revolve([(0.62, 0.0), (0.62, 0.2), (0.5, 0.26), (0.0, 0.26)], 24)
    model.add("cab_trim", foot.moved(m.frame((-4.0, 0.0, 12.08), (0, 0, 1))))
    glass = [
        (0.46, 0.2), *((0.46 - 0.03 * (k % 2), 0.25 + 0.09 * k) for k in range(8)), (0.36, 1.02), (0.0, 1.12),
    ]  # fmt: skip
    model.add("beacon", m.revolve(glass, 28).moved(m.frame((-4.0, 0.0, 12.1), (0, 0, 1))))


def _inside(model: b.BrickModel) -> None:
    model.brick("frame", (-6, -2, 5.1), (6, 4, 0.4))
    model.brick("seat", (-5, -1, 5.5), (2, 2, 1.0), studs=False)
    model.add("seat", s.block((-4.95, -1.1, 6.48), (-2.7, 1.1, 6.95), 0.14))
    model.add("seat", s.block((-5.15, -1.1, 6.9), (-4.6, 1.1, 8.9), 0.14))
    for z in (7.35, 7.85, 8.35):
        model.add("seat", s.block((-4.62, -0.9, z), (-4.5, 0.9, z + 0.35), 0.05))
    axis = np.array([-0.55, 0.0, 0.83])
    top = np.array([-0.2, 0.0, 6.2]) + 1.9 * axis
    model.add("controls", b.axle(2.0, 0.2).moved(m.frame(top - 1.95 * axis, axis)))
    angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    ring = 0.75 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    rim = m.sweep(ring, m.circle(0.13, 10), up=(0, 0, 1), closed=True)
    spokes = [s.block((-0.72, -0.1, -0.06), (0.72, 0.1, 0.06), 0.03).moved(m.frame((0, 0, 0), (0, 0, 1), d))
              for d in ((1, 0, 0), (0.5, 0.866, 0))]  # fmt: skip
    model.add("controls", m.join([rim, *spokes]).moved(m.frame(top, axis)))
    for y in (-1.6, 1.6):
        rod = np.array([(-1.4 + 0.15 * k, y, 5.4 + 0.45 * k) for k in range(5)])
        model.add("controls", m.sweep(rod, m.circle(0.1, 10)))
        ball = [(0.26 * np.sin(a), -0.26 * np.cos(a)) for a in np.linspace(0, np.pi, 11)]
        model.add("red", m.revolve(ball, 18).moved(m.frame(rod[-1], (0, 0, 1))))
