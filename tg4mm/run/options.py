"""Options of `tg4mm train`."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.options import (
    REQUIRED,
    Band,
    Device,
    argument,
    band_option,
    device_option,
    option,
    settings_option,
)

LIST_SETTINGS = "--list-settings"


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """Fit the scene at rest and its motion to a dataset.

    Defaults follow from the dataset's size, timesteps and views. The same command resumes a run that was stopped; for a
    finished run it prints the result again.
    """

    dataset: Path = argument("DATASET", "A dataset folder (docs/conventions.md lists the layouts).")
    out: Path = option(REQUIRED, "Run folder; an unfinished one is resumed.")
    preset: str = option(
        "modal",
        "modal: one fit of modes to all timesteps. paper: TG4MM as published, a triplane for each timestep. "
        "paper-tuned: the same with changes that find more of the motion in less time (docs/paper.md). Packages may "
        "add presets: --list-settings lists all.",
        metavar="NAME",
    )
    device: Device = device_option()
    settings: Mapping[str, str] = settings_option(
        f"Override one setting, e.g. space.iterations=3000; may be repeated. {LIST_SETTINGS} lists them."
    )
    band: Band | None = band_option(
        "Frequency band in Hz in which motion is fitted even if no peak stands out, for records of one or two periods "
        "(--set motion.band). [default: significant peaks]"
    )
    region: str | None = option(
        None,
        "Where motion is allowed, for one fixed camera: a PNG, white there, or a polygon's corners in pixels (--set "
        "motion.region). [default: everywhere]",
        metavar="FILE | X,Y X,Y …",
    )
    mask: str | None = option(
        None,
        "Valid part of the fixed camera's pictures, for the scene at rest and its motion (--set space.mask). [default: "
        "everything]",
        metavar="FILE | X,Y X,Y …",
    )
    list_settings: bool = option(
        False, "Print the settings of all presets with default, unit and meaning, and exit."
    )

    def all_settings(self) -> dict[str, str]:
        """Return the settings of --set with those that have an option of their own.

        Raises Tg4mmError where one is set twice.
        """
        settings = dict(self.settings)
        band = None if self.band is None else "{:g} {:g}".format(*self.band)
        own = {
            "motion.band": ("--band", band),
            "motion.region": ("--region", self.region),
            "space.mask": ("--mask", self.mask),
        }
        for name, (spelling, text) in own.items():
            if text is not None and name in settings:
                raise Tg4mmError(f"{spelling} and --set {name} cannot be used together: give only one")
            if text is not None:
                settings[name] = text
        return settings
