"""Working parts of the toy bulldozer: tracks, blade with teeth, push arms and pistons, ripper. Units: studs."""

import numpy as np

from .. import meshes as m
from ..meshes import Mesh
from ..shapes import bricks as b
from ..shapes import solids as s

HINGE = (-0.5, 0.0, 2.5)  # the push arms turn about the y axis through this point
_WHEELS = (-6.0, 5.0)  # x of sprocket and idler
_AXLE_Z = 2.5
_BELT = 1.86  # radius of the links' hinge lines around sprocket and idler
_TRACK_Y = 4.6
_BLADE = (12.7, 3.2, 3.4)  # centre x, centre z and radius of the mouldboard's face
_PISTON = (np.array([3.2, 2.95, 6.9]), np.array([9.0, 2.95, 4.7]))  # from the bonnet to the blade's back


def mirror(model: b.BrickModel, part: str, mesh: Mesh) -> None:
    model.add(part, mesh)
    model.add(part, s.mirrored(mesh, 1))


def _belt(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Places (x, z) and headings of the middle of `count` links around sprocket and idler."""
    x0, x1 = _WHEELS
    straight, arc = x1 - x0, np.pi * _BELT
    total = 2 * straight + 2 * arc
    at = (np.arange(count) + 0.5) / count * total
    x, z, heading = np.empty(count), np.empty(count), np.empty(count)
    for i, d in enumerate(at):
        if d < straight:  # along the ground, forward
            x[i], z[i], heading[i] = x0 + d, -_BELT, 0.0
        elif d < straight + arc:
            a = (d - straight) / _BELT
            x[i], z[i], heading[i] = x1 + _BELT * np.sin(a), -_BELT * np.cos(a), a
        elif d < 2 * straight + arc:  # back on top, sagging a little between the rollers
            t = (d - straight - arc) / straight
            x[i], z[i], heading[i] = x1 - t * straight, _BELT - 0.1 * np.sin(2 * np.pi * t) ** 2, np.pi
        else:
            a = (d - 2 * straight - arc) / _BELT
            x[i], z[i], heading[i] = x0 - _BELT * np.sin(a), _BELT * np.cos(a), np.pi + a
    return np.column_stack([x, z + _AXLE_Z]), heading


def running_gear(model: b.BrickModel) -> None:
    """Linked treads around sprocket and idler, road wheels on a beam, rollers, axles with bushes."""
    count = 46
    places, headings = _belt(count)
    pitch = (2 * (_WHEELS[1] - _WHEELS[0]) + 2 * np.pi * _BELT) / count
    link = b.tread(pitch, 2.6)
    for (x, z), a in zip(places, headings, strict=True):
        out = (np.sin(a), 0.0, -np.cos(a))
        forward = (np.cos(a), 0.0, np.sin(a))
        mirror(model, "tracks", link.moved(m.frame((x, _TRACK_Y, z), out, forward)))
    for x, teeth in zip(_WHEELS, (16, 22), strict=True):
        wheel = b.gear(teeth, _BELT - 0.06, 1.1, spokes=6 if teeth == 16 else 5)
        mirror(model, "wheels", wheel.moved(m.frame((x, _TRACK_Y, _AXLE_Z), (0, 1, 0))))
        mirror(model, "axles", b.axle(4.5).moved(m.frame((x, 1.9, _AXLE_Z), (0, 1, 0))))
        mirror(model, "wheels", b.bush(0.5, 0.6).moved(m.frame((x, 5.35, _AXLE_Z), (0, 1, 0))))
    beam = b.beam(6).moved(m.frame((-3.5, _TRACK_Y, _AXLE_Z + 0.2), (0, 1, 0), (1, 0, 0)))
    mirror(model, "frame", beam)
    for x in (-3.2, -1.4, 0.4, 2.2):
        mirror(model, "wheels", b.wheel(0.62, 1.5).moved(m.frame((x, _TRACK_Y, 1.55), (0, 1, 0))))
    for x in (-2.5, 1.5):
        mirror(model, "wheels", b.wheel(0.4, 1.5).moved(m.frame((x, _TRACK_Y, 3.56), (0, 1, 0))))
    mirror(model, "axles", b.axle(5.4).moved(m.frame((HINGE[0], 1.9, HINGE[2]), (0, 1, 0))))


def _face(angles: np.ndarray, radius: float) -> np.ndarray:
    x, z, _ = _BLADE
    return np.column_stack([x + radius * np.cos(angles), z + radius * np.sin(angles)])


def blade(model: b.BrickModel) -> None:
    """Seven curved columns with studs on top, ribs behind, a striped edge, teeth."""
    angles = np.radians(np.linspace(132.0, 234.0, 22))
    radius = _BLADE[2]
    front, back = _face(angles, radius), _face(angles, radius + 0.62)
    for y in np.arange(-7.0, 7.0, 2.0):
        model.add("blade", s.lamella(front, back, y + 0.012, y + 1.988, 0.05))
    for side in (-1, 1):  # end plates
        y0, y1 = (7.0, 7.4) if side > 0 else (-7.4, -7.0)
        inner, outer = _face(angles, radius - 0.5), _face(angles, radius + 0.7)
        model.add("blade", s.lamella(inner, outer, y0 + 0.012, y1, 0.06))
    top = 0.5 * (front[0] + back[0])
    for y in np.arange(-7.0, 7.0, 2.0):
        model.brick("blade", (top[0] - 0.62, y, top[1] - 0.2), (1, 2, 0.55))
    _edge(model, front[-1], back[-1])
    _ribs(model)


def _edge(model: b.BrickModel, front: np.ndarray, back: np.ndarray) -> None:
    low = 0.5 * (front + back)
    model.add("teeth", s.block((low[0] - 0.42, -7.1, 0.27), (low[0] + 0.48, 7.1, 0.62), 0.06))
    outline = np.array([(0.0, 0.0), (1.5, 0.0), (1.5, 0.07), (0.45, 0.48), (0.0, 0.48)])
    tooth = s.prism(outline, -0.36, 0.36, 0.04)
    for y in np.linspace(-6.3, 6.3, 8):
        model.add("teeth", tooth.moved(m.frame((low[0] + 0.3, y, 0.24), (0, -1, 0), (1, 0, 0))))
        bolt = m.revolve([(0.0, 0.0), (0.15, 0.0), (0.15, 0.1), (0.1, 0.14), (0.0, 0.14)], 12)
        model.add("blade_pins", bolt.moved(m.frame((low[0] + 0.55, y, 0.7), (0, 0, 1))))
    a = np.radians(np.linspace(196.0, 214.0, 7))
    near, far = _face(a, _BLADE[2] - 0.05), _face(a, _BLADE[2] + 0.02)
    for y in np.arange(-7.0, 7.0, 2.0):
        sheet = s.lamella(near, far, y + 0.1, y + 1.9)
        model.add("stripes", _striped(sheet), mapped=True)


def _striped(sheet: Mesh) -> Mesh:
    """Texture coordinates of a striped sticker: u across the blade, v up."""
    corners = sheet.vertices[sheet.triangles]
    u = (corners[..., 1] + 7.0) / 4.0
    v = (corners[..., 2] - 1.2) / 1.2
    return Mesh(sheet.vertices, sheet.triangles, np.stack([u, np.clip(v, 0.0, 1.0)], -1))


def _ribs(model: b.BrickModel) -> None:
    behind = _BLADE[0] - _BLADE[2] - 0.62
    beam = b.beam(14).moved(m.frame((behind - 0.3, -7.0, 2.5), (1, 0, 0), (0, 1, 0)))
    model.add("blade", beam)
    for y in np.arange(-6.0, 7.0, 3.0):
        model.add("blade_pins", b.pin().moved(m.frame((behind - 0.79, y, 2.5), (-1, 0, 0))))
    angles = np.radians(np.linspace(140.0, 226.0, 14))
    for y in (-4.6, -1.0, 1.0, 4.6):
        inner, outer = _face(angles, _BLADE[2] + 0.55), _face(angles, _BLADE[2] + 0.85)
        model.add("teeth", s.lamella(inner, outer, y - 0.25, y + 0.25, 0.05))
    for y in (-2.95, 2.95):
        for dy in (-0.42, 0.3):
            model.add("teeth", s.block((8.35, y + dy, 4.2), (9.2, y + dy + 0.14, 5.1), 0.03))
        model.add("blade_pins", b.axle(1.1, 0.22).moved(m.frame((8.75, y - 0.55, 4.72), (0, 1, 0))))


def arms(model: b.BrickModel) -> None:
    """Push arms outside the tracks, hinged at the track frames, and the two lift pistons."""
    arm = b.beam(10).moved(m.frame((-1.5, 6.7, 2.5), (0, 1, 0), (1, 0, 0)))
    mirror(model, "arms", arm)
    for x in (1.5, 3.5, 5.5, 7.5):
        mirror(model, "blade_pins", b.pin().moved(m.frame((x, 7.188, 2.5), (0, 1, 0))))
    mirror(model, "wheels", b.bush(0.46, 0.3).moved(m.frame((HINGE[0], 6.0 - 0.15, HINGE[2]), (0, 1, 0))))
    foot, head = _PISTON
    along = (head - foot) / np.linalg.norm(head - foot)
    length = float(np.linalg.norm(head - foot))
    barrel = [(0.0, 0.0), (0.42, 0.0), (0.5, 0.06), *((0.5, z) for z in np.linspace(0.4, 3.4, 9)),
              (0.58, 3.42), (0.58, 3.8), (0.5, 3.88), (0.3, 3.88)]  # fmt: skip
    mirror(model, "pistons", m.revolve(barrel, 24).moved(m.frame(foot, along)))
    rod = [
        (0.0, 3.0),
        (0.26, 3.0),
        *((0.26, z) for z in np.linspace(3.3, length - 0.1, 10)),
        (0.0, length - 0.1),
    ]
    mirror(model, "rods", m.revolve(rod, 20).moved(m.frame(foot, along)))
    eye = m.revolve([(0.0, -0.26), (0.36, -0.26), (0.42, -0.2), (0.42, 0.2), (0.36, 0.26), (0.0, 0.26)], 20)
    mirror(model, "rods", eye.moved(m.frame(head - 0.02 * along, (0, 1, 0))))
    mirror(model, "pins", eye.moved(m.frame(foot, (0, 1, 0))))
    mirror(model, "axles", b.axle(1.6, 0.22).moved(m.frame(foot - [0, 1.1, 0], (0, 1, 0))))


def follow_of_pistons(name: str, vertices: np.ndarray) -> np.ndarray:
    """Return [V]: pistons turn about their feet: they follow the blade by how far along they are; all else wholly."""
    if name not in ("pistons", "rods"):
        return np.ones(len(vertices))
    foot, head = _PISTON
    line = (head - foot)[[0, 2]]
    along = (vertices[:, [0, 2]] - foot[[0, 2]]) @ line / (line @ line)
    return np.clip(along, 0.0, 1.0)


def ripper(model: b.BrickModel) -> None:
    """Return the ripper: two beams, a cross beam and three shanks that end in claws."""
    for y in (-1.5, 1.5):
        arm = b.beam(4).moved(m.frame((-11.0, y, 2.9), (0, 1, 0), (1, 0, 0)))
        model.add("ripper", arm)
        for x in (-10, -9):
            model.add("pins", b.pin().moved(m.frame((x, y + np.sign(y) * 0.488, 2.9), (0, np.sign(y), 0))))
    model.add("ripper", s.block((-11.9, -3.5, 2.3), (-10.9, 3.5, 3.5), 0.07))
    curve = m.spline(
        [(-11.4, 0, 4.2), (-11.45, 0, 3.0), (-11.6, 0, 1.9), (-11.3, 0, 1.0), (-10.7, 0, 0.45)], 6
    )
    line = curve[:, [0, 2]]
    direction = np.gradient(line, axis=0)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    normal = np.column_stack([-direction[:, 1], direction[:, 0]])
    wide = np.interp(np.linspace(0, 1, len(line)), [0.0, 0.7, 1.0], [0.45, 0.4, 0.06])[:, None]
    shank = s.lamella(line - normal * wide, line + normal * wide, -0.28, 0.28, 0.04)
    for y in (-2.6, 0.0, 2.6):
        model.add("claws", s.copies(shank, [(0.0, y, 0.0)]))
