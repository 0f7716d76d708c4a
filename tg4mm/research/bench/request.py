"""Trainings of a benchmark and their magnification, the common plan, and settings sorted by preset."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.magnification import Magnification, TemporalFilter
from tg4mm.research.bench.sets import BenchSet
from tg4mm.research.paper.model import PaperConfig
from tg4mm.run import Run
from tg4mm.run.preset import preset_named
from tg4mm.run.train import parse_settings

SAME_TIME = "modal's time"
# Only `modal` has this setting: with a `paper` preset the base Gaussians' iterations are paper.warm_up.
_OF_MODAL = {"space.iterations"}


@dataclass(frozen=True)
class Scoring:
    """A way to magnify a trained run."""

    name: str
    method: str  # "modal", "linear", "phase"
    filter: str | None = None  # None: the method's default, zero-phase

    def magnified(self, bands: Iterable[tuple[float, float]], alpha: float = 1.0) -> Magnification:
        """Return a magnification by α in the bands, or everywhere without any."""
        chosen = None if self.filter is None else TemporalFilter(self.filter)
        return Magnification.of(alpha, *bands, method=self.method, filter=chosen)


SCORINGS = {
    "modal": (Scoring("modal", "modal"),),
    "paper": (Scoring("linear", "linear"), Scoring("phase", "phase")),
    "paper-tuned": (Scoring("linear", "linear"), Scoring("phase", "phase")),
}


class Trainer(Protocol):
    """A trainer of runs in place of `tg4mm train`."""

    def plain(self) -> dict[str, Any]:
        """Return the settings, in JSON's types."""
        ...

    def overrides(self) -> dict[str, str]:
        """Return the settings that differ from the defaults, as `--set` takes them."""
        ...

    def __call__(self, dataset: Path, place: Path, settings: Mapping[str, str], device: str) -> Run:
        """Train into the folder `place`, or continue there; `settings`: those of the preset."""
        ...


@dataclass(frozen=True)
class Training:
    """A model to train, and its magnification. `settings` as in `tg4mm train --set`."""

    name: str  # a folder's name
    preset: str
    settings: Mapping[str, str] = field(default_factory=dict)
    scorings: tuple[Scoring, ...] = ()  # (): those of the preset
    trainer: Trainer | None = None  # None: `tg4mm train`

    @property
    def ways(self) -> tuple[Scoring, ...]:
        return self.scorings or SCORINGS[self.preset]

    @property
    def overrides(self) -> dict[str, str]:
        """All settings that differ from the defaults."""
        return {**self.settings, **(self.trainer.overrides() if self.trainer else {})}


@dataclass(frozen=True)
class BenchPlan:
    """Options of all runs of a benchmark."""

    alphas: tuple[float, ...] | None = None  # None: all with ground truth
    banded: bool = True  # magnify the band around the motion; False: every frequency
    lpips_weights: tuple[Path, ...] = ()  # of pictures on disk
    device: str = "cpu"
    metrics: tuple[str, ...] = ("ssim",)  # of renderings; the others are computed from pictures on disk

    def bands(self, data: BenchSet) -> tuple[tuple[float, float], ...]:
        """Return the bands that every method magnifies, Hz; (): every frequency."""
        return (data.band_hz,) if self.banded else ()

    def band(self, data: BenchSet) -> list[float] | None:
        """Return the band in JSON's types; None: every frequency."""
        return list(data.band_hz) if self.banded else None


def settings_by_preset(given: Mapping[str, str], presets: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return the settings of each preset.

    Raises Tg4mmError for a setting of none of the presets, and for an invalid value.
    """
    known = {p: setting_names(p) for p in presets}
    for name in given:
        if not any(name in names for names in known.values()):
            listed = ", ".join(sorted(set().union(*known.values()))) or "none"
            raise Tg4mmError(f"--set {name}: no method here has that setting; there are: {listed}")
    chosen = {p: {k: v for k, v in given.items() if k in known[p]} for p in presets}
    for preset, settings in chosen.items():
        check_settings(settings, preset)
    return chosen


def setting_names(preset: str) -> set[str]:
    """Return the names that `--set` accepts with this preset."""
    names = {f"{s}.{f.name}" for s, c in preset_named(preset).defaults.items() for f in dataclasses.fields(c)}
    return names if preset == "modal" else names - _OF_MODAL


def check_settings(settings: Mapping[str, str], preset: str) -> None:
    """Raise Tg4mmError for a setting that `tg4mm train` would refuse, before anything is written."""
    preset_named(preset).check(parse_settings(settings, preset))


def same_time_training(preset: str, settings: dict[str, str], factor: float) -> Training:
    """Return a training of the preset with all iterations times `factor`.

    The factor is measured and differs between machines; the resulting iterations are ordinary settings, are listed on
    the page, and repeat the run bit for bit.
    """
    config: PaperConfig = parse_settings(settings, preset)["paper"]
    warm_up = max(round(config.warm_up * factor), 1)
    scaled = {
        "paper.warm_up": str(warm_up),
        "paper.iterations": str(max(round(config.iterations * factor), warm_up + 1)),
        "paper.motion_iterations": str(max(round(config.motion_iterations * factor), 1)),
    }
    return Training(f"{preset}, {SAME_TIME}", preset, {**settings, **scaled})
