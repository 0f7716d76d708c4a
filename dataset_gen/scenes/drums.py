"""The scene "drums": a drum kit on a round rug; cymbals rock on their stands and the front head breathes."""

import numpy as np

from .. import meshes as m
from ..meshes import Mesh
from ..scene import AreaLight, Gradient, Scene, Surface, part
from ..shapes import drums as d
from ..shapes import drums as tb
from ..shapes import solids as s
from . import drums_hardware as hw
from . import drums_surfaces as paint

FLOOR = hw.FLOOR
PLACE = m.frame((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (np.cos(np.radians(18.0)), np.sin(np.radians(18.0)), 0.0))
_FIT = 0.96  # brings the rug's edge into every picture
PLACE[:3, :3] *= _FIT
_TILE = 0.7  # scene units that one tile of glitter covers

BASS = d.Drum(0.36, 0.52, 10, wooden_hoops=True)
TOMS = (
    # drum, middle of its head, normal of its head
    (d.Drum(0.16, 0.2, 6), (-0.215, 0.06, 0.30), (0.1, -0.36, 0.92)),
    (d.Drum(0.185, 0.22, 6), (0.235, 0.05, 0.30), (-0.1, -0.36, 0.92)),
    (d.Drum(0.25, 0.42, 8), (0.64, -0.33, 0.0), (-0.05, -0.06, 1.0)),
)
SNARE = (d.Drum(0.22, 0.16, 10), (-0.40, -0.42, 0.02), (0.04, -0.08, 1.0))
BASS_FRONT = (0.0, 0.42, FLOOR + 0.416)  # middle of the front head
_BASS_AXIS = (0.0, 1.0, 0.03)


def build() -> Scene:
    parts = [*_bass(), *_toms(), *_snare(), *hw.cymbals(), *hw.stands(), *hw.pedal(), *hw.throne(), _rug()]
    return Scene(
        name="drums",
        parts=tuple(part(name, mesh.moved(PLACE), surface) for name, mesh, surface in parts),
        lights=(
            AreaLight((2.4, 3.0, 3.8), 3.2, 170.0, (1.0, 0.95, 0.88)),
            AreaLight((-3.4, -1.2, 2.6), 3.0, 55.0, (0.86, 0.92, 1.0)),
        ),
        sky=Gradient(((0.25, 0.22, 0.2), (0.5, 0.48, 0.47), (0.78, 0.9, 1.1))),
        unit_scale_m=0.81,
    )


def _at(where: tuple, normal: tuple) -> np.ndarray:
    """Frame of a drum: its head's middle, and x towards the audience (for upright drums)."""
    up = (0.0, 1.0, 0.0) if abs(normal[2]) > 0.5 else (0.0, 0.0, 1.0)
    return m.frame(where, normal, up)


def _metal(mesh: Mesh) -> Mesh:
    return s.cube_mapped(mesh, 0.3)


def _bass() -> list[tuple[str, Mesh, Surface]]:
    """The bass drum lies on its spurs; its front head is at z = 0 of the frame."""
    at = _at(BASS_FRONT, _BASS_AXIS)
    back = m.join([d.head(BASS.radius, up=False).moved(m.shift((0.0, 0.0, -BASS.depth)))])
    spurs, tips = [], []
    for side in (-1.0, 1.0):
        top = np.array([side * 0.35, 0.2, FLOOR + 0.33])
        foot = np.array([side * 0.46, 0.44, FLOOR + 0.02])
        spurs.append(tb.tube(np.linspace(top, foot, 6), 0.014, 0.01))
        spurs.append(tb.collar(top, 0.035, 0.05, (side, 0.0, -0.05)))
        spurs.append(tb.wing_nut(top + [side * 0.024, 0, 0], (side, 0.0, 0.0), 0.06))
        tips.append(tb.rubber_foot(foot - [0, 0, 0.02], 0.022))
    return [
        ("bass_shell", d.shell(BASS, _TILE).moved(at), paint.shells()),
        ("bass_hoops", d.hoops(BASS).moved(at), paint.bass_hoops()),
        ("bass_fittings", _metal(m.join([d.fittings(BASS).moved(at), *spurs])), paint.chrome("bass_fittings")),
        ("bass_front", d.head(BASS.radius, True, 36, 96).moved(at), paint.front_head()),
        ("bass_batter", back.moved(at), paint.batter("bass_batter", 1)),
        ("bass_feet", s.cube_mapped(m.join(tips), 0.2), paint.rubber("bass_feet")),
    ]  # fmt: skip


def _toms() -> list[tuple[str, Mesh, Surface]]:
    shells, fittings, heads, below, feet = [], [], [], [], []
    for drum, where, normal in TOMS:
        at = _at(where, normal)
        shells.append(d.shell(drum, _TILE).moved(at))
        fittings += [d.hoops(drum).moved(at), d.fittings(drum).moved(at)]
        heads.append(d.head(drum.radius, True).moved(at))
        below.append(d.head(drum.radius, False, 3).moved(m.shift((0.0, 0.0, -drum.depth))).moved(at))
    for angle in np.radians([20.0, 140.0, 260.0]):
        leg, bracket, foot = hw.floor_leg(TOMS[2][1], TOMS[2][0].radius, angle)
        fittings += [leg, bracket]
        feet.append(foot)
    fittings += hw.tom_mount([(where, np.array(normal), drum) for drum, where, normal in TOMS[:2]])
    return [
        ("tom_shells", m.join(shells), paint.shells()),
        ("tom_fittings", _metal(m.join(fittings)), paint.chrome("tom_fittings")),
        ("tom_heads", m.join(heads), paint.batter("tom_heads", 2)),
        ("undersides", m.join(below), paint.resonant()),
        ("tom_feet", s.cube_mapped(m.join(feet), 0.2), paint.rubber("tom_feet")),
    ]


def _snare() -> list[tuple[str, Mesh, Surface]]:
    drum, where, normal = SNARE
    at = _at(where, normal)
    steel, rubber = hw.snare_stand(where, np.array(normal), drum)
    shell = d.shell(drum, drum.depth)
    sticks = []
    for x, heading in ((-0.06, 0.3), (0.06, 0.4)):
        # The butt lies on the head, the neck on the hoop.
        out, start = (np.sin(heading), np.cos(heading), 0.065), (x, -0.18, 0.0105)
        sticks.append(hw.stick().moved(m.frame(start, out)).moved(m.frame(where, normal, (1.0, 0.0, 0.0))))
    strainer = [
        s.block((drum.radius - 0.002, -0.03, -0.12), (drum.radius + 0.03, 0.03, -0.05), 0.006).moved(at),
        tb.wing_nut((drum.radius + 0.028, 0.0, -0.085), (1, 0, 0), 0.05).moved(at),
    ]
    metal = m.join([d.hoops(drum).moved(at), d.fittings(drum).moved(at), *strainer, steel])
    return [
        ("snare_shell", shell.moved(at), paint.snare_shell()),
        ("snare_fittings", _metal(metal), paint.chrome("snare_fittings")),
        ("snare_head", d.head(drum.radius, True, 28, 84).moved(at), paint.batter("snare_head", 3)),
        (
            "snare_below",
            d.head(drum.radius, False, 3).moved(m.shift((0.0, 0.0, -drum.depth))).moved(at),
            paint.resonant(),
        ),
        ("snare_rubber", s.cube_mapped(rubber, 0.2), paint.rubber("snare_rubber")),
        ("sticks", m.join(sticks), paint.wood()),
    ]


def _rug() -> tuple[str, Mesh, Surface]:
    edge, thick = 1.15, 0.012
    outline = [
        (0.0, -thick), (edge, -thick), (edge + 0.006, -0.006), (edge, 0.0),
        *((r, 0.0) for r in (0.8, 0.4, 0.0)),
    ]  # fmt: skip
    mesh = m.revolve(outline, 128)
    flat = 0.5 + 0.5 * mesh.vertices[mesh.triangles][..., :2] / (edge + 0.01)
    lying = Mesh(mesh.vertices + [0.0, 0.0, FLOOR], mesh.triangles, flat)
    return "rug", lying, paint.rug()
