"""Metres per scene unit, from what was measured on the spot."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tg4mm.errors import Tg4mmError
from tg4mm.sfm.dataset import Track


def baseline_scale(tracks: Sequence[Track], baseline: tuple[str, str, float]) -> float:
    """Metres per unit from the distance of two cameras (or photographs) in metres.

    Raises Tg4mmError where one is not placed, moves, or both stand at one place.
    """
    *ends, metres = baseline
    still = {track.name: track for track in tracks if (track.viewmats == track.viewmats[0]).all()}
    found = []
    for name in ends:
        stem = Path(name).stem
        key = next((key for key in (name, stem, f"sweep_{stem}") if key in still), None)
        if key is None:
            known = ", ".join(list(still)[:8])
            raise Tg4mmError(f"--baseline names {name}, which is no placed camera; there are {known} …")
        viewmat = still[key].viewmats[0]
        found.append(-viewmat[:3, :3].T @ viewmat[:3, 3])
    apart = float(np.linalg.norm(found[0] - found[1]))
    if apart < 1e-6:
        raise Tg4mmError(f"--baseline: {ends[0]} and {ends[1]} stand at one place")
    return metres / apart
