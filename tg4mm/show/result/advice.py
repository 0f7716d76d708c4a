"""What to do with a result: a magnification that shows the motion, and the command line that renders it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

from tg4mm.capture import Capture
from tg4mm.capture.transforms import SPLITS
from tg4mm.run import Run
from tg4mm.show.result.model import Vibration
from tg4mm.show.result.reach import Reach

_SHOWN = 0.04  # of the picture's shorter side: a motion so large is seen well
_STEPS = (1.0, 2.0, 5.0)
_MOST, _DEFAULT = 500.0, 20.0
_ORBIT = 90  # pictures
_MANY = 60  # cameras: more of the training split are rendered for hours


def suggested_alpha(reach: Reach | None, capture: Capture | None) -> float:
    """A round α (1, 2, 5, 10 …) at which the motion is seen well, as long as it stays within its limits.

    The one default of result, report, viewer and page: the largest motion spans 4 % of the picture's shorter side,
    which a person sees at once and which leaves shapes whole; less where noise would be seen or parts would tear.

    reach: of the motion that is magnified, as it is.
    """
    if reach is None or reach.pixels is None or capture is None:
        return _DEFAULT
    wanted = 1 + _DEFAULT
    if reach.pixels > 0:
        wanted = _SHOWN * min(capture.width, capture.height) / reach.pixels
    most = min(wanted, 1 / reach.too_far if reach.too_far > 0 else _MOST, _MOST + 1) - 1
    round_ones = [step * 10**power for power in range(3) for step in _STEPS]
    return max((a for a in round_ones if a <= max(most, 1.0)), default=1.0)


def next_command(run: Run, capture: Capture | None, vibrations: Sequence[Vibration], alpha: float) -> str:
    """A `tg4mm render` command line: of the strongest vibration, or of the scene at rest where there is none."""
    out = run.path.with_name(f"{run.path.name}_x{alpha:g}" if vibrations else f"{run.path.name}_rest")
    parts = ["tg4mm", "render", str(run.path), "--alpha", f"{alpha if vibrations else 0:g}"]
    if vibrations:
        parts += ["--band", *(f"{f:g}" for f in vibrations[0].band)]
    return shlex.join([*parts, *_cameras(capture), "--out", str(out)])


def _cameras(capture: Capture | None) -> list[str]:
    """The test cameras where there are some, all training cameras where they are few, else an orbit."""
    if capture is None:
        return ["--orbit", str(_ORBIT)]
    if any(next(capture.root.glob(f"{where}transforms_{SPLITS[1]}.json"), None) for where in ("", "000*/")):
        return []
    few = len(set(capture.camera_ids.tolist())) <= _MANY and capture.kind.seen_by_train
    return ["--split", "train"] if few else ["--orbit", str(_ORBIT)]
