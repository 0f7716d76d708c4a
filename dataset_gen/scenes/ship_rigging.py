"""Masts, yards, furled sails, shrouds, stays and flags of the scene "ship"."""

import numpy as np

from .. import meshes as m
from ..scene import Part, part
from ..shapes import vessel
from ..shapes.scatter import both, shifted, slab
from . import ship_surfaces as paint
from .ship_fittings import BOWSPRIT, BULWARKS, FORE, HULL, MAIN, MASTS, MIZZEN, MastPlan

_UP = np.array([0.0, 0.0, 1.0])
_TOP = [
    (0.02, -0.012), (0.045, -0.012), (0.075, -0.002), (0.078, 0.002), (0.078, 0.012), (0.072, 0.012),
    (0.072, 0.004), (0.02, 0.004),
]  # fmt: skip
_THICK, _MID, _THIN = 0.0042, 0.0032, 0.0025  # radii of ropes


def parts() -> tuple[Part, ...]:
    return (*_spars(), *_sails(), *_standing(), *_running(), *_flags())


def _mast(plan: MastPlan) -> list[m.Mesh]:
    """Lower mast, topmast and topgallant mast, each fidded before the one below."""
    r = plan.radius
    lap = 0.07
    return [
        vessel.spar(plan.at(plan.foot - 0.05), plan.at(plan.top + lap), (r, 1.05 * r, 0.95 * r, 0.75 * r)),
        vessel.spar(
            plan.at(plan.top - 0.02, 1.6 * r),
            plan.at(plan.crosstrees + 0.6 * lap, 1.6 * r),
            (0.7 * r, 0.66 * r, 0.5 * r),
        ),
        vessel.spar(
            plan.at(plan.crosstrees - 0.01, 2.5 * r),
            plan.at(plan.head, 2.5 * r),
            (0.46 * r, 0.4 * r, 0.22 * r),
        ),
    ]


def _platforms(plan: MastPlan) -> list[m.Mesh]:
    r, size = plan.radius, plan.radius / 0.022
    top = m.revolve([(size * r, z) for r, z in _TOP], 24)
    made = [shifted(top, plan.at(plan.top, 0.8 * r))]
    for z, forward, scale in ((plan.top + 0.066, 0.8 * r, 1.0), (plan.crosstrees + 0.04, 2.0 * r, 0.66)):
        made.append(
            shifted(
                slab((-2.1 * r * scale, -1.2 * r * scale, 0), (2.1 * r * scale, 1.2 * r * scale, 0.014)),
                plan.at(z, forward),
            )
        )
    for dx in (-0.5, 0.9):
        made.append(
            shifted(
                slab((-0.004, -0.05 * size, -0.005), (0.004, 0.05 * size, 0.004)),
                plan.at(plan.crosstrees, (2.0 + dx) * r),
            )
        )
    return made


def _yard_ends(plan: MastPlan, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Starboard and port yardarm; yards lie before the mast, braced round a little."""
    z, half, _ = plan.yards[number]
    middle = plan.at(z, (1.9, 2.9, 3.3)[number] * plan.radius)
    turn = np.radians(plan.brace + 3.0 * number)
    across = np.array([np.sin(turn), np.cos(turn), 0.0])
    return middle - half * across, middle + half * across


def _yards(plan: MastPlan) -> list[m.Mesh]:
    made = []
    for number, (_, half, _) in enumerate(plan.yards):
        thick = 0.030 * half + 0.0035
        made.append(
            vessel.spar(
                *_yard_ends(plan, number), (0.45 * thick, 0.85 * thick, thick, 0.85 * thick, 0.45 * thick), 10
            )
        )
    return made


def _lateen() -> tuple[np.ndarray, np.ndarray]:
    """Ends of the mizzen's slanting yard."""
    return np.array([-0.27, -0.03, 0.02]), np.array([-0.70, -0.036, 0.44])


def _spritsail() -> tuple[np.ndarray, np.ndarray]:
    """Ends of the yard under the bowsprit."""
    middle = BOWSPRIT[0] + 0.66 * (BOWSPRIT[1] - BOWSPRIT[0]) - [0, 0, 0.026]
    return middle - [0, 0.2, 0], middle + [0, 0.2, 0]


def _spars() -> tuple[Part, ...]:
    masts = [piece for plan in MASTS for piece in _mast(plan)]
    masts.append(vessel.spar(*BOWSPRIT, (0.02, 0.02, 0.016, 0.009)))
    tops = [piece for plan in MASTS for piece in _platforms(plan)]
    yards = [piece for plan in MASTS for piece in _yards(plan)]
    yards.append(vessel.spar(*_lateen(), (0.005, 0.009, 0.009, 0.005), 10))
    yards.append(vessel.spar(*_spritsail(), (0.004, 0.007, 0.008, 0.007, 0.004), 10))
    return (
        part("masts", m.join(masts), paint.mast()),
        part("tops", m.join(tops), paint.joinery()),
        part("yards", m.join(yards), paint.mast()),
    )


def _sails() -> tuple[Part, ...]:
    rng = np.random.default_rng([2031, 70])
    rolls, ties = [], []
    spans = []
    for plan in MASTS:
        for number, (_, half, radius) in enumerate(plan.yards):
            if radius:
                a, b = _yard_ends(plan, number)
                spans.append((a, b, radius, max(7, round(2 * half / 0.062)), 0.012))
    spans.append((*_lateen(), 0.024, 11, 0.0))
    spans.append((*_spritsail(), 0.018, 7, 0.006))
    for a, b, radius, gaskets, sag in spans:
        inset = 0.05 * (b - a)
        before = np.array([0.35 * radius, 0.0, 0.55 * radius])
        canvas, tie = vessel.furled(a + inset + before, b - inset + before, radius, gaskets, rng, sag)
        rolls.append(canvas)
        ties.append(tie)
    return (
        part("sails", m.join(rolls), paint.canvas()),
        part("gaskets", m.join(ties), paint.rope("gaskets", (0.45, 0.34, 0.22), 28)),
    )


def _feet(plan: MastPlan, count: int, spacing: float) -> np.ndarray:
    """Starboard chain plates [N, 3] of a mast's shrouds, on the channel beside the sheer."""
    x = plan.x - 0.015 - spacing * np.arange(count)
    high = next(
        h
        for n, (u, _, h) in BULWARKS.items()
        if n != "poop" and u[0] <= HULL.station(plan.x - 0.05, -0.1) <= u[1]
    )
    rows = []
    for at in x:
        u = HULL.station(float(at), -0.1)
        z = float(HULL.sheer(np.array(u))) + min(high, 0.045) - 0.005
        rows.append(HULL.at(float(at), z, 0.032))
    return np.array(rows)


def _standing() -> tuple[Part, ...]:
    sides = [_shrouds(plan, count) for plan, count in zip(MASTS, (6, 7, 5), strict=True)]
    dark, rungs, eyes, boards = (both(m.join(pieces)) for pieces in zip(*sides, strict=True))
    return (
        part("shrouds", m.join([dark, *_stays()]), paint.rope("shrouds", (0.27, 0.2, 0.14), 24)),
        part("ratlines", rungs, paint.rope("ratlines", (0.52, 0.42, 0.29), 30)),
        part("deadeyes", eyes, paint.joinery()),
        part("channels", boards, paint.oak()),
    )


def _shrouds(plan: MastPlan, count: int) -> tuple[m.Mesh, m.Mesh, m.Mesh, m.Mesh]:
    """Starboard side of a mast: (shrouds and backstays, ratlines, deadeyes, channel)."""
    r, size = plan.radius, plan.radius / 0.022
    feet = _feet(plan, count, 0.03)
    spread = np.column_stack([np.linspace(0.01, -0.012, count), np.full(count, -0.9 * r), np.zeros(count)])
    heads = plan.at(plan.top + 0.012) + spread
    tight, steps = vessel.shrouds(feet + 0.036 * (heads - feet), heads, _MID, 0.021)
    edge = plan.at(plan.top + 0.012) + np.array([[x, -0.07 * size, 0.0] for x in (0.022, 0.002, -0.018)])
    cross = plan.at(plan.crosstrees + 0.02, 1.6 * r) + np.array(
        [[x, -0.008, 0.0] for x in (0.004, 0.0, -0.004)]
    )
    topmast, top_steps = vessel.shrouds(edge, cross, _THIN, 0.019)
    backstays = [
        vessel.rope(feet[-1] - [dx, 0.0, 0.0], plan.at(z, 2.0 * r), _THIN)
        for z, dx in ((plan.crosstrees + 0.02, 0.02), (plan.head - 0.03, 0.05))
    ]
    return (
        m.join([tight, topmast, *backstays]),
        m.join([steps, top_steps]),
        vessel.deadeyes(feet, heads, 0.0075),
        _channel(feet),
    )


def _channel(feet: np.ndarray) -> m.Mesh:
    aft, fore = feet[-1] - [0.075, 0.0, 0.0], feet[0] + [0.02, 0.0, 0.0]
    low, high = min(feet[:, 2].min(), feet[:, 2].max() - 0.011), feet[:, 2].max() - 0.003
    return slab((aft[0], feet[:, 1].min() - 0.006, low), (fore[0], feet[:, 1].max() + 0.037, high), 0.2)


def _stays() -> list[m.Mesh]:
    tip, heel = BOWSPRIT[1], BOWSPRIT[0]

    def on_bowsprit(t: float) -> np.ndarray:
        return np.asarray(heel + t * (tip - heel) + 0.012 * _UP)

    runs = [
        (FORE.at(FORE.top + 0.03), on_bowsprit(0.62), _THICK),
        (FORE.at(FORE.crosstrees + 0.02, 0.03), on_bowsprit(0.86), _MID),
        (FORE.at(FORE.head - 0.03, 0.045), on_bowsprit(0.985), _THIN),
        (MAIN.at(MAIN.top + 0.03), FORE.at(-0.04), _THICK),
        (MAIN.at(MAIN.crosstrees + 0.02, 0.03), FORE.at(FORE.top + 0.02), _MID),
        (MAIN.at(MAIN.head - 0.03, 0.05), FORE.at(FORE.crosstrees + 0.03, 0.03), _THIN),
        (MIZZEN.at(MIZZEN.top + 0.02), MAIN.at(-0.14), _MID),
        (MIZZEN.at(MIZZEN.crosstrees + 0.02, 0.02), MAIN.at(MAIN.top + 0.02), _THIN),
        (MIZZEN.at(MIZZEN.head - 0.02, 0.035), MAIN.at(MAIN.crosstrees - 0.1), _THIN),
        (on_bowsprit(0.9) - [0, 0, 0.02], np.array([0.69, 0.0, -0.21]), _MID),
        (_lateen()[1], MIZZEN.at(MIZZEN.head - 0.06, 0.03), _THIN),
        (_lateen()[1], np.array([-0.83, 0.0, 0.19]), _THIN),
    ]
    return [vessel.rope(a, b, radius, 0.004) for a, b, radius in runs]


def _running() -> tuple[Part, ...]:
    ropes = []
    for plan in MASTS:
        caps = (plan.top + 0.07, plan.crosstrees + 0.045, plan.head - 0.015)
        for number, (z, half, _) in enumerate(plan.yards):
            ends = _yard_ends(plan, number)
            behind = MASTS[MASTS.index(plan) + 1] if plan is not MIZZEN else MAIN
            for arm in ends:
                middle = plan.at(z, 2.0 * plan.radius)
                near = middle + 0.06 * (arm - middle)
                ropes.append(vessel.rope(arm, plan.at(caps[number], 1.6 * plan.radius), _THIN))
                ropes.append(vessel.rope(arm + 0.06 * (middle - arm), near, 0.0019, 0.16 * half, spans=10))
                heights = (behind.top - 0.06, behind.crosstrees - 0.08, behind.head - 0.06)
                ropes.append(vessel.rope(arm, behind.at(min(z + 0.05, heights[number])), 0.0019, 0.012))
    tip = BOWSPRIT[1]
    for arm in _spritsail():
        ropes.append(vessel.rope(arm, tip - 0.02 * _UP, 0.0019))
        ropes.append(
            vessel.rope(arm, HULL.at(0.58, -0.06) * [1, np.sign(arm[1]) * -1, 1] + [0, 0, 0.02], 0.0019, 0.01)
        )
    foot, _ = _lateen()
    ropes.append(vessel.rope(foot, np.array([-0.22, -0.12, -0.06]), _THIN))
    return (part("running", m.join(ropes), paint.rope("running", (0.66, 0.55, 0.37), 31)),)


def _flags() -> tuple[Part, ...]:
    wind = np.radians(245.0)
    staffs = [vessel.spar((-0.825, 0.0, 0.10), (-0.875, 0.0, 0.40), (0.007, 0.006, 0.004), 8)]
    staffs.append(
        vessel.spar(BOWSPRIT[1] + [-0.02, 0, 0.0], BOWSPRIT[1] + [-0.02, 0, 0.16], (0.005, 0.004, 0.003), 8)
    )
    cloths = []
    for plan, length in zip(MASTS, (0.17, 0.26, 0.15), strict=True):
        head = plan.at(plan.head, 2.5 * plan.radius)
        cap = m.revolve([(0.0, -0.008), (0.011, -0.004), (0.011, 0.004), (0.0, 0.008)], 10)
        staffs.append(shifted(cap, head + [0, 0, 0.002]))
        cloths.append(vessel.flag(head - [0, 0, 0.012], (length, 0.04), wind, 1.7, 0.75))
    ensign = vessel.flag((-0.871, 0.0, 0.385), (0.17, 0.115), wind, 1.3)
    jack = vessel.flag(BOWSPRIT[1] + [-0.02, 0, 0.155], (0.11, 0.075), wind, 1.2)
    red, white, blue = (0.70, 0.12, 0.1), (0.9, 0.88, 0.82), (0.12, 0.22, 0.45)
    return (
        part("staffs", m.join(staffs), paint.gilt("staffs")),
        part("pennants", m.join(cloths), paint.flag("pennants", (red, white), 71)),
        part("ensign", m.join([ensign]), paint.flag("ensign", (red, white, blue), 72)),
        part("jack", m.join([jack]), paint.flag("jack", (red, white, blue), 73)),
    )
