"""The methods by name, as `--methods` and `tg4mm bench job` take them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tg4mm.research.bench import BenchError
from tg4mm.research.bench.folder import SET
from tg4mm.research.bench.methods import Method, Trained
from tg4mm.research.bench.methods.external import External
from tg4mm.research.bench.methods.tracking import NAME as TRACKING
from tg4mm.research.bench.methods.tracking import tracking
from tg4mm.research.bench.methods.video import Linear2D, Phase2D
from tg4mm.research.bench.request import SCORINGS, Training
from tg4mm.research.evaluate.run import CEILING, STATIC

BASELINES = (TRACKING, Phase2D.name, Linear2D.name)
NAMES = (*SCORINGS, *BASELINES)
_TAKEN = {*NAMES, STATIC, CEILING, SET}  # folders of rows; some file systems know no upper case
ABOUT = {
    "modal": "tg4mm's own; Gaussians and a few shapes of motion with their courses over time, from all views at once",
    "paper": "the method of TG4MM, the paper that this program implements; magnified by `linear` or `phase`",
    "paper-tuned": "the method of TG4MM, the paper that this program implements, in minutes; by `linear` or `phase`",
    TRACKING: "Gaussians moved by a deformation network, in the manner of 4DGS",
    Phase2D.name: "phase-based magnification of each test view's own video, in complex sub-bands of half an octave",
    Linear2D.name: "linear Eulerian magnification of each test view's own video",
}
DEFAULT = ("modal", "paper-tuned", *BASELINES)


def checked_names(names: Sequence[str]) -> tuple[str, ...]:
    """The names. Raises BenchError for one that is none, given twice, or for no name at all."""
    if not names or names == [""]:
        raise BenchError(f"--methods is empty, expected some of {', '.join(NAMES)}")
    for i, name in enumerate(names):
        if name not in NAMES:
            raise BenchError(f"--methods holds {name!r}, expected some of {', '.join(NAMES)}")
        if name in names[:i]:
            raise BenchError(f"--methods names {name} twice")
    return tuple(names)


def methods_of(
    names: Sequence[str], settings: Mapping[str, Mapping[str, str]], external: Sequence[External] = ()
) -> list[Method]:
    """The methods, in order; the first preset also gives the rows of its Gaussians at rest and moved exactly.

    settings: {preset: as `tg4mm train --set`}; tracking has those of `modal` and its own. Raises BenchError for an
    outside method that is called as one of this program's.
    """
    reference = next((n for n in names if n in SCORINGS), None)
    made = [_method(n, settings, n == reference) for n in names]
    for outside in external:
        if outside.name.lower() in _TAKEN:
            raise BenchError(f"--external {outside.name}: that is the name of a row here; choose another")
    return [*made, *external]


def _method(name: str, settings: Mapping[str, Mapping[str, str]], framing: bool) -> Method:
    if name in SCORINGS:
        return Trained(Training(name, name, settings.get(name, {})), framing)
    if name == TRACKING:
        return tracking(settings.get("modal", {}), settings.get(TRACKING, {}))
    return Phase2D() if name == Phase2D.name else Linear2D()
