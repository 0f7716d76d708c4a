"""What to generate: one frozen description, checked on entry; equal settings give equal files."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from tg4mm.errors import Tg4mmError


class GenerateError(Tg4mmError):
    """A dataset that cannot be generated as asked. One line, with the option and its value."""


TRUTH = ("none", "test", "all")
_LIMIT_SIZE = (8, 4096)


@dataclass(frozen=True)
class Settings:
    """Options of a dataset. Raises GenerateError on construction if one is out of range."""

    scene: str = "mic"
    size: int = 128  # edge of the square images, pixels
    timesteps: int = 30
    fps: float = 30.0  # timesteps per second
    frequency: float = 5.0  # Hz
    amplitude: float = 0.005  # largest displacement, scene units
    views: int = 30  # training cameras
    test_views: int = 5
    alphas: tuple[float, ...] = (5, 10, 20, 50)  # magnification factors of the ground truth
    samples: int = 96  # light paths per pixel
    seed: int = 0  # of the renderer
    truth: str = "test"  # splits with per-pixel truth
    points: int = 20000  # of points3d.ply

    def __post_init__(self) -> None:
        _whole("--size", self.size, *_LIMIT_SIZE)
        _whole("--timesteps", self.timesteps, 1, 1000)  # folders are numbered with three digits
        _whole("--views", self.views, 1, 1000)
        _whole("--test-views", self.test_views, 0, 1000)
        _whole("--samples", self.samples, 1, 65536)
        _whole("--seed", self.seed, 0, 2**31 - 1)
        _whole("--points", self.points, 0, 10_000_000)
        _positive("--fps", self.fps)
        _positive("--frequency", self.frequency)
        _positive("--amplitude", self.amplitude)
        if self.frequency >= self.fps / 2:
            raise GenerateError(
                f"--frequency {self.frequency:g} Hz is not below half the frame rate, {self.fps / 2:g} Hz "
                f"(--fps {self.fps:g})"
            )
        for alpha in self.alphas:
            if not (math.isfinite(alpha) and 0 < alpha <= 999 and alpha == int(alpha)):
                raise GenerateError(
                    f"--alphas {alpha!r}: a magnification factor is a whole number in 1 … 999"
                )
        if len(set(self.alphas)) != len(self.alphas):
            raise GenerateError(f"--alphas {','.join(f'{a:g}' for a in self.alphas)} names a factor twice")
        if self.truth not in TRUTH:
            raise GenerateError(f"--truth {self.truth!r} is none of {', '.join(TRUTH)}")

    @property
    def folder(self) -> str:
        """Name of the dataset's folder, "mic_5Hz_0_005": decimal points become underscores."""
        return f"{self.scene}_{_plain(self.frequency)}Hz_{_plain(self.amplitude)}"

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Settings:
        return cls(**{**data, "alphas": tuple(data["alphas"])})


def _whole(option: str, value: int, low: int, high: int) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise GenerateError(f"{option} {value!r} is not a whole number in {low} … {high}")


def _positive(option: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise GenerateError(f"{option} {value!r} is not a positive number")


def _plain(value: float) -> str:
    """A number without exponent, its decimal point as an underscore."""
    text = f"{value:.12f}".rstrip("0").rstrip(".")
    if float(text) == 0.0:
        raise GenerateError(f"{value!r} is too small to name a folder after")
    return text.replace(".", "_")
