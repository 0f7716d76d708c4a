"""What a run found, as numbers."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from tg4mm.core.choices import Kind

Band = tuple[float, float]  # low and high, Hz, both ends inside


@dataclass(frozen=True)
class Length:
    """A length and its standard deviation, None where that is not known."""

    value: float
    deviation: float | None = None

    def times(self, factor: float) -> Length:
        """In another unit."""
        return Length(self.value * factor, None if self.deviation is None else self.deviation * factor)


@dataclass(frozen=True)
class Vibration:
    """One frequency that was found, and how far things move at it where they move most."""

    hz: float
    deviation_hz: float
    amplitude: (
        Length  # scene units: the largest displacement from the middle, 99th percentile of what is seen
    )
    place: tuple[float, float, float]  # scene units: where that is, at rest
    pixels: Length | None  # the same in the pictures, 99th percentile of what is seen; None without a dataset
    damping: float | None  # ratio, of the critical; None: not to be told
    damping_deviation: float | None
    why_no_damping: str  # "" where there is one
    band: Band  # suggested for --band
    place_px: tuple[float, float] | None = None  # of a flat capture: the same in its picture, right and down
    begins_s: float | None = None  # where it begins in the record; None: before it


@dataclass(frozen=True)
class Result:
    """What a run found, what it could not tell, and what to do next. Vibrations are in order of falling strength."""

    run: Path
    kind: Kind | None  # of the capture; None: its dataset is gone
    n_cameras: int  # poses that show motion; 0 if the dataset is gone
    n_timesteps: int
    fps: float  # Hz
    vibrations: tuple[Vibration, ...]
    untold_hz: tuple[Length, ...]  # frequencies that were found, but not how things move at them
    unit_scale_m: float | None  # metres per scene unit
    noise: (
        float | None
    )  # scene units: the amplitude of a motion as large as the noise, median of what is seen
    noise_px: float | None  # the same in the pictures
    agreement: tuple[float, ...]  # 0 … 1: what two halves of the data agree on, of each function of time
    cannot: tuple[str, ...]  # what cannot be told, a line each
    beside: tuple[Vibration, ...] = field(
        default=(), kw_only=True
    )  # found region by region, but not in the model
    alpha: float  # suggested for --alpha
    next_command: str

    @property
    def is_flat(self) -> bool:
        """Whether lengths are pixels of one picture and nothing else."""
        return self.kind is not None and not self.kind.sees_depth

    @property
    def band(self) -> Band | None:
        """What `--band auto` takes: around the strongest vibration; None where there is none."""
        return self.vibrations[0].band if self.vibrations else None

    @property
    def duration_s(self) -> float:
        """What the record covers."""
        return self.n_timesteps / self.fps
