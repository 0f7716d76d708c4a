"""Engine settings of the pictures, as data: what `scene.json` records and `render` applies."""

from __future__ import annotations

from dataclasses import dataclass, replace

from .settings import Settings


@dataclass(frozen=True)
class Quality:
    """Size, samples, seed, engine and device of a picture.

    Threads do not change a byte, so they are not described. The device does, in the last bits.
    """

    width: int
    height: int
    samples: int
    seed: int
    threads: int = 0  # 0: all cores
    engine: str = "cycles"  # or "eevee", for pictures only: truth is always by Cycles
    device: str = "cpu"  # of Cycles: "cpu", "gpu" or "auto"

    @classmethod
    def of(cls, settings: Settings, threads: int = 0) -> Quality:
        size = settings.size
        return cls(size, size, settings.samples, settings.seed, threads, settings.engine, settings.device)

    def finer(self, size: int, fineness: int) -> Quality:
        """Of a larger picture whose pixels are `fineness` times as many along an edge: as many light paths in all."""
        samples = max(1, round(self.samples / fineness**2))
        return replace(self, width=size, height=size, samples=samples)

    def describe(self) -> dict[str, object]:
        """What `scene.json` says of the engine beside the seed."""
        shared: dict[str, object] = {"samples": self.samples, "view_transform": "Standard", "dither": 0.0}
        if self.engine == "eevee":
            return {"name": "EEVEE", **shared, "pixel_filter": "BLACKMAN_HARRIS 1.5 px", "ray_tracing": True}
        return {
            "name": "CYCLES",
            **shared,
            "device": self.device,
            "denoiser": None,
            "adaptive_sampling": False,
            "pixel_filter": "BLACKMAN_HARRIS 1.5 px",
        }
