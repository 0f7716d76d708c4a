"""Engine settings of the pictures, as data: what `scene.json` records and `render` applies."""

from __future__ import annotations

from dataclasses import dataclass

from .settings import Settings


@dataclass(frozen=True)
class Quality:
    """Size, samples and seed of a picture. Threads do not change a byte, so they are not described."""

    width: int
    height: int
    samples: int
    seed: int
    threads: int = 0  # 0: all cores

    @classmethod
    def of(cls, settings: Settings, threads: int = 0) -> Quality:
        return cls(settings.size, settings.size, settings.samples, settings.seed, threads)

    def describe(self) -> dict[str, object]:
        """What `scene.json` says of the engine beside the seed."""
        return {
            "name": "CYCLES",
            "samples": self.samples,
            "denoiser": None,
            "adaptive_sampling": False,
            "view_transform": "Standard",
            "dither": 0.0,
            "pixel_filter": "BLACKMAN_HARRIS 1.5 px",
        }
